"""First runs of a calibration, extended until enough of them succeed for a surrogate."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from structid.calibration.plan import FEWEST_IN_A_BATCH
from structid.certification.model_runs import ModelRuns
from structid.core.errors import InputError, UnlikeMeasuredWarning
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
