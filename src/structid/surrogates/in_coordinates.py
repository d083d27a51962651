"""Regressions in coordinates of a parameter space: functions of the parameters on which the outputs depend more simply."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.probability.designs import Design
from structid.probability.marginals import Uniform
from structid.probability.space import ParameterSpace
from structid.surrogates.chaos.chaos_expansion import ChaosExpansion
from structid.surrogates.kriging.predictor import KrigingPredictor
from structid.surrogates.regression import Regression


@dataclass(frozen=True, eq=False)
class InCoordinates:
    """A regression on the coordinates of a space."""

    word: ClassVar[str] = "InCoordinates"
    space: ParameterSpace  # space with coordinates
    inner: Any  # regression on the coordinates, which have uniform priors over the range of the runs

    @property
    def leave_one_out_error(self) -> np.ndarray:
        """Leave-one-out error of the inner regression; see `Regression.leave_one_out_error`."""
        return np.asarray(self.inner.leave_one_out_error)

    @property
    def leave_one_out_residuals(self) -> np.ndarray:
        """Leave-one-out residuals of the inner regression, shape (run, output)."""
        return np.asarray(self.inner.leave_one_out_residuals)

    def predict(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run output"]:
        """Predict the outputs; see `Regression.predict`."""
        return self.inner.predict(self.space.in_coordinates(theta))

    def deviation(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run output"] | None:
        """Predict the standard deviations; see `Regression.deviation`."""
        return self.inner.deviation(self.space.in_coordinates(theta))

    def predict_with_deviation(self, theta: Float[Array, "run parameter"]) -> tuple[Any, Any | None]:
        """Predict outputs and standard deviations; see `Regression.predict_with_deviation`."""
        prediction: tuple[Any, Any | None] = self.inner.predict_with_deviation(self.space.in_coordinates(theta))
        return prediction

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the contents for a file; see `Regression.to_plain`."""
        plain, arrays = self.inner.to_plain()
        return {"word": self.inner.word, "space": self.inner_space.to_plain(), "inner": plain}, arrays

    @property
    def inner_space(self) -> ParameterSpace:
        """Space of the coordinates."""
        space: ParameterSpace = self.inner.basis.space if isinstance(self.inner, ChaosExpansion) else self.inner.space
        return space

    @classmethod
    def from_plain(
        cls, space: ParameterSpace, plain: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> InCoordinates:
        """Rebuild a regression from the result of `to_plain`."""
        kind: Any = ChaosExpansion if plain["word"] == ChaosExpansion.word else KrigingPredictor
        return cls(space, kind.from_plain(ParameterSpace.from_plain(plain["space"]), plain["inner"], arrays))


def coordinate_design(design: Design) -> Design:
    """Convert the points of a design to the coordinates of its space, with uniform priors over their range."""
    space: ParameterSpace = design.space
    if not space.coordinates:
        return design
    values = np.asarray(space.in_coordinates(design.values), dtype=np.float64)
    low, high = values.min(axis=0), values.max(axis=0)
    for name, least, most in zip(space.coordinates, low, high, strict=True):
        if not (np.isfinite([least, most]).all() and most > least):
            raise InputError(
                f"coordinate '{name}'", f"{least:g} to {most:g} over the runs", "a finite coordinate that varies"
            )
    ranges = {n: Uniform(float(a), float(b)) for n, a, b in zip(space.coordinates, low, high, strict=True)}
    return Design(values, ParameterSpace(ranges))


def fitted_in_coordinates(design: Design, fit: Callable[[Design], Regression]) -> Regression:
    """Fit a regression in the coordinates of the space if it has any, otherwise in the parameters."""
    points = coordinate_design(design)
    return fit(design) if points is design else InCoordinates(design.space, fit(points))
