"""A NARX for any record, with a POD-Kriging of its residuals on the records of the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from jaxtyping import Float

from structid.campaign.runs import InMemory, Runs
from structid.core.errors import InputError
from structid.core.progress import Progress, Stages
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.probability.designs import Design
from structid.surrogates.base import SurrogateSettings
from structid.surrogates.fit import Fit, OutsideRule, Stopwatch, fitted_range, fitting_runs, run_digests
from structid.surrogates.narx.narx_with_rest import NARXWithRest
from structid.surrogates.narx.parametric_narx import ParametricNARX
from structid.surrogates.narx.settings import NARXSettings
from structid.surrogates.pod.pod_kriging import PODKriging
from structid.surrogates.surrogate_kind import SurrogateKind

STAGES = {"narx": 10.0, "rest": 2.0}
"""Stages of a fit, and their fraction of its time."""

LARGEST_ENERGY = 0.5
"""Largest fraction of the residuals' variance that their components may omit."""


class TrainedNARX(SurrogateSettings, Protocol):
    """Settings of a NARX that accepts any record."""

    @property
    def outside(self) -> OutsideRule:
        """Treatment of points outside the range of the design."""

    @property
    def in_words(self) -> dict[str, Any]:
        """All settings, JSON-compatible."""

    def fit(
        self, runs: Runs, progress: Progress | None = None, weights: Float[np.ndarray, " run"] | None = None
    ) -> ParametricNARX:
        """Fit to runs; see `SurrogateSettings.fit`."""


@check_arguments
@dataclass(frozen=True)
class CorrectedNARX:
    """Settings: a NARX n, and a POD-Kriging r of what it leaves over on the records of the runs, y(t, θ) ≈ n(t, θ) + r(t, θ).

    A NARX of few terms takes any record, and reproduces none of its runs exactly. A `PODKriging` of what it leaves over on a
    record passes through all runs, so that on these records the sum becomes as exact as the runs make it. To any other record the
    NARX responds alone.

    A recursion whose terms have kinks is not quite smooth as a function of its parameters (for an oscillator of Bouc–Wen to about
    1e-5 of the response). With many runs in a small region that is what limits the sum. The response itself is smoother there.

    Parameters
    ----------
    narx : PCNARX or KrigingNARX
        Settings of the NARX.
    rest : PODKriging
        Settings of what it leaves over. The share of the variance that the components leave out is one of the response's.
    whole : bool
        Whether the POD-Kriging is of the whole response on the records of the runs, y(t, θ) ≈ r(t, θ), and the NARX is for other
        records only.

    Examples
    --------
    >>> import structid as si
    >>> settings = si.CorrectedNARX(si.PCNARX(degree=1))
    >>> surrogate = settings.fit(runs)  # doctest: +SKIP
    """

    narx: TrainedNARX
    rest: PODKriging = field(default_factory=PODKriging)
    whole: bool = False

    warm_start: ClassVar[bool] = True
    weighted: ClassVar[bool] = True
    shares: ClassVar[bool] = True  # forms have the NARX in common, which `fit` takes over from one of the same runs

    def __post_init__(self) -> None:
        if not (isinstance(self.narx, NARXSettings) and hasattr(type(self.narx), "forms")):
            raise InputError("CorrectedNARX(narx)", f"a {type(self.narx).__name__}", "a PCNARX or a KrigingNARX")

    @property
    def limit(self) -> float:
        """Largest mean relative error accepted in a posterior: that of the NARX."""
        return self.narx.limit

    @property
    def outside(self) -> OutsideRule:
        """Treatment of points outside the range of the design: as for the NARX."""
        return self.narx.outside

    @property
    def forms(self) -> tuple[CorrectedNARX, ...]:
        """Forms of the Kriging, of the residuals or of the whole response, for a calibration; see `PODKriging.forms`."""
        return tuple(replace(self, rest=form, whole=whole) for whole in (False, True) for form in self.rest.forms)

    @property
    def in_words(self) -> dict[str, Any]:
        """All settings, JSON-compatible."""
        return {
            "narx": {"kind": type(self.narx).__name__, **self.narx.in_words},
            "rest": self.rest.in_words,
            "whole": self.whole,
        }

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against runs that are yet to be made.

        Parameters
        ----------
        design : Design
            Their points.
        records : sequence of Excitation
            What will drive them, dealt out in turn.
        channels : sequence of str
            What they will return.

        Raises
        ------
        InputError
            If no NARX can be fitted to them, or no POD-Kriging of what it leaves over.
        """
        self.narx.check(design, records, channels)
        self.rest.check(design, records, channels)

    def fit(
        self,
        runs: Runs,
        progress: Progress | None = None,
        start: NARXWithRest | None = None,
        weights: np.ndarray | None = None,
    ) -> NARXWithRest:
        """Fit to runs on one record or several.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for; failed ones are left out.
        progress : callable, optional
            Called with the percentage of the fit that is done, and 100.
        start : NARXWithRest, optional
            A surrogate fitted to some of these runs. The search for correlation lengths starts from its own. If it was fitted to
            all of them, its NARX is this one's as well.
        weights : ndarray, shape (run,), optional
            How much the error of each run counts for the NARX; the same for all when left out.

        Returns
        -------
        NARXWithRest
            A model for any record, which is at its best on those of the runs.
        """
        watch, stages = Stopwatch(), Stages(progress, STAGES)
        done, left_out = fitting_runs("CorrectedNARX.fit", runs)
        digests = run_digests(done)
        if start is not None and start.fitted.seen == digests:
            narx = start.narx
        else:
            narx = self.narx.fit(runs, stages.of("narx"), weights=weights)
        stages.done("narx")
        left_over, share = (done, 1.0) if self.whole else _left_over(narx, done)
        energy = min(self.rest.energy / share, LARGEST_ENERGY)
        start_of_rest = start.rest if start is not None and start.whole == self.whole else None
        rest = replace(self.rest, left_out_energy=energy).fit(left_over, stages.of("rest"), start_of_rest)
        fit = Fit(
            "CorrectedNARX",
            self.in_words,
            done.design.space,
            done.channels,
            rest.fitted.excitation,
            rest.fitted.dt,
            *fitted_range(done.design),
            len(left_over),
            left_out + len(done) - len(left_over),
            rest.fitted.error * share,
            self.limit,
            self.outside,
            watch.seconds,
            digests,
            self.rest.reach or 0.0,
        )
        return NARXWithRest(fit, narx, rest, self.whole)


def _left_over(narx: ParametricNARX, runs: Runs) -> tuple[Runs, float]:
    """Residuals of a NARX in runs that it completes, and their mean square relative to the runs' own variance."""
    values, through = np.full(runs.stored.shape, np.nan), np.zeros(len(runs), dtype=bool)
    squares, variance = np.zeros((2, len(runs.channels)))
    for number in np.unique(runs.record_of_run):
        of_record, record = np.flatnonzero(runs.record_of_run == number), runs.records[number]
        true = runs.on(int(number)).values[:, : len(record)]
        left = true - narx.run(runs.design.values[of_record], record).values
        kept = np.isfinite(left).all(axis=(1, 2))
        values[of_record, : len(record)], through[of_record] = left, kept
        squares += (left[kept] ** 2).sum(axis=(0, 1))
        variance += ((true - true.mean(axis=1, keepdims=True))[kept] ** 2).sum(axis=(0, 1))
    return replace(runs, stored=InMemory(values))[through], float(np.mean(squares / variance))


KIND = SurrogateKind(CorrectedNARX, NARXWithRest)
