"""First passages over a design of runs: passage times, and observation times of the runs without a passage."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from structid.campaign.runs import Runs
from structid.core.errors import InputError, Status, check_choice
from structid.core.notebook import ShownAsText
from structid.core.validation import check_arguments
from structid.probability.designs import Design
from structid.reliability.first_passage import first_passage

PAIRS = 2000
"""Largest number of runs of which all pairs are compared."""


@check_arguments
@dataclass(frozen=True, eq=False)
class Passages(ShownAsText):
    """First passages of a limit over a design of runs.

    The passage time of a run without a passage is *longer* than its observation time, but otherwise unknown. Such a run is
    censored, and no number may replace its passage time.

    Parameters
    ----------
    design : Design
        Parameters of the runs.
    channel : str
        Channel whose absolute value is compared with the limit.
    limit : float
        Limit in the channel's SI unit.
    time : ndarray, shape (run,)
        Time of the first passage or of the structure's failure, whichever is earlier [s]; NaN for a run with neither.
    followed : ndarray, shape (run,)
        Observation time of each run [s]: until the end of the record or until the run failed; 0 for a run that did not start.

    Examples
    --------
    >>> import structid as si
    >>> passages = si.passages(runs, "displacement", limit=0.05)  # doctest: +SKIP
    >>> passages.time  # doctest: +SKIP
    """

    design: Design = field(repr=False)
    channel: str
    limit: float
    time: np.ndarray = field(repr=False)
    followed: np.ndarray = field(repr=False)

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: Any) -> Passages:
        """Select some of the runs."""
        return replace(
            self, design=self.design[np.arange(len(self))[rows]], time=self.time[rows], followed=self.followed[rows]
        )

    @property
    def passed(self) -> np.ndarray:
        """True for each run that passed the limit, shape (run,)."""
        return np.asarray(np.isfinite(self.time))

    @property
    def share(self) -> tuple[float, float]:
        """Fraction of the started runs that passed the limit, and its Monte Carlo standard error √(p (1 − p) / n)."""
        begun = self.passed | (self.followed > 0.0)
        p = float(self.passed[begun].mean())
        return p, float(np.sqrt(p * (1.0 - p) / begun.sum()))

    @property
    def censored(self) -> np.ndarray:
        """Passage time of each run, or its observation time if it has no passage [s], shape (run,)."""
        return np.where(self.passed, self.time, self.followed)

    def distribution(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Probability of a passage up to a given time, by the product-limit estimate, which allows for censored times.

        F(t) = 1 − Π_{tᵢ ≤ t} (1 − dᵢ/nᵢ), with dᵢ passages at tᵢ among nᵢ runs still observed (Kaplan & Meier 1958,
        doi 10.1080/01621459.1958.10501452).

        Parameters
        ----------
        times : ndarray, shape (time,)
            Times [s].

        Returns
        -------
        tuple of ndarray, shape (time,)
            Probability, and its standard error by Greenwood's formula.
        """
        sample = scipy.stats.CensoredData(uncensored=self.time[self.passed], right=self.followed[~self.passed])
        estimate = scipy.stats.ecdf(sample).cdf
        low = estimate.confidence_interval(0.6826894921370859).low
        with np.errstate(invalid="ignore"):
            error = np.nan_to_num(estimate.evaluate(times) - low.evaluate(times))
        return np.asarray(estimate.evaluate(times)), np.asarray(error)

    def concordance(self, values: np.ndarray) -> float:
        """Probability that, of two runs, the run with the larger value passes later (Harrell's C).

        A pair counts if the order of its passages is known: both runs passed, or one passed while the other was still observed.

        Parameters
        ----------
        values : ndarray, shape (run,)
            Values of a parameter or a coordinate.

        Returns
        -------
        float
            1 if larger values always pass later, 0 if always earlier, 0.5 if there is no relation; NaN if no pair counts.
        """
        rows = slice(None, None, -(-len(self) // PAIRS))
        time, passed, value = self.censored[rows], self.passed[rows], np.asarray(values)[rows]
        first = passed[:, None] & (time[:, None] < time[None, :])  # the row's run passed before the column's
        larger = (value[None, :] > value[:, None]) + 0.5 * (value[None, :] == value[:, None])
        return float(larger[first].mean()) if first.any() else float("nan")

    def __str__(self) -> str:
        p, error = self.share
        return f"Passages of {self.channel} over {self.limit:g}: {self.passed.sum()} of {len(self)} runs ({p:.1%} ± {error:.1%})"


@check_arguments
def passages(runs: Runs, channel: str, limit: float) -> Passages:
    """Find the first passages of runs; the failure of a structure counts as a passage.

    Parameters
    ----------
    runs : Runs
        Runs for one or several records.
    channel : str
        Name of the channel, such as ``"drift"``.
    limit : float
        Limit in the channel's SI unit.

    Returns
    -------
    Passages
        Passages; a run that failed for another reason is censored at its failure time.

    Raises
    ------
    InputError
        If the channel is not recorded, a run starts beyond the limit, or no run has started.

    Examples
    --------
    >>> import structid as si
    >>> passages = si.passages(runs, "displacement", limit=0.05)  # doctest: +SKIP
    """
    check_choice("passages(channel)", channel, runs.channels)
    time, followed = np.full(len(runs), np.nan), np.full(len(runs), np.nan)
    for number in range(len(runs.records)):
        rows = np.flatnonzero(runs.record_of_run == number)
        if len(rows):
            some = runs[rows].histories()
            time[rows] = first_passage(some, channel, limit)
            followed[rows] = np.where(some.done, some.time[-1], some.failure_time)
    fell = runs.status == Status.STRUCTURE_FAILED
    time = np.where(fell, np.fmin(time, runs.failure_time), time)
    followed = np.nan_to_num(followed)  # a run that did not start was observed for zero time
    if not (followed > 0.0).any():
        raise InputError("passages", "no run has started", "at least one run with a response")
    return Passages(runs.design, channel, float(limit), time, followed)
