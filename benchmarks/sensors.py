"""Cost of a likelihood whose sensors have gaps and their own rates, beside that of sensors at the samples of the record.

    python benchmarks/sensors.py [--quick]

The ratios are medians over interleaved calls. The second table shows a surrogate's likelihood for instruments with unknown
parameters, from sums over time and from the response.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

import common
import numpy as np

import structid as si

NAME = "sensors"
DURATION, RATE = 20.0, 256.0
NOISE, MISSING = 0.01, 0.2
RUNS = 2048
VARIANCE = 1e-4

ERROR_MODELS = {
    "iid": si.IID(variance=VARIANCE),
    "AR(1)": si.AR1(variance=VARIANCE, white=0.1 * VARIANCE, correlation_time=0.05),
    "damped cosine": si.DampedCosine(variance=VARIANCE, white=0.1 * VARIANCE, frequency=3.0, damping=0.1),
}
INSTRUMENTS: dict[str, dict[str, Any]] = {
    "no unknown parameter": {},
    "unknown offset": {"offset": si.Normal(0.0, 0.01)},
    "unknown polarity": {"polarity": "unknown"},
    "unknown polarity, gain, offset, drift": {
        "polarity": "unknown",
        "gain": si.Normal(1.0, 0.05),
        "offset": si.Normal(0.0, 0.01),
        "drift": si.Normal(0.0, 0.001),
    },
}


def oscillator() -> tuple[si.BoucWen, si.ParameterSpace, tuple[float, ...]]:
    """The oscillator with two channels, its unknown parameters, and the rates of its two sensors."""
    space = si.ParameterSpace(stiffness=si.Uniform(6.0, 9.0, unit="kN/mm"), alpha=si.Uniform(0.02, 0.1))
    model = si.BoucWen(
        mass=12e3,
        damping_ratio=0.03,
        beta=63.0,
        gamma=63.0,
        free=space.names,
        channels=("velocity", "displacement"),
    )
    return model, space, (200.0, 128.0)


def frame() -> tuple[si.ShearFrame, si.ParameterSpace, tuple[float, ...]]:
    """A three-storey frame with three accelerometers and a displacement transducer."""
    space = si.ParameterSpace(stiffness_1=si.Uniform(18.0, 26.0, unit="kN/mm"), alpha=si.Uniform(0.02, 0.1))
    model = si.ShearFrame(
        storeys=3,
        mass=12e3,
        stiffness=[22e6, 19e6, 16e6],
        damping_ratio=0.03,
        beta=63.0,
        gamma_ratio=0.4,
        free=space.names,
        channels=(*(f"absolute_acceleration_{n}" for n in (1, 2, 3)), "drift_1"),
    )
    return model, space, (200.0, 200.0, 200.0, 100.0)


def sensors(model: Any, record: si.GroundMotion, theta: np.ndarray, rates: tuple[float, ...]) -> dict[str, list[Any]]:
    """Sensors at the samples of the record, with gaps, and with gaps and their own rates."""
    rng, response = np.random.default_rng(0), model.simulate(theta[:1], record).values[0]
    kinds: dict[str, list[Any]] = {"plain": [], "gaps": [], "gaps, own rates": []}
    for channel, values, rate in zip(model.channels, response.T, rates, strict=True):
        noisy = values + NOISE * values.std() * rng.standard_normal(len(values))
        kinds["plain"].append(si.Observation(record, noisy, (channel,)))
        kinds["gaps"].append(si.Observation(record, with_gaps(noisy, rng), (channel,)))
        times = np.arange(0.0013, record.time[-1], 1.0 / rate)
        own = with_gaps(np.interp(times, record.time, noisy), rng)
        kinds["gaps, own rates"].append(si.Observation(record, own, (channel,), dt=1.0 / rate, start=0.0013))
    return kinds


def with_gaps(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Replace a share of the values by missing ones."""
    return np.where(rng.random(len(values)) < MISSING, np.nan, values)


def timed_ratios(calls: dict[str, Callable[[], Any]], repeats: int) -> dict[str, tuple[float, float]]:
    """Median time of each call, and median ratio to the first call in the same round."""
    for call in calls.values():
        call()
    timings = common.interleaved(calls, repeats)
    first = next(iter(timings.values())).seconds
    return {
        name: (t.median, statistics.median(a / b for a, b in zip(t.seconds, first, strict=True)))
        for name, t in timings.items()
    }


def model_rows(record: si.GroundMotion, repeats: int, quick: bool) -> list[list[str]]:
    """Cost of the likelihood of a model, by error model and kind of sensors."""
    rows = []
    for name, (model, space, rates) in (("oscillator", oscillator()), ("frame, four sensors", frame())):
        theta = space.sample(RUNS, seed=1).values
        kinds = sensors(model, record, theta, rates)
        for error_name, error_model in ERROR_MODELS.items():
            calls = {
                kind: partial(si.Posterior(space, model, observations, error_model).log_likelihood, theta)
                for kind, observations in kinds.items()
            }
            result = timed_ratios(calls, repeats)
            ratios = {kind: ratio for kind, (_, ratio) in result.items()}
            common.record_result(NAME, quick=quick, model=name, error_model=error_name, ratios=ratios)
            plain = 1e3 * result["plain"][0] / RUNS
            rows.append([f"{name}, {error_name}", f"{plain:.3f}", *(f"{r:.2f}" for r in list(ratios.values())[1:])])
    return rows


def surrogate_rows(record: si.GroundMotion, repeats: int, quick: bool) -> list[list[str]]:
    """Cost of a surrogate's likelihood by instrument: from sums over time, and from the response."""
    model, space, _ = oscillator()
    surrogate = si.PODKriging(limit=1.0).fit(si.Campaign(model, record, space.sample(60, seed=1)).run())
    theta = space.sample(RUNS, seed=2).values
    measured = sensors(model, record, theta, (200.0, 128.0))["gaps, own rates"][0]
    rows = []
    for name, unknown in INSTRUMENTS.items():
        observation = si.Observation(
            record, measured.values, measured.channels, dt=measured.dt, start=measured.start, **unknown
        )
        of = si.Posterior(space, surrogate, observation, si.IID(variance=VARIANCE))
        points = np.column_stack([theta, of.space.sample(RUNS, seed=3).values[:, space.dimension :]])
        responses = [surrogate.simulate(theta, record).values]

        def from_responses(of: Any = of, points: np.ndarray = points) -> Any:
            return of.given([surrogate.simulate(points[:, : space.dimension], record).values]).log_density(points)

        result = timed_ratios({"sums": partial(of.log_density, points), "responses": from_responses}, repeats)
        from_sums = of.log_density(points)
        difference = np.abs(of.given(responses).log_density(points) - from_sums).max() / np.abs(from_sums).max()
        common.record_result(NAME, quick=quick, instrument=name, ratio=result["responses"][1], difference=difference)
        cells = [f"{1e6 * seconds / RUNS:.1f}" for seconds, _ in result.values()]
        rows.append([name, *cells, f"{difference:.0e}"])
    return rows


def main() -> None:
    """Run the comparisons, and write the page."""
    quick = common.is_quick(__doc__ or "")
    record = common.shorter_if_quick(common.study_record(40.0, common.STUDY_PGA), 4.0).resample(1.0 / RATE)
    record = record if quick else record.trim(0.0, DURATION)
    repeats = 1 if quick else 15
    of_models, of_surrogates = model_rows(record, repeats, quick), surrogate_rows(record, repeats, quick)
    text = f"""
# Sensors with gaps and their own rates

`benchmarks/sensors.py`. {common.machine()}. Record: {len(record)} samples at {RATE:g} Hz.

Milliseconds per run of the likelihood with sensors at the samples of the record, and the cost relative to it: with
{MISSING:.0%} of the values missing, and also with other rates (oscillator: 200 and 128 Hz; frame: 200 Hz and 100 Hz).

{common.markdown_table(["model, error model", "plain [ms]", "gaps", "gaps, own rates"], of_models)}

Microseconds per evaluation of a surrogate's likelihood for a sensor with its own rate and gaps: from precomputed sums over
time, and from the response. The last column is the largest difference of the two log densities, relative to the
largest log density.

{common.markdown_table(["instrument", "sums [µs]", "response [µs]", "difference"], of_surrogates)}
"""
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
