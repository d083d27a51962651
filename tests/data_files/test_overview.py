"""What `look` shows of a file: faults that were put in are found, and a clean signal has none."""

import numpy as np
import pytest

import structid as si
from structid.data_files.base import FileChannel
from structid.data_files.inspection import compare, facts_of
from structid.data_files.overview import relations

DT = 0.01
TIMES = DT * np.arange(3000)


def shaking(seed=1, samples=3000):
    """Filtered noise under an envelope, at rest for the first two seconds."""
    rng = np.random.default_rng(seed)
    noise = np.convolve(rng.standard_normal(samples), np.hanning(15), "same")
    t = DT * np.arange(samples)
    return noise * np.clip(t - 2.0, 0.0, None) * np.exp(-0.3 * t)


def channel(values, name="a", **more):
    return FileChannel(name, values, "m/s^2", dt=DT, quantity="acceleration", **more)


def kinds(values, **more):
    return [finding.kind for finding in facts_of(channel(values, **more)).findings]


def zeros(values):
    values[800:1000] = 0.0


def missing(values):
    values[800:850] = np.nan


def dead(values):
    values[1200:] = values[1199]


def clipped(values):
    np.clip(values, -0.6 * np.abs(values).max(), 0.6 * np.abs(values).max(), out=values)


def spike(values):
    values[600] += 3.0 * np.abs(values).max()


def offset(values):
    values += 0.2 * np.abs(values).max()


def constant(values):
    values[:] = 3.0


FAULTS = {
    "gap": zeros, "a gap of missing samples": missing, "dead": dead, "saturation": clipped, "spike": spike, "offset": offset,
    "constant": constant,
}  # fmt: skip


@pytest.mark.parametrize("seed", range(20))
def test_a_clean_signal_has_no_finding(seed):
    assert kinds(shaking(seed) + 1e-4 * np.random.default_rng(seed).standard_normal(3000)) == []


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("seed", range(5))
def test_a_fault_is_found(name, seed):
    values = shaking(seed)
    FAULTS[name](values)
    assert set(kinds(values)) == {"gap" if name.startswith("a gap") else name}


def test_rate_length_and_peak():
    values = shaking()
    facts = facts_of(channel(values, start=-5.0))
    at = int(np.abs(values).argmax())
    assert facts.dt == DT and facts.length == pytest.approx(DT * 2999)
    assert facts.peak == values[at] and facts.peak_time == pytest.approx(-5.0 + DT * at)


def test_a_jump_in_uneven_times_is_named():
    times = TIMES.copy()
    times[1500:] += 0.5
    facts = facts_of(FileChannel("a", shaking(), "m/s^2", times=times, quantity="acceleration"))
    assert [finding.kind for finding in facts.findings] == ["gap"]
    assert "from 14.99 to 15.5 s" in facts.findings[0].sentence


@pytest.mark.parametrize("lag", [0.0, 0.37, -1.2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_lag_and_sign_of_two_signals_at_different_rates(lag, sign):
    def signal(t):
        return np.exp(-(((t - 12.0) / 4.0) ** 2)) * np.sin(2.0 * np.pi * 1.3 * t + 0.05 * t**2)

    first = FileChannel("a", signal(TIMES), "m/s^2", dt=DT, quantity="acceleration")
    times = np.arange(3840) / 128.0
    second = FileChannel("b", sign * 0.8 * signal(times - lag), "m/s^2", dt=1.0 / 128.0, quantity="acceleration")
    found = compare(first, second)
    assert found.correlation == pytest.approx(sign, abs=0.01) and found.lag == pytest.approx(lag, abs=DT)


def table(tmp_path, name, **columns):
    titles = ["time [s]", *(f"{title} [m/s^2]" for title in columns)]
    rows = np.stack([TIMES, *columns.values()], axis=1)
    file = tmp_path / name
    file.write_text(",".join(titles) + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows))
    return file


def test_reversed_repeated_and_swapped_channels(tmp_path):
    north, east = shaking(1), shaking(2)
    one = si.look(table(tmp_path, "one.csv", N=north, E=east))
    two = si.look(table(tmp_path, "two.csv", N=0.9 * east, E=1.1 * north))
    sentences = relations([one, two])
    assert sum("are the channels swapped?" in sentence for sentence in sentences) == 1
    three = si.look(table(tmp_path, "three.csv", N=-north, E=east))
    sentences = relations([one, three])
    assert any("moves against" in s and "polarity reversed" in s and "'N [m/s^2]'" in s for s in sentences)
    assert any("holds the same values" in s for s in sentences) and not any("swapped" in s for s in sentences)
    assert not relations([one])


def test_an_overview_prints_every_channel(tmp_path):
    values = shaking()
    spike(values)
    text = str(si.look(table(tmp_path, "one.csv", floor=values)))
    assert "one.csv: text columns, 1 channel" in text and "1 'floor [m/s^2]': acceleration in m/s^2, 100 Hz" in text
    assert "spike: 1 spike of a single sample, the first at 6 s" in text
