"""POD-Kriging: principal components of the histories, with a Kriging of each score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from structid.campaign.runs import Runs
from structid.core.errors import InputError
from structid.core.progress import Progress
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.probability.designs import Design
from structid.surrogates.fit import OutsideRule
from structid.surrogates.in_coordinates import InCoordinates
from structid.surrogates.kriging.kriging_keys import KRIGING_KEYS, kriging_settings
from structid.surrogates.kriging.predictor import KrigingPredictor
from structid.surrogates.kriging.universal_kriging import Kriging
from structid.surrogates.pod.pod_fit import check_runs, fit_records
from structid.surrogates.pod.principal_components import check_energy
from structid.surrogates.pod.response_space import ResponseSpaceSurrogate
from structid.surrogates.surrogate_kind import SurrogateKind

LEFT_OUT, LEFT_OUT_IN_A_CALIBRATION = 1e-8, 1e-13
"""Fractions of the variance that the components omit, by default and in a calibration."""

REACH_IN_A_CALIBRATION = 0.5
"""Distance of Kriging extrapolation beyond the range of the runs in a calibration, relative to the width of the range.
The Kriging variance covers the extrapolation error, and the calibration adds model runs there. A response clipped at the edge
would hide a posterior in the tails of the prior."""


@check_arguments
@dataclass(frozen=True)
class PODKriging:
    """Settings of POD-Kriging: principal components y(t, θ) ≈ ȳ(t) + Σ_k φ_k(t) c_k(θ), with a Kriging of each score.

    Parameters
    ----------
    kriging : Kriging
        Interpolation of the scores. By default the scores share one correlation, weighted by their energy.
    left_out_energy : float, optional
        Fraction of the variance that the components omit. The default is 1e-8, and 1e-13 in a calibration, because omitted
        variance would scatter the log density of precise measurements.
    reach : float, optional
        Distance of extrapolation beyond the range of the runs, as a fraction of its width; further out the response is constant.
        The default is 0, and 0.5 in a calibration, which uses the Kriging variance and adds model runs there.
    limit : float
        Largest mean relative error accepted in a posterior.
    outside : {"warn", "refuse", "allow"}
        Treatment of parameters outside the range of the design.

    Examples
    --------
    >>> import structid as si
    >>> settings = si.PODKriging(limit=0.02)
    >>> surrogate = settings.fit(runs)  # doctest: +SKIP
    """

    kriging: Kriging = field(default_factory=Kriging)
    left_out_energy: float | None = None
    reach: float | None = None
    limit: float = 1e-2
    outside: OutsideRule = "warn"

    warm_start: ClassVar[bool] = True
    weighted: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_energy(self.energy)
        if self.reach is not None and not (isinstance(self.reach, (int, float)) and 0.0 <= self.reach < np.inf):
            raise InputError("PODKriging.reach", f"{self.reach!r}", "a fraction of the range's width, 0 or more")

    @property
    def energy(self) -> float:
        """Fraction of the variance that the components omit."""
        return LEFT_OUT if self.left_out_energy is None else self.left_out_energy

    @property
    def forms(self) -> tuple[PODKriging, ...]:
        """Forms of the Kriging from which a calibration selects; only the given form if it is not the default."""
        kinds = (
            Kriging(separable=False),
            Kriging(separable=True),
            Kriging(separable=False, trend="linear"),
            Kriging(correlation="gaussian"),
        )
        energy = LEFT_OUT_IN_A_CALIBRATION if self.left_out_energy is None else self.left_out_energy
        reach = REACH_IN_A_CALIBRATION if self.reach is None else self.reach
        some = kinds if self.kriging == Kriging() else (self.kriging,)
        return tuple(replace(self, kriging=kind, left_out_energy=energy, reach=reach) for kind in some)

    @property
    def in_words(self) -> dict[str, Any]:
        """All settings, JSON-compatible."""
        return asdict(self)

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against planned runs.

        Parameters
        ----------
        design : Design
            Points of the planned runs.
        records : sequence of Excitation
            Records of the planned runs, assigned in turn.
        channels : sequence of str
            Channels of the planned runs; any channels are accepted.

        Raises
        ------
        InputError
            If there are too few runs on a record, or the records have different time steps.
        """
        check_runs("PODKriging", design, records)

    def fit(
        self, runs: Runs, progress: Progress | None = None, start: ResponseSpaceSurrogate | None = None
    ) -> ResponseSpaceSurrogate:
        """Fit a surrogate to runs on one or several records.

        Parameters
        ----------
        runs : Runs
            Runs of the replaced model; failed runs are left out.
        progress : callable, optional
            Callback whose arguments are the finished percentage of the fit, and 100.
        start : ResponseSpaceSurrogate, optional
            A surrogate fitted to some of these runs. The search starts from the lengths of `start`; see `Kriging.fit`.

        Returns
        -------
        ResponseSpaceSurrogate
            A model for these records.
        """
        previous = {} if start is None else start.records

        def regression(content_hash: str, design: Design, scores: np.ndarray, tell: Progress) -> KrigingPredictor:
            before: Any = previous[content_hash].scores if content_hash in previous else None
            before = before.inner if isinstance(before, InCoordinates) else before
            return self.kriging.fit(design, scores, tell, before if isinstance(before, KrigingPredictor) else None)

        return fit_records(self, regression, runs, progress, self.reach or 0.0)


def from_keys(**given: Any) -> PODKriging:
    """Make settings from the keys of a study file, including the keys of Kriging."""
    kriging, others = kriging_settings(given)
    return PODKriging(kriging=Kriging(**kriging), **others)


KIND = SurrogateKind(
    PODKriging,
    ResponseSpaceSurrogate,
    "pod_kriging",
    {"left_out_energy": float, "reach": float, **KRIGING_KEYS},
    from_keys,
)
