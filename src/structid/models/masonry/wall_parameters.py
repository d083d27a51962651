"""Parameters of a wall that may be unknown, with their units and checks of values and priors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from structid.core.errors import InputError
from structid.core.units import factor_of
from structid.models.hysteretic.hysteretic_parameters import finite_number
from structid.probability.space import ParameterSpace

PARAMETER_UNITS: Mapping[str, str] = {
    "normal_energy": "N/m",
    "normal_strength": "Pa",
    "tangential_energy": "N/m",
    "tangential_strength": "Pa",
    "friction": "",
    "damping_ratio": "",
}
"""SI units of φ_n, σ_max, φ_t, τ_max, μ, ζ."""
OPTIONAL = ("friction", "damping_ratio")
"""Parameters with a default value, which may be zero."""


def check_value(name: str, value: Any) -> None:
    """Refuse an invalid value of a parameter."""
    where = f"MasonryWall.{name}"
    if value is None:
        raise InputError(
            where,
            "the parameter has no value and is not free",
            f"a number in {PARAMETER_UNITS[name]}, or the name of the parameter in the argument free",
        )
    number = finite_number(where, value)
    if number < 0.0 or (number == 0.0 and name not in OPTIONAL):
        raise InputError(where, f"{number:g}", "a number of 0 or more" if name in OPTIONAL else "a positive number")


def check_priors_of(free: tuple[str, ...], space: ParameterSpace) -> None:
    """Refuse priors with a wrong unit or with values that are not positive."""
    for name in set(free) & set(space.names):
        if unit := space.marginals[name].unit:
            factor_of(unit, PARAMETER_UNITS[name], f"unit of the prior of '{name}'")
    low = np.asarray(space.sample(512, 0, "sobol").columns(free)).min(axis=0, initial=np.inf)
    for name, least in zip(free, low, strict=True):
        if least <= 0.0:
            cure = "Give the prior a positive lower bound (low), and check its unit."
            raise InputError(f"the prior of '{name}'", f"values down to {least:g}", "positive values only", cure)
