"""Independent Gaussian errors, the error model of the MSc thesis in docs/bibliography.md."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from structid.core.errors import InputError
from structid.core.units import squared
from structid.core.validation import check_arguments, real_number
from structid.engine.array_module import namespace
from structid.inference.error_models.base import Discrepancy
from structid.inference.error_models.error_model_kind import SQUARED, ErrorModelKind
from structid.probability.marginals import Uniform
from structid.probability.truncation import Marginal


@check_arguments
@dataclass(frozen=True, eq=False)
class IID(Discrepancy):
    """Independent, identically distributed Gaussian discrepancy.

    log L = −½ T log(2πσ²) − ‖y − M(θ)‖² / (2σ²) for each variance σ², which T values share.

    Parameters
    ----------
    variance : float, Marginal, mapping of channel to either, or None
        A known σ² in the square of the channel's SI unit; its prior; or None for the prior U(0, max|y|²).
    per_channel : bool, optional
        Whether each channel has its own σ², or all share one; by default each has its own, since channels differ in unit.

    Examples
    --------
    >>> import structid as si
    >>> si.IID().describe()["kind"]
    'iid'
    >>> known = si.IID(variance=1.0)  # with Observation(sd=...): the standard deviations of the values are known
    """

    variance: float | Marginal | Mapping[str, float | Marginal] | None = None
    per_channel: bool = True

    independent: ClassVar[bool] = True
    takes_gaps: ClassVar[bool] = True

    def __post_init__(self) -> None:
        given = self.variance if isinstance(self.variance, Mapping) else {"": self.variance}
        allowed = "a positive number, a prior, or None"
        checked: dict[str, float | Marginal] = {}
        for channel, value in given.items():
            where = f"IID(variance['{channel}'])" if channel else "IID(variance)"
            number = value if isinstance(value, Marginal) else real_number(where, value, allowed)
            if isinstance(number, (int, float)) and not 0.0 < number < np.inf:
                raise InputError(where, f"{number}", allowed)
            checked[channel] = number
        if isinstance(self.variance, Mapping):
            object.__setattr__(self, "variance", checked)

    def _name(self, channel: str, channels: tuple[str, ...]) -> str:
        return f"sigma2_{channel}" if self.per_channel and len(channels) > 1 else "sigma2"

    def _given(self, channel: str) -> float | Marginal | None:
        if not isinstance(self.variance, Mapping):
            return self.variance
        if channel not in self.variance:
            raise InputError(
                "IID(variance)", f"no variance for channel '{channel}'", "a variance or a prior for every channel"
            )
        return self.variance[channel]

    def parameters(
        self, values: np.ndarray, channels: tuple[str, ...], dt: float, units: tuple[str, ...]
    ) -> dict[str, Marginal]:
        """Unknown variances and their priors; see `Discrepancy.parameters`."""
        priors: dict[str, Marginal] = {}
        for i, channel in enumerate(channels):
            given = self._given(channel)
            if isinstance(given, Marginal):
                priors.setdefault(self._name(channel, channels), given)
            elif given is None:
                peak = np.abs(values).max() if not self.per_channel else np.abs(values[:, i]).max()
                if peak == 0.0:
                    raise InputError(f"observation, channel '{channel}'", "zero throughout", "a response that moves")
                priors.setdefault(self._name(channel, channels), Uniform(0.0, float(peak) ** 2, unit=squared(units[i])))
        return priors

    def variances(self, unknown: Mapping[str, Any], channels: tuple[str, ...], runs: int, numpy: Any) -> Any:
        """σ² of every channel and run."""
        rows = []
        for channel in channels:
            given = self._given(channel)
            is_known = given if isinstance(given, (int, float)) else unknown[self._name(channel, channels)]
            rows.append(numpy.broadcast_to(numpy.asarray(is_known, dtype=np.float64), (runs,)))
        return numpy.stack(rows)

    def log_likelihood(
        self,
        residual: Any,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        white: Any = 0.0,
        is_measured: np.ndarray | None = None,
    ) -> Any:
        """Log density of the whole residual; see `Discrepancy.log_likelihood`."""
        variance = self.variances(unknown, channels, residual.shape[2], namespace(residual)) + white
        samples = residual.shape[0] if is_measured is None else is_measured.sum(axis=0)[:, None]
        return _normal_log_density((residual**2).sum(axis=0), samples, variance)

    def log_likelihood_of_squares(
        self, squares: Any, samples: Any, unknown: Mapping[str, Any], channels: tuple[str, ...]
    ) -> Any:
        """Log density from the sum of squares; see `Discrepancy.log_likelihood_of_squares`."""
        numpy = namespace(squares)
        return _normal_log_density(squares, samples, self.variances(unknown, channels, squares.shape[1], numpy))

    def pointwise(
        self,
        residual: Any,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: np.ndarray | None = None,
    ) -> Any:
        """Log density of every observation; see `Discrepancy.pointwise`."""
        numpy = namespace(residual)
        variance = self.variances(unknown, channels, residual.shape[2], numpy)
        density = -0.5 * numpy.log(2.0 * np.pi * variance) - 0.5 * residual**2 / variance
        return density if is_measured is None else numpy.where(is_measured[:, :, None], density, 0.0)

    def whiten(
        self,
        residual: Any,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: np.ndarray | None = None,
    ) -> Any:
        """Divide by σ; see `Discrepancy.whiten`."""
        numpy = namespace(residual)
        return residual / numpy.sqrt(self.variances(unknown, channels, residual.shape[2], numpy))

    def draw(
        self,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        unknown: Mapping[str, np.ndarray],
        channels: tuple[str, ...],
        dt: float,
    ) -> np.ndarray:
        """Draw white noise; see `Discrepancy.draw`."""
        errors = rng.standard_normal(shape)
        errors *= np.sqrt(self.variances(unknown, channels, shape[0], np).T[:, None, :])
        return errors

    def describe(self) -> dict[str, Any]:
        """Return the kind and the given variance."""

        def plain(value: float | Marginal | None) -> Any:
            return value.describe() if isinstance(value, Marginal) else value

        variance = (
            {c: plain(v) for c, v in self.variance.items()}
            if isinstance(self.variance, Mapping)
            else plain(self.variance)
        )
        return {"kind": "iid", "variance": variance, "per_channel": self.per_channel}


def _normal_log_density(squares: Any, samples: Any, variance: Any) -> Any:
    """Σ over channels of −½ T log(2πσ²) − ‖r‖²/(2σ²), shape (run,); T is one number, or one for each channel (channel, 1)."""
    # A point on the edge of its prior may have zero variance; its density is −inf or NaN, and NumPy would warn.
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = namespace(variance).log(2.0 * np.pi * variance)
        return (-0.5 * samples * logarithm - 0.5 * squares / variance).sum(axis=0)


IID_KIND = ErrorModelKind(IID, "iid", {"variance": SQUARED}, {"per_channel": (bool, True)})
