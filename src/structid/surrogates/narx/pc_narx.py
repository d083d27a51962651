"""PC-NARX: a NARX whose coefficients are polynomial chaos expansions of the parameters.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from structid.campaign.runs import Runs
from structid.core.progress import Progress
from structid.core.validation import check_arguments
from structid.surrogates.chaos.pce import PCE
from structid.surrogates.narx.corrected_narx import CorrectedNARX
from structid.surrogates.narx.narx_fit import NARXFit
from structid.surrogates.narx.parametric_narx import ParametricNARX
from structid.surrogates.narx.settings import JOINT_KEYS, NARX_KEYS, NARXSettings
from structid.surrogates.surrogate_kind import SurrogateKind


@check_arguments
@dataclass(frozen=True)
class PCNARX(NARXSettings):
    """Settings of a PC-NARX: a NARX whose coefficients are polynomial chaos expansions (thesis eq. 2.55).

    Parameters
    ----------
    pce : PCE
        Expansion of the coefficients for ``training="per-experiment"``.
    terms, memories, training, selection, most_terms, degree, horizons, steps, held_out, washout, limit, outside, seed
        See `NARXSettings`.

    Examples
    --------
    >>> import structid as si
    >>> settings = si.PCNARX(terms=["y(t-1)", "y(t-2)", "x(t)", "x(t-1)"])
    >>> surrogate = settings.fit(runs)  # doctest: +SKIP
    """

    pce: PCE = field(default_factory=lambda: PCE(degree=tuple(range(1, 7)), hyperbolic_norm=1.0))

    @property
    def forms(self) -> tuple[CorrectedNARX, ...]:
        """Forms for a calibration, in which the surrogate must interpolate the runs; see `CorrectedNARX`."""
        return CorrectedNARX(self).forms

    def fit(self, runs: Runs, progress: Progress | None = None, weights: np.ndarray | None = None) -> ParametricNARX:
        """Fit a surrogate to runs on one or several records.

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
        return NARXFit(self, runs, progress, weights=weights).pc_narx(self.pce)


KIND = SurrogateKind(PCNARX, ParametricNARX, "pc_narx", NARX_KEYS, unused={("training", "per-experiment"): JOINT_KEYS})
