"""Cross-validation of a surrogate with the draws of a refused certificate, without further model runs.

The draws train the next surrogate and assess it by cross-validation, in which each fold of draws is left out in turn. A surrogate
is fitted to all runs except one fold and evaluated at this fold, since a certificate requires unseen draws. Its posterior q₍₎
differs slightly from the posterior q of the surrogate fitted to all runs; this difference needs no model run. To first order, the
variation of π/q is at most the sum of the variations of π/q₍₎ and q₍₎/q. This also holds for averages over the folds: the root
mean square variation of π/q₍₎, estimated from all draws, and the mean variation of q₍₎/q.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from structid.calibration.next_runs import POPULATION, Batch
from structid.certification.density_difference import FOLDS, density_difference
from structid.certification.fresh_draws import DensityDifference
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult

COMPARED = 1000
"""Number of draws at which the posteriors of two surrogates are compared."""

Left = Callable[[np.ndarray], Posterior]
"""Returns the posterior of a surrogate fitted to all runs except some draws, given by their indices."""


def cross_validate(
    last: Batch, drawn: SamplingResult, under: Posterior, without: Left
) -> tuple[Batch, DensityDifference]:
    """Cross-validate a surrogate with the draws of a refused certificate, which are among its training runs."""
    some = drawn.thinned(COMPARED)
    of_all = under.log_density(some)
    log_surrogate = np.empty(len(last.fresh))
    differences: list[DensityDifference] = []
    for first in range(FOLDS):
        places = np.arange(first, len(last.fresh), FOLDS)
        left = without(places)
        scale, apart = density_difference(left.log_density(some) - of_all, under.compared(some))
        differences.append(apart)
        log_surrogate[places] = left.log_density(last.fresh[places]) - scale
    log_change = (
        under.log_density(last.fresh) - last.log_surrogate
    )  # from the old surrogate's posterior to the new one's
    shares = last.shares * np.exp(log_change - log_change.max())
    highest = float(drawn.log_density[drawn.discarded :].max())
    none = np.empty((0, last.others.shape[1]))
    batch = replace(
        last,
        log_surrogate=log_surrogate,
        shares=shares,
        others=none,
        population=drawn.thinned(POPULATION),
        highest=highest,
    )
    return batch, DensityDifference.average(differences)
