"""A fitted NARX for any record, whose coefficients are functions of the parameters (PC-NARX, Kriging-NARX).

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from jaxtyping import Float

from structid.campaign.runs import Runs, StoredInMemory
from structid.core.arrays import Array
from structid.core.errors import InputError, Status, StructidWarning
from structid.core.progress import Progress
from structid.engine.array_module import namespace
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.models.traceable import TracedExcitation
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace
from structid.surrogates.base import Surrogate
from structid.surrogates.fit import Fit
from structid.surrogates.narx.coefficients import Coefficients
from structid.surrogates.narx.structure.experiments import Experiments, input_signals
from structid.surrogates.narx.structure.recursion import Recursion
from structid.surrogates.narx.structure.terms import Memory, Term
from structid.surrogates.narx.training.free_run import FreeRun
from structid.surrogates.narx.training.least_squares import refined_coefficients
from structid.surrogates.narx.training.one_step_regression import least_squares_of_each
from structid.surrogates.narx.training.training_set import training_set
from structid.surrogates.surrogate_validation import Validation, validate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PREDICTION_BOUND = 10.0
"""Multiple of the largest training output above which a prediction counts as diverged."""

STRONGER = 1.1
"""Ratio of a record's peak to the largest training peak above which a warning is given."""

WINDOW = 101
"""Number of samples in the moving root mean square, to which the predicted standard deviation is proportional."""


def with_held_out_spread(surrogate: ParametricNARX, runs: Runs) -> ParametricNARX:
    """Set the predicted standard deviation so that 95 % of the samples of held-out runs are within 1.96 standard deviations."""
    ratios: list[np.ndarray] = []
    for number in np.unique(runs.record_of_run):
        some = runs.on(int(number))
        record = some.records[0]
        true = some.values[:, : len(record)]
        predicted = surrogate.run(surrogate.parameters(some.design), record).values
        local = local_size(predicted)
        good = np.isfinite(predicted).all(axis=(1, 2))
        ratios.append((np.abs(true - predicted) / local)[good].reshape(-1, true.shape[2]))
    every = np.concatenate(ratios)
    spread = np.quantile(every, 0.95, axis=0) / 1.96 if len(every) else np.full(len(surrogate.channels), np.inf)
    return ParametricNARX(
        surrogate.fitted,
        surrogate.recursion,
        surrogate.coefficients,
        surrogate.largest,
        spread,
        surrogate.largest_input,
    )


def local_size(values: Float[np.ndarray, "run time channel"]) -> Float[np.ndarray, "run time channel"]:
    """Return the moving root mean square of histories, at least a thousandth of the overall root mean square."""
    window = min(WINDOW, values.shape[1])
    square = scipy.ndimage.uniform_filter1d(values**2, window, axis=1, mode="nearest")
    whole = np.mean(values**2, axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.maximum(square, 1e-6 * whole) + 1e-300))


class ParametricNARX(Surrogate):
    """A fitted `PCNARX` or `KrigingNARX`: a recursion for any record with the time step of the training records."""

    def __init__(
        self,
        fit: Fit,
        recursion: Recursion,
        coefficients: Coefficients,
        largest: float,
        spread: Float[np.ndarray, " channel"],
        largest_input: Float[np.ndarray, " input"],
    ) -> None:
        super().__init__(fit)
        self.recursion, self.coefficients, self.largest = recursion, coefficients, largest
        self.spread, self.largest_input = spread, largest_input

    @property
    def terms(self) -> tuple[str, ...]:
        """Term or shape parameter of each coefficient."""
        return self.recursion.names

    @property
    def structure_in_words(self) -> list[tuple[str, str]]:
        """Terms of the NARX."""
        return [("terms", ", ".join(self.terms))]

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse an excitation of another kind or step."""
        if excitation.kind != self.fitted.excitation or abs(excitation.dt / self.fitted.dt - 1.0) > 1e-9:
            raise InputError(
                f"{self.fitted.kind}: record",
                f"'{excitation.name}', a {excitation.kind} with a time step of {excitation.dt:g} s",
                f"a {self.fitted.excitation} with a time step of {self.fitted.dt:g} s, as in the training",
                "Resample the record.",
            )

    def before_run(self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation) -> None:
        """Check excitation and points; warn of an excitation stronger than the training excitations."""
        super().before_run(theta, excitation)
        peaks = np.abs(excitation.values.reshape(len(excitation), -1)).max(axis=0)
        if self.fitted.outside != "allow" and (peaks > STRONGER * self.largest_input).any():
            ratio = float(np.max(peaks / self.largest_input))
            warnings.warn(
                f"{self.fitted.kind}: '{excitation.name}' is {ratio:.2g} times as strong as the training records, so the "
                "response may be inaccurate. Fit the surrogate to runs on stronger records.",
                StructidWarning,
                stacklevel=3,
            )

    def time_loop(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> TimeLoop:
        """Return the loop of the free run; see `TraceableModel.time_loop`."""
        scales = self.recursion.scales
        x = input_signals(excitation.stages) / np.array([scales[x] for x in self.recursion.inputs])
        x = namespace(x).concatenate([x, x[-1:]])
        bound = PREDICTION_BOUND * self.largest
        coefficients = self.coefficients.predict(self.held_inside(theta)).T
        free, admitted = self.recursion.free_loop(coefficients, x, bound), self.admitted(theta)

        def step(carried: tuple[Any, Any], row: Any) -> tuple[tuple[Any, Any], Any]:
            state, inside = carried
            state, scaled = free.step(state, row)
            inside = inside & (jnp.abs(scaled) < bound).all(axis=0)  # false for NaN
            return (state, inside), jnp.where(inside, scaled, jnp.nan) * self._factors[:, None]

        start = (free.start, jnp.ones(theta.shape[0], dtype=bool))
        lead_in = excitation.dropped_samples
        return TimeLoop(start, step, free.rows, lead_in, lambda last: last[1] & admitted, free.unroll)

    def _coefficients_at(self, theta: np.ndarray) -> np.ndarray:
        return np.asarray(self.coefficients.predict(self.held_inside(theta)))

    def predict_ahead(
        self, design: Design | np.ndarray, excitation: Excitation, measured: np.ndarray, horizon: int = 1
    ) -> Histories:
        """Predict from the measured past up to a horizon; `simulate` predicts from the model's past instead.

        Every `horizon` samples the recursion restarts from the measurement: the next sample is predicted one step ahead, the last
        sample `horizon` steps ahead. A small one-step error does not imply a small free-run error; compare both.
        """
        theta = self.parameters(design)
        self.check_excitation(excitation)
        if not (isinstance(horizon, (int, np.integer)) and horizon >= 1):
            raise InputError("predict_ahead: horizon", f"{horizon!r}", "a whole number of samples, 1 or more")
        values = self._measured(measured, len(theta), len(excitation), "predict_ahead: measured")
        outputs = self._from_measured(theta, excitation, values, horizon=int(horizon))
        return self._histories(outputs[:, excitation.dropped_samples :], excitation)

    def simulate_after(self, design: Design | np.ndarray, excitation: Excitation, beginning: np.ndarray) -> Histories:
        """Simulate a free run after a measured beginning, for a system that is not at rest at the start of the record.

        `simulate` starts with the outputs at their mean initial values in the training data, and with zeros before.
        Here the measurement initialises the memory of the recursion. It must cover the longest lag or, with integrals
        and hysteretic memories, the time after which initial conditions have no effect.
        """
        theta = self.parameters(design)
        self.check_excitation(excitation)
        if excitation.dropped_samples:
            came = f"a signal with {excitation.lead_in_periods} lead-in periods"
            raise InputError("simulate_after: excitation", came, "an excitation without lead-in periods")
        measured_samples = np.shape(beginning)[-2] if np.ndim(beginning) > 1 else np.size(beginning)
        if not 1 <= measured_samples < len(excitation):
            allowed = f"1 to {len(excitation) - 1} samples for this excitation"
            raise InputError("simulate_after: beginning", f"{measured_samples} samples", allowed)
        start = self._measured(beginning, len(theta), measured_samples, "simulate_after: beginning")
        later = np.zeros((len(theta), len(excitation) - measured_samples, len(self.channels)))
        outputs = self._from_measured(theta, excitation, np.concatenate([start, later], axis=1), known=measured_samples)
        return self._histories(np.concatenate([start, outputs[:, measured_samples:]], axis=1), excitation)

    def _measured(self, given: np.ndarray, runs: int, samples: int, where: str) -> np.ndarray:
        """Return measured values (run, time, channel) after a check."""
        values = np.asarray(given, dtype=np.float64)
        values = values[:, None] if values.ndim == 1 else values
        shape = (runs, samples, len(self.channels))
        if values.shape not in (shape, shape[1:]) or not np.isfinite(values).all():
            came = f"an array of shape {np.shape(given)}"
            came += "" if np.isfinite(values).all() else " with values that are not finite"
            raise InputError(where, came, f"finite values of shape {shape}, or of this shape without the first axis")
        return np.broadcast_to(values, shape)

    def _from_measured(
        self, theta: np.ndarray, excitation: Excitation, values: np.ndarray, horizon: int | None = None, known: int = 0
    ) -> np.ndarray:
        """Compute the outputs in SI of runs that start from measured values (run, time, channel)."""
        return self._outputs(self._coefficients_at(theta), excitation, values, horizon, known)

    def run_with(self, coefficients: Float[np.ndarray, "run coefficient"], excitation: Excitation) -> Histories:
        """Simulate a free run with given coefficients."""
        nothing = np.zeros((len(coefficients), len(excitation), len(self.channels)))
        outputs = self._outputs(coefficients, excitation, nothing)
        return self._histories(outputs[:, excitation.dropped_samples :], excitation)

    def _outputs(
        self,
        coefficients: np.ndarray,
        excitation: Excitation,
        values: np.ndarray,
        horizon: int | None = None,
        known: int = 0,
    ) -> np.ndarray:
        """Compute the outputs in SI for given coefficients, optionally restarting from given values, shape (run, time, channel)."""
        count = len(coefficients)
        # The parameters are not used here, and there may be none.
        runs = Runs(
            Design(np.zeros((count, 0)), ParameterSpace()),
            (excitation,),
            self.channels,
            StoredInMemory(values),
            np.full(count, Status.DONE),
            np.zeros(count, dtype=int),
        )
        data = training_set(Experiments.of(runs, self.fitted.dt), self.recursion)
        run = FreeRun(self.recursion, PREDICTION_BOUND * self.largest, horizon, known)
        return np.asarray(run.outputs(coefficients, data) * self._factors)

    def _histories(self, outputs: np.ndarray, excitation: Excitation) -> Histories:
        """Return histories, with NaN after a run diverges from the range of the training data."""
        beyond = (np.abs(outputs) >= (1.0 - 1e-9) * PREDICTION_BOUND * self.largest * self._factors).any(axis=2)
        lost = np.logical_or.accumulate(beyond, axis=1)
        status = np.where(lost.any(axis=1), Status.DIVERGED, Status.DONE)
        time = np.where(lost.any(axis=1), lost.argmax(axis=1) * excitation.dt, np.nan)
        values = np.where(lost[:, :, None], np.nan, outputs)
        return Histories(values, excitation.dt, self.channels, status, time, excitation.name)

    @property
    def _factors(self) -> np.ndarray:
        """Factor that converts each scaled output to SI."""
        return np.array([self.recursion.scales[y] for y in self.recursion.outputs])

    def standard_deviation(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        values: Float[np.ndarray, "run time channel"],
    ) -> Float[np.ndarray, "run time channel"]:
        """Return the standard deviation of the error: a moving root mean square times a factor from held-out runs."""
        return np.asarray(local_size(values) * self.spread)

    def error_variance(
        self,
        theta: Float[Array, "run parameter"],
        excitation: TracedExcitation,
        values: Float[Array, "time channel run"],
    ) -> Float[Array, "channel run"]:
        """Return the variance of the surrogate's error, averaged over time; see `StandIn.error_variance`."""
        return (values**2).mean(axis=0) * (np.asarray(self.spread) ** 2)[:, None]

    def validate_structure(self, runs: Runs, refined: bool = True, progress: Progress | None = None) -> Validation:
        """Simulate free runs with coefficients fitted to each run separately, to assess the terms.

        Figures 3.12 and 5.5 to 5.7 of the thesis show such errors over the experimental design, with `refined=False`.
        """
        return validate(WithOwnCoefficients.of(self, runs, refined), runs, progress)

    def own_coefficients(self, runs: Runs, refined: bool = True) -> Float[np.ndarray, "run coefficient"]:
        """Fit the coefficients to each run separately; see `validate_structure`."""
        data = training_set(Experiments.of(runs, self.fitted.dt), self.recursion)
        free_run = FreeRun(self.recursion, PREDICTION_BOUND * self.largest)
        if refined:
            return refined_coefficients(free_run, self._coefficients_at(self.parameters(runs.design)), data, 2)
        return least_squares_of_each(free_run, data)

    def plot_coefficients(self, runs: Runs, save: str | os.PathLike[str] | None = None, refined: bool = True) -> Figure:
        """Draw the predicted coefficients against coefficients fitted to each single run."""
        from structid.figures import surrogate as figures

        done = runs[runs.done]
        for number in np.unique(done.record_of_run):
            self.check_excitation(done.records[number])
        if done.channels != self.channels:
            raise InputError("plot_coefficients", f"the channels {', '.join(done.channels)}", ", ".join(self.channels))
        predicted = self._coefficients_at(self.parameters(done.design))
        return figures.coefficients(self.own_coefficients(done, refined), predicted, self.terms, save=save)

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the contents for a file."""
        contents, arrays = self.coefficients.to_plain()
        recursion = self.recursion
        plain = {
            "terms": [[t.text for t in of] for of in recursion.terms],
            "memories": [str(m) for m in recursion.memories],
            "inputs": list(recursion.inputs),
            "outputs": list(recursion.outputs),
            "scales": dict(recursion.scales),
            "largest": self.largest,
            "largest_input": self.largest_input.tolist(),
            "coefficients": contents,
        }
        return plain, {**arrays, "initial": recursion.initial, "spread": self.spread}

    @classmethod
    def from_plain(cls, fit: Fit, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> ParametricNARX:
        """Rebuild from the result of `to_plain`."""
        recursion = Recursion(
            tuple(tuple(Term(t) for t in of) for of in plain["terms"]),
            tuple(Memory.parse(m) for m in plain["memories"]),
            tuple(plain["inputs"]),
            tuple(plain["outputs"]),
            fit.dt,
            plain["scales"],
            arrays["initial"],
        )
        coefficients = Coefficients.from_plain(fit.space, plain["coefficients"], arrays)
        return cls(fit, recursion, coefficients, plain["largest"], arrays["spread"], np.array(plain["largest_input"]))


@dataclass(frozen=True, eq=False)
class WithOwnCoefficients:
    """A NARX with coefficients fitted to single runs, at the points of these runs."""

    surrogate: ParametricNARX  # structure, channels and range
    of_point: dict[bytes, np.ndarray]  # coefficients at each point

    @classmethod
    def of(cls, surrogate: ParametricNARX, runs: Runs, refined: bool) -> WithOwnCoefficients:
        """Fit the coefficients; see `ParametricNARX.own_coefficients`."""
        done = runs[runs.done]
        points = surrogate.parameters(done.design)
        coefficients = surrogate.own_coefficients(done, refined)
        return cls(surrogate, {point.tobytes(): row for point, row in zip(points, coefficients, strict=True)})

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of the surrogate."""
        return self.surrogate.channels

    def parameters(self, design: Design) -> np.ndarray:
        """Return the parameters of the surrogate; see `Model.parameters`."""
        return self.surrogate.parameters(design)

    def check_excitation(self, excitation: Excitation) -> None:
        """Check an excitation; see `ParametricNARX.check_excitation`."""
        self.surrogate.check_excitation(excitation)

    def outside(self, theta: np.ndarray) -> np.ndarray:
        """Return a mask of the points outside the range of the surrogate."""
        return self.surrogate.outside(theta)

    def standard_deviation(self, theta: np.ndarray, excitation: Excitation, values: np.ndarray) -> np.ndarray:
        """Return the standard deviation of the surrogate."""
        return self.surrogate.standard_deviation(theta, excitation, values)

    def run(self, theta: np.ndarray, excitation: Excitation) -> Histories:
        """Compute the response with the coefficients of these points."""
        coefficients = np.stack([self.of_point[point.tobytes()] for point in theta])
        return self.surrogate.run_with(coefficients, excitation)
