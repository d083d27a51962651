"""A density in the unconstrained coordinates of another density."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.core.hashing import digest
from structid.inference.target import Target
from structid.probability.bijections import Bijection


class TransformedTarget(Target):
    """A density in the unconstrained coordinates of another target of the same parameters.

    Two targets whose parameters differ in bounds or scales map the same φ to different θ. A sampler that uses both
    at once needs a common φ. With φ′ the density's own coordinates of θ(φ): log π(φ) = log π(φ′) + log |dφ′/dφ|.
    """

    def __init__(self, density: Target, bijection: Bijection) -> None:
        self.density, self.bijection, self.names = density, bijection, density.names

    @property
    def knows_prior(self) -> bool:
        """Whether the density can evaluate its prior separately."""
        return self.density.knows_prior

    @property
    def costs_runs(self) -> bool:
        """Whether each evaluation is a run of an expensive solver."""
        return self.density.costs_runs

    def _own(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The density's own coordinates φ′, NaN outside its support, and log |dφ′/dφ|."""
        theta, jacobian = self.bijection(phi)
        own_phi = self.density.bijection.inverse(theta)
        return own_phi, jacobian - self.density.bijection(own_phi)[1]

    def evaluate(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray]:
        """Log density; see `Target.evaluate`."""
        own_phi, jacobian = self._own(phi)
        value, failed = self.density.evaluate(own_phi)
        return _or_none(value + jacobian), failed

    def evaluate_parts(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log prior and log-likelihood; see `Target.evaluate_parts`."""
        own_phi, jacobian = self._own(phi)
        prior, likelihood, failed = self.density.evaluate_parts(own_phi)
        return _or_none(prior + jacobian), _or_none(likelihood), failed

    def log_density(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Log density with respect to the parameters; see `Target.log_density`."""
        return self.density.log_density(theta)

    def initial(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count parameter"]:
        """Draw starting points; see `Target.initial`."""
        return self.bijection.inverse(self.density.bijection(self.density.initial(count, rng))[0])

    @property
    def content_hash(self) -> str:
        """Hash of the density and of the coordinates."""
        bijection = self.bijection
        return digest(
            self.density.content_hash, bijection.bounds, bijection.scales, bijection.scatters, bijection.logarithmic
        )


def _or_none(log_density: np.ndarray) -> np.ndarray:
    """The log density with −inf where it is undefined."""
    return np.where(np.isnan(log_density), -np.inf, log_density)
