"""A posterior computed from model runs made beforehand, such as the runs of a campaign."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from structid.inference.likelihood.joint_likelihood import JointLikelihood
from structid.inference.likelihood.observation_likelihood import ObservationLikelihood

AT_ONCE = 64
"""Number of runs whose likelihood is computed at once."""

Responses = np.ndarray | Iterable[np.ndarray]
"""Responses (run, time, channel) to one record: of all runs in one array, or block by block."""


class GivenResponses:
    """A posterior computed from model runs made beforehand."""

    def __init__(
        self, likelihood: JointLikelihood, responses: Iterable[Responses], compiled: Sequence[Callable[..., Any]]
    ) -> None:
        self._likelihood = likelihood
        # An iterator of responses makes each when it is needed: only their reductions are kept.
        self._reduced = [_Reduced.of(bound, runs) for bound, runs in zip(likelihood.of, responses, strict=True)]
        self._given = compiled

    def log_density(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Log posterior density."""
        theta = self._likelihood.points(theta)
        each = zip(self._likelihood.of, self._given, self._reduced, strict=True)
        return _with_prior(self._likelihood, theta, (_log_likelihood(*of_one, theta) for of_one in each))


def log_density_on_the_way(
    likelihood: JointLikelihood,
    responses: Iterable[Responses],
    compiled: Sequence[Callable[..., Any]],
    theta: Float[np.ndarray, "run parameter"],
) -> Float[np.ndarray, " run"]:
    """Log posterior density of given responses, of which no more than one block is kept; see `GivenResponses`."""
    each = zip(likelihood.of, compiled, responses, strict=True)
    return _with_prior(likelihood, theta, (_of_blocks(bound, given, runs, theta) for bound, given, runs in each))


def _of_blocks(
    bound: ObservationLikelihood, given: Callable[..., Any], runs: Responses, theta: Float[np.ndarray, "run parameter"]
) -> Float[np.ndarray, " run"]:
    """Log-likelihood of the responses to one record, block by block."""
    parts, first = [], 0
    for block in [runs] if isinstance(runs, np.ndarray) else runs:
        parts.append(_log_likelihood(bound, given, _Reduced.of(bound, block), theta[first : first + len(block)]))
        first += len(block)
    return np.concatenate(parts)


def _with_prior(
    likelihood: JointLikelihood, theta: Float[np.ndarray, "run parameter"], parts: Iterable[np.ndarray]
) -> Float[np.ndarray, " run"]:
    """Log prior plus log-likelihoods; −inf where one of them is not a number."""
    total = likelihood.space.log_density(theta)
    for part in parts:
        total = total + part
    return np.where(np.isnan(total), -np.inf, total)


def _log_likelihood(
    bound: ObservationLikelihood,
    given: Callable[..., Any],
    reduced: _Reduced,
    theta: Float[np.ndarray, "run parameter"],
) -> Float[np.ndarray, " run"]:
    """Log-likelihood of reduced responses; −inf where the run failed."""
    if bound.needs_only_squares:
        values = np.asarray(bound.of_squares(reduced.values, theta))
    else:
        measured = bound.weighted(bound.observation.values[:, :, None])
        # Always the same number of runs, the last ones repeated: one compiled program, with little memory, serves all.
        places = np.arange(-(-len(theta) // AT_ONCE) * AT_ONCE).reshape(-1, AT_ONCE).clip(max=len(theta) - 1)
        blocks = [np.asarray(given(reduced.values[p].transpose(1, 2, 0), theta[p], measured)) for p in places]
        values = np.concatenate(blocks)[: len(theta)]
    return np.where(reduced.finite, values, -np.inf)


class _Reduced(NamedTuple):
    """The part of some responses that the likelihood of an observation needs."""

    finite: Bool[np.ndarray, " run"]  # whether the model run succeeded
    # Σ (y − M)² (channel, run) if this is enough, otherwise the responses in the measured channels (run, time, channel)
    values: np.ndarray

    @classmethod
    def of(cls, bound: ObservationLikelihood, responses: Responses) -> _Reduced:
        """Reduce responses in the model's channels, block by block."""
        blocks = [responses] if isinstance(responses, np.ndarray) else responses
        parts = [cls._of_block(bound, block) for block in blocks]
        if len(parts) == 1:
            return parts[0]
        axis = 1 if bound.needs_only_squares else 0
        return cls(np.concatenate([p.finite for p in parts]), np.concatenate([p.values for p in parts], axis=axis))

    @classmethod
    def _of_block(cls, bound: ObservationLikelihood, runs: Float[np.ndarray, "run time channel"]) -> _Reduced:
        finite = np.isfinite(runs).all(axis=(1, 2))
        # Most arrays of thousands of responses are finite and need no copy.
        runs = runs if finite.all() else np.where(finite[:, None, None], runs, 0.0)
        if bound.needs_only_squares:
            return cls(finite, _sum_of_squares(bound, runs))
        if bound.model.channels == bound.channels:
            return cls(finite, runs)
        return cls(finite, runs[:, :, [bound.model.channels.index(channel) for channel in bound.channels]])


def _sum_of_squares(bound: ObservationLikelihood, runs: np.ndarray) -> np.ndarray:
    """Σ (y − M)² (channel, run) of responses (run, time, channel)."""
    observation, squares = bound.observation, []
    # Channel by channel: contiguous samples are summed several times as fast as columns.
    for index, channel in enumerate(observation.channels):
        response = runs[:, :, bound.model.channels.index(channel)]
        if observation.sampling is not None or observation.polarity != "normal":
            response = observation.instrument.signs[0] * np.asarray(observation.instrument.sampled(response.T)).T
        residual = observation.values[:, index] - response
        if observation.missing:
            residual = residual[:, observation.is_measured[:, index]]
        if observation.sd is not None:
            residual = residual / np.asarray(observation.sd)[observation.is_measured[:, index], index]
        squares.append(np.einsum("rt,rt->r", residual, residual))
    return np.stack(squares)
