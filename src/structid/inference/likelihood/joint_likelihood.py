"""The likelihood of all observations that share a model's parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.core.progress import Progress
from structid.engine.device import jnp
from structid.ground_motion.excitation import Excitation
from structid.inference.error_models.base import ErrorModel
from structid.inference.likelihood.observation_likelihood import Measured, ObservationLikelihood, own_priors
from structid.inference.likelihood.shared_response import log_likelihood_of, of_one_run, of_one_test
from structid.models.base import Map, Model
from structid.models.traceable import as_traceable
from structid.observation import Observation
from structid.probability.bijections import Bijection, Scatter
from structid.probability.space import ParameterSpace


class JointLikelihood:
    """log L(y | θ) = Σ log L(y_i | θ) over observations that share a model's parameters.

    θ holds the model's parameters, then nuisance and error-model parameters of each observation, numbered ``_1``, ``_2``, … if
    there are several. Errors inside the model belong to a test: observations of different channels on the same record share
    them, and their names end in the number of the first of these observations.
    """

    def __init__(
        self,
        model_space: ParameterSpace,
        model: Model,
        observations: tuple[Observation, ...],
        error_model: ErrorModel,
        *,
        map: Map | None = None,
        model_error: bool = False,
    ) -> None:
        self.model, self._map = model, map
        self.error_model = error_model.among(model_space, observations[0].record.duration)
        priors_of_observation = [own_priors(observation, self.error_model) for observation in observations]
        self._tests = of_one_test(observations)
        self._names = _names_in_theta(observations, self._tests, self.error_model, priors_of_observation)
        self.space = model_space.extended(
            **self.error_model.shared_parameters,
            **{
                names[name]: prior
                for names, priors in zip(self._names, priors_of_observation, strict=True)
                for name, prior in priors.items()
            },
        )
        responding: dict[int, Model] = {}
        for numbers in self._tests:
            of_test = self.error_model.responding(model, observations[numbers[0]].record.duration)
            responding |= dict.fromkeys(numbers, of_test)
        self.of = tuple(
            ObservationLikelihood(
                responding[number], observation, self.error_model.added, self.space, self._names[number], model_error
            )
            for number, observation in enumerate(observations)
        )

    @cached_property
    def bijection(self) -> Bijection:
        """Smooth map between ℝᵈ and the support of the prior."""
        plain, index, marginals = self.space.bijection, self.space.names.index, self.space.marginals
        scatters = [
            Scatter(
                index(mean),
                index(sd),
                tuple(index(self._names[numbers[0]][name]) for name in members),
                marginals[mean].moments[0],
                float(marginals[sd].quantile(np.array(0.5))),
            )
            for numbers in self._tests
            for (mean, sd), members in self.error_model.scatters(
                self.of[numbers[0]].observation.record.duration
            ).items()
        ]
        return Bijection(plain.bounds, plain.scales, scatters, plain.logarithmic) if scatters else plain

    @cached_property
    def discrepancy_names(self) -> set[str]:
        """Parameters of the error model, for all observations."""
        return set(self.error_model.shared_parameters) | {
            label
            for bound, names in zip(self.of, self._names, strict=True)
            for name, label in names.items()
            if name not in bound.observation.nuisances()
        }

    @cached_property
    def hidden_names(self) -> frozenset[str]:
        """Latent parameters of all observations; see `ErrorModel.hidden_parameters`."""
        return frozenset(
            names[name]
            for bound, names in zip(self.of, self._names, strict=True)
            for name in self.error_model.hidden_parameters(bound.observation.record.duration)
        )

    def model_parameters(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run free_parameter"]:
        """Columns of the model's free parameters."""
        return self.space.columns(theta, self.model.free)

    def on_record(
        self, theta: Float[np.ndarray, "run parameter"], record: Excitation, rng: np.random.Generator, index: int | None
    ) -> tuple[Model, np.ndarray]:
        """Model and parameters for the response to a record, including errors inside the model."""
        if index is not None:
            return self.of[index].model, np.asarray(self.of[index].parameters(theta))
        model, hidden = (
            self.error_model.responding(self.model, record.duration),
            self.error_model.hidden_parameters(record.duration),
        )
        if not hidden:
            return model, np.asarray(self.model_parameters(theta))
        columns = self.space.columns(theta, [name for name in model.free if name not in hidden])
        drawn = ParameterSpace(hidden).from_uniform(rng.random((len(theta), len(hidden))))
        return model, np.concatenate([columns, drawn], axis=1)

    def points(self, theta: np.ndarray) -> Float[np.ndarray, "run parameter"]:
        """Check an array of parameters."""
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        if theta.shape[1] != self.space.dimension:
            raise InputError(
                "theta",
                f"an array of shape {theta.shape}",
                f"(run, {self.space.dimension}) with the columns {', '.join(self.space.names)}",
            )
        return theta

    @cached_property
    def of_one_run(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the observations that share a response."""
        return of_one_run(self.of)

    @cached_property
    def measured(self) -> tuple[Measured, ...]:
        """Input of the density inside JAX, for each observation."""
        return tuple(bound.measured for bound in self.of)

    def traced(self, theta: Float[Array, "run parameter"], data: Sequence[Measured]) -> tuple[Any, Any]:
        """Log-likelihood and success of every run, inside JAX."""
        total, finite = jnp.zeros(theta.shape[0]), jnp.ones(theta.shape[0], dtype=bool)
        for numbers in self.of_one_run:
            more, good = log_likelihood_of([self.of[k] for k in numbers], theta, [data[k] for k in numbers])
            total, finite = total + more, finite & good
        return total, finite & jnp.isfinite(total)

    @property
    def loops_over_time(self) -> bool:
        """Whether the likelihood is a loop over time inside JAX, which XLA runs on one core."""
        return as_traceable(self.model, "likelihood inside JAX").loops or not self.error_model.added.independent

    def on_host(
        self,
        theta: Float[np.ndarray, "run parameter"],
        inside: Bool[np.ndarray, " run"],
        values: Sequence[np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Log-likelihood and failure of every run of a model outside JAX."""
        likelihood, failed = np.full(len(theta), -np.inf), np.zeros(len(theta), dtype=bool)
        rows = np.flatnonzero(inside)
        if rows.size == 0:
            return likelihood, failed
        total = np.zeros(rows.size)
        for numbers in self.of_one_run:
            first = self.of[numbers[0]]
            run = first.model.simulate(
                np.asarray(first.parameters(theta[rows])), first.observation.record, map=self._map
            )
            for index in numbers:
                values_of_runs = None if values is None else values[index][:, :, rows]
                more, bad = self.of[index].on_host(theta[rows], run, values_of_runs)
                total, failed[rows] = total + more, failed[rows] | bad
        likelihood[rows] = total
        return likelihood, failed

    def predict(
        self, theta: Float[np.ndarray, "run parameter"], index: int, progress: Progress | None = None
    ) -> Float[np.ndarray, "run time channel"]:
        """Prediction of one observation, including the instrument, without errors."""
        theta, bound = self.points(theta), self.of[index]
        run = bound.model.simulate(
            np.asarray(bound.parameters(theta)), bound.observation.record, progress=progress, map=self._map
        )
        return np.asarray(bound.shown(run.values.transpose(1, 2, 0), theta)).transpose(2, 0, 1)


def _names_in_theta(
    observations: Sequence[Observation],
    tests: Sequence[Sequence[int]],
    error_model: ErrorModel,
    own_names: Sequence[Iterable[str]],
) -> list[dict[str, str]]:
    """Names in θ of each observation's own parameters, by plain name."""
    if len(observations) == 1:
        return [{name: name for name in own_names[0]}]
    first = {number: numbers[0] for numbers in tests for number in numbers}
    result = []
    for number, (observation, names) in enumerate(zip(observations, own_names, strict=True)):
        hidden = error_model.hidden_parameters(observation.record.duration)
        result.append({name: f"{name}_{(first[number] if name in hidden else number) + 1}" for name in names})
    return result
