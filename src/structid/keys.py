"""Types of a study file's numbers: a number in SI, or a text with a unit of the same dimension."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator

from structid.units import to_si


def quantity(unit: str) -> Any:
    """Type of a number in SI, given in a file as a number in SI or as a text with a unit.

    Parameters
    ----------
    unit : str
        The SI unit.

    Returns
    -------
    type
        For a field's annotation.
    """
    return Annotated[float, BeforeValidator(lambda value: to_si(value, unit))]


Seconds = Annotated[float, BeforeValidator(lambda value: to_si(value, "s"))]
Hertz = Annotated[float, BeforeValidator(lambda value: to_si(value, "Hz"))]
MetresPerSecond = Annotated[float, BeforeValidator(lambda value: to_si(value, "m/s"))]
MetresPerSecondSquared = Annotated[float, BeforeValidator(lambda value: to_si(value, "m/s^2"))]
Fraction = Annotated[float, BeforeValidator(lambda value: to_si(value, ""))]
