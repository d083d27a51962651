"""Tests one after the other on one specimen: damage that stays, what was measured, what is learnt of it, how a programme ends."""

from dataclasses import replace

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.ground_motion.excitation import CombinedExcitation
from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.transfer_system import Actuator, Sensor
from structid.hybrid.coupling.coupling_benchmark import LAW, two_floor_frame
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.remote import RemoteSpecimen
from structid.hybrid.laboratory.server import SpecimenServer
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.laboratory.specimen import Specimen, SpecimenError
from structid.hybrid.programme import Programme, store_of
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.hybrid.virtual_experiment import VirtualHybridTest
from structid.mechanics.restoring_forces import CollapseError, LinearForce
from structid.models.hysteretic.bouc_wen import BoucWen
from structid.models.hysteretic.imposed_displacements import ImposedDisplacements

pytestmark = pytest.mark.quick
SECRET = "a secret of both sides"
UPPER, LOWER = cut_frame(two_floor_frame(hysteretic=True), 1)
STOREY = BoucWen(mass=12e3, stiffness=7.6e6, **LAW)


def shaking(strength):
    return GroundMotion.synthetic(seed=1).trim(2.0, 3.5).scale_to_pga(strength)


def specimen(**settings):
    return SimulatedSpecimen(LOWER.force, stiffness=LOWER.stiffness, **settings)


def programme(moved, strengths=(2.0, 4.0, 3.0), **settings):
    given = {"dt": 0.01, "time_scale": 50.0, "physical": LOWER} | settings
    return Programme({str(k): HybridTest(UPPER, moved, shaking(s), **given) for k, s in enumerate(strengths, start=1)})


@pytest.fixture(scope="module")
def run():
    return programme(specimen()).run()


def test_damage_is_carried_over(run):
    assert run.finished and not run.ended_by
    fresh = programme(specimen(), strengths=(3.0,)).run().tests["1"]
    assert run.tests["3"].stiffness_ratio < 0.9 * fresh.stiffness_ratio
    assert run.tests["1"].datum == 0.0
    assert abs(run.tests["3"].datum[0]) > 1e-4  # it was not where it began when it was without force
    assert "finished" in str(run)


def test_a_released_specimen_is_without_force():
    moved = specimen(actuators=Actuator(stroke=0.1))
    moved.move(np.linspace(0.0, 0.03, 20)[:, None])
    moved.close()
    after = moved.released()
    assert np.abs(after._force).max() < 1e-2
    assert after.position == 0.0
    assert after.describe().datum[0] > 0.005
    assert after.describe().channels[0].stroke == pytest.approx(0.1 - after.describe().datum[0])
    np.testing.assert_allclose(after.move(np.zeros((1, 1))).force, 0.0, atol=1e-2)
    with pytest.raises(SpecimenError, match="holds its position"):
        moved.move(np.zeros((1, 1)))


def test_one_that_tells_no_stiffness_cannot_be_released():
    moved = SimulatedSpecimen(LOWER.force)
    with pytest.raises(InputError, match="initial stiffness"):
        moved.released()


def test_a_structure_is_released_by_its_operator():
    class Laboratory(Specimen):
        def describe(self):
            return specimen().describe().model_copy(update={"simulated": False})

        def move(self, path, averaged=1): ...

        def hold(self, reason): ...

        def close(self): ...

    with pytest.raises(SpecimenError, match="by its operator"):
        Laboratory().released()
    with pytest.raises(InputError, match="a structure as specimen"):
        SpecimenServer(Laboratory(), SECRET, releases=True)


def test_what_was_measured_is_the_law_that_was_tested(run):
    observation = run.observation("3")
    assert observation.record.kind == "displacement" and observation.channels == ("restoring_force",)
    assert len(observation.record) == sum(len(test.moves) for test in run.tests.values())
    found = ImposedDisplacements(STOREY, pieces=20).simulate(np.zeros((1, 0)), observation.record).values[0]
    np.testing.assert_allclose(found, observation.values, atol=2e-6 * np.abs(observation.values).max())


def test_the_whole_as_a_model_is_the_test(run):
    virtual = VirtualHybridTest(
        UPPER,
        LOWER,
        replace(STOREY, stiffness=None, free=("stiffness",)),
        0.01,
        way=run.way_to("3"),
        pieces=20,
        channels=("displacement_1", "displacement_2", "restoring_force_1"),
    )
    found = virtual.simulate(np.full((2, 1), 7.6e6), run.tests["3"].record).values[1]
    happened = run.tests["3"].coarse
    np.testing.assert_allclose(found[:, :2], happened.u, atol=1e-6 * np.abs(happened.u).max())
    np.testing.assert_allclose(
        found[:, 2], happened.physical.force[:, 0], atol=1e-5 * np.abs(happened.physical.force).max()
    )


@pytest.mark.parametrize("fine", ["numerical", "physical"])
def test_the_whole_as_a_model_with_substeps(fine):
    coupling = PrakashHjelmstad(5, fine)
    happened = programme(specimen(), strengths=(3.0,), coupling=coupling).run().tests["1"]
    virtual = VirtualHybridTest(UPPER, LOWER, STOREY, 0.01, coupling, 20, channels=("displacement_1",))
    found = virtual.simulate(np.zeros((1, 0)), happened.record).values[0, :, 0]
    np.testing.assert_allclose(found, happened.coarse.u[:, 0], atol=1e-6 * np.abs(happened.coarse.u).max())


def test_several_channels_are_one_excitation():
    rows = np.diag([2.0, 3.0, 4.0])
    moved = SimulatedSpecimen(LinearForce(rows), channels=("x", "y", "turn"), units=("m", "m", "rad"), stiffness=rows)
    from structid.hybrid.substructures.substructure import Substructure

    upper = Substructure(np.eye(3), 0.1 * np.eye(3), 5.0 * np.eye(3), [0, 1, 2])
    lower = Substructure(np.eye(3), 0.1 * np.eye(3), rows, [0, 1, 2])
    result = HybridTest(upper, moved, shaking(1.0), dt=0.01, time_scale=50.0, physical=lower).run()
    observation = result.observation()
    assert (
        isinstance(observation.record, CombinedExcitation)
        and observation.record.kind == "displacement+displacement+rotation"
    )
    assert observation.channels == ("restoring_force_1", "restoring_force_2", "moment_3")
    np.testing.assert_allclose(observation.values, observation.record.values @ rows, atol=1e-12)
    assert observation.si_units == ("N", "N", "N*m")
    known = result.observation(sd=(1.0, 2.0, 4.0))
    np.testing.assert_array_equal(known.sd, np.tile([1.0, 2.0, 4.0], (len(known.values), 1)))
    for wrong in ((1.0, 2.0), 0.0, (1.0, 2.0, np.nan)):
        with pytest.raises(InputError, match=r"one for each of restoring_force_1, restoring_force_2, moment_3"):
            result.observation(sd=wrong)


def test_a_programme_ends_with_the_test_that_does(tmp_path):
    class Failing(LinearForce):
        def at(self, memory, displacement):
            if abs(displacement[0]) > 4e-3:
                raise CollapseError("its wall leans too far")
            return super().at(memory, displacement)

    moved = SimulatedSpecimen(Failing(LOWER.stiffness), stiffness=LOWER.stiffness)
    expected = replace(LOWER, restoring_force=None)
    result = programme(moved, (0.5, 3.0, 0.5), physical=expected).run(tmp_path)
    assert list(result.tests) == ["1", "2"] and not result.finished
    assert result.tests["1"].finished and 0 < result.tests["2"].steps < 150
    assert "Test 2 ended at" in result.ended_by and "its wall leans too far" in result.ended_by
    assert store_of(tmp_path, "2").exists() and not store_of(tmp_path, "3").exists()


def test_a_collapse_that_is_foreseen_is_told():
    class Weak(LinearForce):
        def at(self, memory, displacement):
            if np.abs(displacement).max() > 4e-3:
                raise CollapseError("its wall leans too far")
            return super().at(memory, displacement)

    expected = replace(LOWER, restoring_force=Weak(LOWER.stiffness))
    found = programme(specimen(), (3.0,), physical=expected).check()["1"]
    assert found.can_work and any("leans too far" in said for said in found.warnings)
    assert found.steps == 150


def noisy(seed=3):
    actuator = Actuator(delay=0.02, displacement_sensor=Sensor(5e-6), force_sensor=Sensor(50.0))
    return specimen(actuators=actuator, seed=seed)


@pytest.mark.slow
def test_a_programme_goes_on_where_it_was_killed(tmp_path):
    whole = programme(noisy()).run(tmp_path / "whole")
    cut = programme(noisy())
    Programme({name: cut.tests[name] for name in ("1", "2")}).run(tmp_path / "cut")
    with pytest.raises(InputError, match="already exists"):
        programme(noisy()).run(tmp_path / "cut")
    resumed = programme(noisy()).run(tmp_path / "cut", resume=True)
    for name in ("1", "2", "3"):
        np.testing.assert_array_equal(resumed.tests[name].moves.measured, whole.tests[name].moves.measured)
    with pytest.raises(InputError, match="the repeated test differs"):
        programme(noisy(seed=4)).run(tmp_path / "cut", resume=True)


def test_a_remote_programme_is_a_local_one_to_the_bit():
    local = programme(noisy()).run()
    with SpecimenServer(noisy(), SECRET, releases=True) as server:
        remote = programme(RemoteSpecimen(server.address, SECRET)).run()
    for name, test in local.tests.items():
        np.testing.assert_array_equal(remote.tests[name].moves.measured, test.moves.measured)
        np.testing.assert_array_equal(remote.tests[name].coarse.u, test.coarse.u)
        assert remote.tests[name].description.datum == test.description.datum


def test_a_server_that_does_not_release_ends_a_programme():
    with SpecimenServer(noisy(), SECRET) as server:
        result = programme(RemoteSpecimen(server.address, SECRET)).run()
    assert result.tests["1"].finished and not result.tests["2"].steps
    assert "holds its position" in result.ended_by


def test_programmes_that_cannot_be(run):
    with pytest.raises(InputError, match="one or more tests"):
        Programme({})
    with pytest.raises(InputError, match="letters, digits"):
        Programme({"../1": next(iter(programme(specimen()).tests.values()))})
    with pytest.raises(InputError, match="1, 2, 3"):
        run.way_to("4")
    with pytest.raises(InputError, match=r"test 1"):
        programme(specimen(actuators=Actuator(stroke=1e-3))).run()


def test_the_virtual_whole_says_what_it_cannot_do():
    with pytest.raises(InputError, match="whole number of coarse steps"):
        VirtualHybridTest(UPPER, LOWER, STOREY, 0.003).simulate(np.zeros((1, 0)), shaking(1.0))
    with pytest.raises(InputError, match="displacement_1"):
        VirtualHybridTest(UPPER, LOWER, STOREY, 0.01, channels=("velocity",))
    one = VirtualHybridTest(UPPER, LOWER, STOREY, 0.01)
    assert one.content_hash != replace(one, dt=0.005).content_hash != replace(one, way=np.zeros((1, 1))).content_hash
    assert one.content_hash == VirtualHybridTest(UPPER, LOWER, STOREY, 0.01).content_hash


def test_a_result_draws_itself(run, tmp_path):
    run.tests["2"].plot(save=tmp_path / "loop")
    assert (tmp_path / "loop.png").is_file() and (tmp_path / "loop.pdf").is_file()
    with pytest.raises(InputError, match="displacement"):
        run.tests["2"].plot("sway")
