"""Attempts to provoke a wrong certificate, and difficult cases in which a certificate must be issued.

Run with ``python benchmarks/attacks.py [--quick]``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import common
import numpy as np
import scipy
from leaderboard_cases import Case, directions, of_a_formula

import structid as si

NAME = "attacks"
SEEDS = (1, 2, 3)
REFERENCE = si.SMC(particles=1000, steps=100, effective_share=0.5, correlation=0.2)
REPLICATIONS = 200
MISSED = ((6, 10.0, True), (6, 10.0, False), (10, 10.0, True), (10, 10.0, False), (10, 5.0, False))
"""Number of parameters, half the width of the prior range, and whether a known model run lies in the mode."""
HEADS = ["attack", "correct outcome", "verdict", "model runs", "largest error of a mean [sd]", "largest error of an sd"]
normal = scipy.stats.norm.logpdf


# --- calibrations ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Attack:
    """A model that is hard to calibrate.

    Parameters
    ----------
    case : Case
        Model, priors and measurement.
    right : str
        Correct outcome.
    model : Model or None
        Replaces the case's model if some of its runs fail.
    """

    case: Case
    right: str
    model: Any = None


def jumps() -> Attack:
    """Response that jumps by two standard deviations of the errors at a = 0.5, in the middle of the posterior."""
    first, second = directions(2)
    space = si.ParameterSpace(a=si.Normal(0.0, 1.0), b=si.Normal(0.0, 1.0))

    def respond(theta: np.ndarray) -> np.ndarray:
        a, b = theta[:, :1], theta[:, 1:]
        return (a + 0.2 * (a > 0.5)) * first + b * second

    return Attack(
        of_a_formula("response that jumps inside the posterior", space, respond, 0.6 * first, 0.1**2),
        "not certified, or correct",
    )


def resonance() -> Attack:
    """Harmonic response of a lightly damped oscillator; amplitude and phase change within a hundredth of the prior range."""
    time = np.arange(200) * 0.05
    space = si.ParameterSpace(frequency=si.Uniform(0.5, 2.0), damping=si.LogNormal(mean=0.02, sd=0.01, high=0.2))

    def respond(theta: np.ndarray) -> np.ndarray:
        ratio, damping = theta[:, :1], theta[:, 1:]
        response = 1.0 / (1.0 - ratio**2 + 2.0j * damping * ratio)
        return np.asarray((response * np.exp(2.0j * np.pi * time)).real)

    y = respond(np.array([[1.01, 0.02]]))[0] + 0.5 * np.random.default_rng(5).standard_normal(len(time))
    return Attack(of_a_formula("resonance", space, respond, y, 0.5**2), "certified and correct")


def seam() -> Attack:
    """Phase whose posterior spans the jump from 2π to 0, which gives a mode at each end of the prior range."""
    time = np.arange(100) * 0.1
    space = si.ParameterSpace(phase=si.Uniform(0.0, 2.0 * np.pi), amplitude=si.Normal(1.0, 0.3))

    def respond(theta: np.ndarray) -> np.ndarray:
        return np.asarray(theta[:, 1:] * np.sin(3.0 * time + theta[:, :1]))

    y = np.sin(3.0 * time) + 0.5 * np.random.default_rng(6).standard_normal(len(time))
    return Attack(of_a_formula("posterior across a phase jump", space, respond, y, 0.5**2), "certified and correct")


def failing(where: Callable[[dict[str, float]], bool], name: str, right: str) -> Attack:
    """Solver that stops with an error in a fifth of the prior range."""
    first, second = directions(2)
    space = si.ParameterSpace(a=si.Uniform(-1.0, 1.0), b=si.Normal(0.0, 1.0))

    def respond(theta: np.ndarray) -> np.ndarray:
        return np.exp(theta[:, :1]) * first + theta[:, 1:] * second

    case = of_a_formula(name, space, respond, np.exp(0.3) * first, 0.1**2)

    def sometimes(parameters: Any, record: Any) -> np.ndarray:
        if where(parameters):
            raise RuntimeError("no equilibrium")
        return respond(np.array([[parameters["a"], parameters["b"]]]))[0]

    return Attack(case, right, si.CallableModel(sometimes, free=space.names, channels=("velocity",), isolated=False))


def attacks() -> list[Attack]:
    return [
        jumps(),
        resonance(),
        seam(),
        failing(lambda p: p["a"] < -0.6, "20 % of the runs fail, away from the posterior", "certified and correct"),
        failing(lambda p: int(1e6 * abs(p["b"])) % 5 == 0, "20 % of the runs fail, at random points", "not certified"),
    ]


def calibrated(attack: Attack, quick: bool) -> list[str]:
    """Return the row of three calibrations, compared with sampling the model itself."""
    case = attack.case
    reference = si.sample(case.target, si.SMC(particles=200, steps=20) if quick else REFERENCE, seed=99)
    said, spent, means, sds = [], [], [0.0], [0.0]
    for seed in SEEDS[:1] if quick else SEEDS:
        model = attack.model or case.model
        found = si.calibrate(
            model, case.space, case.observation, discrepancy=case.law, true_runs=80 if quick else 200, seed=seed
        )
        said.append(found.certificate.certified)
        spent.append(found.certificate.true_runs)
        if said[-1]:
            means.append(float(np.max(np.abs(found.mean - reference.mean) / reference.sd)))
            sds.append(float(np.max(np.abs(found.sd / reference.sd - 1.0))))
    errors = [f"{max(means):.2f}", f"{max(sds):.0%}"] if any(said) else ["–", "–"]
    return [case.name, attack.right, f"certified {sum(said)} of {len(said)}", f"{min(spent)} to {max(spent)}", *errors]


# --- draws ----------------------------------------------------------------------------------------------------------


def boxed(density: Callable[[np.ndarray], np.ndarray], dimension: int, edge: float = 10.0) -> si.LogDensity:
    """Density whose priors are uniform between −edge and edge."""
    names = tuple(f"x{i}" for i in range(dimension))
    space = si.ParameterSpace(**{n: si.Uniform(-edge, edge) for n in names})
    return si.LogDensity(density, names, space, dict.fromkeys(names, (-edge, edge)))


def missed_mode(dimension: int, edge: float, known: bool, quick: bool) -> list[str]:
    """Draws from the wide mode only, while q has both modes; a known model run may lie in the narrow mode."""
    widths, middle = (0.1, 0.3), 0.3 * edge

    def density(x: np.ndarray) -> np.ndarray:
        parts = [normal(x, at, width).sum(axis=1) for at, width in zip((middle, -middle), widths, strict=True)]
        return np.logaddexp(*parts)

    target, said = boxed(density, dimension, edge), []
    for seed in SEEDS[:1] if quick else range(1, 11):
        draws = np.random.default_rng(seed).normal(-middle, widths[1], (4000, dimension))
        there = np.full((1, dimension), middle + 0.5 * widths[0])
        found = si.certify(target, draws, density, known=(there, density(there)) if known else None, seed=seed)
        said.append(found.certified)
    at = "a known model run in the mode" if known else "no known model run in the mode"
    label = f"draws lack a mode of q, d = {dimension}, widths 0.1 and 0.3, prior range ±{edge:g}, {at}"
    return [label, "not certified", f"certified {sum(said)} of {len(said)}", "31", "", ""]


def slope(factor: float, quick: bool) -> list[str]:
    """Surrogate with one wrong derivative out of six, which divides that posterior standard deviation by `factor`."""
    sd = np.array([1.0 / factor, *np.ones(5)])
    target, said = boxed(lambda x: normal(x).sum(axis=1), 6), []
    for seed in range(2 if quick else REPLICATIONS):
        draws = np.random.default_rng(seed).normal(0.0, sd, (1000, 6))
        found = si.certify(target, draws, normal(draws, 0.0, sd).sum(axis=1), seed=seed)
        said.append(found.certified)
    label = f"derivative of the surrogate × {factor:g} in one of six parameters"
    return [label, "not certified", f"certified {sum(said)} of {len(said)}", "31", "", ""]


def rows(quick: bool) -> list[list[str]]:
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the certificate reports points outside the surrogate's range
        for attack in attacks()[: 1 if quick else None]:
            found.append(calibrated(attack, quick))
            print(" | ".join(found[-1]), flush=True)
        for dimension, edge, known in MISSED[: 1 if quick else None]:
            found.append(missed_mode(dimension, edge, known, quick))
            print(" | ".join(found[-1]), flush=True)
        for factor in (1.2,) if quick else (1.2, 0.84):
            found.append(slope(factor, quick))
            print(" | ".join(found[-1]), flush=True)
    return found


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    found = rows(quick)
    text = f"""# Attacks on the certificate

`benchmarks/attacks.py`. {common.machine()}.

These models and draws are designed to provoke a wrong certificate, or to prevent a correct one. Errors are given for certified
calibrations, relative to tempered SMC on the model itself. A mode of the draws' density q that no model run has visited is found
if a prior draw lies in its basin of attraction.

{common.markdown_table(HEADS, found)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=found)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
