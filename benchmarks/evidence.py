"""Accuracy of the evidence from tempered SMC within its stated error, and detection of wrong values.

Run with ``python benchmarks/evidence.py [--quick]``. Nested sampling by dynesty, with default settings, serves for comparison.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import common
import dynesty
import numpy as np
import scipy.integrate
import scipy.special
import scipy.stats

import structid as si

NAME = "evidence"
SEEDS, QUICK_SEEDS = 20, 2
PEER_SEEDS, PEER_DIMENSION = 3, 10
"""Nested sampling takes minutes in 20 dimensions."""
HALF_WIDTH = 10.0
NARROW, WIDE, MODE = 0.15, 0.3, 3.0
"""Widths of the modes, and their position: ±3 in every coordinate."""
FUNNEL_WIDTH = 30.0

LogPdf = Callable[[np.ndarray], np.ndarray]
normal = scipy.stats.norm.logpdf


@dataclass(frozen=True)
class Case:
    """A density on [−w, w]^d and the logarithm of its integral."""

    name: str
    dimension: int
    density: LogPdf
    half_width: float = HALF_WIDTH
    log_evidence: float = 0.0

    @property
    def target(self) -> si.LogDensity:
        """The density, with a uniform prior on [−w, w]^d."""
        names = tuple(f"x{i}" for i in range(self.dimension))
        box = (-self.half_width, self.half_width)
        space = si.ParameterSpace(**{n: si.Uniform(*box) for n in names})
        return si.LogDensity(self.density, names, space, dict.fromkeys(names, box))


def gaussian(dimension: int) -> Case:
    """Gaussian density with standard deviations from 0.05 to 1."""
    widths = np.geomspace(0.05, 1.0, dimension)
    return Case("Gaussian", dimension, lambda x: normal(x, 0.5, widths).sum(axis=1))


def two_modes(name: str, dimension: int, width: float, mass: float) -> Case:
    """A mode of given width and mass at +3, and a mode of width 0.3 with the remaining mass at −3."""

    def density(x: np.ndarray) -> np.ndarray:
        one = np.log(mass) + normal(x, MODE, width).sum(axis=1)
        return np.logaddexp(one, np.log1p(-mass) + normal(x, -MODE, WIDE).sum(axis=1))

    return Case(name, dimension, density)


def funnel(dimension: int) -> Case:
    """Neal's funnel, v ~ N(0, 3), x_i ~ N(0, e^(v/2)) (R. Neal 2003, doi 10.1214/aos/1056562461)."""

    def density(x: np.ndarray) -> np.ndarray:
        v, others = x[:, 0], x[:, 1:]
        return normal(v, 0.0, 3.0) + normal(others, 0.0, np.exp(0.5 * v)[:, None]).sum(axis=1)

    def inside(v: float) -> float:
        share = scipy.special.erf(FUNNEL_WIDTH / np.sqrt(2.0) / np.exp(0.5 * v)) ** (dimension - 1)
        return float(np.exp(normal(v, 0.0, 3.0)) * share)

    whole = scipy.integrate.quad(inside, -FUNNEL_WIDTH, FUNNEL_WIDTH, limit=500, points=[0.0, 3.0, 5.0, 7.0])[0]
    return Case("funnel", dimension, density, FUNNEL_WIDTH, float(np.log(whole)))


def cases() -> list[Case]:
    """All densities, in 10 and 20 dimensions."""
    makers: tuple[Callable[[int], Case], ...] = (
        gaussian,
        lambda d: two_modes("two equal modes", d, WIDE, 0.5),
        lambda d: two_modes("one mode half as wide, with twice the mass", d, NARROW, 2.0 / 3.0),
        funnel,
    )
    return [make(dimension) for make in makers for dimension in (10, 20)]


def ours(case: Case, seed: int) -> dict[str, float]:
    """Run SMC once with default settings."""
    began = time.perf_counter()
    result = si.sample(case.target, si.SMC(), seed=seed)
    evidence = result.log_evidence
    assert evidence is not None
    error = evidence.value - case.log_evidence
    believed = evidence.at_rest and result.verdict().converged
    return {
        "error": error,
        "z": error / evidence.error,
        "believed": float(believed),
        "seconds": time.perf_counter() - began,
    }


def nested(case: Case, seed: int) -> dict[str, float]:
    """Run dynesty's static sampler once with default settings."""
    calls = 0

    def likelihood(x: np.ndarray) -> float:
        nonlocal calls
        calls += 1
        return float(case.density(x[None])[0] + case.dimension * np.log(2.0 * case.half_width))

    began = time.perf_counter()
    sampler = dynesty.NestedSampler(
        likelihood,
        lambda u: case.half_width * (2.0 * u - 1.0),
        case.dimension,
        rstate=np.random.default_rng(seed),
    )
    sampler.run_nested(print_progress=False)
    error = float(sampler.results.logz[-1]) - case.log_evidence
    return {"error": error, "z": error / float(sampler.results.logzerr[-1]), "seconds": time.perf_counter() - began}


def row(case: Case, runs: list[dict[str, float]], peers: list[dict[str, float]]) -> list[str]:
    """A row of the table."""

    def column(rows: list[dict[str, float]], name: str) -> np.ndarray:
        return np.array([r[name] for r in rows])

    def errors(rows: list[dict[str, float]]) -> str:
        found = column(rows, "error")
        return f"{found.mean():+.2f} ± {found.std():.2f}"

    believed = column(runs, "believed") > 0.0
    worst = f"{np.abs(column(runs, 'z'))[believed].max():.1f}" if believed.any() else "none accepted"
    peer = ["–", "–", "–"]
    if peers:
        peer = [errors(peers), f"{np.abs(column(peers, 'z')).max():.1f}", f"{np.median(column(peers, 'seconds')):.0f}"]
    seconds = f"{np.median(column(runs, 'seconds')):.0f}"
    return [
        f"{case.name}, d = {case.dimension}",
        errors(runs),
        f"{believed.sum()} of {len(runs)}",
        worst,
        seconds,
        *peer,
    ]


def main() -> None:
    """Run all cases and write the table."""
    quick = common.is_quick(__doc__ or "")
    rows: list[list[str]] = []
    for case in cases()[:: 4 if quick else 1]:
        runs = [ours(case, seed) for seed in range(QUICK_SEEDS if quick else SEEDS)]
        wanted = case.dimension <= PEER_DIMENSION and not quick
        peers = [nested(case, seed) for seed in range(PEER_SEEDS)] if wanted else []
        found: dict[str, Any] = {"case": case.name, "dimension": case.dimension, "runs": runs, "nested": peers}
        common.record_result(NAME, quick=quick, **found)
        rows.append(row(case, runs, peers))
        print(rows[-1], flush=True)
    header = [
        "density",
        "error of log Z",
        "accepted",
        "largest accepted error [stated errors]",
        "seconds",
        "dynesty: error of log Z",
        "dynesty: largest error [stated errors]",
        "dynesty: seconds",
    ]
    text = f"""
# Evidence

{common.machine("dynesty")}. Each row has {SEEDS} seeds of `SMC()` and {PEER_SEEDS} seeds of dynesty's static sampler, both with
default settings. A run is accepted if its particles were stationary and its verdict is *converged*. The modes are at ±3 in every
coordinate; the prior range is −10 to 10.

{common.markdown_table(header, rows)}
"""
    common.write_page(quick, NAME, text)


if __name__ == "__main__":
    main()
