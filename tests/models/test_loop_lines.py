"""Two lines through a loop."""

import numpy as np
import pytest

import structid as si
from oscillators import DEGRADING
from structid.models.loop_lines import two_lines


def test_two_lines_through_a_bilinear_loop():
    """An elastoplastic loop of known stiffnesses gives them back."""
    u = 0.02 * np.sin(np.linspace(0, 4 * np.pi, 4001))
    loop = si.BoucWen(
        mass=1.0, stiffness=7.6e6, alpha=0.06, beta=0.5 / 0.001**8, gamma=0.5 / 0.001**8, exponent=8.0, substeps=8
    )
    force = (
        loop.recording("restoring_force").simulate(np.zeros((1, 0)), si.DisplacementHistory(u, 0.01)).values[0, :, 0]
    )
    lines = two_lines(u, force, elastic=0.02)
    assert lines.initial_stiffness == pytest.approx(7.6e6, rel=1e-3)
    assert lines.alpha == pytest.approx(0.06, rel=1e-2)
    assert lines.yield_force == pytest.approx(0.94 * 7.6e6 * 0.001, rel=1e-2)
    lines.plot()


def test_prior_means_from_the_study_are_near_the_sources(record):
    """The source reads 7.42 kN/mm and α = 0.063 off its loop (figure 3.7); ours, of the same oscillator, is near."""
    strong = record.scale_to_pga(3.59)
    run = si.BoucWen(**DEGRADING, channels=("displacement", "restoring_force")).simulate(np.zeros((1, 0)), strong)
    lines = two_lines(*run.values[0].T)
    print(f"k_i {lines.initial_stiffness / 1e6:.2f} kN/mm, alpha {lines.alpha:.3f}")
    assert 6.0e6 < lines.initial_stiffness < 7.7e6
    assert 0.0 < lines.alpha < 0.3
