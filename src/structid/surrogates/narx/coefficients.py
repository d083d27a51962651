"""Coefficients of a recursion as functions of the parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.matrices.row_by_row import product
from structid.probability.space import ParameterSpace
from structid.surrogates.chaos.chaos_expansion import ChaosExpansion
from structid.surrogates.named_arrays import found_under, put_under
from structid.surrogates.regression import Regression
from structid.surrogates.regression_list import regression_from_plain


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Coefficients of the recursion as functions of the parameters: a trend, and Kriging of deviations from the trend."""

    trend: ChaosExpansion  # trend of all coefficients
    deviation: Regression | None = None  # Kriging of the scaled deviations
    varying: np.ndarray | None = None  # indices of the coefficients that deviate
    scale: np.ndarray | None = None  # scales of these deviations
    # Space whose coordinates are the inputs of trend and deviation; by default the inputs are the parameters
    space: ParameterSpace | None = None

    def predict(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run coefficient"]:
        """Return the coefficients at parameter points."""
        point = theta if self.space is None else self.space.in_coordinates(theta)
        coefficients = self.trend.predict(point)
        if self.deviation is None or self.varying is None or self.scale is None:
            return coefficients
        places = self.scale[:, None] * np.eye(coefficients.shape[1])[self.varying]
        return coefficients + product(self.deviation.predict(point), places)

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the contents for a file."""
        plain, arrays = self.trend.to_plain()
        contents: dict[str, Any] = {"trend": plain}
        if self.space is not None:
            contents["coordinates"] = self.trend.basis.space.to_plain()
        result = put_under("trend", arrays)
        if self.deviation is not None and self.varying is not None and self.scale is not None:
            plain, arrays = self.deviation.to_plain()
            contents["deviation"] = [self.deviation.word, plain]
            result |= put_under("deviation", arrays)
            result |= {"varying": self.varying, "scale": self.scale}
        return contents, result

    @classmethod
    def from_plain(cls, space: Any, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> Coefficients:
        """Rebuild from the result of `to_plain`."""
        coordinates = space if "coordinates" in plain else None
        inner = space if coordinates is None else ParameterSpace.from_plain(plain["coordinates"])
        trend = ChaosExpansion.from_plain(inner, plain["trend"], found_under("trend", arrays))
        if "deviation" not in plain:
            return cls(trend, space=coordinates)
        word, contents = plain["deviation"]
        deviation = regression_from_plain(word, inner, contents, found_under("deviation", arrays))
        return cls(trend, deviation, arrays["varying"], arrays["scale"], coordinates)
