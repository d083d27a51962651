"""The source's façade against the numbers of an independent program: 15 blocks, 34 joints, El Centro."""

import numpy as np
import pytest

import structid as si
from structid.fem.assembly import Assembly, Masonry
from structid.fem.dense_newton import DenseWall, simulate
from structid.fem.layout import Wall
from structid.fem.mesh import mesh_of
from structid.mechanics.cohesive_laws import cohesive_law, smc_np2

ASSEMBLY = Assembly(mesh_of(Wall()), Masonry())
POINTS = {"A": (5.5e3, 1.05e6, 4e5, 2e6), "B": (3e3, 0.95e6, 2e5, 0.6e6), "C": (2e3, 1.2e6, 1e5, 3.5e6)}
"""φ_n, σ_max, φ_t, τ_max."""
FREQUENCIES = {
    "A": [2.6324123, 9.6974861, 16.558231, 17.868974, 19.916344],
    "B": [1.3092463, 4.8143597, 8.4348913, 16.241278, 20.220876],
    "C": [6.2882386, 20.022010, 26.556396, 33.590572, 41.809032],
}
RAYLEIGH = {"A": [0.85626746, 4.9760168e-4], "B": [0.42725638, 9.8000428e-4], "C": [1.9167472, 2.9074144e-4]}
STATIC = {
    "A": [-0.131423, -2.588060, -2.124898], "B": [-0.0313252, -1.841989, -1.557016], "C": [-0.0745278, -1.085139, -0.931004],
}  # fmt: skip
"""[mm] of the top left corner, horizontally and vertically, and of the top right one vertically."""
AFTER_A_SECOND = {
    "A": [1.875561, -2.389612, -2.293688], "B": [-63.806148, -3.219972, -0.300951], "C": [2.145689, -0.549373, -1.376701],
}  # fmt: skip


def wall(name):
    law = cohesive_law(*POINTS[name])
    return DenseWall(ASSEMBLY, lambda opening, slip: smc_np2(law, opening, slip))


def corners(u):
    """[mm]."""
    left, right = (ASSEMBLY.mesh.corner(name) for name in ("top_left", "top_right"))
    return 1e3 * u[..., [ASSEMBLY.dof(left, 0), ASSEMBLY.dof(left, 1), ASSEMBLY.dof(right, 1)]]


def base_motion(folder):
    record = si.GroundMotion.read(folder / "RSN6_IMPVALL.I_I-ELC180.AT2").lowpass(20.0, order=3)
    record = record.scale_to_pga(6.36).trim(1.0, 3.5)
    time = 1e-3 * np.arange(2501)
    return np.interp(time, record.time, record.values)


@pytest.mark.parametrize("name", POINTS)
def test_the_loaded_wall(name):
    loaded = wall(name).loaded()
    np.testing.assert_allclose(corners(loaded), STATIC[name], atol=1.5e-6)
    np.testing.assert_allclose(wall(name).frequencies(loaded)[:5], FREQUENCIES[name], rtol=5e-8)
    np.testing.assert_allclose(wall(name).rayleigh(loaded, 0.03), RAYLEIGH[name], rtol=5e-8)


def test_the_base_motion(strong_motion):
    base = base_motion(strong_motion)
    assert 1e-3 * np.sum(base**2) == pytest.approx(12.570778, rel=1e-7)
    assert base[0] == pytest.approx(-0.0489, abs=1e-6) and np.argmax(np.abs(base)) == 1180


@pytest.mark.parametrize("name", [pytest.param("A", id="A"), *(pytest.param(n, marks=pytest.mark.slow) for n in "BC")])
def test_the_first_second(name, strong_motion):
    history = simulate(wall(name), base_motion(strong_motion)[:1001], 1e-3)
    assert history.converged
    np.testing.assert_allclose(corners(history.u[-1]), AFTER_A_SECOND[name], atol=1e-6)
