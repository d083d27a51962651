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
    """Coefficients of the recursion as functions of the parameters: a trend, and what Kriging adds to some of them."""

    trend: ChaosExpansion  # All coefficients
    deviation: Regression | None = None  # Scaled deviations from the trend
    varying: np.ndarray | None = None  # Which coefficients deviate
    scale: np.ndarray | None = None  # Scale of their deviations
    # Whose coordinates trend and deviation take; they take the parameters themselves when left out
    space: ParameterSpace | None = None

    def predict(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run coefficient"]:
        """Coefficients at points."""
        point = theta if self.space is None else self.space.in_coordinates(theta)
        found = self.trend.predict(point)
        if self.deviation is None or self.varying is None or self.scale is None:
            return found
        places = self.scale[:, None] * np.eye(found.shape[1])[self.varying]
        return found + product(self.deviation.predict(point), places)

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Give what they consist of, for a file."""
        plain, arrays = self.trend.to_plain()
        said: dict[str, Any] = {"trend": plain}
        if self.space is not None:
            said["coordinates"] = self.trend.basis.space.to_plain()
        found = put_under("trend", arrays)
        if self.deviation is not None and self.varying is not None and self.scale is not None:
            plain, arrays = self.deviation.to_plain()
            said["deviation"] = [self.deviation.word, plain]
            found |= put_under("deviation", arrays)
            found |= {"varying": self.varying, "scale": self.scale}
        return said, found

    @classmethod
    def from_plain(cls, space: Any, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> Coefficients:
        """Make them again from what `to_plain` said."""
        own = space if "coordinates" in plain else None
        inner = space if own is None else ParameterSpace.from_plain(plain["coordinates"])
        trend = ChaosExpansion.from_plain(inner, plain["trend"], found_under("trend", arrays))
        if "deviation" not in plain:
            return cls(trend, space=own)
        word, said = plain["deviation"]
        deviation = regression_from_plain(word, inner, said, found_under("deviation", arrays))
        return cls(trend, deviation, arrays["varying"], arrays["scale"], own)
