"""What tables of a study file are made of: strict tables, and numbers in SI or texts with a unit of the same dimension."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict

from structid.core.units import to_si


class Section(BaseModel):
    """A table of the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=())


def quantity(unit: str) -> Any:
    """Type of a number in SI, given in a file as a number in SI or as a text with a unit."""
    return Annotated[float, BeforeValidator(lambda value: to_si(value, unit))]


Seconds = Annotated[float, BeforeValidator(lambda value: to_si(value, "s"))]
Hertz = Annotated[float, BeforeValidator(lambda value: to_si(value, "Hz"))]
MetresPerSecond = Annotated[float, BeforeValidator(lambda value: to_si(value, "m/s"))]
MetresPerSecondSquared = Annotated[float, BeforeValidator(lambda value: to_si(value, "m/s^2"))]
Fraction = Annotated[float, BeforeValidator(lambda value: to_si(value, ""))]
