"""Records: readers, filters, measures, and what is refused at the door."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.ground_motion import processing

pytestmark = pytest.mark.quick

HEADER = "PEER NGA STRONG MOTION DATABASE RECORD\nSomewhere, 1/1/1999, Station, 180\nACCELERATION TIME SERIES IN UNITS OF G\n"


def at2(path, values, npts=None, head=None):
    npts = len(values) if npts is None else npts
    head = f"NPTS=  {npts}, DT=   .0100 SEC," if head is None else head
    rows = [" ".join(f"{v:.7E}" for v in values[i : i + 5]) for i in range(0, len(values), 5)]
    path.write_text(HEADER + head + "\n" + "\n".join(rows) + "\n")
    return path


def test_peer_file_is_read_in_si(tmp_path):
    values = np.linspace(-0.1, 0.3, 13)
    record = si.GroundMotion.read(at2(tmp_path / "a.AT2", values))
    np.testing.assert_allclose(record.values, values * 9.80665, rtol=1e-6)
    assert record.dt == 0.01
    assert record.name == "a"


@pytest.mark.parametrize("head", ["  13   0.0100   NPTS, DT", "NPTS=13, DT= .0100 SEC"])
def test_older_headers(tmp_path, head):
    assert len(si.GroundMotion.read(at2(tmp_path / "a.at2", np.arange(13.0), head=head))) == 13


@pytest.mark.parametrize(
    "name", ["RSN6_IMPVALL.I_I-ELC180.AT2", "Rinaldi228.AT2", "OpenSees_elCentro.AT2", "OpenSees_ARL360.at2"]
)
def test_real_files(strong_motion, name):
    record = si.GroundMotion.read(strong_motion / name)
    assert 0.5 < record.pga < 15.0
    assert record.dt in (0.01, 0.02)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda p: at2(p, np.arange(10.0), npts=12), ["line 4", "NPTS = 12", "10 values", "incomplete"]),
        (lambda p: at2(p, np.array([0.1, np.nan, 0.2])), ["line 5", "NAN", "finite"]),
        (lambda p: p.write_text(""), ["empty"]),
        (lambda p: p.write_text("hello\nworld\n"), ["NPTS"]),
        (lambda p: None, ["no such file"]),
    ],
)
def test_bad_peer_files_say_where_and_what(tmp_path, make, words):
    path = tmp_path / "bad.AT2"
    make(path)
    with pytest.raises(InputError) as error:
        si.GroundMotion.read(path)
    assert all(word.lower() in str(error.value).lower() for word in ["bad.AT2", *words])


def test_columns_with_and_without_time(tmp_path):
    time = np.arange(50) * 0.02
    (tmp_path / "two.csv").write_text("time [s],a\n" + "\n".join(f"{t:.2f},{np.sin(t)}" for t in time))
    np.testing.assert_allclose(si.GroundMotion.read(tmp_path / "two.csv", unit="g").values, np.sin(time) * 9.80665)
    (tmp_path / "one.txt").write_text("\n".join(f"{np.sin(t)}" for t in time))
    assert si.GroundMotion.read(tmp_path / "one.txt", dt=0.02, unit="cm/s^2").dt == 0.02
    (tmp_path / "broken.csv").write_text("0.00,1\n0.01,2\n0.05,3\n")
    with pytest.raises(InputError, match=r"line 2.*constant step"):
        si.GroundMotion.read(tmp_path / "broken.csv", unit="g")
    with pytest.raises(InputError, match="the unit of a text file is missing"):
        si.GroundMotion.read(tmp_path / "two.csv")


def test_round_trip_through_csv(tmp_path, record):
    again = si.GroundMotion.read(record.to_csv(tmp_path / "r.csv", unit="cm/s^2"), unit="cm/s^2")
    np.testing.assert_allclose(again.values, record.values, rtol=1e-10, atol=1e-12)
    assert again.dt == pytest.approx(record.dt)


def test_butterworth_order_and_loss_of_the_source():
    # Passband 20 Hz, 3 dB there, 8 dB at 25 Hz: order 3 at 0.01 s; forward and backward the loss at 20 Hz is 6 dB.
    assert processing.butterworth_order(20.0, 0.01) == 3
    impulse = np.zeros(4096)
    impulse[2048] = 1.0
    gain = np.abs(np.fft.rfft(processing.butterworth(impulse, 0.01, 20.0, "lowpass", 3)))
    at_edge = np.interp(20.0, np.fft.rfftfreq(4096, 0.01), gain)
    assert 20 * np.log10(at_edge) == pytest.approx(-2 * 3.0103, abs=0.02)


def test_filters_shift_no_phase_and_pass_their_band():
    t = np.arange(4000) * 0.01
    slow, fast = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 40.0 * t)
    window = slice(1000, 3000)
    record = si.GroundMotion(slow + fast, 0.01)
    np.testing.assert_allclose(record.lowpass(10.0, order=6).values[window], slow[window], atol=1e-3)
    np.testing.assert_allclose(record.highpass(10.0, order=6).values[window], fast[window], atol=1e-3)
    np.testing.assert_allclose(record.bandpass(0.2, 10.0, order=3).values[window], slow[window], atol=6e-3)


def test_edges_beyond_nyquist_are_refused(record):
    with pytest.raises(InputError, match="Nyquist"):
        record.lowpass(60.0)


def test_operations_return_new_records(record):
    before = record.values.copy()
    assert record.scale_to_pga(3.59).pga == pytest.approx(3.59, rel=1e-14)
    assert record.trim(1.0, 2.0).duration == pytest.approx(1.0)
    assert len(record.pad(1.0, 2.0)) == len(record) + 300
    assert record.baseline("linear").values.mean() == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_array_equal(record.values, before)
    with pytest.raises(ValueError, match="read-only"):
        record.values[0] = 1.0


def test_resampling_keeps_a_band_limited_signal():
    t = np.arange(2001) * 0.01
    record = si.GroundMotion(np.sin(2 * np.pi * 3.0 * t) * np.sin(np.pi * t / 20.0) ** 2, 0.01)
    fine = record.resample(0.005)
    np.testing.assert_allclose(fine.values[::2][:2001], record.values, atol=2e-3)


def test_measures_of_a_sine():
    t = np.arange(10_001) * 0.001
    record = si.GroundMotion(2.0 * np.sin(2 * np.pi * 2.0 * t), 0.001)
    assert record.arias_intensity == pytest.approx(np.pi / (2 * 9.80665) * 2.0 * 10.0, rel=1e-6)
    assert record.significant_duration == pytest.approx(9.0, rel=1e-2)
    assert record.dominant_frequency == pytest.approx(2.0, abs=0.1)
    assert record.pgv == pytest.approx(2 * 2.0 / (2 * np.pi * 2.0), rel=1e-4)
    assert "2 Hz" in str(record) and "PGA 2 m/s²" in str(record)


def test_synthetic_record_has_its_measures_on_average():
    records = [si.GroundMotion.synthetic(seed=s, arias=1.3, significant_duration=9.0, middle=7.0) for s in range(24)]
    arias = [r.arias_intensity for r in records]
    lengths = [r.significant_duration for r in records]
    assert np.mean(arias) == pytest.approx(1.3, abs=4 * np.std(arias) / np.sqrt(24) + 0.05)
    assert np.mean(lengths) == pytest.approx(9.0, abs=4 * np.std(lengths) / np.sqrt(24) + 0.5)
    np.testing.assert_array_equal(
        records[3].values, si.GroundMotion.synthetic(seed=3, arias=1.3, significant_duration=9.0, middle=7.0).values
    )
    # The high-pass leaves no drift: velocity returns towards zero.
    assert max(abs(r.velocity[-1]) / r.pgv for r in records) < 0.05


def test_periodic_interpolation_is_the_fourier_series():
    t = np.arange(64) / 64
    force = si.ForceHistory(np.cos(2 * np.pi * 5 * t + 0.3), 1 / 64, interpolation="periodic", lead_in_periods=1)
    stages = force.stage_values(4)
    assert stages.shape == (64 + 63, 4, 3)
    fine = np.arange(127 * 4) / (64 * 4)
    np.testing.assert_allclose(stages[:, :, 0].ravel(), np.cos(2 * np.pi * 5 * fine + 0.3), atol=1e-12)
    np.testing.assert_allclose(stages[:, :, 1].ravel(), np.cos(2 * np.pi * 5 * (fine + 1 / 512) + 0.3), atol=1e-12)


@pytest.mark.parametrize(("values", "dt"), [([1.0], 0.1), ([[1.0, 2.0]], 0.1), ([0.0, np.inf], 0.1), ([0.0, 1.0], 0.0)])
def test_bad_signals_are_stopped_at_the_door(values, dt):
    with pytest.raises(InputError):
        si.GroundMotion(values, dt)


@pytest.mark.rendered
def test_plots_are_saved_as_png_and_pdf(tmp_path, record):
    record.plot(tmp_path / "record")
    record.plot_filter(record.lowpass(5.0), tmp_path / "filter")
    for name in ("record", "filter"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
        assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("peak", [-1.0, 0.0, np.nan, np.inf])
def test_a_peak_that_is_no_peak_is_refused(peak):
    with pytest.raises(InputError, match=r"a positive peak|nan, which is not a number"):
        si.GroundMotion.synthetic(seed=1).scale_to_pga(peak)


@pytest.mark.parametrize(("start", "end"), [(0.0, 1e9), (-1.0, 5.0), (5.0, 5.0), (7.0, 2.0), (np.nan, 5.0)])
def test_an_interval_outside_the_record_is_refused(start, end):
    with pytest.raises(InputError, match=r"an interval between 0 s and 40 s|nan, which is not a number"):
        si.GroundMotion.synthetic(seed=1).trim(start, end)


@pytest.mark.parametrize(
    "change", [lambda r: r.highpass(1e-9), lambda r: r.highpass(0.1, order=99), lambda r: r.highpass(0.1, order=0)]
)
def test_filters_that_float64_cannot_hold_are_refused(change):
    with pytest.raises(InputError, match="highpass"):
        change(si.GroundMotion.synthetic(seed=1))


@pytest.mark.parametrize(("interpolation", "order"), [("linear", 2), ("smooth", 4)])
def test_what_interpolation_takes_from_a_sine(interpolation, order):
    """Straight lines (ω dt)²/12 of its amplitude, and splines only a power of four of ω dt."""
    lost = []
    for samples in (10, 20, 40):
        values = np.sin(2.0 * np.pi * np.arange(40 * samples) / samples)
        force = si.ForceHistory(values, 1.0, interpolation=interpolation)
        stages = force.stage_values(32)[5 * samples : -5 * samples].reshape(-1, 3)[:, 0]
        place = 5 * samples + np.arange(len(stages)) / 32
        sine = np.sin(2.0 * np.pi * place / samples)
        lost.append(1.0 - stages @ sine / (sine @ sine))
    assert np.diff(-np.log2(lost)) == pytest.approx([order, order], abs=0.15)
    if interpolation == "linear":
        assert lost[1] == pytest.approx((2.0 * np.pi / 20) ** 2 / 12.0, rel=0.02)


def test_a_smooth_force_has_no_lead_in():
    with pytest.raises(InputError, match="smooth interpolation"):
        si.ForceHistory(np.ones(10), 0.1, interpolation="smooth", lead_in_periods=2)
