"""Critical delays: published figures, closed forms against the whole structure, and a delayed loop that is simulated."""

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.hybrid.control.delay import critical_delay, critical_delay_of, critical_lag
from structid.hybrid.coupling.coupling_benchmark import two_floor_frame
from structid.hybrid.substructures.frame_parts import cut_frame

pytestmark = pytest.mark.quick
OMEGA, ZETA = float(np.sqrt(7.6e6 / 12e3)), 0.03


def test_figures_of_one_degree_of_freedom():
    assert critical_delay(OMEGA, ZETA).delay == pytest.approx(2.385588e-3, rel=1e-6)
    assert critical_delay(2.0 * np.pi, ZETA, 0.5).delay == pytest.approx(1.914456e-2, rel=1e-6)
    assert critical_delay(OMEGA, ZETA, 0.1).delay == pytest.approx(2.0 * ZETA / (0.1 * OMEGA), rel=0.1)


@pytest.mark.parametrize(("hertz", "scale", "milliseconds"), [(0.55, 500, 17.4), (1.38, 200, 6.9), (0.56, 200, 17.1)])
def test_figures_of_a_test_on_a_facade(hertz, scale, milliseconds):
    found = critical_delay(2.0 * np.pi * hertz * scale, ZETA).on_the_wall(scale)
    assert 1e3 * found == pytest.approx(milliseconds, abs=0.05)


def test_figures_of_the_two_floors():
    upper, lower = cut_frame(two_floor_frame(), 1, linear=True)
    physical, mass, damping = np.zeros((2, 2)), upper.mass.copy(), upper.damping.copy()
    for whole, part in ((physical, lower.stiffness), (mass, lower.mass), (damping, lower.damping)):
        whole[0, 0] += part[0, 0]
    found = critical_delay_of(mass, damping, upper.stiffness, physical)
    assert found.delay == pytest.approx(5.31929e-3, rel=1e-6)
    assert found.frequency == pytest.approx(15.5466, rel=1e-5)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 1.0])
def test_the_structure_of_one_mass_is_the_closed_form(share):
    one, k, m = np.eye(1), 7.6e6, 12e3
    found = critical_delay_of(m * one, 2.0 * ZETA * np.sqrt(k * m) * one, (1.0 - share) * k * one, share * k * one)
    closed = critical_delay(OMEGA, ZETA, share)
    assert found.delay == pytest.approx(closed.delay, rel=1e-9)
    assert found.frequency == pytest.approx(closed.frequency, rel=1e-9)


def test_enough_damping_bears_any_delay():
    assert critical_delay(OMEGA, 0.9, 0.05).delay == np.inf
    assert critical_lag(OMEGA, 0.5) == np.inf
    found = critical_delay_of(np.eye(1), 2.0 * np.eye(1), 0.99 * np.eye(1), 0.01 * np.eye(1))
    assert found.delay == np.inf


def growth(operator, mass, damping, delay):
    """Logarithm of the growth of free oscillations of u″ = −c u′ − k u(t − τ) in a second, by the root of its equation."""
    root = complex(-ZETA * OMEGA, OMEGA)
    for _ in range(50):
        value = mass * root**2 + damping * root + operator * np.exp(-root * delay)
        slope = 2.0 * mass * root + damping - delay * operator * np.exp(-root * delay)
        root -= value / slope
    return root.real


def test_below_it_oscillations_decay_and_above_it_they_grow():
    k, m = 7.6e6, 12e3
    critical = critical_delay(OMEGA, ZETA).delay
    assert growth(k, m, 2.0 * ZETA * np.sqrt(k * m), 0.999 * critical) < 0.0
    assert growth(k, m, 2.0 * ZETA * np.sqrt(k * m), 1.001 * critical) > 0.0


def test_the_critical_lag():
    k, m, c = 7.6e6, 12e3, 2.0 * ZETA * np.sqrt(7.6e6 * 12e3)

    def largest(lag):
        # u″ = −(c u′ + k w)/m, w′ = (u − w)/T
        return np.linalg.eigvals([[0.0, 1.0, 0.0], [0.0, -c / m, -k / m], [1.0 / lag, 0.0, -1.0 / lag]]).real.max()

    assert largest(0.999 * critical_lag(OMEGA, ZETA)) < 0.0 < largest(1.001 * critical_lag(OMEGA, ZETA))


@pytest.mark.parametrize("wrong", [{"frequency": 0.0}, {"damping_ratio": -0.1}, {"share": 0.0}, {"share": 1.1}])
def test_what_has_no_critical_delay_is_refused(wrong):
    with pytest.raises(InputError, match="0 < p ≤ 1"):
        critical_delay(**{"frequency": 1.0, "damping_ratio": 0.03, "share": 1.0} | wrong)
