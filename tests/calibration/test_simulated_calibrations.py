"""Whole calibrations of simulated measurements: their outcome, their store, and a fault that they find."""

import numpy as np
import pytest

import structid as si
from structid.calibration import simulated_calibrations
from structid.calibration.simulated_calibrations import CalibrationRanks, Task, outcome_of
from structid.core.errors import InputError
from structid.inference.validation.simulation_based_calibration import Ranks

SPACE = si.ParameterSpace(
    stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
)
MODEL = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=SPACE.names, substeps=1)
RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(1.8)
VALUES = np.sin(RECORD.time)
VALUES[100:120] = np.nan
MEASURED = si.Observation(RECORD, VALUES)


def of_normal(monkeypatch, width):
    """Replace each calibration by draws of a normal posterior, whose width may be wrong; note the tasks."""
    tasks = []

    def outcome(task: Task):
        tasks.append(task)
        if len(tasks) == 4:
            return {"error": np.array("no run finished")}
        rng = np.random.default_rng(len(tasks))
        truth = simulated_calibrations.simulated_truths(si.Posterior(SPACE, MODEL, MEASURED), 40, 1)[0]
        middle = truth[len(tasks) - 1, :2] + np.array([1e5, 0.1]) * rng.normal(size=2)
        draws = middle + width * np.array([1e5, 0.1]) * rng.normal(size=(100, 2))
        return {
            "error": np.array(""),
            "draws": draws,
            "certified": np.array(len(tasks) > 10),
            "error model": np.array("iid"),
            "true runs": np.array(80.0),
            "seconds": np.array(1.0),
        }

    monkeypatch.setattr(simulated_calibrations, "outcome_of", outcome)
    return tasks


def test_ranks_of_whole_calibrations(monkeypatch, tmp_path):
    """Posteriors of the right width pass, those of a third fail; every outcome is kept, and gaps stay gaps."""
    tasks = of_normal(monkeypatch, 1.0)
    settings = dict(seed=1, replicas=40, workers=1)
    found = si.sbc_of_calibration(MODEL, SPACE, MEASURED, store=tmp_path, **settings)
    assert found.calibrated and len(found.certified) == 39 and found.failed == ("no run finished",)
    assert "Certified: 30 of 39" in str(found) and "1 calibration ended with an error" in str(found)
    assert found.of_certified is not None and len(found.of_certified.truth) == 30
    assert np.isnan(tasks[0].observations[0].values[100:120]).all() and len(tasks) == 40
    clean = MODEL.simulate(found.ranks.truth[:1], RECORD).values[0, :, 0]
    errors = (tasks[0].observations[0].values[:, 0] - clean)[~np.isnan(VALUES)]
    assert errors.std() == pytest.approx(0.05 * np.sqrt(np.mean(clean**2)), rel=0.15)
    again = si.sbc_of_calibration(MODEL, SPACE, MEASURED, store=tmp_path, **settings)
    assert len(tasks) == 40 and str(again) == str(found)
    of_normal(monkeypatch, 0.33)
    narrow = si.sbc_of_calibration(MODEL, SPACE, MEASURED, **settings)
    assert not narrow.calibrated and "NOT CALIBRATED" in str(narrow) and "too narrow" in str(narrow)


def test_one_real_calibration_and_an_error():
    measured = si.Observation(RECORD, MODEL.simulate(np.array([[7.2e6, 0.4]]), RECORD).values[0, :, 0])
    noisy = si.Observation(
        RECORD,
        measured.values + 0.02 * measured.values.std() * np.random.default_rng(1).normal(size=measured.values.shape),
    )
    plan = si.Plan(true_runs=60, exploration_sampler=si.SMC(particles=80, steps=8))
    outcome = outcome_of(Task(MODEL, SPACE, (noisy,), None, "auto", plan, 1))
    assert outcome["draws"].shape == (100, 2) and str(outcome["error model"]) == "iid"

    def broken(parameters, record):
        raise KeyError("k")

    external = si.CallableModel(broken, free=SPACE.names, channels=("velocity",), isolated=False)
    failed = outcome_of(Task(external, SPACE, (noisy,), None, None, plan, 1))
    assert set(failed) == {"error"} and "KeyError" in str(failed["error"])


def test_bad_arguments():
    with pytest.raises(InputError, match="20 or more"):
        si.sbc_of_calibration(MODEL, SPACE, MEASURED, replicas=5)
    with pytest.raises(InputError, match="positive fraction"):
        si.sbc_of_calibration(MODEL, SPACE, MEASURED, noise=0.0)


@pytest.mark.slow
def test_twenty_whole_calibrations_side_by_side(tmp_path):
    """Every step as a user gets it: all certified, the error model chosen, the truth in its intervals."""
    found = si.sbc_of_calibration(MODEL, SPACE, MEASURED, discrepancy="auto", replicas=20, seed=2, store=tmp_path)
    assert isinstance(found, CalibrationRanks) and isinstance(found.ranks, Ranks)
    assert found.calibrated and found.certified.sum() >= 18 and set(found.error_models) == {"iid"}, str(found)
