"""External draws whose density is given as a function."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from structid.certification.external.drawn_density import MANY, Chosen, DrawnDensity, contradiction, refuse_infinite
from structid.certification.external.fitted_density import FittedDensity
from structid.certification.limits import Limits
from structid.certification.monte_carlo_error import MonteCarloError
from structid.core.errors import InputError
from structid.core.validation import real_array
from structid.inference.diagnostics.second_sampler import check_representation
from structid.inference.sampling.smc.bridge_sampling import bennett_ratio
from structid.inference.target import Target

WIDE_SHARE = 1.0 / 3.0
"""Fraction of the model runs at draws from a wider density, since draws from a q that is too narrow miss the tails."""
WIDENED = 1.4
"""Width of the wider density relative to the draws, about the width of q^½."""
AROUND = (WIDENED, 3.0)
"""Relative widths of the wider densities from which comparison points without a model run are drawn."""
SEARCHED = 20_000
"""Number of draws of the fitted density searched for points outside the support of q, which may be truncated."""
DEEPEST = 100.0
"""Depth of log q below its maximum at the draws from which q counts as zero [nat]."""


class DensityOfDraws(DrawnDensity):
    """q is a given function."""

    width = WIDENED

    def __init__(
        self,
        posterior: Target,
        draws: np.ndarray,
        function: Callable[[np.ndarray], np.ndarray],
        rng: np.random.Generator,
    ) -> None:
        super().__init__(posterior, draws)
        self.function = function
        self.at_draws = self.log_density(self.flat)
        refuse_infinite(self.at_draws)
        self.fitted = FittedDensity.of(self.phi, rng)

    def log_density(self, theta: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, " point"]:
        """Log density; see `DrawnDensity.log_density`."""
        values = real_array("certify(log_density)", self.function(theta), "log densities")
        values = values[:, 0] if values.shape == (len(theta), 1) else values
        if values.shape != (len(theta),):
            raise InputError(
                "certify(log_density)",
                f"a function that returns an array of shape {values.shape} for points of shape {theta.shape}",
                f"({len(theta)},): a log density for each point",
            )
        return np.where(np.isnan(values), -np.inf, values)

    def chosen(self, count: int, rng: np.random.Generator) -> Chosen:
        """Choose points: two thirds are draws, one third comes from a wider density; see `DrawnDensity.chosen`."""
        wide_count = round(WIDE_SHARE * count)
        rows = self.distinct(count - wide_count, rng)
        return self.beside_wider_ones(self.phi[rows], wide_count, self.phi, rng)

    def beside_wider_ones(
        self,
        plain: Float[np.ndarray, "draw parameter"],
        wide_count: int,
        many: Float[np.ndarray, "many parameter"],
        rng: np.random.Generator,
    ) -> Chosen:
        """Combine draws from q, draws from a wider density and points outside the support of q."""
        beyond = self._beyond(wide_count // 2, rng)
        wide_count -= len(beyond)
        wide = self.fitted.draw(MANY, rng, WIDENED)
        inside = np.isfinite(
            self._in_coordinates(wide)
        )  # of the wider density that part is taken which lies in q's support
        log_integral = self._log_integral(many, wide) - np.log(inside.mean())
        phi = np.concatenate([plain, wide[inside][:wide_count], beyond])
        return self._of_mixture(phi, [len(plain), wide_count], [WIDENED], log_integral)

    def around(self, count: int, rng: np.random.Generator) -> Chosen:
        """Choose draws, and as many points from each of two wider densities; see `DrawnDensity.around`."""
        each = count // (1 + len(AROUND))
        plain = self._many[rng.permutation(len(self._many))[:each]]
        others = [self.fitted.draw(each, rng, width) for width in AROUND]
        log_integral = self._log_integral(self._many, others[0])
        return self._of_mixture(
            np.concatenate([plain, *others]), [len(plain), *map(len, others)], list(AROUND), log_integral
        )

    @property
    def _many(self) -> np.ndarray:
        """Draws from q, in unconstrained coordinates."""
        return self.phi

    def _log_integral(self, many: np.ndarray, wide: np.ndarray) -> float:
        """Return log ∫q, from draws from q and from the wider density, which is normalised."""
        log_q = self._in_coordinates(wide)
        inside = np.isfinite(log_q)
        some = many[:: max(1, len(many) // MANY)]
        forward = log_q[inside] - self.fitted.log_density(wide[inside], WIDENED)
        backward = self._in_coordinates(some) - self.fitted.log_density(some, WIDENED)
        ratio, _ = bennett_ratio(forward, backward)  # log ∫q/∫t, t within q's support
        return float(ratio + np.log(inside.mean()))

    def _of_mixture(self, phi: np.ndarray, counts: list[int], widths: list[float], log_integral: float) -> Chosen:
        """Points drawn from a mixture of q and densities of other widths; all log densities share q's normalisation."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            phi = phi[np.isfinite(self.bijection.inverse(self.bijection(phi)[0])).all(axis=1)]  # others are on a bound
        theta, jacobian = self.bijection(phi)
        log_q = self._in_coordinates(phi)
        wider = [self.fitted.log_density(phi, width) + log_integral for width in widths]
        parts = [np.log(count) + log for count, log in zip(counts, [log_q, *wider], strict=True) if count]
        mixture = np.logaddexp.reduce(parts) - np.log(sum(counts))
        return Chosen(theta, log_q - jacobian, wider[0] - jacobian, mixture - jacobian)

    def _beyond(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return draws from the fitted density that lie outside the support of q."""
        drawn = self.fitted.draw(SEARCHED, rng)
        return np.asarray(drawn[~np.isfinite(self._in_coordinates(drawn))][:count])

    def _in_coordinates(self, phi: np.ndarray) -> np.ndarray:
        """Return log q with respect to φ; −inf where it is negligible, to avoid overflow."""
        theta, jacobian = self.bijection(phi)
        density = self.log_density(theta)
        return np.where(density >= self.highest - DEEPEST, density + jacobian, -np.inf)

    def checked(
        self, known: Float[np.ndarray, "point parameter"], by_chance: MonteCarloError, limits: Limits, seed: int
    ) -> tuple[tuple[str, ...], MonteCarloError]:
        """Compare the draws with a second sampler's draws from q; see `DrawnDensity.checked`."""
        draws, log_density = (
            self.in_order(values).transpose(1, 0, 2)[:, :, None]
            for values in (self.flat, (self.at_draws + self.bijection(self.phi)[1])[:, None])
        )
        comparison = check_representation(_Explored(self), draws, known, seed, log_density=log_density[..., 0])
        if comparison.failures and (error := contradiction(self)):
            raise error
        doubts = (f"these are not draws of the given density: {failure}" for failure in comparison.failures)
        return tuple(doubts), by_chance


class _Explored(Target):
    """q as a target of a sampler, in the coordinates and with the prior of the true posterior."""

    def __init__(self, drawn: DensityOfDraws) -> None:
        self.drawn, self.names, self.bijection = drawn, drawn.posterior.names, drawn.bijection

    @property
    def knows_prior(self) -> bool:
        return self.drawn.posterior.knows_prior

    @property
    def variances(self) -> frozenset[str]:
        return self.drawn.posterior.variances

    @property
    def content_hash(self) -> str:
        return self.drawn.posterior.content_hash

    def evaluate(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        theta, jacobian = self.bijection(phi)
        return self.drawn.log_density(theta) + jacobian, np.zeros(len(phi), dtype=bool)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        return self.drawn.log_density(theta)

    def initial(self, count: int, rng: np.random.Generator) -> np.ndarray:
        return self.drawn.posterior.initial(count, rng)
