"""Accuracy of the evidence from tempered SMC within its stated error, and detection of wrong values.

Run with ``python benchmarks/evidence.py [--quick] [--program NAME]``. Nested sampling by dynesty and UltraNest, with default
settings, serves for comparison. The runs of every density by every program are recorded, and the page has all recorded ones.
"""

from __future__ import annotations

import argparse
import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import common
import dynesty
import numpy as np
import scipy.integrate
import scipy.special
import scipy.stats

import structid as si

NAME = "evidence"
SEEDS, QUICK_SEEDS = 10, 2
PEER_SEEDS = 3
FOR_PEERS = 10
"""Largest dimension for the peers, which take tens of minutes in 20, apart from one case."""
MOST_CALLS = 1_000_000
"""Calls after which a peer is stopped."""
FEW_CALLS = si.SMC(particles=200, ensembles=2, steps=20, effective_share=0.3, correlation=0.6, scouts=0)
"""Settings for expensive densities, without a search for lost modes."""
RIGHT = 3.0
"""Largest error of a right log evidence, in its stated errors."""
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


def shells(dimension: int) -> Case:
    """Two spherical shells of radius 2 and width 0.1, 7 apart (F. Feroz & M. Hobson 2008, doi 10.1111/j.1365-2966.2007.12353.x)."""
    radius, width = 2.0, 0.1
    centre = np.zeros(dimension)
    centre[0] = 3.5

    def density(x: np.ndarray) -> np.ndarray:
        distances = (np.linalg.norm(x - centre, axis=1), np.linalg.norm(x + centre, axis=1))
        return np.logaddexp(*(normal(distance, radius, width) for distance in distances))

    sphere = np.log(2.0) + 0.5 * dimension * np.log(np.pi) - scipy.special.gammaln(0.5 * dimension)
    inside = scipy.integrate.quad(lambda r: r ** (dimension - 1) * np.exp(normal(r, radius, width)), 1.0, 3.0)[0]
    return Case("two shells", dimension, density, 6.0, float(np.log(2.0) + sphere + np.log(inside)))


def eggbox() -> Case:
    """(2 + cos ½x cos ½y)⁵ over a square of 10π, with eighteen modes (same source)."""

    def density(x: np.ndarray) -> np.ndarray:
        return (2.0 + np.prod(np.cos(0.5 * (x + 5.0 * np.pi)), axis=1)) ** 5

    side = np.linspace(-5.0 * np.pi, 5.0 * np.pi, 4001)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    logs = density(grid).reshape(4001, 4001)
    weights = np.exp(logs - logs.max())
    whole = scipy.integrate.trapezoid(scipy.integrate.trapezoid(weights, side), side)
    return Case("eggbox", 2, density, 5.0 * np.pi, float(np.log(whole) + logs.max()))


def rosenbrock(dimension: int) -> Case:
    """Σ over pairs of −(1 − x)² − 100 (y − x²)², in a box of ±5."""

    def of_pair(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return -((1.0 - x) ** 2) - 100.0 * (y - x**2) ** 2

    def density(x: np.ndarray) -> np.ndarray:
        return of_pair(x[:, ::2], x[:, 1::2]).sum(axis=1)

    def inside(x: float) -> float:
        both = scipy.special.erf(10.0 * (5.0 - x**2)) + scipy.special.erf(10.0 * (5.0 + x**2))
        return float(np.exp(-((1.0 - x) ** 2)) * np.sqrt(np.pi) / 20.0 * both)

    whole = scipy.integrate.quad(inside, -5.0, 5.0, points=[-(5.0**0.5), 5.0**0.5], limit=200)[0]
    return Case("Rosenbrock", dimension, density, 5.0, 0.5 * dimension * float(np.log(whole)))


def heavy_tails(dimension: int) -> Case:
    """Multivariate t with ν = 2, in a box of ±30."""
    half_width, nu = 30.0, 2.0
    law = scipy.stats.multivariate_t(np.zeros(dimension), np.eye(dimension), df=nu)

    def inside(chi: float) -> float:
        share = scipy.special.erf(half_width * np.sqrt(0.5 * chi / nu)) ** dimension
        return float(share * scipy.stats.chi2.pdf(chi, nu))

    whole = scipy.integrate.quad(inside, 0.0, 60.0, points=[1e-3, 1e-2, 0.1, 1.0], limit=500)[0]
    return Case("t with ν = 2", dimension, law.logpdf, half_width, float(np.log(whole)))


def correlated(dimension: int) -> Case:
    """Gaussian density with unit variances and correlations of 0.95, well inside its box."""
    matrix = np.full((dimension, dimension), 0.95) + 0.05 * np.eye(dimension)
    law = scipy.stats.multivariate_normal(np.zeros(dimension), matrix)
    return Case("Gaussian with correlations of 0.95", dimension, lambda x: np.atleast_1d(law.logpdf(x)))


def cases() -> list[Case]:
    """All densities."""
    makers: tuple[Callable[[int], Case], ...] = (
        gaussian,
        lambda d: two_modes("two equal modes", d, WIDE, 0.5),
        lambda d: two_modes("one mode half as wide, with twice the mass", d, NARROW, 2.0 / 3.0),
        funnel,
    )
    further = [shells(2), shells(10), eggbox(), rosenbrock(2), rosenbrock(6), heavy_tails(5), correlated(20)]
    return [*(make(dimension) for make in makers for dimension in (10, 20)), *further]


class Counted:
    """A density that counts the points at which it is computed."""

    def __init__(self, density: LogPdf) -> None:
        self._density, self.calls = density, 0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the log density."""
        self.calls += len(x)
        return np.atleast_1d(self._density(x))


def ours(case: Case, seed: int, sampler: si.SMC) -> dict[str, float]:
    """Run SMC once."""
    began, counted = time.perf_counter(), Counted(case.density)
    result = si.sample(replace(case, density=counted).target, sampler, seed=seed)
    evidence = result.log_evidence
    assert evidence is not None
    error = evidence.value - case.log_evidence
    believed = evidence.at_rest and result.verdict().converged
    return {
        "error": error,
        "z": error / evidence.error,
        "believed": float(believed),
        "calls": float(counted.calls),
        "seconds": time.perf_counter() - began,
    }


def with_dynesty(case: Case, seed: int) -> dict[str, float]:
    """Run dynesty's static sampler once with default settings."""
    counted, volume = Counted(case.density), case.dimension * np.log(2.0 * case.half_width)
    began = time.perf_counter()
    sampler = dynesty.NestedSampler(
        lambda x: float(counted(x[None])[0] + volume),
        lambda u: case.half_width * (2.0 * u - 1.0),
        case.dimension,
        rstate=np.random.default_rng(seed),
    )
    sampler.run_nested(print_progress=False, maxcall=MOST_CALLS)
    return peer_run(case, float(sampler.results.logz[-1]), float(sampler.results.logzerr[-1]), counted.calls, began)


def with_ultranest(case: Case, seed: int) -> dict[str, float]:
    """Run UltraNest's reactive sampler once with default settings, many points at once."""
    from ultranest import ReactiveNestedSampler

    counted, volume = Counted(case.density), case.dimension * np.log(2.0 * case.half_width)
    np.random.seed(seed)  # noqa: NPY002 - the only source of UltraNest
    began = time.perf_counter()
    sampler = ReactiveNestedSampler(
        [f"x{i}" for i in range(case.dimension)],
        lambda x: counted(x) + volume,
        lambda u: case.half_width * (2.0 * u - 1.0),
        vectorized=True,
    )
    found = sampler.run(show_status=False, viz_callback=None, max_ncalls=MOST_CALLS)
    return peer_run(case, float(found["logz"]), float(found["logzerr"]), counted.calls, began)


def peer_run(case: Case, value: float, stated: float, calls: int, began: float) -> dict[str, float]:
    """What one run of a peer gives."""
    error = value - case.log_evidence
    return {"error": error, "z": error / stated, "calls": float(calls), "seconds": time.perf_counter() - began}


PROGRAMS: dict[str, Callable[[Case, int], dict[str, float]]] = {
    "SMC()": lambda case, seed: ours(case, seed, si.SMC()),
    "few calls": lambda case, seed: ours(case, seed, FEW_CALLS),
    "dynesty": with_dynesty,
    "UltraNest": with_ultranest,
}
PEERS = ("dynesty", "UltraNest")


def suits(program: str, case: Case) -> bool:
    """Whether a program is there, and takes less than tens of minutes."""
    if program in PEERS and importlib.util.find_spec(program.lower()) is None:
        return False
    return program not in PEERS or case.dimension <= FOR_PEERS or case.name.startswith("Gaussian with")


def column(rows: list[dict[str, float]], name: str) -> np.ndarray:
    return np.array([r[name] for r in rows])


def cells(runs: list[dict[str, float]], *, accepted: bool = False) -> list[str]:
    """Errors, right runs, calls and seconds of one program, and the runs that it accepts."""
    if not runs:
        return ["–"] * 4
    errors, z = column(runs, "error"), np.abs(column(runs, "z"))
    found = [
        f"{errors.mean():+.2f} ± {errors.std():.2f}",
        f"{(z <= RIGHT).sum()} of {len(runs)}",
        f"{np.median(column(runs, 'calls')) / 1e3:.0f}",
        f"{np.median(column(runs, 'seconds')):.0f}",
    ]
    if not accepted:
        return found
    believed = column(runs, "believed") > 0.0
    worst = f"{z[believed].max():.1f}" if believed.any() else "none accepted"
    return [*found, f"{believed.sum()} of {len(runs)}", worst]


def row(case: Case, recorded: dict[tuple[Any, ...], dict[str, Any]]) -> list[str]:
    """A row of the table."""
    runs = {program: recorded.get((case.name, case.dimension, program), {"runs": []})["runs"] for program in PROGRAMS}
    return [
        f"{case.name}, d = {case.dimension}",
        *(cell for program in PROGRAMS for cell in cells(runs[program], accepted=program == "SMC()")),
    ]


def page_text(recorded: dict[tuple[Any, ...], dict[str, Any]]) -> str:
    """The page of all recorded runs."""
    each = ["error of log Z", "right", "thousand calls", "seconds"]
    header = ["density"]
    for program in PROGRAMS:
        header += [f"{program}: {of_one}" for of_one in each]
        if program == "SMC()":
            header += ["accepted", "largest accepted error [stated errors]"]
    done = [case for case in cases() if any(key[:2] == (case.name, case.dimension) for key in recorded)]
    return f"""
# Evidence

`benchmarks/evidence.py`. {common.machine("dynesty", "ultranest")}.

Each row has {SEEDS} seeds of `SMC()` and of SMC with few calls
(`{FEW_CALLS.particles}` particles, `{FEW_CALLS.ensembles}` populations, no search for lost modes), {PEER_SEEDS} seeds of dynesty's
static sampler and {PEER_SEEDS} of UltraNest's reactive sampler, both with default settings; they are stopped after
{MOST_CALLS / 1e6:g} million calls. A log evidence is right if it lies within {RIGHT:g} of its stated errors. A run is accepted if
its particles were stationary and its verdict is *converged*. The modes are at ±3 in every coordinate of a box of ±10.
In 20 dimensions, the basin of the narrow mode covers 0.025 % of the prior; a verdict of `SMC()` says that basins of less than
0.075 % may be missing. A dash marks runs that were not made; the peers take tens of minutes in 20 dimensions.

{common.markdown_table(header, [row(case, recorded) for case in done])}
"""


def main() -> None:
    """Run the programs on all densities, and write the page of all recorded runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few densities and seeds; does not write to docs/")
    parser.add_argument("--program", choices=PROGRAMS, action="append", help="programs of this run; default: all")
    asked = parser.parse_args()
    programs = asked.program or (["SMC()", "few calls"] if asked.quick else list(PROGRAMS))
    for case in cases()[:: 4 if asked.quick else 1]:
        for program in filter(lambda one, case=case: suits(one, case), programs):
            seeds = QUICK_SEEDS if asked.quick else PEER_SEEDS if program in PEERS else SEEDS
            runs = [PROGRAMS[program](case, seed) for seed in range(seeds)]
            found = {"case": case.name, "dimension": case.dimension, "program": program, "runs": runs}
            common.record_result(NAME, quick=asked.quick, **found)
            print(case.name, case.dimension, program, *cells(runs), flush=True)
    recorded = common.last_results(NAME, "case", "dimension", "program", quick=asked.quick)
    common.write_page(asked.quick, NAME, page_text(recorded))


if __name__ == "__main__":
    main()
