"""Spellings of units in headers and titles, and their agreement with a given unit."""

from __future__ import annotations

import re

from structid.core.errors import InputError
from structid.core.units import factor, same_dimension

QUANTITIES = {"acceleration": "m/s^2", "velocity": "m/s", "displacement": "m"}
"""SI units of the quantities of a motion."""

UNITS = {
    "g": "g",
    "gal": "cm/s^2",
    "gals": "cm/s^2",
    "mg": "0.001 g",
    "mgal": "1e-5 m/s^2",
    "%g": "0.01 g",
    "g/10": "0.1 g",
    **dict.fromkeys(
        ("cm/sec**2", "cm/s**2", "cm/s/s", "cm/sec/sec", "cm/sec2", "cm/s2", "cm/s^2", "cm/sec^2", "cm/s²"), "cm/s^2"
    ),
    **dict.fromkeys(
        ("m/sec**2", "m/s**2", "m/s/s", "m/sec/sec", "m/sec2", "m/s2", "m/s^2", "m/sec^2", "m/s²"), "m/s^2"
    ),
    **dict.fromkeys(("mm/sec**2", "mm/s**2", "mm/s/s", "mm/s2", "mm/s^2", "mm/s²"), "mm/s^2"),
    **dict.fromkeys(("in/sec/sec", "in/s/s", "in/s2", "in/s^2", "in/sec2", "in/sec^2"), "inch/s^2"),
    **dict.fromkeys(("ft/s/s", "ft/s2", "ft/s^2", "ft/sec2", "ft/sec^2"), "ft/s^2"),
    **{spelt: unit for unit in ("cm/s", "mm/s", "m/s") for spelt in (unit, f"{unit}ec")},
    **{spelt: "inch/s" for spelt in ("in/s", "in/sec")},
    "in": "inch",
    "inches": "inch",
    "cm": "cm",
    "mm": "mm",
    "m": "m",
    "newton": "N",
    "newtons": "N",
    "n-m": "N*m",
    "kn-m": "kN*m",
    "volt": "V",
    "volts": "V",
    "lbs": "pound",
    "sec": "s",
    "secs": "s",
    "seconds": "s",
    "second": "s",
    "msec": "ms",
}
"""Units by their spellings in headers and titles, in lower case."""

TIME_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sekunde", "sekunden"), 1.0),
    **dict.fromkeys(("ms", "msec", "msecs", "millisec", "millisecond", "milliseconds", "millisekunden"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "microsec", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hour", "hours"), 3600.0),
}
"""Seconds by the spelling of a unit of time, in lower case and without spaces and points."""


def spelt_unit(text: str) -> str | None:
    """Return the unit that a text spells, or None if it spells none."""
    word = text.strip().strip(".,;")
    if not word or word in ("-", "1"):
        return None
    unit = {"KN": "kN", "KNm": "kN*m", "Mpa": "MPa", "Kgf": "kgf"}.get(word) or UNITS.get(word.lower(), word)
    if not re.search("[A-Za-z%°]", unit):
        return None
    try:
        factor(unit)
    except InputError:
        return None
    return unit


def seconds_of(unit: str) -> float | None:
    """Return the seconds of a unit of time; None if it is none. ``MS`` and ``mS`` are milliseconds in a title."""
    return TIME_UNITS.get(re.sub(r"[\s.]", "", unit).lower())


def quantity_of(unit: str) -> str:
    """Return the quantity of a unit if it is one of motion, or an empty string."""
    if not unit:
        return ""
    return next((name for name, si in QUANTITIES.items() if same_dimension(unit, si)), "")


def check_unit(where: str, spelt: str, in_file: str, given: str) -> None:
    """Refuse a given unit that contradicts the file's."""
    unit = UNITS.get(given.lower(), given) if given.lower() in ("gal", "gals", "mg") else given
    if same_dimension(in_file, unit) and abs(factor(in_file) / factor(unit) - 1.0) < 1e-3:
        return
    raise InputError(
        where,
        f"the file gives the unit '{spelt}', but unit='{given}' is given",
        "one unit",
        f"Use unit='{in_file}', or another column of the file; if the file is wrong, correct it.",
    )
