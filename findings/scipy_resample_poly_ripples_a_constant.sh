#!/usr/bin/env bash
# SciPy 1.17.1: resample_poly does not pass a constant.
#
# Guess before the run: far from its ends, a constant signal resampled to twice the rate is the same constant to rounding, and with
# padtype="line", which knows a line, at its ends too.
# Seen: everywhere the samples alternate between 1 + 5.2e-4 and 1 - 5.2e-4, with padtype="line" as well. The kernel as a whole has a gain
# of one, each of its phases has not. Only the padtypes that take a number off first ("mean") are exact.
set -eu
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "numpy==2.4.6" "scipy==1.17.1"
cat > "$work/ripple.py" <<'PY'
import numpy as np
from scipy.signal import resample_poly

def ripple(padtype):
    found = resample_poly(np.ones(4000), 2, 1, padtype=padtype)
    return float(np.ptp(found[2000:6000]) / 2.0)

found = {padtype: ripple(padtype) for padtype in ("constant", "line", "mean")}
print("ripple of a constant:", {padtype: f"{value:.1e}" for padtype, value in found.items()})
assert 5.0e-4 < found["constant"] < 5.4e-4 and found["line"] == found["constant"] and found["mean"] < 1e-12
PY
"$work/venv/bin/python" "$work/ripple.py"
# Output: ripple of a constant: {'constant': '5.2e-04', 'line': '5.2e-04', 'mean': '0.0e+00'}
