"""Exploration of a surrogate's posterior by tempering, and the exponent up to which the surrogate is accurate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from structid.core.streams import Purpose, stream
from structid.ground_motion.excitation import Excitation
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.base import Block
from structid.inference.sampling.smc.bridge_sampling import bennett_ratio
from structid.surrogates.base import Surrogate

SAMPLED_RESPONSES = 8
"""Number of responses sampled from the surrogate's error at each point, for the variance of the log density."""

PARTICLES_ASKED = 64
"""Approximate number of particles of a tempering step at which the variance due to the surrogate error is evaluated."""

SAMPLED_AT_ONCE = 3_000_000
"""Approximate number of values of the responses that are sampled at once, 24 MB; long records would fill the memory."""

SMALLEST_EXPONENT = 1e-300
"""Exponent assigned to the prior when likelihood exponents are compared by their logarithms."""

LARGEST_VARIANCE = 1.0
"""Variance of a tempered log density due to the surrogate error above which the draws mostly reflect this error."""


@dataclass(frozen=True, eq=False)
class Exploration:
    """Tempering steps of a sampler on a surrogate's posterior."""

    posterior: Posterior  # under the surrogate
    surrogate: Surrogate  # its model
    # All blocks of the sampler: tempering steps with rising exponent of the likelihood, then moves in the posterior
    blocks: Sequence[Block]

    @cached_property
    def exponents(self) -> np.ndarray:
        """Exponent of the likelihood in every block, shape (block,)."""
        return np.array([block["exponent"][-1] for block in self.blocks])

    def nearest(self, exponent: float) -> int:
        """Return the index of the block with the closest exponent on a logarithmic scale."""
        log_exponents, log_target = (
            np.log(np.maximum(self.exponents, SMALLEST_EXPONENT)),
            np.log(max(exponent, SMALLEST_EXPONENT)),
        )
        return int(np.argmin(np.abs(log_exponents - log_target)))

    def particles(self, block: int = -1) -> Float[np.ndarray, "particle parameter"]:
        """Particles at the end of a block, in unconstrained coordinates."""
        return np.asarray(self.blocks[block]["phi"][-1].reshape(-1, self.posterior.dimension))

    def draws(self, block: int = -1) -> Float[np.ndarray, "particle parameter"]:
        """Particles in SI."""
        return self.posterior.bijection(self.particles(block))[0]

    def distinct(self, block: int, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count parameter"]:
        """Choose random particles of a block without repetition."""
        phi = self.particles(block)
        phi = phi[rng.permutation(len(phi))]
        # Copies of a particle that have not moved count as one particle, since a point is run once.
        first = np.sort(np.unique(phi, axis=0, return_index=True)[1])
        return np.asarray(phi[first[:count]])

    def log_density(self, phi: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Log density of the surrogate's posterior with respect to the parameters."""
        density, _ = self.posterior.evaluate(phi)
        return np.asarray(density - self.posterior.bijection(phi)[1])

    @cached_property
    def highest(self) -> float:
        """Largest log density, with respect to the parameters, at a particle of the posterior."""
        last = self.blocks[-1]["log_density"][-1].ravel()
        return float(np.max(last - self.posterior.bijection(self.particles())[1]))

    def share_of_tempered(self, phi: Float[np.ndarray, "run parameter"], block: int) -> Float[np.ndarray, " run"]:
        """Ratio of the densities of a tempered posterior and the posterior, both normalised."""
        untempered = 1.0 - self.exponents[block]
        of_block, of_last = (self.blocks[b]["likelihood"][-1].ravel() for b in (block, -1))
        ratio, _ = bennett_ratio(untempered * of_block, untempered * of_last)
        likelihood = self.posterior.evaluate_parts(phi)[1]
        return np.asarray(np.exp(ratio - untempered * likelihood))

    @cached_property
    def outside(self) -> float:
        """Fraction of the posterior's particles outside the range of the surrogate's runs."""
        theta = np.asarray(self.posterior.model_parameters(self.draws()))
        return float(np.mean(self.surrogate.outside(theta)))

    # --- certainty of the surrogate -------------------------------------------------------------------------------

    @cached_property
    def trusted(self) -> int:
        """Index of the last block whose tempered log density has a surrogate variance of at most `LARGEST_VARIANCE`."""
        last = len(self.blocks) - 1
        stages = [int(np.flatnonzero(self.exponents == e)[-1]) for e in np.unique(self.exponents) if e > 0.0]
        for block in reversed(stages):
            if self.exponents[block] ** 2 * self.variance(block) <= LARGEST_VARIANCE:
                return last if self.exponents[block] == 1.0 else block
        return 0

    @property
    def sure(self) -> bool:
        """Whether the block `trusted` is the posterior itself."""
        return bool(self.exponents[self.trusted] == 1.0)

    @cached_property
    def deviation(self) -> float:
        """Standard deviation of the log density due to the surrogate error, averaged over the posterior [nat]."""
        return float(np.sqrt(self.variance()))

    def variance(self, block: int = -1) -> float:
        """Return the mean, over some particles of a block, of the log density's variance due to the surrogate error."""
        phi = self.particles(block)
        some = phi[:: max(1, len(phi) // PARTICLES_ASKED)]
        return float(np.mean(self.variance_at(self.posterior.bijection(some)[0])))

    def variance_at(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Variance of the log density due to the surrogate error, at each point."""
        return variance_by_the_surrogate(self.posterior, self.surrogate, theta)


def variance_by_the_surrogate(
    posterior: Posterior, surrogate: Surrogate, theta: Float[np.ndarray, "run parameter"]
) -> Float[np.ndarray, " run"]:
    """Return the variance of the log density at each point, over responses sampled from the surrogate's error."""
    rng = stream(0, Purpose.SURROGATE_ERROR)  # the same stream at every call, so that points can be compared
    parameters = np.repeat(np.asarray(posterior.model_parameters(theta)), SAMPLED_RESPONSES, axis=0)
    rows = np.repeat(theta, SAMPLED_RESPONSES, axis=0)

    def sampled(record: Excitation) -> Iterator[np.ndarray]:
        # Whole points: NumPy sums a single row in another order, and the last digits would depend on the size.
        of_point = SAMPLED_RESPONSES * len(record) * len(surrogate.channels)
        size = SAMPLED_RESPONSES * max(1, SAMPLED_AT_ONCE // of_point)
        for first in range(0, len(parameters), size):
            yield surrogate.sampled(parameters[first : first + size], record, rng)

    responses = (sampled(observation.record) for observation in posterior.observations)
    density = posterior.log_density_given(responses, rows).reshape(len(theta), SAMPLED_RESPONSES)
    finite = np.isfinite(density).all(axis=1)
    variance = np.var(np.where(finite[:, None], density, 0.0), axis=1, ddof=1)
    return np.where(finite, variance, np.inf)
