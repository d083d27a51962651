"""Draws whose log density is available only at the draws: the check of the draws, and certificates under attack.

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
from structid.certification.external.stein_identity import SteinTest
from structid.certification.monte_carlo_error import MonteCarloError

NAME = "draws_by_values"
SEEDS = 6
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
ATTACKS = 5
"""Seeds of each attack, and of each good sample, on the whole of `certify`."""
REFERENCE = 400_000
"""Draws of the right density, whose moments are the truth."""
ATTACK_HEADS = ["draws", "certified", "false", "statement broken", "largest error over its limit", "seconds"]
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


def of_the_exponential(rng: np.random.Generator, draws: int = DRAWS) -> np.ndarray:
    return -1.0 - 0.5 * np.log1p(-rng.random((draws, 3)) * (1.0 - np.exp(-4.0)))


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
        by_stein = SteinTest.of(law, law.interpolation, by_chance, rng).doubts(limits, names)
        return "".join([*by_stein, *by_chance.too_large(limits, names)])
    except si.InputError as refused:
        return str(refused)


def row(case: str, drawn: Drawn, seeds: int) -> list[str]:
    began = time.perf_counter()
    sentences = [said(drawn, seed) for seed in range(seeds)]
    seconds = (time.perf_counter() - began) / seeds
    first = [next((part for part in REFUSALS if part in sentence), "") for sentence in sentences]
    counts = [first.count(part) for part in REFUSALS]
    return [case, drawn.right, f"{seeds - sum(counts)} of {seeds}", *map(str, counts), f"{seconds:.1f}"]


# --- certificates under attack --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Attack:
    """Draws that come with the right values of the posterior's log density.

    Parameters
    ----------
    log_density : callable
        Log density of the posterior.
    truth : callable
        Sampler of the posterior: function of a generator and a number of draws.
    given : callable or None
        Sampler of the given draws; None for those of the posterior.
    dimension : int
        Number of parameters.
    bound : float
        The priors are uniform between −bound and bound.
    """

    log_density: LogDensity
    truth: Callable[[np.random.Generator, int], np.ndarray]
    given: Sampler | None
    dimension: int
    bound: float = WIDE


def correlated(
    dimension: int, rho: float
) -> tuple[LogDensity, Callable[[np.random.Generator, int], np.ndarray], np.ndarray]:
    """Normal density with unit variances and equal correlations, its sampler, and the conditional standard deviations."""
    covariance = (1.0 - rho) * np.eye(dimension) + rho * np.ones((dimension, dimension))
    precision, root = np.linalg.inv(covariance), np.linalg.cholesky(covariance)

    def log_density(theta: np.ndarray) -> np.ndarray:
        return np.asarray(-0.5 * np.einsum("...i,ij,...j", theta, precision, theta))

    return log_density, lambda rng, n: rng.standard_normal((n, dimension)) @ root.T, 1.0 / np.sqrt(np.diag(precision))


def mean_field(dimension: int, rho: float) -> Attack:
    """Draws of the independent normal density closest to a correlated one, as variational inference gives them."""
    log_density, truth, sds = correlated(dimension, rho)
    return Attack(log_density, truth, lambda rng: sds * rng.standard_normal((DRAWS, dimension)), dimension)


def gamma_density(theta: np.ndarray) -> np.ndarray:
    """Independent gamma densities with shape 3, whose standard deviation is √3."""
    return np.asarray(scipy.stats.gamma(3.0).logpdf(np.maximum(theta, 1e-12)).sum(axis=-1))


def bent(theta: np.ndarray) -> np.ndarray:
    """A normal density along a parabola."""
    return np.asarray(-0.5 * theta[..., 0] ** 2 - 0.5 * ((theta[..., 1] - theta[..., 0] ** 2) / 0.5) ** 2)


def along_the_bend(rng: np.random.Generator, count: int) -> np.ndarray:
    along = rng.standard_normal(count)
    return np.column_stack([along, rng.normal(along**2, 0.5)])


def exchangeable(theta: np.ndarray) -> np.ndarray:
    """Two modes, one with the two parameters of the other exchanged."""
    one, other = (-0.5 * ((a - 1.0) / 0.2) ** 2 - 0.5 * ((b + 1.0) / 0.3) ** 2 for a, b in (theta.T, theta.T[::-1]))
    return np.asarray(np.logaddexp(one, other))


def one_mode(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.column_stack([rng.normal(1.0, 0.2, count), rng.normal(-1.0, 0.3, count)])


def both_modes(rng: np.random.Generator, count: int) -> np.ndarray:
    found = one_mode(rng, count)
    exchanged = rng.random(count) < 0.5
    found[exchanged] = found[exchanged, ::-1]
    return found


def two_modes(theta: np.ndarray) -> np.ndarray:
    """Two normal modes, eight standard deviations apart."""
    away = np.zeros(theta.shape[-1])
    away[0] = 8.0
    return np.asarray(np.logaddexp(normal(theta), normal(theta - away)))


def of_two_modes(rng: np.random.Generator, count: int) -> np.ndarray:
    found = rng.standard_normal((count, 2))
    found[rng.random(count) < 0.5, 0] += 8.0
    return found


def langevin(rng: np.random.Generator) -> np.ndarray:
    """Unadjusted Langevin chains of the gamma density in log coordinates, with a step that is too large."""
    x, found = np.log(rng.gamma(3.0, size=(40, 3))), []
    for _ in range(DRAWS // 40):
        for _ in range(10):
            x = x + 0.15 * (3.0 - np.exp(x)) + np.sqrt(0.3) * rng.standard_normal(x.shape)
        found.append(np.exp(x))
    return np.swapaxes(np.array(found), 0, 1)


def shuffled(rng: np.random.Generator) -> np.ndarray:
    """One chain of eight autocorrelation times in random order, which hides its autocorrelation."""
    steps, rho = DRAWS, (DRAWS / 8 - 1.0) / (DRAWS / 8 + 1.0)
    noise = rng.standard_normal((steps, 4)) * np.sqrt(1.0 - rho**2)
    noise[0] /= np.sqrt(1.0 - rho**2)
    return rng.permutation(np.asarray(scipy.signal.lfilter([1.0], [1.0, -rho], noise, axis=0)))


def attacks() -> dict[str, Attack]:
    """Wrong draws with the right values of the posterior."""

    def of_normal(given: Sampler) -> Attack:
        return Attack(normal, lambda rng, n: rng.standard_normal((n, 4)), given, 4)

    whole = of_the_normal(4)
    first = np.array([1.0, 0.0, 0.0, 0.0])
    found = {f"mean field, ρ = {rho}, d = {d}": mean_field(d, rho) for d in (2, 4, 10) for rho in (0.3, 0.45, 0.6)}
    found |= {
        f"shifted by {shift} standard deviations": of_normal(lambda rng, shift=shift: whole(rng) + shift * first)
        for shift in (0.1, 0.2, 0.3)
    }
    return found | {
        "standard deviations × 1.1": of_normal(lambda rng: 1.1 * whole(rng)),
        "cut beyond 1.65 sd": of_normal(kept(whole, lambda x: x[:, 0] < 1.65)),
        "cut beyond 2 sd on both sides": of_normal(kept(whole, lambda x: np.abs(x[:, 0]) < 2.0)),
        "one chain of 8 autocorrelation times, shuffled": of_normal(shuffled),
        "unadjusted Langevin chains, gamma density": Attack(
            gamma_density, lambda rng, n: rng.gamma(3.0, size=(n, 3)), langevin, 3
        ),
        "mean field of a bent density": Attack(
            bent, along_the_bend, lambda rng: np.array([0.0, 0.5]) + [0.55, 0.5] * rng.standard_normal((DRAWS, 2)), 2
        ),
        "one of two exchangeable modes": Attack(exchangeable, both_modes, lambda rng: one_mode(rng, DRAWS), 2, 10.0),
        "one of two modes 8 sd apart": Attack(
            two_modes, of_two_modes, lambda rng: rng.standard_normal((DRAWS, 2)), 2, 20.0
        ),
    }


def good_draws() -> dict[str, Attack]:
    """Draws of the posterior."""
    found = {}
    for d in (2, 4, 10):
        log_density, truth, _ = correlated(d, 0.5)
        found[f"normal, ρ = 0.5, d = {d}"] = Attack(log_density, truth, None, d)
    return found | {
        "chains of 60 autocorrelation times": Attack(
            normal, lambda rng, n: rng.standard_normal((n, 4)), autoregressive(4, 60 * TAU), 4
        ),
        "gamma density": Attack(gamma_density, lambda rng, n: rng.gamma(3.0, size=(n, 3)), None, 3),
        "exponential, largest at a prior bound": Attack(exponential, of_the_exponential, None, 3, 1.0),
        "bent density": Attack(bent, along_the_bend, None, 2),
    }


def certificate_outcome(attack: Attack, seed: int) -> tuple[bool, bool, bool, float]:
    """Whether the draws are certified, wrongly, with a broken statement; and the largest error in units of its limit."""
    rng = np.random.default_rng(seed)
    names = tuple(f"x{i}" for i in range(attack.dimension))
    low = 1e-9 if attack.log_density is gamma_density else -attack.bound
    space = si.ParameterSpace(**{name: si.Uniform(low, attack.bound) for name in names})
    target = si.LogDensity(attack.log_density, names, space, dict.fromkeys(names, (low, attack.bound)))
    draws = attack.truth(rng, DRAWS) if attack.given is None else attack.given(rng)
    flat, truth = draws.reshape(-1, attack.dimension), attack.truth(np.random.default_rng(0), REFERENCE)
    sds, limits = truth.std(axis=0), si.Limits()
    errors = [
        np.abs(flat.mean(axis=0) - truth.mean(axis=0)) / sds,
        np.abs(flat.std(axis=0) / sds - 1.0),
        np.abs(np.corrcoef(flat.T) - np.corrcoef(truth.T)),
    ]
    worst = max(
        float(e.max()) / limit for e, limit in zip(errors, (limits.mean, limits.sd, limits.correlation), strict=True)
    )
    try:
        found = si.certify(target, draws, attack.log_density(draws), limits=limits, seed=seed)
    except si.InputError:
        return False, False, False, worst
    within = (found.mean_within, found.sd_within, found.correlation_within)
    broken = found.certified and any(
        (e > w + 3.0 / np.sqrt(REFERENCE)).any() for e, w in zip(errors, within, strict=True)
    )
    return found.certified, found.certified and worst > 1.0, broken, worst


def attack_row(name: str, attack: Attack, seeds: int) -> list[str]:
    """Outcomes of one kind of draws."""
    began = time.perf_counter()
    outcomes = [certificate_outcome(attack, seed) for seed in range(seeds)]
    seconds = (time.perf_counter() - began) / seeds
    counts = [f"{sum(outcome[place] for outcome in outcomes)} of {seeds}" for place in range(3)]
    return [name, *counts, f"{max(outcome[3] for outcome in outcomes):.2f}", f"{seconds:.1f}"]


def attack_tables(quick: bool) -> dict[str, list[list[str]]]:
    """Rows of the good and of the wrong draws."""
    tables: dict[str, list[list[str]]] = {}
    for kind, chosen in (("good draws", good_draws()), ("attacks", attacks())):
        names = list(chosen)[:: 6 if quick else 1]
        tables[kind] = [attack_row(name, chosen[name], 1 if quick else ATTACKS) for name in names]
        for line in tables[kind]:
            print(" | ".join(line), flush=True)
    return tables


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    found = []
    for case, drawn in list(cases().items())[:: 4 if quick else 1]:
        if quick and drawn.dimension > 4:
            continue
        found.append(row(case, drawn, 1 if quick else SEEDS))
        print(" | ".join(found[-1]), flush=True)
    tables = attack_tables(quick)
    text = f"""# Draws given with log density values only

`benchmarks/draws_by_values.py`. {common.machine()}.

Other programs often provide draws with their log density values, but not the density as a function. `si.certify` then checks the
draws before any model run, by Stein's identity and by the Monte Carlo error ([theory](../../theory/certificate.md)). Each row has
{SEEDS} samples of {DRAWS:,} draws, from which some cases then remove a part. "Wrong values": a density fitted to the draws
contradicts the given values. "Too few draws": the Monte Carlo error of the draws' averages exceeds the limits, whatever their
density. "Undecided": the errors that Stein's identity leaves exceed the limits, so nothing is certified.

{common.markdown_table(HEADS, found)}

## Certificates

The whole of `certify` with the right values of the posterior at the draws, {ATTACKS} samples a row. "False": certified, although a
mean, a standard deviation or a correlation of the draws is wrong by more than its limit (0.1 standard deviations, 10 %, 0.2).
"Statement broken": certified with a smaller bound than the error. A statement may be broken in 5 % of the certificates.

Good draws:

{common.markdown_table(ATTACK_HEADS, tables["good draws"])}

Wrong draws:

{common.markdown_table(ATTACK_HEADS, tables["attacks"])}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=found, **tables)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
