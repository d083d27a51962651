"""Draws of a surrogate's posterior that are good enough to be certified: converged, found by a second explorer, and not made up."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from structid.calibration.exploration import LARGEST_VARIANCE, variance_by_the_surrogate
from structid.core.hashing import digest
from structid.core.journal import Journal
from structid.core.progress import Progress
from structid.inference.diagnostics.second_sampler import EXPLORER, LONGEST, Representation, represented
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import sample
from structid.inference.sampling.base import Sampler
from structid.inference.sampling.smc.smc import SMC
from structid.inference.sampling_result import SamplingResult
from structid.surrogates.base import Surrogate

USUAL_SAMPLER = SMC(particles=500, steps=50, effective_share=0.5, correlation=0.5)
"""Draws from the surrogate's posterior, where no sampler is named."""

MORE_CAREFUL = (
    USUAL_SAMPLER,
    replace(USUAL_SAMPLER, particles=1000, effective_share=0.7, correlation=0.1, most_moves=100, steps=150),
    replace(USUAL_SAMPLER, particles=2000, effective_share=0.7, correlation=0.1, most_moves=200, steps=100),
)
"""What it is followed by while draws have not converged: along a narrow ridge particles move slowly. If they move too little in a
stage, they come to rest in the end, but evidence is lost on the way, and the second explorer disagrees."""

ASKED = 64
"""Draws at which the surrogate is asked how sure it is."""

NOT_YET_LONGEST = 4
"""Times as many steps a second explorer takes that disagrees with draws for which there is a more careful sampler."""

LONGER = (1, 4, 16)
"""How many times as many steps a sampler that was asked for takes while its draws have not converged."""


@dataclass(frozen=True, eq=False)
class FinalDraws:
    """Draws, and whether they stand for the posterior that they are said to come from."""

    sampling: SamplingResult = field(repr=False)  # The draws
    representation: Representation  # They beside those of a second explorer
    # Some of them, in SI, at which the surrogate does not know its own density. One of few runs may make a mode up
    # where there are none, higher than the true one
    made_up: Float[np.ndarray, "draw parameter"] = field(repr=False)

    @property
    def failures(self) -> tuple[str, ...]:
        """Why they do not, one sentence each; empty where they do."""
        unsure = ["the surrogate does not know its own density at these draws: it may have made a mode up"]
        return (
            *self.sampling.failures,
            *self.representation.failures,
            *(unsure if len(self.made_up) else []),
        )


def final_draws(
    under: Posterior,
    surrogate: Surrogate,
    sure: bool,
    known: Float[np.ndarray, "run model_parameter"],
    sampler: Sampler | None,
    seed: int,
    folder: Path | None,
    told: Progress,
) -> FinalDraws:
    """Draw from a surrogate's posterior until the draws converge and a second sampler agrees, with more work at each try."""
    with tempfile.TemporaryDirectory() as scratch:
        where = Path(scratch) if folder is None else folder
        tried = _one_after_another(sampler)
        for place, (name, one, again) in enumerate(tried, 1):
            drawn = sample(under, one, seed, where / f"{name}.h5", progress=told)
            made_up = _made_up(under, surrogate, drawn) if sure else drawn.flat[:0]
            last = place == len(tried) or len(made_up) > 0
            if drawn.failures and not last:
                continue
            errors = np.median(drawn.flat[:, under.model_space.dimension :], axis=0)
            starts = np.concatenate([known, np.tile(errors, (len(known), 1))], axis=1)
            # What is made up need not be explored to the end, and where a more careful sampler is left, it comes first.
            longest = 1 if len(made_up) else LONGEST if last else NOT_YET_LONGEST
            beside = _beside(under, drawn, starts, seed, again, longest, where / f"beside_{place}.journal")
            found = FinalDraws(drawn, beside, made_up)
            if last or not found.failures:
                break
    return found


def _beside(
    under: Posterior, drawn: SamplingResult, starts: np.ndarray, seed: int, again: SMC, longest: int, path: Path
) -> Representation:
    """The draws beside those of a second explorer, which takes longer than the draws: found once, then read from the store."""
    settings = digest(repr(again), longest, starts)
    identity = {"posterior": under.content_hash, "sampler": repr(drawn.sampler), "seed": seed, "settings": settings}
    journal = Journal(path, identity)
    for entry in journal:
        return Representation.of(entry)
    found = represented(under, drawn.kept, starts, seed, again, drawn.log_evidence, longest)
    journal.append(found.to_entry())
    return found


def _made_up(under: Posterior, surrogate: Surrogate, drawn: SamplingResult) -> np.ndarray:
    """Some of the draws at which the surrogate is unsure of its density; none where it is sure on average over all."""
    some = drawn.thinned(ASKED)
    variance = variance_by_the_surrogate(under, surrogate, some)
    return some[variance > LARGEST_VARIANCE] if np.mean(variance) > LARGEST_VARIANCE else some[:0]


def _one_after_another(sampler: Sampler | None) -> list[tuple[str, Sampler, SMC]]:
    """Samplers to try, each with the name of its store and a second explorer: what takes longer goes on in the same store."""
    if sampler is None:
        return [(f"chains_{place}", one, replace(one, scouts=0)) for place, one in enumerate(MORE_CAREFUL)]
    return [("chains", _longer(sampler, times), EXPLORER) for times in LONGER]


def _longer(sampler: Sampler, times: int) -> Sampler:
    """The same sampler with so many times as many steps: every one is a dataclass that has them."""
    longer: Any = sampler
    return cast(Sampler, replace(longer, steps=times * sampler.steps))
