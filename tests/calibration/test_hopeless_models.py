"""A solver of which no run finishes: the first design says so, and no more is spent on it."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import CampaignStoppedError


def test_a_model_of_which_no_run_finishes_stops_after_the_first_design():
    asked = []

    def respond(parameters, record):
        asked.append(parameters)
        raise KeyError("k")

    space = si.ParameterSpace(stiffness=si.Normal(7.4, 0.7, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0))
    record = si.GroundMotion.synthetic(seed=3, duration=6.0)
    measured = si.Observation(record, np.sin(record.time))
    broken = si.CallableModel(respond, free=space.names, channels=("velocity",), isolated=False)
    with pytest.raises(CampaignStoppedError, match=r"None of the first 10 model runs.*KeyError"):
        si.calibrate(broken, space, measured, seed=1)
    assert len(asked) == 10
