"""Scale factors for prediction bands on another record, from their coverage on the measured record.

A wrong model's error enters its predictions twice: as added errors, and as parameters that drift differently. A prediction
of the measured record as if it were another record shows their combined width (conformal prediction: J. Lei et al. 2018, doi
10.1080/01621459.2017.1307116).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from structid.inference.convergence import autocorrelation_time
from structid.inference.prediction.error_growth import running_power
from structid.inference.prediction.over_draws import median, quantiles

PROBABILITY = 0.9
"""Probability of the compared bands."""
LEVELS = np.array([-5.5, -4.5, -3.5, -2.5, -1.5, -0.5])
"""Centres of the decades of the response's running power, log₁₀ relative to its maximum; each has its own factor."""
LIMITS = (0.02, 4.0)
"""Smallest and largest factor; one record supports no larger correction."""
FEWEST = 50
"""Minimum number of samples for a decade to have its own factor."""
ROUNDS = 6
"""Number of iterations for the factors, which interact because the scale is interpolated between the decades."""


@dataclass(frozen=True, eq=False)
class Rounding:
    """Rounding of readings to a grid. Random values within the steps undo it, so that a factor on a band has an effect."""

    steps: Float[np.ndarray, " channel"]  # 0 if a channel is not rounded
    rng: np.random.Generator = field(repr=False)

    def undone(self, readings: np.ndarray) -> np.ndarray:
        """Readings (…, channel) with a uniform random value within a step added to each."""
        return readings + self.steps * self.rng.uniform(-0.5, 0.5, readings.shape) if self.steps.any() else readings

    def done(self, readings: np.ndarray) -> np.ndarray:
        """Readings (…, channel) rounded to the grid."""
        for channel in np.flatnonzero(self.steps):
            step = self.steps[channel]
            readings[..., channel] = step * np.round(readings[..., channel] / step)
        return readings


@dataclass(frozen=True, eq=False)
class BandScale:
    """λ(t), the factor on the deviation of draws from their median, as a function of the response's running power."""

    factors: Float[np.ndarray, "level channel"]  # λ at `LEVELS`; log λ is linear between levels, constant beyond them

    @classmethod
    def of(
        cls, measured: Float[np.ndarray, "time channel"], draws: Float[np.ndarray, "draw time channel"], dt: float
    ) -> BandScale:
        """Find the factors that give a band of draws its nominal coverage of the measured values."""
        tail = 0.5 * (1.0 - PROBABILITY)
        low, middle, high = quantiles(draws, [tail, 0.5, 1.0 - tail])
        half_width = np.where(measured > middle, high - middle, middle - low)
        power = _relative_power(middle, dt)
        factors = np.ones((len(LEVELS), measured.shape[1]))
        for channel in np.flatnonzero((half_width > 0.0).all(axis=0)):
            known = np.isfinite(measured[:, channel])
            away = (np.abs(measured - middle)[:, channel] / half_width[:, channel])[known]
            factors[:, channel] = _factors(away, power[known, channel])
        return cls(factors)

    def applied(
        self,
        draws: Float[np.ndarray, "draw time channel"],
        dt: float,
        least: Float[np.ndarray, "time channel"] | None = None,
    ) -> np.ndarray:
        """Scale the deviation of draws from their median, to no less than a smallest standard deviation."""
        if not len(draws):
            return draws
        middle = median(draws)
        power = _relative_power(middle, dt)
        scale = np.stack(
            [_between(power[:, i], factors_of_channel) for i, factors_of_channel in enumerate(self.factors.T)], axis=1
        )
        if least is not None:
            spread = draws.std(axis=0)
            # Draws that vary less than this are not made wider.
            scale = np.maximum(scale, np.minimum(least / np.where(spread > 0.0, spread, 1.0), 1.0))
        scaled = draws - middle
        scaled *= scale
        scaled += middle
        return np.asarray(scaled)


def _relative_power(median: np.ndarray, dt: float) -> np.ndarray:
    """Log₁₀ of the running power relative to its maximum, shape (time, channel)."""
    power = running_power(median, dt)
    largest = np.maximum(power.max(axis=0), np.finfo(np.float64).tiny)
    return np.asarray(np.log10(np.maximum(power / largest, 1e-12)))


def _between(power: np.ndarray, factors: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(np.interp(power, LEVELS, np.log(factors))))


def _factors(away: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Factors of one channel, from the distances of measured values to the median, in half-widths of the band."""
    decade = np.clip(np.round(power - LEVELS[0]).astype(int), 0, len(LEVELS) - 1)
    populated = [level for level in range(len(LEVELS)) if np.count_nonzero(decade == level) >= FEWEST]
    if not populated:
        return np.ones(len(LEVELS))
    # A decade with few samples uses the factor of the nearest decade with many.
    nearest = np.array([min(populated, key=lambda other: abs(other - level)) for level in range(len(LEVELS))])
    factors = np.ones(len(LEVELS))
    for _ in range(ROUNDS):
        left = away / _between(power, factors)
        result = np.array(
            [_enough(left[nearest[decade] == level]) if level in populated else 1.0 for level in range(len(LEVELS))]
        )
        factors = np.clip(factors * result[nearest], *LIMITS)
    return factors


def _enough(away: np.ndarray) -> float:
    """Half-widths that cover a next value with probability p: the p (n + 1)/n quantile, n the effective size."""
    outside = (away > np.quantile(away, PROBABILITY)).astype(np.float64)
    count = len(away) / autocorrelation_time(outside[None]) if outside.any() else 1.0
    return float(np.quantile(away, min(PROBABILITY * (count + 1.0) / count, 1.0)))
