"""A test of a frame on a shaking table: from the files of its loggers to a certified posterior and a prediction."""

import re

import numpy as np
import pytest
import xarray

from commands import structid
from shaking_table import BEFORE, STUDY, TRUTH, write_files
from structid.inference.prediction.prediction import predict
from structid.study.run import load


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("table")
    folder.joinpath("study.toml").write_text(STUDY)
    return folder, write_files(folder)


def test_check_prints_what_is_left_out_of_each_sensor(folder):
    printed = structid("check", "study.toml", cwd=folder[0])
    assert printed.returncode == 0, printed.stderr + printed.stdout
    words = " ".join(printed.stdout.split())
    assert "every 0.005 s from 0 to" in words and "726 samples before the record left out" in words
    assert "139 values missing" in words and "unknown polarity" in words
    assert "every 0.01 s" in words and "400 samples before the record left out" in words


def test_the_response_at_the_truth_is_that_of_the_files(folder):
    """The truth of another program leaves the noise alone: whole sensors, with their offsets and directions."""
    posterior = load(folder[0] / "study.toml").posterior
    truth = np.array([[TRUTH.get(name, 1e-4) for name in posterior.names]])
    truth[0, posterior.names.index("offset_3")] = 0.003 * 9.80665
    for index, observation in enumerate(posterior.observations):
        residual = (observation.values - posterior.predict(truth, index)[0])[observation.is_measured[:, 0], 0]
        signal = observation.values[observation.is_measured[:, 0], 0]
        # The offset of a baseline is the mean of 800 noisy values.
        assert residual.std() == pytest.approx(0.02 * signal.std(), rel=0.25)
        assert abs(residual.mean()) < 5.0 * residual.std() / np.sqrt(800)


@pytest.mark.slow
def test_from_files_to_a_certified_posterior(folder):
    place, double = folder
    run = structid("run", "study.toml", "--out", "out", cwd=place)
    assert run.returncode == 0, run.stderr + run.stdout
    assert re.search(r"^CERTIFIED", run.stdout, re.MULTILINE)
    study = load(place / "study.toml")
    posterior = xarray.open_datatree(place / "out" / "posterior.nc")["posterior"].to_dataset()
    draws = np.stack([posterior[name].values.reshape(-1) for name in study.posterior.names], axis=1)
    for name, value in TRUTH.items():
        of_parameter = draws[:, study.posterior.names.index(name)]
        assert abs(of_parameter.mean() - value) < 4.0 * of_parameter.std(), name
    # A run of twice the amplitude, which no calibration has seen
    channels = tuple(c for o in study.posterior.observations for c in o.channels)
    record = study.other_records[0]
    predicted = predict(study.posterior, draws[:: len(draws) // 200], record, channels=channels)
    low, high = predicted.band(discrepancy=True)
    truth = double(record.time + BEFORE - 1.0)
    inside = ((truth >= low) & (truth <= high))[record.time > 1.0]
    assert (inside.mean(axis=0) > 0.95).all()
