"""Draws of a surrogate's posterior that are good enough to be certified: converged, and what a second explorer finds, too."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from structid.inference.assessment.representation import EXPLORER, Representation, represented
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import sample
from structid.inference.sampling.sampler import Sampler
from structid.inference.sampling.tempered import SMC
from structid.inference.sampling_result import SamplingResult
from structid.models.face import Progress

USUAL_SAMPLER = SMC(particles=500, steps=50, effective_share=0.5, correlation=0.5)
"""Draws from the surrogate's posterior, where no sampler is named."""

MORE_CAREFUL = (
    USUAL_SAMPLER,
    replace(USUAL_SAMPLER, particles=1000, correlation=0.2, steps=150),
    replace(USUAL_SAMPLER, particles=2000, effective_share=0.7, correlation=0.1, most_moves=200, steps=100),
)
"""What it is followed by while draws have not converged: along a narrow ridge particles move slowly."""

LONGER = (1, 4, 16)
"""How many times as many steps a sampler that was asked for takes while its draws have not converged."""


@dataclass(frozen=True, eq=False)
class FinalDraws:
    """Draws, and whether they stand for the posterior that they are said to come from.

    Parameters
    ----------
    sampling : SamplingResult
        The draws.
    representation : Representation
        They beside those of a second explorer.
    """

    sampling: SamplingResult = field(repr=False)
    representation: Representation

    @property
    def failures(self) -> tuple[str, ...]:
        """Why they do not, one sentence each; empty where they do."""
        return (*self.sampling.verdict().failures, *self.representation.failures)


def final_draws(
    under: Posterior, known: np.ndarray, sampler: Sampler | None, seed: int, folder: Path | None, told: Progress
) -> FinalDraws:
    """Draw from a surrogate's posterior; by more and more careful samplers until the draws converge, and a second explorer agrees.

    Parameters
    ----------
    under : Posterior
        Of the surrogate.
    known : ndarray, shape (run, model parameter)
        Points of true runs, in SI: the second explorer searches for modes from there as well.
    sampler : Sampler or None
        The only one to be used, where it is given; it takes up to 16 times as many steps.
    seed : int
        Seed.
    folder : Path or None
        For the chains; not kept if None.
    told : callable
        Called with the percentage done, and 100.

    Returns
    -------
    FinalDraws
        The last.
    """
    with tempfile.TemporaryDirectory() as scratch:
        where = Path(scratch) if folder is None else folder
        for name, one, again in _one_after_another(sampler):
            drawn = sample(under, one, seed, where / f"{name}.h5", progress=told)
            errors = np.median(drawn.flat[:, under.model_space.dimension :], axis=0)
            starts = np.concatenate([known, np.tile(errors, (len(known), 1))], axis=1)
            found = FinalDraws(drawn, represented(under, drawn.kept, starts, seed, again, drawn.log_evidence))
            if not found.failures:
                break
    return found


def _one_after_another(sampler: Sampler | None) -> list[tuple[str, Sampler, SMC]]:
    """Samplers to try, each with the name of its store and a second explorer: what takes longer goes on in the same store."""
    if sampler is None:
        return [(f"chains_{place}", one, replace(one, scouts=0)) for place, one in enumerate(MORE_CAREFUL)]
    return [("chains", _longer(sampler, times), EXPLORER) for times in LONGER]


def _longer(sampler: Sampler, times: int) -> Sampler:
    """The same sampler with so many times as many steps: every one is a dataclass that has them."""
    longer: Any = sampler
    return cast(Sampler, replace(longer, steps=times * sampler.steps))
