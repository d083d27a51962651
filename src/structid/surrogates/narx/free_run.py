"""Compiled free runs of a NARX over a training set: errors, sensitivities, and the normal equations made of them.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from structid.device import jnp, over_runs
from structid.surrogates.narx.recursion import UNROLLED, Recursion
from structid.surrogates.narx.training_set import TrainingSet

CHUNK = 64
"""Number of runs whose sensitivities are in memory at once. It is always the same, so that they are compiled once."""

LARGEST_ERROR = 1e6
"""Largest error of a free run; a larger one, or a run that is not finite, counts as this."""


class FreeRun:
    """Compiled runs of a recursion over a training set.

    Parameters
    ----------
    recursion : Recursion
        The structure.
    bound : float
        Outputs are kept within ± this value.
    horizon : int, optional
        Number of samples after which the run starts again from the measured past; if left out, it never does.
    """

    def __init__(self, recursion: Recursion, bound: float, horizon: int | None = None) -> None:
        self.recursion, self.bound, self.horizon = recursion, bound, horizon

    def _split(self, rows: Any, samples: int) -> tuple[Any, Any, Any, Any]:
        """Split rows into coefficients (coefficient, run), x (time, input, run), y (time, output, run), counted (time, run)."""
        size, inputs, outputs = self.recursion.size, len(self.recursion.inputs), len(self.recursion.outputs)
        coefficients, rest = rows[:, :size].T, rows[:, size:]
        x, y, counted = jnp.split(rest, [samples * inputs, samples * (inputs + outputs)], axis=1)

        def runs_last(flat: Any, signals: int) -> Any:
            return jnp.moveaxis(flat.reshape(flat.shape[0], samples, signals), 0, 2)

        return coefficients, runs_last(x, inputs), runs_last(y, outputs), counted.T

    def _compiled(self, kind: str, samples: int) -> Callable[[np.ndarray], Any]:
        """Compiled function of rows, kept for each length of the record."""
        cache: dict[tuple[str, int], Callable[[np.ndarray], Any]] = self.__dict__.setdefault("_cache", {})
        if (kind, samples) not in cache:
            body = {
                "errors": self._errors, "normal": self._normal, "regression": self._regression, "outputs": self._outputs,
            }[kind]  # fmt: skip
            cache[kind, samples] = over_runs(lambda rows: body(*self._split(rows, samples)))
        return cache[kind, samples]

    def _run(self, coefficients: Any, x: Any, y: Any, unrolled: int = UNROLLED) -> Any:
        """Scaled outputs (time, output, run)."""
        if self.horizon is None:
            return self.recursion.free_run(coefficients, x, self.bound, unrolled)
        return self.recursion.multi_step(coefficients, x, y, self.horizon, self.bound, unrolled)

    def _outputs(self, coefficients: Any, x: Any, y: Any, counted: Any) -> Any:
        """Scaled outputs (run, time, output)."""
        return jnp.moveaxis(self._run(coefficients, x, y), 2, 0)

    def _residual(self, coefficients: Any, x: Any, y: Any, counted: Any) -> Any:
        """Residuals y − ŷ (time, output, run), zero where a sample does not count."""
        return jnp.where(counted[:, None] > 0, y - self._run(coefficients, x, y), 0.0)

    def _errors(self, coefficients: Any, x: Any, y: Any, counted: Any) -> Any:
        """Σ(y − ŷ)² (run, output)."""
        return jnp.sum(self._residual(coefficients, x, y, counted) ** 2, axis=0).T

    def _normal(self, coefficients: Any, x: Any, y: Any, counted: Any) -> tuple[Any, Any]:
        """JᵀJ (run, output, coefficient, coefficient) and Jᵀr (run, output, coefficient)."""
        residual = self._residual(coefficients, x, y, counted)

        def along(direction: Any) -> Any:
            tangent = jnp.broadcast_to(direction[:, None], coefficients.shape) + coefficients * 0.0
            # A step with all its sensitivities is long; unrolled it would take two to ten times as long to run and to compile.
            return jax.jvp(lambda c: self._run(c, x, y, unrolled=1), (coefficients,), (tangent,))[1]

        sensitivity = jax.vmap(along)(jnp.eye(self.recursion.size)) * (counted[:, None] > 0)
        square = jnp.einsum("itok,jtok->koij", sensitivity, sensitivity)
        return square, jnp.einsum("itok,tok->koi", sensitivity, residual)

    def _regression(self, coefficients: Any, x: Any, y: Any, counted: Any) -> tuple[Any, Any]:
        """ΦᵀΦ and Φᵀy in the same shapes: the terms along the measured outputs take the place of the sensitivities."""
        terms = self.recursion.one_step(coefficients, x, y) * (counted[1:, None] > 0)
        squares, inners, start = [], [], 0
        total = self.recursion.size
        for index, of_output in enumerate(self.recursion.terms):
            own = terms[:, start : start + len(of_output)]
            square = jnp.einsum("tik,tjk->kij", own, own)
            inner = jnp.einsum("tik,tk->ki", own, y[1:, index])
            margin = (start, total - start - len(of_output))
            squares.append(jnp.pad(square, ((0, 0), margin, margin)))
            inners.append(jnp.pad(inner, ((0, 0), margin)))
            start += len(of_output)
        return jnp.stack(squares, axis=1), jnp.stack(inners, axis=1)

    def _over(self, kind: str, coefficients: np.ndarray, data: TrainingSet, chunk: int) -> Any:
        """Results of a compiled function for all runs, computed in chunks."""
        run = self._compiled(kind, data.x.shape[1])
        rows = np.hstack([coefficients, data.rows])
        count = len(rows)
        if chunk == CHUNK:  # chunks that are always full are compiled once
            rows = np.concatenate([rows, np.repeat(rows[-1:], -count % chunk, axis=0)])
        parts = [run(rows[start : start + chunk]) for start in range(0, len(rows), chunk)]
        if isinstance(parts[0], tuple):
            return tuple(np.concatenate(column)[:count] for column in zip(*parts, strict=True))
        return np.concatenate(parts)[:count]

    def outputs(self, coefficients: np.ndarray, data: TrainingSet) -> np.ndarray:
        """Compute the scaled outputs of every run.

        Parameters
        ----------
        coefficients : ndarray, shape (run, coefficient)
            ϑ of every run.
        data : TrainingSet
            The experiments.

        Returns
        -------
        ndarray, shape (run, time, output)
            Outputs, kept within ± the bound.
        """
        return np.asarray(self._over("outputs", coefficients, data, 1000))

    def errors(self, coefficients: np.ndarray, data: TrainingSet) -> np.ndarray:
        """Compute the free-run error of every run and output, ε = Σ(y − ŷ)²/Σ(y − ȳ)² (thesis eq. 2.65).

        Parameters
        ----------
        coefficients : ndarray, shape (run, coefficient)
            ϑ of every run.
        data : TrainingSet
            The experiments.

        Returns
        -------
        ndarray, shape (run, output)
            Errors; `LARGEST_ERROR` where the run is not finite.
        """
        found = self._over("errors", coefficients, data, 1000) / data.spread
        return np.minimum(np.where(np.isfinite(found), found, LARGEST_ERROR), LARGEST_ERROR)

    def normal_equations(self, coefficients: np.ndarray, data: TrainingSet) -> tuple[np.ndarray, np.ndarray]:
        """Compute JᵀJ and Jᵀr of the free run, relative to Σ(y − ȳ)² of each run and output.

        Parameters
        ----------
        coefficients : ndarray, shape (run, coefficient)
            ϑ of every run.
        data : TrainingSet
            The experiments.

        Returns
        -------
        tuple of ndarray
            (run, output, coefficient, coefficient) and (run, output, coefficient); zero where they are not finite.
        """
        square, inner = self._over("normal", coefficients, data, CHUNK)
        return _relative(square, inner, data.spread)

    def regression_equations(self, shapes: np.ndarray, data: TrainingSet) -> tuple[np.ndarray, np.ndarray]:
        """Compute ΦᵀΦ and Φᵀy of the one-step regression, relative to Σ(y − ȳ)² of each run and output.

        Parameters
        ----------
        shapes : ndarray, shape (run, coefficient)
            Coefficient vectors; only the shapes of the memories, at their end, are used.
        data : TrainingSet
            The experiments.

        Returns
        -------
        tuple of ndarray
            (run, output, coefficient, coefficient) and (run, output, coefficient); zero where they are not finite.
        """
        square, inner = self._over("regression", shapes, data, CHUNK)
        return _relative(square, inner, data.spread)


def _relative(square: np.ndarray, inner: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations divided by Σ(y − ȳ)²; zero where they are not finite or too large."""
    good = np.isfinite(square).all(axis=(2, 3)) & np.isfinite(inner).all(axis=2) & (np.abs(square).max((2, 3)) < 1e14)
    with np.errstate(invalid="ignore"):
        square = np.where(good[:, :, None, None], square / spread[:, :, None, None], 0.0)
        inner = np.where(good[:, :, None], inner / spread[:, :, None], 0.0)
    return square, inner


def robust_loss(errors: np.ndarray, scale: float, weights: np.ndarray | None = None) -> float:
    """Compute the mean of log(1 + ε/s): runs that diverge do not dominate it.

    Parameters
    ----------
    errors : ndarray, shape (run, output)
        Relative errors.
    scale : float
        s.
    weights : ndarray, shape (run,), optional
        Weight of each run.

    Returns
    -------
    float
        The loss.
    """
    return float(np.average(np.log1p(errors / scale).mean(axis=1), weights=weights))
