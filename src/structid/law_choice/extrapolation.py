"""How far a fitted law can be believed beyond its data: rolling-origin predictions of the later half-cycles.

A law that is fitted to the first half-cycles of a test predicts the next ones (Tashman 2000). Its errors there show how the error
of the force grows with the largest and the cumulative displacement, and which laws predict best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.optimize
import scipy.special
import scipy.stats
from jaxtyping import Float

from structid.core.errors import ConvergenceError
from structid.core.streams import Purpose, stream
from structid.law_choice.cycles import cumulative_displacement
from structid.law_choice.cyclic_test import CyclicTest
from structid.law_choice.law_fit import LawFit

ORIGINS = (0.4, 0.55)
"""Shares of the half-cycles from which the rest of the first part is predicted."""
GROWTH = 1.0
"""Median of the prior of a growth coefficient: the error doubles where the largest displacement is e times that of the data."""
GROWTH_SD = 1.0
"""Standard deviation of its logarithm. It also describes what the growth in one part of a test tells of the next."""
SPREAD_DRAWS = 40
"""Number of runs that show the spread from the parameters' posterior."""
RESAMPLES = 500
"""Number of weights of the half-cycles in the Bayesian bootstrap."""
TO_ALL, TO_FIRST_PART = -1, -2
"""Positions of the fits to all half-cycles and to the first part."""


def distance_beyond(
    displacement: Float[np.ndarray, " time"], known: Float[np.ndarray, " known_time"]
) -> Float[np.ndarray, "time 2"]:
    """Return ln(a/a₀) and ln(w/w₀), with the largest and the cumulative displacement so far, a and w; zero within the data."""
    amplitude, cumulative = np.maximum.accumulate(np.abs(displacement)), cumulative_displacement(displacement)
    largest, whole = np.abs(known).max(), max(cumulative_displacement(known)[-1], np.finfo(float).tiny)
    ratios = np.stack([amplitude / largest, cumulative / whole], axis=1)
    return np.asarray(np.log(np.maximum(ratios, 1.0)))


@dataclass(frozen=True, eq=False)
class Trial:
    """A prediction of later half-cycles, compared with the measurement."""

    distance: Float[np.ndarray, "time 2"]  # beyond the data of the fit
    error: Float[np.ndarray, " time"]  # over the fit's standard deviation of the errors
    spread: Float[np.ndarray, " time"]  # standard deviation from the parameters, in the same unit
    ends: list[int]  # ends of the half-cycles
    sd: float  # the fit's standard deviation of the errors [N]

    @property
    def independent_values(self) -> float:
        """Number of independent errors, n (1 − ρ)/(1 + ρ) with the correlation of neighbours; at least one in a half-cycle."""
        first, second = self.error[:-1], self.error[1:]
        size = float(np.sqrt((first @ first) * (second @ second)))
        rho = max(0.0, float(first @ second) / size) if size > 0.0 else 0.0
        return max(len(self.error) * (1.0 - rho) / (1.0 + rho), len(self.ends) + 1.0)

    def sd_along(self, growth: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " time"]:
        """Standard deviation of the error of the model and of the noise."""
        return np.asarray(1.0 + self.distance @ growth)

    def score(self, growth: Float[np.ndarray, " 2"]) -> list[float]:
        """Mean log density of the measurement in every half-cycle."""
        sd = np.hypot(self.sd_along(growth), self.spread)
        density = scipy.stats.norm.logpdf(self.error, 0.0, sd) - np.log(self.sd)
        return [float(part.mean()) for part in np.split(density, self.ends) if len(part)]


@dataclass(frozen=True, eq=False)
class LawOnParts:
    """One law, with one error model, fitted to longer and longer parts of a test.

    Parameters
    ----------
    test : CyclicTest
        The whole test.
    fits : tuple of LawFit
        Fits to parts of increasing length; the last but one is to the first 70 % of the half-cycles, the last to all.
    sampled : dict of int to ndarray, shape (draw, parameter)
        Draws of the law's parameters from the posterior of some fits, by `TO_ALL` and `TO_FIRST_PART` [SI]. The draws of the
        other fits come from a normal approximation.
    """

    test: CyclicTest
    fits: tuple[LawFit, ...]
    sampled: Mapping[int, np.ndarray] = field(repr=False, default_factory=dict)

    @property
    def word(self) -> str:
        """Name of the law."""
        return self.fits[-1].law.word

    @cached_property
    def _forces(self) -> list[tuple[Float[np.ndarray, " time"], Float[np.ndarray, "draw time"]]]:
        """Force of the best parameters along the whole test, and forces of draws, for every fit."""
        rng = stream(0, Purpose.HYSTERETIC_LAW)
        return [self._forces_along(self.test, place - len(self.fits), rng) for place in range(len(self.fits))]

    def _forces_along(
        self, along: CyclicTest, place: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, "draw time"]]:
        """Force of the best parameters of one fit along a path, and forces of draws."""
        fit = self.fits[place]
        if place in self.sampled:
            draws = rng.permutation(self.sampled[place])[:SPREAD_DRAWS]
        else:
            draws = fit.normal_draws(SPREAD_DRAWS, rng)
        return fit.force(along), fit.forces(draws, along)

    def samples(self, place: int) -> int:
        """Return the number of samples to which one fit was made."""
        return len(self.fits[place].test.scales)

    def sd(self, place: int) -> float:
        """Return the standard deviation of the errors of one fit, at its own data [N]."""
        error = (self.test.force - self._forces[place][0])[: self.samples(place)]
        return float(np.sqrt(np.mean(error**2)))

    def trials(self, last: int) -> list[Trial]:
        """Return the predictions by all earlier fits, up to the end of one fit's data."""
        end, trials = self.samples(last), []
        for place in range(len(self.fits[:last])):
            start, sd, (force, draws) = self.samples(place), self.sd(place), self._forces[place]
            part = slice(start, end)
            turns = self.test.turns[(self.test.turns > start) & (self.test.turns < end)] - start
            distance = distance_beyond(self.test.displacement[:end], self.test.displacement[:start])[part]
            spread = draws[:, part].std(axis=0) if len(draws) else np.zeros(end - start)
            error = (self.test.force - force)[part] / sd
            trials.append(Trial(distance, error, spread / sd, list(turns), sd))
        return trials

    def growth(self, last: int) -> Float[np.ndarray, " 2"]:
        """Return the growth of the error with both distances, from the predictions up to the end of one fit's data."""
        trials = [t for t in self.trials(last) if np.isfinite(t.error).all() and len(t.error)]
        return fitted_growth(trials, self.fits[last].leaves_noise)

    def scores(self, last: int) -> list[float]:
        """Return the mean log density of every half-cycle that an earlier fit predicts."""
        growth = self.growth(last)
        return [score for trial in self.trials(last) for score in trial.score(growth)]

    def draws(
        self, last: int, along: CyclicTest, count: int, rng: np.random.Generator
    ) -> Float[np.ndarray, "draw time"]:
        """Return forces that one fit predicts along a path, with the errors of the model [N]."""
        force, draws = self._forces[last] if along is self.test else self._forces_along(along, last, rng)
        forces = draws if len(draws) else force[None]
        if not np.isfinite(forces).all():
            raise ConvergenceError(f"The runs of the law {self.word} fail along the path. Check its displacements.")
        growth = self.growth(last) * np.exp(GROWTH_SD * _stratified_normal(count, 2, rng))
        distance = distance_beyond(along.displacement, self.test.displacement[: self.samples(last)])
        sd = self.sd(last) * (1.0 + growth @ distance.T)
        # The error of a law is nearly the same in all samples of a half-cycle.
        half_cycles = np.searchsorted(along.turns, np.arange(len(along.displacement)), side="right")
        error = _stratified_normal(count, int(half_cycles[-1]) + 1, rng)[:, half_cycles]
        return np.asarray(forces[rng.integers(0, len(forces), count)] + sd * error)


def fitted_growth(trials: Sequence[Trial], parameters_count: bool) -> Float[np.ndarray, " 2"]:
    """Return the growth c of the error with both distances that predictions of later half-cycles show.

    sd = s (1 + c_a ln(a/a₀) + c_w ln(w/w₀))

    If `parameters_count`, uncertain parameters explain a part of the predictions' errors, with their own variance. They do so for a
    law that leaves only noise. A law with an error of its own predicts badly with every value of its parameters.
    """

    def cost(log_growth: np.ndarray) -> float:
        value = 0.5 * float(np.sum((log_growth - np.log(GROWTH)) ** 2)) / GROWTH_SD**2
        for trial in trials:
            sd = np.hypot(trial.sd_along(np.exp(log_growth)), trial.spread if parameters_count else 0.0)
            value += trial.independent_values * float(np.mean(np.log(sd) + 0.5 * (trial.error / sd) ** 2))
        return value

    return np.asarray(np.exp(scipy.optimize.minimize(cost, np.full(2, np.log(GROWTH)), method="Nelder-Mead").x))


def _stratified_normal(count: int, columns: int, rng: np.random.Generator) -> Float[np.ndarray, "draw column"]:
    """Return standard-normal numbers, each column with one from every part of equal probability.

    Bands and means of a thousand independent draws would differ by 4 % from seed to seed.
    """
    parts = rng.permuted(np.tile(np.arange(count), (columns, 1)), axis=1).T
    return np.asarray(scipy.special.ndtri((parts + rng.random((count, columns))) / count))


def weights_by_prediction(laws: Sequence[LawOnParts], last: int) -> Float[np.ndarray, " law"]:
    """Return weights by the predictions of later half-cycles: pseudo-BMA with the Bayesian bootstrap (Yao et al. 2018).

    The samples of a half-cycle have nearly the same error, so a half-cycle counts as one value.
    """
    scores = np.array([law.scores(last) for law in laws])
    if not scores.size:
        return np.full(len(laws), 1.0 / len(laws))
    scores = np.where(np.isfinite(scores), scores, -np.inf).clip(-1e6)
    count = scores.shape[1]
    shares = count * stream(0, Purpose.HYSTERETIC_LAW).dirichlet(np.ones(count), RESAMPLES)
    totals = shares @ scores.T
    weights = np.exp(totals - totals.max(axis=1, keepdims=True))
    return np.asarray((weights / weights.sum(axis=1, keepdims=True)).mean(axis=0))


@dataclass(frozen=True, eq=False)
class CyclicPrediction:
    """Predicted force along a path, averaged over the laws.

    Parameters
    ----------
    test : CyclicTest
        The path; its force is measured, or zero.
    start : int
        First predicted sample.
    draws : ndarray, shape (draw, time)
        Draws of the force, with the error of the model [N].
    """

    test: CyclicTest
    start: int
    draws: np.ndarray

    @cached_property
    def mean(self) -> Float[np.ndarray, " time"]:
        """Mean of the predicted force [N]."""
        return np.asarray(self.draws.mean(axis=0))

    def band(self, level: float = 0.9) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, " time"]]:
        """Return the bounds between which the force lies with a given probability, sample by sample [N]."""
        low, high = np.quantile(self.draws, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
        return low, high

    @property
    def largest_forces(self) -> Float[np.ndarray, " draw"]:
        """Largest absolute force of every draw, from the first predicted sample on [N]."""
        return np.asarray(np.abs(self.draws[:, self.start :]).max(axis=1))

    @property
    def energies(self) -> Float[np.ndarray, " draw"]:
        """Dissipated energy ∫ f du of every draw, from the first predicted sample on [J]."""
        return np.asarray(np.trapezoid(self.draws[:, self.start :], self.test.displacement[self.start :], axis=1))

    @property
    def coverage(self) -> float:
        """Part of the measured samples, from the first predicted one on, that the 90 % band holds."""
        low, high = (edge[self.start :] for edge in self.band())
        force = self.test.force[self.start :]
        return float(np.mean((force >= low) & (force <= high)))


def average_prediction(
    laws: Sequence[LawOnParts],
    weights: Float[np.ndarray, " law"],
    last: int,
    along: CyclicTest,
    count: int,
    rng: np.random.Generator,
) -> CyclicPrediction:
    """Return draws of the force along a path, from every law as many as its weight asks for; laws that fail there have none."""
    counts, draws = rng.multinomial(count, weights / weights.sum()), []
    for law, number in zip(laws, counts, strict=True):
        with suppress(ConvergenceError):
            if number:
                draws.append(law.draws(last, along, int(number), rng))
    if not draws:
        raise ConvergenceError("The runs of every law fail along the path. Check its displacements.")
    # Another path is predicted from its first sample on.
    start = laws[0].samples(last) if along is laws[0].test else 0
    return CyclicPrediction(along, start, np.concatenate(draws))
