"""The question: do intervals hold the truth as often as they say, and what becomes of them where the model is wrong.

Run with ``python benchmarks/honesty.py [--quick]``.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import common
import numpy as np

import structid as si

NAME = "honesty"
MASS, DAMPING_RATIO, GAMMA_RATIO = 12_000.0, 0.03, 0.5
PHI = 0.9
"""Correlation of neighbouring values of the AR(1) noise, at 0.01 s."""
NOISE = 0.1
"""Of the response's RMS."""
DEGRADATION = {"delta_nu": 0.05, "delta_eta": 0.15}
"""Of the truth that the wrong model lacks [kg/J]."""
RECORDS = 20
SMC = si.SMC(particles=200, steps=30, effective_share=0.5, correlation=0.4)


def space() -> si.ParameterSpace:
    """An oscillator of 1 Hz: k = m (2π)²."""
    return si.ParameterSpace(
        stiffness=si.Normal(0.474, 0.06, low=0.2, high=0.8, unit="kN/mm"),
        beta=si.Uniform(5.0, 60.0, unit="1/m"),
        alpha=si.Uniform(0.0, 0.5),
    )


def oscillator(**settings: Any) -> si.BoucWen:
    return si.BoucWen(mass=MASS, damping_ratio=DAMPING_RATIO, gamma_ratio=GAMMA_RATIO, **settings)


def record(seed: int, begin: float, end: float) -> si.GroundMotion:
    return si.GroundMotion.synthetic(seed=seed).lowpass(20.0).trim(begin, end).scale_to_pga(1.8)


# --- simulation-based calibration -------------------------------------------------------------------------------


def sbc_rows(replicas: int) -> list[list[str]]:
    """Right likelihoods, and independent errors where the noise is correlated."""
    motion = record(8, 3.0, 13.0)
    model = oscillator(free=space().names)
    clean = model.simulate(np.array([[0.474e6, 25.0, 0.1]]), motion).values[0, :, 0]
    variance = float((NOISE * clean.std()) ** 2)
    correlated = si.AR1(variance=variance, white=0.0, correlation_time=-motion.dt / np.log(PHI))
    cases = (
        ("iid noise, iid likelihood", si.IID(variance=variance), None, "uniform, 83–96 %"),
        ("AR(1) noise, AR(1) likelihood", correlated, None, "uniform, 83–96 %"),
        ("AR(1) noise, iid likelihood", si.IID(variance=variance), correlated, "must fail, below 45 %"),
    )
    rows = []
    for label, law, noise, limit in cases:
        posterior = si.Posterior(space(), model, si.Observation(motion, clean), law)
        began = time.perf_counter()
        found = si.sbc(posterior, replicas, seed=1, noise=noise)
        seconds = time.perf_counter() - began
        most, half = found.coverage(0.9), found.coverage(0.5)
        rows.append(
            [
                label, "uniform" if found.uniform else "not uniform", f"{found.p_values.min():.2g}",
                f"{half.min():.0%} to {half.max():.0%}", f"{most.min():.0%} to {most.max():.0%}", f"{seconds:.0f}", limit,
            ]
        )  # fmt: skip
        figure = common.documents(replicas < 200) / "figures" / f"sbc_{len(rows)}"
        found.plot(figure)
        figure.with_suffix(".pdf").unlink()
        print(" | ".join(rows[-1]), flush=True)
    return rows


# --- a wrong model ----------------------------------------------------------------------------------------------


def wrong_model_rows(records: int) -> list[list[str]]:
    """Posterior means over many records of one degrading structure, beside what the posteriors say of themselves."""
    truth = oscillator(stiffness=0.474e6, beta=25.0, alpha=0.1, **DEGRADATION)
    model = oscillator(free=space().names)
    rows = []
    for label, law in (("iid", si.IID()), ("damped cosine", si.DampedCosine())):
        means, sds, robust = [], [], []
        for index in range(records):
            motion = record(100 + index, 0.0, 30.0)
            clean = truth.simulate(np.zeros((1, 0)), motion).values[0, :, 0]
            noise = 0.02 * clean.std() * np.random.default_rng(index).normal(size=clean.shape)
            posterior = si.Posterior(space(), model, si.Observation(motion, clean + noise), law)
            result = si.sample(posterior, SMC, seed=index)
            means.append(result.mean[:3])
            sds.append(result.sd[:3])
            assert result.robust_sd is not None
            robust.append(result.robust_sd[:3])
            print(f"{label}, record {index + 1} of {records}: {result.seconds:.0f} s", flush=True)
        scatter = np.std(means, axis=0, ddof=1)
        for name, reported in (("sd", sds), ("robust sd", robust)):
            ratio = scatter / np.sqrt(np.mean(np.square(reported), axis=0))
            limit = "shown" if (label, name) == ("iid", "sd") else "2"
            rows.append([f"{label}, {name}", *(f"{r:.2f}" for r in ratio), limit])
            print(" | ".join(rows[-1]), flush=True)
    return rows


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    replicas, records = (20, 2) if quick else (200, RECORDS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ranks, wrong = sbc_rows(replicas), wrong_model_rows(records)
    heads = [
        "noise and likelihood", "ranks", "smallest p of three", "50 % intervals hold", "90 % intervals hold", "seconds", "limit",
    ]  # fmt: skip
    wrong_heads = ["law, spread", *space().names, "limit"]
    text = f"""## Honesty

`benchmarks/honesty.py`. {common.machine()}.

**Simulation-based calibration** (`si.sbc`): an oscillator of 1 Hz with three unknown parameters, 10 s of a stochastic record at
0.01 s, noise of 10 % of the RMS; {replicas} measurements simulated with parameters drawn from the prior, each calibrated. Ranks of
the truth are uniform at the 1 % level where the likelihood is that of the noise; where the noise is AR(1) with φ = {PHI} and the
likelihood takes it for independent, they are not. ([figures](figures/sbc_3.png))

{common.markdown_table(heads, ranks)}

**A wrong model**: {records} records of one degrading oscillator, 30 s each with 2 % noise, calibrated with one that does not
degrade. The scatter of the posterior means over the records, divided by what each posterior says of itself:

{common.markdown_table(wrong_heads, wrong)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), ranks=ranks, wrong=wrong)
    common.write_section(common.documents(quick) / "benchmarks.md", NAME, text)
    print(text)


if __name__ == "__main__":
    main()
