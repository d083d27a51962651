"""Selection of NARX terms by the free-run error of nested sets of terms, over all experiments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.core.progress import Progress
from structid.surrogates.chaos.lars import least_angle_order, orthogonal_order
from structid.surrogates.narx.structure.recursion import Recursion
from structid.surrogates.narx.structure.terms import Term
from structid.surrogates.narx.training.free_run import FreeRun, robust_loss
from structid.surrogates.narx.training.one_step_regression import (
    FIRST_SHAPES,
    TRIED_RUNS,
    batched_solution,
    constant_shapes,
    per_experiment_solution,
)
from structid.surrogates.narx.training.training_set import TrainingSet, spread_rows

MOST_CANDIDATES = 60
"""Largest number of sets of terms that are compared by free runs."""


def select_terms(
    runs: FreeRun, data: TrainingSet, method: str, most: int | None, progress: Progress | None = None
) -> Recursion:
    """Select terms as in the first phase of the thesis, by the free-run error over all experiments (eqs. 2.62 to 2.66).

    The one-step regression of each experiment orders the terms and so proposes nested sets. Each proposed set is refitted to every
    experiment by ordinary least squares and simulated in a free run. The set with the smallest robust loss is kept.
    """
    recursion = runs.recursion
    some = data[spread_rows(data.weights, TRIED_RUNS)]
    vector = constant_shapes(recursion, FIRST_SHAPES[1])
    square, inner = runs.regression_equations(np.tile(vector, (len(some), 1)), some)
    kept: list[tuple[Term, ...]] = []
    start = 0
    for output, terms in enumerate(recursion.terms):
        columns = slice(start, start + len(terms))
        candidates = _proposed(
            square[:, output, columns, columns], inner[:, output, columns], method, most or len(terms)
        )
        kept.append(_best_candidate(runs, some, output, columns, candidates, square, inner, vector))
        start += len(terms)
        if progress is not None:
            progress(output + 1, len(recursion.terms))
    return replace(recursion, terms=tuple(kept))


def _proposed(square: np.ndarray, inner: np.ndarray, method: str, most: int) -> list[tuple[int, ...]]:
    """Return the sets of terms proposed by the experiments, most frequent first."""
    count: dict[tuple[int, ...], int] = {}
    for gram, covariance in zip(square, inner, strict=True):
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        standard = gram / scale[:, None] / scale
        if method == "lars":
            order = least_angle_order(standard, covariance / scale, 1, min(most, len(scale)))
        else:
            order = orthogonal_order(standard, covariance / scale, min(most, len(scale)))
        for size in range(1, len(order) + 1):
            chosen = tuple(sorted(int(i) for i in order[:size]))
            count[chosen] = count.get(chosen, 0) + 1
    ranked = sorted(count, key=lambda c: (-count[c], len(c), c))
    return ranked[:MOST_CANDIDATES]


def _best_candidate(
    runs: FreeRun,
    data: TrainingSet,
    output: int,
    own: slice,
    candidates: list[tuple[int, ...]],
    square: np.ndarray,
    inner: np.ndarray,
    vector: np.ndarray,
) -> tuple[Term, ...]:
    """Refit every candidate set to every experiment, with all terms of the other outputs, and compare free runs."""
    recursion = runs.recursion
    full = per_experiment_solution(recursion, square, inner, vector)
    best, lowest = recursion.terms[output], np.inf
    for chosen in candidates:
        coefficients = full.copy()
        coefficients[:, own] = 0.0
        columns = own.start + np.array(chosen)
        gram = square[:, output][:, columns][:, :, columns]
        coefficients[:, columns] = batched_solution(gram, inner[:, output][:, columns])
        loss = robust_loss(runs.errors(coefficients, data)[:, [output]], 1e-2)
        if loss < lowest:
            best, lowest = tuple(recursion.terms[output][i] for i in chosen), loss
    return best
