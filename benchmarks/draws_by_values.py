"""Detection of draws from another density when the log density is available only at the draws.

Run with ``python benchmarks/draws_by_values.py [--quick]``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import common
import numpy as np
import scipy

import structid as si
from structid.certification.external.draws_without_density import ValuesAtDraws
from structid.certification.external.stein_identity import not_its_draws
from structid.certification.monte_carlo_error import MonteCarloError

NAME = "draws_by_values"
SEEDS = 12
DRAWS = 8000
WIDE = 1e3
"""Bound of the priors in standard deviations, for densities that fall to zero well inside it."""
HEADS = [
    "draws",
    "correct outcome",
    "accepted",
    "refused: wrong values",
    "refused: another density",
    "refused: too few draws",
    "undecided",
    "seconds",
]
REFUSALS = (
    "a log density that does not match the draws",
    "these are not draws of the given density",
    "there are too few draws",
    "cannot decide whether the draws follow it",
)
"""Parts of the messages about a contradicting fitted density, Stein's identity, the Monte Carlo error, and large errors of the
identity. The first match counts."""
TAU = 50
"""Autocorrelation time of the autoregressive chains, in steps."""
LogDensity = Callable[[np.ndarray], np.ndarray]
"""Function of points, shape (point, parameter)."""
Sampler = Callable[[np.random.Generator], np.ndarray]
"""Function that returns draws, shape (draw, parameter) or (chain, draw, parameter)."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """Draws of a density.

    Parameters
    ----------
    log_density : callable
        Log density, used only at the draws.
    sampler : callable
        Function that generates the draws.
    dimension : int
        Number of parameters.
    bound : float
        The priors are uniform between −bound and bound.
    right : str
        Correct outcome.
    """

    log_density: LogDensity
    sampler: Sampler
    dimension: int
    bound: float = WIDE
    right: str = "accepted"


# --- densities and draws --------------------------------------------------------------------------------------------


def normal(theta: np.ndarray) -> np.ndarray:
    return np.asarray(-0.5 * (theta**2).sum(axis=-1))


def student(theta: np.ndarray) -> np.ndarray:
    return np.asarray(scipy.stats.t(5).logpdf(theta).sum(axis=-1))


def exponential(theta: np.ndarray) -> np.ndarray:
    """Log density that decreases from its largest value, which is at a bound of the prior."""
    return np.asarray(-2.0 * (theta + 1.0).sum(axis=-1))


def ridge(theta: np.ndarray) -> np.ndarray:
    """Rosenbrock's log density, which is narrow and curved."""
    return np.asarray(-((1.0 - theta[..., 0]) ** 2) - 100.0 * (theta[..., 1] - theta[..., 0] ** 2) ** 2)


def of_the_exponential(rng: np.random.Generator) -> np.ndarray:
    return -1.0 - 0.5 * np.log1p(-rng.random((DRAWS, 3)) * (1.0 - np.exp(-4.0)))


def of_the_ridge(rng: np.random.Generator) -> np.ndarray:
    along = rng.normal(1.0, np.sqrt(0.5), DRAWS)
    return np.column_stack([along, rng.normal(along**2, np.sqrt(0.005))])


def of_the_normal(dimension: int, draws: int = DRAWS) -> Sampler:
    return lambda rng: rng.standard_normal((draws, dimension))


def kept(sampler: Sampler, inside: Callable[[np.ndarray], np.ndarray]) -> Sampler:
    """Sampler that keeps only the draws inside a region."""

    def part(rng: np.random.Generator) -> np.ndarray:
        theta = sampler(rng)
        return theta[inside(theta)]

    return part


def random_walk(dimension: int, steps: int, scale: float) -> Sampler:
    """Four Metropolis chains that start at draws of the normal density."""

    def chains(rng: np.random.Generator) -> np.ndarray:
        theta, found = rng.standard_normal((4, dimension)), []
        for _ in range(steps):
            proposed = theta + scale * rng.standard_normal(theta.shape)
            accepted = np.log(rng.random(4)) < normal(proposed) - normal(theta)
            theta = np.where(accepted[:, None], proposed, theta)
            found.append(theta)
        return np.swapaxes(np.array(found), 0, 1)

    return chains


def autoregressive(dimension: int, steps: int) -> Sampler:
    """32 autoregressive chains of the normal density, with autocorrelation time τ = (1 + ρ)/(1 − ρ)."""

    def chains(rng: np.random.Generator) -> np.ndarray:
        rho = (TAU - 1.0) / (TAU + 1.0)
        noise = rng.standard_normal((32, steps, dimension)) * np.sqrt(1.0 - rho**2)
        noise[:, 0] /= np.sqrt(1.0 - rho**2)  # starts in the normal density
        return np.asarray(scipy.signal.lfilter([1.0], [1.0, -rho], noise, axis=1))

    return chains


def cases() -> dict[str, Drawn]:
    """Return all cases: correct draws, wrong draws, and draws for which the gradient is inconclusive."""
    found = {f"normal, d = {d}": Drawn(normal, of_the_normal(d), d) for d in (1, 4, 10)}
    found |= {
        "normal, d = 4, Metropolis chains": Drawn(normal, random_walk(4, 8000, 1.0), 4),
        "Student's t, five degrees of freedom, d = 4": Drawn(student, lambda rng: rng.standard_t(5, (DRAWS, 4)), 4),
        "exponential, largest at a prior bound, d = 3": Drawn(exponential, of_the_exponential, 3, bound=1.0),
    }
    for d in (1, 4, 10):
        whole = of_the_normal(d)
        found[f"half of a normal density, d = {d}"] = Drawn(
            normal, kept(whole, lambda x: x[:, 0] < 0.0), d, right="refused"
        )
        found[f"a tenth missing, d = {d}"] = Drawn(normal, kept(whole, lambda x: x[:, 0] < 1.28), d, right="refused")
        found[f"only within one sd, d = {d}"] = Drawn(
            normal, kept(whole, lambda x: np.abs(x[:, 0]) < 1.0), d, right="refused"
        )
    for times in (2, 30, 60):
        steps = times * TAU
        found[f"32 chains of {times} autocorrelation times, d = 4"] = Drawn(
            normal, autoregressive(4, steps), 4, right="refused" if times == 2 else "accepted"
        )
    narrow, few = Drawn(ridge, of_the_ridge, 2), of_the_normal(4, 100)
    return found | {
        "curved ridge": narrow,
        "half of a curved ridge": Drawn(ridge, kept(of_the_ridge, lambda x: x[:, 0] < 1.0), 2, right="refused"),
        "only 100 draws, normal, d = 4": Drawn(normal, few, 4, right="refused"),
    }


# --- verdicts -------------------------------------------------------------------------------------------------------


def said(drawn: Drawn, seed: int) -> str:
    """Return the objection to the draws, empty if there is none."""
    rng = np.random.default_rng(seed)
    names = tuple(f"x{i}" for i in range(drawn.dimension))
    space = si.ParameterSpace(**{name: si.Uniform(-drawn.bound, drawn.bound) for name in names})
    bounds = dict.fromkeys(names, (-drawn.bound, drawn.bound))
    target = si.LogDensity(drawn.log_density, names, space, bounds)
    draws = drawn.sampler(rng)
    draws = draws if draws.ndim == 3 else draws[None]
    values = drawn.log_density(draws.reshape(-1, drawn.dimension))
    limits = si.Limits()
    try:
        law = ValuesAtDraws(target, draws, values, rng)
        by_chance = MonteCarloError.of(law.in_order(law.flat), limits.confidence)
        return "".join([*not_its_draws(law, rng), *by_chance.too_large(limits, names)])
    except si.InputError as refused:
        return str(refused)


def row(case: str, drawn: Drawn, seeds: int) -> list[str]:
    began = time.perf_counter()
    sentences = [said(drawn, seed) for seed in range(seeds)]
    seconds = (time.perf_counter() - began) / seeds
    first = [next((part for part in REFUSALS if part in sentence), "") for sentence in sentences]
    counts = [first.count(part) for part in REFUSALS]
    return [case, drawn.right, f"{seeds - sum(counts)} of {seeds}", *map(str, counts), f"{seconds:.1f}"]


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    found = []
    for case, drawn in list(cases().items())[:: 4 if quick else 1]:
        if quick and drawn.dimension > 4:
            continue
        found.append(row(case, drawn, 1 if quick else SEEDS))
        print(" | ".join(found[-1]), flush=True)
    text = f"""# Draws given with log density values only

`benchmarks/draws_by_values.py`. {common.machine()}.

Other programs often provide draws with their log density values, but not the density as a function. `si.certify` then checks the
draws before any model run, by Stein's identity and by the Monte Carlo error ([theory](../../theory/certificate.md)). Each row has
{SEEDS} samples of {DRAWS:,} draws, from which some cases then remove a part. "Wrong values": a density fitted to the draws
contradicts the given values. "Too few draws": the Monte Carlo error of the draws' averages exceeds the limits, whatever their
density. "Undecided": the standard errors of Stein's identity are so large that draws from only half of a density would also pass,
so nothing is certified.

{common.markdown_table(HEADS, found)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=found)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
