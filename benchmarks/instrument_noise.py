"""Coverage of parameters, responses, measurements and peaks for five laws of an instrument's noise.

Run with ``python benchmarks/instrument_noise.py [--quick] [--noise NAME] [--replicates FIRST END]``. Every calibration is recorded,
and the page has all recorded ones.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import common
import numpy as np

import structid as si

NAME = "instrument_noise"
RECORDS, REPLICATES = 4, 20
LEVEL = 0.03
"""Standard deviation of the noise, divided by the RMS of the response."""
OUTLIERS, OUTLIER_SIZE = 0.01, 20.0
"""Fraction of outliers, and their standard deviation relative to that of the other errors."""
PROPORTIONAL, FLOOR = 0.1, 0.003
"""Proportional error relative to the response, and constant error relative to the RMS of the response."""
BITS, BEFORE_ROUNDING = 12, 0.1
"""Bits of the converter, whose range is twice the largest response, and the noise before it in steps."""
CORRELATION_TIME = 0.1
"""Correlation time of the AR(1) noise [s]."""
STEP = 0.01
"""Time step of the records [s]."""
PROBABILITY = 0.9
SAMPLER = si.SMC(particles=300, steps=50)


def space() -> si.ParameterSpace:
    """Priors of a 1 Hz oscillator, from which the true parameters are drawn."""
    return si.ParameterSpace(
        stiffness=si.Normal(0.474, 0.06, low=0.2, high=0.8, unit="kN/mm"),
        beta=si.Uniform(5.0, 60.0, unit="1/m"),
        alpha=si.Uniform(0.0, 0.5),
    )


def oscillator() -> si.BoucWen:
    return si.BoucWen(mass=12_000.0, damping_ratio=0.03, gamma_ratio=0.5, free=space().names)


def motion(index: int) -> si.GroundMotion:
    return si.GroundMotion.synthetic(seed=700 + index).lowpass(20.0).trim(2.0, 17.0).scale_to_pga(1.8)


# --- noise: each maps a response (time,), the response to the measured record, and a generator to a measurement ------


def white(clean: np.ndarray, first: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return clean + LEVEL * first.std() * rng.normal(size=clean.shape)


def correlated(clean: np.ndarray, first: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    phi, noise = np.exp(-STEP / CORRELATION_TIME), rng.normal(size=clean.shape)
    for t in range(1, len(noise)):
        noise[t] = phi * noise[t - 1] + np.sqrt(1.0 - phi**2) * noise[t]
    return clean + LEVEL * first.std() * noise


def outliers(clean: np.ndarray, first: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    size = np.where(rng.random(clean.shape) < OUTLIERS, OUTLIER_SIZE, 1.0)
    return clean + LEVEL * first.std() * size * rng.normal(size=clean.shape)


def proportional(clean: np.ndarray, first: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    constant = FLOOR * first.std() * rng.normal(size=clean.shape)
    return clean * (1.0 + PROPORTIONAL * rng.normal(size=clean.shape)) + constant


def rounded(clean: np.ndarray, first: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    step = 2.0 * np.abs(first).max() / 2**BITS
    return step * np.round(clean / step + BEFORE_ROUNDING * rng.normal(size=clean.shape))


@dataclass(frozen=True)
class Noise:
    """One law of noise: how it is made, and the error model that should be chosen."""

    measure: Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]
    right: str


NOISES = {
    "white": Noise(white, "iid"),
    "AR(1)": Noise(correlated, "ar1"),
    "1 % outliers": Noise(outliers, "contaminated"),
    "proportional": Noise(proportional, "proportional"),
    "12-bit rounding": Noise(rounded, "quantised"),
}


def calibrate(label: str, record: int, replicate: int) -> dict[str, Any]:
    """Calibrate one oscillator drawn from the prior, and predict another record; what the result covers.

    Every law of noise has parameters and noise of its own.
    """
    noise, number = NOISES[label], list(NOISES).index(label)
    rng = np.random.default_rng([number, record, replicate])
    theta = space().sample(1, seed=10_000 * number + 1000 * record + replicate).values
    here, there, model = motion(record), motion(RECORDS + record), oscillator()
    clean, elsewhere = (model.simulate(theta, each).values[0, :, 0] for each in (here, there))
    began = time.perf_counter()
    observation = si.Observation(here, noise.measure(clean, clean, rng))
    choice = si.choose_error_model(space(), model, observation, seed=replicate)
    result = si.sample(choice.posterior, SAMPLER, seed=replicate)
    prediction = result.predict(there)
    seconds = time.perf_counter() - began
    tail = 0.5 * (1.0 - PROBABILITY)
    low, high = np.quantile(result.flat[:, :3], (tail, 1.0 - tail), axis=0)
    measured = noise.measure(elsewhere, clean, rng)
    of_response, of_measurement = (prediction.band(PROBABILITY, discrepancy=each) for each in (False, True))
    lowest, highest = np.quantile(prediction.peaks[:, 0], (tail, 1.0 - tail))
    return {
        "noise": label,
        "record": record,
        "replicate": replicate,
        "chosen": choice.error_models[choice.chosen],
        "parameters": ((theta[0] >= low) & (theta[0] <= high)).astype(float).tolist(),
        "response": _share_inside(elsewhere, of_response),
        "measurement": _share_inside(measured, of_measurement),
        "peak": float(lowest <= np.abs(elsewhere).max() <= highest),
        "doubted": float(bool(result.verdict().doubt)),
        "seconds": seconds,
    }


def _share_inside(history: np.ndarray, band: tuple[np.ndarray, np.ndarray]) -> float:
    low, high = (edge[:, 0] for edge in band)
    return float(np.mean((history >= low) & (history <= high)))


def row(label: str, outcomes: list[dict[str, Any]]) -> list[str]:
    """One row of the table."""
    right = NOISES[label].right
    chosen = [each["chosen"] for each in outcomes]
    parameters = np.array([each["parameters"] for each in outcomes])
    shares = [np.mean([each[name] for each in outcomes]) for name in ("response", "measurement", "peak")]
    return [
        label,
        f"{right}: {chosen.count(right)} of {len(outcomes)}",
        ", ".join(sorted({*chosen} - {right})) or "–",
        f"{parameters.mean():.0%} ({', '.join(f'{share:.0%}' for share in parameters.mean(axis=0))})",
        *(f"{share:.0%}" for share in shares),
        f"{sum(each['doubted'] for each in outcomes):.0f} of {len(outcomes)}",
        f"{np.median([each['seconds'] for each in outcomes]):.1f}",
    ]


def page_text(outcomes: list[dict[str, Any]]) -> str:
    """The page of all recorded calibrations."""
    rows = [row(label, of_noise) for label in NOISES if (of_noise := [o for o in outcomes if o["noise"] == label])]
    heads = [
        "noise",
        "right error model chosen",
        "others",
        "parameters (each)",
        "response",
        "measurement",
        "peak",
        "doubted",
        "seconds (median)",
    ]
    return f"""# Noise of instruments

`benchmarks/instrument_noise.py`. {common.machine()}.

An oscillator of 1 Hz, whose three parameters are drawn from the prior, is measured on {RECORDS} stochastic records of 15 s at
0.01 s, up to {REPLICATES} times each. Five laws of noise:

* white noise of {LEVEL:.0%} of the RMS response to the measured record;
* AR(1) noise of the same size, with a correlation time of {CORRELATION_TIME} s;
* white noise of the same size, in which {OUTLIERS:.0%} of the values have {OUTLIER_SIZE:g} times the standard deviation;
* noise of {PROPORTIONAL:.0%} of the momentary response, and {FLOOR:.1%} of its RMS;
* rounding by a converter of {BITS} bits, with noise of {BEFORE_ROUNDING:g} steps before it.

The data choose the error model (`si.choose_error_model` with its default candidates). The posterior is then sampled, and another
record is predicted. The table gives the fraction of 90 % intervals that contain the true parameters (limits 85 to 95 %). For the
other record, it gives the fraction of the true response inside its 90 % band, the fraction of a measurement with the same noise
inside its 90 % band, and how often the true peak is inside its 90 % interval (limits 85 to 98 %). *Doubted*: calibrations whose
verdict names evidence against the model or the error model; both are right.

{common.markdown_table(heads, rows)}
"""


def main() -> None:
    """Run calibrations, and write the page of all recorded ones."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two calibrations; does not write to docs/")
    parser.add_argument("--noise", choices=NOISES, action="append", help="laws of noise of this run; default: all")
    parser.add_argument("--replicates", type=int, nargs=2, default=(0, REPLICATES), metavar=("FIRST", "END"))
    asked = parser.parse_args()
    replicates, records = (range(1), range(1)) if asked.quick else (range(*asked.replicates), range(RECORDS))
    noises = asked.noise or (list(NOISES)[-2:] if asked.quick else list(NOISES))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for replicate in replicates:
            for record in records:
                for label in noises:
                    outcome = calibrate(label, record, replicate)
                    common.record_result(NAME, quick=asked.quick, **outcome)
                    print(outcome, flush=True)
    last = common.last_results(NAME, "noise", "record", "replicate", quick=asked.quick)
    common.write_page(asked.quick, NAME, page_text(list(last.values())))


if __name__ == "__main__":
    main()
