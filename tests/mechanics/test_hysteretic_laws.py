"""Hysteretic laws: closed forms, exact moves, orders of convergence, passivity."""

import numpy as np
import pytest

from law_paths import CYCLES, forces_along, path_between, random_ends, random_values, typical
from structid.mechanics.hysteretic_laws.law_list import LAWS

EXACT = [word for word, law in LAWS.items() if np.isinf(law.accurate_move)]
PASSIVE = [word for word, law in LAWS.items() if law.dissipative]


def test_a_name_has_one_unit_in_all_laws():
    units = {}
    for law in LAWS.values():
        for name, described in law.parameters().items():
            assert units.setdefault(name, described.unit) == described.unit, name


@pytest.mark.parametrize("word", EXACT)
def test_a_polygonal_law_is_exact_for_a_move_of_any_length(word):
    # Deterioration uses the trapezoidal rule for the energy; without it the Ibarra laws are exact, too.
    drawn = random_values(LAWS[word], 40, without="deterioration")
    neutral = {name: 0.0 for name in LAWS[word].parameters() if name.endswith("deterioration")}
    law, ends = LAWS[word]().with_values(drawn | neutral), random_ends(40)
    fine = forces_along(law, path_between(ends, 16))
    np.testing.assert_allclose(forces_along(law, ends), fine[15::16], atol=1e-9 * np.abs(fine).max())


@pytest.mark.parametrize(
    ("word", "order", "smooth"),
    [
        ("bouc_wen", 3.5, {"exponent": 2.0, "asymmetry": 1.0}),
        ("slip_lock", 0.9, {}),
        ("masing", 0.7, {}),
        ("masing_flag", 0.7, {}),
    ],
)
def test_other_laws_converge_with_shorter_moves(word, order, smooth):
    def errors(law, *counts):
        exact = forces_along(law, path_between(CYCLES, 1024))
        coarse = {pieces: forces_along(law, path_between(CYCLES, pieces)) for pieces in counts}
        scale = np.abs(exact).max()
        return [np.abs(force - exact[1024 // n - 1 :: 1024 // n]).max() / scale for n, force in coarse.items()]

    wide, narrow = errors(typical(word, **smooth), 64, 256)
    assert np.log2(wide / narrow) / 2.0 > order
    # A test with full cycles is divided into moves of this length.
    divided = 2 ** int(np.ceil(np.log2(2.0 / LAWS[word].accurate_move)))
    assert errors(typical(word), divided)[0] < 0.01


@pytest.mark.parametrize("word", PASSIVE)
def test_no_path_gives_more_energy_than_it_took(word):
    """The work on a spring that starts at rest is never negative: 50 springs with random parameters, 1000 random cycles."""
    law = LAWS[word]().with_values(random_values(LAWS[word], 50))
    path = path_between(random_ends(50, 40), 60)
    force = forces_along(law, path)
    work = np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(path, axis=0), axis=0)
    assert (work.min(axis=0) > -0.01 * work.max(axis=0)).all()


def test_a_law_that_makes_energy_is_found():
    """With γ > β the Bouc-Wen law's loops turn backwards."""
    law = typical("bouc_wen", gamma_ratio=-3.0, exponent=1.0, zeta0=0.0, delta_nu=0.0, delta_eta=0.0)
    path = path_between(np.tile([0.05, -0.05], 40) * 0.2, 60)
    force = forces_along(law, path)
    work = np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(path))
    assert work.min() < -0.02 * np.abs(work).max()


def test_elastic_plastic_is_bilinear_without_hardening():
    path = path_between(CYCLES, 8)
    np.testing.assert_array_equal(
        forces_along(typical("elastic_plastic"), path), forces_along(typical("bilinear", hardening=0.0), path)
    )


def test_bilinear_energy_of_a_cycle():
    """A cycle of amplitude a dissipates 4 (1 − b) F_y (a − u_y)."""
    law = typical("bilinear", asymmetry=1.0)
    path = path_between(np.array([0.5, -0.5, 0.5]), 200)
    force = forces_along(law, path)
    cycle = slice(199, None)
    dissipated = np.trapezoid(force[cycle], path[cycle])
    assert dissipated == pytest.approx(4.0 * 0.95 * 1.0 * (0.5 - 0.1), rel=1e-4)


def test_bouc_wen_closed_form():
    """First loading with n = 1: z = u_y (1 − e^(−d/u_y))."""
    law = typical("bouc_wen", exponent=1.0, hardening=0.0, zeta0=0.0, delta_nu=0.0, delta_eta=0.0)
    path = np.linspace(0.0, 0.5, 401)
    np.testing.assert_allclose(forces_along(law, path), 1.0 - np.exp(-path / 0.1), atol=1e-8)


def test_asymmetry_is_the_ratio_of_the_strengths():
    for word in ("bouc_wen", "slip_lock"):
        law = typical(
            word,
            hardening=0.0,
            asymmetry=0.6,
            **(
                {"slip": 0.0, "pivot": 1e9, "energy_damage": 0.0}
                if word == "slip_lock"
                else {"zeta0": 0.0, "delta_nu": 0.0, "delta_eta": 0.0}
            ),
        )
        force = forces_along(law, path_between(np.array([3.0, -3.0]), 4000))
        assert force.min() / force.max() == pytest.approx(-0.6, rel=1e-6)


def test_slip_lock_nests_bouc_wen():
    """Without slip, pivot and damage, γ/β = (1 + g)/(1 − g)."""
    path, g = path_between(CYCLES, 400), 0.2
    smooth = typical("slip_lock", slip=0.0, pivot=1e12, energy_damage=0.0, exponent=1.5, unloading=g, asymmetry=0.8)
    bouc_wen = typical(
        "bouc_wen", gamma_ratio=(1.0 + g) / (1.0 - g), exponent=1.5, zeta0=0.0, delta_nu=0.0, delta_eta=0.0
    )
    np.testing.assert_allclose(forces_along(smooth, path), forces_along(bouc_wen, path), atol=1e-9)


def test_masing_flag_nests_masing():
    path = path_between(CYCLES, 50)
    both = typical("masing_flag", flag_share=0.0, peak_damage=0.05, energy_damage=0.03, asymmetry=1.0)
    np.testing.assert_allclose(forces_along(both, path), forces_along(typical("masing"), path), atol=1e-13)


def test_masing_backbone_and_doubled_branches():
    """First loading follows x/(1 + x^N)^(1/N) within the resolution of twenty elements; every branch is it, doubled."""
    law = typical("masing", peak_damage=0.0, energy_damage=0.0, sharpness=2.0)
    path = path_between(np.array([0.6, -0.6, 0.6]), 300)
    force = forces_along(law, path)
    first, down = path[:300], path[300:600]
    x = first / 0.2
    np.testing.assert_allclose(force[:300], 2.0 * x / np.sqrt(1.0 + x**2), atol=0.02)
    half = np.interp(0.5 * (0.6 - down), np.append(0.0, first), np.append(0.0, force[:300]))
    np.testing.assert_allclose(force[300:600], force[299] - 2.0 * half, atol=2e-3)


def test_ramberg_osgood_branches_are_doubled_and_inner_cycles_close():
    law = typical("ramberg_osgood")
    force = forces_along(law, np.array([0.3, 0.6, 0.2, 0.4, 0.2, 0.5, 0.6, 0.9, -0.9]))

    def deformation(f):
        return f / 10.0 + 0.5 * 0.1 * np.abs(f) ** 5 * np.sign(f)

    assert deformation(force[:2]) == pytest.approx([0.3, 0.6], rel=1e-12)
    # (d − d_r)/2 is the first curve of (f − f_r)/2.
    assert 0.6 + 2.0 * deformation(0.5 * (force[2] - force[1])) == pytest.approx(0.2, rel=1e-12)
    # The inner cycle 0.2, 0.4, 0.2 closes; beyond it the outer branch, at 0.6 the first curve again.
    assert force[4] == pytest.approx(force[2], rel=1e-12)
    assert force[6] == pytest.approx(force[1], rel=1e-12)
    assert deformation(force[7]) == pytest.approx(0.9, rel=1e-12)
    assert force[8] == pytest.approx(-force[7], rel=1e-12)


def test_voce_chaboche_closed_form():
    """First loading: f = F_y [1 + q (1 − e^(−b p))] + c/γ (1 − e^(−γ p)), with the plastic deformation p = d − f/k."""
    law = typical("voce_chaboche")
    for d in (0.2, 0.5, 3.0):
        force = forces_along(law, np.array([d]))[0]
        p = (d - force / 10.0) / 0.07
        expected = 0.7 * (1.0 + 0.3 * (1.0 - np.exp(-0.05 * p)) + 0.1 / 0.2 * (1.0 - np.exp(-0.2 * p)))
        assert force == pytest.approx(expected, rel=1e-10)


def test_self_centering_returns_to_its_origin():
    law = typical("self_centering")
    force = forces_along(law, np.array([0.5, 0.0, 0.5, 0.0, -0.4, 0.0]))
    assert force[[1, 3, 5]] == pytest.approx([0.0] * 3, abs=1e-12)
    assert force[0] == pytest.approx(1.0 + 0.05 * 10.0 * 0.4)
    assert force[4] == pytest.approx(-(0.9 + 0.05 * 10.0 * (0.4 - 0.09)))


def test_pivot_lines_pass_the_pivots():
    """Unloading aims at −α F_y on the elastic line, reloading at −β F_y, then at the largest deformation."""
    law = typical("pivot", asymmetry=1.0, hardening=0.0)
    d = np.array([0.5, 0.45, 0.4])
    first = forces_along(law, d)
    slope = (first[0] - first[1]) / 0.05
    assert first[0] - slope * (0.5 + 0.4) == pytest.approx(-4.0, rel=1e-9)
    # The first move to negative forces passes (−0.04, −0.4), where the elastic line has the pinching pivot.
    at_pivot = forces_along(law, np.array([0.5, -0.04]))[1]
    assert at_pivot == pytest.approx(-0.4, rel=1e-9)
    assert forces_along(law, np.array([0.5, -0.3]))[1] == pytest.approx(-1.0, rel=1e-9)


def test_a_deteriorated_spring_breaks_and_stays_broken():
    law = typical("ibarra_peak_oriented", strength_deterioration=0.03)
    force = forces_along(law, path_between(np.tile([1.0, -1.0], 20), 40))
    broken = int(np.argmax(force[200:] == 0.0)) + 200
    assert (force[broken + 40 :] == 0.0).all()
    assert np.isfinite(force).all()
