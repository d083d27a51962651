"""First runs of a calibration, extended until enough of them succeed for a surrogate, and what speaks against the model."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from structid.calibration.plan import FEWEST_IN_A_BATCH
from structid.certification.model_runs import NOISE, ModelRuns
from structid.core.errors import CampaignStoppedError, InputError, UnlikeMeasuredWarning
from structid.inference.validation.recorded_faults import questions_of_the_measurement
from structid.inference.validation.side_by_side import SideBySide
from structid.observation import Observation
from structid.probability.designs import Design
from structid.surrogates.base import SurrogateSettings


def make_first_runs(
    true: ModelRuns, settings: SurrogateSettings, planned: Callable[[int], np.ndarray], left: Callable[[int], int]
) -> None:
    """Run the first design, and extend it within the budget until enough runs succeed for a surrogate."""
    true.make()
    true.refuse_hopeless()
    while left(len(true)) >= FEWEST_IN_A_BATCH and not _fit_for_a_surrogate(true, settings):
        failed = int((~true.finished).sum())
        count = len(true) + min(failed, left(len(true)))
        true.make(planned(count)[len(true) :])
    true.refuse_rest()


def refuse_noise(true: ModelRuns) -> int:
    """Repeat the run that fits best, and refuse an external solver whose responses differ; return the number of repeated runs.

    With the residuals r and r′ of both runs, and the variance s² of r in place of that of the errors, which is not larger, the log
    density differs by |‖r‖² − ‖r′‖²|/2s² or more.
    """
    finished = np.flatnonzero(true.finished)
    if true.model.traceable or not len(finished):
        return 0
    residuals = [_residuals(response, o, true) for response, o in zip(true.responses(), true.observations, strict=True)]
    squares = sum(
        np.nansum(r**2, axis=(1, 2)) / np.nanvar(o.values) for r, o in zip(residuals, true.observations, strict=True)
    )
    best = int(finished[np.argmin(np.asarray(squares)[finished])])
    change, again = 0.0, true.once_more(best)
    for first, response, observation in zip(residuals, again, true.observations, strict=True):
        second = _residuals(response, observation, true)
        variance = np.nanmean(first[best] ** 2, axis=0)
        differences = np.nansum(second[0] ** 2 - first[best] ** 2, axis=0)
        change += float(np.sum(np.abs(differences) / np.where(variance > 0.0, variance, np.inf))) / 2.0
    if not change <= NOISE:
        raise CampaignStoppedError(
            f"The model is not deterministic: a repeated run changes its log density by {change:.2g} nats or more. It has no "
            "posterior then. Fix its random seed, or let it return the mean of several runs. If the solver has changed since the "
            "stored runs, begin in another folder."
        )
    return 1


def _residuals(response: np.ndarray, observation: Observation, true: ModelRuns) -> np.ndarray:
    """Measured values minus responses (run, time, channel), without the instrument's unknown parameters."""
    channels = [true.model.channels.index(channel) for channel in observation.channels]
    sampled = np.asarray(observation.instrument.sampled(response[:, :, channels].transpose(1, 2, 0)))
    return np.asarray(observation.values - sampled.transpose(2, 0, 1))


def warn_of_mistakes(true: ModelRuns) -> None:
    """Warn about faults in the measurements, and about a wrong unit, sign or time base that all first runs indicate."""
    finished = np.flatnonzero(true.finished)
    from_medians = np.abs(true.space.cdf(true.points[finished]) - 0.5).max(axis=1)
    for observation, responses in zip(true.observations, true.responses(), strict=True):
        in_turn = (
            _questions(true, response, observation) for response in responses[finished[np.argsort(from_medians)]]
        )
        questions = next(in_turn, {})
        for others in in_turn if questions else ():
            questions = {what: question for what, question in questions.items() if what in others}
        nearest = f"All of the first {len(finished)} runs show this; the values are from the run nearest to the priors' medians."
        for question in questions_of_the_measurement(observation, true.model.channel_units):
            warnings.warn(question, UnlikeMeasuredWarning, stacklevel=5)
        for question in questions.values():
            warnings.warn(f"{question} {nearest}", UnlikeMeasuredWarning, stacklevel=5)


def _questions(true: ModelRuns, response: np.ndarray, observation: Observation) -> dict[tuple[str, str], str]:
    """Problems of a response (time, channel), by channel and kind."""
    histories = dict(zip(true.model.channels, response.T, strict=True))
    pairs = SideBySide.of(histories, true.model.channel_units, observation)
    return {(pair.channel, kind): question for pair in pairs for kind, question in pair.questions.items()}


def _fit_for_a_surrogate(true: ModelRuns, settings: SurrogateSettings) -> bool:
    """Whether enough runs have completed."""
    design = Design(np.repeat(true.points[true.finished], len(true.records), axis=0), true.space)
    try:
        settings.check(design, true.records, true.model.channels)
    except InputError:
        return False
    return True
