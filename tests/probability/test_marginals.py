"""Marginals: density, distribution, quantile and moments agree, in NumPy and in JAX."""

import jax
import numpy as np
import pytest
import scipy.integrate
import scipy.stats

import structid as si
from structid.core.errors import InputError
from structid.core.units import factor as si_factor

MARGINALS = {
    "uniform": si.Uniform(2.0, 5.0, unit="mm"),
    "normal": si.Normal(7.42, 0.742, unit="kN/mm"),
    "normal truncated": si.Normal(7.42, 0.742, low=7.0, high=7.9, unit="kN/mm"),
    "normal far tail": si.Normal(0.0, 1.0, low=4.0),
    "lognormal": si.LogNormal(mean=0.063, sd=0.01),
    "lognormal truncated": si.LogNormal(log_mean=-1.0, log_sd=0.5, low=0.2, high=1.0),
    "gamma": si.Gamma(mean=3.0, sd=1.2, unit="Hz"),
    "gamma truncated": si.Gamma(shape=2.0, rate=0.5, high=6.0),
    "beta": si.Beta(mean=0.3, sd=0.1),
    "beta truncated": si.Beta(a=2.0, b=3.0, low=0.2, high=0.7, unit="%"),
    "weibull": si.Weibull(mean=2.0, sd=0.7),
    "weibull truncated": si.Weibull(shape=1.7, scale=2.0, low=0.5),
    "gumbel": si.Gumbel(mean=1.0, sd=0.4),
    "gumbel truncated": si.Gumbel(location=1.0, scale=0.3, high=1.5),
    "frozen": si.Frozen(scipy.stats.triang(0.4, 1.0, 2.0), unit="mm"),
    "frozen truncated": si.Frozen(scipy.stats.t(4.0), low=-1.0, high=2.0),
}


@pytest.mark.parametrize("marginal", MARGINALS.values(), ids=MARGINALS.keys())
class TestEveryMarginal:
    def points(self, marginal):
        return marginal.quantile(np.linspace(0.02, 0.98, 25))

    def test_quantiles_are_those_of_scipy(self, marginal):
        p = np.concatenate([np.random.default_rng(0).random(200), [0.0, 1e-300, 1e-16, 0.5, 1.0 - 1e-16, 1.0]])
        base, low, high = marginal.base, marginal.low, marginal.high
        mass = max(base.cdf(high) - base.cdf(low), base.sf(low) - base.sf(high))
        below, above = base.cdf(low) + p * mass, base.sf(high) + (1.0 - p) * mass
        y = np.where(below < 0.5, base.ppf(below.clip(0.0, 1.0)), base.isf(above.clip(0.0, 1.0))).clip(low, high)
        np.testing.assert_allclose(marginal.quantile(p), y * si_factor(marginal.unit), rtol=1e-14)

    def test_quantile_inverts_the_cdf(self, marginal):
        p = np.array([1e-6, 0.01, 0.3, 0.77, 0.999])
        np.testing.assert_allclose(marginal.cdf(marginal.quantile(p)), p, rtol=1e-7)

    def test_density_integrates_to_the_cdf(self, marginal):
        low, high = marginal.quantile(np.array([0.1, 0.8]))
        area, _ = scipy.integrate.quad(
            lambda x: float(np.exp(marginal.log_density(np.array(x)))), low, high, epsabs=1e-11
        )
        assert area == pytest.approx(0.7, abs=1e-7)

    def test_jax_agrees_with_scipy(self, marginal):
        x = self.points(marginal)
        np.testing.assert_allclose(
            marginal.jax_log_density(jax.numpy.asarray(x)), marginal.log_density(x), rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(marginal.jax_cdf(jax.numpy.asarray(x)), marginal.cdf(x), rtol=1e-7, atol=1e-9)

    def test_gradient_agrees_with_differences(self, marginal):
        x = float(marginal.quantile(np.array(0.37)))
        h = 1e-6 * marginal.moments[1]
        exact = float(jax.grad(marginal.jax_log_density)(x))
        numeric = float(marginal.log_density(np.array(x + h)) - marginal.log_density(np.array(x - h))) / (2 * h)
        assert exact == pytest.approx(numeric, rel=1e-4, abs=1e-4 / marginal.moments[1])

    def test_nothing_outside_the_support(self, marginal):
        low, high = marginal.support
        for edge, step in ((low, -1.0), (high, 1.0)):
            if np.isfinite(edge):
                outside = edge + step * 1e-3 * marginal.moments[1]
                assert marginal.log_density(np.array(outside)) == -np.inf
                assert float(marginal.jax_log_density(outside)) == -np.inf
                assert np.isfinite(jax.grad(marginal.jax_log_density)(outside))

    def test_moments(self, marginal):
        u = (np.arange(200_000) + 0.5) / 200_000
        x = marginal.quantile(u)
        mean, sd = marginal.moments
        assert mean == pytest.approx(x.mean(), abs=2e-4 * sd)
        assert sd == pytest.approx(x.std(), rel=3e-3)


def test_given_moments_are_the_moments():
    for make in (si.LogNormal, si.Gamma, si.Weibull, si.Gumbel):
        np.testing.assert_allclose(make(mean=2.0, sd=0.7).moments, (2.0, 0.7), rtol=1e-9)
    np.testing.assert_allclose(si.Beta(mean=0.3, sd=0.1).moments, (0.3, 0.1), rtol=1e-12)


def test_units_become_si_at_the_border():
    assert si.Normal(7.42, 0.742, unit="kN/mm").moments == pytest.approx((7.42e6, 0.742e6))


@pytest.mark.parametrize(
    "make",
    [
        lambda: si.Uniform(2.0, 1.0),
        lambda: si.Normal(0.0, -1.0),
        lambda: si.Normal(0.0, 1.0, low=3.0, high=2.0),
        lambda: si.Normal(7.42, 0.1, low=9.0, unit="kN/mm"),
        lambda: si.LogNormal(mean=1.0),
        lambda: si.LogNormal(mean=1.0, sd=1.0, log_sd=1.0),
        lambda: si.Gamma(mean=1.0, sd=1.0, shape=1.0),
        lambda: si.Beta(mean=0.5, sd=0.6),
        lambda: si.Normal(0.0, 1.0, unit="bananas"),
        lambda: si.Frozen(3.0),
    ],
)
def test_bad_marginals_are_refused(make):
    with pytest.raises(InputError, match="Expected"):
        make()


def test_a_truncation_to_nothing_says_so():
    with pytest.raises(InputError, match=r"contains .* of the distribution with mean 7.42"):
        si.Normal(7.42, 0.1, low=9.0)


def test_a_prior_is_printed_as_it_was_given():
    """NumPyro's words for it, a location and a scale of the logarithm, have no unit kN/mm."""
    assert str(si.LogNormal(7.4, 0.7, unit="kN/mm")) == "LogNormal(mean 7.4, sd 0.7) kN/mm"
    assert str(si.Normal(7.4, 0.7, low=5.0, unit="kN/mm")) == "Normal(mean 7.4, sd 0.7), truncated to [5, ∞) kN/mm"
    assert str(si.Uniform(1.0, 2.0)) == "Uniform(low 1, high 2)"
