"""Identifiability: Fisher information at a point, and the parameter combinations that the data do not determine."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from structid.engine.device import jnp
from structid.inference.likelihood.observation_likelihood import ObservationLikelihood
from structid.inference.likelihood.posterior import Posterior
from structid.models.traceable import as_traceable

SEEN = 1.0
"""Ratio of the data's to the prior's information below which the prior determines a combination better."""


@dataclass(frozen=True)
class Identifiability:
    """Fisher information of the model and nuisance parameters, relative to the prior.

    With the whitened sensitivities S = L⁻¹ ∂y/∂θ (L Lᵀ the covariance of ε) the information is F = SᵀS. In units of the
    prior's standard deviations s, F̃ = diag(s) F diag(s). An eigenvalue of F̃ is the ratio of a
    combination's prior variance to its variance from the data alone.
    """

    names: tuple[str, ...]  # parameters
    fisher: Float[np.ndarray, "parameter parameter"] = field(repr=False)  # F in SI
    eigenvalues: Float[np.ndarray, " parameter"]  # eigenvalues of F̃, descending
    # Columns: the combinations, in prior standard deviations
    eigenvectors: Float[np.ndarray, "parameter parameter"] = field(repr=False)
    # √diag F⁻¹ in SI: the smallest standard deviation of an unbiased estimate from these data alone
    cramer_rao_sd: Float[np.ndarray, " parameter"]
    prior_sd: Float[np.ndarray, " parameter"] = field(repr=False)  # in SI

    @property
    def unseen(self) -> list[str]:
        """Parameter combinations, in words, that the data determine less well than the prior."""
        return [self.combination(i) for i in range(len(self.names)) if self.eigenvalues[i] < SEEN]

    def combination(self, index: int) -> str:
        """One eigenvector in words."""
        vector = self.eigenvectors[:, index]
        vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
        order = [i for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > 0.1]
        if len(order) == 1:
            return str(self.names[order[0]])
        text = " ".join(f"{'−' if vector[i] < 0 else '+'} {abs(vector[i]):.2f} {self.names[i]}" for i in order)
        return text.removeprefix("+ ")


def identifiability(posterior: Posterior, theta: Float[np.ndarray, " parameter"]) -> Identifiability:
    """Compute the Fisher information at a point, from exact sensitivities."""
    as_traceable(posterior.model, "identifiability", "a built-in model")
    error_parameters = posterior.likelihood.discrepancy_names
    kept = [i for i, name in enumerate(posterior.names) if name not in error_parameters]
    point = jnp.asarray(theta)[None, :]

    def whitened(moved: Any, bound: ObservationLikelihood) -> Any:
        response, _ = bound.response(moved, bound.measured)
        shown, unknown = bound.shown(response, moved), jax.lax.stop_gradient(bound.unknowns(point))
        return bound.whiten(shown, unknown, jax.lax.stop_gradient(shown))

    def sensitivity(bound: ObservationLikelihood) -> np.ndarray:
        def along(direction: Any) -> Any:
            return jax.jvp(lambda t: whitened(t, bound), (point,), (direction[None, :],))[1]

        directions = jnp.eye(point.shape[1])[jnp.array(kept)]
        return np.asarray(jax.jit(jax.vmap(along))(directions)).reshape(len(kept), -1)

    # One block of data after another.
    stacked = np.concatenate([sensitivity(bound) for bound in posterior.likelihood.of], axis=1)
    fisher = stacked @ stacked.T
    prior_sd = np.array([list(posterior.space.marginals.values())[i].moments[1] for i in kept])
    scaled = fisher * np.outer(prior_sd, prior_sd)
    eigenvalues, vectors = np.linalg.eigh(scaled)
    # A combination without information has infinite variance, and so has every parameter that contributes to it.
    dark = eigenvalues < 1e-13 * eigenvalues[-1]
    variance = (vectors**2 / np.where(dark, 1.0, eigenvalues)).sum(axis=1, where=~dark[None, :])
    variance = np.where((vectors**2 * dark).sum(axis=1) > 1e-10, np.inf, variance)
    return Identifiability(
        tuple(posterior.names[i] for i in kept),
        fisher,
        np.maximum(eigenvalues[::-1], 0.0),
        vectors[:, ::-1],
        prior_sd * np.sqrt(variance),
        prior_sd,
    )
