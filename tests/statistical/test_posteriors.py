"""The sampler against other people's answers: reference draws of posteriordb, emcee, and the study's reference on El Centro."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import structid as si
from conftest import DEGRADING
from structid.inference import diagnostics
from structid.inference.target import LogDensity
from structid.models.integrate import runge_kutta_4

pytestmark = pytest.mark.slow


# --- posteriordb ------------------------------------------------------------------------------------------------------


def load(folder):
    data = json.loads((folder / "data.json").read_text())
    with np.load(folder / "reference_draws.npz") as file:
        draws, names = file["draws"], [str(n) for n in file["params"]]
    return data, {name: draws[:, i] for i, name in enumerate(names)}


def eight_schools(data):
    """t_j ~ N(0, 1), μ ~ N(0, 5), τ ~ half-Cauchy(0, 5), y_j ~ N(μ + τ t_j, σ_j)."""
    y, sigma = jnp.array(data["y"]), jnp.array(data["sigma"])

    def density(x):
        t, mu, tau = x[:8], x[8], x[9]
        prior = -0.5 * (t**2).sum() - 0.5 * (mu / 5) ** 2 - jnp.log1p((tau / 5) ** 2)
        return prior - 0.5 * (((y - mu - tau * t) / sigma) ** 2).sum()

    names = [*(f"t{j}" for j in range(1, 9)), "mu", "tau"]
    start = lambda n, rng: np.column_stack([rng.standard_normal((n, 9)), rng.exponential(3.0, n) + 0.01])  # noqa: E731
    target = LogDensity(density, names, start, {"tau": (0.0, np.inf)}, backend="jax")

    def quantities(draws):
        found = {f"theta[{j}]": draws[..., 8] + draws[..., 9] * draws[..., j - 1] for j in range(1, 9)}
        return found | {"mu": draws[..., 8], "tau": draws[..., 9]}

    return target, quantities


def lotka_volterra(data):
    """u′ = (θ₁ − θ₂ v) u, v′ = (−θ₃ + θ₄ u) v, yearly, lognormal errors."""
    years, first = jnp.array(data["y"]), jnp.array(data["y_init"])
    steps = 40

    def density(x):
        theta, z, sigma = x[:4], x[4:6], x[6:8]

        def rate(s, _):
            return jnp.array([(theta[0] - theta[1] * s[1]) * s[0], (-theta[2] + theta[3] * s[0]) * s[1]])

        def year(s, _):
            s = jax.lax.fori_loop(0, steps, lambda _, y: runge_kutta_4(rate, y, (0.0, 0.0, 0.0), 1.0 / steps), s)
            return s, s

        _, path = jax.lax.scan(year, z, None, length=len(data["y"]))
        prior = -0.5 * (((theta - jnp.array([1, 0.05, 1, 0.05])) / jnp.array([0.5, 0.05, 0.5, 0.05])) ** 2).sum()
        prior = prior - (0.5 * (jnp.log(sigma) + 1.0) ** 2 + jnp.log(sigma)).sum()
        prior = prior - (0.5 * (jnp.log(z) - jnp.log(10.0)) ** 2 + jnp.log(z)).sum()
        errors = jnp.concatenate([jnp.log(first)[None] - jnp.log(z)[None], jnp.log(years) - jnp.log(path)])
        return prior - (0.5 * (errors / sigma) ** 2 + jnp.log(sigma)).sum()

    names = ["theta1", "theta2", "theta3", "theta4", "z1", "z2", "sigma1", "sigma2"]
    centre = np.array([0.6, 0.03, 0.8, 0.025, 30.0, 5.0, 0.3, 0.3])
    start = lambda n, rng: centre * np.exp(0.1 * rng.standard_normal((n, 8)))  # noqa: E731
    target = LogDensity(density, names, start, {n: (0.0, np.inf) for n in names}, backend="jax")
    reference = [*(f"theta[{i}]" for i in range(1, 5)), "z_init[1]", "z_init[2]", "sigma[1]", "sigma[2]"]
    return target, lambda draws: {n: draws[..., i] for i, n in enumerate(reference)}


@pytest.mark.parametrize(
    ("folder", "make"),
    [("eight_schools-eight_schools_noncentered", eight_schools), ("hudson_lynx_hare-lotka_volterra", lotka_volterra)],
)
def test_reference_draws_of_posteriordb(shared_data, folder, make, capsys):
    """Means and sds within four combined Monte-Carlo standard errors, theirs and ours."""
    data, reference = load(shared_data / "posteriordb" / folder)
    target, quantities = make(data)
    settings = si.AIES(walkers=60, steps=12_000, ensembles=4, differential_evolution=0.6, discard=0.25)
    found = quantities(si.sample(target, settings, seed=1).kept)
    worst = {}
    for name, theirs in reference.items():
        ours = found[name]
        centre = theirs.mean()
        for moment, a, b in (("mean", ours, theirs), ("sd", (ours - centre) ** 2, (theirs - centre) ** 2)):
            error = np.hypot(a.std() / np.sqrt(diagnostics.effective_sample_size(a)), b.std() / np.sqrt(b.size))
            worst[name, moment] = (a.mean() - b.mean()) / error
    with capsys.disabled():
        print(f"\n{folder}: largest deviation {max(map(abs, worst.values())):.2f} combined standard errors")
    assert max(map(abs, worst.values())) < 4.0, worst


# --- the study --------------------------------------------------------------------------------------------------------


def study(record, space, noise=0.0):
    velocity = si.BoucWen(**DEGRADING, substeps=1).simulate(np.zeros((1, 0)), record).channel("velocity")[0]
    velocity = velocity + noise * np.sqrt(np.mean(velocity**2)) * np.random.default_rng(5).standard_normal(
        velocity.size
    )
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=space.names, substeps=1)
    return si.Posterior(space, model, si.Observation(record, velocity))


CONVERGING = dict(walkers=32, ensembles=4, differential_evolution=0.8, start_candidates=10, settling_steps=500)


def test_reference_posterior_of_el_centro(strong_motion, study_space, capsys):
    """§2's reference: order-4 filter at 20 Hz, first 40 s, 1.8 m/s², noise-free, one substep; within 0.25 sd, and converged."""
    record = si.GroundMotion.read(strong_motion / "RSN6_IMPVALL.I_I-ELC180.AT2").lowpass(20.0, order=4)
    posterior = study(record.trim(0.0, 40.0).scale_to_pga(1.8), study_space)
    result = si.sample(posterior, si.AIES(**CONVERGING, steps=4000, discard=0.25), seed=2)
    assert result.verdict().converged, str(result.verdict())
    expected = {
        "stiffness": (5.351e6, 0.012e6), "beta": (64.95, 0.05), "gamma_ratio": (-0.682, 0.024), "alpha": (0.0253, 0.0029),
        "sigma2": (7.40e-5, 0.17e-5),
    }  # fmt: skip
    for i, name in enumerate(posterior.names):
        mean, sd = expected[name]
        with capsys.disabled():
            print(f"\n{name}: {result.mean[i]:.6g} ± {result.sd[i]:.2g}, reference {mean:g} ± {sd:g}", end="")
        assert abs(result.mean[i] - mean) < 0.25 * sd
        assert result.sd[i] == pytest.approx(sd, rel=0.15)


def test_same_posterior_as_emcee(record, study_space, capsys):
    """Difference of the means below three combined standard errors, on the study with its 2 % noise."""
    import emcee

    posterior = study(record, study_space, noise=0.02)
    result = si.sample(posterior, si.AIES(**CONVERGING, steps=3000, discard=0.3), seed=3)
    assert result.verdict().converged, str(result.verdict())
    walkers, steps, burn = 64, 6000, 2000
    start = posterior.bijection.inverse(result.thinned(walkers))[:walkers]
    sampler = emcee.EnsembleSampler(
        len(start) - len(start) % 2, posterior.dimension, lambda p: posterior.evaluate(p)[0], vectorize=True
    )
    sampler.random_state = np.random.RandomState(4).get_state()
    sampler.run_mcmc(start[: sampler.nwalkers], steps)
    chain = sampler.get_chain()[burn:]
    theirs = posterior.bijection(chain.reshape(-1, posterior.dimension))[0].reshape(chain.shape)
    taus = emcee.autocorr.integrated_time(theirs, tol=0, quiet=True)
    for i, name in enumerate(posterior.names):
        ours = result.kept[..., i]
        error = np.hypot(
            ours.std() / np.sqrt(diagnostics.effective_sample_size(ours)),
            theirs[..., i].std() / np.sqrt(theirs[..., i].size / taus[i]),
        )
        deviation = (ours.mean() - theirs[..., i].mean()) / error
        with capsys.disabled():
            print(f"\n{name}: {deviation:+.2f} combined standard errors from emcee (its τ {taus[i]:.0f})", end="")
        assert abs(deviation) < 3.0


def test_the_sources_setting_has_not_converged(record, study_space):
    """100 walkers × 700 plain stretch moves, whatever the source concluded from its trace plots."""
    verdict = si.sample(
        study(record, study_space, 0.02), si.AIES(walkers=100, steps=700, ensembles=2), seed=1
    ).verdict()
    assert not verdict.converged
    assert "autocorrelation times" in str(verdict) or "R-hat" in str(verdict)
