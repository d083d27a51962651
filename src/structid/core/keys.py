"""Building blocks of a study file's tables: tables that refuse unknown keys, and quantities with units."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict

from structid.core.units import to_si


class FileTable(BaseModel):
    """A table of the study file that refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=())


def quantity(unit: str) -> Any:
    """Type of a value that is an SI number, or a string with a unit of the same dimension."""
    return Annotated[float, BeforeValidator(lambda value: to_si(value, unit))]


Seconds = Annotated[float, BeforeValidator(lambda value: to_si(value, "s"))]
Hertz = Annotated[float, BeforeValidator(lambda value: to_si(value, "Hz"))]
MetresPerSecond = Annotated[float, BeforeValidator(lambda value: to_si(value, "m/s"))]
MetresPerSecondSquared = Annotated[float, BeforeValidator(lambda value: to_si(value, "m/s^2"))]
Fraction = Annotated[float, BeforeValidator(lambda value: to_si(value, ""))]
