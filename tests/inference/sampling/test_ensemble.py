"""The ensemble sampler: moves, moments on known targets within their own Monte-Carlo error, stores, verdicts."""

import numpy as np
import pytest
import scipy.signal
import scipy.special
import scipy.stats

import structid as si
from structid.errors import InputError, StoreMismatchError
from structid.inference.assessment import diagnostics
from structid.inference.sampling.moves import (
    DEGREES_OF_FREEDOM,
    LAYERS,
    EnsembleState,
    IndependenceLaw,
    differential_proposal,
    independent_proposal,
    stretch_proposal,
)
from structid.inference.target import LogDensity

RNG = np.random.default_rng(7)
A = RNG.standard_normal((5, 5))
COVARIANCE = A @ A.T / 5 + 0.2 * np.eye(5)
PRECISION = np.linalg.inv(COVARIANCE)
MEAN = np.arange(5) * 0.5


def gaussian():
    density = lambda x: -0.5 * np.einsum("ij,jk,ik->i", x - MEAN, PRECISION, x - MEAN)  # noqa: E731
    return LogDensity(density, "abcde", lambda n, rng: MEAN + 3 * rng.standard_normal((n, 5)))


def skewed():
    """Independent gammas of shape 2 and 5: mean 2, 5; sd √2, √5; on the positive half-line, through the bijection."""
    density = lambda x: (np.array([1.0, 4.0]) * np.log(x) - x).sum(axis=1)  # noqa: E731
    bounds = {"a": (0.0, np.inf), "b": (0.0, np.inf)}
    return LogDensity(density, "ab", lambda n, rng: rng.gamma(1.0, 3.0, (n, 2)) + 1e-3, bounds)


def banana():
    """x ~ N(0, 1), y | x ~ N(x², 0.5²): E y = 1, var y = 2 + 0.25."""
    density = lambda x: -0.5 * x[:, 0] ** 2 - 0.5 * ((x[:, 1] - x[:, 0] ** 2) / 0.5) ** 2  # noqa: E731
    return LogDensity(density, "xy", lambda n, rng: rng.standard_normal((n, 2)) * 2)


TARGETS = {
    "gaussian": (gaussian, MEAN, np.sqrt(np.diag(COVARIANCE))),
    "skewed": (skewed, np.array([2.0, 5.0]), np.sqrt([2.0, 5.0])),
    "banana": (banana, np.array([0.0, 1.0]), np.array([1.0, 1.5])),
}


def moment_errors(result, mean, sd):
    """Deviations of means and sds in units of their own Monte-Carlo error."""
    kept = result.kept
    z_mean, z_sd = [], []
    for i in range(kept.shape[-1]):
        x = kept[..., i]
        squares = (x - mean[i]) ** 2
        z_mean.append((x.mean() - mean[i]) / (x.std() / np.sqrt(diagnostics.effective_sample_size(x))))
        error = squares.std() / np.sqrt(diagnostics.effective_sample_size(squares))
        z_sd.append((squares.mean() - sd[i] ** 2) / error)
    return np.array(z_mean), np.array(z_sd)


@pytest.mark.parametrize("de", [0.0, 0.5, 1.0], ids=["stretch", "mixed", "differential"])
@pytest.mark.parametrize("name", TARGETS)
def test_moments_within_their_monte_carlo_error(name, de):
    make, mean, sd = TARGETS[name]
    result = si.sample(make(), si.AIES(walkers=40, steps=4000, ensembles=4, differential_evolution=de), seed=11)
    z_mean, z_sd = moment_errors(result, mean, sd)
    print(name, de, "z of means", np.round(z_mean, 1), "z of variances", np.round(z_sd, 1))
    assert np.abs(z_mean).max() < 4.0
    assert np.abs(z_sd).max() < 4.0


def test_the_printed_move_would_fail(monkeypatch):
    """The source prints x_i + Z (x_j − x_i) [2.31] with the acceptance of the stretch move: its moments are wrong."""

    def printed(rng, moving, resting, a):
        ensembles, walkers, dimension = moving.shape
        z = ((a - 1.0) * rng.random((ensembles, walkers)) + 1.0) ** 2 / a
        anchor = np.take_along_axis(
            resting, rng.integers(resting.shape[1], size=(ensembles, walkers))[:, :, None], axis=1
        )
        return moving + z[:, :, None] * (anchor - moving), (dimension - 1.0) * np.log(z)

    monkeypatch.setattr("structid.inference.sampling.moves.stretch_proposal", printed)
    result = si.sample(gaussian(), si.AIES(walkers=40, steps=4000, ensembles=4), seed=11)
    z_mean, z_sd = moment_errors(result, MEAN, np.sqrt(np.diag(COVARIANCE)))
    assert max(np.abs(z_mean).max(), np.abs(z_sd).max()) > 8.0


def test_stretch_variable_has_its_law():
    """Z ~ g(z) ∝ 1/√z on [1/a, a]: F(z) = (√(za) − 1)/(a − 1)."""
    moving, resting = np.ones((1, 100_000, 3)), np.zeros((1, 2, 3))
    proposal, log_factor = stretch_proposal(np.random.default_rng(0), moving, resting, 2.0)
    z = proposal[0, :, 0]
    assert scipy.stats.kstest(z, lambda v: np.sqrt(2 * v) - 1).pvalue > 1e-3
    np.testing.assert_allclose(log_factor[0], 2 * np.log(z), rtol=1e-12)


def test_affine_invariance():
    """The same seed on a stretched and shifted target gives the same chain, stretched and shifted."""
    scale, shift = np.array([1e6, 1e-3]), np.array([5.0, -7.0])
    plain = LogDensity(lambda x: -0.5 * (x**2).sum(1), "ab", lambda n, rng: rng.standard_normal((n, 2)))
    moved = LogDensity(
        lambda x: -0.5 * (((x - shift) / scale) ** 2).sum(1),
        "ab",
        lambda n, rng: shift + scale * rng.standard_normal((n, 2)),
    )
    settings = si.AIES(walkers=10, steps=60, ensembles=2, differential_evolution=0.3)
    first, second = (si.sample(t, settings, seed=3).history for t in (plain, moved))
    np.testing.assert_allclose(second, shift + scale * first, rtol=1e-6, atol=1e-6 * scale.min())


def test_differential_moves_never_use_the_same_walker_twice():
    resting = np.eye(4)[None] * 5.0
    proposal, _ = differential_proposal(np.random.default_rng(0), np.zeros((1, 5000, 4)), resting)
    assert (np.abs(proposal[0]).sum(axis=1) > 0).all()


# --- independence moves, which tempered particles and sub-chains make ---------------------------------------------------


def independent_moves(monkeypatch, factor):
    """Let an ensemble make them in half of its steps, with their factor times another."""

    def propose(moves, rng, _kind, moving, resting):
        if rng.random() < 0.5:
            return stretch_proposal(rng, moving, resting.phi, moves.stretch)
        proposal, log_factor = independent_proposal(rng, moving, IndependenceLaw.fitted(resting))
        return proposal, factor * log_factor

    monkeypatch.setattr("structid.inference.sampling.moves.Moves.propose", propose)


@pytest.mark.parametrize("name", TARGETS)
def test_moments_with_independence_moves(name, monkeypatch):
    make, mean, sd = TARGETS[name]
    independent_moves(monkeypatch, 1.0)
    result = si.sample(make(), si.AIES(walkers=40, steps=4000, ensembles=4), seed=11)
    z_mean, z_sd = moment_errors(result, mean, sd)
    assert np.abs(z_mean).max() < 4.0
    assert np.abs(z_sd).max() < 4.0


def test_independence_moves_without_their_factor_would_fail(monkeypatch):
    independent_moves(monkeypatch, 0.0)
    make, mean, sd = TARGETS["skewed"]
    z_mean, z_sd = moment_errors(si.sample(make(), si.AIES(walkers=40, steps=4000, ensembles=4), seed=11), mean, sd)
    assert max(np.abs(z_mean).max(), np.abs(z_sd).max()) > 8.0


def test_independence_moves_have_the_law_of_their_factor():
    """A mixture of Student laws of the densest walkers: factor and draws against scipy's."""
    rng = np.random.default_rng(0)
    resting = rng.standard_normal((2, 100, 3)) @ np.array([[1.0, 0.0, 0.0], [0.9, 0.1, 0.0], [0.0, 3.0, 1.0]])
    density = -((resting - 1.0) ** 2).sum(axis=2)
    moving = rng.standard_normal((2, 20_000, 3))
    proposal, log_factor = independent_proposal(rng, moving, IndependenceLaw.fitted(EnsembleState(resting, density)))
    for k in range(2):
        laws, shares = [], []
        for densest, share in LAYERS:
            part = resting[k, np.argsort(-density[k])[: round(100 * densest)]]
            laws.append(scipy.stats.multivariate_t(part.mean(0), np.cov(part.T, bias=True), df=DEGREES_OF_FREEDOM))
            shares.append(share)

        def log_law(x, laws=laws, shares=shares):
            return scipy.special.logsumexp([law.logpdf(x) for law in laws], axis=0, b=np.array(shares)[:, None])

        np.testing.assert_allclose(log_factor[k], log_law(moving[k]) - log_law(proposal[k]), atol=1e-3)
        for i in range(3):

            def cdf(x, i=i, laws=laws, shares=shares):
                each = [scipy.stats.t.cdf(x, DEGREES_OF_FREEDOM, law.loc[i], np.sqrt(law.shape[i, i])) for law in laws]
                return np.average(each, axis=0, weights=shares)

            assert scipy.stats.kstest(proposal[k, :, i], cdf).pvalue > 1e-3


def test_independence_moves_of_walkers_in_a_plane():
    """All copies of one, and fewer than dimensions: nothing breaks, and nothing finite comes of nothing."""
    rng = np.random.default_rng(1)
    for resting in (np.ones((2, 10, 4)), rng.standard_normal((2, 3, 4))):
        law = IndependenceLaw.fitted(EnsembleState(resting, np.zeros(resting.shape[:2])))
        proposal, log_factor = independent_proposal(rng, rng.standard_normal((2, 10, 4)), law)
        assert np.isfinite(proposal).all() and np.isfinite(log_factor).all()


# --- diagnostics ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 0.97])
def test_autocorrelation_time_of_an_ar1_process(rho):
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((4, 60_000))
    series = scipy.signal.lfilter([1.0], [1.0, -rho], noise, axis=1)
    assert diagnostics.autocorrelation_time(series) == pytest.approx((1 + rho) / (1 - rho), rel=0.12)


def test_r_hat_sees_ensembles_that_disagree():
    rng = np.random.default_rng(2)
    same = rng.standard_normal((400, 4, 20))
    apart = same + np.array([0.0, 0.0, 0.0, 0.4])[None, :, None]
    assert diagnostics.r_hat(same) < 1.01 < diagnostics.r_hat(apart)
    assert np.isnan(diagnostics.r_hat(same[:, :1]))


def test_stuck_walkers_are_found():
    rng = np.random.default_rng(3)
    accepted, density = rng.random((500, 2, 20)) < 0.4, -0.5 * rng.chisquare(5, (500, 2, 20))
    assert not diagnostics.stuck_walkers(accepted, density).any()
    density[:, 1, 7] -= 300.0
    accepted[:, 0, 3] = False
    stuck = diagnostics.stuck_walkers(accepted, density)
    assert stuck[1, 7] and stuck[0, 3] and stuck.sum() == 2


def test_verdicts():
    short = si.sample(gaussian(), si.AIES(walkers=20, steps=200, ensembles=4), seed=1).verdict()
    assert not short.converged and "autocorrelation times" in str(short)
    long = si.sample(
        gaussian(), si.AIES(walkers=20, steps=8000, ensembles=4, differential_evolution=0.5), seed=1
    ).verdict()
    assert long.converged, str(long)
    single = si.sample(gaussian(), si.AIES(walkers=20, steps=8000, ensembles=1), seed=1).verdict()
    assert not single.converged and "single ensemble" in str(single)


def test_settling_frees_walkers_from_a_false_mode():
    """A narrow mode 200 nats below the true one catches walkers for ever; settling takes them out."""

    def density(x):
        true_mode = -0.5 * (x**2).sum(1)
        false_mode = -200.0 - 0.5 * (((x - 30.0) / 0.5) ** 2).sum(1)
        return np.logaddexp(true_mode, false_mode)

    def start(n, rng):
        x = rng.standard_normal((n, 2))
        x[::7] = 30.0 + 0.3 * rng.standard_normal((len(x[::7]), 2))
        return x

    target = LogDensity(density, "ab", start)
    settings = dict(walkers=14, steps=3000, ensembles=3)
    assert si.sample(target, si.AIES(**settings), seed=1).verdict().stuck > 0
    assert si.sample(target, si.AIES(**settings, settling_steps=200), seed=1).verdict().stuck == 0
    with pytest.raises(InputError, match="discarded"):
        si.AIES(**settings, settling_steps=2000)


@pytest.mark.parametrize(
    "settings",
    [
        dict(walkers=7),
        dict(walkers=2),
        dict(steps=0),
        dict(stretch=1.0),
        dict(discard=1.0),
        dict(differential_evolution=2.0),
    ],
)
def test_bad_settings_are_refused(settings):
    with pytest.raises(InputError, match="AIES"):
        si.AIES(**settings)


def test_too_few_walkers_and_hopeless_starts():
    with pytest.raises(InputError, match="10 or more"):
        si.sample(gaussian(), si.AIES(walkers=8, steps=10), seed=1)
    never = LogDensity(lambda x: np.full(len(x), -np.inf), "ab", lambda n, rng: rng.standard_normal((n, 2)))
    with pytest.raises(si.StructidError, match="Check the priors"):
        si.sample(never, si.AIES(walkers=8, steps=10), seed=1)


# --- stores -----------------------------------------------------------------------------------------------------------


def test_a_store_is_read_continued_and_refused(tmp_path):
    store = tmp_path / "chains.h5"
    settings = dict(walkers=12, ensembles=2, discard=0.0)
    first = si.sample(gaussian(), si.AIES(**settings, steps=100), seed=4, store=store)
    assert store.exists() and not store.with_name("chains.h5.journal").exists()
    again = si.sample(gaussian(), si.AIES(**settings, steps=100), seed=4, store=store)
    np.testing.assert_array_equal(again.history, first.history)
    longer = si.sample(gaussian(), si.AIES(**settings, steps=250), seed=4, store=store)
    fresh = si.sample(gaussian(), si.AIES(**settings, steps=250), seed=4)
    np.testing.assert_array_equal(longer.history, fresh.history)
    before = store.read_bytes()
    with pytest.raises(StoreMismatchError, match="seed"):
        si.sample(gaussian(), si.AIES(**settings, steps=100), seed=5, store=store)
    with pytest.raises(StoreMismatchError, match=r"names|target"):
        si.sample(banana(), si.AIES(**settings, steps=100), seed=4, store=store)
    assert store.read_bytes() == before


@pytest.mark.parametrize(("first", "then"), [(120, 250), (20, 30), (120, 110), (50, 70)])
def test_a_store_continues_from_any_length_to_the_same_bits(tmp_path, first, then):
    settings = dict(walkers=12, ensembles=2, discard=0.0)
    store = tmp_path / "chains.h5"
    si.sample(gaussian(), si.AIES(**settings, steps=first), seed=4, store=store)
    longer = si.sample(gaussian(), si.AIES(**settings, steps=then), seed=4, store=store)
    fresh = si.sample(gaussian(), si.AIES(**settings, steps=then), seed=4)
    assert len(longer.history) == then
    np.testing.assert_array_equal(longer.history, fresh.history)
    again = si.sample(gaussian(), si.AIES(**settings, steps=then), seed=4, store=store)
    np.testing.assert_array_equal(again.history, fresh.history)


def test_a_store_knows_its_function_and_its_start(tmp_path):
    start = lambda n, rng: rng.standard_normal((n, 2))  # noqa: E731
    first = LogDensity(lambda x: -0.5 * (x**2).sum(1), "ab", start)
    other = LogDensity(lambda x: -0.6 * (x**2).sum(1), "ab", start)
    settings = si.AIES(walkers=12, steps=50, ensembles=2)
    points = np.random.default_rng(0).standard_normal((30, 2))
    si.sample(first, settings, seed=1, store=tmp_path / "a.h5")
    with pytest.raises(StoreMismatchError, match="target"):
        si.sample(other, settings, seed=1, store=tmp_path / "a.h5")
    with pytest.raises(StoreMismatchError, match="start"):
        si.sample(first, settings, seed=1, store=tmp_path / "a.h5", start=points)


def test_a_run_that_cannot_begin_leaves_nothing(tmp_path):
    with pytest.raises(InputError):
        si.sample(gaussian(), si.AIES(walkers=8, steps=10), seed=1, store=tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


def test_seeds_give_different_draws_and_the_same_seed_the_same():
    settings = si.AIES(walkers=12, steps=60, ensembles=2)
    a, b, c = (si.sample(gaussian(), settings, seed=s).history for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


def test_result_speaks_the_arviz_schema(short_posterior, tmp_path):
    import xarray

    result = si.sample(short_posterior, si.AIES(walkers=12, steps=60, ensembles=2), seed=1)
    path = result.to_netcdf(tmp_path / "posterior.nc")
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        groups = {g.strip("/") for g in tree.groups} - {""}
        predictive = {"posterior_predictive", "prior_predictive", "log_likelihood"}
        assert groups == predictive | {"posterior", "prior", "sample_stats", "observed_data", "constant_data"}
        assert tree["posterior"]["stiffness"].dims == ("chain", "draw")
        assert tree["posterior"]["ensemble"].values.tolist() == [0] * 12 + [1] * 12
        np.testing.assert_array_equal(tree["posterior"]["alpha"].values, result.draws[:, :, 3])
        assert tree["posterior_predictive"]["y"].dims == ("chain", "draw", "time", "channel")
    np.testing.assert_array_equal(result.draws[13, :, 0], result.kept[:, 1, 1, 0])


def test_map_is_at_least_the_best_draw_and_predictions_have_bands(short_posterior, short_record):
    result = si.sample(
        short_posterior,
        si.AIES(walkers=12, steps=400, ensembles=2, differential_evolution=0.5, start_candidates=10),
        seed=1,
    )
    at_map = short_posterior.log_density(result.map_estimate[None])[0]
    assert at_map >= result.log_density[result.discarded :].max() - 1e-9
    prediction = result.predict(draws=100)
    assert prediction.response.shape == (len(prediction.response), 601, 1)
    inner, outer = prediction.band(), prediction.band(discrepancy=True)
    assert np.mean(outer[1] - outer[0]) > np.mean(inner[1] - inner[0])
    other = result.predict(short_record.scale(0.5), channels=("displacement", "restoring_force"), draws=50)
    assert other.channels == ("displacement", "restoring_force") and np.isfinite(other.peaks).all()
    # An observable the discrepancy covers: about nine tenths of the measurement lies in its 90 % band.
    y = short_posterior.observations[0].values
    assert np.mean((y > outer[0]) & (y < outer[1])) > 0.8


def test_short_chains_are_judged_by_their_walkers():
    """Twenty steps of AR(1) walkers with φ = 0.9, τ = 19: the mean over each ensemble, about its own mean, would say 3 or so."""
    from structid.inference.assessment.diagnostics import autocorrelation_time, series_time

    rng = np.random.default_rng(1)
    draws = np.empty((20, 4, 400))
    draws[0] = rng.normal(size=(4, 400))
    for t in range(1, 20):
        draws[t] = 0.9 * draws[t - 1] + np.sqrt(1.0 - 0.81) * rng.normal(size=(4, 400))
    assert autocorrelation_time(draws.mean(axis=2).T) < 6.0 < series_time(draws)


def handed_on(seed, steps, walkers, rho):
    """Walkers that take over their places, x_i(t) = ρ x_{i−1}(t−1) + noise: each alone looks independent, their mean is not."""
    rng, shape = np.random.default_rng(seed), (4, walkers)
    draws = np.empty((steps, *shape))
    draws[0] = rng.standard_normal(shape)
    for t in range(1, steps):
        draws[t] = rho * np.roll(draws[t - 1], 1, axis=1) + np.sqrt(1.0 - rho**2) * rng.standard_normal(shape)
    return draws


def test_the_time_of_an_ensemble_that_moves_together_is_that_of_its_mean():
    rho = 0.9
    draws = handed_on(6, 4000, 60, rho)
    assert diagnostics.autocorrelation_time(draws.reshape(4000, -1).T) < 1.5
    assert diagnostics.series_time(draws) == pytest.approx((1 + rho) / (1 - rho), rel=0.3)


def test_a_chain_too_short_to_tell_is_not_called_long_enough():
    """Of 65 steps with τ = 66 the means cannot say how much of theirs is noise, so the longer one judges the length."""
    draws = handed_on(9, 65, 32, 0.97)
    assert diagnostics.series_time(draws) < 3.0
    figures = diagnostics.parameter_diagnostics(draws)
    assert figures.autocorrelation_time > 13.0
    failures = diagnostics.convergence_failures({"a": figures}, 65, 4, 0, si.DelayedAcceptance.needed_length)
    assert any("autocorrelation times of a" in failure for failure in failures)


def test_the_time_of_a_constant_is_none():
    with np.errstate(all="raise"):
        assert np.isnan(diagnostics.series_time(np.full((37, 3, 7), 0.1)))
        assert np.isnan(diagnostics.longest_time(np.full((37, 3, 7), 0.1)))


def test_the_time_of_few_steps_is_known():
    """AR(1) walkers, ρ = 0.9, of 100 steps: the means of four ensembles know τ to 40 %, the walkers to 10 %."""
    rng, rho, by_means, by_walkers = np.random.default_rng(7), 0.9, [], []
    for _ in range(60):
        start = rho * rng.normal(size=(1, 4, 32))
        noise = np.sqrt(1.0 - rho**2) * rng.standard_normal((100, 4, 32))
        draws = scipy.signal.lfilter([1.0], [1.0, -rho], noise, axis=0, zi=start)[0]
        by_means.append(diagnostics.autocorrelation_time(draws.mean(axis=2).T))
        by_walkers.append(diagnostics.series_time(draws))
    assert np.std(by_walkers) / np.mean(by_walkers) < 0.15 < 0.3 < np.std(by_means) / np.mean(by_means)


def test_few_steps_do_not_make_a_walker_stuck():
    from structid.inference.assessment.diagnostics import stuck_walkers

    rng = np.random.default_rng(2)
    density = -0.5 * rng.chisquare(5, size=(8, 4, 32))
    assert not stuck_walkers(rng.random((8, 4, 32)) < 0.3, density).any()
    density[:, 1, 7] -= 60.0
    assert stuck_walkers(rng.random((8, 4, 32)) < 0.3, density).sum() == 1


@pytest.mark.parametrize("steps", [50, 100, 2000])
def test_short_series_do_not_hide_their_correlation(steps):
    """AR(1) walkers, ρ = 0.9: the variance of their mean is σ² (1 + 2 Σ (1 − t/S) ρᵗ) / N, whatever the length of the series."""
    rng, rho, found = np.random.default_rng(5), 0.9, []
    for _ in range(60 if steps < 1000 else 6):
        noise = rng.standard_normal((steps, 4, 20))
        draws = scipy.signal.lfilter(
            [np.sqrt(1 - rho**2)], [1.0, -rho], noise, axis=0, zi=rho * rng.normal(size=(1, 4, 20))
        )[0]
        found.append(1.0 / diagnostics.effective_sample_size(draws))
    lags = np.arange(1, steps)
    time = 1.0 + 2.0 * np.sum((1.0 - lags / steps) * rho**lags)
    error = np.std(found) / np.sqrt(len(found))
    # Sokal's window leaves out a few hundredths of the sum.
    assert abs(np.mean(found) * steps * 80 / time - 0.97) < 0.05 + 4.0 * error * steps * 80 / time


def test_a_posterior_on_a_bound_of_its_prior():
    """At zero, which physics mostly sets, the data show nothing of the parameter; elsewhere they would go further."""
    space = si.ParameterSpace(a=si.Uniform(0.0, 10.0), b=si.Uniform(1.0, 11.0), c=si.Uniform(0.0, 10.0))
    centre = np.array([0.0, 1.0, 5.0])
    density = LogDensity(
        lambda x: -20.0 * np.abs(x - centre).sum(axis=1),
        "abc",
        lambda n, rng: centre + rng.random((n, 3)),
        {name: marginal.support for name, marginal in space.marginals.items()},
    )
    density.space = space
    warnings = si.sample(density, si.AIES(walkers=12, ensembles=2, steps=400), seed=1).verdict().warnings
    assert [w for w in warnings if "of a sits on the lower bound" in w and "show nothing of it" in w]
    assert [w for w in warnings if "of b sits on the lower bound" in w and w.endswith("would go further")]
    assert len(warnings) == 2  # and nothing of far tails
