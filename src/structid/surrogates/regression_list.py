"""All classes of fitted regressions, by name in files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from structid.probability.space import ParameterSpace
from structid.surrogates.chaos.chaos_expansion import ChaosExpansion
from structid.surrogates.in_coordinates import InCoordinates
from structid.surrogates.kriging.predictor import KrigingPredictor
from structid.surrogates.regression import Regression

REGRESSIONS: dict[str, Any] = {kind.word: kind for kind in (ChaosExpansion, KrigingPredictor, InCoordinates)}
"""Classes of regressions; add a line here for a new class."""


def regression_from_plain(
    word: str, space: ParameterSpace, plain: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
) -> Regression:
    """Rebuild a regression from the result of `to_plain`."""
    regression: Regression = REGRESSIONS[word].from_plain(space, plain, arrays)
    return regression
