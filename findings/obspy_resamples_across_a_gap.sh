#!/usr/bin/env bash
# ObsPy 1.5.1: of the operations on a trace with a gap, most refuse the gap, but resample, integrate and decimate(no_filter=True)
# compute with the number under the mask, and return an array without a mask.
#
# Guess before the run: a trace that Stream.merge() has joined across a gap holds a masked array, and every operation that needs
# a continuous signal refuses it with the message on split(), as filter and interpolate do.
# Seen: filter, detrend, interpolate and decimate with its filter refuse it. resample, integrate and decimate(no_filter=True) do
# not. For 32-bit counts, as in miniSEED, the number under the mask is -2147483648: the resampled signal of 1000 counts reaches
# 2.1e9 counts, rings for seconds beside the gap, and nothing is masked. No warning is given.
set -eu
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "obspy==1.5.1" "numpy==2.3.5" "setuptools<81"
cat > "$work/gap.py" <<'PY'
import sys
import warnings

import numpy as np
from obspy import Stream, Trace, UTCDateTime

COUNTS = np.rint(1000 * np.sin(2 * np.pi * np.arange(4000) / 100)).astype(np.int32)


def with_gap():
    """A sine of 1000 counts at 100 Hz with two seconds missing, as two records of miniSEED give it."""
    before = Trace(COUNTS[:1500].copy(), {"delta": 0.01})
    after = Trace(COUNTS[1700:].copy(), {"delta": 0.01, "starttime": UTCDateTime(0) + 17.0})
    stream = Stream([before, after])
    stream.merge()
    return stream[0]


def outcome(operation):
    """How an operation ends: refused, or the number of masked samples and whether values of a million counts appear."""
    trace = with_gap()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            data = operation(trace).data
        except NotImplementedError:
            return "refused"
    told = [str(w.message) for w in warned if "mask" in str(w.message).lower() or "gap" in str(w.message).lower()]
    size = "beyond a million" if np.abs(np.ma.getdata(data).astype(float)).max() > 1e6 else "as measured"
    return f"{np.ma.count_masked(data)} masked, {size}, {len(told)} warnings"


seen = {
    "filter": outcome(lambda trace: trace.filter("lowpass", freq=10.0)),
    "detrend": outcome(lambda trace: trace.detrend("demean")),
    "interpolate": outcome(lambda trace: trace.interpolate(200.0)),
    "decimate with its filter": outcome(lambda trace: trace.decimate(2)),
    "resample": outcome(lambda trace: trace.resample(200.0)),
    "integrate": outcome(lambda trace: trace.integrate()),
    "decimate without": outcome(lambda trace: trace.decimate(2, no_filter=True)),
}
for name, how in seen.items():
    print(f"{name}: {how}")
refused = all(seen[name] == "refused" for name in ("filter", "detrend", "interpolate", "decimate with its filter"))
used = all(seen[name] == "0 masked, beyond a million, 0 warnings" for name in ("resample", "integrate", "decimate without"))
sys.exit(0 if refused and used else 1)
PY
"$work/venv/bin/python" "$work/gap.py"
