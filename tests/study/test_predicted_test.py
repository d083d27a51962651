"""What tests have taught predicts a stronger one: its moves are longer, and what is not followed is told."""

import numpy as np
import pytest

from structid.ground_motion.record import GroundMotion
from structid.hybrid.coupling.coupling_benchmark import LAW, two_floor_frame
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.hybrid.virtual_experiment import VirtualHybridTest
from structid.models.hysteretic.bouc_wen import BoucWen
from structid.report.material.programme_material import PredictedTest
from structid.study.programmes.learnt_of_tests import followed_in_pieces

pytestmark = pytest.mark.quick
UPPER, LOWER = cut_frame(two_floor_frame(), 1)
TEST = VirtualHybridTest(UPPER, LOWER, BoucWen(mass=12e3, free=("stiffness",), **LAW), dt=0.01, pieces=1)
STIFFNESS = np.array([[7.0e6], [7.6e6]])
RECORD = GroundMotion.synthetic(seed=1).trim(2.0, 4.0)


def test_a_stronger_test_is_followed_in_more_pieces():
    strong = RECORD.scale(20.0)
    assert np.all(TEST.simulate(STIFFNESS, strong).status != 0)
    found = followed_in_pieces(TEST, STIFFNESS, strong)
    fine = VirtualHybridTest(UPPER, LOWER, TEST.specimen, dt=0.01, pieces=64).simulate(STIFFNESS, strong)
    assert np.all(found.status == 0)
    np.testing.assert_allclose(found.values, fine.values, atol=2e-3 * np.abs(fine.values).max())


def test_a_test_that_is_followed_keeps_its_pieces():
    np.testing.assert_array_equal(
        followed_in_pieces(TEST, STIFFNESS, RECORD).values, TEST.simulate(STIFFNESS, RECORD).values
    )


def predicted(drifts, failed):
    return PredictedTest("5", np.arange(3.0), drifts, np.array([0.0, 2e-3]), failed, "not finite from 3 s on")


def test_runs_that_failed_are_told_beside_the_band():
    first, second = predicted(np.full((3, 3), 1e-3), 1).sentences
    assert "1 to 1 mm (5 to 95 %)" in first and "outside the band" in first
    assert second == "1 of 4 model runs failed for test 5: not finite from 3 s on. The band excludes them."


def test_a_test_of_which_every_run_failed_is_not_predicted():
    assert predicted(np.zeros((0, 3)), 4).sentences == [
        "4 of 4 model runs failed for test 5: not finite from 3 s on. There is no prediction."
    ]
