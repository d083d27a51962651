"""The ensemble against other people's answers on the study: emcee, the study's reference on El Centro, the source's own setting."""

import numpy as np
import pytest

import structid as si
from oscillators import DEGRADING
from structid.inference import convergence as diagnostics

pytestmark = pytest.mark.slow


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
        "stiffness": (5.351e6, 0.012e6),
        "beta": (64.95, 0.05),
        "gamma_ratio": (-0.682, 0.024),
        "alpha": (0.0253, 0.0029),
        "sigma2": (7.40e-5, 0.17e-5),
    }
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
