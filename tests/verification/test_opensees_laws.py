"""Hysteretic laws against the uniaxial materials of OpenSees along one path: 1e-6 of the largest force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from law_paths import forces_along
from structid.mechanics.hysteretic_laws.law_list import LAWS

try:  # without the system's libblas the package is there, and raises a RuntimeError
    import openseespy.opensees as ops
except (ImportError, RuntimeError) as error:
    pytest.skip(f"OpenSeesPy cannot be imported: {error}", allow_module_level=True)

K, F_Y = 1e7, 4e4  # N/m, N
U_Y = F_Y / K
NEVER = 1e9
"""Reference deformation of a deterioration that is not wanted [m]."""
U_P, U_PC, CAP, RESIDUAL = 0.012, 0.15, 1.25, 0.2
IBARRA = {
    "capping_displacement": U_P,
    "post_capping_displacement": U_PC,
    "capping_ratio": CAP,
    "residual_ratio": RESIDUAL,
}
RATE = 0.01
MODES = ("strength", "capping", "reloading", "unloading")


def growing_cycles() -> np.ndarray:
    """A path [m] of growing cycles with inner cycles, to seven yield displacements."""
    rng = np.random.default_rng(3)
    ends = [0.0]
    for cycle in range(10):
        amplitude = U_Y * (1.0 + 0.7 * cycle)
        ends += [amplitude * rng.uniform(0.7, 1.0), -amplitude * rng.uniform(0.7, 1.0)]
        if cycle % 3 == 2:
            ends += [0.3 * amplitude, -0.1 * amplitude, 0.5 * amplitude, -0.9 * amplitude]
    return np.concatenate([np.linspace(a, b, 100)[1:] for a, b in itertools.pairwise(ends)])


def opensees(name: str, *arguments: float, path: np.ndarray) -> np.ndarray:
    """Stress of a uniaxial material along a path."""
    ops.wipe()
    ops.uniaxialMaterial(name, 1, *arguments)
    ops.testUniaxialMaterial(1)
    forces = []
    for strain in path:
        ops.setStrain(float(strain))
        forces.append(ops.getStress())
    return np.array(forces)


def difference(word: str, values: dict[str, float], material: tuple, path: np.ndarray) -> float:
    """Largest difference, relative to the largest force."""
    law = LAWS[word]().with_values({"stiffness": K, "yield_force": F_Y} | values)
    expected = opensees(*material, path=path)
    return float(np.abs(forces_along(law, path) - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize(
    ("word", "values", "material"),
    [
        ("elastic_plastic", {}, ("ElasticPP", K, U_Y)),
        ("bilinear", {"hardening": 0.05}, ("Steel01", F_Y, K, 0.05)),
        (
            "giuffre_menegotto_pinto",
            {"hardening": 0.03, "transition": 18.0, "transition_loss": 0.92, "transition_scale": 0.14},
            ("Steel02", F_Y, K, 0.03, 18.0, 0.92, 0.14),
        ),
        (
            "giuffre_menegotto_pinto",
            {"hardening": 0.03, "isotropic_hardening": 0.05},
            ("Steel02", F_Y, K, 0.03, 20.0, 0.925, 0.15, 0.05, 1.0, 0.05, 1.0),
        ),
        (
            "voce_chaboche",
            {
                "isotropic_hardening": 0.3,
                "isotropic_rate": 0.05,
                "kinematic_stiffness": 0.1,
                "kinematic_rate": 0.2,
                "second_stiffness": 0.02,
                "second_rate": 0.01,
            },
            ("UVCuniaxial", K, F_Y, 0.3 * F_Y, 0.05 / U_Y, 0.0, 1.0, 2, 0.1 * K, 0.2 / U_Y, 0.02 * K, 0.01 / U_Y),
        ),
    ],
)
def test_a_law_of_steel(word, values, material):
    assert difference(word, values, material, growing_cycles()) < 1e-6


def backbone() -> tuple[float, ...]:
    return (U_P, U_PC, 1e3, F_Y, CAP, RESIDUAL)


def references(mode: str | None) -> list[float]:
    """Reference deformations of the four modes of deterioration: E_ref/F_y = u_y/δ."""
    return [U_Y / RATE if name == mode else NEVER for name in MODES]


@pytest.mark.parametrize("mode", [None, *MODES])
def test_ibarra_medina_krawinkler(mode):
    values = IBARRA | ({f"{mode}_deterioration": RATE} if mode else {})
    common = (K, *backbone(), *backbone(), *references(mode), 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    path = growing_cycles()
    assert difference("ibarra_peak_oriented", values, ("IMKPeakOriented", *common), path) < 1e-6
    pinched = values | {"pinching_force": 0.4, "pinching_displacement": 0.5}
    assert difference("ibarra_pinching", pinched, ("IMKPinching", *common, 0.4, 0.5), path) < 1e-6


def test_a_wrong_rate_is_found():
    values = IBARRA | {"strength_deterioration": 1.001 * RATE}
    material = (K, *backbone(), *backbone(), *references("strength"), 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    assert difference("ibarra_peak_oriented", values, ("IMKPeakOriented", *material), growing_cycles()) > 1e-5


def test_self_centering_with_its_steps():
    """OpenSees passes the corners of the flag by whole steps, and goes on beside the line by k times the step."""
    values = {"hardening": 0.05, "flag_height": 0.7}

    def largest(pieces):
        ends = np.array([0.0, 0.6, -0.7, 0.3, -0.5, 0.6]) * 0.02
        path = np.concatenate([np.linspace(a, b, pieces)[1:] for a, b in itertools.pairwise(ends)])
        return difference("self_centering", values, ("SelfCentering", K, 0.05 * K, F_Y, 0.7), path)

    coarse, fine = largest(2001), largest(8001)
    assert fine < 0.35 * coarse
    assert fine < 6e-4
    first = np.linspace(0.0, 0.02, 401)
    assert difference("self_centering", values, ("SelfCentering", K, 0.05 * K, F_Y, 0.7), first) < 1e-6
