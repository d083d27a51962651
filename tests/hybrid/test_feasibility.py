"""What a check must find before anything moves: delays, steps, commands, motions, and programmes that can not go on."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError, StructidWarning
from structid.hybrid.control.compensation import AdaptiveTimeSeries, PolynomialExtrapolation
from structid.hybrid.control.delay import critical_delay, critical_delay_of, growing_oscillations
from structid.hybrid.control.transfer_system import Actuator
from structid.hybrid.coupling.coupling_benchmark import pulse, two_floor_frame
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.laboratory.specimen import Specimen, SpecimenError
from structid.hybrid.programme import Programme
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.hybrid.substructures.substructure import Substructure
from structid.mechanics.restoring_forces import LinearForce

pytestmark = pytest.mark.quick
STIFFNESS, MASS, RATIO = 7.6e6, 12e3, 0.03
OMEGA = float(np.sqrt(STIFFNESS / MASS))
UPPER, LOWER = cut_frame(two_floor_frame(hysteretic=True), 1)


def record(duration=1.0, dt=1e-4):
    time = np.arange(0.0, duration + 0.5 * dt, dt)
    return si.GroundMotion(pulse(time), dt, name="pulse")


def frame_test(specimen, **settings):
    return HybridTest(
        UPPER, specimen, **{"record": record(), "dt": 0.01, "time_scale": 100.0, "physical": LOWER} | settings
    )


# --- delays ---------------------------------------------------------------------------------------------------------


def late(tau):
    return lambda omega: np.exp(-1j * omega * tau)


@pytest.mark.parametrize("ratio", [0.01, RATIO, 0.3])
@pytest.mark.parametrize("share", [0.999, 1.001])
def test_oscillations_grow_beyond_the_critical_delay_of_one_mass(ratio, share):
    critical = critical_delay(OMEGA, ratio).delay
    one, damping = np.array([[MASS]]), np.array([[2.0 * ratio * OMEGA * MASS]])
    stiffness = np.array([[STIFFNESS]])
    found = growing_oscillations(one, damping, 0.0 * stiffness, stiffness, late(share * critical))
    assert found == (share > 1.0)


@pytest.mark.parametrize("share", [0.999, 1.001])
def test_and_of_a_structure(share):
    rng = np.random.default_rng(3)
    a, b = (x @ x.T + np.eye(4) for x in rng.normal(size=(2, 4, 4)))
    mass, damping = np.eye(4), 0.05 * np.eye(4)
    critical = critical_delay_of(mass, damping, a, b).delay
    assert (growing_oscillations(mass, damping, a, b, late(share * critical)) > 0) == (share > 1.0)


def test_roots_that_grow_are_counted():
    """Late feedback of half the stiffness: the roots themselves, found from many starts."""
    tau, c = 0.3, 2.0 * 0.3 * OMEGA

    def equation(s):
        return s * s + c * s + OMEGA**2 * np.exp(-s * tau)

    def slope(s):
        return 2.0 * s + c - tau * OMEGA**2 * np.exp(-s * tau)

    starts = np.array([complex(x, y) for x in np.linspace(0.05, 30, 40) for y in np.linspace(0.1, 80.0, 120)])
    for _ in range(60):
        starts = starts - equation(starts) / slope(starts)
    roots = starts[(np.abs(equation(starts)) < 1e-6) & (starts.real > 1e-9) & (starts.imag > 0.0)]
    distinct = np.unique(np.round(roots, 5))
    one = np.array([[1.0]])
    found = growing_oscillations(one, c * one, 0.0 * one, OMEGA**2 * one, late(tau))
    assert found == len(distinct) > 1


def one_mass_test(delay, compensation=None):
    c = 2.0 * RATIO * OMEGA * MASS
    upper = Substructure([[MASS / 2.0]], [[c / 2.0]], [[0.0]], [0])
    lower = Substructure([[MASS / 2.0]], [[c / 2.0]], [[STIFFNESS]], [0])
    specimen = SimulatedSpecimen(LinearForce(np.array([[STIFFNESS]])), Actuator(delay=delay))
    return HybridTest(
        upper,
        specimen,
        record(dt=1e-3),
        dt=0.01,
        time_scale=1.0,
        physical=lower,
        coupling=PrakashHjelmstad(10, "physical"),
        compensation=compensation,
    )


@pytest.mark.parametrize("delay", [0.003, 0.020, 0.159, 0.199])
def test_no_delay_beyond_the_critical_one_is_accepted(delay):
    """Also where the force comes so late that a first estimate takes it for damping."""
    checked = one_mass_test(delay).check()
    assert not checked.can_work and "would grow" in checked.refusals[0]
    assert checked.critical_delay == pytest.approx(2.385588e-3, rel=1e-6)


def test_what_compensation_can_and_cannot_do():
    assert one_mass_test(0.002).check().can_work
    for compensation in (PolynomialExtrapolation(0.020), AdaptiveTimeSeries(0.020)):
        assert one_mass_test(0.020, compensation).check().can_work
    # ωτ beyond π/2: the polynomial feeds energy in.
    assert not one_mass_test(0.08, PolynomialExtrapolation(0.08)).check().can_work
    assert not one_mass_test(0.020, PolynomialExtrapolation(0.001)).check().can_work


# --- steps and stiffness --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("times", [3.0, 20.0])
def test_a_specimen_that_is_expected_to_be_stiffer(times):
    """3 K₀ is told, and borne by a step of 0.01 s; 20 K₀ grows."""
    stiffer = replace(LOWER, restoring_force=LinearForce(times * LOWER.stiffness))
    checked = HybridTest(
        UPPER, SimulatedSpecimen(LOWER.force), record(), dt=0.05, time_scale=100.0, physical=stiffer
    ).check()
    assert any(f"stiffness of the specimen is {times:.3g} times" in warning for warning in checked.warnings)
    radius_is_told = any("times as stiff as K₀" in refusal and "grows by" in refusal for refusal in checked.refusals)
    assert radius_is_told == (not checked.can_work) == (times == 20.0)


def test_steps_that_grow_beyond_all_numbers():
    stiffer = replace(LOWER, restoring_force=LinearForce(1e9 * LOWER.stiffness))
    checked = HybridTest(
        UPPER, SimulatedSpecimen(LOWER.force), record(8.0, 1e-3), dt=0.05, time_scale=100.0, physical=stiffer
    ).check()
    assert "without bound" in " ".join(checked.refusals)


# --- commands and motions -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("compensation", [None, PolynomialExtrapolation(0.017)])
def test_the_check_knows_the_commands_of_the_run(compensation):
    """A compensation overshoots, and makes small jumps fast: what the pistons will be told, not where they should be."""
    test = frame_test(
        SimulatedSpecimen(LOWER.force, Actuator(delay=0.017)),
        coupling=PrakashHjelmstad(100, "physical"),
        time_scale=10.0,
        compensation=compensation,
        record=record(0.4),
    )
    checked, result = test.check(), test.run()
    assert checked.stroke[0] == pytest.approx(np.abs(result.moves.command).max(), rel=2e-3)
    fastest = np.abs(np.diff(result.moves.command[:, 0])).max() / 1e-3
    assert checked.velocity[0] == pytest.approx(fastest, rel=0.05)


class OwnRamps(SimulatedSpecimen):
    """Takes a place, and answers when it is there."""

    longest = 1

    def describe(self):
        return super().describe().model_copy(update={"longest_path": self.longest})


def test_a_specimen_that_makes_its_own_ramps():
    specimen = OwnRamps(LOWER.force)
    test = frame_test(specimen)
    checked = test.check()
    assert checked.can_work, str(checked)
    result = test.run()
    local = frame_test(SimulatedSpecimen(LOWER.force)).run()
    assert result.finished
    np.testing.assert_allclose(result.coarse.u, local.coarse.u, atol=1e-5 * np.abs(local.coarse.u).max())
    assert checked.velocity[0] == pytest.approx(np.abs(np.diff(result.moves.target[:, 0])).max() / 1.0, rel=1e-3)


def test_a_specimen_that_takes_no_such_path():
    specimen = OwnRamps(LOWER.force)
    specimen.longest = 50
    with pytest.raises(InputError, match="A move has 1000 controller steps, but the specimen accepts at most 50"):
        frame_test(specimen).run()


# --- programmes that can not go on ----------------------------------------------------------------------------------


class InALaboratory(SimulatedSpecimen):
    """Damaged for good, and released by its operator alone."""

    def describe(self):
        return super().describe().model_copy(update={"simulated": False})

    def released(self):
        return Specimen.released(self)


def programme(specimen):
    short = record(0.3)
    return Programme({n: frame_test(specimen, record=short) for n in ("1", "2")})


def test_a_programme_waits_for_the_operator_and_goes_on(tmp_path):
    first = programme(InALaboratory(LOWER.force)).run(tmp_path)
    assert list(first.tests) == ["1"] and not first.finished and first.tests["1"].finished
    assert "after test 1" in first.ended_by and "by its operator" in first.ended_by
    second = programme(InALaboratory(LOWER.force)).run(tmp_path, resume=True)
    assert second.finished and list(second.tests) == ["1", "2"]
    np.testing.assert_array_equal(second.tests["1"].moves.force, first.tests["1"].moves.force)


def test_but_not_in_the_middle_of_a_test(tmp_path):
    class Silent(InALaboratory):
        left = 10

        def move(self, path, averaged=1):
            self.left -= 1
            if self.left < 0:
                raise SpecimenError("It is silent.")
            return super().move(path, averaged)

    assert not programme(Silent(LOWER.force)).run(tmp_path).tests["1"].finished
    with pytest.raises(InputError, match="cannot return to an earlier state"):
        programme(InALaboratory(LOWER.force)).run(tmp_path, resume=True)


def test_what_ended_a_test_is_named_before_what_else_happened():
    stiffer = replace(LOWER, restoring_force=None)
    specimen = SimulatedSpecimen(LinearForce(1.3 * LOWER.stiffness), Actuator(force=6e4))
    test = frame_test(specimen, physical=stiffer)
    with pytest.warns(StructidWarning, match=r"1\.3 times as stiff"):
        result = test._run_unchecked()
    assert not result.finished and len(result.events) == 2
    assert "limit" in result.events[-1].what and result.events[-1].what in str(result)
