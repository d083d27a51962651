"""A NARX for any record, with a POD-Kriging for the records of its training runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from jaxtyping import Float

from structid.campaign.runs import Runs
from structid.core.errors import InputError
from structid.core.progress import Progress, Stages
from structid.core.renamed import renamed_argument
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.probability.designs import Design
from structid.surrogates.base import SurrogateSettings
from structid.surrogates.fit import OutsideRule, Stopwatch, fitting_runs, run_digests
from structid.surrogates.narx.narx_beside_kriging import NARXBesideKriging
from structid.surrogates.narx.parametric_narx import ParametricNARX
from structid.surrogates.narx.settings import NARXSettings
from structid.surrogates.pod.pod_kriging import PODKriging
from structid.surrogates.surrogate_kind import SurrogateKind

STAGES = {"narx": 10.0, "kriging": 2.0}
"""Stages of a fit, and their relative durations."""


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
        """Fit a surrogate to runs; see `SurrogateSettings.fit`."""


@renamed_argument(rest="kriging")
@check_arguments
@dataclass(frozen=True)
class CorrectedNARX:
    """Settings of a surrogate of two parts: a NARX for any record, and a POD-Kriging for the records of the training runs.

    A NARX with few terms accepts any record, but reproduces no training run exactly. On the records of the runs the response
    therefore comes from a `PODKriging`, which interpolates all runs. A calibration with a NARX uses this combination: the Kriging
    is certified, and the NARX predicts other records without additional model runs.

    Parameters
    ----------
    narx : PCNARX or KrigingNARX
        Settings of the NARX.
    kriging : PODKriging
        Settings of the Kriging.

    Examples
    --------
    >>> import structid as si
    >>> settings = si.CorrectedNARX(si.PCNARX(degree=1))
    >>> surrogate = settings.fit(runs)  # doctest: +SKIP
    """

    narx: TrainedNARX
    kriging: PODKriging = field(default_factory=PODKriging)

    warm_start: ClassVar[bool] = True
    weighted: ClassVar[bool] = True
    shares: ClassVar[bool] = True  # the forms share the NARX, which `fit` reuses for the same runs

    def __post_init__(self) -> None:
        if not (isinstance(self.narx, NARXSettings) and hasattr(type(self.narx), "forms")):
            raise InputError("CorrectedNARX(narx)", f"a {type(self.narx).__name__}", "a PCNARX or a KrigingNARX")

    @property
    def limit(self) -> float:
        """Largest mean relative error accepted in a posterior, equal to the limit of the NARX."""
        return self.narx.limit

    @property
    def outside(self) -> OutsideRule:
        """Treatment of points outside the range of the design, equal to the setting of the NARX."""
        return self.narx.outside

    @property
    def forms(self) -> tuple[CorrectedNARX, ...]:
        """Forms of the Kriging for a calibration; see `PODKriging.forms`."""
        return tuple(replace(self, kriging=form) for form in self.kriging.forms)

    @property
    def in_words(self) -> dict[str, Any]:
        """All settings, JSON-compatible."""
        return {"narx": {"kind": type(self.narx).__name__, **self.narx.in_words}, "kriging": self.kriging.in_words}

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against planned runs.

        Parameters
        ----------
        design : Design
            Points of the planned runs.
        records : sequence of Excitation
            Records of the planned runs, assigned in turn.
        channels : sequence of str
            Channels of the planned runs.

        Raises
        ------
        InputError
            If a NARX or a POD-Kriging cannot be fitted to the planned runs.
        """
        self.narx.check(design, records, channels)
        self.kriging.check(design, records, channels)

    def fit(
        self,
        runs: Runs,
        progress: Progress | None = None,
        start: NARXBesideKriging | None = None,
        weights: np.ndarray | None = None,
    ) -> NARXBesideKriging:
        """Fit a surrogate to runs on one or several records.

        Parameters
        ----------
        runs : Runs
            Runs of the replaced model; failed runs are left out.
        progress : callable, optional
            Callback whose arguments are the finished percentage of the fit, and 100.
        start : NARXBesideKriging, optional
            A surrogate fitted to some of these runs. The search for correlation lengths starts from those of `start`.
            If it was fitted to all of these runs, its NARX is reused.
        weights : ndarray, shape (run,), optional
            Weights of the errors of the runs in the fit of the NARX; equal by default.

        Returns
        -------
        NARXBesideKriging
            A model for any record, most accurate on the records of the runs.
        """
        watch, stages = Stopwatch(), Stages(progress, STAGES)
        done, left_out = fitting_runs("CorrectedNARX.fit", runs)
        digests = run_digests(done)
        if start is not None and start.fitted.seen == digests:
            narx = start.narx
        else:
            narx = self.narx.fit(runs, stages.of("narx"), weights=weights)
        stages.done("narx")
        kriging = self.kriging.fit(done, stages.of("kriging"), None if start is None else start.kriging)
        fit = replace(
            kriging.fitted,
            kind="CorrectedNARX",
            settings=self.in_words,
            left_out=left_out,
            limit=self.limit,
            outside=self.outside,
            seconds=watch.seconds,
        )
        return NARXBesideKriging(fit, narx, kriging)


KIND = SurrogateKind(CorrectedNARX, NARXBesideKriging)
