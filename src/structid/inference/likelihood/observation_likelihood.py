"""The likelihood of one observation: record, values, nuisance parameters, error model and shortcut.

Every likelihood is computed here: for the posterior, the misfit, given responses, and simulation-based calibration.
It is traced inside JAX, or computed on the host for a model outside JAX.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from structid.core.arrays import Array
from structid.core.errors import Status
from structid.engine.device import jnp
from structid.engine.time_loop import Fold, TimeLoop, once_along_each, sum_of_squares
from structid.histories import Histories
from structid.inference.error_models.base import Discrepancy, ErrorModel
from structid.models.base import Model
from structid.models.traceable import Shortcut, TraceableModel, TracedExcitation, as_traceable
from structid.observation import Observation
from structid.probability.space import ParameterSpace
from structid.probability.truncation import Marginal


@dataclass(frozen=True)
class Measured:
    """Data of an observation for a traced likelihood: arguments of the compiled density, not constants in it."""

    excitation: TracedExcitation  # the excitation
    # Measured values, one set for all runs or one for each run. With known standard deviations: the values and 1, both
    # divided by them
    values: Any
    shortcut: Shortcut | None  # direct computation of the likelihood, without the response

    def for_runs(self, measurement: Int[Array, " run"]) -> Measured:
        """Assign a measurement to each run."""
        shortcut = None if self.shortcut is None else self.shortcut.for_runs(measurement)
        return Measured(self.excitation, self.values[:, :, measurement], shortcut)


jax.tree_util.register_dataclass(Measured, data_fields=["excitation", "values", "shortcut"], meta_fields=[])


def own_priors(observation: Observation, error_model: ErrorModel) -> dict[str, Marginal]:
    """Priors of an observation's own parameters, without the model's parameters."""
    record = observation.record
    values = observation.in_sds(observation.values)
    added = error_model.added.parameters(values, observation.channels, record.dt, observation.error_units)
    return observation.nuisances() | added | error_model.hidden_parameters(record.duration)


class ObservationLikelihood:
    """log L(y | θ) of one observation under one model."""

    def __init__(
        self,
        model: Model,
        observation: Observation,
        discrepancy: Discrepancy,
        space: ParameterSpace,
        own: Mapping[str, str],
        model_error: bool = False,
    ) -> None:
        self.model, self.observation, self.discrepancy = model, observation, discrepancy
        self._space, self._model_error = space, model_error
        self._columns = {plain: space.names.index(name) for plain, name in own.items()}
        # The model's parameters keep their names; latent values of this test alone have their own names in θ.
        self.free = tuple(name if name in space.all_names else own[name] for name in model.free)
        self.channels, self.dt = observation.channels, observation.record.dt
        self._places = np.array([model.channels.index(c) for c in observation.channels])

    # --- pieces -------------------------------------------------------------------------------------------------

    def unknowns(self, theta: Float[Array, "run parameter"]) -> dict[str, Any]:
        """Nuisance and error-model parameters."""
        return {name: theta[:, column] for name, column in self._columns.items()}

    def parameters(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run free_parameter"]:
        """Columns of the model's free parameters."""
        return self._space.columns(theta, self.free)

    def response(self, theta: Float[Array, "run parameter"], measured: Measured) -> tuple[Any, Any]:
        """Response of the model, inside JAX."""
        return self._traceable.response(self.parameters(theta), measured.excitation)

    def shown(
        self, response: Float[Array, "*time channel run"], theta: Float[Array, "run parameter"]
    ) -> Float[Array, "*time shown_channel run"]:
        """Convert a model's response to instrument readings, inside JAX."""
        if self.model.channels != self.channels:
            response = jnp.stack([response[..., index, :] for index in self._places], axis=-2)
        return self.observation.transmit(response, self.unknowns(theta))

    def given(
        self, response: Float[Array, "time model_channel run"], theta: Float[Array, "run parameter"], values: Any
    ) -> Float[Array, " run"]:
        """Log-likelihood of given responses, inside JAX."""
        residual = self.residual(theta)(response, values)
        result = self.discrepancy.log_likelihood(residual, self.unknowns(theta), self.channels, self.dt)
        return self._in_si(result)

    def compared(self, values: Float[np.ndarray, "time channel measurement"]) -> np.ndarray:
        """Data with which a response is compared: the measurements, divided by the standard deviations if these are known."""
        if self.observation.sd is None:
            return values
        return np.concatenate([self.observation.in_sds(each) for each in (values, np.ones(values.shape))], axis=1)

    def residual(self, theta: Float[Array, "run parameter"]) -> Callable[[Any, Any], Any]:
        """Return a function for measurement minus response, divided by the standard deviations if these are known."""
        if self.observation.sd is None:
            return lambda response, values: values - self.shown(response, theta)
        count = len(self.channels)
        return lambda response, values: values[..., :count, :] - values[..., count:, :] * self.shown(response, theta)

    def _in_si(self, log_density: Any) -> Any:
        """Log density of ε from the log density of ε/sd: log p(ε) = log p(ε/sd) − Σ log sd."""
        return log_density if self.observation.sd is None else log_density - self.observation.log_sds.sum()

    def of_squares(
        self, squares: Float[Array, "channel run"], theta: Float[Array, "run parameter"]
    ) -> Float[Array, " run"]:
        """Log-likelihood from sums of squared residuals, inside JAX, if these suffice."""
        samples = len(self.observation.values)
        result = self.discrepancy.log_likelihood_of_squares(squares, samples, self.unknowns(theta), self.channels)
        return self._in_si(result)

    @property
    def needs_only_squares(self) -> bool:
        """Whether error model and instrument need only the sum of squared residuals."""
        return self.discrepancy.independent and not self.observation.nuisances()

    # --- inside JAX ---------------------------------------------------------------------------------------------

    @cached_property
    def measured(self) -> Measured:
        """Data of the observation for the traced likelihood."""
        return self.measured_as(self.observation.values[:, :, None])

    def measured_as(self, values: Float[np.ndarray, "time channel measurement"]) -> Measured:
        """Replace the observation's measurements by other values."""
        model, record = self._traceable, self.observation.record
        shortcut = None if self.observation.sd is not None else model.shortcut(record, values, self.channels)
        return Measured(model.traced(record), self.compared(values), shortcut)

    def traced(self, theta: Float[Array, "run parameter"], measured: Measured) -> tuple[Any, Any]:
        """Log-likelihood and success of every run, inside JAX, computed in the cheapest way."""
        if self._model_error:
            return self._with_model_error(theta, measured)
        if self.discrepancy.independent:
            squares, finite = self.squares(theta, measured)
            return self.of_squares(squares, theta), finite
        loop, fold = self.loop(self.parameters(theta), measured), self.fold(theta, len(measured.values))
        if loop is None or fold is None:
            response, finite = self.response(theta, measured)
            return self.given(response, theta, measured.values), finite
        result, finite = loop.folded(fold, measured.values, self.residual(theta))
        return self.of_fold(result, theta), finite

    def fold(self, theta: Float[Array, "run parameter"], samples: int) -> Fold | None:
        """Fold of the residuals over samples."""
        if self.discrepancy.independent:
            return self.sum_of_squares(theta.shape[0])
        return self.discrepancy.fold(self.unknowns(theta), self.channels, theta.shape[0], self.dt, samples)

    def sum_of_squares(self, runs: int) -> Fold:
        """Σ (y − M)² of every channel."""
        return sum_of_squares(jnp.zeros((len(self.channels), runs)))

    def of_fold(self, value: Any, theta: Float[Array, "run parameter"]) -> Float[Array, " run"]:
        """Log-likelihood from the result of `fold`, inside JAX."""
        return self.of_squares(value, theta) if self.discrepancy.independent else self._in_si(value)

    def squares(self, theta: Float[Array, "run parameter"], measured: Measured) -> tuple[Any, Any]:
        """Sum of squared residuals over time, inside JAX, computed in the cheapest way."""
        parameters = self.parameters(theta)
        if measured.shortcut is not None and not self.observation.nuisances():
            return measured.shortcut.squares(parameters)
        if self.observation.nuisances():
            return self._squares(parameters, measured, self.residual(theta))
        held = self.residual(lax.stop_gradient(theta))  # independent of θ here
        result: tuple[Any, Any] = once_along_each(lambda p: self._squares(p, measured, held), parameters)
        return result

    def _squares(self, parameters: Any, measured: Measured, residual: Callable[[Any, Any], Any]) -> tuple[Any, Any]:
        loop = self.loop(parameters, measured)
        if loop is None:
            response, finite = self._traceable.response(parameters, measured.excitation)
            return (residual(response, measured.values) ** 2).sum(axis=0), finite
        return loop.folded(self.sum_of_squares(parameters.shape[0]), measured.values, residual)

    @property
    def takes_samples(self) -> bool:
        """Whether the response can be processed sample by sample: there is no time shift and no separate model error."""
        return not self._model_error and self.observation.time_shift is None

    def loop(self, parameters: Float[Array, "run free_parameter"], measured: Measured) -> TimeLoop | None:
        """The loop over time that produces the response sample by sample."""
        if self.observation.time_shift is not None:
            return None
        return self._traceable.time_loop(parameters, measured.excitation)

    def _with_model_error(self, theta: Any, measured: Measured) -> tuple[Any, Any]:
        """Log-likelihood with the model's own variance added to the error model's."""
        unknown, parameters = self.unknowns(theta), self.parameters(theta)
        if self.needs_only_squares and measured.shortcut is not None:
            variance = self.discrepancy.variances(unknown, self.channels, theta.shape[0], jnp)
            exact = measured.shortcut.marginal_log_likelihood(parameters, variance)
            if exact is not None:
                return exact
        response, finite = self.response(theta, measured)
        white, stand_in = 0.0, self.model.stand_in
        if stand_in is not None:
            white = stand_in.error_variance(parameters, measured.excitation, response)[self._places]
        if self.observation.sd is not None:
            # A surrogate's variance is constant in time. Divided by known variances it is not, and its mean is used.
            white = white * np.mean(self.observation.sd**-2.0, axis=0)[:, None]
        residual = self.residual(theta)(response, measured.values)
        result = self.discrepancy.log_likelihood(residual, unknown, self.channels, self.dt, white)
        return self._in_si(result), finite

    @property
    def _traceable(self) -> TraceableModel:
        return as_traceable(self.model, "likelihood inside JAX")

    # --- on the host --------------------------------------------------------------------------------------------

    def on_host(
        self,
        theta: Float[np.ndarray, "run parameter"],
        run: Histories,
        values: Float[np.ndarray, "time channel _"] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Log-likelihood and failure of every run of a model outside JAX."""
        response = np.where(run.done[:, None, None], run.values, 0.0).transpose(1, 2, 0)
        values = self.observation.values[:, :, None] if values is None else values
        result = np.asarray(self.given(response, theta, self.compared(values)))
        return np.where(run.done, result, -np.inf), ~run.done & (run.status != Status.STRUCTURE_FAILED)
