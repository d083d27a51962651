"""What every law of ε keeps: one covariance, or one density, behind its likelihood, its whitening and its draws.

A new law of normal errors of constant size goes into `LAWS`, with its covariance as the literature writes it; another law goes into
`OTHERS`.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

import structid as si
from package import concrete_subclasses
from structid.inference.error_models.base import Discrepancy, ResidualSample

DT, SAMPLES, RUNS = 0.05, 120, 3
CHANNELS, UNITS = ("velocity",), ("m/s",)
VARIANCE = 2.0


def ar1(lag):
    return np.exp(-lag / 0.4)


def matern32(lag):
    scaled = np.sqrt(3.0) * lag / 0.5
    return (1.0 + scaled) * np.exp(-scaled)


def damped_cosine(lag):
    natural = 2.0 * np.pi * 1.5
    eta, omega = 0.1 * natural, natural * np.sqrt(1.0 - 0.01)
    return np.exp(-eta * lag) * (np.cos(omega * lag) + eta / omega * np.sin(omega * lag))


# Each with everything known, its correlation at a lag [s], and the variance of its white part.
LAWS = {
    "IID": (si.IID(variance=VARIANCE), lambda lag: (lag == 0.0) * 1.0, 0.0),
    "AR1": (si.AR1(variance=VARIANCE, white=0.3, correlation_time=0.4), ar1, 0.3),
    "Matern32": (si.Matern32(variance=VARIANCE, white=0.1, correlation_time=0.5), matern32, 0.1),
    "DampedCosine": (si.DampedCosine(variance=VARIANCE, white=0.1, frequency=1.5, damping=0.1), damped_cosine, 0.1),
}


# Not normal, or of a size that depends on the response.
OTHERS = {
    "Student": si.Student(variance=VARIANCE, degrees_of_freedom=4.0),
    "Contaminated": si.Contaminated(variance=VARIANCE, outlier_share=0.05, outlier_scale=8.0),
    "Proportional": si.Proportional(variance=VARIANCE, share=0.3),
    "Quantised": si.Quantised(variance=VARIANCE, resolution=2.0),
}


def test_no_law_is_forgotten():
    assert {type(law) for law in (*(law for law, *_ in LAWS.values()), *OTHERS.values())} == concrete_subclasses(
        Discrepancy
    )


@pytest.fixture(scope="module")
def residual():
    return np.random.default_rng(1).normal(size=(SAMPLES, 1, RUNS))


@pytest.mark.parametrize("name", LAWS)
class TestEveryDiscrepancy:
    def covariance(self, name, lag):
        law, correlation, white = LAWS[name]
        floor = 0.0 if law.independent else 1e-10 * VARIANCE  # see SMALLEST_WHITE
        return VARIANCE * correlation(lag) + (white + floor) * (lag == 0.0)

    def matrix(self, name):
        time = np.arange(SAMPLES) * DT
        return self.covariance(name, np.abs(time[:, None] - time))

    def test_the_likelihood_is_that_of_the_dense_covariance(self, name, residual):
        expected = scipy.stats.multivariate_normal(np.zeros(SAMPLES), self.matrix(name)).logpdf(residual[:, 0].T)
        np.testing.assert_allclose(LAWS[name][0].log_likelihood(residual, {}, CHANNELS, DT), expected, rtol=1e-9)

    def test_further_white_variance_is_on_the_diagonal(self, name, residual):
        more = np.array([[0.2, 0.5, 0.9]])
        found = LAWS[name][0].log_likelihood(residual, {}, CHANNELS, DT, white=more)
        for k in range(RUNS):
            dense = scipy.stats.multivariate_normal(np.zeros(SAMPLES), self.matrix(name) + more[0, k] * np.eye(SAMPLES))
            assert float(found[k]) == pytest.approx(dense.logpdf(residual[:, 0, k]), rel=1e-9)

    def test_pointwise_sums_to_the_whole(self, name, residual):
        law = LAWS[name][0]
        pointwise = np.asarray(law.pointwise(residual, {}, CHANNELS, DT))
        assert pointwise.shape == residual.shape
        np.testing.assert_allclose(
            pointwise.sum(axis=(0, 1)), law.log_likelihood(residual, {}, CHANNELS, DT), rtol=1e-9
        )
        # Given the past: the density of the first samples alone is the sum of their terms.
        first = scipy.stats.multivariate_normal(np.zeros(40), self.matrix(name)[:40, :40]).logpdf(residual[:40, 0, 0])
        np.testing.assert_allclose(pointwise[:40, 0, 0].sum(), first, rtol=1e-9)

    def test_whitening_is_the_inverse_of_the_factor(self, name, residual):
        factor = np.linalg.cholesky(self.matrix(name))
        found = np.asarray(LAWS[name][0].whiten(residual, {}, CHANNELS, DT))
        np.testing.assert_allclose(found[:, 0], np.linalg.solve(factor, residual[:, 0]), rtol=1e-7, atol=1e-9)

    def test_the_jacobian_of_whitening_is_that_of_the_likelihood(self, name, residual):
        """Whitening W is linear: log L(r) = −½ ‖W r‖² + log |det W| − ½ T log 2π."""
        law = LAWS[name][0]
        whitening = np.asarray(law.whiten(np.eye(SAMPLES)[:, None, :], {}, CHANNELS, DT))[:, 0]
        squares = (np.asarray(law.whiten(residual, {}, CHANNELS, DT)) ** 2).sum(axis=(0, 1))
        expected = -0.5 * squares + np.linalg.slogdet(whitening)[1] - 0.5 * SAMPLES * np.log(2.0 * np.pi)
        np.testing.assert_allclose(law.log_likelihood(residual, {}, CHANNELS, DT), expected, rtol=1e-8)

    def test_draws_have_the_covariance(self, name):
        """Within 4.5 standard errors over 4000 draws; of a law with a tenth more variance they are not."""
        draws = LAWS[name][0].draw(np.random.default_rng(2), (4000, SAMPLES, 1), {}, CHANNELS, DT)[:, :, 0]
        for lag in (0, 1, 5, 20, 60):
            products = draws[:, : SAMPLES - lag] * draws[:, lag:]
            # One product of each draw, from its middle: independent of one another.
            own = products[:, len(products[0]) // 2]
            error = own.std() / np.sqrt(len(own))
            assert abs(own.mean() - self.covariance(name, lag * DT)) < 4.5 * error
        variance = (draws**2).mean(axis=1)
        assert abs(variance.mean() - 1.1 * self.covariance(name, 0.0)) > 4.5 * variance.std() / np.sqrt(4000)

    def test_whitened_draws_are_independent_unit_normals(self, name):
        """And those of a law with a tenth more variance are not."""
        law = LAWS[name][0]
        draws = law.draw(np.random.default_rng(3), (300, SAMPLES, 1), {}, CHANNELS, DT).transpose(1, 2, 0)
        white = np.asarray(law.whiten(draws, {}, CHANNELS, DT))
        assert scipy.stats.kstest(white.ravel(), "norm").pvalue > 1e-3
        assert scipy.stats.kstest(np.sqrt(1.1) * white.ravel(), "norm").pvalue < 1e-3
        for lag in (1, 2, 7, 20):  # the mean of n products of independent unit normals has standard deviation 1/√n
            products = white[lag:] * white[:-lag]
            assert abs(products.mean()) < 4.5 / np.sqrt(products.size)

    def test_squares_are_a_shortcut_where_nothing_else_is_seen(self, name, residual):
        law = LAWS[name][0]
        squares = (residual**2).sum(axis=0)
        if law.independent:
            found = law.log_likelihood_of_squares(squares, SAMPLES, {}, CHANNELS)
            np.testing.assert_allclose(found, law.log_likelihood(residual, {}, CHANNELS, DT), rtol=1e-12)
            np.testing.assert_array_equal(law.variances({}, CHANNELS, RUNS, np), np.full((1, RUNS), VARIANCE))
        else:
            with pytest.raises(NotImplementedError, match=name):
                law.log_likelihood_of_squares(squares, SAMPLES, {}, CHANNELS)
            with pytest.raises(NotImplementedError, match=name):
                law.variances({}, CHANNELS, RUNS, np)

    def test_what_is_unknown_has_a_prior_and_is_used(self, name, residual):
        """Everything left open, its values given: the law with these values fixed."""
        law = LAWS[name][0]
        open_law, measured = type(law)(), residual[:, :, 0]
        priors = open_law.parameters(measured, CHANNELS, DT, UNITS)
        values = {n: np.full(RUNS, float(prior.quantile(np.array(0.3)))) for n, prior in priors.items()}
        fields = {"sigma2": "variance", "sigma2_white": "white"}
        given = {fields.get(n, n): float(v[0]) for n, v in values.items()}
        assert "variance" in given and all(np.isfinite(v) for v in given.values())
        fixed = type(law)(**given)
        assert fixed.parameters(measured, CHANNELS, DT, UNITS) == {} and fixed.describe() != open_law.describe()
        np.testing.assert_allclose(
            open_law.log_likelihood(residual, values, CHANNELS, DT),
            fixed.log_likelihood(residual, {}, CHANNELS, DT),
            rtol=1e-10,
        )

    def test_channels_are_independent(self, name, residual):
        law, both = LAWS[name][0], np.concatenate([residual, 0.5 * residual], axis=1)
        alone = sum(np.asarray(law.log_likelihood(r, {}, CHANNELS, DT)) for r in (residual, 0.5 * residual))
        together = law.log_likelihood(both, {}, ("velocity", "displacement"), DT)
        np.testing.assert_allclose(together, alone, rtol=1e-10)


@pytest.mark.parametrize("name", [*LAWS, "Student", "Contaminated"])
def test_the_influence_is_the_gradient_by_the_response(name, residual):
    """d/ds log p(r − s v) = Wv · influence(r) at s = 0, with W the whitening and v a smooth change of the response."""
    law = OTHERS[name] if name in OTHERS else LAWS[name][0]
    change = np.broadcast_to(np.sin(0.1 * np.arange(SAMPLES))[:, None, None], residual.shape)
    step = 1e-4
    ahead, behind = (law.log_likelihood(residual - s * change, {}, CHANNELS, DT) for s in (step, -step))
    influence, white = law.influence(residual, {}, CHANNELS, DT), law.whiten(change, {}, CHANNELS, DT)
    found = (np.asarray(white) * np.asarray(influence)).sum(axis=(0, 1))
    np.testing.assert_allclose(found, (np.asarray(ahead) - np.asarray(behind)) / (2.0 * step), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ["Student", "Contaminated"])
def test_an_outlier_has_little_influence(name):
    residual = np.geomspace(1e-3, 1e3, 400)[:, None, None]
    laws = OTHERS[name], si.IID(variance=VARIANCE)
    influence, normal = (np.asarray(law.influence(residual, {}, CHANNELS, DT))[:, 0, 0] for law in laws)
    assert np.isfinite(influence).all()
    assert influence[-1] < 0.02 * normal[-1]
    np.testing.assert_allclose(influence[:100] / influence[0], normal[:100] / normal[0], rtol=0.02)


STEP, AT = 2.0, 3.7
CELLS = STEP * np.arange(-400, 401) - AT
"""Residuals of values on a grid, of a response of `AT`."""


def probabilities(law):
    """Probability of the cell around each of `CELLS`: of the rounded value itself, or the integral of the density."""
    within = [0.0] if isinstance(law, si.Quantised) else (np.arange(100) + 0.5) / 100 * STEP - 0.5 * STEP
    residual = np.add.outer(np.asarray(within), CELLS)[:, :, None]
    density = np.exp(law.pointwise(residual, {}, CHANNELS * len(CELLS), DT, **law.seeing(np.full_like(residual, AT))))
    return STEP * density.mean(axis=0)[:, 0]


def with_variance(law, factor):
    """The same error model with another variance."""
    given = {key: value for key, value in law.describe().items() if key != "kind"}
    return type(law)(**given | {"variance": factor * VARIANCE})


@pytest.mark.parametrize("name", OTHERS)
class TestErrorsOfAnotherDensity:
    def test_the_density_is_one(self, name):
        assert probabilities(OTHERS[name]).sum() == pytest.approx(1.0, abs=1e-7)

    def test_draws_have_the_density(self, name):
        """By their frequencies in cells; those of a law with a quarter more variance differ."""
        mass = probabilities(OTHERS[name])
        frequent = mass > 1e-3
        for factor, passes in ((1.0, True), (1.25, False)):
            law, shape = with_variance(OTHERS[name], factor), (20_000, 1, 1)
            draws = law.draw(np.random.default_rng(5), shape, {}, CHANNELS, DT, **law.seeing(np.full(shape, AT)))
            cells = np.round((draws.ravel() + AT) / STEP).astype(int) + 400
            counts = np.bincount(np.clip(cells, 0, 800), minlength=801)
            counts = np.append(counts[frequent], counts[~frequent].sum())
            shares = np.append(mass[frequent], 1.0 - mass[frequent].sum())
            pvalue = scipy.stats.chisquare(
                counts[shares > 1e-3], shares[shares > 1e-3] * len(cells), sum_check=False
            ).pvalue
            assert (pvalue > 1e-3) == passes, pvalue

    def test_normal_scores_of_draws_are_normal(self, name):
        """Whitened draws of Student's t and of the mixture are not."""
        law, shape = OTHERS[name], (300, SAMPLES, 1)
        at = np.random.default_rng(6).normal(size=shape)
        draws = law.draw(np.random.default_rng(7), shape, {}, CHANNELS, DT, **law.seeing(at)).transpose(1, 2, 0)
        seen = law.seeing(at.transpose(1, 2, 0))
        scores = np.asarray(law.normal_scores(draws, {}, CHANNELS, DT, **seen)).ravel()
        assert scipy.stats.kstest(scores, "norm").pvalue > 1e-3
        assert abs(scores.mean()) < 4.5 / np.sqrt(scores.size) and abs(scores.std() - 1.0) < 0.02
        if name in ("Student", "Contaminated"):
            assert scipy.stats.kstest(np.asarray(law.whiten(draws, {}, CHANNELS, DT)).ravel(), "norm").pvalue < 1e-3

    def test_the_fold_is_the_likelihood(self, name, residual):
        """Sample by sample inside JAX, with and without missing values."""
        law, response = OTHERS[name], 5.0 * residual + 1.0
        whole = law.log_likelihood(residual, {}, CHANNELS, DT, **law.seeing(response))
        pointwise = np.asarray(law.pointwise(residual, {}, CHANNELS, DT, **law.seeing(response)))
        np.testing.assert_allclose(pointwise.sum(axis=(0, 1)), whole, rtol=1e-12)
        fold = law.fold({}, CHANNELS, RUNS, DT, SAMPLES)
        np.testing.assert_allclose(fold.of(ResidualSample(residual, None, response)), whole, rtol=1e-9)
        known = np.random.default_rng(8).random((SAMPLES, 1)) < 0.7
        some = law.log_likelihood(residual, {}, CHANNELS, DT, is_measured=known, **law.seeing(response))
        np.testing.assert_allclose(some, pointwise[known[:, 0]].sum(axis=(0, 1)), rtol=1e-12)
        folded = fold.of(ResidualSample(residual, known[:, :, None], response))
        np.testing.assert_allclose(folded, some, rtol=1e-9)

    def test_further_white_variance_adds_to_the_variance(self, name, residual):
        law, seen = OTHERS[name], OTHERS[name].seeing(residual)
        found = law.log_likelihood(residual, {}, CHANNELS, DT, white=np.full((1, RUNS), 0.5 * VARIANCE), **seen)
        wider = with_variance(law, 1.5)
        if name == "Contaminated":  # the outliers' own variance grows by as much, not in proportion
            wider = replace(wider, outlier_scale=np.sqrt((law.outlier_scale**2 + 0.5) / 1.5))
        expected = wider.log_likelihood(residual, {}, CHANNELS, DT, **seen)
        np.testing.assert_allclose(found, expected, rtol=1e-12)

    def test_what_is_unknown_has_a_prior_and_is_used(self, name, residual):
        rounded = np.round(residual / STEP) * STEP
        unknown = type(OTHERS[name])().bound_to(rounded[:, :, 0], CHANNELS)
        priors = unknown.parameters(rounded[:, :, 0], CHANNELS, DT, UNITS)
        values = {n: np.full(RUNS, float(prior.quantile(np.array(0.3)))) for n, prior in priors.items()}
        given = {{"sigma2": "variance"}.get(n, n): float(v[0]) for n, v in values.items()}
        fixed = type(unknown)(**given, **({"resolution": STEP} if name == "Quantised" else {}))
        assert "variance" in given and fixed.parameters(rounded[:, :, 0], CHANNELS, DT, UNITS) == {}
        assert fixed.describe() != unknown.describe() and unknown.describe()["kind"] == fixed.describe()["kind"]
        seen = unknown.seeing(residual)
        np.testing.assert_allclose(
            unknown.log_likelihood(rounded, values, CHANNELS, DT, **seen),
            fixed.log_likelihood(rounded, {}, CHANNELS, DT, **seen),
            rtol=1e-9,
        )

    def test_channels_are_independent(self, name, residual):
        law, parts = OTHERS[name], (residual, 0.5 * residual)
        alone = sum(np.asarray(law.log_likelihood(r, {}, CHANNELS, DT, **law.seeing(r))) for r in parts)
        both = np.concatenate(parts, axis=1)
        together = law.log_likelihood(both, {}, ("velocity", "displacement"), DT, **law.seeing(both))
        np.testing.assert_allclose(together, alone, rtol=1e-10)
