"""The interface of fitted regressions of outputs on parameters, and a check of their training data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.probability.designs import Design

FEWEST_TRAINING_RUNS = 3
"""Minimum number of runs for a regression."""


class Regression(Protocol):
    """A fitted regression of one or many outputs on the parameters, such as a polynomial chaos expansion or a Kriging."""

    # Name of the class in files; its `from_plain` reads the result of `to_plain`
    word: ClassVar[str]

    @property
    def leave_one_out_error(self) -> np.ndarray:
        """Mean squared leave-one-out residual relative to the variance of the output, shape (output,)."""

    def predict(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run output"]:
        """Predict the outputs."""

    def deviation(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run output"] | None:
        """Predict the standard deviation of the regression's error at each point."""

    def predict_with_deviation(self, theta: Float[Array, "run parameter"]) -> tuple[Any, Any | None]:
        """Predict the outputs and the standard deviations of the regression's error together."""

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the contents of the regression, without its parameter space, for a file."""


def check_training(where: str, design: Design, values: Any) -> tuple[np.ndarray, np.ndarray]:
    """Check the training data of a regression."""
    if not isinstance(design, Design):
        raise InputError(
            where,
            f"a {type(design).__name__}",
            "a Design, which has points and their space",
            "Create one with space.sample(500, seed=1) or Design(points, space).",
        )
    theta = _checked_points(where, design.values, design.space.dimension, design.names)
    outputs = np.asarray(values, dtype=np.float64)
    outputs = outputs[:, None] if outputs.ndim == 1 else outputs
    if outputs.ndim != 2 or len(outputs) != len(theta):
        raise InputError(
            where, f"values of shape {np.shape(values)} for {len(theta)} points", f"shape ({len(theta)}, output)"
        )
    bad = np.flatnonzero(~np.isfinite(outputs).all(axis=1))
    if len(bad):
        raise InputError(
            where,
            f"{len(bad)} rows are not finite, the first is row {bad[0]}",
            "finite numbers",
            "Leave failed runs out.",
        )
    if len(theta) < FEWEST_TRAINING_RUNS:
        raise InputError(where, f"{len(theta)} runs", f"at least {FEWEST_TRAINING_RUNS} runs")
    _check_varying(where, outputs)
    return theta, outputs


def _checked_points(where: str, theta: Any, dimension: int, names: Sequence[str]) -> np.ndarray:
    """Return points as an array if they have a column for each parameter and are finite."""
    points = np.asarray(theta, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != dimension:
        raise InputError(
            where, f"points of shape {points.shape}", f"(run, {dimension}) with the columns {', '.join(names)}"
        )
    if not np.isfinite(points).all():
        raise InputError(
            where, f"{np.count_nonzero(~np.isfinite(points).all(axis=1))} points are not finite", "finite numbers"
        )
    return points


def _check_varying(where: str, outputs: np.ndarray) -> None:
    ranges = np.ptp(outputs, axis=0)
    constant = np.flatnonzero(ranges <= 1e-14 * np.abs(outputs).max(axis=0))
    if len(constant):
        raise InputError(
            where,
            f"output {constant[0]} is {outputs[0, constant[0]]:g} in every run",
            "outputs that vary",
            "Omit this output, since a constant needs no fit.",
        )
