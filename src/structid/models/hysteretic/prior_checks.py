"""Checks of the priors of hysteretic models: units and physical values."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from structid.core.errors import InputError, StructidWarning
from structid.core.units import check_power_of_length, factor, factor_of
from structid.models.hysteretic.hysteretic_parameters import PARAMETER_UNITS, unit_of_shape
from structid.probability.space import ParameterSpace

PHYSICAL_RANGES: Mapping[str, tuple[float, float]] = {
    "mass": (0.0, np.inf),
    "stiffness": (0.0, np.inf),
    "damping": (0.0, np.inf),
    "damping_ratio": (0.0, 1.0),
    "alpha": (0.0, 1.0),
    "beta": (0.0, np.inf),
    "exponent": (0.0, np.inf),
    "amplitude": (0.0, np.inf),
    "delta_nu": (0.0, np.inf),
    "delta_eta": (0.0, np.inf),
    "zeta0": (0.0, 1.0),
    "p": (0.0, np.inf),
    "psi0": (0.0, np.inf),
    "lambda_": (0.0, np.inf),
    "asymmetry": (0.0, np.inf),
}
"""Ranges of physically possible parameter values in SI, including both ends."""

DRAWS = 512
"""Number of prior draws that are checked."""

TOLERATED = 0.01
"""Tolerated fraction of the prior outside a range, such as the tail of a normal prior without a bound."""


def check_value(where: str, name: str, value: float) -> None:
    """Refuse an unphysical value."""
    low, high = PHYSICAL_RANGES.get(name, (-np.inf, np.inf))
    if not low <= value <= high:
        share = f"For {value:g} %, give {value / 100.0:g}." if high == 1.0 and 1.0 < value <= 100.0 else ""
        raise InputError(where, f"{value:g}", _range_in_words(low, high), share)


def check_priors(space: ParameterSpace, free: Sequence[str], model: object) -> None:
    """Refuse priors with a wrong unit or too many unphysical values. Warn of |γ| > β."""
    for name in set(free) & set(space.names):
        unit, given_unit = PARAMETER_UNITS.get(_plain(name), ""), space.marginals[name].unit
        if given_unit and _plain(name) in ("beta", "gamma"):
            _check_unit_of_shape(name, given_unit, _exponent_of(name, free, model))
        elif given_unit:
            factor_of(given_unit, unit, f"unit of the prior of '{name}'")
    draws = space.sample(DRAWS, 0, "sobol")
    values = dict(zip(free, np.asarray(draws.columns(free)).T, strict=True))
    for name, value in values.items():
        low, high = PHYSICAL_RANGES.get(_plain(name), (-np.inf, np.inf))
        outside = float(np.mean((value < low) | (value > high)))
        if outside > TOLERATED:
            raise InputError(
                f"the prior of '{name}'",
                f"{outside:.0%} of the prior lies outside {_range_in_words(low, high)}",
                f"a prior within {_range_in_words(low, high)}",
                "Bound the prior with low and high, and check its unit.",
            )
    if question := unstable_in_words(unstable_share(space, model)):
        warnings.warn(question, StructidWarning, stacklevel=2)


def _exponent_of(name: str, free: Sequence[str], model: object) -> float | None:
    """Return the exponent of the spring to which β or γ belongs; None if it is unknown or differs between springs."""
    if any(_plain(other) == "exponent" for other in free):
        return None
    exponent = getattr(model, "exponent", 1.0)
    if not isinstance(exponent, tuple):
        return float(exponent)
    number = name.removeprefix(_plain(name)).lstrip("_")
    return float(exponent[int(number) - 1]) if number else None


def _check_unit_of_shape(name: str, own: str, exponent: float | None) -> None:
    """Refuse a unit of β or γ other than m⁻ⁿ: 1/mm would scale them by 1000, but n = 2 needs a factor of a million."""
    where = f"unit of the prior of '{name}'"
    if exponent is not None:
        factor_of(own, unit_of_shape(exponent), where)
        return
    check_power_of_length(own, where)
    if factor(own) != 1.0:
        raise InputError(
            where,
            f"'{own}' for an exponent that is unknown or varies",
            "a prior without a unit, with values in m^-n, or the unit '1/m'",
        )


def unstable_share(space: ParameterSpace, model: object) -> float:
    """Return the fraction of the prior with |γ| > β, for which the response may be unbounded."""
    free = [name for name in space.all_names if _plain(name) in _SHAPES]
    columns = np.asarray(space.sample(DRAWS, 0, "sobol").columns(free)).T if free else ()
    values = _fixed_shapes(model) | dict(zip(free, columns, strict=True))
    springs = {name.removeprefix(_plain(name)) for name in values}
    return max((_unstable_share_of(spring, values) for spring in springs), default=0.0)


def unstable_in_words(share: float) -> str:
    """Return a warning about the fraction of the prior with |γ| > β; an empty string if the fraction is tolerated."""
    if share <= TOLERATED:
        return ""
    return (
        f"In {share:.0%} of the prior |gamma| exceeds beta, so the response may grow without bound. "
        "To keep it bounded, use gamma_ratio from -1 to 1."
    )


_SHAPES = ("beta", "gamma", "gamma_ratio")


def _fixed_shapes(model: object) -> dict[str, np.ndarray]:
    """Return the fixed values of β, γ and γ/β by name; names are numbered if storeys differ."""
    fixed = {}
    for name in _SHAPES:
        value = getattr(model, name, None)
        if isinstance(value, (int, float)):
            fixed[name] = np.array([float(value)])
        elif isinstance(value, tuple):
            fixed |= {f"{name}_{j}": np.array([float(v)]) for j, v in enumerate(value, start=1)}
    return fixed


def _unstable_share_of(spring: str, values: Mapping[str, np.ndarray]) -> float:
    beta, gamma, ratio = (values.get(f"{name}{spring}", values.get(name)) for name in _SHAPES)
    if ratio is not None:
        return float(np.mean(np.abs(ratio) > 1.0))
    if beta is not None and gamma is not None:
        return float(np.mean(np.abs(gamma) > beta))
    return 0.0


def _plain(name: str) -> str:
    """Return a name without the storey number."""
    base, _, number = name.rpartition("_")
    return base if number.isdigit() else name


def _range_in_words(low: float, high: float) -> str:
    return f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and above"
