"""Parameters of hysteretic models: their SI units, and the checks that models share."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.errors import InputError, suggestion

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
    "initial_displacement": "m",
    "initial_velocity": "m/s",
    "initial_hysteretic_displacement": "m",
}
"""SI unit of every parameter; β and γ are in m⁻ⁿ, written 1/m for n = 1."""

DEFAULT_SUBSTEPS = 3
"""Steps per sample: the velocity error on the benchmark study is below 1e-4 of its norm (see docs/benchmarks.md)."""


def check_free(model: str, free: Any, known_names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the free names as a tuple if the model has them all.

    Parameters
    ----------
    model : str
        The model's name, for the message.
    free : sequence of str
        The names.
    known_names : tuple of str
        The model's parameters.

    Returns
    -------
    tuple of str
        The names.

    Raises
    ------
    InputError
        If one is unknown or repeated.
    """
    names = (free,) if isinstance(free, str) else tuple(free)
    for name in names:
        if name not in known_names:
            raise InputError(
                f"{model}.free",
                f"the parameter '{name}', which the model lacks",
                ", ".join(known_names),
                suggestion(name, known_names),
            )
    if len(set(names)) < len(names):
        raise InputError(f"{model}.free", f"{list(names)}", "each name once")
    return names


def finite_number(where: str, value: Any) -> float:
    """Return a value as a finite float.

    Parameters
    ----------
    where : str
        The argument, for the message.
    value : object
        What came.

    Returns
    -------
    float
        The number.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(where, f"{value!r}", "a number in SI", "To let it vary name it in free.") from None
    if not np.isfinite(number):
        raise InputError(where, f"{number}", "a finite number")
    return number
