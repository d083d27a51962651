#!/usr/bin/env bash
# OpenSeesPy 3.7.1.2: a Path time series of N samples may not act at its last sample.
#
# Guess before the run: a record of N samples at 0.01 s, integrated in N - 1 steps of 0.01 s, acts at all of its samples.
# Seen: for 101 and 2001 samples the mass does not feel the last one, for 1001 it does. The domain's time is a sum of steps, which
# rounding puts above the time of the last sample for some lengths; behind its end the series is zero. With -useLast all act.
set -eu
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "openseespy==3.7.1.2" "openseespylinux==3.7.1.2"
cat > "$work/last.py" <<'PY'
import openseespy.opensees as ops

def velocity(samples, *options):
    """Of a unit mass on a soft spring, after a record that is zero but for its last sample."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.node(1, 0.0)
    ops.node(2, 0.0)
    ops.fix(1, 1)
    ops.mass(2, 1.0)
    ops.uniaxialMaterial("Elastic", 1, 1.0)
    ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)
    ops.timeSeries("Path", 1, "-dt", 0.01, "-values", *([0.0] * (samples - 1) + [5.0]), *options)
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.system("BandGeneral")
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.algorithm("Linear")
    ops.analysis("Transient")
    assert ops.analyze(samples - 1, 0.01) == 0
    return ops.nodeVel(2, 1)

felt = {n: abs(velocity(n)) > 1e-6 for n in (101, 1001, 2001)}
with_last = {n: abs(velocity(n, "-useLast")) > 1e-6 for n in (101, 1001, 2001)}
print("felt the last sample:", felt, "with -useLast:", with_last)
assert felt == {101: False, 1001: True, 2001: False} and all(with_last.values())
PY
"$work/venv/bin/python" "$work/last.py" 2>/dev/null
# Output: felt the last sample: {101: False, 1001: True, 2001: False} with -useLast: {101: True, 1001: True, 2001: True}
