"""Prior and posterior prediction, with and without discrepancy, on the measured record or another one."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from structid.channels import ChannelUnit
from structid.errors import InputError
from structid.ground_motion.excitation import Excitation
from structid.inference.assessment.band_scale import BandScale
from structid.inference.assessment.error_growth import ErrorGrowth, error_growth
from structid.inference.assessment.parameter_drift import ParameterDrift
from structid.inference.likelihood.discrepancy import Discrepancy
from structid.inference.likelihood.posterior import Posterior
from structid.models.face import Model, Progress
from structid.notebook import ShownAsText
from structid.streams import Purpose, stream
from structid.units import factor

PEAK_SHARE = (0.5, 0.5)
"""Mean and sd of the power of the measured peak's ratio that corrects the peaks of another record."""


@dataclass(frozen=True)
class Prediction(ShownAsText):
    """Draws of a predicted response.

    Parameters
    ----------
    time : ndarray, shape (time,)
        [s].
    channels : tuple of str
        What is predicted.
    response : ndarray, shape (draw, time, channel)
        The model's response in SI, without discrepancy.
    observable : ndarray, shape (draw, time, channel)
        With discrepancy: what an instrument would record. Equal to `response` for channels that were not measured, whose
        discrepancy is unknown.
    failed : int
        Draws whose simulation failed; they are left out.
    excitation : str
        Name of the record.
    units : mapping of str to ChannelUnit
        Units of the channels.
    structural : ndarray, shape (draw, time, channel), optional
        With the model's own error, without the instrument's: what the structure does. The response where nothing else is given.
    peak_ratio : ndarray, shape (channel,), optional
        For another record, the measured record's peak over the one predicted of it in the same way, with the instrument's noise.
        Ones where nothing is given.
    peak_share : ndarray, shape (draw,), optional
        The power of `peak_ratio` that corrects the peaks of each draw.
    status : ndarray of int, shape (all draws,), optional
        How the simulation of each draw ended, those included that are left out.
    """

    time: np.ndarray
    channels: tuple[str, ...]
    response: np.ndarray = field(repr=False)
    observable: np.ndarray = field(repr=False)
    failed: int
    excitation: str
    units: Mapping[str, ChannelUnit] = field(default_factory=dict)
    structural: np.ndarray | None = field(default=None, repr=False)
    peak_ratio: np.ndarray | None = None
    peak_share: np.ndarray | None = None
    status: np.ndarray | None = field(default=None, repr=False)

    def __str__(self) -> str:
        runs, samples, _ = self.response.shape
        failed = f", {self.failed} failed" if self.failed else ""
        lines = [f"{runs} draws{failed} of the response to {self.excitation or 'a record'}, {samples} samples"]
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
            Its probability.
        discrepancy : bool
            Of the observable instead of the model's response.

        Returns
        -------
        tuple of ndarray, shape (time, channel)
            Lower and upper edge in SI.
        """
        tail = 0.5 * (1.0 - probability)
        low, high = np.quantile(self.observable if discrepancy else self.response, [tail, 1.0 - tail], axis=0)
        return low, high

    @property
    def peaks(self) -> np.ndarray:
        """Largest absolute value of what the structure does in every draw, in SI, shape (draw, channel).

        Of another record, each draw u is corrected by r^s_u, where r is `peak_ratio` and s_u the draw's `peak_share`: the half of
        r, give or take a half. A model that is wrong about one peak is often wrong about the next in the same direction, and
        one record does not tell how often.
        """
        largest = _largest(self.response if self.structural is None else self.structural)
        if self.peak_ratio is None or self.peak_share is None:
            return largest
        return np.asarray(largest * self.peak_ratio ** self.peak_share[:, None])


def first_that_takes(record: Excitation | None, *posteriors: Posterior) -> Posterior:
    """Choose the posterior by which to predict a record: a surrogate may know only the records that it was fitted to.

    Parameters
    ----------
    record : Excitation or None
        The record; None for the measured one.
    *posteriors : Posterior
        In the order in which they are preferred; the last takes any record.

    Returns
    -------
    Posterior
        The first whose model takes it.
    """
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
    theta: np.ndarray,
    record: Excitation | None = None,
    channels: tuple[str, ...] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    drift: ParameterDrift | None = None,
    scaled: bool = True,
) -> Prediction:
    """Predict the response of draws of the parameters.

    Parameters
    ----------
    posterior : Posterior
        Model, measurements and discrepancy.
    theta : ndarray, shape (draw, parameter)
        Draws in SI.
    record : Excitation, optional
        The record; the first measured one when left out. On a measured record the discrepancy, gain, offset and time shift are
        those of its observation. On another record, the discrepancy of the first observation is used, but not its instrument.
        The discrepancy grows with the motion as far as the measured residuals do (`error_growth`). On another record parameters
        drift in another way, as far as they did on the measured one. All of it is scaled so that the measured record, predicted
        like this, is inside its 90 % band as often as the band says, in its strong and in its quiet part (`BandScale`).
    channels : tuple of str, optional
        What to predict; what was measured when left out. Channels that were not measured have no discrepancy.
    seed : int
        Seed of the discrepancy.
    progress : callable, optional
        Called with the number of finished runs and the total.
    drift : ParameterDrift, optional
        How far the parameters of another record may be from those of the measured ones; see `parameter_drift`. Where the law
        itself lets them drift, its draws say so.
    scaled : bool
        Whether the errors are scaled by what their band holds of the measured record; without, they are those of the law.

    Returns
    -------
    Prediction
        Draws whose simulation succeeded.
    """
    return Predictor(posterior, theta, seed, drift, scaled).on(record, channels, progress)


@dataclass(frozen=True, eq=False)
class Predictor:
    """Predicts the response of the same draws to one record after another; see `predict`.

    Parameters
    ----------
    posterior : Posterior
        Model, measurements and discrepancy.
    theta : ndarray, shape (draw, parameter)
        Draws in SI.
    seed : int
        Seed of the discrepancy.
    drift : ParameterDrift, optional
        How far the parameters of another record may be from those of the measured ones.
    scaled : bool
        Whether the errors are scaled by what their band holds of the measured record.
    """

    posterior: Posterior
    theta: np.ndarray = field(repr=False)
    seed: int = 0
    drift: ParameterDrift | None = None
    scaled: bool = True

    def on(
        self,
        record: Excitation | None = None,
        channels: tuple[str, ...] | None = None,
        progress: Progress | None = None,
        stand_in: Model | None = None,
    ) -> Prediction:
        """Predict the response to a record.

        Parameters
        ----------
        record : Excitation, optional
            The record; the first measured one when left out.
        channels : tuple of str, optional
            What to predict; what was measured when left out.
        progress : callable, optional
            Called with the number of finished runs and the total.
        stand_in : Model, optional
            A surrogate that knows that record, in the model's place. The errors that are added are the model's.

        Returns
        -------
        Prediction
            Draws whose simulation succeeded.
        """
        posterior = self.posterior
        record = posterior.observations[0].record if record is None else record
        prediction = self._responding(record, channels, progress, stand_in=stand_in)
        measured = next((o for o in posterior.observations if o.record is record), None)
        if not self.scaled or not len(prediction.response):
            return prediction
        if measured is not None:
            known = tuple(c for c in measured.channels if c in prediction.channels)
            here, there = ([own.index(c) for c in known] for own in (prediction.channels, measured.channels))
            scale = BandScale.of(measured.values[:, there], prediction.observable[:, :, here], record.dt)
            whole = _scaled(prediction, scale, known, record.dt)
            return replace(whole, response=prediction.response)  # its parameters have not been moved
        # The measured record once more costs an expensive model as many runs again.
        if posterior.costs_runs:
            return prediction
        observation = posterior.observations[0]
        scale, ratio = self._of_the_measured_record
        ratios = dict(zip(observation.channels, ratio, strict=True))
        own = np.array([ratios.get(channel, 1.0) for channel in prediction.channels])
        share = stream(self.seed, Purpose.PEAK_OF_ANOTHER_RECORD).normal(*PEAK_SHARE, size=len(prediction.response))
        whole = _scaled(prediction, scale, observation.channels, record.dt)
        return replace(whole, peak_ratio=own, peak_share=share)

    @cached_property
    def _of_the_measured_record(self) -> tuple[BandScale, np.ndarray]:
        """What a prediction of the first measured record, made as for another one, would have held of it; the ratio of peaks."""
        observation = self.posterior.observations[0]
        another = copy.copy(observation.record)  # records are told apart by identity
        prediction = self._responding(another, None, None, instrument=True)
        scale = BandScale.of(observation.values, prediction.observable, another.dt)
        scaled = _scaled(prediction, scale, observation.channels, another.dt)
        return scale, _peak_ratio(observation.values, scaled, stream(self.seed, Purpose.NOISE_OF_THE_PEAK))

    @cached_property
    def _growth_of_errors(self) -> dict[int, ErrorGrowth]:
        return {}

    def _growth(self, index: int) -> ErrorGrowth:
        """How the errors of an observation grow with the motion, which costs one run, once."""
        if index not in self._growth_of_errors:
            self._growth_of_errors[index] = error_growth(self.posterior, self.theta.mean(axis=0), index)
        return self._growth_of_errors[index]

    def _responding(
        self,
        record: Excitation,
        channels: tuple[str, ...] | None,
        progress: Progress | None,
        instrument: bool = False,
        stand_in: Model | None = None,
    ) -> Prediction:
        """Draws of the response; of another record with the first observation's instrument only if asked for."""
        posterior, theta, seed, drift = self.posterior, self.theta, self.seed, self.drift
        observations, hidden = posterior.observations, stream(seed, Purpose.HIDDEN_ON_ANOTHER_RECORD)
        if drift is not None and not posterior.law.inside and all(o.record is not record for o in observations):
            theta = drift.moved(theta, hidden)
        model, parameters, index = posterior.likelihood.on_record(theta, record, hidden)
        observation = observations[index or 0]
        channels = observation.channels if channels is None else tuple(channels)
        every = tuple(dict.fromkeys((*observation.channels, *channels)))
        if stand_in is not None:
            space = posterior.model_space
            model, parameters = stand_in, np.asarray(space.columns(theta[:, : space.dimension], stand_in.free))
        elif set(every) - set(model.channels):
            model = model.recording(*every)
        run = model.simulate(parameters, record, progress=progress, map=posterior.map)
        good = run.done
        response = run.values[good][:, :, [run.channels.index(c) for c in every]]
        unknown = posterior.unknowns(theta[good], index or 0)
        measured = slice(0, len(observation.channels))
        if (index is not None or instrument) and len(response):
            shown = observation.transmit(response[:, :, measured].transpose(1, 2, 0), unknown)
            response = np.concatenate([np.asarray(shown).transpose(2, 0, 1), response[:, :, measured.stop :]], axis=2)
        scale = self._growth(index or 0).scale(response[:, :, measured], record.dt)
        if observation.sd is not None:
            # Known for the measured record; of another one it is the mean square that carries over.
            sd = np.asarray(observation.sd)
            scale = sd if index is not None else scale * np.sqrt(np.mean(sd**2, axis=0))

        def erring(law: Discrepancy | None, purpose: Purpose) -> np.ndarray:
            found = response.copy()
            if law is not None:
                shape = (len(response), response.shape[1], measured.stop)
                rng = stream(seed, purpose, index or 0)
                found[:, :, measured] += scale * law.draw(rng, shape, unknown, observation.channels, record.dt)
            return np.asarray(found[:, :, [every.index(c) for c in channels]])

        law = posterior.discrepancy
        purpose = Purpose.PREDICTION_ON_ANOTHER_RECORD if index is None else Purpose.PREDICTION_ON_THE_RECORD
        units = run.units | {c: observation.channel_unit(c) for c in observation.channels if c in observation.units}
        return Prediction(
            run.time,
            channels,
            erring(None, purpose),
            erring(law, purpose),
            int((~good).sum()),
            record.name,
            {c: units[c] for c in channels},
            erring(law.of_the_model, Purpose.PREDICTED_MODEL_ERROR),
            status=run.status,
        )


def _peak_ratio(measured: np.ndarray, prediction: Prediction, rng: np.random.Generator) -> np.ndarray:
    """Measured peak over the predicted one with the instrument's noise, which makes a peak larger, shape (channel,).

    The errors of a wrong model are smooth, noise is not: σ² is estimated from second differences of the residual, whose variance
    is 6σ² (J. Rice 1984, doi 10.1214/aos/1176346788, who takes first ones).
    """
    structural = prediction.response if prediction.structural is None else prediction.structural
    residual = measured - np.median(prediction.response, axis=0)
    sd = np.sqrt(np.mean(np.diff(residual, 2, axis=0) ** 2, axis=0) / 6.0) if len(residual) > 2 else 0.0
    predicted = np.median(_largest(structural + sd * rng.normal(size=structural.shape)), axis=0)
    largest = _largest(measured[None])[0]
    moves = (largest > 0.0) & (predicted > 0.0)
    return np.where(moves, largest / np.where(moves, predicted, 1.0), 1.0)


def _largest(histories: np.ndarray) -> np.ndarray:
    """Largest absolute value over time, shape (draw, channel)."""
    return np.asarray(np.abs(histories).max(axis=1))


def _scaled(prediction: Prediction, scale: BandScale, known: tuple[str, ...], dt: float) -> Prediction:
    """A prediction with errors as large as they were on the measured record, in the channels that were measured there."""
    here = [place for place, channel in enumerate(prediction.channels) if channel in known]
    if not here:
        return prediction
    own = BandScale(scale.factors[:, [known.index(prediction.channels[place]) for place in here]])

    def applied(draws: np.ndarray, scale: BandScale = own) -> np.ndarray:
        found = draws.copy()
        found[:, :, here] = scale.applied(draws[:, :, here], dt)
        return found

    # What the parameters leave open is a part of the whole: narrowed with it, but not widened. A peak is an extreme of the whole
    # record, of which a band that holds nine tenths of the samples says little: what peaks are taken from is not narrowed.
    narrowed, widened = BandScale(np.minimum(own.factors, 1.0)), BandScale(np.maximum(own.factors, 1.0))
    structural = prediction.response if prediction.structural is None else prediction.structural
    return replace(
        prediction,
        response=applied(prediction.response, narrowed),
        observable=applied(prediction.observable),
        structural=applied(structural, widened),
    )
