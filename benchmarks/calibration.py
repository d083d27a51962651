"""The question: how many model runs does a certified calibration take, how long, and is it the model's own posterior.

Run with ``python benchmarks/calibration.py [--quick]``. El Centro comes from ``../shared/data``.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import warnings
from typing import Any

import common
import numpy as np

import structid as si

NAME = "calibration"
SEEDS, SEEDS_OF_SEVEN = tuple(range(1, 11)), (1, 2, 3, 4, 5)
REFERENCE, QUICK_REFERENCE = si.SMC(particles=1000, steps=200), si.SMC(particles=100, steps=20)
OF_SEVEN = {
    "stiffness": (7.599823e6, 1757.0),
    "beta": (63.3415, 0.3013),
    "gamma_ratio": (0.997751, 0.001869),
    "alpha": (0.052979, 0.004323),
    "delta_nu": (2.38631, 0.1241),
    "delta_eta": (6.518985, 0.04038),
    "damping_ratio": (0.0299652, 5.093e-5),
}
"""Mean and standard deviation of seven parameters by 4.6 million runs of the model: 256 walkers, halves within 0.007 sd."""
HEADS = [
    "case, seed",
    "verdict",
    "model runs",
    "rounds",
    "seconds",
    "χ",
    "bound U",
    "sds within",
    "largest error of a mean [sd]",
    "largest error of an sd",
    "limit (stretch goal)",
]
Problem = tuple[Any, si.ParameterSpace, si.Observation]
"""A model, its unknown parameters, and what was measured."""


def stochastic(pga: float) -> si.GroundMotion:
    """The study's own record."""
    record = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(0.0, 40.0).scale_to_pga(pga)
    return common.shorter_if_quick(record, 8.0)


def el_centro(pga: float) -> si.GroundMotion:
    record = si.GroundMotion.read(common.EL_CENTRO).lowpass(20.0).trim(0.0, 40.0).scale_to_pga(pga)
    return common.shorter_if_quick(record, 8.0)


def measured(record: si.GroundMotion) -> si.Observation:
    """What the degrading oscillator shows, with noise of 2 % of its RMS as in the study."""
    truth = common.degrading_oscillator().simulate(np.zeros((1, 0)), record).values[0, :, 0]
    noise = 0.02 * np.sqrt(np.mean(truth**2)) * np.random.default_rng(1).normal(size=truth.shape)
    return si.Observation(record, truth + noise)


def model_and_space() -> tuple[si.BoucWen, si.ParameterSpace]:
    space = common.study_space()
    return si.BoucWen(mass=common.MASS, damping_ratio=common.DAMPING_RATIO, free=space.names), space


def study(record: si.GroundMotion) -> Problem:
    """The packaged study on a record: four parameters of an oscillator without degradation."""
    return *model_and_space(), measured(record)


def degrading() -> Problem:
    """Seven parameters of the class that made the data."""
    record = si.GroundMotion.synthetic(seed=8).lowpass(20.0).scale_to_pga(1.8)
    truth = common.degrading_oscillator().simulate(np.zeros((1, 0)), record).values[0, :, 0]
    noise = 0.02 * truth.std() * np.random.default_rng(1).standard_normal(truth.shape)
    space = si.ParameterSpace(
        stiffness=si.Normal(7.42e6, 0.742e6, low=4.27e6, high=11.85e6),
        beta=si.Uniform(30.0, 90.0),
        gamma_ratio=si.Uniform(-1.0, 1.0),
        alpha=si.LogNormal(mean=0.063, sd=0.02, high=1.0),
        delta_nu=si.Uniform(0.0, 10.0),
        delta_eta=si.Uniform(0.0, 20.0),
        damping_ratio=si.LogNormal(mean=0.03, sd=0.01, high=0.5),
    )
    return si.BoucWen(mass=common.MASS, free=space.names), space, si.Observation(record, truth + noise)


def row(label: str, limit: str, problem: Problem, moments: np.ndarray, seed: int, **settings: Any) -> list[str]:
    """One calibration compared with the means and standard deviations of a reference, shape (2, parameter)."""
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what lies outside a surrogate's range is in the certificate
        result = si.calibrate(*problem, seed=seed, **settings)
    seconds = time.perf_counter() - began
    c, count = result.certificate, moments.shape[1]
    mean = sd = "–"
    if c.usable:
        mean = f"{np.max(np.abs(result.mean[:count] - moments[0]) / moments[1]):.3f}"
        sd = f"{np.max(np.abs(result.sd[:count] / moments[1] - 1.0)):.1%}"
    return [
        f"{label}, {seed}",
        c.verdict,
        str(c.true_runs),
        str(result.depth),
        f"{seconds:.0f}",
        f"{c.variation.estimate:.3f}",
        f"{c.variation.bound:.3f}",
        f"{c.sd_bound.max():.1%}",
        mean,
        sd,
        limit,
    ]


def reference(problem: Problem, sampler: si.SMC) -> np.ndarray:
    """Means and standard deviations by tempered SMC on the model itself."""
    model, space, observation = problem
    found = si.sample(si.Posterior(space, model, observation), sampler, seed=99)
    sizes = [p.bulk_size for p in found.verdict().parameters.values()]
    print(f"a reference with a bulk effective size of {min(sizes):.0f} or more", flush=True)
    return np.stack([found.mean, found.sd])


def cases(quick: bool) -> list[tuple[str, str, Problem, np.ndarray, tuple[int, ...], dict[str, Any]]]:
    """Label, limit, problem, reference, seeds, settings."""
    sampler, seeds = (QUICK_REFERENCE, SEEDS[:1]) if quick else (REFERENCE, SEEDS)
    random = study(stochastic(1.8))
    own = reference(random, sampler)
    found: list[Any] = [("stochastic record, 1.8 m/s²", "100 (60) in 8 rounds", random, own, seeds, {})]
    if quick:
        return found
    for pga, limit in ((1.8, "100 (60) in 8 rounds"), (3.59, "130")):
        problem = study(el_centro(pga))
        found.append((f"El Centro, {pga} m/s²", limit, problem, reference(problem, sampler), seeds, {}))
    seven = np.array(list(OF_SEVEN.values())).T
    found.append(("seven parameters", "250 (150) in 10 rounds", degrading(), seven, SEEDS_OF_SEVEN, {}))
    for label, surrogate in (("PC-NARX", si.PCNARX(degree=2)), ("Kriging-NARX", si.KrigingNARX(degree=2))):
        found.append((f"stochastic record, {label}", "certified", random, own, SEEDS[:3], {"surrogate": surrogate}))
    return found


def rows(quick: bool) -> list[list[str]]:
    found = []
    for label, limit, problem, moments, seeds, settings in cases(quick):
        for seed in seeds:
            found.append(row(label, limit, problem, moments, seed, **settings))
            print(" | ".join(found[-1]), flush=True)
    return found


def alone() -> None:
    """One calibration in this process, which has done nothing before: seconds of the whole call."""
    problem = study(el_centro(1.8))
    began = time.perf_counter()
    certificate = si.calibrate(*problem, seed=1).certificate
    print(f"{time.perf_counter() - began:.1f} {certificate.verdict}")


def in_new_processes() -> list[list[str]]:
    """The same calibration in a new process, where everything is compiled for the first time and where it was before."""
    found = []
    with tempfile.TemporaryDirectory() as cache:
        for label, limit in (("empty", "15 s"), ("warm", "6 s (4 s)"), ("warm", "6 s (4 s)"), ("warm", "6 s (4 s)")):
            process = [sys.executable, "-W", "ignore", __file__, "--alone"]
            said = subprocess.run(
                process, env=os.environ | {"XDG_CACHE_HOME": cache}, capture_output=True, text=True, check=True
            )
            seconds, verdict = said.stdout.split(maxsplit=1)
            found.append([label, verdict.strip(), seconds, limit])
    return found


def main() -> None:
    if "--alone" in sys.argv:
        alone()
        return
    quick = common.is_quick(__doc__.splitlines()[0])
    cold = [] if quick else in_new_processes()
    found = rows(quick)
    text = f"""# Certified calibration

`benchmarks/calibration.py`. {common.machine()}.

The study is `bouc_wen`: a degrading oscillator is measured with 2 % noise, and an oscillator without degradation is calibrated.
The surrogate is a POD-Kriging unless a row names another one. `si.calibrate` has its default settings: 10 runs in the first
design and 10 in each round (16 and 22 for seven parameters). A certificate takes 30 fresh draws, a third of them tempered.
Seconds are for the whole call of `si.calibrate`. Every certified calibration has means within 0.1 sd and standard deviations
within 10 %. Means and standard deviations are compared with tempered SMC on the model itself, with a bulk effective sample size
of 10 000 or more. The seven parameters are those of the model with degradation, and their reference draws took 4.6 million
model runs. The number of rounds excludes the first design.

{common.markdown_table(HEADS, found)}

El Centro, 1.8 m/s², seed 1, in a new process: seconds of `si.calibrate`, without the preceding imports:

{common.markdown_table(["caches", "verdict", "seconds", "limit (stretch goal)"], cold)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=found, in_new_processes=cold)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
