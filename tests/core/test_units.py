"""Quantities with units become SI, wrong ones name their key."""

import pytest

from structid.core import units
from structid.core.errors import InputError

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
        ("1.5 m/s2", "m/s^2", 1.5),
        ("18 kN/m3", "N/m^3", 18e3),
        (2.0, "kN/mm", 2e6),
    ],
)
def test_quantities_become_si(text, unit, value):
    assert units.to_si(text, unit) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("text", ["20 kg", "20 furlongs_per_x", "fast", "0.28", True, None])
def test_wrong_quantities_name_the_key(text):
    with pytest.raises(InputError, match=r"record.lowpass|furlongs"):
        units.to_si(text, "Hz", "record.lowpass")


@pytest.mark.parametrize(
    ("text", "unit", "words"),
    [
        ("12 000 kg", "kg", "the number could end after '12'.*without spaces and commas"),
        ("12,000 kg", "kg", "the number could end after '12'"),
        (
            "2",
            "",
            "'2', a string without a unit. Expected: a string with a unit, such as '2 %', or the number without quotes",
        ),
    ],
)
def test_a_number_that_would_be_read_as_another(text, unit, words):
    with pytest.raises(InputError, match=words):
        units.to_si(text, unit)


def test_hertz_is_not_radians():
    assert units.factor("Hz") == 1.0


def test_labels_have_no_brackets_around_a_single_unit():
    assert units.label("sigma2", "(m)^2") == "sigma2 [m^2]" and units.label("sigma2", "(m/s)^2") == "sigma2 [(m/s)^2]"


def test_a_kilonewton_is_no_knot():
    for text in ("50 kn", "7.6 kn/mm"):
        with pytest.raises(InputError, match="kN"):
            units.to_si(text, "N")
    assert units.factor("knot") == pytest.approx(0.514444, rel=1e-5) and units.factor("kN") == 1000.0


@pytest.mark.parametrize(
    ("value", "unit", "cure"),
    [
        ("10 kN", "kg", "a weight"),
        ("3 %", "N*s/m", "damping_ratio"),
        ("130 1/m", "1/m^2", "Convert the number with the unit"),
        ("130 1/m", "", r"a plain number, without a unit.*if the exponent n is unknown"),
        ("10 s", "kg", "Correct the unit"),
    ],
)
def test_units_that_are_easily_mixed_up_have_their_own_cure(value, unit, cure):
    with pytest.raises(InputError, match=cure):
        units.to_si(value, unit)


@pytest.mark.parametrize("unit", ["degC", "degF", "celsius", "dB", "dBm"])
def test_a_unit_that_is_no_factor_is_refused(unit):
    """25 °C is 298.15 K and 20 dB a ratio of 100 or of 10: a scale read by a factor would be wrong without a word."""
    with pytest.raises(InputError, match=f"unit '{unit}': this scale has an offset or is logarithmic"):
        units.factor(unit)
    assert units.factor("delta_degC") == units.factor("K") == 1.0


@pytest.mark.parametrize(
    ("unit", "cure"),
    [
        ("ton", "short_ton"),
        ("tons", "short_ton"),
        ("kton", "'t' for 1000 kg"),
        ("tonf/m", "'tf'"),
        ("pH", "a pH value"),
    ],
)
def test_a_word_of_several_meanings_is_refused(unit, cure):
    with pytest.raises(InputError, match=cure):
        units.factor(unit)
    assert units.factor("t") == 1000.0 and units.factor("short_ton") == pytest.approx(907.18474)
    assert units.factor("tf") == pytest.approx(9806.65)
