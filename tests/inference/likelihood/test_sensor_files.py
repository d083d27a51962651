"""Files of sensors: their time base, missing lines and cells, gaps and baselines, and what is refused."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.study.run import load
from studies import SMALL

RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(2.0)


def wave(times):
    return np.sin(2.0 * np.pi * 1.3 * times)


def written(path, times, values=None, digits=6, skipped=(), empty=()):
    """A table of a logger without some lines, and with some empty cells."""
    values = wave(times) if values is None else values
    lines = ["time [s];velocity [m/s]"]
    for row, (time, value) in enumerate(zip(times, values, strict=True)):
        if row not in skipped:
            lines.append(f"{time:.{digits}f};{'' if row in empty else f'{value:.9f}'}")
    path.write_text("\n".join(lines) + "\n")
    return path


def read(path, **settings):
    return si.Observation.read(RECORD, path, **settings)


@pytest.mark.parametrize("start", [0.0, 0.0049, 0.000005])
def test_the_first_time_counts_however_small(start, tmp_path):
    path = written(tmp_path / "a.csv", start + RECORD.time)
    measured = read(path)
    np.testing.assert_allclose(measured.values[:, 0], wave(measured.time), atol=1e-3 if 0 < start < 1e-4 else 1e-8)
    assert measured.begin == pytest.approx(0.0 if start < 1e-4 else start)


def test_missing_lines_and_cells_are_missing_values(tmp_path):
    path = written(tmp_path / "a.csv", RECORD.time, skipped=range(50, 75), empty=(3, 200))
    with pytest.raises(InputError, match=r"line 5.*an empty cell.*leave_out|follows"):
        read(path)
    measured = read(path, missing="leave_out")
    assert measured.missing == 27 and len(measured.values) == len(RECORD)
    known = measured.is_measured[:, 0]
    np.testing.assert_allclose(measured.values[known, 0], wave(RECORD.time[known]), atol=1e-8)
    assert not known[[3, 60, 200]].any()


@pytest.mark.parametrize(("digits", "settings"), [(6, {}), (4, {}), (3, {"dt": 1.0 / 256.0})])
def test_a_long_gap_between_rounded_times(digits, settings, tmp_path):
    """256 Hz: 0.0039 s is printed for 0.00390625 s, and a gap of 2 s is 512 steps, not 513."""
    times = np.arange(1537) / 256.0
    path = written(tmp_path / "a.csv", times, digits=digits, skipped=range(257, 768))
    measured = read(path, missing="leave_out", time_shift=0.0, **settings)
    assert measured.dt == 1.0 / 256.0 and measured.missing == 511
    known = measured.is_measured[:, 0]
    np.testing.assert_allclose(measured.values[known, 0], wave(measured.time[known]), atol=1e-8)


def test_a_gap_includes_its_edges(tmp_path):
    """Times such as 95 · 0.01 lie above 0.95 by a rounding error."""
    path = written(tmp_path / "a.csv", RECORD.time)
    for first in range(1, 60):
        measured = read(path, gaps=[(first / 100.0, (first + 50) / 100.0)])
        assert np.flatnonzero(~measured.is_measured[:, 0]).tolist() == list(range(first, first + 51))
    assert read(path, gaps=[(0.57, 0.57), (5.0, 99.0)]).missing == 1 + 101


def test_a_baseline_is_the_mean_at_rest(tmp_path):
    rest = RECORD.time < 1.0
    values = np.where(rest, 0.0, wave(RECORD.time)) + 0.25
    path = written(tmp_path / "a.csv", RECORD.time, values, empty=(7,))
    measured = read(path, baseline=(0.0, 0.99), missing="leave_out")
    np.testing.assert_allclose(measured.values[rest & measured.is_measured[:, 0], 0], 0.0, atol=1e-8)
    np.testing.assert_allclose(measured.values[~rest, 0], wave(RECORD.time[~rest]), atol=1e-8)
    record = si.GroundMotion(values, RECORD.dt).baseline((0.0, 0.99))
    np.testing.assert_allclose(record.values[rest], 0.0, atol=1e-12)
    drifting = written(tmp_path / "b.csv", RECORD.time, values + 0.02 * RECORD.time)
    line = read(drifting, baseline=[(0.0, 0.4), (0.6, 0.99)]).values[:, 0]
    np.testing.assert_allclose(line, values - 0.25, atol=1e-7)
    drifted = si.GroundMotion(values + 0.02 * RECORD.time, RECORD.dt).baseline([(0.0, 0.4), (0.6, 0.99)])
    np.testing.assert_allclose(drifted.values, values - 0.25, atol=1e-12)
    with pytest.raises(InputError, match=r"baseline.*no value between 90 and 99 s"):
        si.GroundMotion(values, RECORD.dt).baseline((90.0, 99.0))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"gaps": [(1.0,)]}, r"gaps.*\(1.0,\).*pair of times"),
        ({"gaps": (1.0, 2.0)}, r"gaps.*1.0.*pair of times"),
        ({"gaps": [("1 s", "2 s")]}, "gaps.*pair of times"),
        ({"gaps": [(70.0, 80.0)]}, "no sample between 70 and 80 s"),
        ({"baseline": (0.0,)}, "baseline.*pair of times"),
        ({"time_shift": True}, "time_shift.*True"),
        ({"missing": "skip"}, "missing.*skip"),
        ({"polarity": "up"}, "polarity.*up"),
        ({"time_shift": -50.0}, "times within the record.*sign"),
    ],
)
def test_mistakes_are_refused_in_one_paragraph(settings, words, tmp_path):
    path = written(tmp_path / "a.csv", RECORD.time)
    with pytest.raises(InputError, match=words):
        read(path, **settings)


def test_times_in_disorder_are_refused(tmp_path):
    times = RECORD.time.copy()
    times[[50, 51]] = times[[51, 50]]
    with pytest.raises(InputError, match="Sort the lines by time"):
        read(written(tmp_path / "a.csv", times), missing="leave_out")
    (tmp_path / "one.csv").write_text("time [s];velocity [m/s]\n0.0;1.0\n" + ";1.0\n" * 50)
    with pytest.raises(InputError, match="1 times"):
        read(tmp_path / "one.csv", missing="leave_out")
    with pytest.raises(InputError, match="no values"):
        si.Observation(RECORD, [], dt=0.5, start=0.2)


def test_missing_samples_of_a_file_without_columns_are_refused_too(tmp_path):
    obspy = pytest.importorskip("obspy")
    values = wave(RECORD.time)
    values[30:40] = np.nan
    obspy.Trace(values.astype(np.float32), {"delta": 0.01, "channel": "HNE"}).write(str(tmp_path / "a.sac"), "SAC")
    with pytest.raises(InputError, match=r"10 of 601 values.*leave_out"):
        read(tmp_path / "a.sac", unit="m/s")
    assert read(tmp_path / "a.sac", unit="m/s", missing="leave_out").missing == 10


def test_a_copy_is_refused_though_it_lacks_values():
    values = wave(RECORD.time) + 0.01 * np.random.default_rng(1).normal(size=len(RECORD))
    whole = si.Observation(RECORD, values)
    gap = values.copy()
    gap[100:150] = np.nan
    for copy in (si.Observation(RECORD, gap), si.Observation(RECORD, values[40:], start=0.4), whole):
        with pytest.raises(InputError, match="repeats the measurement of observation 1"):
            copy.check_new([whole])
    other = values + 0.01 * np.random.default_rng(2).normal(size=len(RECORD))
    si.Observation(RECORD, other).check_new([whole])
    si.Observation(RECORD, values[::2], dt=0.02).check_new([whole])


def test_a_reversed_sensor_of_a_virtual_experiment_shows_the_reversed_motion(tmp_path):
    plain, turned = tmp_path / "plain.toml", tmp_path / "turned.toml"
    plain.write_text(SMALL)
    turned.write_text(SMALL.replace("[observation.virtual]", 'polarity = "reversed"\n[observation.virtual]', 1))
    first, second = (load(path).posterior for path in (plain, turned))
    np.testing.assert_array_equal(first.observations[0].values, -second.observations[0].values)
    theta = first.space.sample(3, seed=1).values
    np.testing.assert_allclose(first.log_density(theta), second.log_density(theta), rtol=1e-12)
