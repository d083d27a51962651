"""Drift of a wrong model's parameters during the response, estimated from the residuals of a fit."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.units import factor
from structid.inference.error_models.drifting import DRIFT_LOG_SD, DRIFT_MEDIAN, SPANS
from structid.inference.likelihood.posterior import Posterior
from structid.models.drifting_model import drift_name, hats

STEP = 0.01
"""Half the step of central differences, in prior standard deviations."""

NATS = 5.0
"""Increase of the log-likelihood above which parameters are considered to drift."""

REPORTED_RATIO = 1.2
"""Ratio to its prior median above which a drift is reported. The data do not support a smaller drift."""


@dataclass(frozen=True, eq=False)
class ParameterDrift:
    """Drift of parameters in time, if the data show a drift."""

    posterior: Posterior = field(repr=False)  # posterior of the parameters
    # Standard deviations d_j of θ_j(t) about its mean, in SI; zeros if the data show no drift
    sd: Float[np.ndarray, " parameter"] = field(repr=False)
    gain: float  # increase of the log density by the best d over no drift [nat]

    @classmethod
    def sampled(cls, posterior: Posterior, draws: Float[np.ndarray, "draw parameter"]) -> ParameterDrift:
        """Take the drift from draws of a posterior with drifting parameters."""
        places = [posterior.names.index(drift_name(name)) for name in posterior.model_space.names]
        return cls(posterior, np.sqrt(np.mean(draws[:, places] ** 2, axis=0)), float("nan"))

    @property
    def found(self) -> bool:
        """Whether the data show that the parameters drift."""
        return bool(self.sd.any())

    def widened(self, sd: Float[np.ndarray, " parameter"]) -> Float[np.ndarray, " parameter"]:
        """Spread of the parameters on an unmeasured record, √(sd² + d²)."""
        return np.asarray(np.hypot(sd, np.pad(self.sd, (0, len(sd) - len(self.sd)))))

    def sentence(self, mean: Float[np.ndarray, " parameter"]) -> str:
        """Describe the drift."""
        if not self.found:
            return ""
        parts = []
        marginals = self.posterior.model_space.marginals
        shares = self.sd / np.array([marginal.moments[1] for marginal in marginals.values()])
        for index, (name, marginal) in enumerate(marginals.items()):
            if shares[index] < min(REPORTED_RATIO * DRIFT_MEDIAN, shares.max()):
                continue
            unit, size = marginal.unit, float(self.sd[index])
            description = f"{name} by {size / factor(unit):.2g}{' ' + unit if unit else ''}"
            if shares[index] > 1.0:
                description += " (more than the standard deviation of its prior)"
            elif abs(mean[index]) > size:  # a fraction of a mean near zero is meaningless
                description += f" ({100.0 * size / abs(mean[index]):.2g} % of its mean)"
            parts.append(description)
        return (
            f"The parameters drift during the response: {', '.join(parts)}. The results show their means over the measured "
            "record; on another record, the means may differ by as much."
        )

    def moved(
        self, theta: Float[np.ndarray, "run parameter"], rng: np.random.Generator
    ) -> Float[np.ndarray, "run parameter"]:
        """Draw the parameters for an unmeasured record: θ_j + d_j b_j, b_j ~ N(0, 1)."""
        (low, high), count = self.posterior.model_space.bounds.T, len(self.sd)
        drifted = theta[:, :count] + self.sd * rng.standard_normal((len(theta), count))
        return np.concatenate([np.clip(drifted, low, high), theta[:, count:]], axis=1)


def drift_of(
    posterior: Posterior, draws: Float[np.ndarray, "draw parameter"], fit: Float[np.ndarray, " parameter"]
) -> ParameterDrift | None:
    """Return the drift from the error model, or estimate it from the residuals of a fit."""
    return ParameterDrift.sampled(posterior, draws) if posterior.error_model.inside else parameter_drift(posterior, fit)


def parameter_drift(
    posterior: Posterior, theta: Float[np.ndarray, " parameter"], spans: int = SPANS
) -> ParameterDrift | None:
    """Estimate the drift of the parameters, to first order about a fit.

    With hat functions h_k about knots in time, S_j = ∂M/∂θ_j and the error model's whitening L⁻¹, the whitened residual is

    e = V √D b + η,   V_jk = L⁻¹ h_k S_j,   D = diag(d_j²),   b, η ~ N(0, I),

    so that b can be integrated out: log p(e | d) = ½ zᵀ (I + √D VᵀV √D)⁻¹ z − ½ log |I + √D VᵀV √D| + const, z = √D Vᵀ e. d
    maximises this with the lognormal priors of `Drifting`. This is the first-order form of `Drifting` with fixed error-model
    parameters. It needs two model runs per parameter and no derivatives, so it also works with a surrogate. If it finds a drift,
    θ at the fit is a mean over this record only; √(sd² + d²) is the parameter's spread on another record.
    """
    space = posterior.model_space
    if space.dimension == 0:  # only error-model parameters are unknown
        return None
    prior_sd = np.array([marginal.moments[1] for marginal in space.marginals.values()])
    parts = [
        _projections(posterior, theta, STEP * prior_sd, index, spans) for index in range(len(posterior.observations))
    ]
    if not all(np.isfinite(gram).all() and np.isfinite(projection).all() for gram, projection in parts):
        return None
    usual = np.full(space.dimension, np.log(DRIFT_MEDIAN))

    def negative(log_share: np.ndarray) -> float:
        spread = np.repeat(np.exp(log_share) * prior_sd, spans + 1)
        prior = -0.5 * np.sum(((log_share - usual) / DRIFT_LOG_SD) ** 2)
        return -float(prior + sum(_gain(gram, projection, spread) for gram, projection in parts))

    best = scipy.optimize.minimize(negative, usual, method="Nelder-Mead", options={"maxiter": 400 * space.dimension})
    gain = -float(best.fun)
    sd = np.exp(best.x) * prior_sd if gain > NATS else np.zeros(space.dimension)
    return ParameterDrift(posterior, sd, gain)


def _gain(gram: np.ndarray, projection: np.ndarray, spread: np.ndarray) -> float:
    """Log p(e | d) − log p(e | 0)."""
    inner = np.eye(len(spread)) + spread[:, None] * gram * spread
    factor = scipy.linalg.cholesky(inner, lower=True)
    explained = scipy.linalg.solve_triangular(factor, spread * projection, lower=True)
    return float(0.5 * explained @ explained - np.log(np.diag(factor)).sum())


def _projections(
    posterior: Posterior, theta: np.ndarray, steps: np.ndarray, index: int, spans: int
) -> tuple[np.ndarray, np.ndarray]:
    """VᵀV (parameter · knot, parameter · knot) and Vᵀ e (parameter · knot,) of one observation.

    For errors that are not normal, e is the influence of the values.
    """
    observation, count = posterior.observations[index], len(steps)
    low, high = posterior.model_space.bounds.T
    points = np.tile(theta, (2 * count + 1, 1))
    points[1:, :count] = np.clip(theta[:count], low + steps, high - steps)
    points[1:, :count] += np.concatenate([np.diag(steps), -np.diag(steps)])
    response = posterior.predict(points, index)
    plus, minus = response[1 : count + 1], response[count + 1 :]
    sensitivity = (plus - minus) / (2.0 * steps[:, None, None])
    samples = response.shape[1]
    duration = observation.record.dt * (len(observation.record) - 1)
    weights = hats(observation.time * spans / max(duration, observation.record.dt), spans + 1)
    columns = np.einsum("jtc,tk->tcjk", sensitivity, weights).reshape(samples, -1, count * (spans + 1))
    unknown = {
        name: np.repeat(value, columns.shape[2]) for name, value in posterior.unknowns(theta[None], index).items()
    }
    bound, middle = posterior.likelihood.of[index], response[0][:, :, None]
    white = np.asarray(bound.whiten(columns, unknown, middle)).reshape(-1, columns.shape[2])
    influence = bound.influence(middle, posterior.unknowns(theta[None], index)).ravel()
    return white.T @ white, white.T @ influence
