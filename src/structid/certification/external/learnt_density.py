"""A density q′ between external draws and the true posterior, learnt from model runs.

The weights π/q vary wherever q is wrong, even if this hardly changes the moments. A Kriging surrogate of log π, fitted to the
certificate's runs and to known runs, gives a closer density q′. The differences between the moments of q′ and q need no model run
(see `Correction`). The runs assess q′: each run is compared with a Kriging surrogate fitted without it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from structid.certification.correction import Correction
from structid.certification.density_difference import FOLDS, density_difference
from structid.certification.external.drawn_density import Chosen, DrawnDensity
from structid.certification.external.kriged_density import (
    CORRELATIONS,
    KrigedDensity,
    in_parameters,
    normal_by,
    standardised_by,
)
from structid.certification.fresh_draws import DensityDifference, FreshDraws, StoredRuns
from structid.certification.known_points import Points, joined
from structid.certification.limits import Limits

AROUND = 9000
"""Number of points at which q and q′ are compared."""
BEYOND = 0.01
"""Largest accepted probability of q′ in regions without fresh draws."""
COMPARED = 1000
"""Number of draws from q′ at which q′ is compared with the densities that leave out one fold."""
SURE = 0.5
"""Standard deviation of the Kriging at which its weight is e⁻¹ [nat]."""
MOST_UNSURE = 2.0
"""Upper limit of the Kriging standard deviation in the choice of a run; a larger one counts as this [nat]."""
TAILS = 0.02
"""Fraction of the wider density in q′ far from runs; with shorter tails, the weights could have infinite variance."""
DEEPEST = 60.0
"""Depth below the best fresh run beyond which known runs are ignored [nat]."""


class LearntDensity:
    """q′, learnt from model runs."""

    def __init__(
        self, drawn: DrawnDensity, judges: Chosen, fresh: FreshDraws, known: Points, rng: np.random.Generator
    ) -> None:
        self.drawn, self.judges, self.fresh, self.rng = drawn, judges, fresh, rng
        self.theta, self.log_true = _worth_learning(drawn, fresh, known)
        self.kriged = _kriged(drawn, self.theta, self.log_true, fresh.shares)
        self.around = drawn.around(AROUND, rng)
        self.log_learnt = self._log_density(self.kriged, self.around)
        of_mixture = self.log_learnt - self.around.log_mixture
        self.weights = np.exp(of_mixture - of_mixture.max())
        self.weights /= self.weights.sum()
        self.covered = drawn.covers(self.around.theta)

    @property
    def correction(self) -> Correction:
        """Correction from q to q′."""
        return Correction.between(self._compared(self.around.theta), self.around.shares, self.weights)

    def stored(self, limits: Limits) -> StoredRuns:
        """Compare the runs with q′ where it is covered by points for model runs, and with q elsewhere."""
        foretold = self.log_true - self.kriged.kriging.leave_one_out_residuals[:, 0]
        covered = self.drawn.covers(self.theta)
        log_drawn = np.where(covered, foretold, self.drawn.log_density(self.theta) + self.fresh.middle)
        # Runs that are neither covered nor in q's support are treated as excluded.
        near = (self.log_true >= self.log_true.max() - limits.reach) & np.isfinite(log_drawn)
        return StoredRuns(self.log_true[near], log_drawn[near])

    @property
    def doubts(self) -> tuple[str, ...]:
        """Report a large probability of q′ in regions where no fresh draw can assess it."""
        beyond = float(self.weights[~self.covered].sum())
        if beyond <= BEYOND:
            return ()
        return (
            f"according to the model runs, {beyond:.0%} of the posterior lies beyond the draws, where no run has checked it: the "
            "draws end where the posterior is still high",
        )

    def judging(self) -> FreshDraws:
        """Assess q′ by the fresh draws."""
        fresh, count = self.fresh, len(self.fresh.theta)
        rows = self.rng.choice(len(self.weights), size=len(self.drawn.population), p=self.weights)
        some, compared = rows[:COMPARED], self._compared(self.around.theta)
        log_drawn, differences = np.empty(count), list[DensityDifference]()
        for fold in range(FOLDS):
            places = np.arange(fold, count, FOLDS)
            left = self.kriged.without(len(self.kriged.phi) - count + places)  # the fresh runs come last
            gap = self._log_density(left, self.around[some]) - self.log_learnt[some]
            scale, apart = density_difference(gap, compared[some])
            differences.append(apart)
            log_drawn[places] = self._log_density(left, self.judges[places]) - scale
        log_correction = self._log_density(self.kriged, self.judges) - fresh.log_drawn  # log q′/q, up to a constant
        return replace(
            fresh,
            log_drawn=log_drawn,
            shares=fresh.shares * np.exp(log_correction - log_correction.max()),
            population=compared[rows],
            highest=fresh.highest + fresh.middle,
            difference=DensityDifference.average(differences),
        )

    def worth_teaching(self, count: int) -> Float[np.ndarray, "point parameter"]:
        """Choose the most informative points for model runs, where q′ is high and the Kriging uncertain."""
        theta, weights = self.around.theta[self.covered], self.weights[self.covered]
        phi = self.drawn.bijection.inverse(theta)
        places: list[int] = []
        kriged = self.kriged
        for _ in range(count if len(theta) else 0):
            mean, deviation = kriged.at(phi)
            # Contribution of a wrong weight to χ², E (w − 1)² = e^(σ²) − 1 of a log-normal w.
            places.append(int(np.argmax(weights * np.expm1(np.minimum(deviation, MOST_UNSURE) ** 2))))
            kriged = kriged.believing(phi[places[-1:]], mean[places[-1:]])
        return np.asarray(theta[places])

    def _compared(self, theta: np.ndarray) -> np.ndarray:
        return self.drawn.posterior.compared(theta)

    def _log_density(self, kriged: KrigedDensity, points: Chosen) -> np.ndarray:
        """Log q′ with respect to θ: the Kriging where it is certain, q with longer tails where nothing was learnt."""
        phi = self.drawn.bijection.inverse(points.theta)
        mean, deviation = kriged.at(phi)
        trust = np.exp(-((deviation / SURE) ** 2))
        untaught = np.logaddexp(points.log_drawn, np.log(TAILS) + points.log_wide) + self.fresh.middle
        return np.asarray(untaught + trust * (mean - self.drawn.bijection(phi)[1] - untaught))


def _worth_learning(drawn: DrawnDensity, fresh: FreshDraws, known: Points) -> Points:
    """Return the known runs that are not too far below the best, followed by the fresh runs."""
    theta, log_true = known
    with np.errstate(invalid="ignore", divide="ignore"):
        inside = np.isfinite(drawn.bijection.inverse(theta)).all(axis=1) & np.isfinite(log_true)
    near = inside & (log_true >= fresh.log_true.max() - DEEPEST)
    theta, first = np.unique(theta[near], axis=0, return_index=True)
    return joined((theta, log_true[near][first]), (fresh.theta, fresh.log_true))


def _kriged(drawn: DrawnDensity, theta: np.ndarray, log_true: np.ndarray, shares: np.ndarray) -> KrigedDensity:
    """Fit log π with respect to φ, in the form with the smallest errors at the fresh runs, which come last."""
    phi = drawn.bijection.inverse(theta)
    charts = [in_parameters(drawn.bijection, drawn.flat), standardised_by(drawn.phi), normal_by(drawn.fitted)]
    forms = [(chart, correlation) for chart in charts for correlation in CORRELATIONS]
    counts = np.concatenate([np.zeros(len(theta) - len(shares)), shares])
    return KrigedDensity.best(forms, phi, log_true + drawn.bijection(phi)[1], counts)
