"""Headers of accelerograms: many ways to say the same record are read to the same numbers; what is no such record is refused."""

import re

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.data_files.read_file import read_signal as read_columns

VALUES = np.array([0.0123, -0.0456, 0.1, -0.25, 0.3, 0.0, -0.0789, 0.0005])
G = 9.80665

TITLE = "PEER STRONG MOTION DATABASE RECORD\nSOMEWHERE 01/01/2000, STATION, 090\n"
IN_G = "ACCELERATION TIME SERIES IN UNITS OF G\n"


def body(form="{:.4e}", between="  ", minus="-"):
    return between.join(form.format(v) for v in VALUES).replace("-0.", minus + "0.")


SAME = {
    "as PEER writes it": TITLE + IN_G + "NPTS=  8, DT=  .0100 SEC,\n" + body(),
    "the older header": TITLE + IN_G + "   8   0.01   NPTS, DT\n" + body(),
    "DT first": TITLE + IN_G + "DT= .0100 SEC, NPTS= 8\n" + body(),
    "on two lines": TITLE + IN_G + "NPTS= 8\nDT= .01 SEC\n" + body(),
    "colons": TITLE + IN_G + "NPTS: 8 DT: 0.01\n" + body(),
    "milliseconds": TITLE + IN_G + "NPTS= 8, DT= 10.0 MSEC\n" + body(),
    "a step with an exponent": TITLE + IN_G + "NPTS= 8, DT= 1.0E-02 SEC\n" + body(),
    "a step with a decimal comma": TITLE + IN_G + "NPTS= 8, DT= 0,0100 SEC\n" + body(),
    "values with decimal commas": TITLE + IN_G + "NPTS= 8, DT= .0100 SEC\n" + body("{:.6f}").replace(".", ","),
    "Fortran's exponents": TITLE + IN_G + "NPTS= 8, DT= .0100 SEC\n" + body("{:.4e}").replace("e", "D"),
    "negative values without a space": TITLE + IN_G + "NPTS= 8, DT= .0100 SEC\n" + body("{:.4e}").replace("  -", "-"),
    "milliseconds in full": TITLE + IN_G + "NPTS= 8, DT= 10 MILLISECONDS\n" + body(),
    "percent of g": TITLE
    + "ACCELERATION IN UNITS OF %G\nNPTS= 8, DT= .0100 SEC\n"
    + "  ".join(f"{100.0 * v:.8f}" for v in VALUES),
    "no unit": TITLE + "NPTS= 8, DT= .0100 SEC\n" + body(),
    "cm/s²": TITLE
    + "ACCELERATION TIME SERIES IN UNITS OF CM/SEC**2\nNPTS= 8, DT= .0100 SEC\n"
    + "  ".join(f"{100.0 * G * v:.8f}" for v in VALUES),
    "cm/s/s": TITLE + "UNITS: CM/S/S\nNPTS= 8, DT= .0100 SEC\n" + "  ".join(f"{100.0 * G * v:.8f}" for v in VALUES),
    "m/s²": TITLE + "Units are (m/sec**2)\nNPTS= 8, DT= .0100 SEC\n" + "  ".join(f"{G * v:.10f}" for v in VALUES),
}


@pytest.mark.parametrize("how", SAME)
def test_one_record_in_many_spellings(how, tmp_path):
    (tmp_path / "r.AT2").write_text(SAME[how])
    record = si.GroundMotion.read(tmp_path / "r.AT2")
    assert record.dt == pytest.approx(0.01, rel=1e-12) and len(record) == 8
    np.testing.assert_allclose(record.values, G * VALUES, rtol=1e-6, atol=1e-9)


END = "NPTS= 8, DT= .01 SEC\n" + body()

OTHER_UNITS = {
    "ACCELERATION TIME SERIES IN CM/S/S": 0.01,
    "Acceleration in cm/s2": 0.01,
    "Acceleration in m/s^2": 1.0,
    "ACC IN MM/S2": 0.001,
    "Acceleration [m/s2]": 1.0,
    "Acceleration, cm/s/s": 0.01,
    "ACCELERATION TIME SERIES (GAL)": 0.01,
    "ACCELERATION TIME HISTORY IN GALS": 0.01,
    "Corrected acceleration, units cm/s/s": 0.01,
    "ACCELERATION TIME SERIES IN UNITS OF 0.01 G": 0.01 * G,
    "Acceleration in g": G,
}


@pytest.mark.parametrize("line", OTHER_UNITS)
def test_a_unit_without_peers_words_is_read(line, tmp_path):
    (tmp_path / "r.AT2").write_text(TITLE + line + "\nNPTS= 8, DT= .0100 SEC\n" + body())
    np.testing.assert_allclose(si.GroundMotion.read(tmp_path / "r.AT2").values, OTHER_UNITS[line] * VALUES, rtol=1e-6)


@pytest.mark.parametrize(
    "head", ["Force history, kN\n", "displacement mm\n", "# acceleration m/s2\n", "a\nb\nForce, kN\n", ""]
)
def test_other_files_with_npts_and_dt_are_not_peers(head, tmp_path):
    """They are no accelerations in g: refused, without a unit."""
    (tmp_path / "r.txt").write_text(head + "NPTS= 8, DT= .0100\n" + "\n".join(f"{v:.4f}" for v in VALUES))
    with pytest.raises(InputError):
        si.GroundMotion.read(tmp_path / "r.txt")


@pytest.mark.parametrize("unit", ["CM", "MM", "M"])
def test_a_displacement_of_peer(unit, tmp_path):
    (tmp_path / "r.DT2").write_text(TITLE + f"DISPLACEMENT TIME SERIES IN UNITS OF {unit}\n" + END)
    record = si.GroundMotion(np.zeros(8), 0.01)
    read = si.Observation.read(record, tmp_path / "r.DT2", channel="displacement").values[:, 0]
    np.testing.assert_allclose(read, {"CM": 0.01, "MM": 0.001, "M": 1.0}[unit] * VALUES, rtol=1e-6, atol=1e-12)


REFUSED = {
    "velocity": (TITLE + "VELOCITY TIME SERIES IN UNITS OF CM/S\n" + END, None, "holds: velocity.*an acceleration"),
    "velocity, its unit in brackets": (TITLE + "VELOCITY (CM/SEC)\n" + END, None, "holds: velocity.*an acceleration"),
    "velocity, shortened": (TITLE + "VEL TIME SERIES IN UNITS OF CM/S\n" + END, None, "holds: velocity"),
    "the unit of a velocity": (TITLE + "TIME SERIES IN UNITS OF CM/S\n" + END, "g", "holds: velocity"),
    "displacement": (TITLE + "DISPLACEMENT TIME HISTORY IN UNITS OF CM\n" + END, None, "holds: displacement"),
    "an unknown unit": (TITLE + "ACCELERATION IN UNITS OF FURLONGS\n" + END, None, "the unit 'FURLONGS'"),
    "two units": (SAME["as PEER writes it"], "cm/s^2", r"the file gives the unit 'g', but unit='cm/s\^2' is given"),
    "a unit of another quantity": (SAME["as PEER writes it"], "cm", "unit"),
    "no header": (TITLE + IN_G + "no numbers here\n" + body(), None, "no lines with NPTS and DT"),
    "too few values": (TITLE + IN_G + END.replace("NPTS= 8", "NPTS= 9"), None, "NPTS = 9, but 8 values follow"),
    "no number": (TITLE + IN_G + END.replace("3.0000e-01", "NaN"), None, "line 5: in this PEER.*'NaN'"),
}


@pytest.mark.parametrize(("text", "unit", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_such_record_is_refused(text, unit, words, tmp_path):
    (tmp_path / "r.AT2").write_text(text)
    with pytest.raises(InputError, match=words):
        si.GroundMotion.read(tmp_path / "r.AT2", unit=unit)


def test_a_time_step_beside_that_of_the_header(tmp_path):
    (tmp_path / "r.AT2").write_text(SAME["as PEER writes it"])
    assert si.GroundMotion.read(tmp_path / "r.AT2", dt=0.01).dt == 0.01
    with pytest.raises(InputError, match=r"the header gives a time step of 0.01 s, but dt=0.005 is given"):
        si.GroundMotion.read(tmp_path / "r.AT2", dt=0.005)


def test_a_unit_that_is_given_and_not_in_the_header_counts(tmp_path):
    (tmp_path / "r.AT2").write_text(SAME["no unit"])
    np.testing.assert_allclose(si.GroundMotion.read(tmp_path / "r.AT2", unit="m/s^2").values, VALUES, rtol=1e-6)
    np.testing.assert_allclose(si.GroundMotion.read(tmp_path / "r.AT2", unit="g").values, G * VALUES, rtol=1e-6)


ESM = """EVENT_NAME: SOMEWHERE
UNITS: cm/s^2
SAMPLING_INTERVAL_S: 0.005000
NDATA: 8
DATA_TYPE: ACCELERATION
USER5:
"""


def test_an_esm_file(tmp_path):
    values = "\n".join(f"{100.0 * v:.6f}" for v in VALUES)
    (tmp_path / "r.ASC").write_text(ESM + values)
    record = si.GroundMotion.read(tmp_path / "r.ASC")
    assert record.dt == 0.005
    np.testing.assert_allclose(record.values, VALUES, rtol=1e-6, atol=1e-8)
    for wrong, words in (
        (ESM.replace("NDATA: 8", "NDATA: 9") + values, "NDATA: 9, but 8 values"),
        (ESM.replace("UNITS: cm/s^2\n", "") + values, "does not state a unit"),
        (ESM.replace("0.005000", "often") + values, "SAMPLING_INTERVAL_S: often"),
        (ESM.replace("ACCELERATION", "VELOCITY") + values, "holds: velocity"),
    ):
        (tmp_path / "w.ASC").write_text(wrong)
        with pytest.raises(InputError, match=words):
            si.GroundMotion.read(tmp_path / "w.ASC")


@pytest.mark.parametrize(
    ("first", "name"),
    [
        ("CORRECTED ACCELEROGRAM IIA001", "CSMIP"),
        ("Corrected data, COSMOS format v01.20", "COSMOS"),
        ("Corrected acceleration, velocity and displacement 15 lines (Format v01.20 with 13 text lines)", "COSMOS"),
    ],
)
def test_damaged_files_of_a_known_format_are_named(first, name, tmp_path):
    (tmp_path / "r.v2").write_text(first + "\n1 2 3\n4 5 6\n")
    with pytest.raises(InputError, match=f"in this {name}"):
        si.GroundMotion.read(tmp_path / "r.v2", unit="g", dt=0.01)


def test_values_that_go_on_from_line_to_line_are_not_read_as_columns(tmp_path):
    (tmp_path / "wrapped.txt").write_text("\n".join(" ".join(f"{v:.3f}" for v in row) for row in VALUES.reshape(2, 4)))
    with pytest.raises(InputError, match="4 values per line and a time step, but no column is named"):
        si.GroundMotion.read(tmp_path / "wrapped.txt", dt=0.01, unit="g")
    with pytest.raises(InputError, match=r"4 values per line, but no column is named.*one value per line and give dt"):
        si.GroundMotion.read(tmp_path / "wrapped.txt", unit="g")
    assert len(si.GroundMotion.read(tmp_path / "wrapped.txt", dt=0.01, unit="g", column=2)) == 2


@pytest.mark.parametrize(
    "head", ["time [s], acc [cm/s2]", "# t (s);a (gal)", "Time (s)\tAcc (cm/sec**2)", "% t [s]  a [cm/s^2]"]
)
def test_a_unit_in_the_head_of_the_column_is_checked(head, tmp_path):
    between = next(mark for mark in (";", ",", "\t", "  ") if mark in head)
    (tmp_path / "r.csv").write_text("\n".join([head, *(f"{0.01 * i:.2f}{between}{v}" for i, v in enumerate(VALUES))]))
    np.testing.assert_allclose(si.GroundMotion.read(tmp_path / "r.csv", unit="cm/s^2").values, 0.01 * VALUES)
    with pytest.raises(InputError, match=r"line 1: the file gives the unit '.*but unit='g' is given"):
        si.GroundMotion.read(tmp_path / "r.csv", unit="g")


def test_three_columns_are_asked_about(tmp_path):
    (tmp_path / "r.txt").write_text("0.00 1.0 2.0\n0.01 1.5 2.5\n")
    with pytest.raises(InputError, match=r"3 values per line, but no column is named. Expected: column=1 to 2"):
        si.GroundMotion.read(tmp_path / "r.txt", unit="g")
    np.testing.assert_allclose(si.GroundMotion.read(tmp_path / "r.txt", unit="g", column=2).values, [2.0 * G, 2.5 * G])


def test_damaged_headers_are_told_and_never_crash(tmp_path):
    """Two thousand records with bytes changed, lost and doubled: read, or one paragraph."""
    rng, texts = np.random.default_rng(1), list(SAME.values())
    read = 0
    for _ in range(2000):
        text = bytearray(texts[rng.integers(len(texts))].encode())
        for _ in range(rng.integers(1, 6)):
            place = int(rng.integers(len(text)))
            match rng.integers(3):
                case 0:
                    text[place] = int(rng.integers(256))
                case 1:
                    del text[place]
                case _:
                    text[place:place] = text[place : place + int(rng.integers(1, 30))]
        (tmp_path / "r.AT2").write_bytes(bytes(text))
        try:
            record = si.GroundMotion.read(tmp_path / "r.AT2")
        except InputError as told:
            assert len(str(told).splitlines()) == 1
        else:
            read += 1
            assert np.isfinite(record.values).all() and record.dt > 0.0
    assert 0 < read < 2000


@pytest.mark.parametrize(
    "text",
    [
        "0.00 0.5\n0.01 -0.25\n0.02 1.5",
        "0.00,0.5\n0.01,-0.25\n0.02,1.5",
        "time, acc\n0.00, 0.5\n0.01, -0.25\n0.02, 1.5",
        "0,00;0,5\n0,01;-0,25\n0,02;1,5",
        "t; a\n0,00; 0,5\n0,01; -0,25\n0,02; 1,5",
        "0,00 0,5\n0,01 -0,25\n0,02 1,5",
        "0,00\t0,5\n0,01\t-0,25\n0,02\t1,5",
        "0.00;0.5\n0.01;-0.25\n0.02;1.5",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_points_commas_semicolons_and_encodings(text, encoding, tmp_path):
    (tmp_path / "r.csv").write_bytes(("# Beschleunigung in m/s\u00b2\n" + text).encode(encoding))
    record = si.GroundMotion.read(tmp_path / "r.csv", unit="m/s^2")
    assert record.dt == 0.01
    np.testing.assert_array_equal(record.values, [0.5, -0.25, 1.5])


SECONDS = np.arange(201) * 0.01


def cells(tmp_path, rows):
    file = tmp_path / "logger.csv"
    file.write_text("\n".join(["time,v", *rows]), encoding="utf-8")
    return file


@pytest.mark.parametrize(
    "row",
    ['"{0:.2f}","{1:.6f}"', '"{0:.2f}" , "{1:.6f}"', '"{0:.2f}";"{1:.6f}"', '{0:.2f},"{1:.6f}"'],
)
@pytest.mark.parametrize("comma", [False, True])
def test_cells_in_quotes_are_read(tmp_path, row, comma):
    rows = [row.format(t, np.sin(t)) for t in SECONDS]
    if comma:
        rows = [re.sub(r"(?<=\d)\.(?=\d)", ",", line) if line.count('"') == 4 else line for line in rows]
    step, values = read_columns(cells(tmp_path, rows), "m/s")[1:]
    assert step == 0.01
    np.testing.assert_allclose(values[:, 0], np.sin(SECONDS), atol=1e-6)


@pytest.mark.parametrize(
    "stamp", ["2026-01-01 00:00:{0:05.2f}", "2026-01-01T00:00:{0:05.2f}Z", "0:00:{0:05.2f}", '"00:00:{0:05.2f}"']
)
def test_dates_are_named_and_left_out_where_the_step_is_given(tmp_path, stamp):
    file = cells(tmp_path, [f"{stamp.format(t)},{np.sin(t):.6f}" for t in SECONDS])
    with pytest.raises(InputError, match=r"line 2: a date or a time of day, '.*00:00.00.*dt=0.01, column=1"):
        read_columns(file, "m/s")
    np.testing.assert_allclose(read_columns(file, "m/s", 0.01, 1).values[:, 0], np.sin(SECONDS), atol=1e-6)


@pytest.mark.parametrize(
    ("rate", "digits"), [(256.0, 4), (200.0, 3), (128.0, 4), (51.2, 4), (100.0, 2), (1 / 0.0137, 4)]
)
def test_the_step_of_rounded_times_is_the_simplest_that_they_allow(tmp_path, rate, digits):
    """As far as their last digit tells; a record of such a file can be resampled."""
    time = np.arange(4001) / rate
    file = cells(tmp_path, [f"{t:.{digits}f},{np.sin(t):.6f}" for t in time])
    step, values = read_columns(file, "m/s^2")[1:]
    assert step == pytest.approx(1.0 / rate, rel=1e-15)
    resampled = si.GroundMotion(values[:, 0], step).resample(0.005)
    assert resampled.dt == 0.005 and resampled.duration <= time[-1] * (1.0 + 1e-12)


@pytest.mark.parametrize("jump", [0.05, -2.0])
def test_a_jump_in_time_is_named_where_it_is(tmp_path, jump):
    time = np.arange(1000) * 0.01
    time[700:] += jump
    file = cells(tmp_path, [f"{t:.4f},{np.sin(t):.6f}" for t in time])
    with pytest.raises(InputError, match=r"line 702: time .* follows 6\.99 s, but the usual step is 0\.01 s"):
        read_columns(file, "m/s^2")
