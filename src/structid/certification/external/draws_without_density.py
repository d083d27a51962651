"""External draws whose density is known only at the draws, or not at all."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float

from structid.certification.external.drawn_density import Chosen, DrawnDensity, contradiction, of_fitted
from structid.certification.external.draws_with_density import WIDE_SHARE, DensityOfDraws
from structid.certification.external.fitted_density import FittedDensity
from structid.certification.external.scores_at_draws import Interpolation, interpolated
from structid.certification.external.stein_identity import SteinTest
from structid.certification.limits import Limits
from structid.certification.monte_carlo_error import MonteCarloError
from structid.core.errors import InputError
from structid.core.streams import Purpose, stream
from structid.inference.target import Target

CERTAIN = 0.3
"""Largest standard deviation of an interpolated log density that is used [nat]."""
FITTED_DRAWS = 20_000
"""Number of draws that represent a fitted density."""
PREDICTED = 0.9
"""Largest standard deviation of interpolation errors, relative to that of the values, of values that belong to the draws. Values in
another order reach 1.0."""
MOMENTS = 0.1
"""Error of a mean in standard deviations, or relative error of a standard deviation, above which a fitted density is rejected."""


class ValuesAtDraws(DrawnDensity):
    """External draws whose log density is known only at the draws."""

    subject = "for a density that is known only at the draws, if it has no mode far from them"

    def __init__(
        self, posterior: Target, draws: np.ndarray, values: Float[np.ndarray, "*chain draw"], rng: np.random.Generator
    ) -> None:
        super().__init__(posterior, draws)
        flat = np.asarray(values, dtype=np.float64).ravel()
        if flat.shape != (len(self.flat),) or not np.isfinite(flat).all():
            raise InputError(
                "certify(log_density)",
                f"an array of shape {np.shape(values)} with {int((~np.isfinite(flat)).sum())} values that are not finite",
                f"a finite log density for each of {len(self.flat)} draws, or a function",
            )
        self.at_draws = flat
        self.fitted = FittedDensity.of(self.phi, rng)

    @cached_property
    def interpolation(self) -> Interpolation:
        """Kriging surrogate of the log density between some draws."""
        return interpolated(self, stream(0, Purpose.INTERPOLATED_VALUES))

    def log_density(self, theta: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, " point"]:
        """Log density of the interpolation where it is certain, and of a density fitted to the draws elsewhere."""
        found = of_fitted(self.fitted, self, theta) + self._above_fitted
        inside = np.isfinite(found)
        if inside.any():
            phi = self.bijection.inverse(theta[inside])
            mean, deviation = self.interpolation.kriged.at(phi)
            mean = mean - self.bijection(phi)[1]
            certain = (deviation < CERTAIN) & (mean <= self.highest)
            found[inside] = np.where(certain, mean, found[inside])
        return found

    @cached_property
    def _above_fitted(self) -> float:
        """Median of the given minus the fitted log density at the draws, which are known up to a constant."""
        return float(np.median(self.at_draws - of_fitted(self.fitted, self, self.flat)))

    def chosen(self, count: int, rng: np.random.Generator) -> Chosen:
        """Draws alone; see `DrawnDensity.chosen`."""
        rows = self.distinct(count, rng)
        return Chosen(self.flat[rows], self.at_draws[rows], np.full(len(rows), -np.inf), self.at_draws[rows])

    def around(self, count: int, rng: np.random.Generator) -> Chosen:
        """Draws alone; see `DrawnDensity.around`."""
        return self.chosen(count, rng)

    def checked(
        self, known: Float[np.ndarray, "point parameter"], by_chance: MonteCarloError, limits: Limits, seed: int
    ) -> tuple[tuple[str, ...], MonteCarloError]:
        """Check by Stein's identity that the draws have the given density; see `DrawnDensity.checked`."""
        test = SteinTest.of(self, self.interpolation, by_chance, stream(seed, Purpose.INTERPOLATED_VALUES))
        if (test.contradicts(limits) or not self._belong_to_the_draws) and (error := contradiction(self)):
            raise error
        return test.doubts(limits, self.posterior.compared_names), test.added_to(by_chance)

    @property
    def _belong_to_the_draws(self) -> bool:
        """Whether interpolation between some draws predicts the values at the others at all."""
        others = np.setdiff1d(np.arange(len(self.phi)), self.interpolation.rows)
        values = self.at_draws[others] + self.bijection(self.phi[others])[1]
        error = values - self.interpolation.kriged.mean_at(self.phi[others])
        return bool(error.std() < PREDICTED * values.std())


class FittedToDraws(DensityOfDraws):
    """External draws without a known density: q is fitted to them."""

    subject = "for a density that was fitted to the draws"
    enough = 60

    def __init__(self, posterior: Target, draws: np.ndarray, rng: np.random.Generator) -> None:
        DrawnDensity.__init__(self, posterior, draws)
        self.fitted = FittedDensity.of(self.phi, rng)
        self.many = self.fitted.draw(FITTED_DRAWS, rng)
        self.at_draws = self.log_density(self.population)

    @property
    def _many(self) -> np.ndarray:
        return self.many

    @cached_property
    def population(self) -> np.ndarray:
        """Draws of the fitted density."""
        return np.asarray(self.bijection(self.many)[0])

    def log_density(self, theta: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, " point"]:
        """Log density; see `DrawnDensity.log_density`."""
        return of_fitted(self.fitted, self, theta)

    def chosen(self, count: int, rng: np.random.Generator) -> Chosen:
        """Choose points, two thirds of which are draws from the fitted density; see `DrawnDensity.chosen`."""
        wide_count = round(WIDE_SHARE * count)
        return self.beside_wider_ones(self.many[: count - wide_count], wide_count, self.many, rng)

    def checked(
        self, known: Float[np.ndarray, "point parameter"], by_chance: MonteCarloError, limits: Limits, seed: int
    ) -> tuple[tuple[str, ...], MonteCarloError]:
        """Compare the moments of the fitted density and of the draws; see `DrawnDensity.checked`."""
        given, many = self.posterior.compared(self.flat), self.posterior.compared(self.population)
        sd = given.std(axis=0)
        means = np.abs(many.mean(axis=0) - given.mean(axis=0)) / sd
        sds = np.abs(many.std(axis=0) / sd - 1.0)
        worst = int(np.argmax(np.maximum(means, sds)))
        if max(means[worst], sds[worst]) <= MOMENTS:
            return (), by_chance
        doubt = (
            "the density that was fitted to the draws does not have their moments: the mean of "
            f"{self.posterior.compared_names[worst]} differs by {means[worst]:.2g} standard deviations, its standard deviation "
            f"by {sds[worst]:.0%}; give the density itself"
        )
        return (doubt,), by_chance
