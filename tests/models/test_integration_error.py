"""The error of the integration: its size against many more steps, and the number of steps that is asked for."""

import numpy as np
import pytest

import structid as si
from oscillators import DEGRADING
from structid.models.integration_error import LIMIT, integration_error

NOTHING = np.zeros((1, 0))


def error_of(model, record, substeps):
    """Largest error in parts of the peak, against 64 times as many steps."""
    values = [model(n).simulate(NOTHING, record).values[0] for n in (substeps, 64 * substeps)]
    return np.abs(values[0] - values[1]).max() / np.abs(values[1]).max()


def oscillator(stiffness, beta=63.0):
    def of(substeps):
        changes = {"stiffness": stiffness, "beta": beta, "delta_nu": 0.0, "delta_eta": 0.0}
        return si.BoucWen(**DEGRADING | changes, substeps=substeps)

    return of


def test_the_default_is_good_for_the_benchmark(short_record):
    found = integration_error(oscillator(7.6e6)(3), NOTHING, short_record)
    assert found.error == pytest.approx(error_of(oscillator(7.6e6), short_record, 3), rel=0.2, abs=1e-9)
    assert not found.too_large and found.question == ""
    assert "With substeps = 3 the integration error is" in str(found)


@pytest.mark.parametrize(("stiffness", "substeps"), [(2e8, 1), (1e9, 1), (1e9, 2)])
def test_the_steps_that_are_asked_for_are_enough(short_record, stiffness, substeps):
    """Stiff structures: too few steps err by more than the limit or are not followed, and those that are named do not."""
    model = oscillator(stiffness)
    found = integration_error(model(substeps), NOTHING, short_record)
    assert found.too_large and found.wanted is not None, found
    assert f"substeps = {found.wanted} in [model]" in found.question
    assert error_of(model, short_record, found.wanted) < 1.2 * LIMIT
    assert found.wanted == 2 * substeps or not error_of(model, short_record, found.wanted // 2) < LIMIT


def test_what_no_steps_follow_is_said(short_record):
    found = integration_error(oscillator(1e13)(1), NOTHING, short_record)
    assert found.wanted is None and "Even 8 steps are not enough. Check priors, units and time step." in found.question


def test_a_frame_too_and_nothing_of_a_solver(short_record):
    frame = si.ShearFrame(
        storeys=2, mass=12e3, stiffness=2e9, alpha=0.1, beta=63.0, gamma_ratio=1.0, damping_ratio=0.03, substeps=1
    )
    found = integration_error(frame, NOTHING, short_record)
    assert found.too_large and (found.wanted or 0) > 1
    drifting = si.ImposedDisplacements(oscillator(7.6e6)(3))
    assert integration_error(drifting, NOTHING, short_record) is None
