"""Physical units: ``"7.6 kN/mm"`` to SI and back. All arrays inside the library are in SI."""

from __future__ import annotations

import functools
import re
from typing import Any

from structid.core.errors import InputError

STANDARD_GRAVITY = 9.80665
"""Standard gravity [m/s²], as defined by PEER and ISO 80000-3."""

MIXED_UP = (
    ("N", "kg", "This is a weight: divide it by g = 9.81 m/s²; 10 kN corresponds to 1.02 t."),
    ("1/m", "", "Give parameters in m^-n, such as beta and gamma, as plain SI numbers if the exponent n is unknown."),
    ("", "N*s/m", "Give a fraction of critical damping as damping_ratio."),
    (
        "1/m",
        "1/m^2",
        "Convert the number with the unit: a yield displacement of 5 mm means 130 1/m, or 26000 1/m^2 with exponent 2.",
    ),
)
"""Units that are easily confused: the given unit, the expected unit, and the advice."""

AMBIGUOUS = (
    (r"kn", "kn means knot, a speed", "'kN' for a kilonewton, or 'knot'"),
    (r"pH", "pH means picohenry", "no unit, since a pH value is a logarithm"),
    (
        r"[kM]?(?:tons?(?:_force)?|tonf|force_ton)",
        "a ton may be 907.185 kg (US short ton), 1016.05 kg (long ton) or 1000 kg",
        "'t' for 1000 kg, 'short_ton' or 'long_ton'; 'tf' for the weight of 1000 kg",
    ),
)
"""Unit names whose meaning in the units library differs from engineering usage: pattern, problem, replacement."""

LONGEST_UNIT = 60
"""Largest number of characters of a unit."""

_POWER_OF_POWER = re.compile(r"\*\*\s*[-+]?[\d.]+\s*\*\*|\*\*\s*[-+]?\d{3}|\d{30}")
"""Powers of powers and very large numbers, which a unit does not have and which take long to compute."""

_NUMBER = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$")


@functools.cache
def _registry() -> Any:
    import pint  # slow to import

    registry = pint.UnitRegistry(cache_folder=None)
    # In structural engineering g means gravity; grams are not needed.
    registry.define(f"gravity_g = {STANDARD_GRAVITY} * meter / second ** 2")
    return registry


def _clean(unit: str) -> str:
    text = unit.strip().replace("²", "**2").replace("³", "**3").replace("·", "*").replace("^", "**")
    text = re.sub(r"(?<=[A-Za-z])(?<!\d[eE])(?=-?[2-9]|-1)", "**", text)  # m/s2, kN/m3; the CF conventions' m s-1
    if not re.search(r"\bper\b", text):
        text = re.sub(r"(?<=[A-Za-z\d])\s+(?=[A-Za-z])", "*", text)
    # The units library reads Nm as a number metric of textiles; engineers mean newton metres.
    text = re.sub(r"(?<![A-Za-z])([kMGm]?)Nm(?![A-Za-z])", r"\1N*m", text)
    # A single g means gravity; "kg" and similar units stay as they are.
    return re.sub(r"(?<![A-Za-z])g(?![A-Za-z])", "gravity_g", text)


def _parsed(text: str, times: float = 1.0) -> Any:
    """Parse a unit, or a number with a unit, and multiply it by a factor."""
    registry = _registry()
    return times * registry.Quantity(text) if text[0].isdigit() else registry.Quantity(times, text)


@functools.cache
def _si_quantity(unit: str) -> Any:
    registry = _registry()
    text = _clean(unit)
    if text in ("", "-", "1"):
        return registry.Quantity(1.0)
    if len(text) > LONGEST_UNIT or _POWER_OF_POWER.search(text):
        raise InputError(
            f"unit '{unit[:40]}'", "this is no unit", "a unit such as 'kN/mm' or 'm/s^2'", "Write a shorter unit."
        )
    for words, came, allowed in AMBIGUOUS:
        if re.search(rf"(?<![A-Za-z_]){words}(?![A-Za-z_])", text):
            raise InputError(f"unit '{unit}'", came, allowed)
    try:
        one, three = (_parsed(text, times).to_base_units() for times in (1.0, 3.0))
        proportional = abs(three.magnitude / one.magnitude - 3.0) < 1e-9
    except Exception as cause:
        if type(cause).__name__ != "OffsetUnitCalculusError":
            raise InputError(
                f"unit '{unit}'",
                "this unit is unknown",
                "a unit such as 'kN/mm', '1/m', 'm/s^2', 'g', 'Hz', '%'",
                "Check the spelling. Write exponents as m^2, m**2 or m2.",
            ) from cause
        proportional = False
    if not proportional:
        raise InputError(
            f"unit '{unit}'",
            "this scale has an offset or is logarithmic, so no factor converts it to SI",
            "a proportional unit, such as 'K', or 'delta_degC' for a temperature difference",
            "Convert the values first.",
        )
    return one


def factor(unit: str) -> float:
    """Factor that converts a unit to SI: ``value_si = value * factor(unit)``."""
    return float(_si_quantity(unit).magnitude)


def si_unit(unit: str) -> str:
    """Return the SI unit that has the same dimension as the given unit."""
    if _si_quantity(unit).dimensionless:
        return ""
    registry = _registry()
    coherent = registry.Quantity(1.0)
    for name, power in _parsed(_clean(unit)).unit_items():
        # Drop prefixes: kilonewton becomes newton. A unit that is not SI even then becomes base units: t becomes kg.
        plain = registry.Quantity(1.0, registry.parse_unit_name(name)[0][1])
        whole = abs(plain.to_base_units().magnitude - 1.0) < 1e-12
        coherent = coherent * registry.Quantity(1.0, (plain if whole else plain.to_base_units()).units) ** power
    return f"{coherent.units:~C}"


def same_dimension(unit: str, other: str) -> bool:
    """Whether two units have the same dimension."""
    return bool(_si_quantity(unit).dimensionality == _si_quantity(other).dimensionality)


def to_si(value: float | str, unit: str, where: str = "value") -> float:
    """Convert a number, or a string such as ``"7.6 kN/mm"``, to SI."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise InputError(where, f"{value!r}", f"a number, or a string such as '1 {unit or '%'}'")
    if not isinstance(value, str):
        return float(value) * factor(unit)
    match = _NUMBER.match(value)
    if match is None:
        raise InputError(where, f"'{value}'", f"a number followed by a unit, such as '1.0 {unit}'".rstrip(" '") + "'")
    number, unit_text = float(match.group(1)), match.group(2)
    if unit_text == "":
        pure = unit in ("", "-", "1")
        raise InputError(
            where,
            f"'{value}', a string without a unit",
            f"a string with a unit, such as '{value.strip()} {'%' if pure else unit}', or the number without quotes, which is "
            f"{'a pure number' if pure else f'in {unit}'}",
        )
    if re.match(r"(?!1\s*/)[\d.,]", unit_text):
        raise InputError(
            where,
            f"'{value}' is ambiguous, since the number could end after '{match.group(1)}'",
            f"one number and its unit, such as '12000 {unit}'".rstrip(" '") + "'",
            "Write thousands without spaces and commas, and decimals with a point.",
        )
    return number * factor_of(unit_text, unit, where, value)


def factor_of(unit: str, like: str, where: str, came: str = "") -> float:
    """Return the SI value of a unit, which must have the dimension of the unit `like`."""
    if not same_dimension(unit, like):
        description = f"'{came}' has the unit '{unit}'" if came else f"the unit '{unit}'"
        allowed = f"a unit of the same dimension as '{like}'" if like else "a plain number, without a unit"
        raise InputError(where, description, allowed, _mixed_up(unit, like))
    return factor(unit)


def _mixed_up(unit: str, like: str) -> str:
    """Advice for a unit of another dimension."""
    for given, expected, cure in MIXED_UP:
        if same_dimension(unit, given) and same_dimension(like, expected):
            return cure
    return "Correct the unit."


def check_power_of_length(unit: str, where: str) -> None:
    """Refuse a unit other than m⁻ⁿ, the unit of β and γ."""
    if set(_si_quantity(unit).dimensionality) - {"[length]"}:
        raise InputError(where, f"'{unit}'", "a power of a length, such as '1/m'", "Correct the unit.")


def is_quantity(text: str) -> bool:
    """Whether a string is a number with a known unit."""
    match = _NUMBER.match(text)
    if match is None or not match.group(2):
        return False
    try:
        _si_quantity(match.group(2))
    except InputError:
        return False
    return True


def in_si(text: str) -> str:
    """Format a quantity in SI."""
    match = _NUMBER.match(text)
    assert match is not None
    unit = si_unit(match.group(2)).replace("**", "^")
    return f"{float(match.group(1)) * factor(match.group(2)):.6g}{' ' + unit if unit else ''}"


def label(name: str, unit: str) -> str:
    """Label of a quantity in axes and tables, such as ``"stiffness [kN/mm]"``."""
    return f"{name} [{unbracketed(unit)}]" if unit not in ("", "-", "1") else name


def squared(unit: str) -> str:
    """Unit of the variance of a quantity."""
    return f"({unit})^2" if unit else ""


def unbracketed(unit: str) -> str:
    """Remove brackets around a single unit."""
    return re.sub(r"\((\w+)\)\^", r"\1^", unit)
