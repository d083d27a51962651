#!/usr/bin/env python3
"""Write down what the package computes, to the last bit, and compare it with what another version of it computes.

A change that is meant to leave results alone is checked so, on one machine:

    python tools/same_results.py write before.npz        # with the old code installed
    python tools/same_results.py write after.npz         # with the new code
    python tools/same_results.py compare before.npz after.npz

Only public names are used, so that the two versions may differ in everything else. A case is a function whose name
begins with ``case_``: it yields a word and an array for each result.
"""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import structid as si

Results = Iterator[tuple[str, Any]]

RECORD = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 6.0).scale_to_pga(2.0)
OTHER = si.GroundMotion.synthetic(seed=9).lowpass(20.0).trim(3.0, 6.0).scale_to_pga(2.0)
STROKES = si.DisplacementHistory(0.02 * np.sin(9.0 * RECORD.time), RECORD.dt, "strokes")
LAW = dict(alpha=0.05, beta=63.0, gamma_ratio=0.5)
DEGRADING = dict(mass=12e3, damping_ratio=0.03, stiffness=7.6e6, alpha=0.05, beta=63.0, gamma_ratio=1.0)
DEGRADING |= dict(delta_nu=2.43, delta_eta=6.5)
SPACE = si.ParameterSpace(stiffness=si.Uniform(6.5, 8.5, unit="kN/mm"), gamma_ratio=si.Uniform(-0.5, 0.8))
SMALL_SMC = si.SMC(particles=100, ensembles=2, steps=10, effective_share=0.5, correlation=0.5)


# --- what several cases use -------------------------------------------------------------------------------------------


@cache
def oscillator() -> si.BoucWen:
    return si.BoucWen(mass=12e3, damping_ratio=0.03, beta=60.0, alpha=0.06, free=SPACE.names)


@cache
def measured() -> si.Observation:
    clean = oscillator().simulate(np.array([[7.4e6, 0.2]]), RECORD).values[0]
    noise = 0.02 * clean.std() * np.random.default_rng(1).normal(size=clean.shape)
    return si.Observation(RECORD, clean + noise)


@cache
def posterior(law: Any = None) -> si.Posterior:
    return si.Posterior(SPACE, oscillator(), measured(), law or si.IID())


@cache
def runs() -> si.Runs:
    return si.Campaign(oscillator(), RECORD, SPACE.sample(40, seed=1, method="sobol", widen=1.3)).run()


@cache
def drawn() -> si.SamplingResult:
    return si.sample(posterior(), SMALL_SMC, seed=3)


def parts(**settings: Any) -> tuple[si.Substructure, si.Substructure]:
    return si.cut_frame(si.ShearFrame(storeys=2, mass=12e3, damping_ratio=0.03, stiffness=8e6, **LAW, **settings), 1)


# --- records and priors -----------------------------------------------------------------------------------------------


def case_records() -> Results:
    raw = si.GroundMotion.synthetic(seed=7, duration=12.0)
    for word, record in {
        "synthetic": raw,
        "low pass": raw.lowpass(20.0),
        "resampled": raw.resample(0.004),
        "trimmed": raw.trim(1.0, 9.0),
        "scaled": raw.scale_to_pga(3.59),
    }.items():
        yield word, record.values
    frequency, amplitude = raw.fourier_amplitude()
    yield "Fourier amplitude", amplitude
    yield "its frequency", frequency
    spectrum = raw.response_spectrum(np.linspace(0.1, 2.0, 20), 0.05)
    yield "response spectrum", getattr(spectrum, "acceleration", spectrum)


def case_priors() -> Results:
    families = dict(
        normal=si.Normal(2.0, 0.5), cut=si.Normal(2.0, 0.5, low=1.5), uniform=si.Uniform(1.0, 3.0),
        lognormal=si.LogNormal(2.0, 0.4), gamma=si.Gamma(2.0, 0.3), beta=si.Beta(0.4, 0.1),
        weibull=si.Weibull(2.0, 0.5), gumbel=si.Gumbel(2.0, 0.5),
    )  # fmt: skip
    space = si.ParameterSpace(**families, correlation={("normal", "uniform"): 0.4})
    for method in ("random", "latin_hypercube", "sobol"):
        yield f"design {method}", space.sample(50, seed=4, method=method).values
    points = space.sample(50, seed=5).values
    yield "log density", space.log_density(points)
    yield "quantiles", space.quantile(np.full((3, len(families)), [[0.1], [0.5], [0.9]]))


# --- models -----------------------------------------------------------------------------------------------------------


def simulated(model: Any, space: si.ParameterSpace, excitation: Any = RECORD) -> Results:
    histories = model.simulate(space.sample(5, seed=2), excitation)
    yield "histories", histories.values
    yield "status", histories.status


def case_oscillator() -> Results:
    yield from simulated(oscillator(), SPACE)
    channels = ("velocity", "displacement", "restoring_force", "absolute_acceleration", "absorbed_energy")
    yield "degrading", si.BoucWen(**DEGRADING, channels=channels).simulate(np.zeros((1, 0)), RECORD).values


def case_frame() -> Results:
    space = si.ParameterSpace(
        stiffness_1=si.Uniform(15.0, 25.0, unit="kN/mm"), stiffness_2=si.Uniform(15.0, 25.0, unit="kN/mm")
    )
    channels = ("velocity_1", "velocity_2")
    frame = si.ShearFrame(storeys=2, mass=12e3, damping_ratio=0.03, **LAW, free=space.names, channels=channels)
    yield from simulated(frame, space)


def case_imposed_displacements() -> Results:
    yield from simulated(si.ImposedDisplacements(oscillator(), pieces=2), SPACE, STROKES)


def case_wall() -> Results:
    space = si.ParameterSpace(normal_energy=si.Uniform(4e3, 6e3), tangential_strength=si.Uniform(1e6, 2e6))
    for law in ("smc-np2", "damage-friction"):
        joints = dict(normal_strength=1e6, tangential_energy=4e5, joint_law=law, step=5e-3)
        wall = si.MasonryWall(**joints, free=space.names, channels=("ux_top_left", "base_shear"))
        for word, values in simulated(wall, space):
            yield f"{law}: {word}", values


def case_virtual_hybrid_test() -> Results:
    test = si.VirtualHybridTest(*parts(), oscillator(), 0.01, si.PrakashHjelmstad(20, "numerical"), 2)
    yield from simulated(test, SPACE)


def wave(parameters: dict[str, float], record: si.GroundMotion) -> np.ndarray:
    """A user's model."""
    return np.asarray(parameters["a"] * np.sin(parameters["b"] * record.time) + record.values)


def case_user_model() -> Results:
    space = si.ParameterSpace(a=si.Uniform(0.2, 1.0), b=si.Normal(5.0, 1.0, low=1.0))
    yield from simulated(si.CallableModel(wave, space.names, ("velocity",), isolated=False), space)


# --- likelihood and posterior -----------------------------------------------------------------------------------------


def case_posterior() -> Results:
    laws = {
        "iid": si.IID(),
        "AR(1)": si.AR1(),
        "Matérn": si.Matern32(),
        "damped cosine": si.DampedCosine(),
        "drifting": si.Drifting(0.5),
    }
    for word, law in laws.items():
        target = si.Posterior(SPACE, oscillator(), measured(), law)
        points = target.initial(6, np.random.default_rng(5))
        yield f"{word}: log density", target.log_density(points)
        yield f"{word}: log likelihood", target.log_likelihood(points)


def case_misfit() -> Results:
    misfit = posterior().misfit
    points = SPACE.sample(4, seed=6).values
    yield "values", misfit(points)
    for word, values in zip(("value", "gradient", "Hessian"), misfit.linearised(points), strict=True):
        yield f"linearised: {word}", values
    found = si.optimize.pattern_search(misfit, starts=3, seed=1)
    yield "pattern search", found.ends


# --- surrogates -------------------------------------------------------------------------------------------------------


def fitted(settings: Any) -> Results:
    surrogate = settings.fit(runs())
    points = SPACE.sample(6, seed=9).values
    yield "values", surrogate.simulate(points, RECORD).values
    with tempfile.TemporaryDirectory() as folder:
        surrogate.save(Path(folder) / "surrogate.h5")
        yield "read again", si.load_surrogate(Path(folder) / "surrogate.h5").simulate(points, RECORD).values
    yield "validation", surrogate.validate(runs(), fitted=True).mean


def case_pod_kriging() -> Results:
    yield from fitted(si.PODKriging())


def case_pod_pce() -> Results:
    yield from fitted(si.PODPCE())


def case_pc_narx() -> Results:
    yield from fitted(si.PCNARX(degree=1, steps=2))


def case_kriging_narx() -> Results:
    yield from fitted(si.KrigingNARX(steps=2))


def case_regressions() -> Results:
    space = si.ParameterSpace(x=si.Uniform(-1.0, 1.0), y=si.Normal(0.0, 1.0))
    design, points = space.sample(60, seed=3), space.sample(7, seed=4).values
    outputs = np.sin(2.0 * design.values[:, :1]) + design.values[:, 1:] ** 2
    for word, settings in {
        "Kriging": si.Kriging(),
        "Kriging with nugget": si.Kriging(trend="linear", correlation="gaussian", nugget="estimate", separable=True),
        "PCE": si.PCE(degree=(1, 2, 3, 4)),
        "PCE by least squares": si.PCE(degree=3, method="ols"),
        "PCE shrunken": si.PCE(degree=5, method="shrinkage"),
    }.items():
        found = settings.fit(design, outputs)
        yield word, found.predict(points) if hasattr(found, "predict") else found(points)


# --- samplers, calibration, certificate -------------------------------------------------------------------------------


def sampled(sampler: Any, target: Any = None) -> Results:
    result = si.sample(target or posterior(), sampler, seed=1)
    yield "draws", result.draws
    yield "log density", result.log_density
    if result.log_evidence is not None:
        yield "evidence", result.log_evidence.value


def case_aies() -> Results:
    yield from sampled(si.AIES(walkers=20, steps=60, ensembles=2))


def case_smc() -> Results:
    yield from sampled(SMALL_SMC)


def case_nuts() -> Results:
    yield from sampled(si.NUTS(steps=50, chains=2, warm_up=50))


def case_delayed_acceptance() -> Results:
    surrogate = si.PODKriging().fit(runs())
    yield from sampled(si.DelayedAcceptance(surrogate, walkers=8, steps=12, ensembles=2, tuning=4))


def case_what_follows_from_draws() -> Results:
    result = drawn()
    for word in ("mean", "sd", "covariance", "robust_sd", "map_estimate"):
        value = getattr(result, word)
        if value is not None:
            yield word, value
    prediction = result.predict(OTHER)
    for word in ("response", "observable", "peaks"):
        yield f"predicted {word}", getattr(prediction, word)
    yield "verdict", np.frombuffer(str(result.verdict().converged).encode(), np.uint8)


def case_calibration() -> Results:
    result = si.calibrate(oscillator(), SPACE, measured(), true_runs=150, seed=1)
    yield "certified", result.certified
    yield "draws", result.draws
    yield "mean", result.mean
    yield "mean bound", result.certificate.mean_bound
    yield "sd bound", result.certificate.sd_bound


def case_certified_draws() -> Results:
    names, truth, sds = ("a", "b", "c"), np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.5, 0.2])
    box = {name: (-10.0, 10.0) for name in names}

    def normal(theta: np.ndarray) -> np.ndarray:
        return np.asarray((-0.5 * ((theta - truth) / sds) ** 2).sum(axis=1))

    target = si.LogDensity(normal, names, si.ParameterSpace(**{n: si.Uniform(*box[n]) for n in names}), box)
    draws = np.random.default_rng(1).normal(truth, sds, (4000, 3))
    for word, known in {"function": normal, "values": normal(draws), "nothing": None}.items():
        certificate = si.certify(target, draws, known, seed=1)
        yield f"{word}: mean bound", certificate.mean_bound
        yield f"{word}: sd bound", certificate.sd_bound
        yield f"{word}: draws", certificate.draws


def case_simulation_based_calibration() -> Results:
    explorer = si.SMC(particles=60, ensembles=1, steps=10, effective_share=0.5, correlation=0.3)
    found = si.sbc(posterior(), 20, seed=2, explorer=explorer)
    yield "ranks", found.ranks


# --- reliability ------------------------------------------------------------------------------------------------------


def case_reliability() -> Results:
    limit = float(np.median(np.abs(runs().histories().values).max(axis=(1, 2))))
    passages = si.passages(runs(), "velocity", limit)
    yield "times", passages.time
    yield "probability", si.passage_probability(passages, degrees=(1,)).probability(passages.design.values)
    design = SPACE.sample(80, seed=3)
    found = si.sensitivity(design, np.sin(design.values[:, 0] / 1e6) + design.values[:, 1])
    yield "Sobol' indices", np.array([found.first, found.total])


def case_fragility() -> Results:
    records = [si.GroundMotion.synthetic(seed=seed, duration=6.0) for seed in (3, 4)]
    draws = drawn().flat[:20]
    found = si.fragility(posterior(), draws, records, "displacement", 0.02, [1.0, 2.0, 4.0], seed=1)
    yield "probability", found.probability
    yield "error", found.error


# --- hybrid tests -----------------------------------------------------------------------------------------------------


def case_hybrid_test() -> Results:
    upper, lower = parts()
    sensors = si.Actuator(delay=0.017, force_sensor=si.Sensor(100.0), displacement_sensor=si.Sensor(5e-6))
    record = si.GroundMotion.synthetic(seed=1).trim(2.0, 2.5).scale_to_pga(3.0)
    for word, coupling, compensation in (
        ("PH", si.PrakashHjelmstad(10, "physical"), si.PolynomialExtrapolation(0.017)),
        ("GC", si.GravouilCombescure(10, "physical"), None),
        ("learning", si.PrakashHjelmstad(1000, "physical"), si.AdaptiveTimeSeries(0.017)),
        ("PH fine in the computer", si.PrakashHjelmstad(10, "numerical"), None),
    ):
        specimen = si.SimulatedSpecimen(lower.force, sensors, stiffness=lower.stiffness, seed=1)
        test = si.HybridTest(
            upper,
            specimen,
            record,
            dt=0.01,
            time_scale=100.0,
            coupling=coupling,
            compensation=compensation,
            physical=lower,
        )
        result = test.run()
        coarse = result.histories.coarse
        yield f"{word}: displacement", coarse.u
        yield f"{word}: traction", coarse.traction
        yield f"{word}: commands", result.moves.command
        yield f"{word}: force", result.moves.force
        yield f"{word}: observation", result.observation().values


def case_reduction() -> Results:
    rows = np.eye(8) - np.eye(8, k=1)
    stiffness = 4e6 * rows.T @ rows
    mass, damping = np.diag(900.0 * np.linspace(1.0, 1.6, 8)), 2e-4 * stiffness
    yield "Guyan", si.reduced_by_guyan(mass, damping, stiffness, [0, 3, 6], [0]).stiffness
    yield "Craig-Bampton", si.reduced_by_craig_bampton(mass, damping, stiffness, [0], 3).stiffness


def case_unscented_filter() -> Results:
    upper, lower = parts()
    model = si.BoucWen(mass=12e3, beta=63.0, gamma_ratio=0.5, damping_ratio=0.03, free=("stiffness", "alpha"))
    space = si.ParameterSpace(stiffness=si.Normal(7e6, 7e5, low=4e6, unit="N/m"), alpha=si.Uniform(0.01, 0.2))
    specimen = si.SimulatedSpecimen(lower.force, stiffness=lower.stiffness, seed=1)
    record = si.GroundMotion.synthetic(seed=1).trim(2.0, 3.5).scale_to_pga(3.0)
    online = si.UnscentedFilter(model, space, 200.0)
    test = si.HybridTest(upper, specimen, record, dt=0.01, time_scale=100.0, physical=lower, online=online)
    path = test.run().online
    yield "mean", path.mean
    yield "low", path.low


# --- the two commands -------------------------------------------------------------------------------------------------


def all_results() -> dict[str, np.ndarray]:
    """Every case, and what it takes."""
    found: dict[str, np.ndarray] = {}
    warnings.simplefilter("ignore")
    for name, case in list(globals().items()):
        if name.startswith("case_"):
            start = time.perf_counter()
            for word, values in case():
                found[f"{name.removeprefix('case_')}: {word}"] = np.asarray(values)
            print(f"{time.perf_counter() - start:6.1f} s  {name}", flush=True)
    return found


def differences(before: Any, after: Any) -> list[str]:
    """Results that are not the same to the last bit, in words."""
    lines = [f"{name}: only in one of the two" for name in sorted(set(before) ^ set(after))]
    for name in sorted(set(before) & set(after)):
        old, new = before[name], after[name]
        if old.dtype != new.dtype or old.shape != new.shape:
            lines.append(f"{name}: {old.dtype} {old.shape} before, {new.dtype} {new.shape} after")
        elif old.tobytes() != new.tobytes():
            size = np.abs(old).max() or 1.0
            lines.append(f"{name}: up to {np.nanmax(np.abs(old - new)) / size:.1e} of the largest value apart")
    return lines


def main(arguments: list[str]) -> int:
    match arguments:
        case ["write", path]:
            np.savez(path, **all_results())
            return 0
        case ["compare", before, after]:
            old, new = dict(np.load(before)), dict(np.load(after))
            lines = differences(old, new)
            print("\n".join(lines) or f"all {len(old)} arrays are the same to the last bit")
            return int(bool(lines))
    print(__doc__)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
