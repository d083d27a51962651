"""Study of a prior range by a design of runs: first passages of limits, their probabilities, sensitivity of peaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool

from structid.campaign.runs import Runs
from structid.core.errors import InputError, check_choice
from structid.core.notebook import ShownAsText
from structid.core.validation import check_arguments
from structid.reliability.passage_probability import (
    LEAST,
    PassageProbability,
    coordinate_names,
    coordinates_of,
    passage_probability,
)
from structid.reliability.passages import Passages, passages
from structid.reliability.sensitivity import Sensitivity, sensitivity

SMALLEST = 40
"""Minimum number of finished runs for a sensitivity analysis."""


@dataclass(frozen=True, eq=False)
class ParameterStudy(ShownAsText):
    """Results of a study of a prior range by a design of runs.

    Parameters
    ----------
    runs : Runs
        Runs of the design.
    passages : tuple of Passages
        First passages of each limit.
    above : mapping of str to float
        Lower bounds [SI] of a part of the prior range that is also studied separately.
    inside : ndarray of bool, shape (run,)
        True for the runs in that part.
    probabilities : tuple of PassageProbability or None
        Passage probability for each limit; None if too few runs passed the limit, or too few did not.
    sensitivities : mapping of str to Sensitivity
        Sensitivity of the largest absolute value, by channel.
    """

    runs: Runs = field(repr=False)
    passages: tuple[Passages, ...]
    above: Mapping[str, float]
    inside: Bool[np.ndarray, " run"] = field(repr=False)
    probabilities: tuple[PassageProbability | None, ...] = field(repr=False)
    sensitivities: Mapping[str, Sensitivity] = field(repr=False)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Values of the parameters and coordinates in SI by name; every array has shape (run,)."""
        design = self.runs.design
        space = design.space
        columns = dict(zip(space.names, np.asarray(design.values).T, strict=True))
        if space.coordinates:
            columns |= dict(zip(space.coordinates, coordinates_of(space, design.values).T, strict=True))
        return columns

    def leading(self, number: int) -> list[str]:
        """Names of parameters and coordinates, ordered by how well they separate the runs that pass a limit; the best first.

        Parameters
        ----------
        number : int
            Number of the limit.

        Returns
        -------
        list of str
            Ordered by |AUC − ½|, where AUC is the area under the receiver operating characteristic curve: the probability
            that the value is larger in a run that passed the limit than in a run that did not.
        """
        from sklearn.metrics import roc_auc_score

        passed = self.passages[number].passed
        if passed.all() or not passed.any():
            return list(self.columns)
        areas = {name: roc_auc_score(passed, values) for name, values in self.columns.items()}
        return sorted(areas, key=lambda name: -abs(areas[name] - 0.5))

    def leading_pair(self, number: int) -> list[int]:
        """Columns of the two coordinates that best separate the runs that pass a limit from the other runs.

        Parameters
        ----------
        number : int
            Number of the limit.

        Returns
        -------
        list of int
            Two columns, or one if there is only one coordinate.
        """
        names = coordinate_names(self.runs.design.space)
        return [names.index(name) for name in self.leading(number) if name in names][:2]

    def __str__(self) -> str:
        lines = [str(p) for p in self.passages]
        lines += [str(p) for p in self.probabilities if p is not None]
        lines += [f"Peak of {channel}: {result}" for channel, result in self.sensitivities.items()]
        return "\n".join(lines)


@check_arguments
def parameter_study(
    runs: Runs,
    channel: str,
    limits: float | Sequence[float],
    above: Mapping[str, float] | None = None,
    peaks: Sequence[str] = (),
    seed: int = 0,
) -> ParameterStudy:
    """Study a prior range by a design of runs.

    Parameters
    ----------
    runs : Runs
        Runs over a design, such as the runs of a `Campaign`.
    channel : str
        Channel whose first passages are computed.
    limits : float or sequence of float
        Limits of the channel's absolute value [SI].
    above : mapping of str to float, optional
        Lower bounds [SI] of some parameters; they define a part of the prior range that is also studied separately.
    peaks : sequence of str
        Channels for whose peaks Sobol' indices are computed.
    seed : int
        Seed of the samples for the indices.

    Returns
    -------
    ParameterStudy
        Passages, their probabilities, and Sobol' indices.

    Raises
    ------
    InputError
        If a channel is not recorded, a run starts beyond a limit, or a parameter is unknown.

    Examples
    --------
    >>> import structid as si
    >>> study = si.parameter_study(runs, "displacement", limits=[0.02, 0.05])  # doctest: +SKIP
    >>> print(study)  # doctest: +SKIP
    """
    above = dict(above or {})
    limits = [limits] if isinstance(limits, (int, float)) else list(limits)
    space = runs.design.space
    for name in above:
        check_choice("parameter_study(above)", name, space.names)
    for name in peaks:
        check_choice("parameter_study(peaks)", name, runs.channels)
    if not limits:
        raise InputError("parameter_study(limits)", "no limit", "one or more limits")
    values = np.asarray(runs.design.values)
    inside = np.all([values[:, space.names.index(n)] > least for n, least in above.items()], axis=0)
    result = tuple(passages(runs, channel, limit) for limit in limits)
    probabilities = tuple(passage_probability(p) if _both_kinds(p) else None for p in result)
    sensitivities = {name: sensitivity(runs.design, _largest(runs, name), seed=seed) for name in peaks if _enough(runs)}
    return ParameterStudy(
        runs, result, above, np.broadcast_to(inside, len(runs)).astype(bool), probabilities, sensitivities
    )


def _both_kinds(passages: Passages) -> bool:
    return bool(min(passages.passed.sum(), (~passages.passed).sum()) >= LEAST)


def _enough(runs: Runs) -> bool:
    return bool(runs.done.sum() >= SMALLEST) and runs.design.space.correlation is None


def _largest(runs: Runs, channel: str) -> np.ndarray:
    """Largest absolute value of a channel in each run, read in batches; NaN for failed runs."""
    column = runs.channels.index(channel)
    result: list[Any] = []
    for some in runs.batches(1024):
        values = some.values[:, :, column]
        # Responses to shorter records are padded with NaN.
        peaks = np.nanmax(np.abs(np.where(some.done[:, None], values, 0.0)), axis=1)
        result.append(np.where(some.done, peaks, np.nan))
    return np.concatenate(result)
