#!/usr/bin/env bash
# pydantic 2.14.4: strict mode takes NumPy's masked value for NaN and an array without axes for a float, and refuses np.int64 for an int.
#
# Guess before the run: "strict" means no conversion, so that a float field takes float and its subclass np.float64, and refuses
# np.float32, an array and a masked value; an int field takes np.int64 as the counterpart of np.float64.
# Seen: everything with a __float__ passes as a float, also in strict mode. A masked sample, which was not measured, becomes NaN.
# For int the rule is the opposite: np.int64, which every index and count of NumPy is, is refused.
set -eu
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "pydantic==2.14.4" "numpy==2.4.6"
cat > "$work/strict.py" <<'PY'
import warnings

import numpy as np
from pydantic import TypeAdapter, ValidationError

warnings.simplefilter("ignore")


def taken(kind, value):
    """What a strict field makes of a value."""
    try:
        return repr(TypeAdapter(kind).validate_python(value, strict=True))
    except ValidationError as problem:
        return problem.errors()[0]["type"]


record = np.ma.masked_invalid([0.1, np.nan, 0.3])
seen = [
    taken(float, np.float32(0.5)),
    taken(float, np.array(0.5)),
    taken(float, record[1]),
    taken(int, np.int64(3)),
    taken(float, "0.5"),
]
print(*seen)
assert seen == ["0.5", "0.5", "nan", "int_type", "float_type"]
PY
"$work/venv/bin/python" "$work/strict.py"
# Output: 0.5 0.5 nan int_type float_type
