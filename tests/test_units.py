"""Quantities with units become SI, wrong ones name their key."""

import pytest

from structid import units
from structid.errors import InputError

pytestmark = pytest.mark.quick


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("7.6 kN/mm", "N/m", 7.6e6),
        ("12 t", "kg", 12_000.0),
        ("0.3 g", "m/s^2", 0.3 * 9.80665),
        ("3 %", "", 0.03),
        ("63e-3 1/mm", "1/m", 63.0),
        ("20 Hz", "Hz", 20.0),
        ("1.5 cm/s^2", "m/s^2", 0.015),
        (2.0, "kN/mm", 2e6),
        ("-4", "", -4.0),
    ],
)
def test_quantities_become_si(text, unit, value):
    assert units.to_si(text, unit) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("text", ["20 kg", "20 furlongs_per_x", "fast", "0.28", True, None])
def test_wrong_quantities_name_the_key(text):
    with pytest.raises(InputError, match=r"record.lowpass|furlongs"):
        units.to_si(text, "Hz", "record.lowpass")


def test_hertz_is_not_radians():
    assert units.factor("Hz") == 1.0
