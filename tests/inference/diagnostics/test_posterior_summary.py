"""The table of a sampling, and the standard deviations of the errors beneath it."""

import numpy as np
import pytest

import structid as si

RECORD = si.GroundMotion(np.sin(np.linspace(0.0, 20.0, 201)), 0.05)


def oscillator(channels):
    return si.BoucWen(
        mass=12e3, stiffness=7.6e6, damping_ratio=0.03, beta=63.0, gamma_ratio=0.5, free=("alpha",), channels=channels
    )


@pytest.mark.parametrize(
    ("channels", "law", "units"),
    [
        (("velocity",), si.IID(), {"sigma2": "mm/s"}),
        (("displacement",), si.IID(variance=si.Uniform(0.0, 9.0, unit="mm^2")), {"sigma2": "mm"}),
        (("displacement",), si.AR1(), {"sigma2": "mm", "sigma2_white": "mm"}),
        (
            ("velocity", "absolute_acceleration"),
            si.IID(),
            {"sigma2_velocity": "mm/s", "sigma2_absolute_acceleration": "m/s^2"},
        ),
    ],
)
def test_errors_have_a_standard_deviation_in_the_unit_of_their_channel(channels, law, units):
    model = oscillator(channels)
    values = model.simulate(np.array([[0.06]]), RECORD).values[0]
    measured = values + 0.05 * values.std(axis=0) * np.random.default_rng(1).standard_normal(values.shape)
    space = si.ParameterSpace(alpha=si.Uniform(0.0, 0.2))
    posterior = si.Posterior(space, model, si.Observation(RECORD, measured, channels), law)
    assert posterior.sd_units == units
    result = si.sample(posterior, si.SMC(particles=40, steps=3), seed=1)
    found = {of.variance: of for of in result.summary().error_sds}
    for name, unit in units.items():
        draws = np.sqrt(result.flat[:, posterior.names.index(name)]) * (1e3 if "mm" in unit else 1.0)
        of = found[name]
        np.testing.assert_allclose([of.low, of.median, of.high], np.quantile(draws, [0.05, 0.5, 0.95]), rtol=5e-3)
        assert f"the root of {name}: {of.median:.3g} {unit}" in str(result)


def test_known_standard_deviations_leave_a_ratio():
    """Where the errors are measured in known standard deviations, theirs has no unit."""
    model = oscillator(("velocity",))
    values = model.simulate(np.array([[0.06]]), RECORD).values[0]
    posterior = si.Posterior(
        si.ParameterSpace(alpha=si.Uniform(0.0, 0.2)), model, si.Observation(RECORD, values, ("velocity",), sd=0.01)
    )
    assert posterior.sd_units == {"sigma2": ""}
