"""Standard deviations of posterior means, valid even for a wrong model or error model, and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from structid.inference.likelihood.posterior import Posterior

LONG_RUN_SHARE = 1.0 / 6.0
"""Width of the lag window of a long-run covariance, as a fraction of the history."""

KEPT = 1.0 - 0.75 * LONG_RUN_SHARE
"""Fraction of white noise's long-run covariance that remains after its terms are centred on their own mean."""


@dataclass(frozen=True, eq=False)
class RobustSpread:
    """Variation of the posterior means over repeated measurements."""

    sd: Float[np.ndarray, " parameter"] = field(repr=False)  # standard deviations in SI
    # Relative standard errors of `sd`; 0 if `sd` equals the posterior's
    error: Float[np.ndarray, " parameter"] = field(repr=False)

    @property
    def same(self) -> bool:
        """Whether the standard deviations equal the posterior's, as they do if the residuals are white."""
        return not self.error.any()

    def at_least(self, sd: Float[np.ndarray, " parameter"]) -> RobustSpread:
        """Raise the standard deviations to at least the posterior's."""
        wider = self.sd > sd
        return RobustSpread(np.where(wider, self.sd, sd), np.where(wider, self.error, 0.0))


def robust_spread(posterior: Posterior, draws: Float[np.ndarray, "draw parameter"]) -> RobustSpread:
    """Compute sandwich standard deviations of the posterior means, valid even for a wrong model or error model.

    The influence of the measurement at time t on the mean of θ_j is ψ_t = Cov(θ_j, log p(y_t | y_<t, θ)) over the
    posterior (R. Giordano & T. Broderick 2023, "The Bayesian infinitesimal jackknife for variance", arXiv 2305.06466);
    the variance of the mean is the long-run covariance of ψ. With the whitened response m, its influence a = Cov(m,
    θ_j) and the whitened errors e, ψ_t = Σ_c a_tc e_tc. At the fit, the residual is (I − P) e, with P the projection on
    all a. Therefore ψ sums to almost zero, and the estimate is too small. Its expectation for white e is

    tr B,   B = diag(a) C W C diag(a) (I − P),

    with the window's Toeplitz matrix W and the centring matrix C. The unbiased expectation is Σa², so the estimate is
    scaled by Σa²/tr B. The relative standard error of its square root is ½ √(2 tr B²)/tr B, where P is omitted in B².
    """
    influences = [_of_one(posterior, draws, index) for index in range(len(posterior.observations))]
    # A common basis, over all observations, of the responses that the parameters can produce.
    basis, _ = np.linalg.qr(np.concatenate([influence.reshape(-1, influence.shape[2]) for _, influence in influences]))
    raw = np.zeros(posterior.dimension)
    corrected, expected, squared, first = raw.copy(), raw.copy(), raw.copy(), 0
    for psi, influence in influences:
        samples, channels, count = influence.shape
        basis_of_observation = basis[first : first + samples * channels].reshape(samples, channels, -1)
        first += samples * channels
        raw += np.diag(long_run_covariance(psi))
        power = (influence**2).sum(axis=1)
        corrected += power.sum(axis=0)
        lost = [
            np.diag(long_run_covariance((influence[:, :, [j]] * basis_of_observation).sum(axis=1))).sum()
            for j in range(count)
        ]
        trace, of_square = _traces(power)
        expected += trace - np.array(lost)
        squared += of_square
    responds = (corrected > 0.0) & (expected > 1e-6 * corrected)
    expected = np.where(responds, expected, 1.0)
    factor = np.where(responds, corrected / expected, 1.0)
    error = np.where(responds, 0.5 * np.sqrt(2.0 * squared) / expected, 0.0)
    return RobustSpread(np.sqrt(raw * factor), error)


def _of_one(posterior: Posterior, draws: np.ndarray, index: int) -> tuple[np.ndarray, np.ndarray]:
    """ψ of one observation (time, parameter), and a = Cov(m, θ) of its whitened response m (time, channel, parameter)."""
    response = posterior.predict(draws, index)
    pointwise = posterior.pointwise_log_likelihood(draws, index, response).sum(axis=2)
    finite = np.isfinite(pointwise).all(axis=1)
    centred = (draws - draws.mean(axis=0))[finite] / finite.sum()
    psi = (pointwise[finite] - pointwise[finite].mean(axis=0)).T @ centred
    response = response[finite]
    mean = {
        name: np.repeat(value, len(response))
        for name, value in posterior.unknowns(draws.mean(axis=0)[None], index).items()
    }
    middle = response.mean(axis=0)
    deviations = (response - middle).transpose(1, 2, 0)
    white = np.asarray(posterior.likelihood.of[index].whiten(deviations, mean, middle[:, :, None]))
    influence = white @ centred
    influence[..., [posterior.names.index(name) for name in posterior.likelihood.discrepancy_names]] = 0.0
    return psi, influence


# --- long-run covariances -------------------------------------------------------------------------------------------


def long_run_covariance(series: Float[np.ndarray, "time quantity"]) -> Float[np.ndarray, "quantity quantity"]:
    """Covariance of a sum of correlated terms, Σ_k w(k/K) Γ_k, with Parzen's window w (A. R. Gallant 1987), never negative."""
    count = series.shape[1]
    centred = series - series.mean(axis=0)
    covariance = centred.T @ _toeplitz(_lag_window(len(series)), centred)
    return np.asarray(0.5 * (covariance + covariance.T).reshape(count, count) / KEPT)


def parzen(x: np.ndarray) -> np.ndarray:
    """Parzen's lag window."""
    return np.where(x <= 0.5, 1.0 - 6.0 * x**2 + 6.0 * x**3, 2.0 * np.maximum(1.0 - x, 0.0) ** 3)


def _traces(power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Traces of D diag(p) and of its square for every column p of `power`, with D = C W C / `KEPT`.

    The entries of C W C are w_ts + u_t + u_s with u = m/2 − r, r the row means of W and m their mean.
    """
    samples = len(power)
    window = _lag_window(samples)
    rows = _toeplitz(window, np.ones((samples, 1)))[:, 0] / samples
    u = 0.5 * rows.mean() - rows
    trace = (window[0] + 2.0 * u) @ power / KEPT
    plain, with_u, with_square = power.sum(axis=0), u @ power, (u**2) @ power
    square = (
        (power * _toeplitz(window**2, power)).sum(axis=0)
        + 4.0 * (u[:, None] * power * _toeplitz(window, power)).sum(axis=0)
        + 2.0 * (plain * with_square + with_u**2)
    )
    return trace, square / KEPT**2


def _lag_window(samples: int) -> np.ndarray:
    """Weights of the lags 0, 1, …."""
    return parzen(np.arange(samples) / (LONG_RUN_SHARE * samples))


def _toeplitz(weights: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Σ_s w_|t−s| x_s of every column."""
    samples = len(series)
    around = np.concatenate([weights, [0.0], weights[:0:-1]])
    transform = np.fft.rfft(series, 2 * samples, axis=0) * np.fft.rfft(around)[:, None].real
    return np.asarray(np.fft.irfft(transform, axis=0)[:samples])
