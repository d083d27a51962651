"""The likelihood of one observation: record, values, nuisance parameters, error model and shortcut.

Every likelihood is computed here: for the posterior, the misfit, given responses, and simulation-based calibration.
It is traced inside JAX, or computed on the host for a model outside JAX.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from structid.core.arrays import Array
from structid.core.errors import InputError, Status
from structid.engine.array_module import namespace
from structid.engine.device import jnp
from structid.engine.time_loop import Fold, TimeLoop, once_along_each, side_by_side, sum_of_squares
from structid.histories import Histories
from structid.inference.error_models.base import Discrepancy, ErrorModel, ResidualSample
from structid.inference.likelihood.sensor_loop import at_sensor_samples
from structid.models.base import Model
from structid.models.traceable import Shortcut, TraceableModel, TracedExcitation, as_traceable
from structid.observation import Observation
from structid.probability.space import ParameterSpace
from structid.probability.truncation import Marginal


@dataclass(frozen=True)
class Measured:
    """Data of an observation for a traced likelihood: arguments of the compiled density, not constants in it."""

    excitation: TracedExcitation  # the excitation
    # Measured values, one set for all runs or one for each run; divided by the known standard deviations, and 0 if missing
    values: Any
    shortcut: Shortcut | None  # direct computation of the likelihood, without the response

    def for_runs(self, measurement: Int[Array, " run"]) -> Measured:
        """Assign a measurement to each run."""
        shortcut = None if self.shortcut is None else self.shortcut.for_runs(measurement)
        return Measured(self.excitation, self.values[:, :, measurement], shortcut)


jax.tree_util.register_dataclass(Measured, data_fields=["excitation", "values", "shortcut"], meta_fields=[])


class Readings(NamedTuple):
    """What a response is compared with, at all samples of the sensor or at one of them."""

    values: Any  # measured values (..., channel, run), weighted
    weights: Any  # weights (..., channel, 1): 1/sd, and 0 for a missing value; None if all are 1
    times: Any  # times (..., 1, 1); None if the instrument does not drift


class InLoop(NamedTuple):
    """A reduction of the residuals inside a loop over the samples of the record."""

    fold: Fold
    rows: Any  # input of the fold besides the response
    make: Callable[[Any, Any], Any]  # the fold's samples, from the response and a row


def own_priors(observation: Observation, error_model: ErrorModel) -> dict[str, Marginal]:
    """Priors of an observation's own parameters, without the model's parameters."""
    values = observation.weighted(observation.values)
    added = error_model.added.parameters(values, observation.channels, observation.step, observation.error_units)
    return observation.nuisances() | added | error_model.hidden_parameters(observation.record.duration)


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
        self.model, self.observation = model, observation
        relative = observation.values if observation.sd is None else observation.values / np.asarray(observation.sd)
        self.discrepancy = discrepancy.bound_to(relative, observation.channels)
        self._space, self._model_error = space, model_error
        self.labels = dict(own)  # names in θ of the observation's own parameters, by their plain names
        self._columns = {plain: space.names.index(name) for plain, name in own.items()}
        # The model's parameters keep their names; latent values of this test alone have their own names in θ.
        self.free = tuple(name if name in space.all_names else own[name] for name in model.free)
        self.channels, self.dt = observation.channels, observation.step
        self._places = np.array([model.channels.index(c) for c in observation.channels])
        if observation.missing and not discrepancy.takes_gaps:
            raise InputError(
                "observation",
                f"{observation.missing} missing values, but the error model {type(discrepancy).__name__} does not take them",
                "an error model with takes_gaps = True, such as IID or AR1",
                "Choose another error model, or extend its methods by the argument `is_measured`.",
            )

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

    def measured_channels(self, response: Float[Array, "*time channel run"]) -> Float[Array, "*time shown_channel run"]:
        """Channels of a response that the instrument measures."""
        if self.model.channels == self.channels:
            return response
        return namespace(response).stack([response[..., index, :] for index in self._places], axis=-2)

    def shown(
        self, response: Float[Array, "time channel run"], theta: Float[Array, "run parameter"]
    ) -> Float[Array, "sample shown_channel run"]:
        """Convert a model's response to instrument readings at the samples of the sensor, inside JAX."""
        measured = self.measured_channels(response)
        return self.observation.transmit(measured, self.unknowns(theta), self.sign(measured, theta))

    def sign(self, response: Float[Array, "time shown_channel run"], theta: Float[Array, "run parameter"]) -> Any:
        """The more probable direction of the sensor for each run, from its measured channels; None if it is known."""
        signs = self.observation.instrument.signs
        if len(signs) == 1:
            return None
        values = self.weighted(self.observation.values[:, :, None])
        # Operations of JAX outside a trace would keep a megabyte of compiled code each.
        numpy = namespace(response)
        each = numpy.stack([self._given(response, theta, values, sign) for sign in signs])
        # At a variance of zero the densities are not finite, and the sum of squares decides.
        residuals = [self._residual_of_all(response, theta, values, sign) for sign in signs]
        squares = numpy.stack([(residual**2).sum(axis=(0, 1)) for residual in residuals])
        better = numpy.where(numpy.isfinite(each).all(axis=0), each, -squares)
        return numpy.array(signs)[numpy.argmax(better, axis=0)]

    def given(
        self, response: Float[Array, "time model_channel run"], theta: Float[Array, "run parameter"], values: Any
    ) -> Float[Array, " run"]:
        """Log-likelihood of given responses, inside JAX."""
        return self.given_measured(self.measured_channels(response), theta, values)

    def given_measured(
        self, measured: Float[Array, "time shown_channel run"], theta: Float[Array, "run parameter"], values: Any
    ) -> Float[Array, " run"]:
        """Log-likelihood of given responses in the measured channels, inside JAX."""
        return self._mean_of_signs(
            [self._given(measured, theta, values, sign) for sign in self.observation.instrument.signs]
        )

    def _given(self, response: Any, theta: Any, values: Any, sign: float, white: Any = 0.0) -> Any:
        """Log-likelihood of the response in the measured channels for one direction of the sensor, inside JAX."""
        residual = self._residual_of_all(response, theta, values, sign)
        more = self._of_all_samples(values - residual)
        result = self.discrepancy.log_likelihood(residual, self.unknowns(theta), self.channels, self.dt, white, **more)
        return self._in_si(result)

    def _of_all_samples(self, response: Any) -> dict[str, Any]:
        """Further arguments of the error model: the mask of the measured values, and the response divided by the known sds."""
        masked = {"is_measured": self.observation.is_measured} if self.observation.missing else {}
        return masked | self.discrepancy.seeing(response)

    def whiten(
        self,
        values: Float[Array, "sample channel run"],
        unknown: Mapping[str, Any],
        response: Float[Array, "sample channel _"],
    ) -> Float[Array, "sample channel run"]:
        """Whiten residuals or sensitivities at a response, 0 where a value is missing, inside JAX or of NumPy arrays."""
        weighted, more = self.observation.weighted(values), self._of_all_samples(self.observation.weighted(response))
        return self.discrepancy.whiten(weighted, unknown, self.channels, self.dt, **more)

    def _residual_at(self, response: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
        """Weighted residual of readings, and the further arguments of the error model."""
        residual = self.observation.weighted(self.observation.values[:, :, None] - response)
        return residual, self._of_all_samples(self.observation.weighted(response))

    def influence(
        self, response: Float[np.ndarray, "sample channel run"], unknown: Mapping[str, Any]
    ) -> Float[np.ndarray, "sample channel run"]:
        """Influence of every measured value on the response; see `Discrepancy.influence`."""
        residual, more = self._residual_at(response)
        return np.asarray(self.discrepancy.influence(residual, unknown, self.channels, self.dt, **more))

    def normal_scores(
        self, response: Float[np.ndarray, "sample channel run"], unknown: Mapping[str, Any]
    ) -> Float[np.ndarray, "sample channel run"]:
        """Residuals of readings as independent unit normals, 0 where a value is missing."""
        residual, more = self._residual_at(response)
        return np.asarray(self.discrepancy.normal_scores(residual, unknown, self.channels, self.dt, **more))

    def pointwise(
        self, response: Float[np.ndarray, "sample channel run"], unknown: Mapping[str, Any]
    ) -> Float[np.ndarray, "sample channel run"]:
        """Log density of every measured value in SI, given the readings of a model; 0 where a value is missing."""
        residual, more = self._residual_at(response)
        result = self.discrepancy.pointwise(residual, unknown, self.channels, self.dt, **more)
        return np.asarray(result - self.observation.log_sds[:, :, None])

    def draw_errors(
        self,
        rng: np.random.Generator,
        response: Float[np.ndarray, "run time channel"],
        unknown: Mapping[str, np.ndarray],
        dt: float,
        size: Any = None,
        of: Discrepancy | None = None,
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw errors in SI of some readings; `size` replaces the known standard deviations, `of` the error model."""
        error_model = self.discrepancy if of is None else of
        if size is None:
            size = 1.0 if self.observation.sd is None else np.asarray(self.observation.sd)
        more = error_model.seeing(response / size)
        return np.asarray(size * error_model.draw(rng, response.shape, unknown, self.channels, dt, **more))

    @staticmethod
    def _mean_of_signs(each: Sequence[Any]) -> Any:
        """Log-likelihood from those of the directions, which have equal prior probabilities."""
        return each[0] if len(each) == 1 else namespace(each[0]).logaddexp(*each) - math.log(len(each))

    def weighted(self, values: Float[np.ndarray, "time channel measurement"]) -> np.ndarray:
        """Measured values as the likelihood uses them; see `Measured.values`."""
        return np.asarray(self.observation.weighted(values))

    def readings(self, values: Any) -> Readings:
        """Pair measured values with weights and times."""
        weights, drifts = self.observation.weights, self.observation.drift is not None
        times = self.observation.time[:, None, None] if drifts else None
        return Readings(values, None if weights is None else weights[:, :, None], times)

    def residual(self, theta: Float[Array, "run parameter"], sign: float | None = None) -> Callable[[Any, Any], Any]:
        """Return a function for measurement minus response at the samples of the sensor, weighted.

        It takes responses in the channels of the measurement, and readings.
        """
        unknown = self.unknowns(theta)

        def residual(response: Any, readings: Readings) -> Any:
            shown = self.observation.instrument.reading(response, unknown, readings.times, sign)
            return readings.values - (shown if readings.weights is None else readings.weights * shown)

        return residual

    def residual_of_all(
        self, response: Float[Array, "time model_channel run"], theta: Float[Array, "run parameter"], values: Any
    ) -> Float[Array, "sample channel run"]:
        """Residual of whole responses, inside JAX; for an unknown direction, the smaller one."""
        measured = self.measured_channels(response)
        each = [self._residual_of_all(measured, theta, values, sign) for sign in self.observation.instrument.signs]
        if len(each) == 1:
            return each[0]
        first, second = each
        return namespace(first).where((first**2).sum(axis=(0, 1)) <= (second**2).sum(axis=(0, 1)), first, second)

    def _residual_of_all(self, response: Any, theta: Any, values: Any, sign: float) -> Any:
        response = self.observation.instrument.delayed(response, self.unknowns(theta))
        return self.residual(theta, sign)(self.observation.instrument.sampled(response), self.readings(values))

    def _in_si(self, log_density: Any) -> Any:
        """Log density of ε from the log density of ε/sd: log p(ε) = log p(ε/sd) − Σ log sd."""
        return log_density if self.observation.sd is None else log_density - self.observation.log_sds.sum()

    def of_squares(
        self, squares: Float[Array, "channel run"], theta: Float[Array, "run parameter"]
    ) -> Float[Array, " run"]:
        """Log-likelihood from sums of squared residuals, inside JAX, if these suffice."""
        samples, unknown = self.observation.counts, self.unknowns(theta)
        return self._in_si(self.discrepancy.log_likelihood_of_squares(squares, samples, unknown, self.channels))

    @property
    def needs_only_squares(self) -> bool:
        """Whether error model and instrument need only the sum of squared residuals."""
        return self.discrepancy.independent and self.plain_instrument

    @property
    def plain_instrument(self) -> bool:
        """Whether the instrument has no unknown parameters and a known direction."""
        return not self.observation.nuisances() and len(self.observation.instrument.signs) == 1

    # --- inside JAX ---------------------------------------------------------------------------------------------

    @cached_property
    def measured(self) -> Measured:
        """Data of the observation for the traced likelihood."""
        return self.measured_as(self.observation.values[:, :, None])

    def measured_as(self, values: Float[np.ndarray, "time channel measurement"]) -> Measured:
        """Replace the observation's measurements by other values."""
        model, observation = self._traceable, self.observation
        weighted, shortcut = self.weighted(values), None
        if observation.sd is None and observation.time_shift is None:
            columns = None if self._plain_reading else observation.weighted(observation.instrument.columns)
            shortcut = model.shortcut(observation.record, weighted, self.channels, self._sampled_parts, columns)
        return Measured(model.traced(observation.record), weighted, shortcut)

    @property
    def _plain_reading(self) -> bool:
        """Whether the instrument shows the response itself."""
        return self.plain_instrument and self.observation.polarity == "normal"

    @property
    def _sampled_parts(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """Linear map of histories (time, channel, part) to the samples of the sensor, 0 where a value is missing."""
        observation = self.observation
        if observation.sampling is None and not observation.missing:
            return None
        return lambda histories: np.asarray(observation.weighted(observation.instrument.sampled(histories)))

    def traced(self, theta: Float[Array, "run parameter"], measured: Measured) -> tuple[Any, Any]:
        """Log-likelihood and success of every run, inside JAX, computed in the cheapest way."""
        if self._model_error:
            return self._with_model_error(theta, measured)
        if self.discrepancy.independent:
            each, finite = self._squares_of_signs(theta, measured)
            return self._mean_of_signs([self.of_squares(squares, theta) for squares in each]), finite
        loop, fold = self.loop(self.parameters(theta), measured), self.fold(theta)
        if loop is None or fold is None:
            response, finite = self.response(theta, measured)
            return self.given(response, theta, measured.values), finite
        result, finite = loop.folded(*self.in_loop(fold, theta, measured.values, self.needs_samples))
        return self.of_fold(result, theta), finite

    def fold(self, theta: Float[Array, "run parameter"]) -> Fold | None:
        """Fold of the residuals over samples, for one direction of the sensor."""
        if self.discrepancy.independent:
            return self.sum_of_squares(theta.shape[0])
        counts, runs = self.observation.counts, theta.shape[0]
        return self.discrepancy.fold(self.unknowns(theta), self.channels, runs, self.dt, counts)

    def sum_of_squares(self, runs: int) -> Fold:
        """Σ (y − M)² of every channel."""
        return sum_of_squares(jnp.zeros((len(self.channels), runs)))

    def of_fold(self, value: Any, theta: Float[Array, "run parameter"]) -> Float[Array, " run"]:
        """Log-likelihood from the result of `in_loop`, inside JAX."""

        def of_one(value: Any) -> Any:
            return self.of_squares(value, theta) if self.discrepancy.independent else self._in_si(value)

        return (
            of_one(value)
            if len(self.observation.instrument.signs) == 1
            else self._mean_of_signs([of_one(v) for v in value])
        )

    @property
    def needs_samples(self) -> bool:
        """Whether `fold` is one of `ResidualSample`, not of residuals."""
        return not self.discrepancy.independent

    def _sample(self, residual: Any, readings: Readings) -> ResidualSample:
        """What the error model sees of a sample."""
        is_measured = readings.weights > 0.0 if self.observation.missing else None
        response = readings.values - residual if self.discrepancy.depends_on_response else None
        return ResidualSample(residual, is_measured, response)

    def in_loop(
        self, fold: Fold, theta: Float[Array, "run parameter"], values: Any, as_samples: bool = False
    ) -> InLoop:
        """Apply a fold, of residuals or of `ResidualSample`, to the response of a loop over the samples of the record.

        An unknown direction of the sensor has one fold for each sign.
        """
        signs = self.observation.instrument.signs
        residuals = [self.residual(theta, sign) for sign in signs]
        fold = fold if len(signs) == 1 else side_by_side([fold] * len(signs))

        def compared(response: Any, readings: Readings) -> Any:
            each = [residual(response, readings) for residual in residuals]
            each = [self._sample(r, readings) for r in each] if as_samples else each
            return each[0] if len(each) == 1 else each

        readings, sampling = self.readings(values), self.observation.sampling
        if sampling is None:
            return InLoop(fold, readings, lambda response, row: compared(self.measured_channels(response), row))
        shape = (len(self.channels), theta.shape[0])
        return InLoop(
            *at_sensor_samples(fold, sampling.schedule, readings, compared, shape),
            lambda response, row: (self.measured_channels(response), row),
        )

    def squares(self, theta: Float[Array, "run parameter"], measured: Measured) -> tuple[Any, Any]:
        """Sum of squared residuals over time, inside JAX, computed in the cheapest way; the smaller for an unknown polarity."""
        each, finite = self._squares_of_signs(theta, measured)
        return self.least_squares(each), finite

    def _squares_of_signs(self, theta: Any, measured: Measured) -> tuple[list[Any], Any]:
        """Sums of squared residuals for each direction of the sensor, inside JAX."""
        parameters, shortcut = self.parameters(theta), measured.shortcut
        if shortcut is not None:
            return self._squares_by_shortcut(shortcut, parameters, theta)
        if not self.plain_instrument:
            return self._squares(parameters, measured, theta)
        held = lax.stop_gradient(theta)  # the residual depends on θ only through the response
        result: tuple[Any, Any] = once_along_each(lambda p: self._squares(p, measured, held), parameters)
        return result

    def _squares_by_shortcut(self, shortcut: Shortcut, parameters: Any, theta: Any) -> tuple[list[Any], Any]:
        if self._plain_reading:
            squares, finite = shortcut.squares(parameters)
            return [squares], finite
        unknown, runs = self.unknowns(theta), theta.shape[0]
        coefficients = [
            self.observation.instrument.coefficients(unknown, s, runs) for s in self.observation.instrument.signs
        ]
        each = [shortcut.squares(parameters, of_sign) for of_sign in coefficients]
        return [squares for squares, _ in each], each[0][1]

    def _squares(self, parameters: Any, measured: Measured, theta: Any) -> tuple[list[Any], Any]:
        loop, signs = self.loop(parameters, measured), self.observation.instrument.signs
        if loop is None:
            response, finite = self._traceable.response(parameters, measured.excitation)
            response = self.measured_channels(response)
            residuals = [self._residual_of_all(response, theta, measured.values, sign) for sign in signs]
            return [(residual**2).sum(axis=0) for residual in residuals], finite
        result, finite = loop.folded(*self.in_loop(self.sum_of_squares(parameters.shape[0]), theta, measured.values))
        return [result] if len(signs) == 1 else list(result), finite

    @staticmethod
    def least_squares(each: Sequence[Any]) -> Any:
        """The smaller of the sums of squares for the directions of the sensor."""
        return each[0] if len(each) == 1 else jnp.minimum(*each)

    @property
    def takes_samples(self) -> bool:
        """Whether the response can be processed sample by sample: there is no time shift and no separate model error."""
        return not self._model_error and self.observation.time_shift is None

    @property
    def reads_every_sample(self) -> bool:
        """Whether the sensor has the record's sampling times and a known direction."""
        return self.observation.sampling is None and len(self.observation.instrument.signs) == 1

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
            white = white * np.mean(self.observation.sd**-2.0, axis=0, where=self.observation.is_measured)[:, None]
        response = self.measured_channels(response)
        each = [
            self._given(response, theta, measured.values, sign, white) for sign in self.observation.instrument.signs
        ]
        return self._mean_of_signs(each), finite

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
        result = np.asarray(self.given(response, theta, self.weighted(values)))
        return np.where(run.done, result, -np.inf), ~run.done & (run.status != Status.STRUCTURE_FAILED)
