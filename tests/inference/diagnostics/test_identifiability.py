"""Identifiability: information in closed form, and what the data cannot see."""

import numpy as np

import structid as si
from structid.inference.diagnostics.identifiability import identifiability


def test_fisher_information_is_the_curvature_of_a_linear_problem(short_record):
    """For a linear dependence on the parameter the Cramér-Rao bound is exact: sd² = σ²/Σ(∂y/∂θ)²."""
    space = si.ParameterSpace(initial_displacement=si.Normal(0.0, 0.01), initial_velocity=si.Normal(0.0, 0.1))
    model = si.BoucWen(
        mass=1.0,
        stiffness=630.0,
        damping_ratio=0.03,
        alpha=1.0,
        beta=0.0,
        gamma=0.0,
        free=space.names,
        channels=("displacement",),
    )
    quiet = si.GroundMotion(np.zeros(601), 0.01)
    base = model.simulate(np.array([[1.0, 0.0], [0.0, 1.0]]), quiet).values[:, :, 0]
    posterior = si.Posterior(space, model, si.Observation(quiet, base[0], ("displacement",)), si.IID(1e-6))
    found = identifiability(posterior, np.array([0.001, 0.01]))
    np.testing.assert_allclose(found.fisher, base @ base.T / 1e-6, rtol=1e-9)
    np.testing.assert_allclose(found.cramer_rao_sd, np.sqrt(np.diag(np.linalg.inv(found.fisher))), rtol=1e-6)
    assert found.unseen == []


def test_a_parameter_the_data_cannot_see_has_an_infinite_bound(short_record):
    """Mass and stiffness of a free oscillator enter as their ratio alone."""
    space = si.ParameterSpace(
        mass=si.Uniform(0.5, 2.0), stiffness=si.Uniform(300.0, 1300.0), damping_ratio=si.Uniform(0.01, 0.1)
    )
    model = si.BoucWen(alpha=1.0, beta=0.0, gamma=0.0, free=space.names, channels=("displacement",))
    posterior = si.Posterior(space, model, si.Observation(short_record, np.ones(601), ("displacement",)), si.IID(1e-6))
    found = identifiability(posterior, np.array([1.0, 630.0, 0.03]))
    assert np.isinf(found.cramer_rao_sd[:2]).all() and np.isfinite(found.cramer_rao_sd[2])
    assert len(found.unseen) == 1 and "mass" in found.unseen[0] and "stiffness" in found.unseen[0]
