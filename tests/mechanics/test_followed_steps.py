"""A step that is too long for the hysteretic law is seen: a run is right, or it says why it cannot be used."""

from itertools import pairwise

import numpy as np
import pytest

import structid as si
from structid.mechanics import moved_springs
from structid.mechanics.restoring_forces import HystereticSprings, spring_law
from structid.models.drifting_model import DriftingModel

SPRING = dict(mass=12e3, stiffness=7.6e6, alpha=0.05, gamma_ratio=0.5, damping_ratio=0.03)
RECORD = si.GroundMotion.synthetic(seed=8, duration=10.0).scale_to_pga(1.8)
NOTHING = np.zeros((1, 0))


def cycles(step, amplitude=0.05):
    """Three cycles of constant amplitude in equal steps [m]."""
    turning = amplitude * np.array([0.0, 1.0, -1.0, 1.0, -1.0, 1.0, 0.0])
    parts = [np.linspace(a, b, round(abs(b - a) / step) + 1)[1:] for a, b in pairwise(turning)]
    return si.DisplacementHistory(np.concatenate([[0.0], *parts]), 1.0, "cycles")


@pytest.mark.parametrize("exponent", [0.7, 1.0, 2.0])
@pytest.mark.parametrize("more", [{}, {"delta_nu": 0.5, "delta_eta": 0.2}], ids=["plain", "degrading"])
def test_an_imposed_displacement_is_followed_or_refused(exponent, more):
    """Against forty times as many steps. One model of free β, so that runs that are refused do not disturb the others."""
    betas = np.array([1000.0, 300.0, 100.0, 20.0])[:, None] ** exponent
    settings = {**SPRING, **more, "exponent": exponent, "free": ("beta",), "channels": ("restoring_force",)}
    refused = []
    for step in (0.01, 0.002):
        path = cycles(step)
        found = si.BoucWen(**settings).simulate(betas, path)
        exact = si.BoucWen(**settings, substeps=120 if step > 0.005 else 60).simulate(betas, path)
        assert exact.done.all()
        error = np.abs(found.values - exact.values)[:, :, 0].max(axis=1) / np.abs(exact.values).max(axis=(1, 2))
        assert (error[found.done] < 0.01).all(), error
        assert np.isnan(found.values[~found.done, -1]).all()
        refused += found.done.tolist()
        for run in np.flatnonzero(~found.done):
            assert "not finite" in found.reasons[run] or "use more substeps or a finer record" in found.reasons[run]
    assert 0 < sum(refused) < len(refused)


@pytest.mark.parametrize("mass", [12.0, 300.0, 12e3], ids=lambda mass: f"{mass:g} kg")
def test_under_a_record_a_run_is_right_or_refused(mass):
    """From soft to so stiff that a step is longer than the period. Right is: the peak of the exact solution, to 5 %."""
    stiffness, beta = np.meshgrid([7.6e5, 7.6e6, 2e8], [60.0, 2000.0, 60_000.0])
    theta = np.column_stack([stiffness.ravel(), beta.ravel()])
    settings = {**SPRING, "mass": mass, "free": ("stiffness", "beta")}
    settings.pop("stiffness")
    found = si.BoucWen(**settings).simulate(theta, RECORD)
    exact = si.BoucWen(**settings, substeps=200).simulate(theta, RECORD)
    both = found.done & exact.done
    peaks, right = np.abs(found.values[both]).max(axis=(1, 2)), np.abs(exact.values[both]).max(axis=(1, 2))
    np.testing.assert_allclose(peaks, right, rtol=0.05)
    assert both.any() and (not found.done.all() or mass == 12e3)
    assert exact.done.sum() > found.done.sum() or found.done.all()


def test_a_frame_whose_highest_mode_is_too_quick_is_refused():
    frame = dict(storeys=3, alpha=0.05, beta=200.0, gamma_ratio=0.5, damping_ratio=0.03, free=("mass", "stiffness"))
    theta = np.array([[1e3, 2e6], [1e3, 2e8]])
    coarse = si.ShearFrame(**frame, channels=("drift_1",)).simulate(theta, RECORD)
    fine = si.ShearFrame(**frame, channels=("drift_1",), substeps=20).simulate(theta, RECORD)
    assert coarse.done.tolist() == [True, False] and fine.done.all()
    assert "too long for the stiffness" in coarse.reasons[1] or "not finite" in coarse.reasons[1]
    np.testing.assert_allclose(coarse.values[0], fine.values[0], atol=2e-3 * np.abs(fine.values[0]).max())


def test_drifting_parameters_are_watched_too():
    space = si.ParameterSpace(stiffness=si.Normal(7.6e6, 1e5), beta=si.LogNormal(60.0, 3e4))
    settings = {**SPRING, "free": space.names}
    settings.pop("stiffness")
    model = DriftingModel(si.BoucWen(**settings), space, 3, 5.0)
    knots = np.zeros((2, len(model.free)))
    knots[:, :2] = [[7.6e6, 60.0], [7.6e6, 60_000.0]]
    run = model.simulate(knots, RECORD)
    assert run.done.tolist() == [True, False]


def test_a_posterior_counts_what_was_not_followed():
    """−inf, and a failed simulation: never the density of a history that is wrong."""
    space = si.ParameterSpace(beta=si.Uniform(20.0, 1e5))
    model = si.BoucWen(**{**SPRING, "free": space.names})
    measured = model.simulate([[60.0]], RECORD).values[0]
    posterior = si.Posterior(space, model, si.Observation(RECORD, measured), si.IID(variance=1e-4))
    theta = np.array([[60.0], [8e4]])
    assert np.isfinite(posterior.log_density(theta)).tolist() == [True, False]
    _, failed = posterior.evaluate(posterior.bijection.inverse(theta))
    assert failed.tolist() == [False, True]


LAW = dict(alpha=0.05, beta=1000.0, gamma=500.0)


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_a_long_move_of_a_spring_is_done_in_pieces(exponent):
    """Of a specimen or a numerical part, where one move may be many times as long as the law's length."""
    law = spring_law(**{**LAW, "beta": 1000.0**exponent, "gamma": 500.0**exponent}, exponent=exponent)
    springs = HystereticSprings([[1.0]], [7.6e6], [12e3], law)
    memory = springs.at_rest(np.zeros(1))
    slow = springs.at_rest(np.zeros(1))
    for place in (0.01, -0.01, 0.03, 0.0):
        force, memory = springs.at(memory, np.array([place]))
        for part in np.linspace(slow["d"][0], place, 2001)[1:]:
            exact, slow = springs.at(slow, np.array([part]))
        assert abs(force - exact)[0] < 1e-3 * 7.6e6 * 0.01 * 0.05, (place, force, exact)


@pytest.mark.parametrize("move", [1e4, 1e30, np.inf, np.nan])
def test_a_move_without_bound_is_not_followed(monkeypatch, move):
    """As in a virtual hybrid test that grows without bound: its pieces would never end."""
    taken, moved = [], moved_springs.moved
    monkeypatch.setattr(moved_springs, "moved", lambda *arguments: taken.append(1) or moved(*arguments))
    springs = HystereticSprings([[1.0]], [7.6e6], [12e3], spring_law(**LAW))
    with np.errstate(all="ignore"):
        force, _ = springs.at(springs.at_rest(np.zeros(1)), np.array([move]))
    assert np.isnan(force).all() and len(taken) == 1


def test_imposed_displacements_are_followed_or_refused():
    model = si.BoucWen(**{**SPRING, "free": ("beta",), "channels": ("restoring_force",)})
    path = cycles(0.01)
    few, many = (si.ImposedDisplacements(model, pieces=n).simulate([[1000.0], [20.0]], path) for n in (2, 100))
    assert few.done.tolist() == [False, True] and many.done.all()
    assert "use more pieces" in few.reasons[0]
    np.testing.assert_allclose(few.values[1], many.values[1], atol=1e-3 * np.abs(many.values[1]).max())
