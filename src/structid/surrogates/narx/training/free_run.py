"""Compiled free runs of a NARX over a training set: errors, sensitivities and normal equations.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.engine.device import jnp
from structid.engine.lanes.in_lanes import InLanes
from structid.engine.time_loop import Fold, TimeLoop, sum_of_squares, with_sensitivities
from structid.surrogates.narx.structure.recursion import UNROLLED, Recursion
from structid.surrogates.narx.training.training_set import TrainingSet

LARGEST_ERROR = 1e6
"""Largest error of a free run; larger or non-finite errors are set to this value."""


class FreeRun:
    """Compiled runs of a recursion over a training set."""

    def __init__(self, recursion: Recursion, bound: float, horizon: int | None = None, known: int = 0) -> None:
        self.recursion, self.bound, self.horizon, self.known = recursion, bound, horizon, known
        self._compiled_outputs = InLanes(self._outputs, 2)
        self._compiled_errors = InLanes(self._errors, 1)
        self._compiled_normal = InLanes(self._normal, 2)
        self._compiled_regression = InLanes(self._regression, 1)

    def _loop(self, coefficients: Any, signals: Any, unroll: int = UNROLLED) -> TimeLoop:
        if self.horizon is None and not self.known:
            return self.recursion.free_loop(coefficients, signals, self.bound, unroll)
        return self.recursion.restarted_loop(coefficients, signals, self._starts, self.bound, unroll)

    def _starts(self, samples: np.ndarray) -> np.ndarray:
        """Return a mask of the samples at which the run starts from the measured past."""
        return samples < self.known if self.horizon is None else samples % self.horizon == 0

    def _outputs(self, rows: Any, signals: Any) -> Any:
        """Return the scaled outputs (time, output, run)."""
        return self._loop(rows.T, signals).run()[0]

    def _residual(self, outputs: Any, row: Any) -> Any:
        """Return the residuals y − ŷ (output, run), which are zero for unused samples."""
        return jnp.where(row[-1] > 0, jnp.stack(self.recursion.measured_outputs(row)) - outputs, 0.0)

    def _errors(self, rows: Any, signals: Any) -> Any:
        """Return Σ(y − ŷ)² (output, run)."""
        squares = sum_of_squares(_zeros(rows, len(self.recursion.outputs)))
        return self._loop(rows.T, signals).folded(squares, signals[:-1], self._residual)[0]

    def _normal(self, rows: Any, signals: Any) -> tuple[Any, Any]:
        """Return the lower triangle of JᵀJ, row by row, (pair, output, run), and Jᵀr (coefficient, output, run)."""
        # A step with sensitivities is long. If unrolled, XLA would take two to ten times as long to run and to compile it.
        loop = with_sensitivities(lambda c: self._loop(c, signals, unroll=1), rows.T)

        def sample(outputs_and_slopes: tuple[Any, Any], row: Any) -> tuple[Any, Any]:
            outputs, sensitivities = outputs_and_slopes
            return sensitivities * row[-1], self._residual(outputs, row)

        shape = self.recursion.size, len(self.recursion.outputs)
        sums: tuple[Any, Any] = loop.folded(_products(rows, *shape), signals[:-1], sample)[0]
        return sums

    def _regression(self, rows: Any, signals: Any) -> list[tuple[Any, Any]]:
        """Return ΦᵀΦ (pair, run) and Φᵀy (term, run) of each output; Φ contains the terms on the measured outputs."""
        recursion = self.recursion
        ends = np.cumsum([len(of_output) for of_output in recursion.terms])
        each = [_products(rows, len(of_output)) for of_output in recursion.terms]
        slices = [slice(end - len(of_output), end) for end, of_output in zip(ends, recursion.terms, strict=True)]

        def folded(sums: Any, at: tuple[Any, Any]) -> Any:
            terms, row = at
            counted = terms * row[-1]
            parts = zip(each, slices, recursion.measured_outputs(row), sums, strict=True)
            return [fold.step(sum_, (counted[columns], y)) for fold, columns, y, sum_ in parts]

        all_outputs = Fold(
            [fold.start for fold in each],
            folded,
            lambda sums: [fold.value(sum_) for fold, sum_ in zip(each, sums, strict=True)],
        )
        loop = recursion.one_step_loop(rows.T, signals)
        result: list[tuple[Any, Any]] = loop.folded(all_outputs, signals[1:], lambda terms, row: (terms, row))[0]
        return result

    def outputs(
        self, coefficients: Float[np.ndarray, "run coefficient"], data: TrainingSet
    ) -> Float[np.ndarray, "run time output"]:
        """Compute the scaled outputs of every run."""
        return np.asarray(np.moveaxis(self._compiled_outputs(coefficients, signals=data.signals), 2, 0))

    def errors(
        self, coefficients: Float[np.ndarray, "run coefficient"], data: TrainingSet
    ) -> Float[np.ndarray, "run output"]:
        """Compute the free-run error of every run and output, ε = Σ(y − ŷ)²/Σ(y − ȳ)² (thesis eq. 2.65)."""
        errors = self._compiled_errors(coefficients, signals=data.signals).T / data.spread
        return np.minimum(np.where(np.isfinite(errors), errors, LARGEST_ERROR), LARGEST_ERROR)

    def normal_equations(
        self, coefficients: Float[np.ndarray, "run coefficient"], data: TrainingSet
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute JᵀJ and Jᵀr of the free run, divided by Σ(y − ȳ)² of each run and output."""
        square, inner = self._compiled_normal(coefficients, signals=data.signals)
        return _relative(_symmetric(square), _runs_first(inner), data.spread)

    def regression_equations(
        self, shapes: Float[np.ndarray, "run coefficient"], data: TrainingSet
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute ΦᵀΦ and Φᵀy of the one-step regression, divided by Σ(y − ȳ)² of each run and output."""
        size, outputs = self.recursion.size, len(self.recursion.outputs)
        square, inner = np.zeros((len(shapes), outputs, size, size)), np.zeros((len(shapes), outputs, size))
        start = 0
        for index, (pairs, products) in enumerate(self._compiled_regression(shapes, signals=data.signals)):
            columns = slice(start, start + len(products))
            square[:, index, columns, columns], inner[:, index, columns] = _symmetric(pairs), products.T
            start = columns.stop
        return _relative(square, inner, data.spread)


def _zeros(rows: Any, *shape: int) -> Any:
    """Return zeros (…, run)."""
    return jnp.zeros((*shape, rows.shape[0]))


def _products(rows: Any, size: int, *more: int) -> Fold:
    """Return a fold for samples a (size, …, run), b (…, run): Σ aᵢaⱼ for j ≤ i, (pair, …, run), and Σ aᵢb, (size, …, run)."""

    def folded(sums: tuple[list[Any], Any], sample: tuple[Any, Any]) -> tuple[list[Any], Any]:
        (pairs, products), (a, b) = sums, sample
        return [pairs[i] + a[i] * a[: i + 1] for i in range(size)], products + a * b

    start = [_zeros(rows, i + 1, *more) for i in range(size)], _zeros(rows, size, *more)
    return Fold(start, folded, lambda sums: (jnp.concatenate(sums[0]), sums[1]))


def _symmetric(pairs: np.ndarray) -> np.ndarray:
    """Return matrices (run, …, size, size) from their lower triangles (pair, …, run)."""
    triangles = _runs_first(pairs)
    size = (math.isqrt(8 * len(pairs) + 1) - 1) // 2
    matrices, (i, j) = np.empty((*triangles.shape[:-1], size, size)), np.tril_indices(size)
    matrices[..., i, j] = matrices[..., j, i] = triangles
    return matrices


def _runs_first(sums: np.ndarray) -> np.ndarray:
    """Exchange the first and last axes of sums: (number, …, run) becomes (run, …, number)."""
    return np.moveaxis(sums, (0, -1), (-1, 0))


def _relative(square: np.ndarray, inner: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Divide normal equations by Σ(y − ȳ)²; set equations to zero if they are not finite or are too large."""
    good = np.isfinite(square).all(axis=(2, 3)) & np.isfinite(inner).all(axis=2) & (np.abs(square).max((2, 3)) < 1e14)
    with np.errstate(invalid="ignore"):
        square = np.where(good[:, :, None, None], square / spread[:, :, None, None], 0.0)
        inner = np.where(good[:, :, None], inner / spread[:, :, None], 0.0)
    return square, inner


def robust_loss(
    errors: Float[np.ndarray, "run output"], scale: float, weights: Float[np.ndarray, " run"] | None = None
) -> float:
    """Compute the mean of log(1 + ε/s), which diverged runs do not dominate."""
    return float(np.average(np.log1p(errors / scale).mean(axis=1), weights=weights))
