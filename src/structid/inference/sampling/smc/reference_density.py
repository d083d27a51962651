"""A second reference density for tempering, around modes that a search has found."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.inference.sampling.moves import EnsembleState, IndependenceProposal
from structid.inference.sampling.smc.lost_modes import Mode
from structid.inference.target import Target


class FromReference(Target):
    """A target whose particles begin at a reference density q in place of the prior.

    π = q · (π/q): q replaces the prior and π/q the likelihood, so that a tempering run passes through q^(1−β) π^β. Since q
    integrates to one, the evidence equals the target's evidence.
    """

    def __init__(self, target: Target, particles: EnsembleState, modes: list[Mode]) -> None:
        self.target, self.names, self.bijection = target, target.names, target.bijection
        phi, log_density = (np.concatenate(list(array))[None] for array in particles)
        fitted = IndependenceProposal.fitted(EnsembleState(phi, log_density))
        count = max(len(modes), 1)
        self.reference = IndependenceProposal(
            np.concatenate([fitted.middle, np.stack([m.middle for m in modes])[None]], axis=1),
            np.concatenate([fitted.factor, np.stack([m.factor for m in modes])[None]], axis=1),
            np.concatenate([0.5 * fitted.share / fitted.share.sum(), np.full(count, 0.5 / count)]),
        )

    def evaluate_parts(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log q, and log π − log q; see `Target.evaluate_parts`."""
        log_reference = self.reference.log_density(phi[None])[0]
        density, failed = self.target.evaluate(phi)
        return log_reference, density - log_reference, failed

    def evaluate(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray]:
        """Log density of the target; see `Target.evaluate`."""
        return self.target.evaluate(phi)

    def log_density(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Log density with respect to the parameters; see `Target.log_density`."""
        return self.target.log_density(theta)

    def initial(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count parameter"]:
        """Draw from the reference."""
        return np.asarray(self.reference.draw(rng, count)[0])

    @property
    def content_hash(self) -> str:
        """Hash of the target, whose log density is the sum of both parts."""
        return self.target.content_hash
