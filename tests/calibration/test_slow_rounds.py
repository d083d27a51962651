"""Rounds of a calibration that hardly improve the surrogate: the reader is told, and told what to do."""

import logging

import numpy as np
import pytest

import structid as si
from structid.calibration.calibration_result import Round, hint_for_slow_rounds


def rounds(*exponents: float) -> list[Round]:
    return [
        Round(number, 10 + 10 * number, 0.1, 0, 10, exponent, 30.0, np.inf, 0, None, np.zeros(0), np.zeros(0))
        for number, exponent in enumerate(exponents)
    ]


class OfSolver:
    """A posterior of which only the model's kind matters."""

    class model:
        batched = False


@pytest.mark.parametrize(
    ("exponents", "told"),
    [
        ((0.001, 0.001, 0.001), False),  # too early
        ((0.001, 0.001, 0.0012, 0.001), True),
        ((0.0, 0.0, 0.0, 0.0), True),
        ((0.001, 0.01, 0.1, 0.3), False),  # progress
        ((0.2, 0.4, 0.5, 0.6), True),
        ((0.001, 0.001, 0.001, 1.0), False),  # good enough
    ],
)
def test_a_lack_of_progress_is_told_after_three_rounds(exponents, told):
    assert bool(hint_for_slow_rounds(rounds(*exponents), OfSolver)) == told


@pytest.mark.slow
def test_what_no_surrogate_can_learn_is_told_in_the_log(caplog):
    """A response with hundreds of waves within the prior: every round has new runs, and none of them helps the next."""

    def respond(parameters, record):
        return np.sin(record.time * 20.0 * parameters["a"]) + np.cos(90.0 * parameters["b"] * record.time)

    space = si.ParameterSpace(a=si.Uniform(1.0, 3.0), b=si.Uniform(1.0, 3.0))
    record = si.GroundMotion.synthetic(seed=3, duration=6.0)
    measured = si.Observation(
        record, respond({"a": 2.1, "b": 1.7}, record) + 0.02 * np.random.default_rng(0).normal(size=len(record))
    )
    model = si.CallableModel(respond, free=space.names, channels=("velocity",), isolated=False)
    with caplog.at_level(logging.INFO, logger="structid.calibration"):
        result = si.calibrate(
            model, space, measured, plan=si.Plan(true_runs=61, start=10, batch=5, certificate=20), seed=1
        )
    assert not result.certified
    assert "hardly improved the surrogate" in result.hint
    assert sum("hardly improved the surrogate" in record.getMessage() for record in caplog.records) == 1
