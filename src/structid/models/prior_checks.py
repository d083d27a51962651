"""Priors that a hysteretic model cannot have: another unit, or values that are not physical."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from structid.errors import InputError
from structid.models.hysteretic_parameters import PARAMETER_UNITS
from structid.probability.space import ParameterSpace
from structid.units import to_si

PHYSICAL_RANGES: Mapping[str, tuple[float, float]] = {
    "mass": (0.0, np.inf),
    "stiffness": (0.0, np.inf),
    "damping": (0.0, np.inf),
    "damping_ratio": (0.0, np.inf),
    "alpha": (0.0, 1.0),
    "exponent": (0.0, np.inf),
}
"""In SI, ends included."""

DRAWS = 512
"""Draws of the prior by which it is judged."""

TOLERATED = 0.01
"""Share of the prior that may lie outside a range: the tail of a normal prior whose bound nobody wrote."""


def check_value(where: str, name: str, value: float) -> None:
    """Refuse a value that is not physical.

    Parameters
    ----------
    where : str
        The argument, for the message.
    name : str
        The parameter, without the number of a storey.
    value : float
        In SI.

    Raises
    ------
    InputError
        If it lies outside `PHYSICAL_RANGES`.
    """
    low, high = PHYSICAL_RANGES.get(name, (-np.inf, np.inf))
    if not low <= value <= high:
        raise InputError(where, f"{value:g}", _range_in_words(low, high))


def check_priors(space: ParameterSpace, free: Sequence[str]) -> None:
    """Refuse priors in a unit of another dimension, and those of which a good part is not physical.

    Parameters
    ----------
    space : ParameterSpace
        The unknown parameters.
    free : sequence of str
        The model's free parameters.

    Raises
    ------
    InputError
        For the first that is wrong.
    """
    for name in set(free) & set(space.names):
        unit, own = PARAMETER_UNITS.get(_plain(name), ""), space.marginals[name].unit
        if own and _plain(name) not in ("beta", "gamma"):
            to_si(f"1 {own}", unit, f"unit of the prior of '{name}'")
    draws = space.sample(DRAWS, 0, "sobol")
    values = dict(zip(free, np.asarray(draws.columns(free)).T, strict=True))
    for name, value in values.items():
        low, high = PHYSICAL_RANGES.get(_plain(name), (-np.inf, np.inf))
        outside = float(np.mean((value < low) | (value > high)))
        if outside > TOLERATED:
            raise InputError(
                f"the prior of '{name}'",
                f"one of which {outside:.0%} lies outside {_range_in_words(low, high)}",
                f"a prior within {_range_in_words(low, high)}",
                "Bound it with low and high, and check its unit.",
            )


def unstable_share(values: Mapping[str, np.ndarray]) -> float:
    """Give the share of draws in which |γ| > β, where the response need not stay bounded.

    Parameters
    ----------
    values : mapping of str to ndarray, shape (run,)
        Parameters of one spring in SI, those of ``beta``, ``gamma`` and ``gamma_ratio`` that are known.

    Returns
    -------
    float
        From 0 to 1; 0 where γ and β are not both known.
    """
    if "gamma_ratio" in values:
        return float(np.mean(np.abs(values["gamma_ratio"]) > 1.0))
    if {"beta", "gamma"} <= set(values):
        return float(np.mean(np.abs(values["gamma"]) > values["beta"]))
    return 0.0


def _plain(name: str) -> str:
    """Name without the number of a storey."""
    base, _, number = name.rpartition("_")
    return base if number.isdigit() else name


def _range_in_words(low: float, high: float) -> str:
    return f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and above"
