"""Growth of a fit's errors with the response, for transfer to another record."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy
from jaxtyping import Float

from structid.inference.likelihood.posterior import Posterior

PERIODS = 2.0
"""Number of dominant periods of the response over which its power is averaged."""


@dataclass(frozen=True, eq=False)
class ErrorGrowth:
    """σ²(t) = σ² (1 − s + s p(t)/p̄): the fraction s of the error variance is proportional to the power p(t) of the response."""

    share: Float[np.ndarray, " channel"]  # s, from 0 (an instrument's noise) to 1 (a wrong model's error)
    # p̄, the mean power of the response to the measured record, in the square of the channel's SI unit
    power: Float[np.ndarray, " channel"] = field(repr=False)

    def scale(
        self, response: Float[np.ndarray, "run time channel"], dt: float
    ) -> Float[np.ndarray, "run time channel"]:
        """σ(t)/σ for another record."""
        if not (len(response) and self.share.any()):
            return np.ones(response.shape)
        power = np.empty(response.shape)
        for draw, history in enumerate(response):
            power[draw] = running_power(history, dt)
        power *= self.share
        power /= self.power
        power += 1.0 - self.share
        return np.sqrt(power, out=power)


def running_power(response: Float[np.ndarray, "time channel"], dt: float) -> Float[np.ndarray, "time channel"]:
    """Running mean square of a response over two dominant periods."""
    spectrum = (np.abs(np.fft.rfft(response - response.mean(axis=0), axis=0)) ** 2).sum(axis=1)
    frequency = max(int(np.argmax(spectrum)), 1) / (len(response) * dt)
    width = int(np.clip(round(PERIODS / (frequency * dt)), 1, len(response)))
    return np.asarray(scipy.ndimage.uniform_filter1d(response**2, width, axis=0, mode="nearest"))


def error_growth(posterior: Posterior, theta: Float[np.ndarray, " parameter"], index: int = 0) -> ErrorGrowth:
    """Fraction of the error variance proportional to the response's power, by non-negative least squares."""
    observation, response = posterior.observations[index], posterior.predict(theta[None], index)[0]
    residual, dt = np.where(observation.is_measured, observation.values - response, 0.0), observation.step
    bound = posterior.likelihood.of[index]
    if bound.discrepancy.has_outliers:  # which would determine the power alone
        residual = bound.normal_scores(response[:, :, None], posterior.unknowns(theta[None], index))[:, :, 0]
    channels = len(observation.channels)
    power = np.mean(response**2, axis=0)
    if not (np.isfinite(power).all() and power.all()):
        return ErrorGrowth(np.zeros(channels), np.ones(channels))
    motion, error = running_power(response, dt) / power, running_power(residual, dt)
    share = np.zeros(channels)
    for channel in np.flatnonzero(error.any(axis=0)):
        known = observation.is_measured[:, channel]
        design = np.stack([np.ones(len(motion)), motion[:, channel]], axis=1)[known]
        of_known = error[known, channel]
        (constant, growing), _ = scipy.optimize.nnls(design, of_known / of_known.mean())
        share[channel] = growing / (constant + growing)
    return ErrorGrowth(share, power)
