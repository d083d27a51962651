"""Bare log densities."""

import subprocess
import sys

import jax
import numpy as np
import pytest
import scipy

import structid as si
from structid.inference.sampling.transformed_target import TransformedTarget
from structid.inference.target import LogDensity


def test_bare_log_densities_numpy_and_jax_agree():
    bounds = {"b": (0.0, np.inf), "c": (-1.0, 2.0)}
    start = si.ParameterSpace(a=si.Normal(0, 1), b=si.Gamma(mean=2, sd=1), c=si.Uniform(-1, 2))

    def density(theta, numpy=np):
        return -0.5 * theta[..., 0] ** 2 - theta[..., 1] + numpy.log(theta[..., 1]) - theta[..., 2]

    host = LogDensity(density, "abc", start, bounds)
    device = LogDensity(lambda t: density(t, jax.numpy), "abc", start, bounds, backend="jax")
    phi = host.initial(6, np.random.default_rng(0))
    np.testing.assert_allclose(host.evaluate(phi)[0], device.evaluate(phi)[0], rtol=1e-10)
    broken = LogDensity(lambda t: np.full(len(t), np.nan), "abc", start)
    assert broken.evaluate(phi)[1].all() and (broken.evaluate(phi)[0] == -np.inf).all()


def test_variances_of_errors_are_compared_by_their_logarithms():
    """The model's own parameters as they are, and a variance of zero in floating point is a number."""
    record = si.GroundMotion.synthetic(seed=1, duration=2.0)
    space = si.ParameterSpace(stiffness=si.Uniform(1e6, 9e6))
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma_ratio=0.5, alpha=0.06, free=space.names)
    measured = si.Observation(record, record.acceleration)
    posterior = si.Posterior(space, model, measured, si.AR1())
    assert posterior.names[:2] == ("stiffness", "sigma2") and posterior.variances == {"sigma2", "sigma2_white"}
    theta = np.array([[[2e6, 4.0, 2.0, 0.5], [3e6, 0.0, 1.0, 0.5]]])
    found = posterior.compared(theta)
    np.testing.assert_array_equal(found[..., [0, 3]], theta[..., [0, 3]])
    np.testing.assert_allclose(found[0, :, 1:3], np.log([[4.0, 2.0], [np.finfo(float).tiny, 1.0]]))
    assert theta[0, 0, 1] == 4.0  # a copy
    assert posterior.compared_names == ("stiffness", "log sigma2", "log sigma2_white", *posterior.names[3:])


def test_a_density_in_the_coordinates_of_another():
    """The same density of θ, and the same prior, whose Jacobian alone has changed; and none outside its own support."""
    prior = si.ParameterSpace(a=si.Normal(0, 1), b=si.Gamma(mean=2, sd=1))

    def density(theta):
        with np.errstate(invalid="ignore"):
            return -0.5 * theta[:, 0] ** 2 - theta[:, 1] + np.log(theta[:, 1])

    own = LogDensity(density, "ab", prior, {"b": (0.0, np.inf)})
    other = LogDensity(density, "ab", prior, {"a": (-5.0, 5.0)})
    moved = TransformedTarget(own, other.bijection)
    phi = moved.initial(5, np.random.default_rng(0))
    theta, jacobian = other.bijection(phi)
    np.testing.assert_allclose(moved.evaluate(phi)[0], density(theta) + jacobian, rtol=1e-12)
    for found, expected in zip(moved.evaluate_parts(phi)[:2], other.evaluate_parts(phi)[:2], strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-10)
    outside = other.bijection.inverse(np.array([[0.5, -1.0]]))
    assert moved.evaluate(outside)[0] == -np.inf and moved.evaluate_parts(outside)[0] == -np.inf
    assert (
        own.bijection != other.bijection
        and own.bijection == LogDensity(density, "ab", prior, {"b": (0.0, np.inf)}).bijection
    )


FACTORISED = """
import jax.numpy as jnp, numpy as np, structid as si
points = jnp.linspace(0.0, 3.0, 12)
def density(x):
    covariance = jnp.exp(-((points[:, None] - points) / x[0]) ** 2) + x[1] * jnp.eye(12)
    factor = jnp.linalg.cholesky(covariance)
    return -jnp.log(jnp.diag(factor)).sum() - 0.5 * (jnp.linalg.solve(factor, jnp.sin(points)) ** 2).sum()
space = si.ParameterSpace(length=si.Uniform(0.1, 2.0), noise=si.Uniform(0.01, 1.0))
target = si.LogDensity(density, space.names, space, {n: m.support for n, m in space.marginals.items()}, backend="jax")
print(np.isfinite(target.evaluate_parts(target.initial(4000, np.random.default_rng(0)))[1]).all())
"""


def test_a_density_that_factorises_matrices_does_not_wait_for_ever():
    """LAPACK, called by two devices of one machine at once, waits for threads that the other holds."""
    done = subprocess.run([sys.executable, "-c", FACTORISED], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "True", done.stderr


def test_a_function_that_leaves_the_axis_of_a_single_point_out():
    """As SciPy's multivariate laws do."""
    law, space = scipy.stats.multivariate_normal(np.zeros(2)), si.ParameterSpace(a=si.Normal(0, 1), b=si.Normal(0, 1))
    target = LogDensity(law.logpdf, "ab", space)
    assert target.log_density(np.zeros((1, 2))).shape == target.evaluate(np.zeros((1, 2)))[0].shape == (1,)
    wrong = LogDensity(lambda theta: theta, "ab", space)
    with pytest.raises(si.InputError, match=r"shape \(3, 2\) for 3 points"):
        wrong.log_density(np.zeros((3, 2)))
