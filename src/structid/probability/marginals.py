"""Marginal distributions with units: given by moments or native parameters, each optionally truncated.

SciPy gives the cdf and quantile on the host, NumPyro the log density and cdf inside JAX; truncation, which NumPyro lacks
for half of them, is the thin layer here: with F the untruncated cdf,

    log f_[a,b](x) = log f(x) − log(F(b) − F(a)),    F_[a,b](x) = (F(x) − F(a)) / (F(b) − F(a)).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.optimize
import scipy.special
import scipy.stats

from structid.errors import InputError
from structid.units import factor

SMALLEST_MASS = 1e-6
"""A truncation that leaves less of the distribution than this is taken for a mistake."""


@dataclass(frozen=True, eq=False)
class Marginal:
    """One parameter's prior distribution. Numbers in the constructor are in `unit`; everything it returns is in SI.

    Make one with `Uniform`, `Normal`, `LogNormal`, `Gamma`, `Beta`, `Weibull`, `Gumbel` or `Frozen`.

    Parameters
    ----------
    family : str
        Name of the family.
    base : scipy.stats frozen distribution
        The untruncated distribution, in `unit`.
    numpyro_name : str
        The NumPyro distribution with the same law, empty for none.
    numpyro_parameters : dict
        Its parameters.
    low, high : float
        Truncation, in `unit`; infinite for none.
    unit : str
        Unit of the parameter.
    """

    family: str
    base: Any
    numpyro_name: str
    numpyro_parameters: dict[str, float]
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
                "Exchange them.",
            )
        if not self._mass > SMALLEST_MASS:
            raise InputError(
                f"{self.family}(low, high)",
                f"[{self.low:g}, {self.high:g}] holds {self._mass:.1e} of the distribution with mean {self.base.mean():g} "
                f"and sd {self.base.std():g}",
                f"a truncation that keeps more than {SMALLEST_MASS:g} of it",
                "Check the units of the bounds and of the moments.",
            )

    # --- SI face ------------------------------------------------------------------------------------------------

    @functools.cached_property
    def _factor(self) -> float:
        return factor(self.unit)

    @functools.cached_property
    def _mass(self) -> float:
        # In the upper tail the difference of survival functions keeps the digits.
        lower = self.base.cdf(self.high) - self.base.cdf(self.low)
        upper = self.base.sf(self.low) - self.base.sf(self.high)
        return float(max(lower, upper))

    @functools.cached_property
    def support(self) -> tuple[float, float]:
        """Smallest and largest value in SI."""
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
        # In the upper half by the survival function, so that far tails keep their digits.
        upper = self.base.sf(self.low) - self.base.sf(y)
        lower = self.base.cdf(y) - self.base.cdf(self.low)
        return np.clip(np.where(self.base.cdf(y) > 0.5, upper, lower) / self._mass, 0.0, 1.0)

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
        below, above = self.base.cdf(self.low), self.base.sf(self.high)
        # From whichever end is nearer, so that both tails keep their digits.
        from_below = self.base.ppf(np.clip(below + p * self._mass, 0.0, 1.0))
        from_above = self.base.isf(np.clip(above + (1.0 - p) * self._mass, 0.0, 1.0))
        y = np.where(below + p * self._mass < 0.5, from_below, from_above)
        return np.clip(y, self.low, self.high) * self._factor

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
            return np.where(inside, self.base.logpdf(y), -np.inf) - np.log(self._mass) - np.log(self._factor)

    @functools.cached_property
    def moments(self) -> tuple[float, float]:
        """Mean and standard deviation in SI, after truncation."""
        if np.isinf(self.low) and np.isinf(self.high):
            return float(self.base.mean()) * self._factor, float(self.base.std()) * self._factor
        nodes, weights = scipy.special.roots_legendre(400)
        # Sines crowd the nodes towards both ends, where a quantile function is steep.
        angle = 0.25 * np.pi * (nodes + 1.0)
        x = self.quantile(np.sin(angle) ** 2)
        weight = 0.25 * np.pi * weights * np.sin(2 * angle)
        mean = float(np.sum(weight * x))
        return mean, float(np.sqrt(np.sum(weight * (x - mean) ** 2)))

    # --- JAX face -----------------------------------------------------------------------------------------------

    @functools.cached_property
    def _numpyro(self) -> Any:
        import numpyro.distributions

        return getattr(numpyro.distributions, self.numpyro_name)(**self.numpyro_parameters)

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
        from structid.device import jnp

        low, high = self.support
        inside = (x >= low) & (x <= high)
        # A safe value stands in outside, so that no NaN enters the gradient.
        y = jnp.where(inside, x, self._safe_value) / self._factor
        log_density = (
            self._numpyro.log_prob(y)
            if self.numpyro_name
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
        from structid.device import jnp

        y = jnp.clip(x, *self.support) / self._factor
        cdf = self._numpyro.cdf(y) if self.numpyro_name else _host_function(self.base.cdf, self.base.pdf)(y)
        return jnp.clip((cdf - self.base.cdf(self.low)) / self._mass, 0.0, 1.0)

    @functools.cached_property
    def _safe_value(self) -> float:
        return float(self.quantile(np.array(0.5)))

    def describe(self) -> dict[str, Any]:
        """Everything that defines the marginal, for hashes and reports.

        Returns
        -------
        dict
            Family, native parameters of the untruncated law, bounds and unit.
        """
        parameters: dict[str, Any] = dict(self.numpyro_parameters)
        if not parameters:
            parameters = {"args": repr(self.base.args), "kwds": repr(self.base.kwds)}
        return {"family": self.family, **parameters, "low": self.low, "high": self.high, "unit": self.unit}

    def to_plain(self) -> dict[str, Any]:
        """Give everything `from_plain` needs, as JSON can say it.

        Returns
        -------
        dict
            The law's name in SciPy with its arguments, and the fields of the marginal.
        """
        return {
            "family": self.family,
            "scipy": [self.base.dist.name, [float(a) for a in self.base.args], {k: float(v) for k, v in self.base.kwds.items()}],
            "numpyro": [self.numpyro_name, self.numpyro_parameters],
            "low": self.low,
            "high": self.high,
            "unit": self.unit,
        }  # fmt: skip

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Marginal:
        """Make a marginal again from what `to_plain` said.

        Parameters
        ----------
        plain : dict
            The description.

        Returns
        -------
        Marginal
            The same law.
        """
        name, arguments, keywords = plain["scipy"]
        base = getattr(scipy.stats, name)(*arguments, **keywords)
        numpyro_name, parameters = plain["numpyro"]
        return cls(plain["family"], base, numpyro_name, parameters, plain["low"], plain["high"], plain["unit"])

    def __str__(self) -> str:
        inside = ", ".join(f"{k} {v:.6g}" for k, v in self.numpyro_parameters.items())
        cut = ""
        if self.family != "Uniform" and np.isfinite([self.low, self.high]).any():
            cut = f", truncated to [{self.low:g}, {self.high:g}]".replace("[-inf, ", "(−∞, ").replace(", inf]", ", ∞)")
        return f"{self.family}({inside}){cut}{' ' + self.unit if self.unit else ''}"


def _slope(function: Callable[..., Any]) -> Callable[[np.ndarray], np.ndarray]:
    def slope(y: np.ndarray) -> np.ndarray:
        h = 6e-6 * np.maximum(np.abs(y), 1e-3)
        return (function(y + h) - function(y - h)) / (2 * h)

    return slope


def _host_function(function: Callable[..., Any], derivative: Callable[..., Any]) -> Callable[[Any], Any]:
    """Call a NumPy function from JAX, with its derivative for gradients."""
    import jax

    def on_host(f: Callable[..., Any], y: Any) -> Any:
        shape = jax.ShapeDtypeStruct(y.shape, y.dtype)
        return jax.pure_callback(
            lambda v: np.asarray(f(np.asarray(v)), dtype=np.float64), shape, y, vmap_method="expand_dims"
        )

    @jax.custom_jvp
    def call(y: Any) -> Any:
        return on_host(function, y)

    @call.defjvp
    def _(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
        (y,), (dy,) = primals, tangents
        return call(y), on_host(derivative, y) * dy

    return call


def _one_way(family: str, ways: dict[str, dict[str, float | None]]) -> str:
    """Which of several complete sets of parameters was given; exactly one is allowed."""
    given = [name for name, values in ways.items() if any(v is not None for v in values.values())]
    complete = [name for name in given if all(v is not None for v in ways[name].values())]
    if len(given) != 1 or len(complete) != 1:
        came = ", ".join(k for values in ways.values() for k, v in values.items() if v is not None) or "nothing"
        raise InputError(family, f"{came}", " or ".join("(" + ", ".join(v) + ")" for v in ways.values()))
    return complete[0]


def _positive(family: str, **values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{family}({name})", f"{value}", "a positive number")


def _bounds(low: float | None, high: float | None) -> tuple[float, float]:
    return (-np.inf if low is None else float(low)), (np.inf if high is None else float(high))


def Uniform(low: float, high: float, unit: str = "") -> Marginal:
    """Uniform distribution on [low, high].

    Parameters
    ----------
    low, high : float
        Bounds, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.
    """
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(
            "Uniform(low, high)",
            f"low = {low:g} and high = {high:g}",
            "finite numbers with low < high",
            "Exchange them.",
        )
    base = scipy.stats.uniform(low, high - low)
    return Marginal("Uniform", base, "Uniform", {"low": float(low), "high": float(high)}, float(low), float(high), unit)


def Normal(mean: float, sd: float, low: float | None = None, high: float | None = None, unit: str = "") -> Marginal:
    """Normal distribution, optionally truncated; the moments are those before truncation.

    Parameters
    ----------
    mean, sd : float
        Moments, in `unit`.
    low, high : float, optional
        Truncation, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.
    """
    _positive("Normal", sd=sd)
    parameters = {"loc": float(mean), "scale": float(sd)}
    return Marginal("Normal", scipy.stats.norm(mean, sd), "Normal", parameters, *_bounds(low, high), unit)


def LogNormal(
    mean: float | None = None,
    sd: float | None = None,
    *,
    log_mean: float | None = None,
    log_sd: float | None = None,
    low: float | None = None,
    high: float | None = None,
    unit: str = "",
) -> Marginal:
    """Lognormal distribution, by its own moments or by those of its logarithm; optionally truncated.

    Parameters
    ----------
    mean, sd : float, optional
        Moments, in `unit`, before truncation.
    log_mean, log_sd : float, optional
        Moments of the logarithm of the number in `unit`.
    low, high : float, optional
        Truncation, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.
    """
    way = _one_way("LogNormal", {"moments": {"mean": mean, "sd": sd}, "log": {"log_mean": log_mean, "log_sd": log_sd}})
    if way == "moments":
        assert mean is not None and sd is not None
        _positive("LogNormal", mean=mean, sd=sd)
        # sd_log² = log(1 + sd²/mean²),  mean_log = log mean − sd_log²/2
        log_sd = float(np.sqrt(np.log1p((sd / mean) ** 2)))
        log_mean = float(np.log(mean)) - 0.5 * log_sd**2
    assert log_mean is not None and log_sd is not None
    _positive("LogNormal", log_sd=log_sd)
    base = scipy.stats.lognorm(log_sd, scale=np.exp(log_mean))
    return Marginal("LogNormal", base, "LogNormal", {"loc": log_mean, "scale": log_sd}, *_bounds(low, high), unit)


def Gamma(
    mean: float | None = None,
    sd: float | None = None,
    *,
    shape: float | None = None,
    rate: float | None = None,
    low: float | None = None,
    high: float | None = None,
    unit: str = "",
) -> Marginal:
    """Gamma distribution, by moments or by shape and rate; optionally truncated.

    Parameters
    ----------
    mean, sd : float, optional
        Moments, in `unit`, before truncation.
    shape, rate : float, optional
        Shape, and rate in 1/`unit`.
    low, high : float, optional
        Truncation, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.
    """
    way = _one_way("Gamma", {"moments": {"mean": mean, "sd": sd}, "native": {"shape": shape, "rate": rate}})
    if way == "moments":
        assert mean is not None and sd is not None
        _positive("Gamma", mean=mean, sd=sd)
        shape, rate = (mean / sd) ** 2, mean / sd**2
    assert shape is not None and rate is not None
    _positive("Gamma", shape=shape, rate=rate)
    parameters = {"concentration": float(shape), "rate": float(rate)}
    return Marginal("Gamma", scipy.stats.gamma(shape, scale=1 / rate), "Gamma", parameters, *_bounds(low, high), unit)


def Beta(
    mean: float | None = None,
    sd: float | None = None,
    *,
    a: float | None = None,
    b: float | None = None,
    low: float | None = None,
    high: float | None = None,
    unit: str = "",
) -> Marginal:
    """Beta distribution on [0, 1], by moments or by its two shapes; optionally truncated within.

    Parameters
    ----------
    mean, sd : float, optional
        Moments before truncation.
    a, b : float, optional
        Shapes.
    low, high : float, optional
        Truncation.
    unit : str
        Unit of the parameter; with ``"%"`` the interval is 0 to 1 %.

    Returns
    -------
    Marginal
        The distribution.
    """
    way = _one_way("Beta", {"moments": {"mean": mean, "sd": sd}, "native": {"a": a, "b": b}})
    if way == "moments":
        assert mean is not None and sd is not None
        if not (0 < mean < 1 and 0 < sd**2 < mean * (1 - mean)):
            raise InputError("Beta(mean, sd)", f"mean {mean}, sd {sd}", "0 < mean < 1 and sd² < mean (1 − mean)")
        total = mean * (1 - mean) / sd**2 - 1
        a, b = mean * total, (1 - mean) * total
    assert a is not None and b is not None
    _positive("Beta", a=a, b=b)
    parameters = {"concentration1": float(a), "concentration0": float(b)}
    return Marginal("Beta", scipy.stats.beta(a, b), "Beta", parameters, *_bounds(low, high), unit)


def Weibull(
    mean: float | None = None,
    sd: float | None = None,
    *,
    shape: float | None = None,
    scale: float | None = None,
    low: float | None = None,
    high: float | None = None,
    unit: str = "",
) -> Marginal:
    """Weibull distribution (of minima, on positive numbers), by moments or shape and scale; optionally truncated.

    Parameters
    ----------
    mean, sd : float, optional
        Moments, in `unit`, before truncation.
    shape, scale : float, optional
        Shape, and scale in `unit`.
    low, high : float, optional
        Truncation, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.
    """
    way = _one_way("Weibull", {"moments": {"mean": mean, "sd": sd}, "native": {"shape": shape, "scale": scale}})
    if way == "moments":
        assert mean is not None and sd is not None
        _positive("Weibull", mean=mean, sd=sd)
        # (sd/mean)² + 1 = Γ(1 + 2/k) / Γ(1 + 1/k)², which falls with k
        target = np.log1p((sd / mean) ** 2)
        gap = lambda k: scipy.special.gammaln(1 + 2 / k) - 2 * scipy.special.gammaln(1 + 1 / k) - target  # noqa: E731
        if not gap(0.1) > 0 > gap(1e4):
            raise InputError("Weibull(mean, sd)", f"mean {mean:g}, sd {sd:g}", "a ratio sd/mean between 2e-4 and 400")
        shape = float(scipy.optimize.brentq(gap, 0.1, 1e4, xtol=1e-14))
        scale = mean / float(scipy.special.gamma(1 + 1 / shape))
    assert shape is not None and scale is not None
    _positive("Weibull", shape=shape, scale=scale)
    parameters = {"scale": float(scale), "concentration": float(shape)}
    return Marginal(
        "Weibull", scipy.stats.weibull_min(shape, scale=scale), "Weibull", parameters, *_bounds(low, high), unit
    )


def Gumbel(
    mean: float | None = None,
    sd: float | None = None,
    *,
    location: float | None = None,
    scale: float | None = None,
    low: float | None = None,
    high: float | None = None,
    unit: str = "",
) -> Marginal:
    """Gumbel distribution of maxima, by moments or location and scale; optionally truncated.

    Parameters
    ----------
    mean, sd : float, optional
        Moments, in `unit`, before truncation.
    location, scale : float, optional
        Mode and scale, in `unit`.
    low, high : float, optional
        Truncation, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.
    """
    way = _one_way("Gumbel", {"moments": {"mean": mean, "sd": sd}, "native": {"location": location, "scale": scale}})
    if way == "moments":
        assert mean is not None and sd is not None
        _positive("Gumbel", sd=sd)
        scale = sd * np.sqrt(6.0) / np.pi
        location = mean - np.euler_gamma * scale
    assert location is not None and scale is not None
    _positive("Gumbel", scale=scale)
    parameters = {"loc": float(location), "scale": float(scale)}
    return Marginal("Gumbel", scipy.stats.gumbel_r(location, scale), "Gumbel", parameters, *_bounds(low, high), unit)


def Frozen(distribution: Any, low: float | None = None, high: float | None = None, unit: str = "") -> Marginal:
    """Any frozen continuous distribution of SciPy, optionally truncated.

    Inside JAX it is evaluated on the host, which is slow; the gradient of the log density is a central difference.

    Parameters
    ----------
    distribution : scipy.stats frozen distribution
        Such as ``scipy.stats.triang(0.5, 2.0, 1.0)``, in `unit`.
    low, high : float, optional
        Truncation, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.
    """
    if not all(hasattr(distribution, name) for name in ("logpdf", "cdf", "ppf", "sf", "isf", "support")):
        raise InputError("Frozen(distribution)", f"{distribution!r}", "a frozen continuous distribution of scipy.stats")
    name = getattr(getattr(distribution, "dist", None), "name", "Frozen")
    return Marginal(name, distribution, "", {}, *_bounds(low, high), unit)
