"""Cohesive laws: exact tangents, works in closed form, what the coupling is chosen for."""

import jax
import numpy as np
import pytest
from scipy.integrate import quad

from structid.engine.device import jnp
from structid.mechanics.cohesive_laws import DamageFriction, SmcNp2, cohesive_law

PHI_N, SIGMA, PHI_T, TAU = 5.5e3, 1.05e6, 4e5, 2e6
LAW = cohesive_law(PHI_N, SIGMA, PHI_T, TAU)
NOTHING = np.zeros((0, 1))


def smc_np2(law, opening, slip):
    return SmcNp2().respond(law, NOTHING, opening, slip)


FAR = 60.0
"""Lengths after which nothing is left of exp(−x)."""


def points(count=400):
    rng = np.random.default_rng(1)
    return rng.uniform(-1.0, 3.0, count) * LAW.normal_length, rng.uniform(-3.0, 3.0, count) * LAW.tangential_length


def test_tangents_are_derivatives():
    opening, slip = points()
    response, scales = smc_np2(LAW, opening, slip), (LAW.normal_length, LAW.tangential_length)
    for axis, letter in enumerate("nt"):
        step = 1e-5 * scales[axis] * np.eye(2)[axis]
        ahead, behind = (smc_np2(LAW, opening + s * step[0], slip + s * step[1]) for s in (1.0, -1.0))
        for force in ("normal", "tangential"):
            slope = (getattr(ahead, force) - getattr(behind, force)) / (2e-5 * scales[axis])
            exact = getattr(response, force[0] + letter)
            # Fourth derivatives, of up to exp(1.4) in closure, leave 1e-10 of a difference over 2e-5 lengths.
            np.testing.assert_allclose(slope, exact, rtol=1e-8, atol=2e-9 * np.abs(exact).max())


def test_jax_derives_the_same_tangents():
    opening, slip = points(50)
    response = smc_np2(LAW, opening, slip)

    def forces(jump):
        found = smc_np2(LAW, jump[0], jump[1])
        return jnp.stack([found.normal, found.tangential])

    slopes = jax.vmap(jax.jacfwd(forces))(jnp.stack([opening, slip], axis=1))
    exact = np.array([[response.nn, response.nt], [response.tn, response.tt]]).transpose(2, 0, 1)
    np.testing.assert_allclose(slopes, exact, rtol=1e-12, atol=1e-6)
    at_origin = np.asarray(jax.jacfwd(forces)(jnp.zeros(2)))
    np.testing.assert_allclose(at_origin, np.diag([LAW.normal_stiffness, LAW.tangential_stiffness]))


@pytest.mark.parametrize(("length", "factor"), [("exponential", 1.0), ("xu-needleman", 2.33164398)])
def test_work_of_separation_and_of_sliding(length, factor):
    law = cohesive_law(PHI_N, SIGMA, PHI_T, TAU, length)
    opened = quad(lambda d: smc_np2(law, d, 0.0).normal, 0.0, FAR * law.normal_length, limit=200)[0]
    slid = quad(lambda d: smc_np2(law, 0.0, d).tangential, 0.0, FAR * law.tangential_length, limit=200)[0]
    assert opened == pytest.approx(PHI_N, rel=1e-9) and slid == pytest.approx(factor * PHI_T, rel=1e-8)
    # The strengths are the peaks.
    lengths = np.linspace(0.5, 1.5, 2001)
    assert smc_np2(law, lengths * law.normal_length, 0.0 * lengths).normal.max() == pytest.approx(SIGMA, rel=1e-9)
    assert smc_np2(law, 0.0 * lengths, lengths * law.tangential_length).tangential.max() == pytest.approx(TAU, rel=1e-9)


@pytest.mark.parametrize("s", [0.0, 0.3, 1.0, 4.0])
def test_separate_then_slide_and_the_other_way_round(s):
    """φ_n + (φ_t − φ_n)(1 + s) e^(−s), and n and t exchanged."""
    d_n, d_t = LAW.normal_length, LAW.tangential_length
    opened = quad(lambda d: smc_np2(LAW, d, 0.0).normal, 0.0, s * d_n)[0]
    then_slid = quad(lambda d: smc_np2(LAW, s * d_n, d).tangential, 0.0, FAR * d_t, limit=200)[0]
    assert opened + then_slid == pytest.approx(PHI_N + (PHI_T - PHI_N) * (1.0 + s) * np.exp(-s), rel=1e-8)
    slid = quad(lambda d: smc_np2(LAW, 0.0, d).tangential, 0.0, s * d_t)[0]
    then_opened = quad(lambda d: smc_np2(LAW, d, s * d_t).normal, 0.0, FAR * d_n, limit=200)[0]
    assert slid + then_opened == pytest.approx(PHI_T + (PHI_N - PHI_T) * (1.0 + s) * np.exp(-s), rel=1e-8)


def test_equal_components_at_45_degrees():
    """Of equal energies and strengths, in separation; in over-closure they are not, whatever a and b."""
    law = cohesive_law(PHI_N, SIGMA, PHI_N, SIGMA)
    jump = np.linspace(0.01, 4.0, 50) * law.normal_length
    apart, closed = smc_np2(law, jump, jump), smc_np2(law, -jump, jump)
    np.testing.assert_allclose(apart.normal, apart.tangential, rtol=1e-12)
    assert (np.abs(closed.normal + closed.tangential) > 0.01 * np.abs(closed.tangential)).all()


@pytest.mark.parametrize(("x", "rho"), [(-0.6, 0.7), (-0.3, 0.35), (-1.0, 3.0)])
def test_a_closed_cycle_in_closure_may_create_energy(x, rho):
    """NP2 has no potential: around a rectangle in (Δ_n < 0, Δ_t) the work is φ_n I(x)(1 − e^(−aρ)) + φ_t I(ρ)(e^(−bx) − 1).

    I(x) = 1 − (1 + x) e^(−x), x = Δ_n/δ_n, ρ = Δ_t/δ_t, a = b = √2 − 1. As far as the façade's joints go (0.6 δ_n, 0.7 δ_t) it is
    three times φ_n; one way round it is created, the other way it is lost.
    """
    d_n, d_t = LAW.normal_length, LAW.tangential_length
    s, r, coupling = x * d_n, rho * d_t, np.sqrt(2.0) - 1.0
    around = (
        quad(lambda d: smc_np2(LAW, d, 0.0).normal, 0.0, s)[0]
        + quad(lambda d: smc_np2(LAW, s, d).tangential, 0.0, r)[0]
        + quad(lambda d: smc_np2(LAW, d, r).normal, s, 0.0)[0]
        + quad(lambda d: smc_np2(LAW, -0.0, d).tangential, r, 0.0)[0]
    )

    def work(z):
        return 1.0 - (1.0 + z) * np.exp(-z)

    expected = PHI_N * work(x) * (1.0 - np.exp(-coupling * rho)) + PHI_T * work(rho) * (np.exp(-coupling * x) - 1.0)
    assert around == pytest.approx(expected, rel=1e-7)
    if (x, rho) == (-0.6, 0.7):
        assert 3.0 < around / PHI_N < 3.5


# --- damage and friction ----------------------------------------------------------------------------------------------

MORTAR = cohesive_law(10.0, 0.2e6, 100.0, 0.25e6, friction=0.7)
DAMAGING = DamageFriction()


def walked(openings, slips, law=MORTAR):
    """Tractions along a path, and what is remembered at its end."""
    memory, tractions = np.zeros((2, *np.shape(openings)[1:])), []
    for opening, slip in zip(openings, slips, strict=True):
        response = DAMAGING.respond(law, memory, opening, slip)
        memory = DAMAGING.remembered(law, memory, opening, slip)
        tractions.append((response.normal, response.tangential))
    return np.array(tractions), memory


def test_the_virgin_curve_is_smc():
    path = np.linspace(0.0, 8.0, 400)
    for angle in (0.0, 0.4, 1.1, np.pi / 2.0):
        opening, slip = path * np.cos(angle) * MORTAR.normal_length, path * np.sin(angle) * MORTAR.tangential_length
        expected = smc_np2(MORTAR, opening, slip)
        found, _ = walked(opening, slip)
        np.testing.assert_allclose(
            found, np.stack([expected.normal, expected.tangential], axis=1), rtol=1e-12, atol=1e-9
        )


def test_unloading_goes_to_the_origin_and_contact_is_undamaged():
    opening = np.concatenate([np.linspace(0.0, 2.0, 50), np.linspace(2.0, -1.0, 100)]) * MORTAR.normal_length
    (normal, _), _ = walked(opening, np.zeros_like(opening))[0].T, None
    back = opening[50:]
    secant = normal[49] / opening[49]
    np.testing.assert_allclose(normal[50:], np.where(back >= 0.0, secant, MORTAR.normal_stiffness) * back, rtol=1e-12)


def test_what_is_left_of_a_slid_joint_is_friction():
    """Far beyond its slip length nothing is left but μ N, whatever the direction."""
    slip = np.concatenate([np.linspace(0.0, 60.0, 3000), np.linspace(60.0, 20.0, 2000)]) * MORTAR.tangential_length
    closed = np.full_like(slip, -0.3 * MORTAR.normal_length)
    tangential = walked(closed, slip)[0][:, 1]
    pressed = 0.7 * 0.3 * MORTAR.normal_stiffness * MORTAR.normal_length
    assert tangential[2999] == pytest.approx(pressed, rel=1e-9)
    assert tangential[-1] == pytest.approx(-pressed, rel=1e-9)


def test_no_path_makes_energy():
    """A thousand random walks in opening and slip: what is stored and what was put in never differ the wrong way."""
    rng = np.random.default_rng(3)
    steps, paths = 3000, 1000
    scale = np.array([MORTAR.normal_length, MORTAR.tangential_length])[:, None, None]
    walk = np.cumsum(0.03 * rng.normal(size=(2, steps, paths)), axis=1) * scale
    walk[:, 0] = 0.0
    tractions, (kappa, slipped) = walked(*walk)
    moves = np.diff(walk, axis=1)
    work = (0.5 * (tractions[1:] + tractions[:-1]) * moves.transpose(1, 0, 2)).sum(axis=(0, 1))
    opening, slip = walk[:, -1]
    left = np.exp(-kappa)
    normal = 0.5 * MORTAR.normal_stiffness * opening**2 * np.where(opening > 0.0, left, 1.0)
    stuck = np.where(opening < 0.0, slip - slipped, 0.0)
    stored = normal + 0.5 * MORTAR.tangential_stiffness * (left * slip**2 + (1.0 - left) * stuck**2)
    # The trapezoidal rule is off by the curvature within a step.
    assert (work - stored > -0.02 * np.abs(work).max()).all() and np.median((work - stored) / work) > 0.3


def test_tangents_of_damage_and_friction():
    rng, count = np.random.default_rng(4), 500
    opening = rng.uniform(-1.0, 3.0, count) * MORTAR.normal_length
    slip = rng.uniform(-3.0, 3.0, count) * MORTAR.tangential_length
    memory = np.stack([rng.uniform(0.0, 3.0, count), rng.uniform(-2.0, 2.0, count) * MORTAR.tangential_length])
    response, scales = DAMAGING.respond(MORTAR, memory, opening, slip), (MORTAR.normal_length, MORTAR.tangential_length)
    for axis, letter in enumerate("nt"):
        step = 1e-6 * scales[axis] * np.eye(2)[axis]
        ahead, behind = (
            DAMAGING.respond(MORTAR, memory, opening + s * step[0], slip + s * step[1]) for s in (1.0, -1.0)
        )
        for force in ("normal", "tangential"):
            slope = (getattr(ahead, force) - getattr(behind, force)) / (2e-6 * scales[axis])
            exact = getattr(response, force[0] + letter)
            np.testing.assert_allclose(slope, exact, rtol=1e-7, atol=1e-8 * np.abs(exact).max())
