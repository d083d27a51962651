"""Cycles of a test: energy and equivalent damping in closed form, where cycles begin, and one direction only."""

import numpy as np
import pytest

import structid as si
from law_paths import path_between

STIFFNESS, FORCE = 20e6, 60e3
YIELD = FORCE / STIFFNESS


def elastic_plastic(path):
    model = si.Hysteretic("elastic_plastic", {"stiffness": STIFFNESS, "yield_force": FORCE})
    return model.simulate(np.zeros((1, 0)), si.DisplacementHistory(path, 1.0)).values[0, :, 0]


def test_energy_and_damping_of_an_elastic_plastic_spring():
    """E = 4 F_y (a − u_y); with k = F_y/a, ζ = E/(2π k a²) = 2/π (1 − 1/μ)."""
    amplitudes = np.repeat([2.0, 4.0, 8.0], 2) * YIELD
    ends = np.concatenate([[a, -a] for a in amplitudes] + [[0.0]])
    path = path_between(ends, 60)
    cycles = si.CyclicTest(path, elastic_plastic(path)).cycles
    # The second cycle of every amplitude is closed.
    second = slice(1, None, 2)
    ductility = amplitudes[second] / YIELD
    np.testing.assert_allclose(cycles.amplitude, amplitudes, rtol=1e-12)
    np.testing.assert_allclose(cycles.energy[second], 4.0 * FORCE * (amplitudes[second] - YIELD), rtol=2e-3)
    np.testing.assert_allclose(cycles.damping_ratio[second], 2.0 / np.pi * (1.0 - 1.0 / ductility), rtol=2e-3)
    np.testing.assert_allclose(cycles.stiffness, FORCE / amplitudes, rtol=1e-9)
    np.testing.assert_allclose(cycles.strength, [[-FORCE, FORCE]] * 6, rtol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_energies_of_the_cycles_are_the_work_of_the_test(sign):
    path = sign * path_between(np.array([0.01, -0.01, 0.02, -0.02, 0.03, -0.03, 0.0]), 50)
    test = si.CyclicTest(path, elastic_plastic(path))
    assert len(test.cycles.energy) == 3
    assert test.cycles.energy.sum() == pytest.approx(np.trapezoid(test.force, path), rel=1e-9)


@pytest.mark.parametrize("reversal", [(2e-4, -2e-4), (-2e-4, 2e-4)])
def test_a_small_reversal_near_zero_is_no_cycle(reversal):
    turns = (
        [0.01, -0.01, *reversal, 0.02, -0.02, 0.0] if reversal[0] > 0.0 else [0.01, *reversal, -0.01, 0.02, -0.02, 0.0]
    )
    path = path_between(np.array(turns), 50)
    cycles = si.CyclicTest(path, elastic_plastic(path)).cycles
    assert len(cycles.energy) == 2
    np.testing.assert_allclose(cycles.amplitude, [0.01, 0.02], rtol=1e-9)


def test_an_unfinished_cycle_is_left_out():
    path = path_between(np.array([0.01, -0.01, 0.02, -0.02, 0.03]), 50)
    assert len(si.CyclicTest(path, elastic_plastic(path)).cycles.energy) == 2


def test_cycles_in_one_direction_begin_at_their_troughs():
    path = path_between(np.array([0.01, 0.001, 0.02, 0.002, 0.03, 0.002]), 50)
    test = si.CyclicTest(path, elastic_plastic(path))
    cycles = test.cycles
    np.testing.assert_allclose(cycles.displacement[:, 1], [0.01, 0.02, 0.03], rtol=1e-9)
    assert (cycles.energy > 0.0).all()


def test_a_push_over_has_no_cycle():
    path = np.linspace(0.0, 0.03, 100)
    test = si.CyclicTest(path, elastic_plastic(path))
    assert len(test.cycles.energy) == 0
    assert str(test.cycles).startswith("cycle")
