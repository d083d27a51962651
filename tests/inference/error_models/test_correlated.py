"""Correlated discrepancies beyond what every law keeps (`tests/seams`): determinants, gradients, posteriors that know them."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.inference.error_models.correlated import HUGE

DT = 0.05
CHANNELS = ("velocity",)


def test_a_smooth_law_whose_determinant_no_float_holds():
    import jax

    law = si.Matern32(white=0.0, correlation_time=10.0)
    residual = (
        si.Matern32(2.0, 0.0, 10.0).draw(np.random.default_rng(5), (2, 400, 1), {}, CHANNELS, DT).transpose(1, 2, 0)
    )
    unknown = {"sigma2": np.full(2, 2.0)}
    pointwise = np.asarray(law.pointwise(residual, unknown, CHANNELS, DT))
    found = np.asarray(law.log_likelihood(residual, unknown, CHANNELS, DT))
    np.testing.assert_allclose(found, pointwise.sum(axis=(0, 1)), rtol=1e-12)
    # Π S₁/S is beyond the largest float, about 1e308, and its factors are far from 1.
    whitened = np.asarray(law.whiten(residual, unknown, CHANNELS, DT))
    determinants = -2.0 * (found + 0.5 * (whitened**2).sum(axis=(0, 1))) - 400 * np.log(2.0 * np.pi)
    assert (400 * np.log(2.0) - determinants > 4 * np.log(HUGE)).all()
    # σ² scales the covariance and its white floor alike: d log L/dσ² = −(T − Σ v²/S)/(2σ²).
    slope = jax.grad(lambda v: law.log_likelihood(residual, {"sigma2": v}, CHANNELS, DT).sum())(unknown["sigma2"])
    np.testing.assert_allclose(slope, -(400 - (whitened**2).sum(axis=(0, 1))) / 4.0, rtol=1e-6)


def test_what_is_unknown_is_inferred_channel_by_channel():
    values = np.random.default_rng(3).normal(size=(200, 2))
    law = si.DampedCosine(damping=0.2, white=si.Uniform(0.0, 2.0))
    priors = law.parameters(values, ("velocity", "displacement"), 0.01, ("m/s", "m"))
    assert set(priors) == {
        f"{p}_{c}" for p in ("sigma2", "sigma2_white", "frequency") for c in ("velocity", "displacement")
    }
    low, high = priors["frequency_velocity"].quantile(np.array([0.025, 0.975]))
    assert low == pytest.approx(1.0, rel=1e-3) and high == pytest.approx(50.0, rel=1e-3)
    unknown = {n: np.full(3, 0.5) for n in priors}
    both = law.log_likelihood(np.ones((50, 2, 3)), unknown, ("velocity", "displacement"), 0.01)
    alone = si.DampedCosine(variance=0.5, white=0.5, frequency=0.5, damping=0.2)
    one = alone.log_likelihood(np.ones((50, 1, 3)), {}, ("velocity",), 0.01)
    np.testing.assert_allclose(both, 2.0 * np.asarray(one), rtol=1e-10)


def test_gradients_are_finite():
    import jax

    from structid.engine.device import jnp

    law = si.DampedCosine(damping=0.1, white=0.1)
    residual = jnp.asarray(np.random.default_rng(4).normal(size=(50, 1, 1)))

    def density(p):
        unknown = {"sigma2": p[:1], "frequency": p[1:2]}
        return law.log_likelihood(residual, unknown, CHANNELS, DT)[0]

    point = jnp.asarray([1.5, 2.0])
    slope = np.asarray(jax.grad(density)(point))
    for j in range(2):
        step = 1e-5 * np.eye(2)[j]
        np.testing.assert_allclose(slope[j], (density(point + step) - density(point - step)) / 2e-5, rtol=1e-4)


@pytest.mark.slow
def test_a_posterior_with_correlated_errors_is_wider_and_says_what_they_are():
    """AR(1) noise: the right law finds its time and is wider than the one that takes the errors for independent."""
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 11.0).scale_to_pga(2.0)
    space = si.ParameterSpace(stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"))
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=1.0, beta=1.0, gamma=0.0, free=space.names)
    clean = model.simulate(np.array([[7.2e6]]), record).values[0, :, 0]
    true = si.AR1(variance=float((0.2 * clean.std()) ** 2), white=0.0, correlation_time=0.1)
    noise = true.draw(np.random.default_rng(5), (1, len(record), 1), {}, CHANNELS, record.dt)[0, :, 0]
    measured = si.Observation(record, clean + noise)
    settings = si.SMC(particles=200, steps=20, effective_share=0.5, correlation=0.5)
    right = si.sample(si.Posterior(space, model, measured, si.AR1(white=1e-8)), settings, seed=1)
    wrong = si.sample(si.Posterior(space, model, measured), settings, seed=1)
    time = right.flat[:, right.names.index("correlation_time")]
    low, high = np.quantile(time, [0.005, 0.995])
    assert low < 0.1 < high
    assert right.sd[0] > 1.5 * wrong.sd[0]
    assert abs(right.mean[0] - 7.2e6) < 4 * right.sd[0]
    # The data prefer the law that made them, by far.
    assert right.log_evidence.value > wrong.log_evidence.value + 100
    prediction = right.predict(draws=20)
    assert np.isfinite(prediction.observable).all()


@pytest.mark.parametrize(
    ("law", "settings", "words"),
    [
        (si.AR1, dict(variance=-1.0), "positive number"),
        (si.DampedCosine, dict(damping=1.5), "below 1"),
        (si.Matern32, dict(correlation_time=0.0), "positive number"),
    ],
)
def test_laws_that_make_no_sense(law, settings, words):
    with pytest.raises(InputError, match=words):
        law(**settings)
