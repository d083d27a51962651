"""Stored runs are read as they are needed."""

import numpy as np

import structid as si
from waves import RECORD, SPACE, wave_model


def test_runs_are_read_as_they_are_needed(tmp_path):
    runs = si.Campaign(wave_model(), RECORD, SPACE.sample(25, seed=1), tmp_path / "r.h5").run()
    whole = runs.values
    np.testing.assert_array_equal(np.concatenate([b.values for b in runs.batches(7)]), whole)
    np.testing.assert_array_equal(runs[[5, 3, 5]].values, whole[[5, 3, 5]])
    np.testing.assert_array_equal(runs[::3][1:4].values, whole[[3, 6, 9]])
    np.testing.assert_array_equal(runs[runs.design.values[:, 0] > 0.5].values, whole[runs.design.values[:, 0] > 0.5])
    assert len(runs[4]) == 1 and runs.histories().channels == ("velocity",)
    model = wave_model(isolated=False)
    direct = si.Runs.from_histories(runs.design, model.simulate(runs.design, RECORD), RECORD)
    np.testing.assert_array_equal(direct.values, whole)
