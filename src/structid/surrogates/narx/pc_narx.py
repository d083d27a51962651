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
        For ``training="per-experiment"``: how the coefficients are expanded.
    terms, memories, training, selection, most_terms, degree, horizons, steps, held_out, washout, limit, outside, seed
        As for `NARXSettings`.

    Examples
    --------
    >>> import structid as si
    >>> settings = si.PCNARX(terms=["y(t-1)", "y(t-2)", "x(t)", "x(t-1)"])
    >>> surrogate = settings.fit(runs)  # doctest: +SKIP
    """

    pce: PCE = field(default_factory=lambda: PCE(degree=tuple(range(1, 7)), hyperbolic_norm=1.0))

    @property
    def forms(self) -> tuple[CorrectedNARX, ...]:
        """Forms for a calibration, where a surrogate must interpolate the runs: with an interpolation of its residuals."""
        return CorrectedNARX(self).forms

    def fit(self, runs: Runs, progress: Progress | None = None, weights: np.ndarray | None = None) -> ParametricNARX:
        """Fit to runs on one record or several.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for; failed ones are left out.
        progress : callable, optional
            Called with the percentage of the fit that is done, and 100.
        weights : ndarray, shape (run,), optional
            How much the error of each run counts in the joint training; the same for all when left out.

        Returns
        -------
        ParametricNARX
            A model for these parameters and any record.
        """
        return NARXFit(self, runs, progress, weights=weights).pc_narx(self.pce)


KIND = SurrogateKind(PCNARX, ParametricNARX, "pc_narx", NARX_KEYS, unused={("training", "per-experiment"): JOINT_KEYS})
