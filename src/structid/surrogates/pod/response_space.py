"""Response-space surrogates for given records: principal components of the history, and a regression of each score."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.engine.array_module import namespace
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation
from structid.models.traceable import TracedExcitation
from structid.surrogates.base import Surrogate
from structid.surrogates.fit import Fit
from structid.surrogates.named_arrays import found_under, put_under
from structid.surrogates.pod.record_fit import RecordFit
from structid.surrogates.pod.score_shortcut import ScoreShortcut, nearest_scores
from structid.surrogates.regression_list import regression_from_plain


class ResponseSpaceSurrogate(Surrogate):
    """A fitted `PODKriging` or `PODPCE`, restricted to the records of its training runs."""

    loops: ClassVar[bool] = False
    own_records: ClassVar[bool] = True

    def __init__(self, fit: Fit, records: Mapping[str, RecordFit]) -> None:
        super().__init__(fit)
        self.records = dict(records)

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse a record that is not among the records of the training runs."""
        if excitation.content_hash not in self.records:
            records = ", ".join(
                f"'{f.name}' ({f.samples} samples at {self.fitted.dt:g} s)" for f in self.records.values()
            )
            raise InputError(
                f"{self.fitted.kind}: record",
                f"the surrogate was not fitted to '{excitation.name}' ({len(excitation)} samples at {excitation.dt:g} s)",
                records,
                "Fit it to runs on this record, or use PCNARX or KrigingNARX, which accept any record.",
            )

    def response(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> tuple[Any, Any]:
        """Compute the scores, then the response as the sum of scores times modes."""
        fit, numpy = self.records[excitation.identity], namespace(theta)
        factors = np.tile(fit.scale, fit.samples)
        scores = fit.scores.predict(self.held_inside(theta))
        values = numpy.asarray((fit.modes * factors).T) @ scores.T + (fit.mean * factors)[:, None]
        finite = numpy.isfinite(scores).all(axis=1)
        return values.reshape(fit.samples, len(fit.scale), -1), finite

    def time_loop(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> TimeLoop:
        """Return a loop over samples, for a likelihood that needs no history; see `TraceableModel.time_loop`."""
        fit = self.records[excitation.identity]
        scores = fit.scores.predict(self.held_inside(theta)).T
        modes = fit.modes.reshape(-1, fit.samples, len(fit.scale)) * fit.scale
        mean = fit.mean.reshape(fit.samples, len(fit.scale)) * fit.scale

        def step(scores: Any, row: tuple[Any, Any]) -> tuple[Any, Any]:
            of_modes, of_mean = row
            return scores, of_modes.T @ scores + of_mean[:, None]

        rows = jnp.asarray(modes.transpose(1, 0, 2)), jnp.asarray(mean)
        return TimeLoop(scores, step, rows, 0, lambda scores: jnp.isfinite(scores).all(axis=0))

    @property
    def _compiled_response(self) -> Callable[..., Any]:
        return self.response  # two matrix products need no compilation

    def shortcut(
        self,
        excitation: Excitation,
        values: Float[np.ndarray, "sample channel measurement"],
        channels: tuple[str, ...],
        sampled: Callable[[np.ndarray], np.ndarray] | None = None,
        instrument: Float[np.ndarray, "sample channel column"] | None = None,
    ) -> ScoreShortcut:
        """Precompute sums of modes and measurements over time; see `TraceableModel.shortcut`."""
        self.check_excitation(excitation)
        fit = self.records[excitation.content_hash]
        shape = (fit.samples, len(fit.scale))
        places = [self.channels.index(channel) for channel in channels]
        scale = fit.scale[places]
        modes = fit.modes.reshape(-1, *shape)[:, :, places] * scale
        mean = fit.mean.reshape(shape)[:, places] * scale
        left_out = np.mean(fit.truncation.reshape(shape)[:, places] ** 2, axis=0) * scale**2
        if sampled is not None:
            modes, mean = sampled(modes.transpose(1, 2, 0)).transpose(2, 0, 1), sampled(mean[:, :, None])[:, :, 0]
        if instrument is not None:
            # An unknown gain multiplies the mean, too: the mean and the columns of the instrument are further modes.
            modes = np.concatenate([modes, mean[None], instrument.transpose(2, 0, 1)])
            mean = np.zeros_like(mean)
        modes_of = [np.ascontiguousarray(modes[:, :, index]) for index in range(len(channels))]
        inner = [of_channel @ of_channel.T for of_channel in modes_of]
        parts = [
            [nearest_scores(modes, products, column - mean) for column in values[:, index].T]
            for index, (modes, products, mean) in enumerate(zip(modes_of, inner, mean.T, strict=True))
        ]
        nearest, squares, levers = (np.array([[m[part] for m in of] for of in parts]) for part in range(3))
        return ScoreShortcut(
            self,
            excitation.content_hash,
            np.array(inner),
            left_out,
            float(len(values)),
            nearest,
            squares,
            levers,
            orthogonal=sampled is None and instrument is None,
        )

    def error_variance(
        self,
        theta: Float[Array, "run parameter"],
        excitation: TracedExcitation,
        values: Float[Array, "time channel run"],
    ) -> Float[Array, "channel run"]:
        """Return the variance of the surrogate's error, averaged over time; see `StandIn.error_variance`."""
        fit = self.records[excitation.identity]
        shape = (fit.samples, len(fit.scale))
        squares = (fit.modes.reshape(-1, *shape) ** 2).mean(axis=1) * fit.scale**2
        rest = (fit.truncation.reshape(shape) ** 2).mean(axis=0) * fit.scale**2
        return (self.scores_with_deviation(fit, theta)[1] ** 2 @ squares + rest).T

    def scores_with_deviation(self, fit: RecordFit, theta: Float[Array, "run parameter"]) -> tuple[Any, Any]:
        """Return the scores and their standard deviations."""
        scores, deviation = fit.scores.predict_with_deviation(self.held_inside(theta))
        if deviation is None:
            numpy = namespace(scores)
            deviation = numpy.broadcast_to(numpy.asarray(fit.score_deviation), scores.shape)
        return scores, deviation

    def standard_deviation(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        values: Float[np.ndarray, "run time channel"],
    ) -> Float[np.ndarray, "run time channel"]:
        """Return the standard deviation in time, from the scores and from the omitted components."""
        self.check_excitation(excitation)
        fit = self.records[excitation.content_hash]
        deviation = fit.scores.deviation(self.held_inside(np.asarray(theta, dtype=np.float64)))
        if deviation is None:
            deviation = np.tile(fit.score_deviation, (len(theta), 1))
        variance = deviation**2 @ fit.modes**2 + fit.truncation**2
        return np.asarray(np.sqrt(variance).reshape(values.shape) * fit.scale)

    def sampled(
        self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation, rng: np.random.Generator
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw responses with independent random errors of the scores; see `Surrogate.sampled`."""
        self.check_excitation(excitation)
        fit = self.records[excitation.content_hash]
        scores, deviation = self.scores_with_deviation(fit, np.asarray(theta, dtype=np.float64))
        scores = scores + deviation * rng.standard_normal(scores.shape)
        values = scores @ fit.modes
        values += fit.mean
        values = values.reshape(len(theta), fit.samples, len(fit.scale))
        values *= fit.scale
        return np.asarray(values)

    def left_out(
        self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation
    ) -> Float[np.ndarray, "run time channel"]:
        """Predict each training run from all other runs, with the same correlation lengths."""
        fit = self.records[excitation.content_hash]
        kriging: Any = fit.scores
        scores = kriging.predict(np.asarray(theta, dtype=np.float64)) - kriging.leave_one_out_residuals
        values = (fit.mean + scores @ fit.modes).reshape(len(theta), fit.samples, len(fit.scale))
        return np.asarray(values * fit.scale)

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the contents for a file."""
        plain: dict[str, Any] = {}
        arrays: dict[str, np.ndarray] = {}
        for number, (content_hash, fit) in enumerate(self.records.items()):
            scores_plain, scores_arrays = fit.scores.to_plain()
            plain[str(number)] = {
                "hash": content_hash,
                "name": fit.name,
                "samples": fit.samples,
                "regression": fit.scores.word,
                "scores": scores_plain,
            }
            part_arrays = {
                "mean": fit.mean,
                "modes": fit.modes,
                "truncation": fit.truncation,
                "scale": fit.scale,
                "score_deviation": fit.score_deviation,
            }
            arrays |= put_under(str(number), {**part_arrays, **put_under("scores", scores_arrays)})
        return plain, arrays

    @classmethod
    def from_plain(cls, fit: Fit, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> ResponseSpaceSurrogate:
        """Rebuild from the result of `to_plain`."""
        records = {}
        for number, description in plain.items():
            arrays_of_record = found_under(number, arrays)
            scores = found_under("scores", arrays_of_record)
            records[description["hash"]] = RecordFit(
                name=description["name"],
                samples=description["samples"],
                scores=regression_from_plain(description["regression"], fit.space, description["scores"], scores),
                **{
                    name: arrays_of_record[name] for name in ("mean", "modes", "truncation", "scale", "score_deviation")
                },
            )
        return cls(fit, records)
