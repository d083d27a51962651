"""A second look for nothing: the draws of a refused certificate train the next surrogate, and judge it, each left out in turn.

A surrogate is fitted to all runs but some of these draws, and asked for the log density at those. It has not seen them, as a
certificate demands. Its posterior q₍₎ differs a little from q, that of the surrogate which is fitted to all; by how much is
known without a run of the model. With log π/q = log π/q₍₎ + log q₍₎/q, the variation of π/q is at most the sum of both, to
first order. That holds for every group that is left out, and so for averages over the groups: with the root of the mean square
of the variations of π/q₍₎, which all draws together estimate, and the mean of those of q₍₎/q.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from structid.calibration.next_runs import POPULATION, Batch
from structid.certification.density_difference import FOLDS, density_difference
from structid.certification.fresh_draws import Beside
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult

COMPARED = 1000
"""Draws at which the posteriors of two surrogates are compared."""

Left = Callable[[np.ndarray], Posterior]
"""The posterior of a surrogate that was fitted to all runs but some of the draws, given by their places."""


def judged_in_turn(last: Batch, drawn: SamplingResult, under: Posterior, without: Left) -> tuple[Batch, Beside]:
    """Let the draws of a refused certificate judge the surrogate that they have trained."""
    some = drawn.thinned(COMPARED)
    of_all = under.log_density(some)
    log_surrogate = np.empty(len(last.fresh))
    beside: list[Beside] = []
    for first in range(FOLDS):
        places = np.arange(first, len(last.fresh), FOLDS)
        left = without(places)
        scale, apart = density_difference(left.log_density(some) - of_all, under.compared(some))
        beside.append(apart)
        log_surrogate[places] = left.log_density(last.fresh[places]) - scale
    moved = under.log_density(last.fresh) - last.log_surrogate  # from the old surrogate's posterior to the new one's
    shares = last.shares * np.exp(moved - moved.max())
    highest = float(drawn.log_density[drawn.discarded :].max())
    none = np.empty((0, last.others.shape[1]))
    judged = replace(
        last,
        log_surrogate=log_surrogate,
        shares=shares,
        others=none,
        population=drawn.thinned(POPULATION),
        highest=highest,
    )
    return judged, Beside.average(beside)
