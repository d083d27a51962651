"""Agreement and speed of the samplers and of other programs, and savings of exact sampling with a surrogate.

Run with ``python benchmarks/samplers.py [--quick]``. posteriordb is read from ``../shared/data``.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import calibration as study
import common
import emcee
import jax
import numpy as np
import posteriordb
from numpyro.infer import MCMC
from numpyro.infer.ensemble import AIES as NumPyroAIES

import structid as si
from structid.inference import convergence as diagnostics
from structid.inference.target import Target

NAME = "samplers"
POSTERIORDB = common.ROOT.parent / "shared" / "data" / "posteriordb"
PGA = 1.8
WALKERS = 128
ENSEMBLE = si.AIES(
    walkers=32,
    steps=3000,
    ensembles=4,
    differential_evolution=0.8,
    discard=0.3,
    start_candidates=10,
    settling_steps=500,
)
"""Settings of a study: 128 walkers in total."""
SHORT_STAGES = {"effective_share": 0.5, "correlation": 0.3}
"""Settings for short tempering steps."""
ON_THE_MODEL: dict[str, Any] = {
    "structid AIES": ENSEMBLE,
    "structid SMC": si.SMC(particles=500, steps=50, **SHORT_STAGES),
}
"""Samplers for the model itself, with 4001 time steps per evaluation; NUTS, which needs their gradients, exceeds ten minutes."""
SAMPLERS: dict[str, Any] = {
    "structid AIES": ENSEMBLE,
    "structid SMC": si.SMC(),
    "structid NUTS": si.NUTS(),
}
QUICK_ENSEMBLE = replace(ENSEMBLE, steps=400, settling_steps=100)
QUICK_SAMPLERS: dict[str, Any] = {
    "structid AIES": QUICK_ENSEMBLE,
    "structid SMC": si.SMC(particles=250, steps=20, **SHORT_STAGES),
}
"""Samplers of a quick run, without NUTS, whose gradients take half a minute to compile."""


def smallest_size(draws: np.ndarray) -> float:
    """Smallest bulk effective size over the parameters of draws (step, ensemble, walker, parameter)."""
    return min(diagnostics.bulk_and_tail_size(draws[..., i])[0] for i in range(draws.shape[-1]))


# --- samplers and other programs --------------------------------------------------------------------------------


def by_emcee(target: Target, start: np.ndarray, steps: int) -> np.ndarray:
    """Emcee with the same mixture of moves, vectorised over the walkers."""
    moves = [(emcee.moves.StretchMove(), 0.2), (emcee.moves.DEMove(), 0.72), (emcee.moves.DEMove(gamma0=1.0), 0.08)]
    sampler = emcee.EnsembleSampler(
        len(start), start.shape[1], lambda phi: target.evaluate(phi)[0], moves=moves, vectorize=True
    )
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(start, steps)
    return sampler.get_chain()[int(0.3 * steps) :]


def by_numpyro(target: Target, start: np.ndarray, steps: int) -> np.ndarray:
    """NumPyro's AIES with its differential-evolution and stretch moves."""
    function, data = target.traceable()
    kernel = NumPyroAIES(
        potential_fn=lambda phi: -function(phi[None], data)[0],
        moves={NumPyroAIES.DEMove(): 0.8, NumPyroAIES.StretchMove(): 0.2},
    )
    chains = MCMC(
        kernel,
        num_warmup=int(0.3 * steps),
        num_samples=steps - int(0.3 * steps),
        num_chains=len(start),
        chain_method="vectorized",
        progress_bar=False,
    )
    chains.run(jax.random.PRNGKey(1), init_params=jax.numpy.asarray(start))
    return np.asarray(chains.get_samples(group_by_chain=True)).swapaxes(0, 1)


def timed(draw: Callable[[], np.ndarray], twice: bool) -> tuple[np.ndarray, float]:
    """Return draws and seconds of a call; with `twice`, of a second call, since the first one compiles."""
    if twice:
        draw()
    began = time.perf_counter()
    draws = draw()
    return draws, time.perf_counter() - began


def sampler_rows(
    label: str,
    target: Target,
    quick: bool,
    deviation: Callable[[np.ndarray], float],
    samplers: dict[str, Any],
    alone: bool = False,
) -> list[list[str]]:
    """Run every sampler on one target, `alone` without other programs; `deviation` compares draws with a reference."""
    start = si.sample(target, si.SMC(particles=WALKERS, ensembles=1, steps=20), seed=5).history[-1, 0]
    phi = target.bijection.inverse(start)
    steps = 400 if quick else ENSEMBLE.steps

    def ours(settings: Any) -> Callable[[], np.ndarray]:
        return lambda: si.sample(target, settings, seed=1).kept

    def theirs(draw: Callable[..., np.ndarray]) -> Callable[[], np.ndarray]:
        def drawn() -> np.ndarray:
            found = draw(target, phi, steps)
            return target.bijection(found.reshape(-1, found.shape[-1]))[0].reshape(found.shape)[:, None]

        return drawn

    calls = {n: ours(s) for n, s in samplers.items()}
    if not alone:
        calls |= {"emcee": theirs(by_emcee), "NumPyro AIES": theirs(by_numpyro)}
    rows = []
    for name, call in calls.items():
        draws, seconds = timed(call, twice=not (alone or quick))
        size = smallest_size(draws)
        hats = [diagnostics.r_hat(draws[..., i]) for i in range(draws.shape[-1])]
        hat = "–" if draws.shape[1] < 2 else f"{max(hats):.3f}"
        rows.append(
            [label, name, f"{seconds:.1f}", f"{size:.0f}", f"{size / seconds:.0f}", hat, f"{deviation(draws):.1f}"]
        )
        print(" | ".join(rows[-1]), flush=True)
    return rows


def from_reference(reference: Any) -> Callable[[np.ndarray], float]:
    """Largest deviation of means and second moments from another sampler's draws, in combined standard errors."""
    theirs = reference.kept
    names = {str(i): theirs[..., i] for i in range(theirs.shape[-1])}

    def deviation(draws: np.ndarray) -> float:
        worst = 0.0
        for key, b in names.items():
            a, centre = draws[..., int(key)], b.mean()
            for x, y in ((a, b), ((a - centre) ** 2, (b - centre) ** 2)):
                error = np.hypot(*(s.std() / np.sqrt(diagnostics.effective_sample_size(s)) for s in (x, y)))
                worst = max(worst, abs(x.mean() - y.mean()) / error)
        return worst

    return deviation


def agreement(quick: bool, posterior: si.Posterior, surrogate: Any) -> list[list[str]]:
    under, samplers = posterior.on(surrogate), QUICK_SAMPLERS if quick else SAMPLERS
    longer = (
        si.SMC(particles=250, steps=20, **SHORT_STAGES) if quick else si.SMC(particles=2000, steps=100, **SHORT_STAGES)
    )
    rows = sampler_rows("study, surrogate", under, quick, from_reference(si.sample(under, longer, seed=77)), samplers)
    if not quick:
        reference = si.sample(posterior, si.SMC(particles=1000, steps=100, **SHORT_STAGES), seed=78)
        rows += sampler_rows(
            "study, the model itself", posterior, quick, from_reference(reference), ON_THE_MODEL, alone=True
        )
    for folder, make in list(posteriordb.POSTERIORS.items())[: 1 if quick else None]:
        if not (POSTERIORDB / folder).is_dir():
            continue
        data, reference = posteriordb.load(POSTERIORDB / folder)
        target, quantities = make(data)

        def deviation(draws: np.ndarray, reference: Any = reference, quantities: Any = quantities) -> float:
            return max(map(abs, posteriordb.deviations(draws, reference, quantities).values()))

        rows += sampler_rows(folder.partition("-")[0], target, quick, deviation, samplers)
    return rows


# --- delayed acceptance -----------------------------------------------------------------------------------------


class Counted(si.Posterior):
    """Posterior that counts the model runs of tempered particles."""

    asked = 0

    def evaluate_parts(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Count, and evaluate."""
        self.asked += len(phi)
        return super().evaluate_parts(phi)


def exact_rows(quick: bool, posterior: si.Posterior, calibrated: Any) -> list[list[str]]:
    """Model runs per effective draw, without a surrogate and with accurate and inaccurate surrogates."""
    particles, steps = (250, 20) if quick else (1000, 60)
    reference = si.sample(posterior, si.SMC(particles=particles, steps=steps, **SHORT_STAGES), seed=99)
    counted = Counted(posterior.model_space, posterior.model, posterior.observations)
    few = si.sample(counted, si.SMC(particles=250, steps=20, **SHORT_STAGES), seed=98)
    few_size = smallest_size(few.kept)
    plain = si.sample(posterior, QUICK_ENSEMBLE if quick else ENSEMBLE, seed=2)
    runs = plain.history.shape[0] * WALKERS
    plain_size = smallest_size(plain.kept)
    rows = [
        [
            "AIES on the model itself",
            f"{runs:,}",
            f"{plain_size:.0f}",
            f"{runs / plain_size:.1f}",
            "1",
            "–",
            "–",
            f"{from_reference(reference)(plain.kept):.1f}",
        ],
        [
            "tempered SMC on the model itself",
            f"{counted.asked:,}",
            f"{few_size:.0f}",
            f"{counted.asked / few_size:.1f}",
            f"{(runs / plain_size) / (counted.asked / few_size):.0f}",
            "–",
            "–",
            f"{from_reference(reference)(few.kept):.1f}",
        ],
    ]
    for row in rows:
        print(" | ".join(row), flush=True)
    design = posterior.model_space.sample(200, seed=3, method="sobol", widen=2.0)
    record = posterior.observations[0].record
    everywhere = si.Campaign(posterior.model, record, design).run()
    # The number of effective draws is uncertain by 10 to 20 %, hence several seeds.
    calibrated_ones = {
        f"surrogate of a calibration ({calibrated.training_runs} runs), seed {seed}": (
            calibrated.surrogate,
            calibrated.training_runs,
            seed,
        )
        for seed in ((3,) if quick else (3, 4, 5))
    }
    surrogates = calibrated_ones | {
        "surrogate of 200 runs over the prior": (si.PODKriging().fit(everywhere), 200, 3),
        "inaccurate surrogate of 100 runs": (si.PODKriging().fit(everywhere[:100]), 100, 3),
    }
    for label, (surrogate, training, seed) in surrogates.items():
        # As many effective draws as the plain ensemble gives, or twice as many, for an accurate count.
        steps = 30 if quick else 1500 if "inaccurate" in label else 200
        result = si.sample(
            posterior, si.DelayedAcceptance(surrogate, steps=steps, discard=max(0.1, 10 / steps)), seed=seed
        )
        assert result.cost is not None
        size, spent = smallest_size(result.kept), result.cost.true_runs + training
        rows.append(
            [
                f"delayed acceptance, {label}",
                f"{spent:,}",
                f"{size:.0f}",
                f"{spent / size:.1f}",
                f"{(runs / plain_size) / (spent / size):.0f}",
                f"{result.cost.acceptance:.0%}",
                f"{result.cost.sub_steps}",
                f"{from_reference(reference)(result.kept):.1f}",
            ]
        )
        print(" | ".join(rows[-1]), flush=True)
    return rows


# --- evidence ---------------------------------------------------------------------------------------------------


def evidence_rows(quick: bool) -> list[list[str]]:
    """Log evidence of a degrading and a non-degrading model class on data of each class, and their difference."""
    model, space = study.model_and_space()
    wide = space.extended(delta_nu=si.Uniform(0.0, 10.0), delta_eta=si.Uniform(0.0, 20.0))
    degrading = si.BoucWen(mass=common.MASS, damping_ratio=common.DAMPING_RATIO, free=wide.names)
    record = study.stochastic(PGA)
    truths = {
        "degrading": common.degrading_oscillator(),
        "not degrading": common.degrading_oscillator(delta_nu=0.0, delta_eta=0.0),
    }
    settings = si.SMC(particles=100 if quick else 500, steps=20, **SHORT_STAGES)
    rows = []
    for label, truth in list(truths.items())[: 1 if quick else None]:
        clean = truth.simulate(np.zeros((1, 0)), record).values[0, :, 0]
        noise = 0.02 * np.sqrt(np.mean(clean**2)) * np.random.default_rng(1).normal(size=clean.shape)
        observation = si.Observation(record, clean + noise)
        found = [
            si.sample(si.Posterior(s, m, observation), settings, seed=4).log_evidence
            for m, s in ((degrading, wide), (model, space))
        ]
        gap, error = found[0].value - found[1].value, float(np.hypot(found[0].error, found[1].error))
        limit = "above 100" if label == "degrading" else f"below its error, {error:.2f}"
        rows.append([label, *(f"{e.value:.2f} ± {e.error:.2f}" for e in found), f"{gap:.2f} ± {error:.2f}", limit])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    model, space = study.model_and_space()
    posterior = si.Posterior(space, model, study.measured(study.stochastic(PGA)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # points outside a surrogate's range
        calibrated = si.calibrate(model, space, posterior.observations, seed=1)
        evidence = evidence_rows(quick)
        exact = exact_rows(quick, posterior, calibrated)
        speed = agreement(quick, posterior, calibrated.surrogate)
    write(quick, speed, exact, evidence)


def write(quick: bool, speed: list[list[str]], exact: list[list[str]], evidence: list[list[str]]) -> None:
    """Write the page, and store its rows."""
    speed_heads = [
        "posterior",
        "sampler",
        "seconds",
        "effective draws",
        "effective draws per second",
        "R-hat",
        "deviation from the reference",
    ]
    exact_heads = [
        "method",
        "model runs",
        "effective draws",
        "model runs per effective draw",
        "times fewer",
        "acceptance",
        "length of sub-chains",
        "deviation from the reference",
    ]
    evidence_heads = ["true oscillator", "log Z, degrading model", "log Z, non-degrading model", "difference", "limit"]
    text = f"""# Samplers, exact sampling, evidence

`benchmarks/samplers.py`. {common.machine("emcee", "numpyro", "blackjax")}.

**Samplers**: the number of effective draws is the smallest bulk effective sample size of all parameters, by the same estimator for
all programs. Seconds include start and warm-up, and are for a second call, after compilation. On the model itself, they are for a
single call with fewer draws. emcee and NumPyro start from posterior draws, structid from the prior. The last column is the largest
deviation of a mean or second moment from reference draws, in combined Monte Carlo standard errors; about 3 is expected for the
largest of ten. References are posteriordb's draws, and tempered SMC with 8000 particles for the study (4000 for the model itself).

{common.markdown_table(speed_heads, speed)}

**Delayed acceptance** on the study `bouc_wen` (stochastic record), compared with an ensemble and tempered SMC on the model itself.
Model runs include tempering steps and the surrogate's training runs. The limit is 20 times fewer runs per effective draw than the
ensemble.

{common.markdown_table(exact_heads, exact)}

**Evidence** by tempered SMC on the study, for models with degradation (priors U(0, 10) and U(0, 20) kg/J) and without.

{common.markdown_table(evidence_heads, evidence)}
"""
    values = {"speed": speed, "exact": exact, "evidence": evidence}
    common.record_result(NAME, quick=quick, machine=common.machine(), **values)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
