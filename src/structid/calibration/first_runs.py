"""The first runs of a calibration: more of the same design while too many have failed to fit a surrogate to the others."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from structid.calibration.plan import FEWEST_IN_A_BATCH
from structid.calibration.true_runs import TrueRuns
from structid.errors import InputError, StructidWarning
from structid.inference.assessment.side_by_side import SideBySide
from structid.probability.designs import Design
from structid.surrogates.face import SurrogateSettings


def make_first_runs(
    true: TrueRuns, settings: SurrogateSettings, planned: Callable[[int], np.ndarray], left: Callable[[int], int]
) -> None:
    """Run the first design, and more of the same points while too many have failed to fit a surrogate to the others.

    Parameters
    ----------
    true : TrueRuns
        With the points of the first design.
    settings : SurrogateSettings
        Of the surrogate.
    planned : callable
        Gives so many points (point, parameter) of the design, of which each longer one begins with the shorter one.
    left : callable
        Gives how many runs the budget leaves after so many.

    Raises
    ------
    InputError
        If no response moves.
    CampaignStoppedError
        If no run of the first design finishes.
    """
    true.make()
    true.refuse_hopeless()
    while left(len(true)) >= FEWEST_IN_A_BATCH and not _fit_for_a_surrogate(true, settings):
        failed = int((~true.finished).sum())
        count = len(true) + min(failed, left(len(true)))
        true.make(planned(count)[len(true) :])
    true.refuse_rest()


def warn_of_mistakes(true: TrueRuns) -> None:
    """Warn of what all first runs show beside the measurements: a wrong unit, sign or clock.

    Parameters
    ----------
    true : TrueRuns
        With the first runs.
    """
    from_medians = np.abs(true.space.cdf(true.points) - 0.5).max(axis=1)
    places = np.flatnonzero(true.finished)
    for observation, responses in zip(true.observations, true.responses(), strict=True):
        asked: list[dict[tuple[str, str], str]] = []
        for place in places[np.argsort(from_medians[places])]:
            histories = dict(zip(true.model.channels, responses[place].T, strict=True))
            pairs = SideBySide.of(histories, true.model.channel_units, observation)
            asked.append({(pair.channel, kind): said for pair in pairs for kind, said in pair.questions.items()})
        for what, question in asked[0].items() if asked else ():
            if all(what in others for others in asked):
                nearest = f"All of the first {len(asked)} runs say so; these figures are of that nearest to the priors' medians."
                warnings.warn(f"{question} {nearest}", StructidWarning, stacklevel=5)


def _fit_for_a_surrogate(true: TrueRuns, settings: SurrogateSettings) -> bool:
    """Whether enough runs have finished."""
    design = Design(np.repeat(true.points[true.finished], len(true.records), axis=0), true.space)
    try:
        settings.check(design, true.records, true.model.channels)
    except InputError:
        return False
    return True
