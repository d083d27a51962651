"""What a channel of a file shows by itself, without a model: rate, peak, offset, gaps, saturation, spikes, polarity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from structid.data_files.base import FileChannel

SHORTEST_GAP = 1.0
"""Duration of exact zeros [s] that indicates lost values if the signal moves."""

MOVING = 0.1
"""Fraction of its peak that a signal must reach within `SHORTEST_GAP` of a gap; zeros after a quiet end are no gap."""

FEWEST = 20
"""Minimum number of samples of a stretch."""

FLAT_TOP = 3
"""Minimum number of samples in a flat top, and of resolution steps by which the signal must rise to it."""

ONE_SIDED = 0.5
"""Fraction of the peak that an extreme must reach; a smaller extreme may be the zero line of a one-sided signal."""

SPIKE = 15.0
"""Deviation from the neighbours, in robust standard deviations of such deviations, that makes a single sample a spike."""

SPIKE_SIZE = 0.2
"""The same deviation relative to the peak."""

ALIKE = 0.7
"""Correlation from which two signals show the same motion."""

LONGEST_LAG = 5.0
"""Largest lag between two signals [s] that is searched."""


@dataclass(frozen=True)
class Finding:
    """What is remarkable in a channel: a kind, such as "gap", and a sentence."""

    kind: str
    sentence: str


@dataclass(frozen=True, eq=False)
class ChannelFacts:
    """A channel, and what it shows."""

    channel: FileChannel
    dt: float | None  # time step [s]; None if it is not constant
    length: float  # duration [s]
    peak: float  # largest value, with its sign, in the unit of the channel
    peak_time: float  # time of the peak [s]
    mean: float  # in the unit of the channel
    findings: tuple[Finding, ...]


def facts_of(channel: FileChannel) -> ChannelFacts:
    """Describe a channel."""
    values, times = channel.values, times_of(channel)
    filled = np.nan_to_num(values)
    at = int(np.abs(filled).argmax())
    step = channel.dt if channel.dt is not None else float(np.median(np.diff(times)))
    findings = [*_missing(values, times), *_steps(channel, times)]
    if np.ptp(filled) == 0.0:
        findings.append(Finding("constant", f"the value is {filled[0]:.4g} throughout: did the sensor fail?"))
    else:
        findings += [*_zeros(filled, times, step), *_dead(filled, times), *_flat_tops(filled), *_spikes(values, times)]
        findings += _offset(filled)
    return ChannelFacts(
        channel=channel,
        dt=channel.dt,
        length=float(times[-1] - times[0]),
        peak=float(filled[at]),
        peak_time=float(times[at]),
        mean=float(np.nanmean(values)) if np.isfinite(values).any() else 0.0,
        findings=tuple(findings),
    )


def times_of(channel: FileChannel) -> Float[np.ndarray, " time"]:
    """Times of the samples in the time base of the file [s]."""
    if channel.times is not None:
        return channel.times
    assert channel.dt is not None
    return channel.start + channel.dt * np.arange(len(channel.values))


def stretches(marked: Bool[np.ndarray, " time"]) -> Iterator[tuple[int, int]]:
    """Return first and behind-last index of each stretch of marked samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.view(np.int8), [0]])))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def zero_gaps(values: Float[np.ndarray, " time"], dt: float) -> Iterator[tuple[int, int]]:
    """Return the stretches of exact zeros next to large values."""
    near = max(int(np.ceil(SHORTEST_GAP / dt)), FEWEST) if dt > 0.0 else len(values)
    peak = np.abs(values).max()
    for begin, end in stretches(values == 0.0):
        around = np.concatenate([values[max(begin - near, 0) : begin], values[end : end + near]])
        if begin > 0 and end - begin >= near and np.abs(around).max() > MOVING * peak:
            yield begin, end


def flat_tops(values: Float[np.ndarray, " time"]) -> list[tuple[float, list[int]]]:
    """Return the extremes at which a signal stays, with the lengths of the flat tops in samples."""
    steps = np.abs(np.diff(values))
    if not steps.any():
        return []
    resolution = steps[steps > 0.0].min()
    found = []
    for extreme in (values.max(), values.min()):
        if abs(extreme) < ONE_SIDED * np.abs(values).max():
            continue
        lengths = [
            end - begin
            for begin, end in stretches(values == extreme)
            if end - begin >= FLAT_TOP
            and begin > 0
            and end < len(values)
            # A smooth peak is also flat if the resolution is coarse, but the signal then rises in single resolution steps.
            and min(steps[begin - 1], steps[end - 1]) > FLAT_TOP * resolution
        ]
        if lengths:
            found.append((float(extreme), lengths))
    return found


def spikes(values: Float[np.ndarray, " time"]) -> list[int]:
    """Return single samples that leave the signal and return to it at once."""
    if len(values) < FEWEST:
        return []
    deviation = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    around = np.abs(values[2:] - values[:-2])
    scale = 1.4826 * float(np.nanmedian(np.abs(deviation - np.nanmedian(deviation))))
    peak = float(np.nanmax(np.abs(values - np.nanmedian(values))))
    large = (np.abs(deviation) > max(SPIKE * scale, SPIKE_SIZE * peak)) & (around < 0.25 * np.abs(deviation))
    return (np.flatnonzero(large) + 1).tolist()


def _missing(values: np.ndarray, times: np.ndarray) -> list[Finding]:
    """Report missing samples."""
    missing = list(stretches(~np.isfinite(values)))
    if not missing:
        return []
    count = sum(end - begin for begin, end in missing)
    begin, end = max(missing, key=lambda pair: pair[1] - pair[0])
    return [Finding("gap", f"{count} samples are missing, the most from {times[begin]:.4g} to {times[end - 1]:.4g} s")]


def _steps(channel: FileChannel, times: np.ndarray) -> list[Finding]:
    """Report jumps in uneven times."""
    if channel.times is None or len(times) < 3 or channel.counted:
        return []
    steps = np.diff(times)
    usual = float(np.median(steps))
    jumps = np.flatnonzero(steps > 1.5 * usual)
    if 0 < len(jumps) <= 0.05 * len(steps):
        at = int(jumps[steps[jumps].argmax()])
        return [
            Finding("gap", f"{len(jumps)} jumps in time, the longest from {times[at]:.6g} to {times[at + 1]:.6g} s")
        ]
    return [Finding("uneven", f"the time steps vary from {steps.min():.3g} to {steps.max():.3g} s")]


def _zeros(values: np.ndarray, times: np.ndarray, step: float) -> list[Finding]:
    """Report exact zeros while the signal moves."""
    return [
        Finding("gap", f"exactly zero from {times[begin]:.4g} to {times[end - 1]:.4g} s, next to large values")
        for begin, end in zero_gaps(values, step)
        if end < len(values)
    ]


def _dead(values: np.ndarray, times: np.ndarray) -> list[Finding]:
    """Report a signal that stays at one value until its end while it was moving."""
    last = len(values) - 1 - int(np.argmax((values != values[-1])[::-1]))
    still = len(values) - 1 - last
    before = values[max(last - 2 * FEWEST, 0) : last + 1]
    if still < max(FEWEST, 0.05 * len(values)) or np.abs(before - values[-1]).max() < MOVING * np.ptp(values):
        return []
    return [
        Finding(
            "dead", f"the value is {values[-1]:.4g} from {times[last + 1]:.4g} s to the end: did the sensor fail there?"
        )
    ]


def _flat_tops(values: np.ndarray) -> list[Finding]:
    """Report saturation."""
    return [
        Finding(
            "saturation",
            f"the value stays at {extreme:.4g} for up to {max(lengths)} samples, {len(lengths)} times: saturated?",
        )
        for extreme, lengths in flat_tops(values)
    ]


def _spikes(values: np.ndarray, times: np.ndarray) -> list[Finding]:
    """Report spikes."""
    at = spikes(values)
    if not at:
        return []
    return [
        Finding(
            "spike",
            f"{len(at)} spike{'s' if len(at) > 1 else ''} of a single sample, the first at {times[at[0]]:.4g} s",
        )
    ]


def _offset(values: np.ndarray) -> list[Finding]:
    """Report a mean at rest, before the signal leaves it."""
    tenth = values[: max(len(values) // 20, FEWEST)]
    rest, spread = float(tenth.mean()), float(tenth.std())
    peak = float(np.abs(values - rest).max())
    if spread < 0.02 * peak and abs(rest) > max(0.02 * peak, 5.0 * spread / np.sqrt(len(tenth))):
        return [Finding("offset", f"the mean before the motion is {rest:.4g}, {abs(rest) / peak:.0%} of the peak")]
    return []


# --- two channels ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Comparison:
    """Correlation of two channels at the lag at which it is largest."""

    correlation: float
    lag: float  # time by which the second is later [s], each in the time base of its file


def compare(first: FileChannel, second: FileChannel) -> Comparison | None:
    """Correlate two channels; linear interpolation to one step serves only this comparison."""
    a_times, b_times = times_of(first), times_of(second)
    step = max(float(np.median(np.diff(a_times))), float(np.median(np.diff(b_times))))
    begin, end = min(a_times[0], b_times[0]), max(a_times[-1], b_times[-1])
    count = int((end - begin) / step) + 1
    if count < FEWEST or count > 4_000_000:
        return None
    grid = begin + step * np.arange(count)
    a, b = (_on_grid(grid, times, channel.values) for times, channel in ((a_times, first), (b_times, second)))
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    if scale == 0.0:
        return None
    size = 1 << (2 * count - 1).bit_length()
    # c(τ) = Σ a(t) b(t + τ)
    c = np.fft.irfft(np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size), size) / scale
    reach = min(int(LONGEST_LAG / step), count - 1)
    lags = np.concatenate([np.arange(reach + 1), np.arange(-reach, 0)])
    at = int(lags[np.abs(c[lags]).argmax()])
    return Comparison(float(c[at]), at * step)


def _on_grid(grid: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate a signal without its mean; it is zero outside its times."""
    known = np.isfinite(values)
    centred = values - np.mean(values[known])
    return np.asarray(np.interp(grid, times[known], centred[known], left=0.0, right=0.0))


def comparisons(channels: Sequence[tuple[str, FileChannel]]) -> list[str]:
    """Say which channels move against one another, lag, repeat one another, or seem to be swapped.

    `channels` are pairs of a label and a channel; only channels of one quantity are compared.
    """
    sentences = []
    for n, (name, channel) in enumerate(channels):
        for other_name, other in channels[n + 1 :]:
            if channel.quantity != other.quantity or channel.unit != other.unit:
                continue
            found = compare(channel, other)
            if found is not None and abs(found.correlation) >= ALIKE:
                sentences.append(_sentence(name, other_name, channel, other, found))
    return sentences


def _sentence(name: str, other_name: str, channel: FileChannel, other: FileChannel, found: Comparison) -> str:
    later = (
        f"{other_name} is {abs(found.lag):.4g} s {'later' if found.lag > 0 else 'earlier'} than {name}"
        if found.lag
        else ""
    )
    same = len(channel.values) == len(other.values) and np.array_equal(channel.values, other.values)
    if same:
        return f"{other_name} holds the same values as {name}."
    if found.correlation < 0.0:
        return (
            f"{other_name} moves against {name} (correlation {found.correlation:.2f}{f'; {later}' if later else ''}): is its "
            "polarity reversed?"
        )
    return f"{other_name} moves with {name} (correlation {found.correlation:.2f}){f', and {later}' if later else ''}."
