#!/usr/bin/env bash
# ArviZ 0.23.4: loo takes log-likelihoods of other draws than the posterior's, and judges the tail by both.
#
# Guess before the run: with 100 000 draws in the group posterior and 300 of them in log_likelihood, loo refuses, or counts 300.
# Seen: no word about the numbers. The relative efficiency is the effective size of the 100 000 divided by 300, some hundred, so
# that fewer than five draws are left for the tail, and loo warns of a Pareto tail that it cannot fit. The same 300 in both groups are fine.
set -eu
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "arviz==0.23.4" "numpy==2.4.6" "scipy==1.17.1"
cat > "$work/loo.py" <<'PY'
import warnings

import numpy as np

warnings.simplefilter("ignore")
import arviz as az

rng = np.random.default_rng(1)
y = rng.normal(size=50)

def kinds(draws, thinned):
    """What loo says of a normal mean, with that many draws in either group."""
    mean = rng.normal(y.mean(), 1.0 / np.sqrt(50), (4, draws))
    some = mean.reshape(1, -1)[:, :thinned]
    likelihood = -0.5 * (y - some[:, :, None]) ** 2 - 0.5 * np.log(2 * np.pi)
    posterior = {"mean": some if draws * 4 == thinned else mean}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = az.loo(az.from_dict(posterior=posterior, log_likelihood={"y": likelihood}))
    return bool(found.warning), len(told)

other, same = kinds(25_000, 300), kinds(75, 300)
print("300 of 100 000 draws: warned", other[0], "- the same 300: warned", same[0])
assert other[0] and not same[0]
PY
"$work/venv/bin/python" "$work/loo.py"
# Output: 300 of 100 000 draws: warned True - the same 300: warned False
