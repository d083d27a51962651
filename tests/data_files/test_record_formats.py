"""Formats of strong-motion networks: synthetic files of each are read to the right numbers, and damaged ones never to others."""

import re

import numpy as np
import pytest

import structid as si
from format_writers import CASES, cosmos, csmip_v2, cwa, esm, knet, peer
from structid.core.errors import InputError
from structid.data_files.read_file import read_file


def written(tmp_path, text, name="record.dat"):
    file = tmp_path / name
    file.write_text(text, encoding="latin-1", newline="\n")
    return file


@pytest.mark.parametrize("name", CASES)
def test_every_component_of_a_format(name, tmp_path):
    """Peak, step, number of samples, order and direction of the components."""
    case = CASES[name]
    text, truth = case.write()
    file = written(tmp_path, text)
    assert case.format in read_file(file).format
    for number, (component, values) in enumerate(truth.components.items(), start=1):
        for choice in (component, component.lower(), number):
            record = si.GroundMotion.read(file, component=choice, **case.arguments)
            assert record.dt == pytest.approx(truth.dt, rel=1e-12) and len(record) == len(values)
            np.testing.assert_allclose(record.values, values, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("ending", ["\r\n", "\r\r\n", "\n\x1a"])
@pytest.mark.parametrize("name", CASES)
def test_line_endings_of_other_systems(name, ending, tmp_path):
    case = CASES[name]
    text, truth = case.write()
    raw = text + ending.strip("\n") if "\x1a" in ending else text.replace("\n", ending)
    (tmp_path / "r.dat").write_bytes(raw.encode("latin-1"))
    component, values = next(iter(truth.components.items()))
    record = si.GroundMotion.read(tmp_path / "r.dat", component=component, **case.arguments)
    np.testing.assert_allclose(record.values, values, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if len(case.write()[1].components) > 1])
def test_several_channels_without_a_component_are_listed(name, tmp_path):
    case = CASES[name]
    text, truth = case.write()
    file = written(tmp_path, text)
    with pytest.raises(InputError, match="no component is given") as refusal:
        si.GroundMotion.read(file, **case.arguments)
    assert all(f"'{component}'" in str(refusal.value) for component in truth.components)
    with pytest.raises(InputError, match="component='Z9' is 0 of them"):
        si.GroundMotion.read(file, component="Z9", **case.arguments)
    with pytest.raises(InputError, match=r"column=1 is given.*has no columns.*component="):
        si.GroundMotion.read(file, column=1, **case.arguments)


@pytest.mark.parametrize("name", CASES)
def test_a_given_unit_or_step_is_held_against_the_header(name, tmp_path):
    case = CASES[name]
    text, truth = case.write()
    file, component = written(tmp_path, text), next(iter(truth.components))
    with pytest.raises(InputError, match=r"but unit='ft/s\^2' is given"):
        si.GroundMotion.read(file, component=component, unit="ft/s^2", **case.arguments)
    if not case.arguments:
        with pytest.raises(InputError, match=r"but dt=0\.0123 is given"):
            si.GroundMotion.read(file, component=component, dt=0.0123)


@pytest.mark.parametrize("suffix", [".txt", ".dat", ".csv", ".AT2", ".smc", ""])
def test_the_content_and_not_the_name_of_a_file_counts(suffix, tmp_path):
    for write in (knet, esm, peer):
        text, truth = write()
        values = next(iter(truth.components.values()))
        np.testing.assert_allclose(
            si.GroundMotion.read(written(tmp_path, text, f"record{suffix}")).values, values, rtol=1e-9, atol=1e-12
        )


def test_points_of_a_film_are_interpolated_only_at_a_given_step(tmp_path):
    text, _ = CASES["USC"].write()
    with pytest.raises(
        InputError, match=r"not at a constant step: 0\.004 to 0\.006 s.*dt=0\.005 interpolates linearly"
    ):
        si.GroundMotion.read(written(tmp_path, text))


def test_counts_are_no_acceleration(tmp_path):
    text, _ = cosmos("counts", 50, 1.0)
    with pytest.raises(InputError, match="the file states the unit 'counts', which is no unit of acceleration"):
        si.GroundMotion.read(written(tmp_path, text), component=1)


def test_a_step_that_the_text_rounds_is_that_of_the_real_valued_header(tmp_path):
    text, _ = csmip_v2()
    assert si.GroundMotion.read(written(tmp_path, text), component=1).dt == 0.0125
    with pytest.raises(InputError, match="two values of the time step"):
        si.GroundMotion.read(written(tmp_path, text.replace(" 0.0125000", " 0.0250000")), component=1)


def test_channels_of_a_building_have_their_numbers_at_the_station(tmp_path):
    """Several recorders of a building each begin with channel 1; the location is no part of the direction."""
    text, truth = csmip_v2()
    text = text.replace("Chan  1: 90 Deg\n", "Chan  1: 90 Deg (Sta Chn:  7)        Location: Roof, North Wall\n")
    text = text.replace("Chan  2: Up\n", "Chan  2:  Up                       Location: Ground Floor\n")
    file = written(tmp_path, text)
    assert [(c.number, c.name) for c in read_file(file).channels[::3]] == [(7, "90 Deg"), (2, "Up")]
    np.testing.assert_allclose(si.GroundMotion.read(file, component="up").values, truth.components["Up"])


def test_velocities_of_a_file_are_observations(tmp_path):
    text, _ = csmip_v2()
    file = written(tmp_path, text)
    record = si.GroundMotion.read(file, component="Up")
    measured = si.Observation.read(record, file, channel="velocity", component="Up")
    velocity = next(c for c in read_file(file).channels if c.name == "Up" and c.quantity == "velocity")
    np.testing.assert_allclose(measured.values[:, 0], velocity.values / 100.0)
    with pytest.raises(InputError, match="the file gives the unit 'cm/s', but unit='mm/s' is given"):
        si.Observation.read(record, file, "mm/s", component="Up")


SPECTRA = {
    "SIGMA": "Per(s)PSA @ damp 02% PSA @ damp 05% (m/s/s)\n0.000 5.08E+000 5.06E+000\n0.010 1.1E+001 5.07E+000\n",
    "CSMIP V3": "Response and Fourier amplitude spectra (78 periods,  .04 -  6.0 sec)   for\nCorrected accelerogram\n1 2\n3 4\n",
    "COSMOS V3": "Response spectra     (Format v01.20 with 13 text lines)\n1 2\n3 4\n",
    "USGS SMC": "5 RESPONSE SPECTRA\n*\n1 2\n3 4\n",
    "text": "Period (s), PSA (g)\n0.01, 0.5\n0.02, 0.6\n0.03, 0.8\n",
}


@pytest.mark.parametrize("name", SPECTRA)
def test_a_spectrum_is_no_record(name, tmp_path):
    with pytest.raises(InputError, match="spectr"):
        si.GroundMotion.read(written(tmp_path, SPECTRA[name]), unit="g", dt=0.01)


FREE = {"NSMN", "ESM", "PEER", "BBP"}
"""Formats without columns of fixed width: the loss of one digit does not show in them."""


UNCOUNTED = {"BBP"}
"""Formats whose files do not state the number of samples: one that is cut is a shorter record."""


def damaged(text, rng, free):
    """One realistic damage: a cut, a lost or doubled line, and where the format shows it a lost or doubled character."""
    lines = text.split("\n")
    first = next(
        n for n, line in enumerate(lines) if n > 1 and re.fullmatch(r"[-+.\dEe \t]{30,}|[-\d.]+", line.strip())
    )
    at = int(rng.integers(first, len(lines) - 2))
    match rng.integers(3 if free else 5):
        case 0:
            return "\n".join(lines[:at]) + "\n"
        case 1:
            return "\n".join(lines[:at] + lines[at + 1 :])
        case 2:
            return "\n".join(lines[: at + 1] + lines[at:])
        case 3:
            line = lines[at].rstrip()
            place = int(rng.integers(max(len(line), 1)))
            lines[at] = line[:place] + line[place + 1 :]
        case _:
            line = lines[at].rstrip()
            place = int(rng.integers(max(len(line), 1)))
            lines[at] = line[:place] + line[place : place + 1] + line[place:]
    return "\n".join(lines)


def test_two_thousand_damaged_files_are_refused_or_read_right(tmp_path):
    rng, names = np.random.default_rng(45), list(CASES)
    written_files = {name: case.write() for name, case in CASES.items()}
    refused = 0
    for n in range(2000):
        name = names[n % len(names)]
        text, truth = written_files[name]
        file = written(tmp_path, damaged(text, rng, name in FREE))
        for component, values in truth.components.items():
            try:
                record = si.GroundMotion.read(file, component=component, **CASES[name].arguments)
            except InputError as refusal:
                assert len(str(refusal).splitlines()) == 1 and str(file) in str(refusal)
                refused += 1
            else:
                if name in UNCOUNTED:
                    values = values[: len(record)]
                assert record.dt == pytest.approx(truth.dt) and len(record) == len(values), (name, component)
                np.testing.assert_allclose(record.values, values, rtol=1e-9, atol=1e-12, err_msg=name)
    assert refused > 2000


@pytest.mark.parametrize("change", [("NDATA: 800", "NDATA: 801"), ("NDATA: 800", "NDATA: 8OO"), ("0.005000", "often")])
def test_a_damaged_header(change, tmp_path):
    with pytest.raises(InputError, match="in this ESM"):
        si.GroundMotion.read(written(tmp_path, esm()[0].replace(*change)))


def test_the_name_of_a_station_is_no_unit(tmp_path):
    """STATION_NAME: Fire unit of Athens."""
    text, truth = esm()
    assert "Fire unit of Athens" in text
    np.testing.assert_allclose(si.GroundMotion.read(written(tmp_path, text)).values, truth.components["HNE"])
    text, truth = peer()
    named = text.replace("El Centro Array #9", "Unit of Athens, units of Rome")
    np.testing.assert_allclose(si.GroundMotion.read(written(tmp_path, named)).values, truth.components["acceleration"])


def test_a_record_in_gal_is_not_read_in_g(tmp_path):
    text, _ = cwa()
    with pytest.raises(InputError, match=r"the file gives the unit 'cm/s\^2', but unit='g' is given"):
        si.GroundMotion.read(written(tmp_path, text), unit="g", component="U")


def test_a_binary_file_gets_a_sentence_of_its_own(tmp_path):
    (tmp_path / "r.dat").write_bytes(bytes(range(256)) * 10)
    with pytest.raises(InputError, match="a binary file of a format that structid does not know"):
        si.GroundMotion.read(tmp_path / "r.dat", unit="g", dt=0.01)
    with pytest.raises(InputError, match="this is a folder"):
        si.GroundMotion.read(tmp_path, unit="g")
