"""Study of a model's box of parameters: who passes which limits and when, with what probability, and what peaks depend on."""

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
"""Minimum number of runs for a sensitivity."""


@dataclass(frozen=True, eq=False)
class ParameterStudy(ShownAsText):
    """What a design of runs tells of a box of parameters.

    Parameters
    ----------
    runs : Runs
        The runs.
    passages : tuple of Passages
        One for every limit.
    above : mapping of str to float
        Lower bounds [SI] of a part of the box that is looked at by itself.
    inside : ndarray of bool, shape (run,)
        Which runs are in that part.
    probabilities : tuple of PassageProbability or None
        One for every limit; None where too few passed, or too few did not.
    sensitivities : mapping of str to Sensitivity
        Of the largest absolute value of a channel.
    """

    runs: Runs = field(repr=False)
    passages: tuple[Passages, ...]
    above: Mapping[str, float]
    inside: Bool[np.ndarray, " run"] = field(repr=False)
    probabilities: tuple[PassageProbability | None, ...] = field(repr=False)
    sensitivities: Mapping[str, Sensitivity] = field(repr=False)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Values of parameters and coordinates in SI by name, each of shape (run,)."""
        design = self.runs.design
        space = design.space
        columns = dict(zip(space.names, np.asarray(design.values).T, strict=True))
        if space.coordinates:
            columns |= dict(zip(space.coordinates, coordinates_of(space, design.values).T, strict=True))
        return columns

    def leading(self, number: int) -> list[str]:
        """Names of parameters and coordinates, from the one that separates the runs best that pass a limit from the others.

        Parameters
        ----------
        number : int
            Of the limit.

        Returns
        -------
        list of str
            By the distance from one half of the area under the receiver's operating curve: the probability that of a run
            that passed and one that did not the latter has the larger value.
        """
        from sklearn.metrics import roc_auc_score

        passed = self.passages[number].passed
        if passed.all() or not passed.any():
            return list(self.columns)
        areas = {name: roc_auc_score(passed, values) for name, values in self.columns.items()}
        return sorted(areas, key=lambda name: -abs(areas[name] - 0.5))

    def leading_pair(self, number: int) -> list[int]:
        """Columns of the two coordinates that separate the runs that pass a limit best.

        Parameters
        ----------
        number : int
            Of the limit.

        Returns
        -------
        list of int
            Two, or one where there is only one.
        """
        names = coordinate_names(self.runs.design.space)
        return [names.index(name) for name in self.leading(number) if name in names][:2]

    def __str__(self) -> str:
        lines = [str(p) for p in self.passages]
        lines += [str(p) for p in self.probabilities if p is not None]
        lines += [f"{channel}, largest: {result}" for channel, result in self.sensitivities.items()]
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
    """Study a box of parameters by a design of runs.

    Parameters
    ----------
    runs : Runs
        Over a design, such as a `Campaign`'s.
    channel : str
        Whose first passages are looked for.
    limits : float or sequence of float
        Of its absolute value [SI].
    above : mapping of str to float, optional
        Lower bounds [SI] of some parameters, for a part of the box that is looked at by itself.
    peaks : sequence of str
        Channels of whose largest absolute value Sobol' indices are wanted.
    seed : int
        Of their samples.

    Returns
    -------
    ParameterStudy
        Passages, their probabilities, and indices.

    Raises
    ------
    InputError
        If a channel is not recorded, a limit is passed from the beginning, or a parameter is unknown.

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
        raise InputError("parameter_study(limits)", "no limit", "one or more")
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
    """Largest absolute value of a channel, NaN for failed runs, batch by batch."""
    column = runs.channels.index(channel)
    result: list[Any] = []
    for some in runs.batches(1024):
        values = some.values[:, :, column]
        # Shorter records are followed by NaN.
        peaks = np.nanmax(np.abs(np.where(some.done[:, None], values, 0.0)), axis=1)
        result.append(np.where(some.done, peaks, np.nan))
    return np.concatenate(result)
