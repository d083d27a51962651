"""POD-Kriging: principal components of the histories, each score a Kriging."""

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
"""Fractions of the variance that components omit."""

REACH_IN_A_CALIBRATION = 0.5
"""Distance beyond the range of the runs to which a Kriging extrapolates in a calibration, relative to the width of the range.
Its variance covers what it does not know there, and model runs follow. A response clipped at the edge would hide a
posterior in the tails of the prior."""


@check_arguments
@dataclass(frozen=True)
class PODKriging:
    """Settings: principal components of the histories, y(t, θ) ≈ ȳ(t) + Σ_k φ_k(t) c_k(θ), each score a Kriging.

    Parameters
    ----------
    kriging : Kriging
        How the scores are interpolated. By default they share one correlation, weighted by their energy.
    left_out_energy : float, optional
        Components are kept until they leave out this share of the variance; 1e-8 when left out, and 1e-13 in a calibration, where
        what they leave out would scatter the log density of precise measurements.
    reach : float, optional
        How far beyond the range of the runs it extrapolates, as a share of the range's width; further out it responds as there. 0
        when left out, and 0.5 in a calibration, where its own variance is asked and model runs follow.
    limit : float
        Largest mean relative error with which it may be used in a posterior.
    outside : {"warn", "refuse", "allow"}
        What to do with parameters beyond the range of the design.

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
            raise InputError("PODKriging.reach", f"{self.reach!r}", "a share of the range's width, 0 or more")

    @property
    def energy(self) -> float:
        """Fraction of the variance that components omit."""
        return LEFT_OUT if self.left_out_energy is None else self.left_out_energy

    @property
    def forms(self) -> tuple[PODKriging, ...]:
        """Forms from which a calibration chooses; only one if a Kriging was specified."""
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
        """Check the settings against runs that are yet to be made.

        Parameters
        ----------
        design : Design
            Their points.
        records : sequence of Excitation
            What will drive them, dealt out in turn.
        channels : sequence of str
            What they will return; any will do.

        Raises
        ------
        InputError
            If no surrogate can be fitted to them: too few on each record, or records of different steps.
        """
        check_runs("PODKriging", design, records)

    def fit(
        self, runs: Runs, progress: Progress | None = None, start: ResponseSpaceSurrogate | None = None
    ) -> ResponseSpaceSurrogate:
        """Fit to runs on one record or several.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for; failed ones are left out.
        progress : callable, optional
            Called with the percentage of the fit that is done, and 100.
        start : ResponseSpaceSurrogate, optional
            A surrogate fitted to some of these runs. The search starts from its correlation lengths; see `Kriging.fit`.

        Returns
        -------
        ResponseSpaceSurrogate
            A model for those records.
        """
        previous = {} if start is None else start.records

        def regression(content_hash: str, design: Design, scores: np.ndarray, tell: Progress) -> KrigingPredictor:
            before: Any = previous[content_hash].scores if content_hash in previous else None
            before = before.inner if isinstance(before, InCoordinates) else before
            return self.kriging.fit(design, scores, tell, before if isinstance(before, KrigingPredictor) else None)

        return fit_records(self, regression, runs, progress, self.reach or 0.0)


def from_keys(**given: Any) -> PODKriging:
    """Make settings from the keys of a study file, including those of the Kriging."""
    kriging, others = kriging_settings(given)
    return PODKriging(kriging=Kriging(**kriging), **others)


KIND = SurrogateKind(
    PODKriging,
    ResponseSpaceSurrogate,
    "pod_kriging",
    {"left_out_energy": float, "reach": float, **KRIGING_KEYS},
    from_keys,
)
