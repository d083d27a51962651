"""Text columns of loggers and laboratories: many dialects are read to the same numbers, ambiguous ones are refused."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.data_files.read_file import read_signal, read_table

TIMES = np.arange(40) * 0.01
VALUES = np.round(1.5 * np.sin(TIMES * 9.0), 3)
FORCES = np.round(12.0 * np.cos(TIMES * 7.0), 2)


def written(tmp_path, text, name="logger.txt"):
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return file


def lines(form, between="\n"):
    return between.join(form.format(t=t, a=a, f=f) for t, a, f in zip(TIMES, VALUES, FORCES, strict=True)) + "\n"


def comma(text):
    return text.replace(".", ",")


SAME = {
    "spaces": ("time [s]  acc [m/s^2]  force [kN]\n" + lines("{t:.2f} {a:.3f} {f:.2f}"), {}),
    "a row of units in brackets": ("Time;Acc;Force\n[s];[m/s²];[kN]\n" + lines("{t:.2f};{a:.3f};{f:.2f}"), {}),
    "a row of units without brackets": ("Time\tAcc\tForce\ns\tm/s^2\tkN\n" + lines("{t:.2f}\t{a:.3f}\t{f:.2f}"), {}),
    "a line of dashes below the titles": (
        "time [s], acc [m/s^2], force [kN]\n---,---,---\n" + lines("{t:.2f},{a:.3f},{f:.2f}"),
        {},
    ),
    "a blank line below the titles": ("time [s], acc [m/s^2], force [kN]\n\n" + lines("{t:.2f},{a:.3f},{f:.2f}"), {}),
    "milliseconds": ("time [ms];acc [m/s^2];force [kN]\n" + lines("{t:.5f};{a:.3f};{f:.2f}"), {"times": 1000.0}),
    "milliseconds in a row of units": (
        "Time;Acc;Force\nms;m/s^2;kN\n" + lines("{t:.5f};{a:.3f};{f:.2f}"),
        {"times": 1000.0},
    ),
    "time_ms": ("time_ms;acc [m/s^2];force [kN]\n" + lines("{t:.5f};{a:.3f};{f:.2f}"), {"times": 1000.0}),
    "the time in the third column": ("acc [m/s^2];force [kN];time [s]\n" + lines("{a:.3f};{f:.2f};{t:.2f}"), {}),
    "decimal commas": (comma("time [s];acc [m/s^2];force [kN]\n" + lines("{t:.2f};{a:.3f};{f:.2f}")), {}),
    "quotes": ('"time [s]","acc [m/s^2]","force [kN]"\n' + lines('"{t:.2f}","{a:.3f}","{f:.2f}"'), {}),
    "quotes and decimal commas": (
        '"time [s]";"acc [m/s^2]";"force [kN]"\n' + comma(lines('"{t:.2f}";"{a:.3f}";"{f:.2f}"')),
        {},
    ),
    "a separator at the end": ("time [s];acc [m/s^2];force [kN];\n" + lines("{t:.2f};{a:.3f};{f:.2f};"), {}),
    "comments": ("# logger 7\n# time [s]\tacc [m/s^2]\tforce [kN]\n" + lines("{t:.2f}\t{a:.3f}\t{f:.2f}"), {}),
    "other lines above": (
        "Logger 7, serial 12\nDate: 2026-01-01\nOperator: N. N.\n\ntime [s]\tacc [m/s^2]\tforce [kN]\n"
        + lines("{t:.2f}\t{a:.3f}\t{f:.2f}"),
        {},
    ),
}


@pytest.mark.parametrize("how", SAME)
def test_one_table_in_many_dialects(how, tmp_path):
    text, changes = SAME[how]
    if changes:
        scaled = [f"{1000.0 * t:.1f}" for t in TIMES]
        rows = [f"{t};{a:.3f};{f:.2f}" for t, a, f in zip(scaled, VALUES, FORCES, strict=True)]
        text = text[: text.index("0.00000")] + "\n".join(rows) + "\n"
    file = written(tmp_path, text)
    table = read_table(file)
    acc, force = (
        next(n for n, title in enumerate(table.titles) if title.lower().startswith(w)) for w in ("acc", "force")
    )
    record = si.GroundMotion.read(file, column=acc)
    assert record.dt == 0.01
    np.testing.assert_allclose(record.values, VALUES, atol=1e-12)
    by_title = read_signal(file, column="force", si_unit="N")
    np.testing.assert_allclose(by_title.values[:, 0], 1000.0 * FORCES, atol=1e-9)
    np.testing.assert_allclose(read_signal(file, "kN", column=force).values[:, 0], 1000.0 * FORCES, atol=1e-9)
    with pytest.raises(InputError, match="but unit='g' is given"):
        si.GroundMotion.read(file, unit="g", column=acc)


THOUSANDS = {
    "comma and point": (
        "time [s];force [N]\n0.00;1,200.5\n0.01;20,000.0\n0.02;-3,000.25\n",
        [1200.5, 20000.0, -3000.25],
    ),
    "point and comma": (
        "time [s];force [N]\n0,00;1.200,5\n0,01;20.000,0\n0,02;-3.000,25\n",
        [1200.5, 20000.0, -3000.25],
    ),
    "quoted, decimal points elsewhere": (
        'time [s],force [N]\n0.00,"1,200"\n0.01,"20,000"\n0.02,"-3,000"\n',
        [1200, 20000, -3000],
    ),
    "millions": ("time [s];force [N]\n0;1,200,000\n1;20,000\n2;-3,000\n", [1.2e6, 2e4, -3e3]),
    "decimal commas with three digits": (
        "time [s];force [N]\n0,000;0,200\n0,010;20,000\n0,020;-3,000\n",
        [0.2, 20.0, -3.0],
    ),
}


@pytest.mark.parametrize("how", THOUSANDS)
def test_commas_and_points_of_thousands(how, tmp_path):
    text, values = THOUSANDS[how]
    np.testing.assert_allclose(read_signal(written(tmp_path, text)).values[:, 0], values)


def test_a_comma_with_two_meanings_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"the number '1,200' may be 1200 or 1\.200"):
        read_signal(written(tmp_path, "time [s];force [N]\n0;1,200\n1;20,000\n2;-3,000\n"))
    with pytest.raises(InputError, match="comma and point differently"):
        read_signal(written(tmp_path, "time [s];force [N]\n0;1,200.5\n1;20.000,5\n2;3\n"))


REFUSED = {
    "an empty cell between commas": (
        "0.00,1,1.0\n0.01,,2.0\n0.02,3,1.0\n",
        {"column": 1},
        r"line 2: an empty cell.* in column 1",
    ),
    "an empty cell between tabs": (
        "0.00\t1\t1.0\n0.01\t\t2.0\n0.02\t3\t1.0\n",
        {"column": 1},
        "line 2: an empty cell.* in column 1",
    ),
    "an empty time": ("0.00,1\n,2\n0.02,3\n", {}, "line 2: an empty cell in the column of the times"),
    "times in milliseconds without a unit": ("0 1\n5 2\n10 1\n15 0\n", {}, r"a time step of 5 s.*'time \[ms\]'"),
    "time in the third column": ("1.0 5 0.00\n0.5 4 0.01\n0.7 9 0.02\n", {"column": 0}, "time_column=2"),
    "a missing line": (
        "".join(f"{0.01 * n:.2f} 1\n" for n in range(100) if n != 60),
        {},
        "line 61: time 0.61 s follows 0.59 s",
    ),
    "dashes in place of the first values": ("---\n---\n0.1\n0.2\n0.3\n", {"dt": 0.01}, "line 1: an empty cell"),
    "nan in place of the first values": ("nan\n0.1\n0.2\n", {"dt": 0.01}, "line 1: an empty cell"),
    "a count and a step that do not fit": (
        "7 0.01\n0.1\n0.2\n0.3\n",
        {"dt": 0.01},
        "line 1: 2 numbers, '7 0.01', before 3 lines",
    ),
    "a step that contradicts": ("3 0.01\n0.1\n0.2\n0.3\n", {"dt": 0.02}, "the first line gives a time step of 0.01 s"),
    "text in between": ("0.00 1\n0.01 2\nstopped\n0.02 3\n", {}, "line 3: 'stopped' is not a number"),
    "text at the end": ("0.00 1\n0.01 2\n0.02 3\nend of test\n", {}, "line 4: 'end of test' is not a number"),
    "no infinite number": ("0.00 1\n0.01 inf\n0.02 3\n", {}, "line 2: 'inf' is not a number"),
    "a step that contradicts the times": (
        "0.00 1\n0.01 2\n0.02 3\n",
        {"dt": 0.005, "time_column": 0, "column": 1},
        "increases by 0.01 s, but dt=0.005",
    ),
}


@pytest.mark.parametrize("how", REFUSED)
def test_what_is_not_read_as_something_else(how, tmp_path):
    text, arguments, words = REFUSED[how]
    with pytest.raises(InputError, match=words) as refusal:
        si.GroundMotion.read(written(tmp_path, text), unit="m/s^2", **arguments)
    assert len(str(refusal.value).splitlines()) == 1


def test_a_count_and_a_step_in_the_first_line_are_no_values(tmp_path):
    """The line is known by its count; the step needs no argument."""
    record = si.GroundMotion.read(written(tmp_path, "3\n0.1\n0.2\n0.3\n"), dt=0.01, unit="m/s^2")
    np.testing.assert_array_equal(record.values, [0.1, 0.2, 0.3])
    record = si.GroundMotion.read(written(tmp_path, "3 0.02\n0.1\n0.2\n0.3\n"), unit="m/s^2")
    assert record.dt == 0.02 and len(record) == 3


def test_a_wrapped_record_is_not_offered_as_columns(tmp_path):
    values = np.sin(0.05 * np.arange(800))
    text = "\n".join(" ".join(f"{v:.6f}" for v in row) for row in values.reshape(-1, 8))
    file = written(tmp_path, text)
    with pytest.raises(InputError, match="Expected: one value per line") as refusal:
        si.GroundMotion.read(file, dt=0.01, unit="g")
    assert "column=0" not in str(refusal.value)
    with pytest.raises(InputError, match="8 values per line that continue from line to line"):
        si.GroundMotion.read(file, dt=0.01, unit="g", column=0)


def test_channels_in_columns_are_not_taken_for_a_wrapped_record(tmp_path):
    channels = np.stack([np.sin(0.05 * np.arange(300) + k) * (k + 1) for k in range(6)], axis=1)
    text = "\n".join(" ".join(f"{v:.6f}" for v in row) for row in channels)
    record = si.GroundMotion.read(written(tmp_path, text), dt=0.01, unit="m/s^2", column=3)
    np.testing.assert_allclose(record.values, channels[:, 3], atol=1e-6)


def test_blocks_of_a_test_controller_are_one_table(tmp_path):
    """A controller repeats its header at every block of data."""
    head = "Data Acquisition\tTime: {t} Sec\t1/1/2026\nRunning Time\tDisplacement\tForce\nsec\tmm\tkN\n"
    rows = lines("{t:.2f}\t{a:.3f}\t{f:.2f}").splitlines(keepends=True)
    text = (
        "MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\n"
        + head.format(t=1)
        + "".join(rows[:25])
        + "\n"
        + head.format(t=2)
        + "".join(rows[25:])
    )
    file = written(tmp_path, text)
    force = read_signal(file, column="Force", si_unit="N")
    assert force.dt == 0.01
    np.testing.assert_allclose(force.values[:, 0], 1000.0 * FORCES)
    np.testing.assert_allclose(
        read_signal(file, column="Displacement", si_unit="m").values[:, 0], 1e-3 * VALUES, atol=1e-12
    )
    other = head.replace("Force", "Strain").format(t=2)
    with pytest.raises(InputError, match="is not a number"):
        read_signal(written(tmp_path, text.replace(head.format(t=2), other)), column="Force")


def test_a_column_is_given_by_its_title(tmp_path):
    text = "time [s];left [mm];right [mm]\n0.0;1;4\n0.1;2;5\n0.2;3;6\n"
    file = written(tmp_path, text)
    np.testing.assert_allclose(read_signal(file, column="right").values[:, 0], [4e-3, 5e-3, 6e-3])
    with pytest.raises(InputError, match=r"column='middle' is the title of 0 columns.*'left"):
        read_signal(file, column="middle")
    with pytest.raises(InputError, match=r"no column is named.*column=1 to 2.*1 'left \[mm\]', 2 'right"):
        read_signal(file)
    with pytest.raises(InputError, match="column 0 is the time"):
        read_signal(file, column=0)


@pytest.mark.parametrize(("unit", "factor"), [("gal", 0.01), ("mg", 9.80665e-3), ("G", 9.80665), ("g", 9.80665)])
def test_units_of_accelerations(unit, factor, tmp_path):
    file = written(tmp_path, f"time [s];a [{unit}]\n0.00;1\n0.01;2\n0.02;3\n")
    np.testing.assert_allclose(si.GroundMotion.read(file).values, factor * np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(si.GroundMotion.read(file, unit=unit).values, factor * np.array([1.0, 2.0, 3.0]))
