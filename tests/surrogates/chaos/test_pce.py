"""Polynomial chaos: polynomials are recovered, indices and moments are those of closed forms, leave-one-out is what it says."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError


def polynomial(x):
    return 3.0 + x[:, 0] - 2 * x[:, 1] ** 2 + x[:, 0] * x[:, 1] * x[:, 2] + 0.5 * x[:, 2] ** 3


@pytest.mark.parametrize("method", ["sparse", "lars", "forward", "ols", "shrinkage"])
def test_a_polynomial_is_recovered(method):
    space = si.ParameterSpace(a=si.Uniform(-1.0, 2.0), b=si.Normal(0.0, 1.0), c=si.Gamma(mean=2.0, sd=1.0))
    expansion = si.PCE(degree=3, hyperbolic_norm=1.0, method=method).fit(
        design := space.sample(80, seed=1), polynomial(design.values)
    )
    other = space.sample(500, seed=2).values
    if method == "shrinkage":  # beyond the range of the design it stays at the edge
        low, high = design.values.min(axis=0), design.values.max(axis=0)
        other = other[((other > low) & (other < high)).all(axis=1)]
    scale = 1e-9 if method != "shrinkage" else 2e-2
    assert np.abs(expansion.predict(other)[:, 0] - polynomial(other)).max() < scale * np.abs(polynomial(other)).max()
    if method in ("sparse", "lars", "forward"):
        assert expansion.terms[0] <= 20


def ishigami(x):
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def test_sobol_indices_of_ishigami():
    """Closed forms of Ishigami & Homma 1990, N = 200, to 1e-3."""
    space = si.ParameterSpace(**{f"x{i}": si.Uniform(-np.pi, np.pi) for i in range(3)})
    design = space.sample(200, seed=1)
    expansion = si.PCE().fit(design, ishigami(design.values))
    b, a = 0.1 * np.pi**4, 7.0
    parts = {"1": 0.5 * (1 + b / 5) ** 2, "2": a**2 / 8, "13": b**2 * (1 / 18 - 1 / 50)}
    total = sum(parts.values())
    np.testing.assert_allclose(expansion.sobol_indices(1)[:, 0], [parts["1"] / total, parts["2"] / total, 0], atol=1e-3)
    np.testing.assert_allclose(
        expansion.sobol_indices("total")[:, 0],
        [(parts["1"] + parts["13"]) / total, parts["2"] / total, parts["13"] / total],
        atol=1e-3,
    )
    np.testing.assert_allclose(expansion.sobol_indices(2)[0, 2, 0], parts["13"] / total, atol=1e-3)
    np.testing.assert_allclose(expansion.variance, total, rtol=1e-3)
    np.testing.assert_allclose(expansion.mean, a / 2, rtol=1e-3)


def test_sobol_g_function():
    """g = Π (|4x − 2| + a)/(1 + a): first-order indices from the closed form, kinks and all."""
    a = np.array([1.0, 2.0, 5.0, 10.0])
    space = si.ParameterSpace(**{f"x{i}": si.Uniform(0.0, 1.0) for i in range(4)})
    design = space.sample(500, seed=1)
    values = np.prod((np.abs(4 * design.values - 2) + a) / (1 + a), axis=1)
    expansion = si.PCE(degree=range(2, 13), interaction=2).fit(design, values)
    first = 1 / (3 * (1 + a) ** 2)
    np.testing.assert_allclose(expansion.sobol_indices(1)[:, 0], first / (np.prod(1 + first) - 1), atol=0.02)


def test_borehole_validation_error():
    """N = 300, degree at most 4: error 1e-5 or less on 10⁴ points."""
    low = np.array([0.05, 100.0, 63070.0, 990.0, 63.1, 700.0, 1120.0, 9855.0])
    high = np.array([0.15, 50000.0, 115600.0, 1110.0, 116.0, 820.0, 1680.0, 12045.0])
    space = si.ParameterSpace(**{f"x{i}": si.Uniform(a, b) for i, (a, b) in enumerate(zip(low, high, strict=True))})

    def borehole(x):
        rw, r, tu, hu, tl, hl, length, kw = x.T
        ratio = np.log(r / rw)
        return 2 * np.pi * tu * (hu - hl) / (ratio * (1 + 2 * length * tu / (ratio * rw**2 * kw) + tu / tl))

    design, other = space.sample(300, seed=1), space.sample(10_000, seed=2, method="random").values
    expansion = si.PCE(degree=(2, 3, 4), hyperbolic_norm=1.0).fit(design, borehole(design.values))
    error = np.mean((expansion.predict(other)[:, 0] - borehole(other)) ** 2) / borehole(other).var()
    print(f"borehole: validation error {error:.1e}, leave-one-out {expansion.leave_one_out_error[0]:.1e}")
    assert error < 1e-5


def test_moments_of_a_shrunk_expansion_are_those_of_its_polynomial():
    space = si.ParameterSpace(a=si.Normal(1.0, 0.5), b=si.Uniform(0.0, 2.0))
    design = space.sample(150, seed=1, widen=1.3)
    values = np.sin(design.values[:, 0]) * np.exp(0.3 * design.values[:, 1])
    expansion = si.PCE(method="shrinkage").fit(design, values)
    many = expansion.predict(space.sample(2**16, seed=3, method="sobol").values)
    np.testing.assert_allclose(expansion.mean, many.mean(axis=0), rtol=2e-3)
    np.testing.assert_allclose(expansion.variance, many.var(axis=0), rtol=2e-2)


def test_moments_of_a_shrunk_expansion_with_a_lognormal_parameter():
    """f = a (1 + b): mean 1.5, variance E[a²] E[(1 + b)²] − 1.5², which its own logarithm must not spoil."""
    space = si.ParameterSpace(a=si.LogNormal(mean=1.0, sd=0.5), b=si.Uniform(0.0, 1.0))
    design = space.sample(200, seed=1, widen=1.5)
    expansion = si.PCE(method="shrinkage").fit(design, design.values[:, 0] * (1 + design.values[:, 1]))
    np.testing.assert_allclose(expansion.mean, 1.5, rtol=5e-3)
    np.testing.assert_allclose(expansion.variance, 1.25 * 7 / 3 - 1.5**2, rtol=3e-2)
    with pytest.raises(InputError, match="bootstrap"):
        expansion.bootstrap(3, seed=1)


def test_a_parameter_that_does_not_vary_is_no_trouble():
    space = si.ParameterSpace(a=si.Uniform(0.0, 1.0), b=si.Uniform(0.0, 1.0))
    values = space.sample(40, seed=1).values
    values[:, 1] = 0.5
    for method, limit in (("sparse", 0.05), ("shrinkage", 1e-2)):
        expansion = si.PCE(method=method, degree=3).fit(si.Design(values, space), np.sin(values[:, 0]))
        assert np.abs(expansion.predict(values)[:, 0] - np.sin(values[:, 0])).max() < limit


def test_bootstrap_spreads_as_theory_says():
    """Noise of known size: the bootstrap's standard deviation is σ/√N for orthonormal terms."""
    space = si.ParameterSpace(a=si.Uniform(-1.0, 1.0))
    design = space.sample(400, seed=1)
    rng = np.random.default_rng(3)
    expansion = si.PCE(degree=2, method="ols").fit(design, design.values[:, 0] + 0.1 * rng.normal(size=400))
    spread = expansion.bootstrap(200, seed=1).std(axis=0)[:, 0]
    np.testing.assert_allclose(spread, 0.1 / 20, rtol=0.3)


def test_predict_in_jax_and_its_gradient():
    import jax

    from structid.engine.device import jnp

    space = si.ParameterSpace(a=si.Normal(1.0, 0.5), b=si.LogNormal(mean=1.0, sd=0.2))
    design = space.sample(60, seed=1)
    expansion = si.PCE(degree=4).fit(design, np.sin(design.values).sum(axis=1))
    point = design.values[:3]
    np.testing.assert_allclose(expansion.predict(jnp.asarray(point)), expansion.predict(point), rtol=1e-12)
    slope = jax.grad(lambda t: expansion.predict(t[None])[0, 0])(jnp.asarray(point[0]))
    step = 1e-6
    for j in range(2):
        moved = point[0] + step * np.eye(2)[j]
        back = point[0] - step * np.eye(2)[j]
        difference = (expansion.predict(moved[None]) - expansion.predict(back[None]))[0, 0] / (2 * step)
        np.testing.assert_allclose(slope[j], difference, rtol=1e-6)


def test_what_a_fit_refuses():
    space = si.ParameterSpace(a=si.Uniform(0.0, 1.0), b=si.Uniform(0.0, 1.0))
    design = space.sample(20, seed=1)
    values = design.values.sum(axis=1)
    with pytest.raises(InputError, match="a Design"):
        si.PCE().fit(design.values, values)
    with pytest.raises(InputError, match="is 3 in every run"):
        si.PCE().fit(design, np.full(20, 3.0))
    with pytest.raises(InputError, match="not finite, the first is row 4"):
        si.PCE().fit(design, np.where(np.arange(20) == 4, np.nan, values))
    with pytest.raises(InputError, match=r"20 runs for a basis of 66 terms.*at least 67 runs"):
        si.PCE(degree=10, hyperbolic_norm=1.0, method="ols").fit(design, values)
    with pytest.raises(InputError, match="method"):
        si.PCE(method="magic")
