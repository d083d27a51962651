"""Narrow modes inside a wide one: how often tempered SMC finds them, and whether it calls a run without them converged.

Run with ``python benchmarks/spikes.py [--quick]``.
"""

from __future__ import annotations

import collections
import itertools
import time

import common
import numpy as np
import scipy

import structid as si

NAME = "spikes"
SEEDS = 10
DIMENSIONS = (2, 3, 5, 8)
WIDTHS = (0.01, 0.03, 0.1, 0.3)
"""Standard deviation of the narrow mode, divided by that of the wide one."""
SHARES = (0.1, 0.5, 0.9)
"""Share of the narrow mode in the mass."""
HALF_WIDTH = 5.0
"""Half-width of the box, in standard deviations of the wide mode."""
RIGHT = 3.0
"""Largest error of a right log evidence, in its stated errors."""
FOUND, REFUSED, FALSE = "found", "not converged", "converged without it"

normal = scipy.stats.norm.logpdf


def spike(dimension: int, width: float, share: float, rng: np.random.Generator) -> tuple[si.LogDensity, float]:
    """The density of both modes and its log evidence; the narrow mode lies at a draw from the wide one."""
    names = tuple(f"x{i}" for i in range(dimension))
    box, centre = (-HALF_WIDTH, HALF_WIDTH), np.clip(rng.normal(size=dimension), -3.0, 3.0)

    def density(x: np.ndarray) -> np.ndarray:
        wide = np.log1p(-share) + normal(x).sum(axis=1)
        return np.logaddexp(wide, np.log(share) + normal(x, centre, width).sum(axis=1))

    def inside(middle: np.ndarray, sd: float) -> float:
        return float(np.prod(np.diff(scipy.stats.norm.cdf(np.array(box), middle[:, None], sd), axis=1)))

    log_evidence = np.log((1.0 - share) * inside(np.zeros(dimension), 1.0) + share * inside(centre, width))
    space = si.ParameterSpace(**{name: si.Uniform(*box) for name in names})
    return si.LogDensity(density, names, space, dict.fromkeys(names, box)), float(log_evidence)


def basin(dimension: int, width: float) -> float:
    """Part of the box in which the narrow mode is denser than the wide one, for equal masses and a usual place of the mode."""
    radius = width * np.sqrt(2.0 * (0.5 * dimension - dimension * np.log(width)))
    volume = np.pi ** (0.5 * dimension) / scipy.special.gamma(0.5 * dimension + 1.0) * radius**dimension
    return float(volume / (2.0 * HALF_WIDTH) ** dimension)


def outcome(dimension: int, width: float, share: float, seed: int) -> tuple[str, float]:
    """What one run says, and its error of the log evidence in stated errors."""
    target, log_evidence = spike(dimension, width, share, np.random.default_rng([dimension, seed]))
    result = si.sample(target, si.SMC(), seed=seed)
    assert result.log_evidence is not None
    error = (result.log_evidence.value - log_evidence) / result.log_evidence.error
    if not (result.log_evidence.at_rest and result.verdict().converged):
        return REFUSED, error
    return (FOUND if abs(error) <= RIGHT else FALSE), error


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    dimensions, widths, shares, seeds = ((2,), (0.1,), (0.5,), 1) if quick else (DIMENSIONS, WIDTHS, SHARES, SEEDS)
    rows = []
    for dimension, width in itertools.product(dimensions, widths):
        began, counts, worst = time.perf_counter(), [], 0.0
        for share in shares:
            found = [outcome(dimension, width, share, seed) for seed in range(seeds)]
            counts.append(collections.Counter(name for name, _ in found))
            worst = max([worst, *(abs(error) for name, error in found if name != REFUSED)])
        seconds = (time.perf_counter() - began) / (len(shares) * seeds)
        each = [" / ".join(str(count[name]) for name in (FOUND, REFUSED, FALSE)) for count in counts]
        rows.append(
            [str(dimension), f"{width:g}", f"{basin(dimension, width):.0e}", *each, f"{worst:.1f}", f"{seconds:.1f}"]
        )
        print(" | ".join(rows[-1]), flush=True)
    heads = [
        "parameters",
        "width",
        "basin",
        *(f"share {share:g}" for share in shares),
        "largest error of a converged run [stated errors]",
        "seconds",
    ]
    text = f"""# Narrow modes inside a wide one

`benchmarks/spikes.py`. {common.machine()}.

A standard normal density in a box of ±{HALF_WIDTH:g} standard deviations has a second, narrow mode inside it. The table has a row
for each number of parameters and each width of the narrow mode, relative to the wide one, and a column for each share of the narrow
mode in the mass. Each cell counts {seeds} runs of `SMC()` with different seeds and places of the mode: *found* (converged, with a
log evidence within {RIGHT:g} of its stated errors) / *not converged* / *converged without it*. The basin is the part of the box in
which the narrow mode is denser than the wide one. A verdict *converged* names the smallest basin whose mode is found with a
probability of 95 %: {3 / 4000:.1g} of the box. Of a basin of 1e-9, a run of half a million points sees nothing.

{common.markdown_table(heads, rows)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=rows)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
