"""Parameters of hysteretic models: SI units and common checks."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from structid.core.errors import InputError, suggestion

PARAMETER_UNITS = {
    "mass": "kg",
    "stiffness": "N/m",
    "damping_ratio": "",
    "damping": "N*s/m",
    "alpha": "",
    "beta": "1/m",
    "gamma": "1/m",
    "gamma_ratio": "",
    "exponent": "",
    "amplitude": "",
    "delta_a": "kg/J",
    "delta_nu": "kg/J",
    "delta_eta": "kg/J",
    "zeta0": "",
    "p": "kg/J",
    "q": "",
    "psi0": "m",
    "delta_psi": "m*kg/J",
    "lambda_": "",
    "asymmetry": "",
    "force_offset": "N",
    "initial_displacement": "m",
    "initial_velocity": "m/s",
    "initial_hysteretic_displacement": "m",
}
"""SI unit of every parameter; β and γ are in m⁻ⁿ, written 1/m for n = 1."""

LATER_TERMS = {"asymmetry": 1.0, "force_offset": 0.0}
"""Parameters that the first stores did not have, with the values at which they have no effect."""

DEFAULT_SUBSTEPS = 3
"""Integration steps per sample, with a velocity error below 1e-4 of the velocity norm in the benchmark study."""


def check_free(model: str, free: Any, known_names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the free names as a tuple; refuse names that the model does not have."""
    names = (free,) if isinstance(free, str) else tuple(free)
    for name in names:
        if name not in known_names:
            raise InputError(
                f"{model}.free",
                f"the model has no parameter '{name}'",
                ", ".join(known_names),
                suggestion(name, known_names),
            )
    if len(set(names)) < len(names):
        raise InputError(f"{model}.free", f"{list(names)}", "each name once")
    return names


def finite_number(where: str, value: Any) -> float:
    """Return a value as a finite float."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(where, f"{value!r}", "a number in SI", "To let the parameter vary, name it in free.") from None
    if not np.isfinite(number):
        raise InputError(where, f"{number}", "a finite number")
    return number


def parameter_unit(name: str, given: Mapping[str, Any], unknown: Collection[str]) -> str | None:
    """Return the SI unit of a parameter in a study; the unit m⁻ⁿ of β and γ is known only if n is known."""
    if name not in ("beta", "gamma"):
        return PARAMETER_UNITS.get(name)
    exponent = given.get("exponent")
    if any(n.startswith("exponent") for n in unknown) or isinstance(exponent, tuple):
        return ""  # a plain number in SI
    return unit_of_shape(1.0 if exponent is None else exponent)


def unit_of_shape(exponent: float) -> str:
    """Return the SI unit of β and γ for a known exponent."""
    return "1/m" if exponent == 1.0 else f"1/m^{exponent:g}"


def refuse_units_of_shapes(table: Any) -> Any:
    """Refuse a unit for β and γ if n is not 1: they are in m⁻ⁿ, so the unit would scale them wrongly."""
    if isinstance(table, dict) and table.get("exponent", 1) not in (1, 1.0):
        for name in ("beta", "gamma"):
            if isinstance(table.get(name), str):
                raise InputError(
                    name, f"{name} = '{table[name]}' with an exponent that is not 1", "a plain number in m^-n"
                )
    return table
