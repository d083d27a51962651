"""A second law to temper from: around modes that were searched for, whether particles from the prior have found them or not."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln

from structid.inference.sampling.moves import DEGREES_OF_FREEDOM, EnsembleState, IndependenceLaw
from structid.inference.sampling.smc.lost_modes import Mode
from structid.inference.target import Target


class FromReference(Target):
    """A target whose particles begin at a reference q in place of the prior.

    π = q · (π/q): the reference takes the prior's place and the rest the likelihood's, so that a tempering passes through
    q^(1−β) π^β. Since q integrates to one, its evidence is the target's.
    """

    def __init__(self, target: Target, particles: EnsembleState, modes: list[Mode]) -> None:
        self.target, self.names, self.bijection = target, target.names, target.bijection
        phi, log_density = (np.concatenate(list(array))[None] for array in particles)
        known = IndependenceLaw.fitted(EnsembleState(phi, log_density))
        count = max(len(modes), 1)
        self.law = IndependenceLaw(
            np.concatenate([known.middle, np.stack([m.middle for m in modes])[None]], axis=1),
            np.concatenate([known.factor, np.stack([m.factor for m in modes])[None]], axis=1),
            np.concatenate([0.5 * known.share / known.share.sum(), np.full(count, 0.5 / count)]),
        )

    def evaluate_parts(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log q, and what it lacks of log π; see `Target.evaluate_parts`."""
        dimension, degrees = phi.shape[1], DEGREES_OF_FREEDOM
        # A Student density is Γ((ν + d)/2) / (Γ(ν/2) (νπ)^(d/2) |Σ|^½) (1 + r²/ν)^(−(ν + d)/2).
        constant = (
            gammaln(0.5 * (degrees + dimension)) - gammaln(0.5 * degrees) - 0.5 * dimension * np.log(np.pi * degrees)
        )
        own = self.law.log_density(phi[None])[0] + constant
        density, failed = self.target.evaluate(phi)
        return own, density - own, failed

    def evaluate(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray]:
        """Log density of the target; see `Target.evaluate`."""
        return self.target.evaluate(phi)

    def log_density(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Log density with respect to the parameters; see `Target.log_density`."""
        return self.target.log_density(theta)

    def initial(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count parameter"]:
        """Draw from the reference."""
        return np.asarray(self.law.draw(rng, count)[0])

    @property
    def content_hash(self) -> str:
        """The target's: a sum over q and what it lacks is the same density."""
        return self.target.content_hash
