"""A posterior computed from model runs made beforehand, such as the runs of a campaign."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.inference.likelihood.joint_likelihood import JointLikelihood
from structid.inference.likelihood.observation_likelihood import ObservationLikelihood


class GivenResponses:
    """A posterior computed from model runs made beforehand."""

    def __init__(
        self, likelihood: JointLikelihood, responses: Sequence[np.ndarray], compiled: Sequence[Callable[..., Any]]
    ) -> None:
        self._likelihood = likelihood
        self._finite = np.asarray(np.stack([np.isfinite(r).all(axis=(1, 2)) for r in responses]).all(axis=0))
        # Most arrays of thousands of responses are finite and need no copy.
        runs = responses if self._finite.all() else [np.where(self._finite[:, None, None], r, 0.0) for r in responses]
        self._squares = [
            _sum_of_squares(bound, histories) for bound, histories in zip(likelihood.of, runs, strict=True)
        ]
        self._responses = [histories.transpose(1, 2, 0) for histories in runs]
        self._given = compiled

    def log_density(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Log posterior density."""
        theta = self._likelihood.points(theta)
        total = self._likelihood.space.log_density(theta)
        for bound, given, response, squares in zip(
            self._likelihood.of, self._given, self._responses, self._squares, strict=True
        ):
            if squares is not None:
                likelihood = bound.of_squares(squares, theta)
            else:
                likelihood = given(response, theta, bound.weighted(bound.observation.values[:, :, None]))
            total = total + np.asarray(likelihood)
        return np.where(self._finite & ~np.isnan(total), total, -np.inf)


def _sum_of_squares(bound: ObservationLikelihood, runs: np.ndarray) -> np.ndarray | None:
    """Σ (y − M)² (channel, run) of responses (run, time, channel), if the likelihood needs only this."""
    if not bound.needs_only_squares:
        return None
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
