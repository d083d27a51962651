"""Calibrations of the façade compared with the model's posterior and the true parameters, for correct and wrong models.

Run with ``python benchmarks/facade_calibration.py [--quick]``. El Centro is read from ``../shared/data``.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import common
import numpy as np
from facade import BOX, COORDINATES, MONITORED, el_centro
from scipy.special import ndtri

import structid as si
from structid.inference.prediction.prediction import predict

NAME = "facade_calibration"
NOISE = 0.02
"""Standard deviation of the white noise of each channel, divided by the channel's RMS."""
PLAN = si.Plan(true_runs=400, start=40, batch=10)
"""Batches are small, since the posteriors are so narrow that the first surrogates only locate them."""
QUICK_SAMPLER = si.SMC(particles=60, ensembles=2, steps=6, effective_share=0.5)
QUICK_PLAN = si.Plan(true_runs=44, start=12, batch=10, exploration_sampler=QUICK_SAMPLER)
"""Too few runs for a certificate; a quick run only checks that the script works."""
EXPERIMENTS, BESIDE_SMC = 10, 3
REFERENCE = si.SMC(particles=150, steps=80, effective_share=0.5, correlation=0.5, most_moves=10, scouts=0)


def space() -> si.ParameterSpace:
    return si.ParameterSpace(**BOX, coordinates=COORDINATES)


def model(*channels: str) -> si.MasonryWall:
    return si.MasonryWall(free=tuple(BOX), channels=channels or MONITORED)


def truths(count: int) -> np.ndarray:
    """True parameters, spread evenly over the prior range."""
    return space().sample(count, 20).values


def settings_of(theta: np.ndarray) -> dict[str, float]:
    return dict(zip(BOX, map(float, theta), strict=True))


def another_record(number: int) -> si.GroundMotion:
    """Strong part of a stochastic record, scaled to the PGA of El Centro."""
    record = si.GroundMotion.synthetic(seed=100 + number).lowpass(20.0).trim(6.0, 8.5).scale_to_pga(6.36)
    return common.shorter_if_quick(record, 1.2)


def measured(truth: si.MasonryWall, seed: int) -> si.Observation:
    """Simulated measurement of three displacements, with noise."""
    record = el_centro()
    clean = truth.recording(*MONITORED).simulate(np.zeros((1, 0)), record).values[0]
    noise = NOISE * np.sqrt(np.mean(clean**2, axis=0)) * np.random.default_rng(seed).normal(size=clean.shape)
    return si.Observation(record, clean + noise, channels=MONITORED)


def calibrated(observation: si.Observation, seed: int, plan: si.Plan, **settings: Any) -> tuple[Any, float]:
    began = time.perf_counter()
    if plan is QUICK_PLAN:
        settings["sampler"] = QUICK_SAMPLER
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the certificate reports points outside the surrogate's range
        found = si.calibrate(model(), space(), observation, plan=plan, seed=seed, **settings)
    return found, time.perf_counter() - began


def in_stiffnesses(draws: np.ndarray) -> np.ndarray:
    """Return log k_n and log k_t of draws (draw, parameter)."""
    phi_n, sigma, phi_t, tau = draws.T[:4]
    return np.log(np.stack([sigma**2 / phi_n, tau**2 / phi_t], axis=1))


# --- the correct model ----------------------------------------------------------------------------------------------


def inside_region(draws: np.ndarray, theta: np.ndarray) -> bool:
    """Whether the truth lies inside the ellipsoid of 95 % of the draws, in normal scores of the prior."""
    scores = ndtri(space().to_uniform(np.vstack([draws, theta])))
    centred = scores - scores[:-1].mean(axis=0)
    distance = np.einsum("di,ij,dj->d", centred, np.linalg.inv(np.cov(scores[:-1].T)), centred)
    return bool(distance[-1] <= np.quantile(distance[:-1], 0.95))


def right_model(count: int, beside: int, reference: si.SMC, plan: si.Plan) -> tuple[list[list[str]], list[list[str]]]:
    """Virtual experiments with the correct model; the first ones are compared with tempered SMC on the model itself."""
    rows, beside_rows = [], []
    for number, theta in enumerate(truths(count)):
        observation = measured(si.MasonryWall(**settings_of(theta)), number)
        found, seconds = calibrated(observation, number, plan)
        draws, certificate = found.sampling.flat[:, :4], found.certificate
        logs, true_logs = in_stiffnesses(draws), in_stiffnesses(theta[None])[0]
        rows.append(
            [
                f"{number + 1}",
                f"{certificate.verdict}, {_converged(found.sampling)}",
                f"{certificate.true_runs}",
                f"{seconds:.0f}",
                "inside" if inside_region(draws, theta) else "outside",
                *(f"{(m - t) / s:+.1f}" for m, t, s in zip(draws.mean(0), theta, draws.std(0), strict=True)),
                *(f"{m:.3f} ± {s:.3f} ({t:.3f})" for m, s, t in zip(logs.mean(0), logs.std(0), true_logs, strict=True)),
            ]
        )
        print(" | ".join(rows[-1]), flush=True)
        if number < beside:
            beside_rows.append(beside_the_model(number, found, observation, reference))
            print(" | ".join(beside_rows[-1]), flush=True)
    return rows, beside_rows


def _converged(result: si.SamplingResult) -> str:
    return "converged" if result.verdict().converged else "not converged"


def beside_the_model(number: int, found: Any, observation: si.Observation, reference: si.SMC) -> list[str]:
    """Compare a calibration with tempered SMC on the model itself."""
    posterior = si.Posterior(space(), model(), observation)
    began = time.perf_counter()
    itself = si.sample(posterior, reference, seed=99)
    seconds = time.perf_counter() - began
    sizes = [p.bulk_size for p in itself.verdict().parameters.values()]
    both = [found.sampling.flat[:, :4], itself.flat[:, :4]]
    means = [draws.mean(axis=0) for draws in both] + [in_stiffnesses(draws).mean(axis=0) for draws in both]
    sds = [draws.std(axis=0) for draws in both] + [in_stiffnesses(draws).std(axis=0) for draws in both]
    off = np.concatenate([(means[0] - means[1]) / sds[1], (means[2] - means[3]) / sds[3]])
    ratio = np.concatenate([sds[0] / sds[1], sds[2] / sds[3]])
    return [
        f"{number + 1}",
        f"{np.abs(off).max():.3f}",
        f"{np.abs(ratio - 1.0).max():.1%}",
        f"{min(sizes):.0f}",
        _converged(itself),
        f"{reference.evaluations(posterior.dimension)}",
        f"{seconds:.0f}",
    ]


# --- wrong models ---------------------------------------------------------------------------------------------------


def wrong_truth(number: int, theta: np.ndarray) -> tuple[str, si.MasonryWall]:
    """True wall that differs from the model: with damage and friction, or with other blocks."""
    if number % 2:
        finer = si.Wall(courses=((8, 6), 4))
        return "twice as many courses", si.MasonryWall(**settings_of(theta), wall=finer)
    joints = {"joint_law": "damage-friction", "friction": 0.7}
    return "damage and friction", si.MasonryWall(**settings_of(theta), **joints)


def wrong_model(count: int, plan: si.Plan) -> list[list[str]]:
    """Calibrate the wrong model, and predict the peak displacement under another record."""
    rows = []
    for number, theta in enumerate(truths(count)):
        what, truth = wrong_truth(number, theta)
        law = {} if plan is QUICK_PLAN else {"discrepancy": "auto"}  # a choice samples a posterior for each error model
        found, seconds = calibrated(measured(truth, number), number, plan, **law)
        other = another_record(number)
        true_history = truth.recording(MONITORED[0]).simulate(np.zeros((1, 0)), other)
        peak = float(np.nanmax(np.abs(true_history.values[0, :, 0])))
        prediction = predict(
            found.posterior, found.sampling.thinned(200), other, seed=number, drift=found.sampling.drift
        )
        low, middle, high = np.quantile(prediction.peaks[:, 0], [0.05, 0.5, 0.95])
        rows.append(
            [
                f"{number + 1}, {what}",
                f"{found.certificate.verdict}, {_converged(found.sampling)}",
                f"{found.certificate.true_runs}",
                f"{seconds:.0f}",
                found.posterior.discrepancy.describe()["kind"],
                f"{1e3 * peak:.1f}",
                f"{1e3 * low:.1f}, {1e3 * middle:.1f}, {1e3 * high:.1f}",
                "inside" if low <= peak <= high else "outside",
            ]
        )
        print(" | ".join(rows[-1]), flush=True)
    return rows


# --- two samplers ---------------------------------------------------------------------------------------------------


class NutsAlone(si.NUTS):
    """NUTS without its usual comparison with a population of particles, which is the reference here."""

    compared = False


def by_gradients(theta: np.ndarray, reference: si.SMC, nuts: NutsAlone) -> list[list[str]]:
    """Sample one posterior of the wall itself by tempered SMC, and by NUTS with implicit derivatives.

    The case has two parameters and 0.6 s of the record, since NUTS needs thousands of gradients one after another.
    """
    free, record = ("normal_energy", "tangential_strength"), el_centro().trim(0.9, 1.5)
    known = {name: value for name, value in settings_of(theta).items() if name not in free}
    two = si.MasonryWall(**known, free=free, channels=MONITORED)
    clean = si.MasonryWall(**settings_of(theta), channels=MONITORED).simulate(np.zeros((1, 0)), record).values[0]
    noise = NOISE * np.sqrt(np.mean(clean**2, axis=0)) * np.random.default_rng(0).normal(size=clean.shape)
    observation = si.Observation(record, clean + noise, channels=MONITORED)
    posterior = si.Posterior(si.ParameterSpace(**{name: BOX[name] for name in free}), two, observation)
    rows, draws = [], []
    for name, sampler in (("SMC", reference), ("NUTS", nuts)):
        began = time.perf_counter()
        found = si.sample(posterior, sampler, seed=7)
        seconds = time.perf_counter() - began
        sizes = [p.bulk_size for p in found.verdict().parameters.values()]
        draws.append(found.flat[:, :2])
        off = (draws[-1].mean(0) - draws[0].mean(0)) / draws[0].std(0)
        ratio = draws[-1].std(0) / draws[0].std(0) - 1.0
        converged = "converged" if found.verdict().converged else "not converged"
        rows.append(
            [
                name,
                converged,
                f"{min(sizes):.0f}",
                f"{seconds:.0f}",
                f"{np.abs(off).max():.3f}",
                f"{np.abs(ratio).max():.1%}",
            ]
        )
        print(" | ".join(rows[-1]), flush=True)
    return rows


# --- the page -------------------------------------------------------------------------------------------------------

HEADS = [
    "experiment",
    "verdict",
    "model runs",
    "seconds",
    "truth in the 95 % region",
    "error of φ_n [sd]",
    "error of σ_max [sd]",
    "error of φ_t [sd]",
    "error of τ_max [sd]",
    "log k_n (truth)",
    "log k_t (truth)",
]
BESIDE = [
    "experiment",
    "largest error of a mean [sd]",
    "largest error of an sd",
    "bulk effective size of SMC",
    "verdict on SMC",
    "model runs of SMC",
    "seconds of SMC",
]
WRONG = [
    "experiment, truth",
    "verdict",
    "model runs",
    "seconds",
    "error model",
    "true peak in another record [mm]",
    "predicted 5, 50, 95 % quantiles [mm]",
    "true peak is",
]
SAMPLERS = [
    "sampler on the wall itself",
    "verdict",
    "bulk effective size",
    "seconds",
    "largest difference of a mean [sd]",
    "largest difference of an sd",
]


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    # The comparisons take hundreds of thousands of model runs, too many for a quick run.
    plan = QUICK_PLAN if quick else PLAN
    right, beside = right_model(1 if quick else EXPERIMENTS, 0 if quick else BESIDE_SMC, REFERENCE, plan)
    wrong = wrong_model(1 if quick else EXPERIMENTS, plan)
    nuts = NutsAlone(steps=150, chains=4, warm_up=100)
    both = [] if quick else by_gradients(truths(EXPERIMENTS)[4], REFERENCE, nuts)
    inside = sum(row[4] == "inside" for row in right)
    covered = sum(row[-1] == "inside" for row in wrong)
    text = f"""# The masonry façade, calibrated

`benchmarks/facade_calibration.py`. {common.machine()}.

Virtual experiments under El Centro (2.5 s, 753 values) give three displacements with 2 % noise. The true parameters are spread
evenly over the prior ranges of the thesis. `si.calibrate` uses POD-Kriging in transformed coordinates and at most 400 model runs:
40 in the first design, 10 per round, and 30 for the certificate. The 95 % region is the ellipsoid of the draws in normal scores of
the prior. The truth is inside in {inside} of {len(right)} experiments (limit 9 of 10).

{common.markdown_table(HEADS, right)}

The first experiments are compared with draws on the wall itself (limit 0.1 sd), by {REFERENCE.in_words}:

{common.markdown_table(BESIDE, beside)}

Calibrations of a wrong model: the true wall has damage and friction (μ = 0.7), or twice as many courses. The error model is chosen
from the data. The predicted 5 to 95 % interval of the peak |u_x| in another record contains the true peak in {covered} of
{len(wrong)} experiments (limit 8 of 10).

{common.markdown_table(WRONG, wrong)}

The table compares two samplers on one posterior of the wall itself, without a surrogate (φ_n and τ_max unknown, 0.6 s of the
record). NUTS uses derivatives through the equilibrium of every step:

{common.markdown_table(SAMPLERS, both)}
"""
    common.record_result(
        NAME, quick=quick, machine=common.machine(), right=right, beside=beside, wrong=wrong, both=both
    )
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
