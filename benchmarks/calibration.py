"""The question: how many true runs does a certified calibration take, how long, and is it the model's own posterior.

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
EL_CENTRO = common.ROOT.parent / "shared" / "data" / "strong_motion" / "RSN6_IMPVALL.I_I-ELC180.AT2"
SEEDS = (1, 2, 3)
REFERENCE, QUICK_REFERENCE = si.SMC(particles=1000, steps=200), si.SMC(particles=100, steps=20)
HEADS = [
    "case, seed", "verdict", "training + certificate", "rounds", "seconds", "χ", "bound U", "sds within",
    "largest error of a mean [sd]", "largest error of an sd", "limit (stretch)",
]  # fmt: skip


def stochastic(pga: float) -> si.GroundMotion:
    """The study's own record."""
    return si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(0.0, 40.0).scale_to_pga(pga)


def el_centro(pga: float) -> si.GroundMotion:
    return si.GroundMotion.read(EL_CENTRO).lowpass(20.0).trim(0.0, 40.0).scale_to_pga(pga)


def measured(record: si.GroundMotion) -> si.Observation:
    """What the degrading oscillator shows, with noise of 2 % of its RMS as in the study."""
    truth = common.degrading_oscillator().simulate(np.zeros((1, 0)), record).values[0, :, 0]
    noise = 0.02 * np.sqrt(np.mean(truth**2)) * np.random.default_rng(1).normal(size=truth.shape)
    return si.Observation(record, truth + noise)


def model_and_space() -> tuple[si.BoucWen, si.ParameterSpace]:
    space = common.study_space()
    return si.BoucWen(mass=common.MASS, damping_ratio=common.DAMPING_RATIO, free=space.names), space


def row(label: str, limit: str, record: si.GroundMotion, reference: Any, seed: int, **settings: Any) -> list[str]:
    """One calibration beside the reference."""
    model, space = model_and_space()
    observation = measured(record)
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what lies outside a surrogate's range is in the certificate
        result = si.calibrate(model, space, observation, seed=seed, **settings)
    seconds = time.perf_counter() - began
    c = result.certificate
    if c.usable:
        mean = f"{np.max(np.abs(result.mean - reference.mean) / reference.sd):.3f}"
        sd = f"{np.max(np.abs(result.sd / reference.sd - 1.0)):.1%}"
    else:
        mean = sd = "–"
    spent = f"{result.training_runs} + {c.true_runs - result.training_runs}"
    return [
        f"{label}, {seed}", c.verdict, spent, str(result.depth), f"{seconds:.0f}", f"{c.variation.estimate:.3f}",
        f"{c.variation.bound:.3f}", f"{c.sd_bound.max():.1%}", mean, sd, limit,
    ]  # fmt: skip


def rows(quick: bool) -> list[list[str]]:
    found = []
    cases = [
        ("stochastic record, 1.8 m/s²", stochastic(1.8), "100 (60), 0.1, 10 %", {}),
        ("El Centro, 1.8 m/s²", el_centro(1.8), "100 (60), 0.1, 10 %", {}),
        ("El Centro, 3.59 m/s²", el_centro(3.59), "130, 0.1, 10 %", {"true_runs": 700}),
        (
            "stochastic record, PC-NARX", stochastic(1.8), "certified or refused",
            {"surrogate": si.PCNARX(degree=2), "true_runs": 700, "plan": si.Plan(true_runs=700, start=120, batch=60)},
        ),
        (
            "stochastic record, Kriging-NARX", stochastic(1.8), "certified or refused",
            {"surrogate": si.KrigingNARX(degree=2), "true_runs": 700, "plan": si.Plan(true_runs=700, start=120, batch=60)},
        ),
    ]  # fmt: skip
    references: dict[str, Any] = {}
    for label, record, limit, settings in cases[:1] if quick else cases:
        if record.content_hash not in references:
            model, space = model_and_space()
            references[record.content_hash] = si.sample(
                si.Posterior(space, model, measured(record)), QUICK_REFERENCE if quick else REFERENCE, seed=99
            )
        reference = references[record.content_hash]
        sizes = [p.bulk_size for p in reference.verdict().parameters.values()]
        print(f"{label}: reference with a bulk effective size of {min(sizes):.0f} or more", flush=True)
        for seed in SEEDS[:1] if quick or "NARX" in label else SEEDS:
            found.append(row(label, limit, record, reference, seed, **settings))
            print(" | ".join(found[-1]), flush=True)
    return found


def alone() -> None:
    """One calibration in this process, which has done nothing before: seconds of the whole call."""
    (model, space), observation = model_and_space(), measured(el_centro(1.8))
    began = time.perf_counter()
    certificate = si.calibrate(model, space, observation, seed=1).certificate
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
    text = f"""## Certified calibration

`benchmarks/calibration.py`. {common.machine()}.

The study `bouc_wen` (a degrading oscillator is measured with 2 % noise, one without degradation is calibrated), POD-Kriging unless
it says otherwise, `si.calibrate` as it comes: 10 runs in the first design, 10 a round, 30 fresh draws in a certificate, ten of them
tempered. Seconds are those of the whole call, compilation and imports included. Means and standard deviations beside a reference
of tempered SMC on the model itself with a bulk effective size of 10 000 or more.

{common.markdown_table(HEADS, found)}

El Centro, 1.8 m/s², seed 1, in a process that has done nothing before; seconds of `si.calibrate`, without the imports before it:

{common.markdown_table(["caches", "verdict", "seconds", "limit (stretch)"], cold)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=found, in_new_processes=cold)
    common.write_section(common.documents(quick) / "benchmarks.md", NAME, text)
    print(text)


if __name__ == "__main__":
    main()
