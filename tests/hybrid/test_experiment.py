"""A hybrid test in one process: what it says beforehand, what delay does to it, how it ends, what it keeps."""

from dataclasses import replace

import numpy as np
import pytest
from one_mass import RATIO, growth, one_mass_test

from structid.core.errors import InputError, StructidWarning
from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.compensation import AdaptiveTimeSeries, PolynomialExtrapolation
from structid.hybrid.control.transfer_system import Actuator, Sensor
from structid.hybrid.coupling.coupling_benchmark import pulse, two_floor_frame, two_floors
from structid.hybrid.coupling.gravouil_combescure import GravouilCombescure
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.laboratory.specimen import SpecimenError
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.mechanics.restoring_forces import LinearForce

pytestmark = pytest.mark.quick


def record(duration=1.0, dt=1e-4):
    time = np.arange(0.0, duration + 0.5 * dt, dt)
    return GroundMotion(pulse(time), dt, name="pulse")


def frame_test(actuator=None, **settings):
    upper, lower = cut_frame(two_floor_frame(hysteretic=True), 1)
    specimen = SimulatedSpecimen(lower.force, actuator)
    given = {"record": record(), "dt": 0.01, "time_scale": 100.0, "physical": lower} | settings
    return HybridTest(upper, specimen, **given)


# --- what a test does -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "coupling", [PrakashHjelmstad(), PrakashHjelmstad(10, "physical"), GravouilCombescure(10, "physical")]
)
def test_a_perfect_transfer_system_gives_the_virtual_structure(coupling):
    result = frame_test(coupling=coupling, time_scale=10.0).run()
    virtual = two_floors(coupling, hysteretic=True, duration=1.0).coarse
    assert result.finished
    scale = np.abs(virtual.u).max()
    # A coarse specimen is moved along its ramp, which is more exact than one Runge-Kutta step.
    np.testing.assert_allclose(result.coarse.u / scale, virtual.u / scale, rtol=0.0, atol=2e-6)


def test_a_delay_beyond_the_critical_one_grows_as_predicted():
    test = one_mass_test(0.030, substeps=5)
    checked = test.check()
    assert not checked.can_work
    assert checked.critical_delay == pytest.approx(10.0 * 2.385588e-3, rel=1e-6)
    with pytest.raises(InputError, match=r"mode 1 .* would grow"):
        test.run()
    grown = growth(test._run_unchecked())
    assert grown == pytest.approx(0.0483, abs=3e-4)
    assert -2.0 * np.pi * checked.damping[0] == pytest.approx(grown, rel=0.03)


def test_the_loop_is_neutral_at_the_critical_delay():
    """Where its growth passes zero, between a delay of 1 % less and of 1 % more, is the predicted delay within 0.1 %."""
    critical = 10.0 * 2.385588e-3
    shares = np.array([0.99, 1.01])
    grown = [growth(one_mass_test(share * critical, cycles=12, substeps=2)._run_unchecked()) for share in shares]
    assert grown[0] < 0.0 < grown[1]
    assert np.interp(0.0, grown, shares) == pytest.approx(1.0, abs=1e-3)


def test_extrapolation_brings_back_the_decay():
    result = one_mass_test(0.030, PolynomialExtrapolation(0.030), substeps=5).run()
    assert growth(result) == pytest.approx(-2.0 * np.pi * RATIO, rel=2e-3)
    assert result.tracking["displacement"].error < 1e-4
    assert result.tracking["displacement"].index.delay == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_a_series_that_learns_does_so_too():
    sensor = Sensor(5e-6)
    result = one_mass_test(0.030, AdaptiveTimeSeries(0.020), cycles=14, substeps=5, displacement_sensor=sensor).run()
    u = result.coarse.u[:, 0]
    assert np.abs(u[-200:]).max() < 0.2 * np.abs(u).max()


def test_the_force_correction_is_exact_for_a_linear_specimen():
    test = replace(one_mass_test(0.015, cycles=8, substeps=3), force_correction=True)
    assert growth(test.run()) == pytest.approx(-2.0 * np.pi * RATIO, rel=2e-3)
    assert growth(one_mass_test(0.015, cycles=8, substeps=3).run()) > -2.0 * np.pi * 0.7 * RATIO


def test_indicators_see_the_delay():
    late = frame_test(Actuator(delay=0.020), coupling=PrakashHjelmstad(20, "physical"), time_scale=10.0).run()
    tracking = late.tracking["displacement"]
    assert tracking.index.delay == pytest.approx(2e-3, rel=0.15)
    assert tracking.indicator[-1] > 0.0
    assert tracking.energy[-1] > 0.0


# --- what it says beforehand ----------------------------------------------------------------------------------------


def test_the_check_tells_what_the_run_will_need():
    test = frame_test(Actuator(delay=0.017))
    checked, result = test.check(), test.run()
    assert checked.can_work
    assert checked.stroke[0] == pytest.approx(np.abs(result.moves.target).max(), rel=1e-3)
    assert checked.force[0] == pytest.approx(np.abs(result.moves.force).max(), rel=1e-3)
    assert (checked.steps, checked.wall_time) == (100, pytest.approx(100.0))
    text = str(checked)
    assert "This test is feasible." in text
    assert "critical delay" in text


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"actuator": Actuator(stroke=0.01)}, "displacement of .* exceeds the limit of 0.01"),
        ({"actuator": Actuator(velocity=1e-4)}, "velocity of .* larger time scale"),
        ({"actuator": Actuator(force=1e4)}, "force of .* weaker record"),
        ({"actuator": Actuator(delay=0.15)}, "is read 100 ms after the end of its ramp"),
        (
            {"actuator": Actuator(delay=0.03), "time_scale": 5.0, "coupling": PrakashHjelmstad(50, "physical")},
            "would grow",
        ),
        ({"dt": 0.02, "coupling": PrakashHjelmstad(10, "physical")}, "at most 0.5"),
    ],
)
def test_what_cannot_work_is_refused_with_its_figure(settings, message):
    test = frame_test(**settings)
    with pytest.raises(InputError, match=message):
        test.run()
    assert not test.specimen.position.any()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"time_scale": 0.0}, "a positive number"),
        ({"time_scale": 0.3}, "5 or more"),
        ({"compensation": AdaptiveTimeSeries(0.01)}, "learns from every controller step"),
        ({"geometry": np.eye(2)}, r"shape \(1, 1\)"),
        ({"physical": None}, "a Substructure with mass"),
        ({"duration": 2.0}, "is after the end"),
    ],
)
def test_what_does_not_fit_together_is_refused(settings, message):
    with pytest.raises(InputError, match=message):
        frame_test(**settings).check()


def test_a_specimen_that_tells_its_stiffness_needs_no_part():
    upper, lower = cut_frame(two_floor_frame(), 1, linear=True)
    whole = replace(upper, mass=upper.mass + np.diag([lower.mass[0, 0], 0.0]))
    specimen = SimulatedSpecimen(lower.force, stiffness=lower.stiffness)
    result = HybridTest(whole, specimen, record(), dt=0.01, time_scale=100.0).run()
    told = HybridTest(
        upper, SimulatedSpecimen(lower.force), record(), dt=0.01, time_scale=100.0, physical=lower.undamped()
    )
    np.testing.assert_allclose(result.coarse.u, told.run().coarse.u, rtol=0.0, atol=1e-15)


# --- how it ends ----------------------------------------------------------------------------------------------------


class Failing(SimulatedSpecimen):
    """A specimen that fails at a move."""

    def __init__(self, *arguments, at, error=None, **settings):
        super().__init__(*arguments, **settings)
        self.left, self.error = at, error

    def move(self, path, averaged=1):
        self.left -= 1
        if self.left < 0:
            if self.error is not None:
                raise self.error
            return super().move(path, averaged)._replace(force=np.array([np.nan]))
        return super().move(path, averaged)


@pytest.mark.parametrize("error", [SpecimenError("It is silent."), None], ids=["silence", "a reading of nan"])
@pytest.mark.parametrize("moves", [0, 1, 2, 38])
def test_a_failure_ends_it_and_keeps_every_finished_step(error, moves):
    upper, lower = cut_frame(two_floor_frame(hysteretic=True), 1)
    specimen = Failing(lower.force, at=moves, error=error)
    result = HybridTest(upper, specimen, record(), dt=0.01, time_scale=100.0, physical=lower).run()
    assert not result.finished
    known = max(moves - 1, 0)  # the first move only averages the force at rest
    assert result.steps == max(known - 1, 0)  # and the next one reads the specimen there
    assert specimen.held
    whole = frame_test().run()
    if known:
        np.testing.assert_array_equal(result.coarse.u, whole.coarse.u[:known])
    assert result.events[-1].what in str(result)
    with pytest.raises(SpecimenError, match="holds its position"):
        SimulatedSpecimen.move(specimen, np.zeros((1, 1)))


def test_a_stiffening_specimen_is_told():
    upper, lower = cut_frame(two_floor_frame(hysteretic=True), 1)
    stiffer = LinearForce(1.2 * lower.stiffness)
    test = HybridTest(upper, SimulatedSpecimen(stiffer), record(), dt=0.01, time_scale=100.0, physical=lower)
    with pytest.warns(StructidWarning, match=r"1\.2 times as stiff as K₀"):
        result = test.run()
    assert result.stiffness_ratio == pytest.approx(1.2)
    assert frame_test().run().stiffness_ratio < 1.02


def test_what_a_specimen_is_told_to_do_beyond_its_limits():
    specimen = SimulatedSpecimen(LinearForce(np.eye(1)), Actuator(stroke=1.0, velocity=1e3))
    specimen.move(np.array([[0.5]]))
    with pytest.raises(SpecimenError, match="refused before it started"):
        specimen.move(np.array([[1.5]]))
    assert specimen.position == 0.5
    with pytest.raises(SpecimenError, match="holds its position"):
        specimen.move(np.array([[0.4]]))
