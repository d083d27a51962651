"""Prior and posterior prediction, with and without discrepancy, on the measured record or another one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from structid.channels import ChannelUnit
from structid.ground_motion.excitation import Excitation
from structid.inference.likelihood.posterior import Posterior
from structid.models.face import Progress
from structid.streams import Purpose, stream


@dataclass(frozen=True)
class Prediction:
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
    """

    time: np.ndarray
    channels: tuple[str, ...]
    response: np.ndarray = field(repr=False)
    observable: np.ndarray = field(repr=False)
    failed: int
    excitation: str
    units: Mapping[str, ChannelUnit] = field(default_factory=dict)

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
        """Largest absolute response of every draw in SI, shape (draw, channel)."""
        return np.asarray(np.abs(self.response).max(axis=1))


def predict(
    posterior: Posterior,
    theta: np.ndarray,
    record: Excitation | None = None,
    channels: tuple[str, ...] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
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
        those of its observation. On another record, the discrepancy of the first observation is used, but not its instrument;
        parameters that drift do so in another way, as far as they did on the measured record.
    channels : tuple of str, optional
        What to predict; what was measured when left out. Channels that were not measured have no discrepancy.
    seed : int
        Seed of the discrepancy.
    progress : callable, optional
        Called with the number of finished runs and the total.

    Returns
    -------
    Prediction
        Draws whose simulation succeeded.
    """
    observations = posterior.observations
    record = observations[0].record if record is None else record
    hidden = stream(seed, Purpose.HIDDEN_ON_ANOTHER_RECORD)
    model, parameters, index = posterior.likelihood.on_record(theta, record, hidden)
    observation = observations[index or 0]
    channels = observation.channels if channels is None else tuple(channels)
    every = tuple(dict.fromkeys((*observation.channels, *channels)))
    if set(every) - set(model.channels):
        model = model.recording(*every)
    run = model.simulate(parameters, record, progress=progress, map=posterior.map)
    good = run.done
    response = run.values[good][:, :, [run.channels.index(c) for c in every]]
    unknown = posterior.unknowns(theta[good], index or 0)
    measured = slice(0, len(observation.channels))
    if index is not None and len(response):
        shown = observation.transmit(response[:, :, measured].transpose(1, 2, 0), unknown)
        response = np.concatenate([np.asarray(shown).transpose(2, 0, 1), response[:, :, measured.stop :]], axis=2)
    purpose = Purpose.PREDICTION_ON_ANOTHER_RECORD if index is None else Purpose.PREDICTION_ON_THE_RECORD
    rng = stream(seed, purpose, index or 0)
    observable = response.copy()
    noise_shape = (len(response), response.shape[1], measured.stop)
    observable[:, :, measured] += posterior.discrepancy.draw(rng, noise_shape, unknown, observation.channels, record.dt)
    wanted = [every.index(c) for c in channels]
    units = run.units | {c: observation.channel_unit(c) for c in observation.channels if c in observation.units}
    return Prediction(
        run.time,
        channels,
        response[:, :, wanted],
        observable[:, :, wanted],
        int((~good).sum()),
        record.name,
        {c: units[c] for c in channels},
    )


def unexplained_fraction(posterior: Posterior, theta: np.ndarray) -> float:
    """Fraction of the measurements' variance that a prediction leaves unexplained, Σ(y − M)² / Σ(y − ȳ)².

    Parameters
    ----------
    posterior : Posterior
        Model and measurements.
    theta : ndarray, shape (parameter,)
        Parameters in SI.

    Returns
    -------
    float
        The largest over measurements and channels; 0 is perfect.
    """
    worst = 0.0
    for index, observation in enumerate(posterior.observations):
        residual = observation.values - posterior.predict(theta[None, :], index)[0]
        about_mean = ((observation.values - observation.values.mean(axis=0)) ** 2).sum(axis=0)
        fraction = float(((residual**2).sum(axis=0) / about_mean).max())
        worst = max(worst, fraction if np.isfinite(fraction) else np.inf)
    return worst
