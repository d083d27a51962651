"""Draw from a target with a sampler, block by block, each block on disk before the next."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from structid.errors import InputError
from structid.inference.chain_store import ChainStore
from structid.inference.ensemble import (
    AIES,
    BLOCK_STEPS,
    Block,
    EnsembleState,
    block_lengths,
    run_block,
    settle,
    starting_state,
)
from structid.inference.result import SamplingResult
from structid.inference.target import Target
from structid.journal import digest
from structid.models.base import Progress


def sample(
    target: Target,
    sampler: AIES | None = None,
    seed: int = 0,
    store: str | os.PathLike[str] | None = None,
    start: np.ndarray | None = None,
    progress: Progress | None = None,
) -> SamplingResult:
    """Draw from a target.

    Parameters
    ----------
    target : Target
        A `Posterior`, or any `LogDensity`.
    sampler : AIES, optional
        The sampler and its settings.
    seed : int
        Seed; the same one gives the same draws.
    store : path-like, optional
        HDF5 file for the draws. A killed run continues from it to the same bits; a finished one is read; with more steps it is
        continued. A store of another target, sampler or seed is refused.
    start : array-like, shape (point, parameter), optional
        Points in SI, inside the support, among which the walkers start; drawn from the target's prior when left out. Spread
        them wider than the posterior, or R-hat has nothing to find.
    progress : callable, optional
        Told how many steps are done.

    Returns
    -------
    SamplingResult
        Draws, diagnostics, verdict.

    Raises
    ------
    StoreMismatchError
        If `store` belongs to another run.
    """
    sampler = AIES() if sampler is None else sampler
    if seed < 0:
        raise InputError("sample(seed)", f"{seed}", "a whole number, 0 or more")
    identity = {
        "target": target.content_hash,
        "names": list(target.names),
        "sampler": sampler.describe(),
        "seed": seed,
        "start": None if start is None else digest(np.asarray(start, dtype=np.float64)),
    }
    chains = None if store is None else ChainStore(store, identity)
    blocks = [] if chains is None else chains.blocks()
    lengths = list(block_lengths(sampler.steps))
    # A last block that an earlier, shorter run cut off is run again whole: its random stream is the block's.
    while blocks and len(blocks) <= len(lengths) and len(blocks[-1]["log_density"]) < lengths[len(blocks) - 1]:
        blocks.pop()
    state, start_failures = _resume(target, sampler, seed, start, blocks)
    for index in range(len(blocks), len(lengths)):
        began = time.perf_counter()
        if 0 < index * BLOCK_STEPS <= sampler.settling_steps:
            state = settle(state, seed, index)
        state, block = run_block(target, sampler, state, seed, index, lengths[index])
        if index == 0:
            block["failed"][0] += start_failures
        block["seconds"] = np.full(lengths[index], (time.perf_counter() - began) / lengths[index])
        if chains is not None:
            chains.append(index, block)
        blocks.append(block)
        if progress is not None:
            progress(sum(lengths[: index + 1]), sampler.steps)
    if chains is not None:
        chains.finish()
    return _result(target, sampler, seed, blocks)


def _resume(
    target: Target, sampler: AIES, seed: int, points: np.ndarray | None, blocks: list[Block]
) -> tuple[EnsembleState, int]:
    """Where the walkers were after the last stored block, or fresh starting points."""
    if blocks:
        return EnsembleState(blocks[-1]["phi"][-1], blocks[-1]["log_density"][-1]), 0
    return starting_state(target, sampler, seed, points)


def _result(target: Target, sampler: AIES, seed: int, blocks: list[Block]) -> SamplingResult:
    joined: dict[str, Any] = {name: np.concatenate([b[name] for b in blocks])[: sampler.steps] for name in blocks[0]}
    phi = joined["phi"]
    theta, jacobian = target.bijection(phi.reshape(-1, phi.shape[-1]))
    return SamplingResult(
        target=target,
        sampler=sampler,
        seed=seed,
        history=theta.reshape(phi.shape),
        log_density=joined["log_density"] - jacobian.reshape(phi.shape[:-1]),
        coordinate_log_density=joined["log_density"],
        accepted=joined["accepted"],
        failed_simulations=int(joined["failed"].sum()),
        seconds=float(joined["seconds"].sum()),
    )
