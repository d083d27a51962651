"""Several observations of one run, such as a file from each sensor: the response is computed once for all of them."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import Any

from jax import lax
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.time_loop import once_along_each, side_by_side
from structid.inference.likelihood.observation_likelihood import Measured, ObservationLikelihood
from structid.observation import Observation


def of_one_test(observations: Sequence[Observation]) -> tuple[tuple[int, ...], ...]:
    """Group the observations of one test, that is, of different channels on one record. A repeated channel is another test."""
    tests: list[tuple[str, set[str], list[int]]] = []
    for number, observation in enumerate(observations):
        record, channels = observation.record.content_hash, set(observation.channels)
        for of_test, channels_seen, numbers in tests:
            if of_test == record and not channels_seen & channels:
                channels_seen |= channels
                numbers.append(number)
                break
        else:
            tests.append((record, channels, [number]))
    return tuple(tuple(numbers) for _, _, numbers in tests)


def of_one_run(bounds: Sequence[ObservationLikelihood]) -> tuple[tuple[int, ...], ...]:
    """Group observations that share a response: one record, one model and the same model parameters."""
    groups: dict[Any, list[int]] = {}
    for number, bound in enumerate(bounds):
        groups.setdefault((id(bound.model), bound.observation.record.content_hash, bound.free), []).append(number)
    return tuple(map(tuple, groups.values()))


def squares_of(
    bounds: Sequence[ObservationLikelihood], theta: Float[Array, "run parameter"], data: Sequence[Measured]
) -> tuple[list[Any], Any]:
    """Sums of squared residuals of observations that share a response, inside JAX."""
    if _in_one_loop(bounds, theta, data):
        folds = [bound.sum_of_squares(theta.shape[0]) for bound in bounds]
        plain = all(bound.plain_instrument for bound in bounds)
        result, finite = _folded(bounds, theta, data, folds, plain, as_samples=False)
        of_signs = [value if isinstance(value, tuple) else (value,) for value in result]
        return [bound.least_squares(value) for bound, value in zip(bounds, of_signs, strict=True)], finite
    each, finite = zip(
        *(bound.squares(theta, data_of_one) for bound, data_of_one in zip(bounds, data, strict=True)), strict=True
    )
    return list(each), functools.reduce(operator.and_, finite)


def log_likelihood_of(
    bounds: Sequence[ObservationLikelihood], theta: Float[Array, "run parameter"], data: Sequence[Measured]
) -> tuple[Any, Any]:
    """Log-likelihood of observations that share a response, inside JAX."""
    if _in_one_loop(bounds, theta, data):
        folds = [bound.fold(theta) for bound in bounds]
        if all(fold is not None for fold in folds):
            plain = all(bound.needs_only_squares for bound in bounds)
            result, finite = _folded(bounds, theta, data, folds, plain, as_samples=True)
            return sum(bound.of_fold(value, theta) for bound, value in zip(bounds, result, strict=True)), finite
    each, finite = zip(
        *(bound.traced(theta, data_of_one) for bound, data_of_one in zip(bounds, data, strict=True)), strict=True
    )
    return sum(each), functools.reduce(operator.and_, finite)


def _in_one_loop(bounds: Sequence[ObservationLikelihood], theta: Any, data: Sequence[Measured]) -> bool:
    """Whether there are several observations, and one loop over time serves all of them."""
    if len(bounds) == 1 or any(data_of_one.shortcut is not None for data_of_one in data):
        return False
    looping = bounds[0].loop(bounds[0].parameters(theta), data[0]) is not None
    return looping and all(bound.takes_samples for bound in bounds)


def _folded(
    bounds: Sequence[ObservationLikelihood],
    theta: Any,
    data: Sequence[Measured],
    folds: Sequence[Any],
    plain: bool,
    as_samples: bool,
) -> tuple[Any, Any]:
    """Values of all folds, and whether the response is finite, from one loop over time.

    `plain` means that residuals and folds depend on the model's parameters only through the response; `as_samples`
    that the folds take `ResidualSample` where the error model needs more than sums of squares.
    """
    first, at = bounds[0], lax.stop_gradient(theta) if plain else theta
    each = [
        bound.in_loop(fold, at, data_of_one.values, as_samples and bound.needs_samples)
        for bound, fold, data_of_one in zip(bounds, folds, data, strict=True)
    ]
    rows = tuple(of_one.rows for of_one in each)

    def make(response: Any, row: Any) -> tuple[Any, ...]:
        return tuple(of_one.make(response, row_of_one) for of_one, row_of_one in zip(each, row, strict=True))

    def folded(parameters: Any) -> Any:
        loop = first.loop(parameters, data[0])
        assert loop is not None  # `_in_one_loop` has checked this
        return loop.folded(side_by_side([of_one.fold for of_one in each]), rows, make)

    result: tuple[Any, Any] = (
        once_along_each(folded, first.parameters(theta)) if plain else folded(first.parameters(theta))
    )
    return result
