"""Coverage of credible intervals compared with their nominal level, for correct and wrong models.

Run with ``python benchmarks/honesty.py [--quick]``.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import common
import numpy as np

import structid as si
from structid.inference.prediction.parameter_drift import drift_of
from structid.inference.prediction.prediction import predict

NAME = "honesty"
MASS, DAMPING_RATIO, GAMMA_RATIO = 12_000.0, 0.03, 0.5
PHI = 0.9
"""Correlation of successive samples of the AR(1) noise, at a time step of 0.01 s."""
NOISE = 0.1
"""Standard deviation of the noise, divided by the RMS of the response."""
DEGRADATION = {"delta_nu": 0.05, "delta_eta": 0.15}
"""Degradation of a true oscillator, which the wrong model lacks [kg/J]."""
PINCHING = {"zeta0": 0.6, "p": 0.5, "q": 0.1, "psi0": 0.02, "delta_psi": 0.002, "lambda_": 0.5}
"""Pinching of another true oscillator, which the wrong model lacks."""
RECORDS = 20


def space() -> si.ParameterSpace:
    """Priors of a 1 Hz oscillator, with k = m (2π)²."""
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
    """Ranks with correct likelihoods, and with an independent likelihood for correlated noise."""
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
                label,
                "uniform" if found.uniform else "not uniform",
                f"{found.p_values.min():.2g}",
                f"{half.min():.0%} to {half.max():.0%}",
                f"{most.min():.0%} to {most.max():.0%}",
                f"{seconds:.0f}",
                limit,
            ]
        )
        figure = common.documents(replicas < 200) / "figures" / f"sbc_{len(rows)}"
        found.plot(figure)
        figure.with_suffix(".pdf").unlink()
        print(" | ".join(rows[-1]), flush=True)
    return rows


# --- wrong models -----------------------------------------------------------------------------------------------


def degrading() -> Any:
    return oscillator(stiffness=0.474e6, beta=25.0, alpha=0.1, **DEGRADATION)


def pinched() -> Any:
    return oscillator(stiffness=0.474e6, beta=25.0, alpha=0.1, **PINCHING)


def two_storeys() -> Any:
    """Frame with the same fundamental frequency as the oscillator, measured at the roof."""
    return si.ShearFrame(
        storeys=2,
        mass=MASS / 2.0,
        stiffness=0.62e6,
        damping_ratio=DAMPING_RATIO,
        alpha=0.1,
        beta=35.0,
        gamma_ratio=GAMMA_RATIO,
        channels=("velocity_2",),
    )


TRUTHS = {
    "degradation omitted": degrading,
    "pinching omitted": pinched,
    "frame modelled as oscillator": two_storeys,
}
LAWS = {
    "iid": si.IID(),
    "ar1": si.AR1(),
    "damped cosine": si.DampedCosine(),
    "drifting": si.Drifting(),
    "drifting, damped cosine": si.Drifting(errors=si.DampedCosine()),
}
"""Error models, the simplest first."""


def motion_of(index: int) -> si.GroundMotion:
    return record(100 + index, 0.0, 30.0)


def response(truth: Any, motion: si.GroundMotion) -> np.ndarray:
    return truth.simulate(np.zeros((1, 0)), motion).values[0, :, 0]


def measured(truth: Any, index: int, motion: si.GroundMotion) -> si.Observation:
    """Simulated measurement with 2 % noise."""
    clean = response(truth, motion)
    return si.Observation(motion, clean + 0.02 * clean.std() * np.random.default_rng(index).normal(size=clean.shape))


@dataclass
class Found:
    """Results of one error model: parameters over the records, and predicted peaks and histories of other records."""

    means: list[np.ndarray] = field(default_factory=list)
    sds: list[np.ndarray] = field(default_factory=list)
    elsewhere: list[np.ndarray] = field(default_factory=list)
    evidence: list[float] = field(default_factory=list)
    peaks: list[bool] = field(default_factory=list)
    strong: list[float] = field(default_factory=list)
    quiet: list[float] = field(default_factory=list)

    def take(self, result: si.SamplingResult, truth: Any, other: si.GroundMotion) -> None:
        """Add the result of one record, and its prediction for another record."""
        self.means.append(result.mean[:3])
        self.sds.append(result.sd[:3])
        posterior = result.target
        drift = drift_of(posterior, result.flat, result.map_estimate)
        self.elsewhere.append(drift.widened(result.sd)[:3])
        self.evidence.append(result.log_evidence.value)
        prediction = predict(posterior, result.thinned(400), other, seed=result.seed, drift=drift)
        clean = response(truth, other)
        low, high = np.quantile(prediction.peaks[:, 0], [0.05, 0.95])
        self.peaks.append(bool(low <= np.abs(clean).max() <= high))
        low, high = (edge[:, 0] for edge in prediction.band(0.9, discrepancy=True))
        inside = (clean >= low) & (clean <= high)
        envelope = np.convolve(clean**2, np.ones(200) / 200, mode="same")
        strong = envelope > 0.1 * envelope.max()
        self.strong.append(float(inside[strong].mean()))
        self.quiet.append(float(inside[~strong].mean()))

    def take_last_of(self, other: Found) -> None:
        """Add the latest result of another error model."""
        for each in fields(self):
            getattr(self, each.name).append(getattr(other, each.name)[-1])

    def row(self, label: str, chosen: int) -> list[str]:
        """Return a row of the table."""
        scatter = np.std(self.means, axis=0, ddof=1)
        ratios = [scatter / np.sqrt(np.mean(np.square(sds), axis=0)) for sds in (self.sds, self.elsewhere)]
        both = [f"{plain:.2f} ({shown:.2f})" for plain, shown in zip(*ratios, strict=True)]
        covered = [f"{np.mean(x):.0%}" for x in (self.peaks, self.strong, self.quiet)]
        return [label, *both, f"{np.mean(self.evidence):.0f}", str(chosen), *covered]


def wrong_model_rows(records: int, laws: dict[str, Any], structures: Sequence[str]) -> list[list[str]]:
    """Compare the scatter of posterior means over many records of one structure with the posterior standard deviations."""
    model, rows = oscillator(free=space().names), []
    for name, truth in ((name, TRUTHS[name]()) for name in structures):
        found, chosen = {law: Found() for law in laws}, dict.fromkeys((*laws, "chosen error model"), 0)
        found["chosen error model"] = Found()
        for index in range(records):
            observation = measured(truth, index, motion_of(index))
            choice = si.choose_error_model(space(), model, observation, list(laws.values()), seed=index)
            for law, result in zip(laws, choice.results, strict=True):
                found[law].take(result, truth, motion_of(index + 1))
            found["chosen error model"].take_last_of(found[list(laws)[choice.chosen]])
            chosen[list(laws)[choice.chosen]] += 1
            print(f"{name}, record {index + 1} of {records}: {choice.sentence}", flush=True)
        rows += [found[law].row(f"{name}: {law}", chosen[law] or "") for law in found]
        for row in rows[-len(found) :]:
            print(" | ".join(row), flush=True)
    return rows


# --- correct models ---------------------------------------------------------------------------------------------


def right_model_rows(replicas: int, laws: dict[str, Any]) -> list[list[str]]:
    """How often the true error model is chosen for a correct model, and the standard deviations relative to it."""
    truth, model, rows = oscillator(stiffness=0.474e6, beta=25.0, alpha=0.1), oscillator(free=space().names), []
    for label, right in (("white noise", "iid"), ("AR(1) noise", "ar1")):
        chosen, ratios = [], []
        for index in range(replicas):
            motion = record(300 + index, 3.0, 18.0)
            clean = response(truth, motion)
            rng, sd = np.random.default_rng(index), 0.05 * clean.std()
            law = si.IID(variance=sd**2) if right == "iid" else si.AR1(variance=sd**2, white=0.0, correlation_time=0.1)
            noise = law.draw(rng, (1, len(clean), 1), {}, ("velocity",), motion.dt)[0, :, 0]
            choice = si.choose_error_model(
                space(), model, si.Observation(motion, clean + noise), list(laws.values()), seed=index
            )
            chosen.append(list(laws)[choice.chosen])
            ratios.append(choice.result.sd[:3] / choice.results[list(laws).index(right)].sd[:3])
        others = ", ".join(f"{law} {chosen.count(law)}" for law in sorted(set(chosen) - {right})) or "–"
        rows.append(
            [
                label,
                f"{right}: {chosen.count(right)} of {replicas}",
                others,
                ", ".join(f"{r:.2f}" for r in np.mean(ratios, axis=0)),
                "95 %, 0.9–1.1",
            ]
        )
        print(" | ".join(rows[-1]), flush=True)
    return rows


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    replicas, records, right = (20, 2, 1) if quick else (200, RECORDS, 20)
    laws, structures = (dict(list(LAWS.items())[:2]), list(TRUTHS)[:1]) if quick else (LAWS, list(TRUTHS))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ranks, rightly = sbc_rows(replicas), right_model_rows(right, laws)
        wrong = wrong_model_rows(records, laws, structures)
    heads = [
        "noise and likelihood",
        "ranks",
        "smallest of four p-values",
        "coverage of 50 % intervals",
        "coverage of 90 % intervals",
        "seconds",
        "limit",
    ]
    wrong_heads = [
        "wrong model: error model",
        *(f"{name}: scatter/sd (record-to-record)" for name in space().names),
        "log evidence",
        "times chosen",
        "coverage of peaks",
        "coverage, strong part",
        "coverage, weak part",
    ]
    right_heads = [
        "noise",
        "true error model chosen",
        "others chosen",
        "sds of stiffness, beta, alpha relative to the true error model",
        "limit",
    ]
    text = f"""# Coverage of credible intervals

`benchmarks/honesty.py`. {common.machine()}.

**Simulation-based calibration** (`si.sbc`): an oscillator of 1 Hz with three unknown parameters, 10 s of a stochastic record at
0.01 s, noise of 10 % of the RMS. Each of {replicas} measurements is simulated with parameters from the prior, and calibrated. If
the likelihood matches the noise, a test at the 1 % level does not reject uniform ranks of the true parameters. The test rejects
uniform ranks if the noise is AR(1) with φ = {PHI} and the likelihood assumes independent errors
([figures](../../figures/sbc_3.png)).

{common.markdown_table(heads, ranks)}

**Correct models**: choices of `si.choose_error_model` for the oscillator, measured {right} times for 15 s with 5 % noise.

{common.markdown_table(right_heads, rightly)}

**Wrong models**: an oscillator with three unknown parameters is calibrated to {records} records of each structure (30 s, 2 %
noise). The scatter of the posterior means over the records is divided by the posterior sd. For the values in brackets, this
scatter is divided by the reported record-to-record sd, which includes the drift of the parameters (limit 1.5). The last columns
refer to predictions of the next record. The coverage of peaks is the fraction of 90 % intervals that contain the true peak (limit
80 %). The other coverages are the fraction of the history within the 90 % band with model error (limits 85 to 95 %). In the strong
part, the running mean of the squared response exceeds a tenth of its maximum. In these cases, a study with a surrogate chooses
damped-cosine errors. A study without a surrogate can also choose one of the two error models with drifting parameters.

{common.markdown_table(wrong_heads, wrong)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), ranks=ranks, rightly=rightly, wrong=wrong)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
