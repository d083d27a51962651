"""How far bands of another record must be narrowed or widened, by what they would have held of the measured one.

A wrong model's error is in its predictions twice: as errors that are added, and as parameters that drift in another way. The
measured record, predicted as if it were another one, shows how wide the two are together (conformal prediction: J. Lei et al. 2018,
doi 10.1080/01621459.2017.1307116).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.inference.assessment.diagnostics import autocorrelation_time
from structid.inference.assessment.error_growth import running_power

PROBABILITY = 0.9
"""Of the bands that are compared."""
STRONG = 0.1
"""Share of the largest running power from which on the motion is strong."""
LIMITS = (0.25, 4.0)
"""Of the factors: one record is not proof of more."""
ROUNDS = 6
"""In which the factors of both parts, which meet in between, are found."""


@dataclass(frozen=True, eq=False)
class BandScale:
    """λ(t), by which draws are moved away from their median: λ_quiet^(1 − w) λ_strong^w with w = p/(p + 0.1 max p).

    p is the running power of the motion.

    Parameters
    ----------
    strong, quiet : ndarray, shape (channel,)
        λ in the strong and in the quiet part.
    """

    strong: np.ndarray
    quiet: np.ndarray

    @classmethod
    def of(cls, measured: np.ndarray, draws: np.ndarray, dt: float) -> BandScale:
        """Find the factors with which a band of draws would have held the measured values as often as it says.

        Parameters
        ----------
        measured : ndarray, shape (time, channel)
            In SI.
        draws : ndarray, shape (draw, time, channel)
            Predictions of them, made as for another record.
        dt : float
            Time step [s].

        Returns
        -------
        BandScale
            Ones for a channel that does not move.
        """
        strong, quiet = np.ones(measured.shape[1]), np.ones(measured.shape[1])
        for channel in range(measured.shape[1]):
            away, weight, is_strong = _in_half_widths(measured[:, channel], draws[:, :, channel], dt)
            if away is None:
                continue
            for _ in range(ROUNDS):
                left = away / _blended(strong[channel], quiet[channel], weight)
                for part, factors in ((is_strong, strong), (~is_strong, quiet)):
                    if part.any():
                        factors[channel] = np.clip(factors[channel] * _enough(left[part]), *LIMITS)
        return cls(strong, quiet)

    def applied(self, draws: np.ndarray, dt: float) -> np.ndarray:
        """Move draws away from their median, or towards it.

        Parameters
        ----------
        draws : ndarray, shape (draw, time, channel)
            In SI.
        dt : float
            Time step [s].

        Returns
        -------
        ndarray
            In the same shape.
        """
        if not len(draws):
            return draws
        median = np.median(draws, axis=0)
        return np.asarray(median + _blended(self.strong, self.quiet, _weight(median, dt)) * (draws - median))


def _blended(strong: np.ndarray, quiet: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return np.asarray(quiet ** (1.0 - weight) * strong**weight)


def _weight(median: np.ndarray, dt: float) -> np.ndarray:
    """Weights w = p/(p + 0.1 max p), shape (time, channel)."""
    power = running_power(median, dt)
    return np.asarray(power / np.maximum(power + STRONG * power.max(axis=0), np.finfo(np.float64).tiny))


def _in_half_widths(
    measured: np.ndarray, draws: np.ndarray, dt: float
) -> tuple[np.ndarray | None, np.ndarray, np.ndarray]:
    """Distance of the measured values from the median in half-widths of the band, w, and where the motion is strong."""
    tail = 0.5 * (1.0 - PROBABILITY)
    low, median, high = np.quantile(draws, [tail, 0.5, 1.0 - tail], axis=0)
    weight = _weight(median[:, None], dt)[:, 0]
    half_width = np.where(measured > median, high - median, median - low)
    if not (half_width > 0.0).all():
        return None, weight, weight > 0.5
    return np.abs(measured - median) / half_width, weight, weight > 0.5


def _enough(away: np.ndarray) -> float:
    """The half-widths that hold 90 % of a next value: the ⌈(n + 1) p⌉-th of n independent ones, n of the correlated ones here."""
    outside = (away > np.quantile(away, PROBABILITY)).astype(np.float64)
    count = len(away) / autocorrelation_time(outside[None]) if outside.any() else 1.0
    return float(np.quantile(away, min(PROBABILITY * (count + 1.0) / count, 1.0)))
