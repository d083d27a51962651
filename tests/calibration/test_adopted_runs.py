"""Runs of a solver that was mended since: a calibration begins with them, and runs only what failed or is new."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import StoreMismatchError

SPACE = si.ParameterSpace(stiffness=si.Normal(7.4, 0.7, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0))
RECORD = si.GroundMotion.synthetic(seed=3, duration=6.0).scale_to_pga(1.8)
OSCILLATOR = si.BoucWen(
    mass=12_000.0, damping_ratio=0.03, alpha=0.063, beta=60.0, free=("stiffness", "gamma_ratio"), substeps=2
)


def response(parameters, record):
    return OSCILLATOR.simulate(np.array([[parameters["stiffness"], parameters["gamma_ratio"]]]), record).values[0, :, 0]


def solver(calls, most=np.inf):
    """It fails where the ratio of γ and β is larger."""

    def respond(parameters, record):
        calls.append(tuple(parameters.values()))
        if parameters["gamma_ratio"] > most:
            raise ValueError("too pinched")
        return response(parameters, record)

    return si.CallableModel(respond, free=SPACE.names, channels=("velocity",), isolated=False)


@pytest.fixture(scope="module")
def measured():
    truth = response({"stiffness": 7.6e6, "gamma_ratio": -0.2}, RECORD)
    noise = 0.05 * truth.std() * np.random.default_rng(1).standard_normal(truth.size)
    return si.Observation(RECORD, truth + noise)


@pytest.mark.slow
def test_a_mended_solver_goes_on_with_the_runs_of_before(measured, tmp_path):
    before, after = [], []
    first = si.calibrate(solver(before, 0.5), SPACE, measured, true_runs=45, seed=1, store=tmp_path)
    failed = {tuple(point) for point in first.runs.design.values[~first.runs.done]}
    assert failed
    with pytest.raises(StoreMismatchError, match="model is"):
        si.calibrate(solver([]), SPACE, measured, seed=1, store=tmp_path)
    other = si.Observation(RECORD.scale(1.1), measured.values)
    kept = sorted(path.name for path in tmp_path.rglob("*"))
    with pytest.raises(StoreMismatchError, match="records is"):
        si.calibrate(solver([]), SPACE, other, seed=1, store=tmp_path, adopt=True)
    assert sorted(path.name for path in tmp_path.rglob("*")) == kept

    model = solver(after)
    found = si.calibrate(model, SPACE, measured, seed=1, store=tmp_path, adopt=True)
    assert found.certificate.certified and found.runs.done.all()
    # One earlier run is repeated, to see whether the solver still gives the same response.
    assert failed <= set(after) and len(set(after) & (set(before) - failed)) == 1
    assert len(found.runs) >= len(first.runs) and found.rounds[0].training == len(first.runs)
    again = si.calibrate(model, SPACE, measured, seed=1, store=tmp_path)
    np.testing.assert_array_equal(again.sampling.draws, found.sampling.draws)
