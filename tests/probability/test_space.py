"""Spaces: correlations, bijections, derived parameters, and the way to plain words and back."""

import jax
import numpy as np
import pytest
import scipy.integrate
import scipy.stats

import structid as si
from structid.core.errors import InputError
from structid.engine.device import jnp


def correlated():
    return si.ParameterSpace(
        correlation={("a", "b"): 0.7, ("b", "c"): -0.3},
        a=si.Normal(1.0, 2.0),
        b=si.LogNormal(mean=1.0, sd=0.4),
        c=si.Uniform(0, 1),
    )


def test_copula_has_its_correlation_and_keeps_the_marginals():
    space = correlated()
    theta = space.sample(2**15, seed=3, method="sobol").values
    normal = scipy.stats.norm.ppf(space.cdf(theta))
    expected = np.array([[1, 0.7, 0], [0.7, 1, -0.3], [0, -0.3, 1]])
    np.testing.assert_allclose(np.corrcoef(normal.T), expected, atol=5e-3)
    for i, marginal in enumerate(space.marginals.values()):
        assert scipy.stats.kstest(theta[:, i], marginal.cdf).statistic < 5e-3


def test_copula_density_integrates_to_one():
    space = si.ParameterSpace(correlation=np.array([[1, 0.6], [0.6, 1]]), a=si.Uniform(0, 2), b=si.Uniform(0, 1))
    u = (np.arange(1200) + 0.5) / 1200
    grid = np.stack(np.meshgrid(2 * u, u), axis=-1).reshape(-1, 2)
    assert np.exp(space.log_density(grid)).mean() * 2.0 == pytest.approx(1.0, abs=2e-3)


def test_jax_density_agrees_with_numpy_and_rosenblatt_inverts():
    space = correlated()
    theta = space.sample(50, seed=1).values
    np.testing.assert_allclose(space.jax_log_density(jnp.asarray(theta)), space.log_density(theta), rtol=1e-8)
    np.testing.assert_allclose(space.from_uniform(space.to_uniform(theta)), theta, rtol=1e-7)


def test_bijection_and_its_jacobian(study_space):
    theta = study_space.sample(20, seed=1).values
    phi = study_space.bijection.inverse(theta)
    again, log_jacobian = study_space.bijection(phi)
    np.testing.assert_allclose(again, theta, rtol=1e-10)
    exact = jax.vmap(jax.jacfwd(lambda p: study_space.bijection.forward(p)[0]))(phi)
    np.testing.assert_allclose(log_jacobian, np.log(np.abs(np.linalg.det(np.asarray(exact)))), rtol=1e-9)


def test_derived_parameters():
    space = si.ParameterSpace(
        derived={"gamma": "gamma_ratio * beta", "twice": lambda p: 2 * p["gamma"]},
        beta=si.Uniform(55, 65),
        gamma_ratio=si.Uniform(-1, 1),
    )
    design = space.sample(10, seed=1)
    np.testing.assert_allclose(design.columns(["gamma"])[:, 0], design.values[:, 0] * design.values[:, 1])
    np.testing.assert_allclose(design.columns(["twice", "beta"])[:, 0], 2 * design.values[:, 0] * design.values[:, 1])
    with pytest.raises(InputError, match="Did you mean 'beta'"):
        si.ParameterSpace(derived={"gamma": "gamma_ratio * betta"}, beta=si.Uniform(0, 1), gamma_ratio=si.Uniform(0, 1))
    with pytest.raises(InputError, match="functions of one argument"):
        si.ParameterSpace(derived={"g": "__import__('os').getcwd()"}, beta=si.Uniform(0, 1))


def test_contradictory_correlations_are_refused():
    with pytest.raises(InputError, match="positive definite"):
        si.ParameterSpace(
            correlation={("a", "b"): 0.9, ("b", "c"): 0.9, ("a", "c"): -0.9},
            a=si.Uniform(0, 1),
            b=si.Uniform(0, 1),
            c=si.Uniform(0, 1),
        )


def test_a_space_comes_back_from_its_plain_words(study_space):
    import json

    space = si.ParameterSpace(
        correlation={("a", "b"): 0.3},
        derived={"c": "a * b"},
        a=si.Gamma(mean=2, sd=1, unit="mm"),
        b=si.Weibull(mean=3, sd=1, high=9),
        d=si.Gumbel(mean=0, sd=1),
        e=si.Beta(mean=0.3, sd=0.1),
        f=si.Uniform(-1, 1),
    )
    for one in (space, study_space):
        again = si.ParameterSpace.from_plain(json.loads(json.dumps(one.to_plain())))
        assert again.content_hash == one.content_hash
        np.testing.assert_array_equal(again.sample(9, seed=1).values, one.sample(9, seed=1).values)


def test_a_correlation_beyond_one_is_named_with_its_pair():
    with pytest.raises(InputError, match=r"correlation of a and b: 2.0. Expected: a number between -1 and 1"):
        si.ParameterSpace(correlation={("a", "b"): 2.0}, a=si.Normal(0.0, 1.0), b=si.Normal(0.0, 1.0))


@pytest.mark.parametrize(("low", "high", "cure"), [(2.0, 1.0, "Exchange"), (1.0, 1.0, "known value to the model")])
def test_bounds_out_of_order_have_their_cure(low, high, cure):
    for prior in (lambda: si.Uniform(low, high), lambda: si.Normal(1.5, 1.0, low=low, high=high)):
        with pytest.raises(InputError, match=cure):
            prior()


def test_a_list_of_priors_is_no_empty_space():
    with pytest.raises(InputError, match=r"not a dictionary of priors.*priors by name"):
        si.ParameterSpace([si.Normal(0.0, 1.0)])


def test_parameters_may_have_the_names_of_arguments():
    names = ("derived", "correlation", "coordinates")
    space = si.ParameterSpace(
        dict.fromkeys(names, si.Normal(1.0, 0.1)),
        correlation={("derived", "coordinates"): 0.4},
        stiffness=si.Uniform(1, 2),
    )
    assert space.names == (*names, "stiffness") and space.correlation[0, 2] == 0.4
    again = si.ParameterSpace.from_plain(space.to_plain())
    assert again.content_hash == space.content_hash and again.names == space.names
    assert space.extended(noise=si.Uniform(0, 1)).names == (*names, "stiffness", "noise")
    with pytest.raises(si.InputError, match=r"ParameterSpace\(derived\): a prior.*in a dictionary"):
        si.ParameterSpace(derived=si.Normal(1.0, 0.1))
    with pytest.raises(si.InputError, match="the name 'a' twice"):
        si.ParameterSpace({"a": si.Normal(1.0, 0.1)}, a=si.Normal(1.0, 0.1))
    with pytest.warns(DeprecationWarning, match="correlation="):
        earlier = si.ParameterSpace({("a", "b"): 0.3}, a=si.Normal(1.0, 0.1), b=si.Normal(1.0, 0.1))
    assert earlier.correlation[0, 1] == 0.3


def test_the_order_of_priors_is_the_order_of_columns():
    assert si.ParameterSpace({"b": si.Uniform(0, 1), "a": si.Uniform(0, 1)}, c=si.Uniform(0, 1)).names == (
        "b",
        "a",
        "c",
    )
