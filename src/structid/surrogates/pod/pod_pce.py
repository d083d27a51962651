"""POD-PCE: principal components of the histories, with a polynomial chaos expansion of each score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from structid.campaign.runs import Runs
from structid.core.progress import Progress
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.probability.designs import Design
from structid.surrogates.chaos.pce import PCE
from structid.surrogates.fit import OutsideRule
from structid.surrogates.pod.pod_fit import check_runs, fit_records
from structid.surrogates.pod.principal_components import check_energy
from structid.surrogates.pod.response_space import ResponseSpaceSurrogate
from structid.surrogates.surrogate_kind import SurrogateKind


@check_arguments
@dataclass(frozen=True)
class PODPCE:
    """Settings of POD-PCE: principal components of the histories, with a polynomial chaos expansion of each score.

    Parameters
    ----------
    pce : PCE
        Expansion of the scores. By default, coefficients shrink with the degree. Sparse expansions of a hundred scores take
        minutes, and their error is a hundred times larger.
    left_out_energy, limit, outside
        See `PODKriging`.

    Examples
    --------
    >>> import structid as si
    >>> settings = si.PODPCE(pce=si.PCE(degree=(1, 2, 3)))
    >>> surrogate = settings.fit(runs)  # doctest: +SKIP
    """

    pce: PCE = field(default_factory=lambda: PCE(method="shrinkage"))
    left_out_energy: float = 1e-8
    limit: float = 1e-2
    outside: OutsideRule = "warn"

    warm_start: ClassVar[bool] = False
    weighted: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_energy(self.left_out_energy)

    @property
    def energy(self) -> float:
        """Fraction of the variance that the components omit."""
        return self.left_out_energy

    @property
    def in_words(self) -> dict[str, Any]:
        """All settings, JSON-compatible."""
        return asdict(self)

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against runs that are yet to be made; see `PODKriging.check`.

        Parameters
        ----------
        design : Design
            Points of the planned runs.
        records : sequence of Excitation
            Records of the planned runs, assigned in turn.
        channels : sequence of str
            Channels of the planned runs; any channels are accepted.
        """
        check_runs("PODPCE", design, records)
        self.pce.check_runs(design.space.dimension, len(design) // len(records))

    def fit(self, runs: Runs, progress: Progress | None = None) -> ResponseSpaceSurrogate:
        """Fit a surrogate to runs on one or several records; see `PODKriging.fit`.

        Parameters
        ----------
        runs : Runs
            Runs of the replaced model; failed runs are left out.
        progress : callable, optional
            Callback whose arguments are the finished percentage of the fit, and 100.

        Returns
        -------
        ResponseSpaceSurrogate
            A model for these records.
        """
        return fit_records(self, lambda _hash, design, scores, tell: self.pce.fit(design, scores, tell), runs, progress)


def from_keys(**given: Any) -> PODPCE:
    """Make settings from the keys of a study file, including the keys of the expansion."""
    pce_keys = {key: given.pop(key) for key in PCE_KEYS if key in given}
    default = PODPCE().pce if not pce_keys else PCE()
    return PODPCE(pce=replace(default, **pce_keys), **given)


PCE_KEYS = {
    "degree": int | tuple[int, ...],
    "hyperbolic_norm": float | tuple[float, ...],
    "interaction": Annotated[int, Field(ge=1)],
    "method": Literal["sparse", "lars", "forward", "ols", "shrinkage"],
}
"""Study-file keys of the expansion."""

KIND = SurrogateKind(
    PODPCE,
    ResponseSpaceSurrogate,
    "pod_pce",
    {"left_out_energy": float, **PCE_KEYS},
    from_keys,
    {("method", "shrinkage"): ("degree", "hyperbolic_norm", "interaction")},
)
