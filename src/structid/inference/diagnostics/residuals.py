"""Whitened residuals of a fit, tests of their whiteness, tails and size, and warnings if the error model does not describe them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy
from jaxtyping import Bool, Float

from structid.inference.convergence import autocovariance, lagged_products
from structid.inference.error_models.base import ErrorModel
from structid.inference.likelihood.posterior import Posterior

LARGEST_CORRELATION = 0.2
"""Autocorrelation of a whitened residual above which the error model is considered wrong."""
WHITE_BOUND = 5.0
"""Limit for short histories, in standard deviations 1/√T of white noise's autocorrelation; the larger limit applies."""
SHARE_OF_LAGS = 0.1
"""Largest examined lag, as a fraction of the history."""
FEWEST_PAIRS = 100
"""Number of pairs of measured values below which an autocorrelation is shrunk towards 0."""
UNEVEN = 3.0
"""Ratio of a spectral peak to white noise above which it is reported; peaks of white noise reach 2.4."""
LARGEST_KURTOSIS = 2.0
"""Excess kurtosis of a residual's normal scores above which its tails are considered heavy: that of Student's t with ν = 7."""
MOST_GROWTH = 1.5
"""Ratio of the residual's variance at large and at small responses above which its size is considered uneven."""
LARGE, SMALL = 0.75, 0.5
"""Quantiles of the absolute response above which it is large, and below which it is small."""
SURE, LIKELY = 5.0, 3.0
"""Standard deviations, under the error model, of a statistic that contradicts it, and of one that gives a reason to try another."""
OF_TAILS = {
    "iid": "; use the error model student or contaminated",
    "student": "; use the error model contaminated",
    "contaminated": "; use the error model student",
}
"""What to do about heavy tails under an error model, if another one may have them."""
WHITE_PROBABILITY = 0.05
"""Probability with which white noise is not accepted as white."""
MUCH_WIDER = 1.5
"""Ratio of the robust to the posterior standard deviation above which a warning is given."""


@dataclass(frozen=True, eq=False)
class WhitenedResidual:
    """Residual of one channel, mapped to values that are independent and N(0, 1) if model and error model hold.

    For normal errors they are L⁻¹ (y − M(θ)), with L Lᵀ the covariance of ε.
    """

    channel: str  # measured channel
    record: str  # name of the record
    dt: float  # time step [s]
    values: Float[np.ndarray, " time"] = field(repr=False)  # residual, dimensionless; 0 for a missing value
    observation: int = 0  # index of the observation
    known: Bool[np.ndarray, " time"] | None = field(
        default=None, repr=False
    )  # mask of the measured values; None for all
    response: Float[np.ndarray, " time"] | None = field(default=None, repr=False)  # the model's readings, in SI

    @cached_property
    def _all_known(self) -> bool:
        return self.known is None or bool(self.known.all())

    @property
    def autocorrelation(self) -> np.ndarray:
        """Autocorrelation at the lags 0, 1, … up to a tenth of the history, shape (lag,)."""
        count = max(int(SHARE_OF_LAGS * len(self.values)), 2)
        if self._all_known:
            covariance = autocovariance(self.values[:, None])[:count, 0]
            return np.asarray(covariance / covariance[0])
        # Means over the pairs of measured values; a lag with few pairs is shrunk towards 0.
        assert self.known is not None
        centred = np.where(self.known, self.values - self.values[self.known].mean(), 0.0)
        products, pairs = lagged_products(np.stack([centred, self.known.astype(float)], axis=1))[:count].T
        enough = np.maximum(np.rint(pairs), FEWEST_PAIRS)
        return np.asarray(products / enough * pairs[0] / products[0])

    @property
    def spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies [Hz] and power relative to white noise (Welch), both of shape (frequency,)."""
        segment = min(len(self.values), max(len(self.values) // 8, 64))
        frequency, power = scipy.signal.welch(self.values, 1.0 / self.dt, nperseg=segment)
        return frequency[1:], power[1:] / (2.0 * self.dt * self.values.var())

    @property
    def bound(self) -> float:
        """Autocorrelation above which the residual is considered correlated."""
        samples = len(self.values) if self.known is None else np.count_nonzero(self.known)
        return float(max(LARGEST_CORRELATION, WHITE_BOUND / np.sqrt(samples)))

    @property
    def largest(self) -> tuple[float, float]:
        """The autocorrelation of largest magnitude, and its lag [s]."""
        correlation = self.autocorrelation
        lag = 1 + int(np.argmax(np.abs(correlation[1:])))
        return float(correlation[lag]), lag * self.dt

    @property
    def peak(self) -> tuple[float, float]:
        """Frequency [Hz] of the spectral peak, and the ratio of its power to white noise."""
        frequency, power = self.spectrum
        index = int(np.argmax(power))
        return float(frequency[index]), float(power[index])

    @property
    def correlated(self) -> bool:
        """Whether the values are correlated in time, against the error model."""
        return abs(self.largest[0]) > self.bound

    @cached_property
    def _known_values(self) -> Float[np.ndarray, " value"]:
        return self.values if self.known is None else self.values[self.known]

    @property
    def is_white(self) -> bool:
        """Whether the cumulative periodogram is that of white noise (M. S. Bartlett 1955; Kolmogorov's test)."""
        power = np.abs(np.fft.rfft(self.values - self._known_values.mean())[1:-1]) ** 2
        if self.correlated or not power.any():
            return False
        cumulated = np.cumsum(power) / power.sum()
        farthest = np.abs(cumulated - np.arange(1, len(power) + 1) / len(power)).max()
        return bool(scipy.stats.kstwobign.sf(farthest * np.sqrt(len(power))) > WHITE_PROBABILITY)

    @cached_property
    def excess_kurtosis(self) -> float:
        """Excess kurtosis, 0 for a normal distribution."""
        return float(scipy.stats.kurtosis(self._known_values)) if self._known_values.any() else 0.0

    def _tails_beyond(self, errors: float) -> bool:
        return bool(self.excess_kurtosis > errors * np.sqrt(24.0 / len(self._known_values)))

    @property
    def heavy_tailed(self) -> bool:
        """Whether large values are more frequent than those of the error model."""
        return self.excess_kurtosis > LARGEST_KURTOSIS and self._tails_beyond(SURE)

    @cached_property
    def _growing(self) -> tuple[float, float]:
        """Rank correlation of |value| and |response| in standard errors, and ratio of variances at large and small responses."""
        size = (
            None
            if self.response is None
            else np.abs(self.response if self.known is None else self.response[self.known])
        )
        if size is None or not size.any() or np.ptp(size) == 0.0:
            return 0.0, 1.0
        values = np.abs(self._known_values)
        correlation = scipy.stats.spearmanr(values, size).statistic
        small, large = np.quantile(size, (SMALL, LARGE))
        ratio = np.mean(values[size >= large] ** 2) / max(np.mean(values[size <= small] ** 2), np.finfo(float).tiny)
        return float(correlation * np.sqrt(len(values) - 1)), float(ratio)

    @property
    def growth(self) -> float:
        """Ratio of the variance at the largest quarter of the responses to that at the smallest half; 1 for even errors."""
        return self._growing[1]

    @property
    def uneven(self) -> bool:
        """Whether the values grow with the response, against the error model."""
        return self._growing[0] > SURE and self.growth > MOST_GROWTH

    @property
    def may_be_heavy_tailed(self) -> bool:
        """Whether an error model with heavy tails deserves a trial."""
        return self._tails_beyond(LIKELY)

    @property
    def may_be_uneven(self) -> bool:
        """Whether an error model that grows with the response deserves a trial."""
        return self._growing[0] > LIKELY

    @property
    def as_assumed(self) -> bool:
        """Whether nothing contradicts the error model."""
        return not (self.correlated or self.heavy_tailed or self.uneven)


def whitened_residuals(posterior: Posterior, theta: Float[np.ndarray, " parameter"]) -> tuple[WhitenedResidual, ...]:
    """Whiten the residuals of a prediction."""
    residuals = []
    for index, observation in enumerate(posterior.observations):
        response = posterior.predict(theta[None], index).transpose(1, 2, 0)
        white = posterior.likelihood.of[index].normal_scores(response, posterior.unknowns(theta[None], index))[:, :, 0]
        residuals += [
            WhitenedResidual(
                channel,
                observation.record.name,
                observation.step,
                white[:, i],
                index,
                observation.is_measured[:, i],
                response[:, i, 0],
            )
            for i, channel in enumerate(observation.channels)
            if np.isfinite(white[:, i]).all()
        ]
    return tuple(residuals)


def residual_warnings(
    residuals: tuple[WhitenedResidual, ...], error_model: ErrorModel, too_small_by: Mapping[str, float] | None
) -> list[str]:
    """Warnings about residuals that the error model does not describe."""
    added = error_model.added
    assumed = "independent errors" if added.independent else f"the error model {added.describe()['kind']}"
    if error_model.inside:
        assumed += f" with {error_model.describe()['kind']} parameters"
    worst = max(too_small_by, key=lambda name: too_small_by[name]) if too_small_by else None
    effect = ""
    if too_small_by and worst and too_small_by[worst] > MUCH_WIDER:
        effect = f"; the sd of {worst} is about {too_small_by[worst]:.2g} times too small (see robust_sd)"
    sentences = []
    if correlated := [_correlation_in_words(residual) for residual in residuals if residual.correlated]:
        cure = "; use a correlated error model, such as damped_cosine" if added.independent else ""
        said = f"after whitening, the residuals are still correlated, which contradicts {assumed}"
        sentences.append(f"{said}: {', '.join(correlated)}{effect}{cure}")
    if heavy := [_tails_in_words(residual) for residual in residuals if residual.heavy_tailed]:
        cure = OF_TAILS.get(str(added.describe()["kind"]), "")
        said = f"the residuals have more large values than {assumed} {'have' if added.independent else 'has'}"
        sentences.append(f"{said}: {', '.join(heavy)}{effect}{cure}")
    if uneven := [_growth_in_words(residual) for residual in residuals if residual.uneven]:
        cure = "; use the error model proportional" if added.independent else ""
        said = f"the residuals grow with the response, which contradicts {assumed}"
        sentences.append(f"{said}: {', '.join(uneven)}{effect}{cure}")
    return sentences


def _tails_in_words(residual: WhitenedResidual) -> str:
    return f"{residual.channel} on {residual.record} has an excess kurtosis of {residual.excess_kurtosis:.2g} (expected: 0)"


def _growth_in_words(residual: WhitenedResidual) -> str:
    where = f"{residual.channel} on {residual.record}"
    return f"the variance of {where} at large responses is {residual.growth:.2g} times that at small ones"


def _correlation_in_words(residual: WhitenedResidual) -> str:
    value, lag = residual.largest
    return (
        f"{residual.channel} on {residual.record} by {value:.2f} at a lag of {lag:.3g} s "
        f"(expected: within ±{residual.bound:.2f})"
    )
