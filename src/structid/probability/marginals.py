"""Families of prior distributions, defined by moments or by native parameters, with a unit and optional truncation."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.probability.truncation import Marginal, out_of_order

__all__ = ["Beta", "Frozen", "Gamma", "Gumbel", "LogNormal", "Marginal", "Normal", "Uniform", "Weibull"]


def _one_way(family: str, ways: dict[str, dict[str, float | None]]) -> str:
    """Return the name of the set of parameters that is given; refuse any input other than one complete set."""
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


@check_arguments
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

    Examples
    --------
    >>> import structid as si
    >>> print(si.Uniform(55.0, 65.0, unit="1/m"))
    Uniform(low 55, high 65) 1/m
    """
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(
            "Uniform(low, high)",
            f"low = {low:g} and high = {high:g}",
            "finite numbers with low < high",
            out_of_order(low, high) if np.isfinite([low, high]).all() else "",
        )
    base = scipy.stats.uniform(low, high - low)
    return Marginal("Uniform", base, {"low": float(low), "high": float(high)}, float(low), float(high), unit)


@check_arguments
def Normal(mean: float, sd: float, low: float | None = None, high: float | None = None, unit: str = "") -> Marginal:
    """Normal distribution, optionally truncated.

    Parameters
    ----------
    mean, sd : float
        Mean and standard deviation, in `unit`, before truncation.
    low, high : float, optional
        Truncation, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.

    Examples
    --------
    >>> import structid as si
    >>> print(si.Normal(7.42, 0.742, low=0.0, unit="kN/mm"))
    Normal(mean 7.42, sd 0.742), truncated to [0, ∞) kN/mm
    """
    _positive("Normal", sd=sd)
    parameters = {"loc": float(mean), "scale": float(sd)}
    return Marginal("Normal", scipy.stats.norm(mean, sd), parameters, *_bounds(low, high), unit)


@check_arguments
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
    """Lognormal distribution, from its own moments or from the moments of its logarithm; optionally truncated.

    Parameters
    ----------
    mean, sd : float, optional
        Moments, in `unit`, before truncation.
    log_mean, log_sd : float, optional
        Moments of the logarithm of the value in `unit`.
    low, high : float, optional
        Truncation, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.

    Examples
    --------
    >>> import structid as si
    >>> print(si.LogNormal(mean=0.063, sd=0.01, high=1.0))
    LogNormal(mean 0.063, sd 0.01), truncated to (−∞, 1]
    """
    way = _one_way("LogNormal", {"moments": {"mean": mean, "sd": sd}, "log": {"log_mean": log_mean, "log_sd": log_sd}})
    if way == "moments":
        assert mean is not None and sd is not None
        _positive("LogNormal", mean=mean, sd=sd)
        # log_sd² = log(1 + sd²/mean²),  log_mean = log mean − log_sd²/2
        log_sd = float(np.sqrt(np.log1p((sd / mean) ** 2)))
        log_mean = float(np.log(mean)) - 0.5 * log_sd**2
    assert log_mean is not None and log_sd is not None
    _positive("LogNormal", log_sd=log_sd)
    base = scipy.stats.lognorm(log_sd, scale=np.exp(log_mean))
    return Marginal("LogNormal", base, {"loc": log_mean, "scale": log_sd}, *_bounds(low, high), unit)


@check_arguments
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
    """Gamma distribution, from moments or from shape and rate; optionally truncated.

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

    Examples
    --------
    >>> import structid as si
    >>> print(si.Gamma(mean=2.0, sd=0.5, unit="mm"))
    Gamma(mean 2, sd 0.5) mm
    """
    way = _one_way("Gamma", {"moments": {"mean": mean, "sd": sd}, "native": {"shape": shape, "rate": rate}})
    if way == "moments":
        assert mean is not None and sd is not None
        _positive("Gamma", mean=mean, sd=sd)
        shape, rate = (mean / sd) ** 2, mean / sd**2
    assert shape is not None and rate is not None
    _positive("Gamma", shape=shape, rate=rate)
    parameters = {"concentration": float(shape), "rate": float(rate)}
    return Marginal("Gamma", scipy.stats.gamma(shape, scale=1 / rate), parameters, *_bounds(low, high), unit)


@check_arguments
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
    """Beta distribution on [0, 1], from moments or from its two shape parameters; optionally truncated.

    Parameters
    ----------
    mean, sd : float, optional
        Moments before truncation.
    a, b : float, optional
        Shape parameters.
    low, high : float, optional
        Truncation.
    unit : str
        Unit of the parameter. With ``"%"`` the interval is 0 to 1 %.

    Returns
    -------
    Marginal
        The distribution.

    Examples
    --------
    >>> import structid as si
    >>> print(si.Beta(mean=0.05, sd=0.02))
    Beta(mean 0.05, sd 0.02)
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
    return Marginal("Beta", scipy.stats.beta(a, b), parameters, *_bounds(low, high), unit)


@check_arguments
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
    """Weibull distribution of minima, on positive numbers, from moments or from shape and scale; optionally truncated.

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

    Examples
    --------
    >>> import structid as si
    >>> print(si.Weibull(mean=30.0, sd=5.0, unit="MPa"))
    Weibull(mean 30, sd 5) MPa
    """
    way = _one_way("Weibull", {"moments": {"mean": mean, "sd": sd}, "native": {"shape": shape, "scale": scale}})
    if way == "moments":
        assert mean is not None and sd is not None
        _positive("Weibull", mean=mean, sd=sd)
        shape, scale = _weibull_of_moments(mean, sd)
    assert shape is not None and scale is not None
    _positive("Weibull", shape=shape, scale=scale)
    parameters = {"scale": float(scale), "concentration": float(shape)}
    return Marginal("Weibull", scipy.stats.weibull_min(shape, scale=scale), parameters, *_bounds(low, high), unit)


def _weibull_of_moments(mean: float, sd: float) -> tuple[float, float]:
    """Shape k and scale from (sd/mean)² + 1 = Γ(1 + 2/k) / Γ(1 + 1/k)², which decreases with k."""
    target = np.log1p((sd / mean) ** 2)

    def gap(k: float) -> float:
        return float(scipy.special.gammaln(1 + 2 / k) - 2 * scipy.special.gammaln(1 + 1 / k) - target)

    if not gap(0.1) > 0 > gap(1e4):
        raise InputError("Weibull(mean, sd)", f"mean {mean:g}, sd {sd:g}", "a ratio sd/mean between 2e-4 and 400")
    shape = float(scipy.optimize.brentq(gap, 0.1, 1e4, xtol=1e-14))
    return shape, mean / float(scipy.special.gamma(1 + 1 / shape))


@check_arguments
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
    """Gumbel distribution of maxima, from moments or from location and scale; optionally truncated.

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

    Examples
    --------
    >>> import structid as si
    >>> print(si.Gumbel(mean=0.3, sd=0.1, unit="g"))
    Gumbel(mean 0.3, sd 0.1) g
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
    return Marginal("Gumbel", scipy.stats.gumbel_r(location, scale), parameters, *_bounds(low, high), unit)


@check_arguments
def Frozen(distribution: Any, low: float | None = None, high: float | None = None, unit: str = "") -> Marginal:
    """Any frozen continuous distribution of SciPy, optionally truncated.

    Inside JAX it is evaluated on the host, which is slow. The gradient of its log density is a central difference.

    Parameters
    ----------
    distribution : scipy.stats frozen distribution
        For example ``scipy.stats.triang(0.5, 2.0, 1.0)``, in `unit`.
    low, high : float, optional
        Truncation, in `unit`.
    unit : str
        Unit of the parameter.

    Returns
    -------
    Marginal
        The distribution.

    Examples
    --------
    >>> import structid as si
    >>> import scipy.stats
    >>> print(si.Frozen(scipy.stats.t(4, loc=1.0, scale=0.1), low=0.0))
    t(mean 1, sd 0.141421), truncated to [0, ∞)
    """
    if hasattr(distribution, "iccdf"):
        raise InputError(
            "Frozen(distribution)",
            f"{distribution!r}, which is one of SciPy's new distributions",
            "a frozen distribution of scipy.stats such as scipy.stats.norm(1.0, 2.0)",
            "Use the equivalent frozen distribution: the parameters of a new distribution cannot be stored and compared.",
        )
    if not all(hasattr(distribution, name) for name in ("logpdf", "cdf", "ppf", "sf", "isf", "support")):
        raise InputError("Frozen(distribution)", f"{distribution!r}", "a frozen continuous distribution of scipy.stats")
    name = getattr(getattr(distribution, "dist", None), "name", "Frozen")
    return Marginal(name, distribution, {}, *_bounds(low, high), unit)
