"""Tempered sequential Monte Carlo: evidence in closed form, moments, failures, and the same numbers after a kill."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.special
import scipy.stats

import structid as si
from structid.core.errors import InputError
from structid.inference.sampling.base import Evidence
from structid.inference.sampling.smc.bridge_sampling import bennett_ratio
from structid.inference.sampling.smc.tempering import next_exponent

SMALL = si.SMC(particles=200, ensembles=4, steps=20, effective_share=0.5, correlation=0.5)


class LinearGaussian:
    """y = Aθ + ε with normal priors: posterior and evidence are known."""

    def __init__(self, seed, dimension=3, samples=40, noise=0.3):
        rng = np.random.default_rng(seed)
        self.matrix = rng.normal(size=(samples, dimension))
        self.y = self.matrix @ rng.normal(size=dimension) + noise * rng.normal(size=samples)
        self.noise, self.dimension = noise, dimension
        names = [f"a{i}" for i in range(dimension)]
        self.space = si.ParameterSpace(**{n: si.Normal(0.0, 2.0) for n in names})
        self.target = si.LogDensity(self._density, names, self.space)

    def _density(self, theta):
        residual = self.y - theta @ self.matrix.T
        likelihood = scipy.stats.norm.logpdf(residual, scale=self.noise).sum(axis=1)
        return likelihood + self.space.log_density(theta)

    @property
    def log_evidence(self):
        covariance = self.noise**2 * np.eye(len(self.y)) + 4.0 * self.matrix @ self.matrix.T
        return scipy.stats.multivariate_normal(np.zeros(len(self.y)), covariance).logpdf(self.y)

    @property
    def posterior(self):
        precision = self.matrix.T @ self.matrix / self.noise**2 + np.eye(self.dimension) / 4.0
        covariance = np.linalg.inv(precision)
        return covariance @ self.matrix.T @ self.y / self.noise**2, np.sqrt(np.diag(covariance))


class NormalGamma:
    """y ~ N(m + z / √(κ τ), 1 / τ) with z ~ N(0, 1) and τ ~ Gamma(a, b): mean and precision of a sample, both unknown.

    κₙ = κ + n, aₙ = a + n/2, bₙ = b + Σ(y − ȳ)²/2 + κ n (ȳ − m)² / (2 κₙ), and
    log Z = log Γ(aₙ) − log Γ(a) + a log b − aₙ log bₙ + ½ log(κ / κₙ) − ½ n log 2π.
    """

    m, kappa, a, b = 1.0, 0.5, 3.0, 2.0

    def __init__(self, seed, samples=25):
        rng = np.random.default_rng(seed)
        self.y = 2.0 + 0.7 * rng.normal(size=samples)
        self.space = si.ParameterSpace(z=si.Normal(0.0, 1.0), precision=si.Gamma(shape=self.a, rate=self.b))
        self.target = si.LogDensity(self._density, self.space.names, self.space, {"precision": (0.0, np.inf)})

    def _density(self, theta):
        z, precision = theta[:, :1], theta[:, 1:]
        mean = self.m + z / np.sqrt(self.kappa * precision)
        likelihood = scipy.stats.norm.logpdf(self.y, mean, 1.0 / np.sqrt(precision)).sum(axis=1)
        return likelihood + self.space.log_density(theta)

    @property
    def updated(self):
        n, mean = len(self.y), self.y.mean()
        kappa, a = self.kappa + n, self.a + n / 2
        b = self.b + 0.5 * np.sum((self.y - mean) ** 2) + self.kappa * n * (mean - self.m) ** 2 / (2 * kappa)
        return kappa, a, b

    @property
    def log_evidence(self):
        kappa, a, b = self.updated
        gammas = scipy.special.gammaln(a) - scipy.special.gammaln(self.a)
        scales = self.a * np.log(self.b) - a * np.log(b)
        return gammas + scales + 0.5 * np.log(self.kappa / kappa) - 0.5 * len(self.y) * np.log(2 * np.pi)


@pytest.mark.parametrize("problem", [LinearGaussian, NormalGamma])
def test_the_closed_form_is_the_integral_of_the_density(problem):
    """Over a grid, in two dimensions."""
    case = LinearGaussian(2, dimension=2) if problem is LinearGaussian else NormalGamma(2)
    values = si.sample(case.target, SMALL, seed=1).flat
    middle, spread = values.mean(axis=0), values.std(axis=0)
    axes = [np.linspace(m - 8 * s, m + 8 * s, 400) for m, s in zip(middle, spread, strict=True)]
    axes[1] = axes[1][axes[1] > 0] if problem is NormalGamma else axes[1]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    density = np.concatenate([case.target.log_density(row) for row in grid])
    cell = np.prod([np.diff(axis)[0] for axis in axes])
    assert scipy.special.logsumexp(density) + np.log(cell) == pytest.approx(case.log_evidence, abs=1e-3)


def test_evidence_and_moments_of_a_conjugate_model():
    problem = NormalGamma(1)
    result = si.sample(problem.target, si.SMC(steps=40), seed=1)
    evidence = result.log_evidence
    assert abs(evidence.value - problem.log_evidence) < min(0.1, 4.0 * evidence.error + 0.02), str(evidence)
    _, a, b = problem.updated
    precision = result.flat[:, 1]
    error = np.sqrt(a) / b / np.sqrt(result.summary().columns["ess_bulk"][1])
    assert abs(precision.mean() - a / b) < 4.0 * error
    assert precision.std() == pytest.approx(np.sqrt(a) / b, rel=0.07)


def test_evidence_and_moments_of_a_linear_gaussian_model():
    problem = LinearGaussian(1)
    result = si.sample(problem.target, si.SMC(steps=40), seed=1)
    evidence = result.log_evidence
    assert abs(evidence.value - problem.log_evidence) < min(0.1, 4.0 * evidence.error + 0.02), str(evidence)
    mean, sd = problem.posterior
    np.testing.assert_allclose(result.mean, mean, atol=0.1 * sd.min())
    np.testing.assert_allclose(result.sd, sd, rtol=0.07)
    assert result.verdict().converged, str(result.verdict())


@pytest.mark.slow
@pytest.mark.parametrize("problem", [LinearGaussian, NormalGamma])
def test_evidence_and_its_error_over_twenty_seeds(problem):
    errors, scores = [], []
    for seed in range(20):
        case = problem(seed)
        evidence = si.sample(case.target, si.SMC(steps=1), seed=100 + seed).log_evidence
        errors.append(evidence.value - case.log_evidence)
        scores.append(errors[-1] / evidence.error)
    print(f"errors of log Z: {np.round(errors, 3)}, in reported errors {np.round(scores, 1)}")
    assert np.abs(errors).max() <= 0.1 and np.abs(scores).max() <= 3.0
    # Reported errors are neither far too small nor far too large.
    assert 0.4 < np.std(scores) < 1.8


class PowerLaw:
    """L = (1 + |θ − m|² / s²)^−a in a wide box: at some β its peak takes over from the slope, at every scale of it at once.

    log Z = (d/2) log π + log Γ(a − d/2) − log Γ(a) + d log(s / w), but for what lies beyond the box, of width w: nothing.
    """

    s, a, dimension = 0.01, 500.0, 5

    def __init__(self):
        names = [f"a{i}" for i in range(self.dimension)]
        self.space = si.ParameterSpace(**{n: si.Uniform(-1.0, 1.0) for n in names})
        self.target = si.LogDensity(self._density, names, self.space, dict.fromkeys(names, (-1.0, 1.0)))

    def _density(self, theta):
        return -self.a * np.log1p(((theta - 0.3) ** 2).sum(axis=1) / self.s**2) + self.space.log_density(theta)

    @property
    def log_evidence(self):
        gammas = scipy.special.gammaln(self.a - self.dimension / 2) - scipy.special.gammaln(self.a)
        return gammas + self.dimension * (0.5 * np.log(np.pi) + np.log(self.s / 2.0))


def test_evidence_where_a_peak_takes_over():
    problem = PowerLaw()
    evidence = si.sample(problem.target, replace(SMALL, particles=400, correlation=0.3, steps=1), seed=2).log_evidence
    assert abs(evidence.value - problem.log_evidence) < min(0.5, 4.0 * evidence.error), str(evidence)


def test_particles_that_lag_behind_say_so(monkeypatch):
    """Independence moves by the law of all particles alone do not reach the peak that takes over: populations are wrong alike."""
    monkeypatch.setattr("structid.inference.sampling.moves.LAYERS", ((1.0, 1.0),))
    problem = PowerLaw()
    evidence = si.sample(problem.target, replace(SMALL, particles=400, correlation=0.3, steps=1), seed=2).log_evidence
    error = evidence.value - problem.log_evidence
    assert error < -1.0 and error < -3.0 * evidence.each.std(ddof=1) / np.sqrt(len(evidence.each))
    assert abs(error) < 3.0 * evidence.error, str(evidence)


def test_two_modes_keep_their_weights():
    """A narrow mode with two thirds of the mass and a wide one: a plain ensemble started in one would never know."""
    space = si.ParameterSpace(a=si.Uniform(-10.0, 10.0), b=si.Uniform(-10.0, 10.0))

    def density(theta):
        narrow = np.log(2 / 3) + scipy.stats.norm.logpdf(theta, 5.0, 0.1).sum(axis=1)
        wide = np.log(1 / 3) + scipy.stats.norm.logpdf(theta, -4.0, 0.5).sum(axis=1)
        return np.logaddexp(narrow, wide)

    result = si.sample(
        si.LogDensity(density, space.names, space, {n: (-10.0, 10.0) for n in space.names}),
        si.SMC(steps=5),
        seed=3,
    )
    share = (result.flat[:, 0] > 0).mean()
    assert abs(share - 2 / 3) < 0.06
    # The density integrates to one over the box.
    assert abs(result.log_evidence.value) < 4 * result.log_evidence.error + 0.03


def test_a_likelihood_that_half_the_prior_does_not_have():
    space = si.ParameterSpace(a=si.Uniform(-1.0, 1.0))

    def density(theta):
        inside = theta[:, 0] > 0
        return np.where(inside, scipy.stats.norm.logpdf(theta[:, 0], 0.5, 0.1) - np.log(2.0), -np.inf)

    result = si.sample(si.LogDensity(density, ("a",), space, {"a": (-1.0, 1.0)}), SMALL, seed=4)
    assert abs(result.log_evidence.value - np.log(0.5)) < 0.1
    assert result.flat.min() > 0


def test_the_exponent_leaves_the_asked_for_share():
    likelihood = -0.5 * np.random.default_rng(5).chisquare(3, size=(4, 1000)) * 100.0
    beta = next_exponent(likelihood, 0.0, 0.5)
    weights = np.exp(beta * (likelihood - likelihood.max()))
    sizes = weights.sum(axis=1) ** 2 / (weights**2).sum(axis=1)
    assert sizes.mean() == pytest.approx(500, rel=1e-3)
    assert next_exponent(likelihood * 1e-4, 0.0, 0.5) == 1.0


def test_a_killed_run_goes_on_to_the_same_bits(tmp_path):
    problem = LinearGaussian(2)
    whole = si.sample(problem.target, SMALL, seed=7, store=tmp_path / "whole.h5")

    class Killed(Exception):
        pass

    stages = []

    def stop(done, total):
        stages.append(done)
        if len(stages) == 4:
            raise Killed

    with pytest.raises(Killed):
        si.sample(problem.target, SMALL, seed=7, store=tmp_path / "cut.h5", progress=stop)
    again = si.sample(problem.target, SMALL, seed=7, store=tmp_path / "cut.h5")
    np.testing.assert_array_equal(again.history, whole.history)
    assert again.log_evidence.value == whole.log_evidence.value
    # More steps go on from the stored ones, a block that was cut off included.
    longer = si.sample(problem.target, replace(SMALL, steps=70), seed=7, store=tmp_path / "cut.h5")
    np.testing.assert_array_equal(longer.history[:20], whole.history)
    np.testing.assert_array_equal(longer.history, si.sample(problem.target, replace(SMALL, steps=70), seed=7).history)


@pytest.mark.slow
def test_on_a_posterior_it_agrees_with_the_ensemble():
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(2.0)
    space = si.ParameterSpace(
        stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
    )
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=space.names)
    rng = np.random.default_rng(1)
    y = model.simulate(np.array([[7.2e6, 0.4]]), record).values[0, :, 0]
    posterior = si.Posterior(space, model, si.Observation(record, y + 0.3 * y.std() * rng.normal(size=y.shape)))
    tempered = si.sample(posterior, SMALL, seed=1)
    ensemble = si.sample(posterior, si.AIES(walkers=60, steps=1200, start_candidates=10, settling_steps=300), seed=2)
    assert (np.abs(tempered.mean - ensemble.mean) < 0.1 * ensemble.sd).all()
    np.testing.assert_allclose(tempered.sd, ensemble.sd, rtol=0.12)
    tree = tempered.to_datatree(predictions=False)
    assert tree.attrs["log_evidence"] == tempered.log_evidence.value


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(particles=5), "even number"),
        (dict(particles=2), "4 or more"),
        (dict(effective_share=1.0), "between 0 and 1"),
        (dict(steps=0), "1 or more"),
        (dict(independent=1.5), "from 0 to 1"),
    ],
)
def test_settings_that_make_no_sense(settings, words):
    with pytest.raises(InputError, match=words):
        si.SMC(**settings)


def test_what_it_does_not_take():
    problem = LinearGaussian(3)
    with pytest.raises(InputError, match="start from the prior"):
        si.sample(problem.target, SMALL, start=np.zeros((20, 3)))
    bare = si.LogDensity(lambda t: -0.5 * (t**2).sum(axis=1), ("a",), lambda n, rng: rng.normal(size=(n, 1)))
    with pytest.raises(InputError, match="without a separate prior"):
        si.sample(bare, SMALL)


def test_evidence_of_populations():
    found = Evidence.of_populations(np.log([1.0, 3.0]), np.zeros(2), np.zeros(2))
    assert found.value == pytest.approx(np.log(2.0)) and found.error == pytest.approx(np.log(3.0) / 2)
    assert Evidence.of_populations(np.zeros(4), np.full(4, 0.04), np.zeros(4)).error == pytest.approx(0.1)
    # What all of them lack alike is not averaged away.
    lagging = Evidence.of_populations(np.zeros(4), np.zeros(4), np.array([0.3, 0.5, 0.3, 0.5]))
    assert lagging.error == pytest.approx(np.sqrt(0.4**2 + 0.2**2 / 3 / 4))


@pytest.mark.parametrize("least", [-1e30, -1e200, -1e308])
@pytest.mark.parametrize("seed", range(2))
def test_log_likelihoods_far_below_all_others_disturb_nothing(least, seed):
    """A model that is hopeless in half of the prior, as a cyclic test has it: log Z is that of the other half."""
    space = si.ParameterSpace(x=si.Uniform(-5.0, 5.0))

    def log_density(x):
        return space.log_density(x) + np.where(x[:, 0] < 0.0, least, -0.5 * ((x[:, 0] - 1.0) / 0.1) ** 2)

    target = si.LogDensity(log_density, ("x",), space, {"x": (-5.0, 5.0)})
    result = si.sample(target, si.SMC(particles=200, steps=10), seed=seed)
    exact = np.log(0.1 * np.sqrt(2.0 * np.pi) / 10.0)
    assert abs(result.log_evidence.value - exact) < max(4.0 * result.log_evidence.error, 0.1)
    assert abs(result.mean[0] - 1.0) < 0.02


def test_densities_without_anything_in_common_have_no_ratio():
    assert bennett_ratio(np.full(5, -np.inf), np.zeros(5)) == (-np.inf, np.inf)


@pytest.mark.parametrize("offset", [-1e6, 0.0, 1e6])
def test_the_ratio_of_densities_with_outliers_is_that_without_them(offset):
    """log N(1, 1) over N(0, 1) at draws of both, times e^offset: its ratio is the offset."""
    rng = np.random.default_rng(3)
    forward, backward = (rng.normal(mean, 1.0, 4000) - 0.5 + offset for mean in (0.0, 1.0))
    plain, variance = bennett_ratio(forward, backward)
    assert abs(plain - offset) < 4.0 * np.sqrt(variance)
    forward[:3] = -1e30
    assert bennett_ratio(forward, backward)[0] == pytest.approx(plain, abs=2e-3)
