"""Purposes of random numbers, numbered in one place so that every purpose has its own stream.

A stream is ``numpy.random.SeedSequence([seed, purpose, index])``. NumPy pads such a list with zeros, so
``[seed, purpose]`` would give the same stream as index 0. Every stream therefore has all three numbers.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

_LARGEST_WORD = 2**32
"""Smallest seed that takes two 32-bit words, so that its stream could coincide with a stream of another seed."""


class Purpose(IntEnum):
    """Purposes of random numbers. The number is part of the stream: never change or reuse a number."""

    LATIN_HYPERCUBE = 0
    MAXIMIN = 1
    SOBOL = 2
    RANDOM_DESIGN = 3

    SMC_START = 11
    SMC_STAGE = 12
    SMC_MOVES = 13
    SMC_SCOUTS = 14

    DELAYED_ACCEPTANCE_START = 21
    DELAYED_ACCEPTANCE_STEPS = 22

    NUTS_START = 31
    NUTS_WARM_UP = 32
    NUTS_STEPS = 33

    REPLICA_TRUTH = 41
    REPLICA_NOISE = 42
    REPLICA_CALIBRATION = 44
    RANK_JITTER = 43

    BESIDE = 34

    ENSEMBLE_START = 51
    ENSEMBLE_MOVES = 52
    ENSEMBLE_SETTLING = 53

    PREDICTION_ON_THE_RECORD = 61
    PREDICTION_FROM_THE_PRIOR = 62
    PREDICTION_ON_ANOTHER_RECORD = 63
    PRIOR_DRAWS = 64
    HIDDEN_ON_ANOTHER_RECORD = 65
    PREDICTED_MODEL_ERROR = 66
    PEAK_OF_ANOTHER_RECORD = 67
    NOISE_OF_THE_PEAK = 68
    WITHIN_A_ROUNDING_STEP = 69

    CALIBRATION_EXPLORING = 71
    CALIBRATION_BATCH = 72
    CALIBRATION_SAMPLING = 73
    SURROGATE_ERROR = 74
    CERTIFIED_DRAWS = 75
    INTERPOLATED_VALUES = 76
    PRIOR_BESIDE_DRAWS = 77

    KRIGING_SEARCH = 81
    HELD_OUT_RUNS = 82
    BOOTSTRAP = 83

    SEARCH_STARTS = 91

    LAW_CHOICE = 95
    SENSITIVITY = 97
    FRAGILITY_RESAMPLES = 98
    TIMED_DRAWS = 96

    SENSOR_NOISE = 101
    HYSTERETIC_LAW = 103

    VALIDATION_DESIGN = 0x76616C
    RECORD = 0x67726F75
    VIRTUAL_NOISE = 0x6E6F6973


def _sequence(seed: int, purpose: Purpose, index: int) -> np.random.SeedSequence:
    if seed >= _LARGEST_WORD:
        seed = int(np.random.SeedSequence(seed).generate_state(1)[0])
    return np.random.SeedSequence([seed, purpose, index])


def stream(seed: int, purpose: Purpose, index: int = 0) -> np.random.Generator:
    """Return the random generator for one purpose."""
    return np.random.default_rng(_sequence(seed, purpose, index))


def derived_seed(seed: int, purpose: Purpose, index: int = 0) -> int:
    """Return the seed of a component that derives its own streams."""
    return int(_sequence(seed, purpose, index).generate_state(1)[0])
