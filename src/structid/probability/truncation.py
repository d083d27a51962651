"""The general marginal distribution: any SciPy distribution with a unit and optional truncation, on the host and inside JAX.

SciPy gives the cdf and the quantiles on the host; `jax_distributions` gives the log density and the cdf inside JAX. With F the
untruncated cdf,

    log f_[a,b](x) = log f(x) − log(F(b) − F(a)),    F_[a,b](x) = (F(x) − F(a)) / (F(b) − F(a)).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from structid.core.errors import InputError
from structid.core.units import factor
from structid.probability.quadrature import probability_nodes
from structid.probability.quantiles import QUANTILES

SMALLEST_MASS = 1e-6
"""Smallest probability that a truncation may keep; a smaller probability is rejected as a mistake."""


def out_of_order(low: float, high: float) -> str:
    """Advice on bounds in the wrong order."""
    if low > high:
        return "Exchange the bounds."
    return "Give a known value to the model." if low == high else ""


@dataclass(frozen=True, eq=False)
class Marginal:
    """Prior distribution of one parameter. Numbers in the constructor are in `unit`; all results are in SI.

    Create a marginal with `Uniform`, `Normal`, `LogNormal`, `Gamma`, `Beta`, `Weibull`, `Gumbel` or `Frozen`.

    Parameters
    ----------
    family : str
        Name of the family.
    base : scipy.stats frozen distribution
        The untruncated distribution, in `unit`.
    parameters : dict
        Native parameters, for `JAX_DISTRIBUTIONS`; empty if the family is not in this table.
    low, high : float
        Truncation, in `unit`; infinite for none.
    unit : str
        Unit of the parameter.
    """

    family: str
    base: Any
    parameters: dict[str, float]
    low: float
    high: float
    unit: str

    def __post_init__(self) -> None:
        factor(self.unit)
        if not self.low < self.high:
            raise InputError(
                f"{self.family}(low, high)",
                f"low = {self.low:g} and high = {self.high:g}",
                "low < high",
                out_of_order(self.low, self.high),
            )
        if not self._mass > SMALLEST_MASS:
            raise InputError(
                f"{self.family}(low, high)",
                f"[{self.low:g}, {self.high:g}] contains {self._mass:.1e} of the distribution with mean {self.base.mean():g} "
                f"and sd {self.base.std():g}",
                f"a truncation that keeps more than {SMALLEST_MASS:g} of it",
                "Check the units of the bounds and of the moments.",
            )

    # --- on the host --------------------------------------------------------------------------------------------

    @functools.cached_property
    def _factor(self) -> float:
        return factor(self.unit)

    @functools.cached_property
    def _mass(self) -> float:
        # In the upper tail, the difference of survival functions is more exact.
        lower = self.base.cdf(self.high) - self.base.cdf(self.low)
        upper = self.base.sf(self.low) - self.base.sf(self.high)
        return float(max(lower, upper))

    @functools.cached_property
    def _cut_off(self) -> tuple[float, float]:
        """Probabilities below and above the bounds, before truncation."""
        return float(self.base.cdf(self.low)), float(self.base.sf(self.high))

    @functools.cached_property
    def support(self) -> tuple[float, float]:
        """Smallest and largest value, in SI."""
        low, high = self.base.support()
        return float(max(low, self.low)) * self._factor, float(min(high, self.high)) * self._factor

    def cdf(self, x: np.ndarray) -> np.ndarray:
        """Cumulative distribution.

        Parameters
        ----------
        x : ndarray
            Values in SI.

        Returns
        -------
        ndarray
            Probabilities.
        """
        y = np.clip(np.asarray(x) / self._factor, self.low, self.high)
        # The survival function in the upper half, so that both tails are exact.
        upper = self.base.sf(self.low) - self.base.sf(y)
        lower = self.base.cdf(y) - self.base.cdf(self.low)
        probability: np.ndarray = np.clip(np.where(self.base.cdf(y) > 0.5, upper, lower) / self._mass, 0.0, 1.0)
        return probability

    def quantile(self, p: np.ndarray) -> np.ndarray:
        """Inverse of the cumulative distribution.

        Parameters
        ----------
        p : ndarray
            Probabilities.

        Returns
        -------
        ndarray
            Values in SI.
        """
        p = np.asarray(p, dtype=np.float64)
        below, above = self._cut_off
        lower, upper = below + p * self._mass, above + (1.0 - p) * self._mass
        from_below, from_above = self._untruncated_quantiles(np.clip(lower, 0.0, 1.0), np.clip(upper, 0.0, 1.0))
        # From the nearer end, so that both tails are exact.
        y = np.where(lower < 0.5, from_below, from_above)
        values: np.ndarray = np.clip(y, self.low, self.high) * self._factor
        return values

    def _untruncated_quantiles(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values with the given probabilities below them, and above them, before truncation."""
        if self.parameters and self.family in QUANTILES:
            of_family = QUANTILES[self.family]
            return of_family.from_below(lower, self.parameters), of_family.from_above(upper, self.parameters)
        return self.base.ppf(lower), self.base.isf(upper)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Logarithm of the density.

        Parameters
        ----------
        x : ndarray
            Values in SI.

        Returns
        -------
        ndarray
            Log density with respect to the SI value; −inf outside the support.
        """
        y = np.asarray(x, dtype=np.float64) / self._factor
        inside = (y >= self.low) & (y <= self.high)
        with np.errstate(divide="ignore"):
            density: np.ndarray = (
                np.where(inside, self.base.logpdf(y), -np.inf) - np.log(self._mass) - np.log(self._factor)
            )
        return density

    @functools.cached_property
    def moments(self) -> tuple[float, float]:
        """Mean and standard deviation in SI, after truncation."""
        if np.isinf(self.low) and np.isinf(self.high):
            return float(self.base.mean()) * self._factor, float(self.base.std()) * self._factor
        p, weight = probability_nodes(400)
        x = self.quantile(p)
        mean = float(np.sum(weight * x))
        return mean, float(np.sqrt(np.sum(weight * (x - mean) ** 2)))

    # --- inside JAX ---------------------------------------------------------------------------------------------

    def jax_log_density(self, x: Any) -> Any:
        """Log density inside JAX, with gradients.

        Parameters
        ----------
        x : jax.Array
            Values in SI.

        Returns
        -------
        jax.Array
            Log density with respect to the SI value; −inf outside the support.
        """
        from structid.engine.device import jnp
        from structid.probability.jax_distributions import JAX_DISTRIBUTIONS

        low, high = self.support
        inside = (x >= low) & (x <= high)
        # Outside the support a safe value is used instead, so that the gradient has no NaN.
        y = jnp.where(inside, x, self._safe_value) / self._factor
        log_density = (
            JAX_DISTRIBUTIONS[self.family].log_density(y, self.parameters)
            if self.parameters
            else _host_function(self.base.logpdf, _slope(self.base.logpdf))(y)
        )
        return jnp.where(inside, log_density - np.log(self._mass * self._factor), -jnp.inf)

    def jax_cdf(self, x: Any) -> Any:
        """Cumulative distribution inside JAX, with gradients.

        Parameters
        ----------
        x : jax.Array
            Values in SI.

        Returns
        -------
        jax.Array
            Probabilities.
        """
        from structid.engine.device import jnp
        from structid.probability.jax_distributions import JAX_DISTRIBUTIONS

        y = jnp.clip(x, *self.support) / self._factor
        if self.parameters:
            cdf = JAX_DISTRIBUTIONS[self.family].cdf(y, self.parameters)
        else:
            cdf = _host_function(self.base.cdf, self.base.pdf)(y)
        return jnp.clip((cdf - self.base.cdf(self.low)) / self._mass, 0.0, 1.0)

    @functools.cached_property
    def _safe_value(self) -> float:
        return float(self.quantile(np.array(0.5)))

    def describe(self) -> dict[str, Any]:
        """Everything that defines the marginal, for hashes and reports.

        Returns
        -------
        dict
            Family, native parameters of the untruncated distribution, bounds and unit.
        """
        parameters: dict[str, Any] = dict(self.parameters)
        if not parameters:
            parameters = {"args": repr(self.base.args), "kwds": repr(self.base.kwds)}
        return {"family": self.family, **parameters, "low": self.low, "high": self.high, "unit": self.unit}

    def to_plain(self) -> dict[str, Any]:
        """Describe the marginal for `from_plain`, ready for JSON.

        Returns
        -------
        dict
            Name and arguments of the distribution in SciPy, and the fields of the marginal.
        """
        return {
            "family": self.family,
            "scipy": [
                self.base.dist.name,
                [float(a) for a in self.base.args],
                {k: float(v) for k, v in self.base.kwds.items()},
            ],
            "numpyro": [
                self.family if self.parameters else "",
                self.parameters,
            ],  # the name in the first layout of stores
            "low": self.low,
            "high": self.high,
            "unit": self.unit,
        }

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Marginal:
        """Rebuild a marginal from the description by `to_plain`.

        Parameters
        ----------
        plain : dict
            The description.

        Returns
        -------
        Marginal
            The same distribution.
        """
        name, arguments, keywords = plain["scipy"]
        base = getattr(scipy.stats, name)(*arguments, **keywords)
        return cls(plain["family"], base, plain["numpyro"][1], plain["low"], plain["high"], plain["unit"])

    def __str__(self) -> str:
        # Moments before truncation, as the user gave them; native parameters may be location and scale of the logarithm.
        moments = {"mean": self.base.mean(), "sd": self.base.std()}
        native_or_moments = self.parameters if self.family == "Uniform" else moments
        inside = ", ".join(f"{k} {v:.6g}" for k, v in native_or_moments.items())
        cut = ""
        if self.family != "Uniform" and np.isfinite([self.low, self.high]).any():
            cut = f", truncated to [{self.low:g}, {self.high:g}]".replace("[-inf, ", "(−∞, ").replace(", inf]", ", ∞)")
        return f"{self.family}({inside}){cut}{' ' + self.unit if self.unit else ''}"


def _slope(function: Callable[..., Any]) -> Callable[[np.ndarray], np.ndarray]:
    """Central difference of a function, (f(y + h) − f(y − h)) / 2h."""

    def slope(y: np.ndarray) -> np.ndarray:
        h = 6e-6 * np.maximum(np.abs(y), 1e-3)
        difference: np.ndarray = (function(y + h) - function(y - h)) / (2 * h)
        return difference

    return slope


def _host_function(function: Callable[..., Any], derivative: Callable[..., Any]) -> Any:
    """Call a NumPy function from JAX, with its derivative for gradients."""
    import jax

    def on_host(f: Callable[..., Any], y: Any) -> Any:
        shape = jax.ShapeDtypeStruct(y.shape, y.dtype)
        return jax.pure_callback(
            lambda v: np.asarray(f(np.asarray(v)), dtype=np.float64), shape, y, vmap_method="expand_dims"
        )

    def value(y: Any) -> Any:
        return on_host(function, y)

    def jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
        (y,), (dy,) = primals, tangents
        return call(y), on_host(derivative, y) * dy

    call = jax.custom_jvp(value)
    call.defjvp(jvp)
    return call
