"""Draws from a surrogate's posterior for a certificate: converged, and confirmed by a second sampler."""

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
from structid.inference.diagnostics.second_sampler import LONGEST, SECOND_SAMPLER, Representation, check_representation
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import sample
from structid.inference.sampling.base import Sampler
from structid.inference.sampling.smc.smc import SMC
from structid.inference.sampling_result import SamplingResult
from structid.surrogates.base import Surrogate

USUAL_SAMPLER = SMC(particles=500, steps=50, effective_share=0.5, correlation=0.5)
"""Default sampler of the surrogate's posterior."""

MORE_CAREFUL = (
    USUAL_SAMPLER,
    replace(USUAL_SAMPLER, particles=1000, effective_share=0.7, correlation=0.1, most_moves=100, steps=150),
    replace(USUAL_SAMPLER, particles=2000, effective_share=0.7, correlation=0.1, most_moves=200, steps=100),
)
"""Samplers to try in turn until the draws converge, since particles move slowly along a narrow ridge. With too few moves in a
tempering step, the particles still reach equilibrium, but the evidence is inaccurate, and the second sampler disagrees."""

ASKED = 64
"""Number of draws at which the surrogate error is evaluated."""

NOT_YET_LONGEST = 4
"""Factor on the steps of a second sampler that disagrees, while a more careful sampler remains to be tried."""

LONGER = (1, 4, 16)
"""Factors on the number of steps of a user's sampler, tried in turn until its draws converge."""


@dataclass(frozen=True, eq=False)
class FinalDraws:
    """Draws from a surrogate's posterior, with the checks that they represent it."""

    sampling: SamplingResult = field(repr=False)  # the draws
    representation: Representation  # comparison with a second sampler
    # Some of the draws, in SI, at which the surrogate's density is unreliable. A surrogate of few runs may have a false mode
    # away from the runs, higher than the true mode
    made_up: Float[np.ndarray, "draw parameter"] = field(repr=False)

    @property
    def failures(self) -> tuple[str, ...]:
        """Reasons why the draws may not represent their posterior, one sentence each; empty if there are none."""
        unsure = ["the surrogate's density is unreliable at these draws: it may have a false mode there"]
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
    report: Progress,
) -> FinalDraws:
    """Sample a surrogate's posterior with increasing effort until the draws converge and a second sampler agrees."""
    with tempfile.TemporaryDirectory() as scratch:
        where = Path(scratch) if folder is None else folder
        tried = _one_after_another(sampler)
        for number, (name, one, again) in enumerate(tried, 1):
            drawn = sample(under, one, seed, where / f"{name}.h5", progress=report)
            made_up = _made_up(under, surrogate, drawn) if sure else drawn.flat[:0]
            last = number == len(tried) or len(made_up) > 0
            if drawn.failures and not last:
                continue
            errors = np.median(drawn.flat[:, under.model_space.dimension :], axis=0)
            starts = np.concatenate([known, np.tile(errors, (len(known), 1))], axis=1)
            # A false mode need not be sampled to convergence, and a more careful sampler comes first if one is left.
            longest = 1 if len(made_up) else LONGEST if last else NOT_YET_LONGEST
            comparison = _beside(under, drawn, starts, seed, again, longest, where / f"beside_{number}.journal")
            draws = FinalDraws(drawn, comparison, made_up)
            if last or not draws.failures:
                break
    return draws


def _beside(
    under: Posterior, drawn: SamplingResult, starts: np.ndarray, seed: int, again: SMC, longest: int, path: Path
) -> Representation:
    """Compare the draws with those of a second sampler, or read a stored comparison."""
    settings = digest(repr(again), longest, starts)
    identity = {"posterior": under.content_hash, "sampler": repr(drawn.sampler), "seed": seed, "settings": settings}
    journal = Journal(path, identity)
    for entry in journal:
        return Representation.of(entry)
    comparison = check_representation(under, drawn.kept, starts, seed, again, drawn.log_evidence, longest)
    journal.append(comparison.to_entry())
    return comparison


def _made_up(under: Posterior, surrogate: Surrogate, drawn: SamplingResult) -> np.ndarray:
    """Return the draws with a large variance due to the surrogate error; none if the mean variance is small."""
    some = drawn.thinned(ASKED)
    variance = variance_by_the_surrogate(under, surrogate, some)
    return some[variance > LARGEST_VARIANCE] if np.mean(variance) > LARGEST_VARIANCE else some[:0]


def _one_after_another(sampler: Sampler | None) -> list[tuple[str, Sampler, SMC]]:
    """Samplers to try, each with the name of its store and a second sampler; longer runs continue in the same store."""
    if sampler is None:
        return [(f"chains_{number}", one, replace(one, scouts=0)) for number, one in enumerate(MORE_CAREFUL)]
    return [("chains", _longer(sampler, times), SECOND_SAMPLER) for times in LONGER]


def _longer(sampler: Sampler, times: int) -> Sampler:
    """The sampler with a multiple of its steps."""
    longer: Any = sampler
    return cast(Sampler, replace(longer, steps=times * sampler.steps))
