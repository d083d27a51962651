"""Draw from a target in blocks; each block is on disk before the next begins."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.progress import Progress
from structid.core.streams import Purpose, derived_seed
from structid.core.validation import check_arguments
from structid.engine.lanes.machine import engine
from structid.inference.sampling.aies import AIES
from structid.inference.sampling.base import Block, Sampler
from structid.inference.sampling.chain_store import ChainStore
from structid.inference.sampling.smc.smc import SMC
from structid.inference.sampling_result import SamplingResult
from structid.inference.target import Target

POPULATION = SMC(particles=250, ensembles=8, steps=20, effective_share=0.6, correlation=0.3)
"""Sampler of an independent population, with which the draws of a few chains are compared."""


@check_arguments
def sample(
    target: Target,
    sampler: Sampler | None = None,
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
    sampler : AIES, SMC, NUTS or DelayedAcceptance, optional
        The sampler and its settings; by default AIES.
    seed : int
        Seed; the same seed gives the same draws.
    store : path-like, optional
        HDF5 file for the draws. An interrupted run continues from it, with identical results. A finished run is read back, and
        extended if more steps are requested. A store of another target, sampler or seed is refused.
    start : array-like, shape (point, parameter), optional
        For AIES, NUTS and delayed acceptance: points in SI, inside the support, from which the starting points are chosen. By
        default, they are drawn from the target's prior or from a tempered posterior. Scatter them more widely than the
        posterior; otherwise R-hat cannot detect a lack of convergence.
    progress : callable, optional
        Called with the amount done and the total.

    Returns
    -------
    SamplingResult
        Draws, diagnostics, verdict.

    Raises
    ------
    StoreMismatchError
        If `store` belongs to another run.

    Examples
    --------
    >>> import structid as si
    >>> start = si.ParameterSpace(a=si.Normal(0.0, 3.0), b=si.Normal(0.0, 3.0))
    >>> target = si.LogDensity(lambda x: -0.5 * (x**2).sum(axis=-1), ("a", "b"), start)
    >>> result = si.sample(target, si.SMC(particles=100, ensembles=2, steps=20), seed=1)
    >>> result.flat.shape[1]
    2
    """
    sampler = AIES() if sampler is None else sampler
    if seed < 0:
        raise InputError("sample(seed)", f"{seed}", "a whole number, 0 or more")
    check_memory(target, sampler)
    chains = None if store is None else ChainStore(store, chain_identity(target, sampler, seed, start))
    blocks = [] if chains is None else chains.blocks()
    seconds = {index: float(block["seconds"].sum()) for index, block in enumerate(blocks)}
    clock = time.perf_counter()

    def keep(index: int, block: Block) -> None:
        nonlocal clock
        seconds[index], clock = time.perf_counter() - clock, time.perf_counter()
        steps = len(block["log_density"])
        block["seconds"] = np.full(steps, seconds[index] / steps)
        if chains is not None:
            chains.append(index, block)

    drawn = sampler.run(target, seed, start, blocks, keep, progress)
    del blocks  # `drawn` has copies of all draws
    if chains is not None:
        chains.finish()
    del chains
    population = None
    if sampler.compared and target.knows_prior and not target.costs_runs:
        kept = None if store is None else Path(store).with_suffix(".beside.h5")
        population = sample(target, POPULATION, derived_seed(seed, Purpose.BESIDE), kept).kept
    theta, jacobian = target.bijection(drawn.phi.reshape(-1, drawn.phi.shape[-1]))
    return SamplingResult(
        target=target,
        sampler=sampler,
        seed=seed,
        history=theta.reshape(drawn.phi.shape),
        log_density=drawn.log_density - jacobian.reshape(drawn.log_density.shape),
        coordinate_log_density=drawn.log_density,
        accepted=drawn.accepted,
        failed_simulations=drawn.failed,
        seconds=sum(seconds.values()),
        log_evidence=drawn.log_evidence,
        cost=drawn.cost,
        divergent=drawn.divergent,
        beside=population,
    )


def check_memory(target: Target, sampler: Sampler) -> None:
    """Refuse draws that exceed this machine's memory, before sampling begins."""
    numbers = sampler.steps * sampler.ensembles * sampler.walkers * (target.dimension + 2)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else np.inf
    if 8 * numbers > memory:
        raise InputError(
            f"sample({type(sampler).__name__})",
            f"{sampler.steps} steps of {sampler.ensembles} x {sampler.walkers} walkers, whose draws take {8e-9 * numbers:,.0f} GB",
            f"draws that fit into the {1e-9 * memory:.0f} GB of this machine",
            "Use fewer steps: a hundred walkers and a few thousand steps are usually enough.",
        )


def chain_identity(target: Target, sampler: Sampler, seed: int, start: np.ndarray | None = None) -> dict[str, Any]:
    """Everything on which chains depend; a store with another identity is refused."""
    return {
        "target": target.content_hash,
        "engine": engine(),
        "names": list(target.names),
        "sampler": sampler.describe(),
        "seed": seed,
        "start": None if start is None else digest(np.asarray(start, dtype=np.float64)),
    }
