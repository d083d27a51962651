"""Errors that are independent in time, but not normal, or not of one size: Student's t, proportional, and rounded errors."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy
from jaxtyping import Bool, Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.engine.array_module import namespace
from structid.engine.device import jnp
from structid.engine.time_loop import Fold
from structid.inference.error_models.base import ResidualSample
from structid.inference.error_models.error_model_kind import SQUARED, ErrorModelKind
from structid.inference.error_models.parametric import Parametric
from structid.probability.marginals import LogNormal, Uniform
from structid.probability.truncation import Marginal

Density = Callable[[Any, Any], Any]
"""``density(residual, response)``: the log density of values (…, channel, run)."""

DEGREES_OF_FREEDOM = LogNormal(log_mean=float(np.log(5.0)), log_sd=1.0, low=1.0, high=100.0)
"""Default prior of ν: 95 % between 1.2 and 34. Beyond 100, Student's t and the normal distribution are the same to the data."""

LARGEST_SHARE = 1.0
"""Upper limit of the default prior of a proportional error, relative to the response."""

OFF_THE_GRID = 0.01
"""Largest distance of a rounded value from its grid, in steps of the grid."""
SMALLEST_STEP = 1e-9
"""Smallest step of a grid relative to the largest value; smaller differences are round-off of floating-point numbers."""

TERMS = 14
"""Number of terms of the Chebyshev series of log erfcx, whose error is 3e-10."""


class Uncorrelated(Parametric):
    """Common part: one log density for each value, given its residual and the response."""

    takes_gaps: ClassVar[bool] = True

    @abstractmethod
    def density(self, values: Mapping[str, Any], channels: tuple[str, ...], white: Any, numpy: Any) -> Density:
        """Log density of a value for given parameters (channel, run); `white` is an additional variance of normal errors."""

    @abstractmethod
    def sd(self, values: Mapping[str, Any], channels: tuple[str, ...], response: Any, numpy: Any) -> Any:
        """Standard deviation (…, channel, run) of normal errors with as much information on the response."""

    def _of_draws(self, unknown: Mapping[str, Any], channels: tuple[str, ...], runs: int) -> dict[str, np.ndarray]:
        """Every parameter as an array (run, 1, channel), for draws (run, time, channel)."""
        return {name: x.T[:, None, :] for name, x in self._values(unknown, channels, runs, np).items()}

    # --- the likelihood -----------------------------------------------------------------------------------------

    def log_likelihood(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        white: Any = 0.0,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
        response: Float[Array, "time channel run"] | None = None,
    ) -> Float[Array, " run"]:
        """Log density of the whole residual; see `Discrepancy.log_likelihood`."""
        return self._each(residual, unknown, channels, white, is_measured, response).sum(axis=(0, 1))

    def pointwise(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
        response: Float[Array, "time channel run"] | None = None,
    ) -> Float[Array, "time channel run"]:
        """Log density of every value; see `Discrepancy.pointwise`."""
        return self._each(residual, unknown, channels, 0.0, is_measured, response)

    def _each(
        self, residual: Any, unknown: Any, channels: Any, white: Any, is_measured: np.ndarray | None, response: Any
    ) -> Any:
        """Log density of every value, 0 where it is missing."""
        numpy = namespace(residual)
        values = self._values(unknown, channels, residual.shape[2], numpy)
        # A point on the edge of its prior may have zero variance; its density is −inf or NaN, and NumPy would warn.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            density = self.density(values, channels, white, numpy)(residual, response)
        return density if is_measured is None else numpy.where(is_measured[:, :, None], density, 0.0)

    def fold(
        self,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        runs: int,
        dt: float,
        samples: Any,
    ) -> Fold:
        """The log density as a fold over samples; see `Discrepancy.fold`."""
        density = self.density(self._values(unknown, channels, runs, jnp), channels, 0.0, jnp)

        def step(total: Any, sample: ResidualSample) -> Any:
            each = density(sample.residual, sample.response)
            return total + (each if sample.is_measured is None else jnp.where(sample.is_measured, each, 0.0))

        return Fold(jnp.zeros((len(channels), runs)), step, lambda total: total.sum(axis=0))

    def whiten(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
        response: Float[Array, "time channel _"] | None = None,
    ) -> Float[Array, "time channel run"]:
        """Divide by `sd`; see `Discrepancy.whiten`."""
        numpy = namespace(residual)
        return residual / self.sd(self._values(unknown, channels, residual.shape[2], numpy), channels, response, numpy)


@check_arguments
@dataclass(frozen=True, eq=False)
class Student(Uncorrelated):
    """Independent errors with Student's t distribution, for outliers: spikes, dropouts, knocks against the sensor.

    log p(r) = log Γ(½(ν+1)) − log Γ(½ν) − ½ log(πνσ²) − ½(ν+1) log(1 + r²/(νσ²)), with ν degrees of freedom (K. L. Lange, R. J. A.
    Little & J. M. G. Taylor 1989, doi 10.1080/01621459.1989.10478852). The influence of a value on the parameters falls as 1/r far
    away.

    Parameters
    ----------
    variance : float, Marginal or None
        The square of the scale σ, in the square of the channel's SI unit: a number if it is known, or a prior. If left out, its
        prior is U(0, max|y|²). The variance of the errors is σ² ν/(ν − 2).
    degrees_of_freedom : float, Marginal or None
        ν: a number or a prior. If left out, its prior is lognormal with a median of 5, between 1 and 100.

    Examples
    --------
    >>> import structid as si
    >>> si.Student(degrees_of_freedom=4.0).describe()["kind"]
    'student'
    """

    variance: float | Marginal | None = None
    degrees_of_freedom: float | Marginal | None = None

    kind: ClassVar[str] = "student"

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        return ("variance", "degrees_of_freedom")

    def _default_prior(self, name: str, dt: float, samples: int) -> Marginal:
        return DEGREES_OF_FREEDOM

    def density(self, values: Mapping[str, Any], channels: tuple[str, ...], white: Any, numpy: Any) -> Density:
        """Student's log density; an additional variance widens the scale."""
        nu = values["degrees_of_freedom"]
        square = nu * (values["variance"] + white)
        volume = _log_gamma(0.5 * (nu + 1.0), numpy) - _log_gamma(0.5 * nu, numpy) - 0.5 * numpy.log(np.pi * square)
        exponent, precision = 0.5 * (nu + 1.0), 1.0 / square
        return lambda residual, _: volume - exponent * numpy.log(1.0 + residual**2 * precision)

    def sd(self, values: Mapping[str, Any], channels: tuple[str, ...], response: Any, numpy: Any) -> Any:
        """σ √((ν + 3)/(ν + 1)), from the Fisher information on the location."""
        nu = values["degrees_of_freedom"]
        return numpy.sqrt(values["variance"] * (nu + 3.0) / (nu + 1.0))

    def normal_scores(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        **more: Any,
    ) -> Float[np.ndarray, "time channel run"]:
        """Φ⁻¹(F(r/σ)), with F the distribution function of Student's t; see `Discrepancy.normal_scores`."""
        residual = np.asarray(residual)
        values = self._values(unknown, channels, residual.shape[2], np)
        scaled = np.abs(residual) / np.sqrt(values["variance"])
        beyond = scipy.stats.t.sf(scaled, values["degrees_of_freedom"])
        return np.asarray(np.sign(residual) * scipy.stats.norm.isf(beyond))

    def draw(
        self,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        unknown: Mapping[str, np.ndarray],
        channels: tuple[str, ...],
        dt: float,
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw ε = σ n/√(χ²/ν); see `Discrepancy.draw`."""
        values = self._of_draws(unknown, channels, shape[0])
        draws = rng.standard_t(np.broadcast_to(values["degrees_of_freedom"], shape))
        return np.asarray(np.sqrt(values["variance"]) * draws)


@check_arguments
@dataclass(frozen=True, eq=False)
class Proportional(Uncorrelated):
    """Independent normal errors of which a part is proportional to the response: r_t ~ N(0, σ² + c² M_t²).

    Such errors come from a gain that fluctuates, or from a sensor whose noise grows with its signal.

    Parameters
    ----------
    variance : float, Marginal or None
        σ² of the constant part, in the square of the channel's SI unit: a number if it is known, or a prior. If left out, its
        prior is U(0, max|y|²).
    share : float, Marginal or None
        c, the standard deviation of the proportional part relative to the response: a number or a prior. If left out, its prior
        is U(0, 1).

    Examples
    --------
    >>> import structid as si
    >>> si.Proportional(share=si.Uniform(0.0, 0.2)).describe()["kind"]
    'proportional'
    """

    variance: float | Marginal | None = None
    share: float | Marginal | None = None

    kind: ClassVar[str] = "proportional"
    depends_on_response: ClassVar[bool] = True

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        return ("variance", "share")

    def _default_prior(self, name: str, dt: float, samples: int) -> Marginal:
        return Uniform(0.0, LARGEST_SHARE)

    def density(self, values: Mapping[str, Any], channels: tuple[str, ...], white: Any, numpy: Any) -> Density:
        """Normal log density with a variance that depends on the response."""
        constant, square = values["variance"] + white, values["share"] ** 2

        def log_density(residual: Any, response: Any) -> Any:
            variance = constant + square * response**2
            return -0.5 * (numpy.log(2.0 * np.pi * variance) + residual**2 / variance)

        return log_density

    def sd(self, values: Mapping[str, Any], channels: tuple[str, ...], response: Any, numpy: Any) -> Any:
        """√(σ² + c² M²)."""
        return numpy.sqrt(values["variance"] + values["share"] ** 2 * response**2)

    def draw(
        self,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        unknown: Mapping[str, np.ndarray],
        channels: tuple[str, ...],
        dt: float,
        response: Float[np.ndarray, "run time channel"] | None = None,
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw normal errors of this size; see `Discrepancy.draw`."""
        values = self._of_draws(unknown, channels, shape[0])
        return np.asarray(rng.standard_normal(shape) * self.sd(values, channels, response, np))


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


def _log_gamma(x: Any, numpy: Any) -> Any:
    """Logarithm of Γ(x), x > 0, by Stirling's series at x + 8 and Γ(x + 1) = x Γ(x): vector code has no such function."""
    product: Any = 1.0
    for k in range(8):
        product = product * (x + k)
    y = x + 8.0
    series = 1.0 / 1680.0 - 1.0 / 1188.0 / y**2
    for bernoulli in (1.0 / 1260.0, 1.0 / 360.0, 1.0 / 12.0):
        series = bernoulli - series / y**2
    return (y - 0.5) * numpy.log(y) - y + 0.5 * np.log(2.0 * np.pi) + series / y - numpy.log(product)


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


STUDENT_KIND = ErrorModelKind(Student, "student", {"variance": SQUARED, "degrees_of_freedom": ""})
"""The description of Student's errors, by which a study file can name them."""
PROPORTIONAL_KIND = ErrorModelKind(Proportional, "proportional", {"variance": SQUARED, "share": ""})
"""The description of proportional errors, by which a study file can name them."""
QUANTISED_KIND = ErrorModelKind(Quantised, "quantised", {"variance": SQUARED})
"""The description of rounded errors, by which a study file can name them."""
