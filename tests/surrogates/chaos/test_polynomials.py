"""Families of polynomials are orthonormal under their marginals; sets of multi-indices are what they say."""

import math

import numpy as np
import pytest
import scipy.special
import scipy.stats

import structid as si
from structid.core.errors import InputError
from structid.surrogates.chaos.isoprobabilistic_transform import standard_normal
from structid.surrogates.chaos.multi_indices import multi_indices
from structid.surrogates.chaos.orthogonal_polynomials import OrthonormalFamily, lanczos_recurrence
from structid.surrogates.chaos.polynomial_basis import PolynomialBasis
from structid.surrogates.chaos.shrinkage import weighted_indices

MARGINALS = {
    "uniform": (si.Uniform(2.0, 5.0), "Legendre"),
    "normal": (si.Normal(3.0, 2.0), "Hermite"),
    "lognormal": (si.LogNormal(mean=2.0, sd=0.5, unit="kN"), "Hermite"),
    "gamma": (si.Gamma(mean=3.0, sd=1.0, unit="mm"), "Laguerre"),
    "beta": (si.Beta(mean=0.3, sd=0.1), "Jacobi"),
    "beta_percent": (si.Beta(a=2.0, b=5.0, unit="%"), "Jacobi"),
    "weibull": (si.Weibull(mean=3.0, sd=1.0), "numerical"),
    "gumbel": (si.Gumbel(mean=3.0, sd=1.0), "numerical"),
    "truncated_normal": (si.Normal(0.0, 1.0, low=-1.0, high=2.5), "numerical"),
    "truncated_lognormal": (si.LogNormal(mean=2.0, sd=0.5, high=2.5), "numerical"),
    "frozen": (si.Frozen(scipy.stats.triang(0.5, 2.0, 1.0)), "numerical"),
}


def quantile_rule(marginal, nodes=4000):
    """Nodes and weights of an integral over a distribution, through its quantile function."""
    x, w = scipy.special.roots_legendre(nodes)
    angle = 0.25 * np.pi * (x + 1)
    return marginal.quantile(np.sin(angle) ** 2), 0.25 * np.pi * w * np.sin(2 * angle)


@pytest.mark.parametrize("name", MARGINALS)
def test_a_family_is_orthonormal_under_its_marginal(name):
    marginal, kind = MARGINALS[name]
    family = OrthonormalFamily.of(marginal, 5)
    assert family.name == kind
    x, w = quantile_rule(marginal)
    values = np.array(family.evaluate(x, 5))
    # Unbounded tails are cut at the last node of the rule; that is what the tolerance is for.
    np.testing.assert_allclose((values * w) @ values.T, np.eye(6), atol=2e-4 if kind != "Legendre" else 1e-10)


def test_lanczos_finds_the_legendre_recurrence_at_high_degree():
    nodes, weights = scipy.special.roots_legendre(200)
    a, b = lanczos_recurrence(nodes, weights / 2, 60)
    n = np.arange(1, 61)
    np.testing.assert_allclose(a, 0.0, atol=1e-13)
    np.testing.assert_allclose(b, n / np.sqrt(4 * n**2 - 1), rtol=1e-12)


def test_multi_indices_count_and_truncate():
    assert len(multi_indices(4, 3)) == math.comb(7, 3)
    low = multi_indices(4, 21, interaction=2)
    assert len(low) == 1345 and (low > 0).sum(axis=1).max() == 2
    hyperbolic = multi_indices(4, 15, 0.5)
    assert len(hyperbolic) == 263
    assert (np.sum(np.sqrt(hyperbolic), axis=1) ** 2 <= 15 + 1e-9).all()
    np.testing.assert_array_equal(low[0], 0)
    with pytest.raises(InputError, match="hyperbolic_norm"):
        multi_indices(2, 3, 1.5)


def test_weighted_indices_are_closed_downwards():
    indices = weighted_indices(np.array([0.2, 0.7, 1.3]), 300)
    known = {tuple(i) for i in indices}
    assert len(known) == 300
    for index in indices:
        for j in np.flatnonzero(index):
            lower = index.copy()
            lower[j] -= 1
            assert tuple(lower) in known


def test_dependent_parameters_go_through_standard_normal_ones():
    space = si.ParameterSpace(correlation={("a", "b"): 0.7}, a=si.Normal(1.0, 2.0), b=si.Gamma(mean=2.0, sd=1.0))
    theta = space.sample(200_000, seed=1, method="sobol").values
    z = standard_normal(space, theta)
    np.testing.assert_allclose(np.cov(z.T), np.eye(2), atol=0.01)
    values = PolynomialBasis(space, multi_indices(2, 2)).evaluate(theta)
    np.testing.assert_allclose(values.T @ values / len(values), np.eye(6), atol=0.03)
    expansion = si.PCE(degree=2).fit(space.sample(60, seed=2), z[:60, 0] * 0 + theta[:60, 0] ** 2)
    with pytest.raises(InputError, match="correlated"):
        expansion.sobol_indices()
