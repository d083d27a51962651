"""Errors of values that are rounded to multiples of a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.inference.error_models.error_model_kind import SQUARED, ErrorModelKind
from structid.inference.error_models.uncorrelated import Density, Uncorrelated
from structid.probability.truncation import Marginal

OFF_THE_GRID = 0.01
"""Largest distance of a rounded value from its grid, in steps of the grid."""
SMALLEST_STEP = 1e-9
"""Smallest step of a grid relative to the largest value; smaller differences are round-off of floating-point numbers."""

TERMS = 14
"""Number of terms of the Chebyshev series of log erfcx, whose error is 3e-10."""


@check_arguments
@dataclass(frozen=True, eq=False)
class Quantised(Uncorrelated):
    """Independent normal errors before a rounding of the values to multiples of a step q, as by a converter of few bits.

    The probability of a rounded value is that of its cell, p(r) = (Φ((r + q/2)/σ) − Φ((r − q/2)/σ)) / q. Independent errors after
    rounding, with the variance q²/12, are right for σ > q only: below, the errors of slow passages are not independent.

    Parameters
    ----------
    variance : float, Marginal or None
        σ² of the errors before rounding, in the square of the channel's SI unit: a number if it is known, or a prior. If left
        out, its prior is U(0, max|y|²).
    resolution : float, mapping of channel to float, or None
        q, in the channel's SI unit. If left out, it is the step of the grid on which the values lie.

    Raises
    ------
    InputError
        If the resolution is left out and the values do not lie on a grid.

    Examples
    --------
    >>> import structid as si
    >>> si.Quantised(resolution=1e-4).describe()["kind"]
    'quantised'
    """

    variance: float | Marginal | None = None
    resolution: float | Mapping[str, float] | None = None

    kind: ClassVar[str] = "quantised"
    depends_on_response: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        given = self.resolution.values() if isinstance(self.resolution, Mapping) else [self.resolution]
        for step in given:
            if step is not None and not 0.0 < step < np.inf:
                raise InputError("Quantised(resolution)", f"{step}", "a positive number in the channel's SI unit")

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        return ("variance",)

    def _default_prior(self, name: str, dt: float, samples: int) -> Marginal:
        raise NotImplementedError(f"{type(self).__name__} has no parameter '{name}'")

    def bound_to(self, values: Float[np.ndarray, "time channel"], channels: tuple[str, ...]) -> Quantised:
        """Take the resolution of every channel from the measured values; see `Discrepancy.bound_to`."""
        if self.resolution is not None:
            return self
        steps = {}
        for i, channel in enumerate(channels):
            step = grid_step(values[:, i])
            if step is None:
                raise InputError(
                    f"observation, channel '{channel}'",
                    "values that do not lie on a grid",
                    "values rounded to a step, or the step itself",
                    "Use Quantised(resolution=…) or another error model: filters and corrections of the baseline remove the grid.",
                )
            steps[channel] = step
        return replace(self, resolution=steps)

    def _steps(self, channels: tuple[str, ...]) -> Float[np.ndarray, "channel 1"]:
        """The resolution q of every channel."""
        given = self.resolution
        assert given is not None, "an observation must first bind the error model to its values"
        return np.array([[given[channel] if isinstance(given, Mapping) else given] for channel in channels])

    def rounding(self, channels: tuple[str, ...]) -> Float[np.ndarray, " channel"]:
        """Return the resolution of every channel; see `Discrepancy.rounding`."""
        return self._steps(channels)[:, 0]

    def density(self, values: Mapping[str, Any], channels: tuple[str, ...], white: Any, numpy: Any) -> Density:
        """Log probability of the cell of a value, over its width."""
        step, precision = self._steps(channels), 1.0 / numpy.sqrt(values["variance"] + white)

        def log_density(residual: Any, _: Any) -> Any:
            size = numpy.abs(residual)
            near, far = (size - 0.5 * step) * precision, (size + 0.5 * step) * precision
            of_near, of_far = _log_normal_tail(numpy.abs(near), numpy), _log_normal_tail(far, numpy)
            # Outside the cell, the difference of two tails; inside, what the tails on both sides leave.
            outside = of_near + numpy.log(1.0 - numpy.exp(of_far - of_near))
            inside = numpy.log(1.0 - numpy.exp(of_near) - numpy.exp(of_far))
            return numpy.where(near > 0.0, outside, inside) - np.log(step)

        return log_density

    def sd(self, values: Mapping[str, Any], channels: tuple[str, ...], response: Any, numpy: Any) -> Any:
        """√(σ² + q²/12), the standard deviation of the errors after rounding."""
        return numpy.sqrt(values["variance"] + self._steps(channels) ** 2 / 12.0)

    def draw(
        self,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        unknown: Mapping[str, np.ndarray],
        channels: tuple[str, ...],
        dt: float,
        response: Float[np.ndarray, "run time channel"] | None = None,
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw the errors of values rounded to multiples of q; see `Discrepancy.draw`."""
        sd = np.sqrt(self._of_draws(unknown, channels, shape[0])["variance"])
        step, exact = self._steps(channels)[:, 0], np.asarray(response)
        return np.asarray(np.round((exact + sd * rng.standard_normal(shape)) / step) * step - exact)

    def describe(self) -> dict[str, Any]:
        """Return the kind and the arguments."""
        resolution = dict(self.resolution) if isinstance(self.resolution, Mapping) else self.resolution
        return {**super().describe(), "resolution": resolution}


def grid_step(values: Float[np.ndarray, " time"]) -> float | None:
    """Step of the grid on which measured values lie; None if they do not lie on a grid, or are all the same."""
    levels = np.unique(values[np.isfinite(values)])
    differences = np.diff(levels)
    differences = differences[differences > SMALLEST_STEP * np.abs(levels).max()] if len(levels) > 1 else differences
    if not len(differences):
        return None
    cells = (levels - levels[0]) / differences.min()
    # A step that many levels determine is known better than the smallest difference.
    whole = np.round(cells)
    step = float(whole @ (levels - levels[0]) / (whole @ whole))
    away = np.abs((levels - levels[0]) / step - whole)
    return step if away.max() < OFF_THE_GRID else None


def _series_of_tail() -> np.ndarray:
    """Chebyshev coefficients of log(erfcx(z)/t) in t = 2/(2 + z) from 0 to 1, that is, for z ≥ 0."""

    def scaled(s: np.ndarray) -> np.ndarray:
        t = np.maximum(0.5 * (s + 1.0), 1e-12)
        return np.asarray(np.log(scipy.special.erfcx(2.0 / t - 2.0) / t))

    return np.asarray(np.polynomial.Chebyshev.interpolate(scaled, TERMS).coef)


SERIES_OF_TAIL = _series_of_tail()
"""See `_series_of_tail`."""


def _log_normal_tail(x: Any, numpy: Any) -> Any:
    """Logarithm of 1 − Φ(x) = ½ erfcx(x/√2) exp(−½x²) for x ≥ 0, by Clenshaw's sum."""
    t = 2.0 / (2.0 + np.sqrt(0.5) * x)
    s = 2.0 * t - 1.0
    last, before = 0.0, 0.0
    for coefficient in SERIES_OF_TAIL[:0:-1]:
        last, before = coefficient + 2.0 * s * last - before, last
    return numpy.log(0.5 * t) + SERIES_OF_TAIL[0] + s * last - before - 0.5 * x**2


QUANTISED_KIND = ErrorModelKind(Quantised, "quantised", {"variance": SQUARED})
"""The description of rounded errors, by which a study file can name them."""
