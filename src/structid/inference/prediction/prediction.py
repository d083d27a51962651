"""Prior and posterior prediction, with and without errors, for the measured record or another record."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from jaxtyping import Float, Int

from structid.core.channels import ChannelUnit
from structid.core.errors import InputError
from structid.core.notebook import ShownAsText
from structid.core.progress import Progress
from structid.core.streams import Purpose, stream
from structid.core.units import factor
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.inference.likelihood.posterior import Posterior
from structid.inference.prediction.band_scale import BandScale, Rounding
from structid.inference.prediction.error_growth import ErrorGrowth, error_growth
from structid.inference.prediction.over_draws import median, quantiles
from structid.inference.prediction.parameter_drift import ParameterDrift
from structid.models.base import Model
from structid.models.finer_steps import simulate_in_steps_it_needs
from structid.observation import Observation

FEW_DRAWS = 100
"""Number of draws that show the spread of the response from the posterior of the parameters alone."""
LARGEST_USUAL = 3.0
"""Size of an error, in standard deviations of the noise, from which it is an outlier."""
PEAK_SHARE = (0.5, 0.5)
"""Mean and standard deviation of the exponent with which the measured peak ratio corrects the peaks on another record."""


@dataclass(frozen=True)
class Prediction(ShownAsText):
    """Draws of a predicted response.

    Parameters
    ----------
    time : ndarray, shape (time,)
        Time [s].
    channels : tuple of str
        Predicted channels.
    response : ndarray, shape (draw, time, channel)
        The model's response in SI, without errors.
    observable : ndarray, shape (draw, time, channel)
        The response with errors, as an instrument would record it. Equal to `response` for unmeasured channels, whose errors
        are unknown.
    failed : int
        Number of draws whose simulation failed; they are left out.
    excitation : str
        Name of the record.
    units : mapping of str to ChannelUnit
        Units of the channels.
    structural : ndarray, shape (draw, time, channel), optional
        Response of the structure, with the model's error but without the instrument's. By default equal to `response`.
    peak_ratio : ndarray, shape (channel,), optional
        For another record: ratio of measured and predicted peak on the measured record, with the instrument's noise in the
        prediction. By default 1.
    peak_share : ndarray, shape (draw,), optional
        Exponent of `peak_ratio` for the correction of each draw's peaks.
    status : ndarray of int, shape (all draws,), optional
        Final status of every simulation, including the failed draws.
    rounding : ndarray, shape (channel,), optional
        Step to which the instrument rounds its readings, in SI; 0 if it does not.
    """

    time: Float[np.ndarray, " time"]
    channels: tuple[str, ...]
    response: Float[np.ndarray, "draw time channel"] = field(repr=False)
    observable: Float[np.ndarray, "draw time channel"] = field(repr=False)
    failed: int
    excitation: str
    units: Mapping[str, ChannelUnit] = field(default_factory=dict)
    structural: Float[np.ndarray, "draw time channel"] | None = field(default=None, repr=False)
    peak_ratio: Float[np.ndarray, " channel"] | None = None
    peak_share: Float[np.ndarray, " draw"] | None = None
    status: Int[np.ndarray, " all_draws"] | None = field(default=None, repr=False)
    rounding: Float[np.ndarray, " channel"] | None = field(default=None, repr=False)

    def __str__(self) -> str:
        runs, samples, _ = self.response.shape
        failed = f"; {self.failed} further draws failed" if self.failed else ""
        lines = [f"{runs} draws of the response to {self.excitation or 'a record'}, {samples} samples{failed}"]
        for channel, peaks in zip(self.channels, self.peaks.T, strict=True):
            unit = self.units[channel].display if channel in self.units else ""
            low, middle, high = np.quantile(peaks, (0.05, 0.5, 0.95)) / factor(unit) if runs else (np.nan,) * 3
            lines.append(f"  peak {channel} {middle:.3g} {unit} (90 %: {low:.3g} to {high:.3g})")
        return "\n".join(lines)

    __repr__ = __str__

    def band(self, probability: float = 0.9, discrepancy: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Pointwise central interval.

        Parameters
        ----------
        probability : float
            Probability of the interval.
        discrepancy : bool
            Use the observable instead of the model's response.

        Returns
        -------
        tuple of ndarray, shape (time, channel)
            Lower and upper edge in SI. Those of rounded readings lie half a step outside the outermost values.
        """
        tail = 0.5 * (1.0 - probability)
        low, high = quantiles(self.observable if discrepancy else self.response, [tail, 1.0 - tail])
        if not discrepancy or self.rounding is None:
            return low, high
        # A reading equals another one to within the round-off of floating-point numbers only.
        return low - 0.5 * self.rounding, high + 0.5 * self.rounding

    @property
    def peaks(self) -> np.ndarray:
        """Largest absolute value of the structure's response in every draw, in SI, shape (draw, channel).

        On another record, the peaks of draw u are multiplied by r^s_u, with r the `peak_ratio` and s_u the draw's `peak_share`.
        The exponents s_u have a mean and a standard deviation of ½. A model that errs on one peak often errs on the next in the
        same direction, and one record does not show how often.
        """
        largest = _largest(self.response if self.structural is None else self.structural)
        if self.peak_ratio is None or self.peak_share is None:
            return largest
        return np.asarray(largest * self.peak_ratio ** self.peak_share[:, None])


def first_that_takes(record: Excitation | None, *posteriors: Posterior) -> Posterior:
    """Choose the first posterior that can predict a record: a surrogate may be restricted to its own records."""
    for posterior in posteriors[:-1]:
        try:
            if record is not None:
                posterior.model.check_excitation(record)
        except InputError:
            continue
        return posterior
    return posteriors[-1]


def predict(
    posterior: Posterior,
    theta: Float[np.ndarray, "draw parameter"],
    record: Excitation | None = None,
    channels: tuple[str, ...] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    drift: ParameterDrift | None = None,
    scaled: bool = True,
    observation: int | None = None,
) -> Prediction:
    """Predict the response for draws of the parameters."""
    predictor = Predictor(posterior, theta, seed, drift, scaled)
    return predictor.on(record, channels, progress, observation=observation)


@dataclass(frozen=True, eq=False)
class Predictor:
    """Predicts the response of the same draws to several records; see `predict`."""

    posterior: Posterior  # model, measurements and error model
    theta: Float[np.ndarray, "draw parameter"] = field(repr=False)  # draws in SI
    seed: int = 0  # seed of the errors
    # Drift of the parameters between the measured records and another record
    drift: ParameterDrift | None = None
    scaled: bool = True  # whether errors are scaled by the coverage of their band on the measured record

    def on(
        self,
        record: Excitation | None = None,
        channels: tuple[str, ...] | None = None,
        progress: Progress | None = None,
        stand_in: Model | None = None,
        observation: int | None = None,
    ) -> Prediction:
        """Predict the response to a record."""
        observations = self.posterior.observations
        if observation is not None and not 0 <= observation < len(observations):
            raise InputError("observation", f"index {observation}", f"an index from 0 to {len(observations) - 1}")
        measured_record = observations[observation or 0].record
        if observation is not None and record is not None and record is not measured_record:
            raise InputError(
                "observation", f"index {observation} and another record", "only one of the two", "Leave record out."
            )
        record = measured_record if record is None else record
        sources = Sources.of_record(observations, record, channels, observation)
        prediction = self._responding(record, sources, progress, stand_in)
        if not self.scaled or not len(prediction.response):
            return prediction
        own = self._spread_of_parameters(prediction, record, sources, stand_in)
        for index in sources.indices:
            if index in sources.here:
                there, places = self._there(index, sources), sources.places(index)
                scale = self._band_scale(index, there, prediction, places)
                # Its parameters have no added drift.
                self._scale(index, there, prediction, places, scale, own, response=False)
        # A further prediction of the measured record would double the runs of an expensive model.
        if sources.here or self.posterior.costs_runs:
            return prediction
        ratios = np.ones(len(sources.channels))
        for index in sources.indices:
            there, places = self._there(index, sources), sources.places(index)
            scale, ratio = self._of_the_measured_record(index)
            self._scale(index, there, prediction, places, BandScale(scale.factors[:, there]), own)
            ratios[places] = ratio[there]
        share = stream(self.seed, Purpose.PEAK_OF_ANOTHER_RECORD).normal(*PEAK_SHARE, size=len(prediction.response))
        return replace(prediction, peak_ratio=ratios, peak_share=share)

    def _spread_of_parameters(
        self, prediction: Prediction, record: Excitation, sources: Sources, stand_in: Model | None
    ) -> np.ndarray:
        """Standard deviation of the response from the posterior of the parameters alone, shape (time, channel)."""
        if not self._drifts(sources):
            return np.asarray(prediction.response.std(axis=0))
        some = self.theta[:: -(-len(self.theta) // FEW_DRAWS)]
        without = replace(self, theta=some, drift=None)._responding(record, sources, None, stand_in)
        return np.asarray(without.response.std(axis=0))

    def _drifts(self, sources: Sources) -> bool:
        """Whether the parameters of the draws move by the drift that the measured record shows."""
        return self.drift is not None and not self.posterior.error_model.inside and not sources.here

    def _of_the_measured_record(self, index: int) -> tuple[BandScale, np.ndarray]:
        """Band scale and peak ratio of an observation, predicted as if its record were another record."""
        if index not in self._measured_again:
            observation = self.posterior.observations[index]
            another = copy.copy(observation.record)  # records are distinguished by identity
            sources = Sources(observation.channels, (index,) * len(observation.channels), frozenset())
            prediction = self._responding(another, sources, None, instrument=True)
            every = list(range(len(observation.channels)))
            scale = self._band_scale(index, every, prediction, every)
            self._scale(index, every, prediction, every, scale, prediction.response.std(axis=0))
            self._measured_again[index] = scale, self._peak_ratio(index, prediction)
        return self._measured_again[index]

    def _peak_ratio(self, index: int, prediction: Prediction) -> np.ndarray:
        """Ratio of measured to predicted peak of an observation, (channel,); the prediction includes noise, which raises peaks.

        An outlier is no peak of the response: outliers are moved to `LARGEST_USUAL` standard deviations of the noise.
        """
        observation, bound = self.posterior.observations[index], self.posterior.likelihood.of[index]
        rng, has_outliers = stream(self.seed, Purpose.NOISE_OF_THE_PEAK), bound.discrepancy.has_outliers
        structural = prediction.response if prediction.structural is None else prediction.structural
        middle = np.asarray(observation.instrument.sampled(median(prediction.response)))
        residual = observation.values - middle
        sd = _noise_sd(residual, has_outliers)
        if bound.discrepancy.depends_on_response:
            unknown = self.posterior.unknowns(self.theta[: len(structural)], index)
            noise = bound.draw_errors(rng, structural, unknown, observation.step)
        else:
            noise = sd * rng.normal(size=structural.shape)
        predicted = np.median(_largest(np.where(observation.covered[:, None], structural + noise, 0.0)), axis=0)
        largest = observation.peaks
        if has_outliers:
            usual = middle + np.clip(residual, -LARGEST_USUAL * sd, LARGEST_USUAL * sd)
            largest = np.nanmax(np.abs(usual), axis=0, initial=0.0)
        moves = (largest > 0.0) & (predicted > 0.0)
        return np.where(moves, largest / np.where(moves, predicted, 1.0), 1.0)

    def _band_scale(self, index: int, there: list[int], prediction: Prediction, places: list[int]) -> BandScale:
        """Factors on the bands of some channels of an observation, `there`, which are `places` of the prediction."""
        observation = self.posterior.observations[index]
        observable = prediction.observable[:, :, places]
        if observation.sampling is not None:
            observable = self._at_samples(index, prediction.response[:, :, places], there)
        rounding = self._rounding(index, there)
        measured, observable = (rounding.undone(readings) for readings in (observation.values[:, there], observable))
        return BandScale.of(measured, observable, observation.step)

    def _there(self, index: int, sources: Sources) -> list[int]:
        """Places, among the channels of an observation, of the channels whose source it is."""
        channels = self.posterior.observations[index].channels
        return [channels.index(sources.channels[place]) for place in sources.places(index)]

    def _rounding(self, index: int, there: list[int]) -> Rounding:
        """Rounding of some channels of an observation."""
        bound = self.posterior.likelihood.of[index]
        steps = bound.discrepancy.rounding(bound.channels)[there]
        return Rounding(steps, stream(self.seed, Purpose.WITHIN_A_ROUNDING_STEP, index))

    def _scale(
        self,
        index: int,
        there: list[int],
        prediction: Prediction,
        places: list[int],
        scale: BandScale,
        own: np.ndarray,
        response: bool = True,
    ) -> None:
        """Scale the errors in some channels as on the measured record; `response` also scales the response."""
        # The drift of the parameters is a part of the total: it is narrowed with the total, but not widened. Nothing becomes
        # narrower than the spread `own` of the parameters' posterior: outliers or gaps make errors too large, and tell nothing of
        # it. A peak is an extreme of the record, on which a 90 % band of the samples contains little information: histories used
        # for peaks are not narrowed.
        narrowed, widened = BandScale(np.minimum(scale.factors, 1.0)), BandScale(np.maximum(scale.factors, 1.0))
        assert prediction.structural is not None
        dt, rounding = prediction.time[1] - prediction.time[0], self._rounding(index, there)
        # In place: copies of all histories would need several times their memory.
        readings = prediction.observable
        readings[:, :, places] = rounding.done(
            scale.applied(rounding.undone(readings[:, :, places]), dt, own[:, places])
        )
        others = [(prediction.structural, widened), *([(prediction.response, narrowed)] if response else [])]
        for draws, scale_of_draws in others:
            draws[:, :, places] = scale_of_draws.applied(draws[:, :, places], dt, own[:, places])

    def _at_samples(self, index: int, response: np.ndarray, there: list[int]) -> np.ndarray:
        """Draws of the readings at the samples of a sensor, (draw, sample, channel)."""
        observation = self.posterior.observations[index]
        sampled = np.asarray(observation.instrument.sampled(response.transpose(1, 2, 0))).transpose(2, 0, 1)
        rng = stream(self.seed, Purpose.PREDICTION_ON_THE_RECORD, index)
        unknown = self.posterior.unknowns(self.theta[: len(sampled)], index)
        every = np.zeros((*sampled.shape[:2], len(observation.channels)))
        every[:, :, there] = sampled
        errors = self.posterior.likelihood.of[index].draw_errors(rng, every, unknown, observation.step)
        return np.asarray(sampled + errors[:, :, there])

    @cached_property
    def _measured_again(self) -> dict[int, tuple[BandScale, np.ndarray]]:
        return {}

    @cached_property
    def _growth_of_errors(self) -> dict[int, ErrorGrowth]:
        return {}

    def _growth(self, index: int) -> ErrorGrowth:
        """Error growth of an observation, computed once, by one model run."""
        if index not in self._growth_of_errors:
            self._growth_of_errors[index] = error_growth(self.posterior, self.theta.mean(axis=0), index)
        return self._growth_of_errors[index]

    def _responding(
        self,
        record: Excitation,
        sources: Sources,
        progress: Progress | None,
        stand_in: Model | None = None,
        instrument: bool = False,
    ) -> Prediction:
        """Draws of the response; on another record, instruments' nuisance parameters are used only on request."""
        posterior, theta, hidden = self.posterior, self.theta, stream(self.seed, Purpose.HIDDEN_ON_ANOTHER_RECORD)
        observations = posterior.observations
        if self._drifts(sources):
            assert self.drift is not None
            theta = self.drift.moved(theta, hidden)
        measured = {index: observations[index].channels for index in sources.indices}
        every = tuple(
            dict.fromkeys((*(c for channels_of_one in measured.values() for c in channels_of_one), *sources.channels))
        )
        # Errors inside the model differ between observations, so each observation needs its own run.
        alone = posterior.error_model.inside and len(sources.here) > 1
        runs = {
            index: self._run(theta, record, every, index, hidden, progress, stand_in)
            for index in (sources.indices if alone else [min(sources.here, default=None)])
        }
        good = np.all([run.done for run in runs.values()], axis=0)

        def response_of(index: int | None, channels: Sequence[str]) -> np.ndarray:
            """The model's response with the instrument of an observation, (draw, time, channel)."""
            run = runs[index] if alone and index is not None else next(iter(runs.values()))
            values = (run.values if good.all() else run.values[good])[:, :, [run.channels.index(c) for c in channels]]
            if index is None or not len(values) or not (index in sources.here or instrument):
                return np.asarray(values)
            observation, bound = observations[index], posterior.likelihood.of[index]
            unknown, response = posterior.unknowns(theta[good], index), values.transpose(1, 2, 0)
            sign = bound.sign(response, theta[good])
            return np.asarray(observation.instrument.on_record(response, unknown, sign)).transpose(2, 0, 1)

        responses = {index: response_of(index, channels_of_one) for index, channels_of_one in measured.items()}
        of_sources = response_of(None, sources.channels).copy()
        for index, response in responses.items():
            of_sources[:, :, sources.places(index)] = response[:, :, self._there(index, sources)]
        first, status = next(iter(runs.values())), np.max([run.status for run in runs.values()], axis=0)
        time, model_units = first.time, first.units
        del first
        runs.clear()  # histories of all draws take much memory, and are not needed again

        def erring(purpose: Purpose | None = None) -> np.ndarray:
            """Add all errors, or for a purpose those of the model alone, to the response."""
            result = of_sources.copy()
            for index, response in responses.items():
                bound = posterior.likelihood.of[index]
                error_model = bound.discrepancy if purpose is None else bound.discrepancy.of_the_model
                if error_model is None:
                    continue
                here = index in sources.here
                drawn = Purpose.PREDICTION_ON_THE_RECORD if here else Purpose.PREDICTION_ON_ANOTHER_RECORD
                rng, unknown = stream(self.seed, purpose or drawn, index), posterior.unknowns(theta[good], index)
                size = self._size_of_errors(index, response, record.dt, here)
                errors = bound.draw_errors(rng, response, unknown, record.dt, size, error_model)
                errors += response
                result[:, :, sources.places(index)] = errors[:, :, self._there(index, sources)]
            return result

        units = model_units | {
            c: observations[index].channel_unit(c)
            for index, channels_of_one in reversed(measured.items())
            for c in channels_of_one
            if c in observations[index].units
        }
        return Prediction(
            time,
            sources.channels,
            of_sources,
            erring(),
            int((~good).sum()),
            record.name,
            {c: units[c] for c in sources.channels},
            erring(Purpose.PREDICTED_MODEL_ERROR),
            status=status,
            rounding=self._rounding_of(sources),
        )

    def _run(
        self,
        theta: np.ndarray,
        record: Excitation,
        channels: tuple[str, ...],
        index: int | None,
        hidden: np.random.Generator,
        progress: Progress | None,
        stand_in: Model | None,
    ) -> Histories:
        """Run the model on the record of the observation `index`, or on another record if it is None."""
        posterior = self.posterior
        if stand_in is not None:
            space = posterior.model_space
            model, parameters = stand_in, np.asarray(space.columns(theta[:, : space.dimension], stand_in.free))
        else:
            model, parameters = posterior.likelihood.on_record(theta, record, hidden, index)
            if set(channels) - set(model.channels):
                model = model.recording(*channels)
        if index is None:
            return simulate_in_steps_it_needs(model, parameters, record, progress, posterior.map)
        return model.simulate(parameters, record, progress=progress, map=posterior.map)

    def _rounding_of(self, sources: Sources) -> np.ndarray:
        """Steps to which the instruments round the predicted channels, shape (channel,)."""
        steps = np.zeros(len(sources.channels))
        for index in sources.indices:
            steps[sources.places(index)] = self._rounding(index, self._there(index, sources)).steps
        return steps

    def _size_of_errors(self, index: int, response: np.ndarray, dt: float, here: bool) -> np.ndarray:
        """Factor on the errors of an observation: their growth with the response, and known standard deviations."""
        observation = self.posterior.observations[index]
        # Errors that depend on the response grow with it by themselves.
        depends = self.posterior.discrepancy.depends_on_response
        scale = np.ones(response.shape) if depends else self._growth(index).scale(response, dt)
        if observation.sd is None:
            return scale
        # The standard deviations hold for the measured record; another record takes their mean square.
        sd = np.asarray(observation.sd)
        if here:
            return observation.instrument.edge_on_record(sd)
        return np.asarray(scale * np.sqrt(np.mean(sd**2, axis=0, where=observation.is_measured)))


@dataclass(frozen=True)
class Sources:
    """The observation that determines the errors of each predicted channel."""

    channels: tuple[str, ...]  # predicted channels
    of: tuple[int | None, ...]  # index of the observation of each channel; None for an unmeasured channel
    here: frozenset[int]  # observations made on the predicted record itself

    @classmethod
    def of_record(
        cls,
        observations: Sequence[Observation],
        record: Excitation,
        channels: tuple[str, ...] | None,
        observation: int | None,
    ) -> Sources:
        """Choose an observation for every channel: one on that record, or else the first of the channel."""
        on_record = [i for i, o in enumerate(observations) if o.record is record]
        here = on_record if observation is None else [observation]
        order = [*here, *(i for i in range(len(observations)) if i not in here)]
        if channels is None:
            channels = tuple(dict.fromkeys(c for i in here or order for c in observations[i].channels))
        first = tuple(next((i for i in order if c in observations[i].channels), None) for c in channels)
        return cls(tuple(channels), first, frozenset(here))

    @property
    def indices(self) -> list[int]:
        """Indices of the observations that are sources, in order."""
        return sorted({index for index in self.of if index is not None})

    def places(self, index: int) -> list[int]:
        """Indices of the channels whose source is the given observation."""
        return [index_of_channel for index_of_channel, source in enumerate(self.of) if source == index]


def _noise_sd(residual: Float[np.ndarray, "time channel"], has_outliers: bool) -> np.ndarray:
    """Standard deviation of the noise in a residual, (channel,).

    Errors of a wrong model are smooth, but noise is not. σ² is therefore estimated from second differences of the residual,
    whose variance is 6σ² (J. Rice 1984, doi 10.1214/aos/1176346788, with first differences).
    """
    if len(residual) < 3:
        return np.zeros(residual.shape[1])
    squares = np.diff(residual, 2, axis=0) ** 2
    if has_outliers:  # the median of the square of a normal value is 0.455 of its mean
        return np.asarray(np.sqrt(np.nanmedian(squares, axis=0) / scipy.stats.chi2.median(1) / 6.0))
    return np.asarray(np.sqrt(_mean_of_known(squares) / 6.0))


def _mean_of_known(values: np.ndarray) -> np.ndarray:
    """Mean over the known values of each channel; 0 if none is known."""
    known = np.isfinite(values)
    return np.asarray(np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def _largest(histories: np.ndarray) -> np.ndarray:
    """Largest absolute value over time, shape (draw, channel)."""
    return np.asarray(np.abs(histories).max(axis=1))
