"""A filter beside a running test: it finds the parameters, stays within priors, hands them on, and is kept with the result."""

from dataclasses import replace

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.transfer_system import Actuator, Sensor
from structid.hybrid.coupling.coupling_benchmark import LAW, two_floor_frame
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.online.unscented_filter import UnscentedFilter
from structid.hybrid.online.updated_springs import UpdatedSprings
from structid.hybrid.programme import Programme
from structid.hybrid.recording.result_file import open_hybrid
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.mechanics.restoring_forces import HystereticSprings, LinearForce, spring_law
from structid.models.hysteretic.bouc_wen import BoucWen
from structid.models.masonry.masonry_wall import MasonryWall
from structid.probability.marginals import Normal, Uniform
from structid.probability.space import ParameterSpace

pytestmark = pytest.mark.quick
UPPER, LOWER = cut_frame(two_floor_frame(hysteretic=True), 1)
TRUTH = {"stiffness": 7.6e6, "alpha": 0.05, "beta": 63.0}
NOISE = 200.0


def space():
    return ParameterSpace(
        stiffness=Normal(7.0e6, 0.7e6, low=4e6, high=10e6, unit="N/m"),
        alpha=Uniform(0.01, 0.2),
        beta=Uniform(40.0, 90.0, unit="1/m"),
    )


def filtering(**settings):
    rest = {name: value for name, value in LAW.items() if name not in TRUTH}
    model = BoucWen(mass=12e3, free=("stiffness", "alpha", "beta"), **rest)
    return UnscentedFilter(model, space(), NOISE, **settings)


def ran(online, seed=1, strength=4.0, upper=UPPER, store=None, noise=NOISE):
    sensors = Actuator(force_sensor=Sensor(noise * 10.0))  # a reading averages a hundred samples
    moved = SimulatedSpecimen(LOWER.force, sensors, stiffness=LOWER.stiffness, seed=seed)
    record = GroundMotion.synthetic(seed=1).trim(2.0, 5.0).scale_to_pga(strength)
    test = HybridTest(upper, moved, record, dt=0.01, time_scale=100.0, physical=LOWER, online=online)
    return test.run(store)


def test_it_finds_the_parameters():
    path = ran(filtering()).online
    truth = np.array([TRUTH[name] for name in path.names])
    assert path.mean.shape == (301, 3)
    widths = path.high - path.low
    assert (widths[-1] < 0.1 * widths[0]).all()
    sd = widths[-1] / 3.92
    assert (np.abs(path.mean[-1] - truth) < 5.0 * sd).all()
    low, high = space().quantile(np.full((1, 3), 1e-9)), space().quantile(np.full((1, 3), 1.0 - 1e-9))
    assert (path.low >= low).all() and (path.high <= high).all()


def test_without_moves_it_believes_its_prior():
    online = filtering()
    online.begin(0.0)
    online.see(0.0, 0.0)
    path = online.path()
    np.testing.assert_allclose(path.mean[0], space().quantile(np.full((1, 3), 0.5))[0], rtol=1e-6)
    np.testing.assert_allclose(path.low[0], space().quantile(np.full((1, 3), 0.025))[0], rtol=1e-3)


def test_for_a_linear_law_it_is_the_kalman_filter():
    """F = k d with k normal: precision grows by d²/σ² with each move."""
    prior = ParameterSpace(stiffness=Normal(7.0e6, 0.7e6, unit="N/m"))
    online = UnscentedFilter(BoucWen(mass=12e3, alpha=1.0, beta=0.0, gamma=0.0, free=("stiffness",)), prior, NOISE)
    online.begin(0.0)
    random, precision, weighted = np.random.default_rng(3), 1.0 / 0.7e6**2, 7.0e6 / 0.7e6**2
    for place in random.normal(0.0, 1e-3, 40):
        force = 7.6e6 * place + NOISE * random.normal()
        online.see(place, force)
        precision, weighted = precision + place**2 / NOISE**2, weighted + place * force / NOISE**2
    path = online.path()
    assert path.mean[-1, 0] == pytest.approx(weighted / precision, rel=1e-9)
    assert (path.high - path.low)[-1, 0] / (2 * 1.959964) == pytest.approx(precision**-0.5, rel=1e-6)


def test_one_that_forgets_stays_wide():
    sure, forgetful = ran(filtering()).online, ran(filtering(drift=0.02)).online
    assert ((forgetful.high - forgetful.low)[-1] > 2.0 * (sure.high - sure.low)[-1]).all()


def test_the_numerical_part_takes_over_what_it_learns():
    springs = HystereticSprings([[-1.0, 1.0]], [6.5e6], [12e3], spring_law(alpha=0.1, beta=50.0, gamma=50.0))
    alike = UpdatedSprings(springs)
    upper = replace(UPPER, restoring_force=alike)
    right, updated = ran(None).coarse.u, ran(filtering(updates=alike), upper=upper).coarse.u
    fixed = ran(None, upper=replace(UPPER, restoring_force=UpdatedSprings(springs))).coarse.u
    assert alike.springs.stiffness[0] == pytest.approx(7.6e6, rel=0.02)
    assert np.abs(updated - right).max() < 0.3 * np.abs(fixed - right).max()


def test_its_path_is_kept_with_the_result(tmp_path):
    result = ran(filtering(), store=tmp_path / "test.h5")
    kept = open_hybrid(tmp_path / "test.h5").online
    assert kept.names == result.online.names
    np.testing.assert_array_equal(kept.low, result.online.low)
    assert open_hybrid(tmp_path / "test.h5").moves.force.shape == result.moves.force.shape
    ran(None, store=tmp_path / "other.h5")
    assert open_hybrid(tmp_path / "other.h5").online is None


def test_it_goes_on_from_test_to_test():
    online = filtering()
    moved = SimulatedSpecimen(LOWER.force, Actuator(force_sensor=Sensor(10.0 * NOISE)), stiffness=LOWER.stiffness)
    record = GroundMotion.synthetic(seed=1).trim(2.0, 4.0).scale_to_pga(4.0)
    test = HybridTest(UPPER, moved, record, dt=0.01, time_scale=100.0, physical=LOWER, online=online)
    result = Programme({"1": test, "2": test}).run()
    first, second = result.tests["1"].online, result.tests["2"].online
    assert abs(result.tests["2"].datum[0]) > 1e-3
    np.testing.assert_allclose(second.mean[0], first.mean[-1], rtol=0.02)
    truth = np.array([TRUTH[name] for name in second.names])
    assert (np.abs(second.mean[-1] - truth) < 5.0 * (second.high - second.low)[-1] / 3.92).all()


def test_what_it_cannot_follow():
    with pytest.raises(InputError, match="one spring"):
        wall = MasonryWall(
            normal_energy=15.0,
            normal_strength=0.2e6,
            tangential_energy=150.0,
            joint_law="damage-friction",
            friction=0.6,
            free=("tangential_strength",),
        )
        UnscentedFilter(wall, ParameterSpace(tangential_strength=Uniform(1e5, 1e6)), NOISE)
    with pytest.raises(InputError, match="positive noise"):
        UnscentedFilter(filtering().model, space(), 0.0)
    rows = np.diag([1.0, 2.0])
    two = SimulatedSpecimen(LinearForce(rows), channels=("x", "y"), stiffness=rows)
    with pytest.raises(InputError, match="one channel"):
        HybridTest(UPPER, two, GroundMotion.synthetic(seed=1), dt=0.01, time_scale=1.0, online=filtering())
