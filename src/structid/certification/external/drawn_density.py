"""Interface of the density q of external draws."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from structid.certification.external.fitted_density import FittedDensity
from structid.certification.limits import Limits
from structid.certification.monte_carlo_error import MonteCarloError
from structid.core.errors import InputError
from structid.inference.convergence import walkers_in_turn
from structid.inference.target import Target

PARTS = 4
"""Number of parts into which a single chain is divided, to estimate the standard errors of its averages."""
MANY = 4000
"""Approximate number of draws that represent a density."""
COVERED = 0.99
"""Probability of the ball, in normal coordinates, within which points count as covered by the draws."""
FAR_FROM_PRIOR = 8.0
"""Distance of the draws' median from the prior median, in prior standard deviations, that suggests a wrong unit."""
OTHER_SPREAD = 0.7
"""Largest accepted ratio of two spreads: of the given minus the fitted log density, and of the fitted log density."""


@dataclass(frozen=True, eq=False)
class Chosen:
    """Points for model runs."""

    theta: Float[np.ndarray, "point parameter"]  # in SI
    # Log density of q there; −inf outside its support, where the true posterior may have density
    log_drawn: Float[np.ndarray, " point"]
    # Log density of the wider distribution there, with q's normalisation; −inf if there is none
    log_wide: Float[np.ndarray, " point"]
    log_mixture: Float[np.ndarray, " point"]  # log density of the mixture g of the points, with q's normalisation

    @property
    def shares(self) -> np.ndarray:
        """q/g, the weight of each point in an average over q."""
        return np.asarray(np.exp(self.log_drawn - self.log_mixture))

    @property
    def inside(self) -> Chosen:
        """Points in the support of q."""
        return self[np.isfinite(self.log_drawn)]

    def __getitem__(self, rows: np.ndarray) -> Chosen:
        return Chosen(self.theta[rows], self.log_drawn[rows], self.log_wide[rows], self.log_mixture[rows])


class DrawnDensity(ABC):
    """q, the density of external draws."""

    subject = ""
    """Description of the certified density, if the draws themselves are not certified."""
    at_draws: np.ndarray
    """Log density of q at draws from q, shape (draw,)."""
    fitted: FittedDensity
    """Density fitted to the draws, in unconstrained coordinates."""
    width = 1.0
    """Width of the density of the points for model runs, relative to the draws."""
    enough = 30
    """Number of model runs that usually suffices for a verdict."""

    def __init__(self, posterior: Target, draws: Float[np.ndarray, "chain draw parameter"]) -> None:
        self.posterior, self.bijection, self.draws = posterior, posterior.bijection, draws
        self.flat = draws.reshape(-1, posterior.dimension)
        with np.errstate(invalid="ignore", divide="ignore"):
            self.phi = self.bijection.inverse(self.flat)
        outside = ~np.isfinite(self.phi)
        if outside.any():
            names = ", ".join(n for n, out in zip(posterior.names, outside.any(axis=0), strict=True) if out)
            raise InputError(
                "certify(draws)",
                f"{int(outside.any(axis=1).sum())} of {len(self.flat)} draws outside the support of the priors, in {names}",
                "draws in SI inside the support",
                "Check that they are in SI: N, m, kg, s.",
            )

    @property
    def population(self) -> np.ndarray:
        """Many draws from q, (draw, parameter), in SI."""
        return self.flat[:: max(1, len(self.flat) // MANY)]

    @property
    def highest(self) -> float:
        """Largest log density of q at a draw."""
        return float(self.at_draws.max())

    def distinct(self, count: int, rng: np.random.Generator) -> Int[np.ndarray, " count"]:
        """Choose random draws without repetition."""
        return rng.permutation(np.unique(self.flat, axis=0, return_index=True)[1])[:count]

    def in_order(self, flat: Float[np.ndarray, "_ parameter"]) -> Float[np.ndarray, "chain draw parameter"]:
        """Arrange values of all draws in the order in which they were drawn."""
        if self._walkers > 1:
            length = len(flat) // self._walkers
            return flat[: self._walkers * length].reshape(length, self._walkers, -1).swapaxes(0, 1)
        chains = len(self.draws) if len(self.draws) > 1 else PARTS
        length = len(flat) // chains
        return flat[: chains * length].reshape(chains, length, -1)

    @cached_property
    def _walkers(self) -> int:
        """Number of walkers of an ensemble whose draws were given step by step as one chain; 1 otherwise."""
        return walkers_in_turn(self.draws[0]) if len(self.draws) == 1 else 1

    def far_from_prior(self, rng: np.random.Generator) -> tuple[str, ...]:
        """Report draws where the prior is nearly zero, for example because of a wrong unit."""
        if not self.posterior.knows_prior:
            return ()
        prior = self.posterior.initial(MANY, rng)
        middle, sd = np.median(prior, axis=0), prior.std(axis=0)
        distance = np.abs(np.median(self.phi, axis=0) - middle) / sd
        # Errors may be a thousandth of their prior's range: this indicates a good fit, not another unit.
        worst = max(self.posterior.own, key=lambda place: float(distance[place]))
        if distance[worst] <= FAR_FROM_PRIOR:
            return ()
        median_of_draws, expected = (
            float(np.median(self.flat[:, worst])),
            float(self.bijection(middle[None])[0][0, worst]),
        )
        return (
            f"the draws of {self.posterior.names[worst]} have a median of {median_of_draws:.3g}, {distance[worst]:.0f} standard "
            f"deviations from the prior median {expected:.3g}: check that they are in SI (N, m, kg, s)",
        )

    @abstractmethod
    def log_density(self, theta: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, " point"]:
        """Log density of q."""

    @abstractmethod
    def chosen(self, count: int, rng: np.random.Generator) -> Chosen:
        """Choose points for model runs."""

    @abstractmethod
    def around(self, count: int, rng: np.random.Generator) -> Chosen:
        """Choose points at which other densities are compared with q, without a model run."""

    def covers(self, theta: Float[np.ndarray, "point parameter"]) -> Bool[np.ndarray, " point"]:
        """Return whether each point lies in the region from which most points for model runs are drawn."""
        z, _ = self.fitted.in_normal_coordinates(self.bijection.inverse(theta))
        with np.errstate(over="ignore", invalid="ignore"):  # z may be infinite far from all draws
            return np.asarray(np.sum((z / self.width) ** 2, axis=1) <= scipy.stats.chi2.ppf(COVERED, z.shape[1]))

    def checked(
        self, known: Float[np.ndarray, "point parameter"], by_chance: MonteCarloError, limits: Limits, seed: int
    ) -> tuple[tuple[str, ...], MonteCarloError]:
        """Report the evidence against q that needs no model run, and bounds on the errors of the draws' moments."""
        return (), by_chance


def refuse_infinite(at_draws: Float[np.ndarray, " draw"]) -> None:
    """Refuse a log density that is not finite at some draws."""
    if not np.isfinite(at_draws).all():
        raise InputError(
            "certify(log_density)",
            f"a log density that is not finite at {int((~np.isfinite(at_draws)).sum())} of {len(at_draws)} draws",
            "a finite value at every draw, since a density is positive wherever it has draws",
        )


def contradiction(drawn: DrawnDensity) -> InputError | None:
    """Error about a log density that differs from the density fitted to the draws, by more than the latter varies.

    It is raised only if a further check finds that the draws do not have the given density: no density can be fitted well to
    draws along a thin arc.
    """
    log_fitted = of_fitted(drawn.fitted, drawn, drawn.flat)
    gap, spread = (np.diff(np.quantile(x, (0.16, 0.84)))[0] for x in (drawn.at_draws - log_fitted, log_fitted))
    if gap <= OTHER_SPREAD * spread:
        return None
    return InputError(
        "certify(log_density)",
        f"a log density that does not match the draws: it deviates by {0.5 * gap:.3g} nats from a density fitted to "
        f"the draws, which itself varies by {0.5 * spread:.3g} nats",
        "log q with respect to the parameters in SI, up to a constant, where q is the density of the draws",
        "Do not give a log-likelihood, a density with respect to other coordinates, or a chain that is only a few "
        "autocorrelation times long. If log q is unknown, omit log_density.",
    )


def of_fitted(
    fitted: FittedDensity, drawn: DrawnDensity, theta: Float[np.ndarray, "point parameter"]
) -> Float[np.ndarray, " point"]:
    """Log density of a fitted density with respect to the parameters."""
    with np.errstate(invalid="ignore", divide="ignore"):
        phi = drawn.bijection.inverse(theta)
    inside = np.isfinite(phi).all(axis=1)
    density = np.full(len(theta), -np.inf)
    density[inside] = fitted.log_density(phi[inside]) - drawn.bijection(phi[inside])[1]
    return density
