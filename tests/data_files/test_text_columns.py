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


def rows(*columns, between=";"):
    return "\n".join(between.join(f"{v:.3f}" for v in row) for row in zip(*columns, strict=True)) + "\n"


N = np.arange(12)
ACC = np.round(np.sin(1.3 * N), 3)
MILLISECONDS = 0.2 * N

IN_MILLISECONDS = {
    "capitals": "TIME (MS);Acc [g]\n",
    "mixed": "Time (mS);Acc [g]\n",
    "a comma": "Time, ms;Acc [g]\n",
    "a slash": "Zeit / ms;Acc [g]\n",
    "an underscore": "Elapsed_ms;Acc [g]\n",
    "two words": "Time [milli sec];Acc [g]\n",
    "in German": "Zeit [Millisekunden];Acc [g]\n",
    "a row with an unknown unit": "Time;Acc\nms;Xq\n",
    "a separator behind the titles": "Time [ms];Acc [g];\n",
    "another line below the titles": "Time [ms];Acc [g]\nStation;Basement\n",
}


@pytest.mark.parametrize("how", IN_MILLISECONDS)
def test_times_in_milliseconds_are_never_seconds(how, tmp_path):
    file = written(tmp_path, IN_MILLISECONDS[how] + rows(MILLISECONDS, ACC))
    assert read_signal(file, "g", column=1).dt == pytest.approx(0.2e-3)


@pytest.mark.parametrize("head", ["Time (ms) Acc (g)\n", "sampled every 0.2 ms\n", "Time [xs] Acc [g]\n"])
def test_titles_of_times_that_cannot_be_understood(head, tmp_path):
    file = written(tmp_path, head + rows(MILLISECONDS, ACC, between=" "))
    try:
        assert read_signal(file, "g", column=1).dt == pytest.approx(0.2e-3)
    except InputError as refusal:
        assert "milliseconds" in str(refusal) or "not a unit of time" in str(refusal)


UNEVEN = np.array([0.01, 0.04, 0.05, 0.10, 0.11, 0.15, 0.16, 0.20, 0.22, 0.25, 0.30, 0.31])
NEVER = {
    "uneven times with a step": ("Time [s];Acc [g]\n" + rows(UNEVEN, ACC), {"dt": 0.01}, "usual step"),
    "descending times with a step": ("Time [s];Acc [g]\n" + rows(0.01 * N[::-1], ACC), {"dt": 0.01}, "line"),
    "a spectrum": ("Frequency (Hz);Amplitude (g)\n" + rows(0.1 * N, ACC), {}, "spectrum|not a time"),
    "displacements for times": ("Displacement [mm];Acc [g]\n" + rows(0.05 * N, ACC), {}, "'mm'.*is not a unit of time"),
    "the step as the first value": ("0.02\n" + rows(ACC), {"dt": 0.02, "unit": "g"}, "first value, 0.02"),
    "the rate as the first value": ("100\n" + rows(ACC), {"dt": 0.01, "unit": "g"}, "first value, 100"),
    "a German thousands point": ("Zeit [s];a [mm/s²]\n0,000;2.000\n0,005;-3.500\n0,010;1.500\n", {}, "may be 2000 or 2.000"),
    "one column with decimal commas": (
        "0,10\n-0,25\n0,05\n", {"dt": 0.01, "unit": "g", "column": 0}, "one number with a decimal comma"),
    "another unit in the last brackets": ("Time [s];Acc (1) [g]\n" + rows(0.01 * N, ACC), {"unit": "m/s^2"}, "the unit 'g"),
    "a wrapped record of four": (
        "\n".join(" ".join(f"{v:.6f}" for v in row) for row in np.sin(0.03 * np.arange(400)).reshape(-1, 4)),
        {"dt": 0.01, "unit": "g", "column": 0},
        "continue from line to line",
    ),
}  # fmt: skip


@pytest.mark.parametrize("how", NEVER)
def test_what_a_record_is_never_made_of(how, tmp_path):
    text, arguments, words = NEVER[how]
    with pytest.raises(InputError, match=words):
        si.GroundMotion.read(written(tmp_path, text), **arguments)


def test_a_sentence_above_the_numbers_is_no_title(tmp_path):
    """It has as many words as the table has columns, and one of them is a word for the time."""
    for head in ("# Acceleration time-series\n", "Units: seconds\n"):
        file = written(tmp_path, head + rows(0.01 * N, ACC, between=" "))
        np.testing.assert_allclose(si.GroundMotion.read(file, unit="m/s^2").values, ACC)


def test_an_integer_behind_a_clock_is_no_fraction_of_a_second(tmp_path):
    lines = "".join(f"2024-05-01 12:00:{n:02d},{100 + n},{a:.3f}\n" for n, a in enumerate(ACC))
    file = written(tmp_path, "TIMESTAMP,RECORD,Acc1\n" + lines)
    np.testing.assert_allclose(si.GroundMotion.read(file, dt=0.02, unit="m/s^2", column="Acc1").values, ACC)


def test_moments_are_newton_metres(tmp_path):
    file = written(tmp_path, "Time [s];M [kNm]\n" + rows(0.01 * N, ACC))
    np.testing.assert_allclose(read_signal(file, "kN*m", si_unit="N*m").values[:, 0], 1000.0 * ACC)


@pytest.mark.parametrize(
    "arguments", [{"dt": 0}, {"dt": -1.0}, {"column": 1.0}, {"component": 1.5}, {"time_column": [1]}, {"unit": 5}]
)
def test_arguments_of_the_wrong_type(arguments, tmp_path):
    file = written(tmp_path, "Time [s];Acc [g]\n" + rows(0.01 * N, ACC))
    with pytest.raises(InputError):
        si.GroundMotion.read(file, **arguments)


def each(form):
    return "".join(form.format(n=n) for n in range(9))


LOGGERS = {
    "TOA5": (
        '"TOA5","st","CR6","1","2","3","4","T"\n"TIMESTAMP","RECORD","Acc1","Acc2"\n"TS","RN","g","g"\n"","","Smp","Smp"\n'
        + each('"2024-05-01 12:00:0{n}",{n},0.{n},1.{n}\n'),
        {"dt": 0.02, "column": "Acc1"},
    ),
    "date and clock in two columns": (
        "Datum;Zeit;A [g]\n" + each("01.05.2024;12:00:0{n},00;0,{n}\n"),
        {"dt": 0.02, "column": 2},
    ),
    "an American date": ("Time,A [g]\n" + each("05/01/2024 12:00:0{n}.01 PM,0.{n}\n"), {"dt": 0.02, "column": 1}),
    "a time zone": ("Time,A [g]\n" + each("2024-05-01T12:00:0{n}+02:00,0.{n}\n"), {"dt": 0.02, "column": 1}),
    "a column of words": ("t [s];a [g];state\n" + each("0.0{n};0.{n};OK\n"), {"column": 1}),
    "a comment at the end": ("t [s];a [g]\n" + each("0.0{n};0.{n}\n") + "# end\n", {}),
    "lines of separators at the end": ("t [s];a [g]\n" + each("0.0{n};0.{n}\n") + ";\n;;\n", {}),
    "a temperature": ("Zeitpunkt;a [g];T [\u00b0C]\n" + each("0.0{n};0.{n};2{n}.0\n"), {"column": 1}),
    "an empty first title": ("\ta [g]\n" + each("{n}\t0.{n}\n"), {"dt": 1.0, "column": 1}),
    "a date above the titles": ("2024-05-01\nTime [s];A [g]\n" + each("0.0{n};0.{n}\n"), {}),
    "a function": ("t [s];a(t) [g]\n" + each("0.0{n};0.{n}\n"), {}),
    "a direction": ("t [s];Acc (N) [g]\n" + each("0.0{n};0.{n}\n"), {}),
    "a typographic minus": ("t [s];a [g]\n" + each("0.0{n};\u22120.{n}\n").replace("\u22120.0", "0.0"), {"sign": -1.0}),
}


@pytest.mark.parametrize("how", LOGGERS)
def test_files_of_loggers(how, tmp_path):
    text, arguments = LOGGERS[how]
    arguments = dict(arguments)
    sign = arguments.pop("sign", 1.0)
    values = read_signal(written(tmp_path, text), si_unit="m/s^2", **arguments).values[:, 0]
    np.testing.assert_allclose(values, sign * 0.1 * 9.80665 * np.arange(9), atol=1e-12)


def test_thousands_with_spaces_between_cells(tmp_path):
    text = "t F\n0.00 1,234.5\n0.01 -2,000.0\n0.02 3.0\n"
    np.testing.assert_allclose(read_signal(written(tmp_path, text), "N").values[:, 0], [1234.5, -2000.0, 3.0])
    text = "t [s];F [N]\n0,00;3\u202f100,5\n0,01;-2\u00a0000,0\n0,02;3,0\n"
    np.testing.assert_allclose(read_signal(written(tmp_path, text)).values[:, 0], [3100.5, -2000.0, 3.0])


def test_a_line_that_looks_like_titles_above_the_titles(tmp_path):
    """A specimen called T1-1 is no time, and a file without times has sample numbers, not seconds."""
    path = tmp_path / "wall.csv"
    path.write_text(
        "Test unit,T1-1\nReference,Faella et al. (1992)\ndisplacement,force,drift\n[mm],[kN],[%]\n"
        + "".join(f"{n * n % 17},{-(n % 5)},{n * n % 17 / 12:.3f}\n" for n in range(60))
    )
    overview = si.look(path)
    assert [facts.channel.name for facts in overview.channels] == ["displacement", "force", "drift"]
    assert [facts.channel.unit for facts in overview.channels][:2] == ["mm", "kN"]
    assert "peak 16 at sample" in str(overview) and "to 59 s" not in str(overview)
