"""Training of NARX coefficients that depend on parameters: joint regression, then least squares on the free-run error.

The coefficients of run k are ϑ_k = A ψ(ξ_k), with features ψ of its parameters. One step ahead the outputs are linear in A;
free-running they are not, but the sensitivities J_k = ∂y_k/∂ϑ_k come from differentiating the recursion, and the
Gauss–Newton step has the shape of the joint regression, with sensitivities in the place of regressors:

    Σ_k w_k (J_kᵀJ_k ⊗ ψ_kψ_kᵀ) vec ΔA = Σ_k w_k (J_kᵀr_k ⊗ ψ_k)

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from structid.models.face import Progress
from structid.surrogates.narx.recursion import UNROLLED, Recursion

CHUNK = 64
"""Runs whose sensitivities are in memory at once; always as many, so that they are compiled once."""

SMALLEST_GAIN = 1e-3
"""Of the loss; a smaller one ends the training."""

LARGEST_ERROR = 1e6
"""A free run that errs by more is as bad as one that diverges."""


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Experiments in scaled signals.

    Parameters
    ----------
    x : ndarray, shape (run, time, input)
        Inputs.
    y : ndarray, shape (run, time, output)
        Outputs.
    counted : ndarray of bool, shape (run, time)
        Samples that count: not those beyond the end of a shorter record.
    weights : ndarray, shape (run,)
        How much the error of each run counts.
    """

    x: np.ndarray
    y: np.ndarray
    counted: np.ndarray
    weights: np.ndarray

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, rows: np.ndarray) -> TrainingSet:
        return TrainingSet(self.x[rows], self.y[rows], self.counted[rows], self.weights[rows])

    def alike(self) -> TrainingSet:
        """Let all runs count the same.

        Returns
        -------
        TrainingSet
            With weights of one.
        """
        return replace(self, weights=np.ones(len(self)))

    @cached_property
    def spread(self) -> np.ndarray:
        """Σ (y − ȳ)² of every run and output, shape (run, output): errors are relative to it (thesis eq. 2.65)."""
        count = self.counted.sum(axis=1)[:, None]
        y = np.where(self.counted[:, :, None], self.y, 0.0)
        square = np.sum(y**2, axis=1) - np.sum(y, axis=1) ** 2 / count
        return np.maximum(square, 1e-300)

    @property
    def rows(self) -> np.ndarray:
        """Everything of a run in one row, as compiled functions take it, shape (run, …)."""
        flat = [self.x.reshape(len(self), -1), self.y.reshape(len(self), -1), self.counted]
        return np.hstack(flat)


class FreeRun:
    """Compiled runs of a recursion over a training set.

    Parameters
    ----------
    recursion : Recursion
        The structure.
    bound : float
        Outputs are kept within ± this.
    horizon : int, optional
        Start again from the measured past every so many samples; never, when left out.
    """

    def __init__(self, recursion: Recursion, bound: float, horizon: int | None = None) -> None:
        self.recursion, self.bound, self.horizon = recursion, bound, horizon

    def _split(self, rows: Any, samples: int) -> tuple[Any, Any, Any, Any]:
        """Coefficients (coefficient, run), x (time, input, run), y (time, output, run), counted (time, run)."""
        from structid.device import jnp

        size, inputs, outputs = self.recursion.size, len(self.recursion.inputs), len(self.recursion.outputs)
        coefficients, rest = rows[:, :size].T, rows[:, size:]
        x, y, counted = jnp.split(rest, [samples * inputs, samples * (inputs + outputs)], axis=1)
        move = lambda a, n: jnp.moveaxis(a.reshape(a.shape[0], samples, n), 0, 2)  # noqa: E731
        return coefficients, move(x, inputs), move(y, outputs), counted.T

    def _compiled(self, kind: str, samples: int) -> Callable[[np.ndarray], Any]:
        from structid.device import over_runs

        cache: dict[Any, Any] = self.__dict__.setdefault("_cache", {})
        if (kind, samples) not in cache:
            body = {
                "errors": self._errors, "normal": self._normal, "regression": self._regression, "outputs": self._outputs,
            }[kind]  # fmt: skip
            cache[kind, samples] = over_runs(lambda rows: body(*self._split(rows, samples)))
        return cache[kind, samples]

    def _run(self, coefficients: Any, x: Any, y: Any, unrolled: int = UNROLLED) -> Any:
        if self.horizon is None:
            return self.recursion.free_run(coefficients, x, self.bound, unrolled)
        return self.recursion.multi_step(coefficients, x, y, self.horizon, self.bound, unrolled)

    def _outputs(self, coefficients: Any, x: Any, y: Any, counted: Any) -> Any:
        from structid.device import jnp

        return jnp.moveaxis(self._run(coefficients, x, y), 2, 0)

    def _residual(self, coefficients: Any, x: Any, y: Any, counted: Any) -> Any:
        from structid.device import jnp

        return jnp.where(counted[:, None] > 0, y - self._run(coefficients, x, y), 0.0)

    def _errors(self, coefficients: Any, x: Any, y: Any, counted: Any) -> Any:
        from structid.device import jnp

        return jnp.sum(self._residual(coefficients, x, y, counted) ** 2, axis=0).T

    def _normal(self, coefficients: Any, x: Any, y: Any, counted: Any) -> tuple[Any, Any]:
        """JᵀJ (run, output, coefficient, coefficient) and Jᵀr (run, output, coefficient)."""
        import jax

        from structid.device import jnp

        residual = self._residual(coefficients, x, y, counted)

        def along(direction: Any) -> Any:
            tangent = jnp.broadcast_to(direction[:, None], coefficients.shape) + coefficients * 0.0
            # A step with all its sensitivities is long: unrolled it would take two to ten times as long to run and to compile.
            return jax.jvp(lambda c: self._run(c, x, y, unrolled=1), (coefficients,), (tangent,))[1]

        sensitivity = jax.vmap(along)(jnp.eye(self.recursion.size)) * (counted[:, None] > 0)
        square = jnp.einsum("itok,jtok->koij", sensitivity, sensitivity)
        return square, jnp.einsum("itok,tok->koi", sensitivity, residual)

    def _regression(self, coefficients: Any, x: Any, y: Any, counted: Any) -> tuple[Any, Any]:
        """The same with the terms along the measured outputs in the place of sensitivities."""
        from structid.device import jnp

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
        run = self._compiled(kind, data.x.shape[1])
        rows = np.hstack([coefficients, data.rows])
        count = len(rows)
        if chunk == CHUNK:  # a chunk that is always full is compiled once
            rows = np.concatenate([rows, np.repeat(rows[-1:], -count % chunk, axis=0)])
        parts = [run(rows[start : start + chunk]) for start in range(0, len(rows), chunk)]
        if isinstance(parts[0], tuple):
            return tuple(np.concatenate(column)[:count] for column in zip(*parts, strict=True))
        return np.concatenate(parts)[:count]

    def outputs(self, coefficients: np.ndarray, data: TrainingSet) -> np.ndarray:
        """Scaled outputs of every run.

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
        """Free-run error of every run and output, ε = Σ(y − ŷ)²/Σ(y − ȳ)² (thesis eq. 2.65).

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
        """JᵀJ and Jᵀr of the free run, relative to the spread of each run and output.

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
        """Normal equations of the one-step regression, likewise.

        Parameters
        ----------
        shapes : ndarray, shape (run, coefficient)
            Coefficient vectors; only the memories' shapes at their end are used.
        data : TrainingSet
            The experiments.

        Returns
        -------
        tuple of ndarray
            (run, output, coefficient, coefficient) and (run, output, coefficient).
        """
        square, inner = self._over("regression", shapes, data, CHUNK)
        return _relative(square, inner, data.spread)


def _relative(square: np.ndarray, inner: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    good = np.isfinite(square).all(axis=(2, 3)) & np.isfinite(inner).all(axis=2) & (np.abs(square).max((2, 3)) < 1e14)
    with np.errstate(invalid="ignore"):
        square = np.where(good[:, :, None, None], square / spread[:, :, None, None], 0.0)
        inner = np.where(good[:, :, None], inner / spread[:, :, None], 0.0)
    return square, inner


def joint_solution(
    square: np.ndarray, inner: np.ndarray, features: np.ndarray, weights: np.ndarray, ridge: float
) -> np.ndarray:
    """Solve the joint normal equations, scaled to a unit diagonal, plus a ridge.

    Parameters
    ----------
    square : ndarray, shape (run, coefficient, coefficient)
        G_k: JᵀJ or ΦᵀΦ of each run.
    inner : ndarray, shape (run, coefficient)
        Jᵀr or Φᵀy.
    features : ndarray, shape (run, feature)
        ψ_k.
    weights : ndarray, shape (run,)
        w_k.
    ridge : float
        Added to the unit diagonal.

    Returns
    -------
    ndarray, shape (coefficient, feature)
        A, or ΔA.
    """
    size, width = square.shape[1], features.shape[1]
    # Σ_k G_k ⊗ ψ_kψ_kᵀ as one product of matrices.
    outer = (features[:, :, None] * features[:, None, :]).reshape(len(features), -1)
    matrix = (square * weights[:, None, None]).reshape(len(features), -1).T @ outer
    matrix = matrix.reshape(size, size, width, width).transpose(0, 2, 1, 3).reshape(size * width, size * width)
    right = np.einsum("r,ri,rp->ip", weights, inner, features, optimize=True).ravel()
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, 1.0)
    matrix = matrix / scale[:, None] / scale + ridge * np.eye(len(matrix))
    return np.asarray(np.linalg.solve(matrix, right / scale) / scale).reshape(size, width)


@dataclass
class Trained:
    """Coefficients and how they came about.

    Parameters
    ----------
    coefficients : ndarray, shape (coefficient, feature)
        A.
    history : list of dict
        For each step its loss and the mean and largest error over the training and the hold-out runs.
    """

    coefficients: np.ndarray
    history: list[dict[str, float]] = field(default_factory=list)


def robust_loss(errors: np.ndarray, scale: float, weights: np.ndarray | None = None) -> float:
    """Mean of log(1 + ε/s): no run that diverges rules the sum.

    Parameters
    ----------
    errors : ndarray, shape (run, output)
        Relative errors.
    scale : float
        s.
    weights : ndarray, shape (run,), optional
        How much each run counts.

    Returns
    -------
    float
        The loss.
    """
    return float(np.average(np.log1p(errors / scale).mean(axis=1), weights=weights))


def train_free_run(
    runs: FreeRun,
    start: np.ndarray,
    features: np.ndarray,
    data: TrainingSet,
    held_out: tuple[np.ndarray, TrainingSet] | None,
    steps: int,
    scale: float,
    progress: Progress | None = None,
) -> Trained:
    """Levenberg–Marquardt on the free-run error, with the robust loss by iterated weights.

    A step is accepted only if the loss falls, else the damping is raised: no step can make a good model diverge. What is kept
    is what did best on the runs held out.

    Parameters
    ----------
    runs : FreeRun
        Compiled runs.
    start : ndarray, shape (coefficient, feature)
        A to start from.
    features : ndarray, shape (run, feature)
        ψ of the training runs.
    data : TrainingSet
        The training runs.
    held_out : tuple of ndarray and TrainingSet, optional
        ψ and data of runs that choose when to stop.
    steps : int
        Most steps.
    scale : float
        s of the loss.
    progress : callable, optional
        Told how many steps are done.

    Returns
    -------
    Trained
        The best coefficients.
    """
    current, damping = start, 1e-3
    errors = runs.errors(features @ current.T, data)
    loss = robust_loss(errors, scale, data.weights)
    best = Trained(start, [_entry(loss, errors, current, runs, held_out, scale)])
    lowest = best.history[-1]["judged"]
    for step in range(steps):
        square, inner = runs.normal_equations(features @ current.T, data)
        weights = 1.0 / (scale + errors)  # derivative of the loss by ε
        square = np.einsum("ro,roij->rij", weights, square)
        inner = np.einsum("ro,roi->ri", weights, inner)
        gained = 0.0
        for _ in range(6):
            trial = current + joint_solution(square, inner, features, data.weights, damping)
            trial_errors = runs.errors(features @ trial.T, data)
            gained = loss - robust_loss(trial_errors, scale, data.weights)
            if gained > 0:
                break
            damping *= 10.0
        if gained <= 0:
            break
        current, errors, loss, damping = trial, trial_errors, loss - gained, max(damping / 5.0, 1e-10)
        best.history.append(_entry(loss, errors, current, runs, held_out, scale))
        if best.history[-1]["judged"] < lowest:
            best.coefficients, lowest = current, best.history[-1]["judged"]
        if progress is not None:
            progress(step + 1, steps)
        if gained < SMALLEST_GAIN * loss:
            break
    return best


def _entry(
    loss: float,
    errors: np.ndarray,
    current: np.ndarray,
    runs: FreeRun,
    held_out: tuple[np.ndarray, TrainingSet] | None,
    scale: float,
) -> dict[str, float]:
    entry = {"loss": loss, "mean": float(errors.mean()), "worst": float(errors.max()), "judged": loss}
    if held_out is not None:
        features, data = held_out
        unseen = runs.errors(features @ current.T, data)
        entry |= {"held_out_mean": float(unseen.mean()), "held_out_worst": float(unseen.max())}
        entry["judged"] = robust_loss(unseen, scale, data.weights)
    return entry


def refined_coefficients(
    runs: FreeRun, start: np.ndarray, data: TrainingSet, steps: int, progress: Progress | None = None
) -> np.ndarray:
    """Coefficients of every run on its own free run, drawn towards given ones: maximum a posteriori, by Gauss–Newton.

    The prior's spread is a tenth of what the given coefficients vary by over the runs; the noise is the error they leave.

    Parameters
    ----------
    runs : FreeRun
        Compiled runs.
    start : ndarray, shape (run, coefficient)
        Mean of the prior, and where the search starts.
    data : TrainingSet
        The runs.
    steps : int
        Gauss–Newton steps; a run keeps one only if its error falls.
    progress : callable, optional
        Told how many are done.

    Returns
    -------
    ndarray, shape (run, coefficient)
        ϑ of every run.
    """
    spread = 0.1 * np.maximum(start.std(axis=0), 1e-3 * np.abs(start).max(axis=0) + 1e-9)
    current = start
    errors = runs.errors(current, data).mean(axis=1)
    noise = max(float(np.median(errors)), 1e-12) / data.y.shape[1]
    for step in range(steps):
        square, inner = runs.normal_equations(current, data)
        square, inner = square.mean(axis=1) / noise, inner.mean(axis=1) / noise
        # In units of the prior's spread the prior is the identity, and nothing is ill-conditioned.
        matrix = square * spread[:, None] * spread + np.eye(len(spread))
        right = inner * spread - (current - start) / spread
        trial = current + np.linalg.solve(matrix, right[:, :, None])[:, :, 0] * spread
        found = runs.errors(trial, data).mean(axis=1)
        better = found < errors
        current = np.where(better[:, None], trial, current)
        errors = np.where(better, found, errors)
        if progress is not None:
            progress(step + 1, steps)
    return current
