"""Whitened residuals of a fit, a test of their whiteness, and warnings if they are correlated."""

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
MUCH_WIDER = 1.5
"""Ratio of the robust to the posterior standard deviation above which a warning is given."""


@dataclass(frozen=True, eq=False)
class WhitenedResidual:
    """L⁻¹ (y − M(θ)) of one channel, L Lᵀ the covariance of ε: independent N(0, 1) if model and error model hold."""

    channel: str  # measured channel
    record: str  # name of the record
    dt: float  # time step [s]
    values: Float[np.ndarray, " time"] = field(repr=False)  # residual, dimensionless; 0 for a missing value
    observation: int = 0  # index of the observation
    known: Bool[np.ndarray, " time"] | None = field(
        default=None, repr=False
    )  # mask of the measured values; None for all

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
        """Whether the error model fails to describe the residual."""
        return abs(self.largest[0]) > self.bound


def whitened_residuals(posterior: Posterior, theta: Float[np.ndarray, " parameter"]) -> tuple[WhitenedResidual, ...]:
    """Whiten the residuals of a prediction."""
    residuals = []
    for index, observation in enumerate(posterior.observations):
        residual = (observation.values - posterior.predict(theta[None], index)[0])[:, :, None]
        white = np.asarray(posterior.likelihood.of[index].whiten(residual, posterior.unknowns(theta[None], index)))[
            :, :, 0
        ]
        residuals += [
            WhitenedResidual(
                channel, observation.record.name, observation.step, white[:, i], index, observation.is_measured[:, i]
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
    correlated = [residual for residual in residuals if residual.correlated]
    if not correlated:
        return []
    each = ", ".join(_correlation_in_words(residual) for residual in correlated)
    sentence = f"after whitening, the residuals are still correlated, which contradicts {assumed}: {each}"
    worst = max(too_small_by, key=lambda name: too_small_by[name]) if too_small_by else None
    if too_small_by and worst and too_small_by[worst] > MUCH_WIDER:
        sentence += f"; the sd of {worst} is about {too_small_by[worst]:.2g} times too small (see robust_sd)"
    return [sentence + ("; use a correlated error model, such as damped_cosine" if added.independent else "")]


def _correlation_in_words(residual: WhitenedResidual) -> str:
    value, lag = residual.largest
    return (
        f"{residual.channel} on {residual.record} by {value:.2f} at a lag of {lag:.3g} s "
        f"(expected: within ±{residual.bound:.2f})"
    )
