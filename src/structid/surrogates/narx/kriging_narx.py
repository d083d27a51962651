"""Kriging-NARX: a NARX whose coefficients are Kriging predictors over the parameters.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from structid.campaign.runs import Runs
from structid.core.progress import Progress
from structid.core.validation import check_arguments
from structid.surrogates.kriging.kriging_keys import KRIGING_KEYS, kriging_settings
from structid.surrogates.kriging.universal_kriging import Kriging
from structid.surrogates.narx.corrected_narx import CorrectedNARX
from structid.surrogates.narx.narx_fit import NARXFit
from structid.surrogates.narx.parametric_narx import ParametricNARX
from structid.surrogates.narx.settings import JOINT_KEYS, NARX_KEYS, NARXSettings
from structid.surrogates.surrogate_kind import SurrogateKind


@check_arguments
@dataclass(frozen=True)
class KrigingNARX(NARXSettings):
    """Settings of a Kriging-NARX: a NARX whose coefficients are Kriging predictors (thesis eq. 2.72, with σ for its σ²).

    With ``training="joint"``, a refinement fits the coefficients of each run to its free run. Coefficients that the run
    does not determine are drawn towards the coefficients of the joint training. The differences are then interpolated.
    With plain least squares, collinear coefficients would vary so irregularly that no interpolation is possible.

    Parameters
    ----------
    kriging : Kriging
        Interpolation of the coefficients.
    refinements : int
        Number of steps of the refinement.
    terms, memories, training, selection, most_terms, degree, horizons, steps, held_out, washout, limit, outside, seed
        See `NARXSettings`.

    Examples
    --------
    >>> import structid as si
    >>> settings = si.KrigingNARX(terms=["y(t-1)", "y(t-2)", "x(t)", "x(t-1)"])
    >>> surrogate = settings.fit(runs)  # doctest: +SKIP
    """

    kriging: Kriging = field(default_factory=lambda: Kriging(nugget="estimate", separable=False))
    refinements: int = 2

    @property
    def forms(self) -> tuple[CorrectedNARX, ...]:
        """Forms for a calibration, in which the surrogate must interpolate the runs; see `CorrectedNARX`."""
        return CorrectedNARX(self).forms

    def fit(self, runs: Runs, progress: Progress | None = None, weights: np.ndarray | None = None) -> ParametricNARX:
        """Fit a surrogate to runs on one or several records; see `PCNARX.fit`.

        Parameters
        ----------
        runs : Runs
            Runs of the replaced model; failed runs are left out.
        progress : callable, optional
            Callback whose arguments are the finished percentage of the fit, and 100.
        weights : ndarray, shape (run,), optional
            Weights of the errors of the runs in the joint training; equal by default.

        Returns
        -------
        ParametricNARX
            A model for these parameters and any record.
        """
        return NARXFit(self, runs, progress, weights=weights).kriging_narx(self.kriging, self.refinements)


def from_keys(**given: Any) -> KrigingNARX:
    """Make settings from the keys of a study file, including the keys of Kriging."""
    kriging, others = kriging_settings(given)
    return KrigingNARX(kriging=replace(KrigingNARX().kriging, **kriging), **others)


KIND = SurrogateKind(
    KrigingNARX,
    ParametricNARX,
    "kriging_narx",
    {**NARX_KEYS, "refinements": Annotated[int, Field(ge=0)], **KRIGING_KEYS},
    from_keys,
    {("training", "per-experiment"): (*JOINT_KEYS, "refinements")},
)
