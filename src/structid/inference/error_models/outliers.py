"""Error models for outliers: spikes, dropouts, knocks against the sensor."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.inference.error_models.error_model_kind import SQUARED, ErrorModelKind
from structid.inference.error_models.uncorrelated import Density, Uncorrelated
from structid.probability.marginals import LogNormal, Uniform
from structid.probability.truncation import Marginal

DEGREES_OF_FREEDOM = LogNormal(log_mean=float(np.log(5.0)), log_sd=1.0, low=1.0, high=100.0)
"""Default prior of ν: 95 % between 1.2 and 34. Beyond 100, Student's t and the normal distribution are the same to the data."""

LARGEST_SHARE = 0.3
"""Upper limit of the default prior of the share of outliers."""
OUTLIER_SCALE = LogNormal(log_mean=float(np.log(10.0)), log_sd=1.0, low=3.0, high=1000.0)
"""Default prior of the standard deviation of outliers over that of the others: 95 % between 3 and 71."""


class WithOutliers(Uncorrelated):
    """Common part: symmetric densities of r/σ whose large values have little influence."""

    has_outliers: ClassVar[bool] = True

    @abstractmethod
    def slope(self, residual: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """−d log p/dr of a value (…, channel, run)."""

    @abstractmethod
    def beyond(self, scaled: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Probability of a value above |r|/σ."""

    def influence(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        **more: Any,
    ) -> Float[np.ndarray, "time channel run"]:
        """`slope` times `sd`; see `Discrepancy.influence`."""
        residual = np.asarray(residual)
        values = self._values(unknown, channels, residual.shape[2], np)
        return np.asarray(self.slope(residual, values) * self.sd(values, channels, None, np))

    def normal_scores(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        **more: Any,
    ) -> Float[np.ndarray, "time channel run"]:
        """Φ⁻¹(F(r/σ)), with F the distribution function; see `Discrepancy.normal_scores`."""
        residual = np.asarray(residual)
        values = self._values(unknown, channels, residual.shape[2], np)
        beyond = self.beyond(np.abs(residual) / np.sqrt(values["variance"]), values)
        return np.asarray(np.sign(residual) * scipy.stats.norm.isf(beyond))


@check_arguments
@dataclass(frozen=True, eq=False)
class Student(WithOutliers):
    """Independent errors with Student's t distribution, for outliers of any size.

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

    def slope(self, residual: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """(ν + 1) r/(νσ² + r²)."""
        nu = values["degrees_of_freedom"]
        return np.asarray((nu + 1.0) * residual / (nu * values["variance"] + residual**2))

    def beyond(self, scaled: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Probability of a larger value under Student's t."""
        return np.asarray(scipy.stats.t.sf(scaled, values["degrees_of_freedom"]))

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
class Contaminated(WithOutliers):
    """Independent normal errors of which a few, the outliers, have a much larger standard deviation.

    p(r) = (1 − ε) N(r; 0, σ²) + ε N(r; 0, k²σ²), the contaminated normal distribution (J. W. Tukey 1960, "A survey of sampling from
    contaminated distributions"). In contrast to `Student`, all other errors are normal.

    Parameters
    ----------
    variance : float, Marginal or None
        σ² of the errors that are no outliers, in the square of the channel's SI unit: a number if it is known, or a prior. If left
        out, its prior is U(0, max|y|²).
    outlier_share : float, Marginal or None
        ε, the probability of an outlier: a number or a prior. If left out, its prior is U(0, 0.3).
    outlier_scale : float, Marginal or None
        k, the standard deviation of an outlier relative to σ: a number or a prior. If left out, its prior is lognormal with a
        median of 10, between 3 and 1000.

    Raises
    ------
    InputError
        If the share of outliers is 1 or more, or their scale is not larger than 1.

    Examples
    --------
    >>> import structid as si
    >>> si.Contaminated(outlier_share=0.01).describe()["kind"]
    'contaminated'
    """

    variance: float | Marginal | None = None
    outlier_share: float | Marginal | None = None
    outlier_scale: float | Marginal | None = None

    kind: ClassVar[str] = "contaminated"

    def __post_init__(self) -> None:
        super().__post_init__()
        share, scale = self.outlier_share, self.outlier_scale
        if isinstance(share, (int, float)) and share >= 1.0:
            raise InputError("Contaminated(outlier_share)", f"{share}", "a share below 1, a prior, or None")
        if isinstance(scale, (int, float)) and scale <= 1.0:
            raise InputError("Contaminated(outlier_scale)", f"{scale}", "a number above 1, a prior, or None")

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        return ("variance", "outlier_share", "outlier_scale")

    def _default_prior(self, name: str, dt: float, samples: int) -> Marginal:
        return Uniform(0.0, LARGEST_SHARE) if name == "outlier_share" else OUTLIER_SCALE

    def density(self, values: Mapping[str, Any], channels: tuple[str, ...], white: Any, numpy: Any) -> Density:
        """Log density of the mixture; an additional variance widens both components."""
        share, usual = values["outlier_share"], values["variance"] + white
        large = values["variance"] * values["outlier_scale"] ** 2 + white
        volume = numpy.log(share) - 0.5 * numpy.log(2.0 * np.pi * large)
        # log p = log p_large + log(1 + p_usual/p_large), whose ratio is bounded
        ratio = (1.0 - share) / share * numpy.sqrt(large / usual)
        of_large, of_both = 0.5 / large, 0.5 / usual - 0.5 / large

        def log_density(residual: Any, _: Any) -> Any:
            square = residual**2
            return volume - of_large * square + numpy.log(1.0 + ratio * numpy.exp(-of_both * square))

        return log_density

    def sd(self, values: Mapping[str, Any], channels: tuple[str, ...], response: Any, numpy: Any) -> Any:
        """σ/√(1 − ε + ε/k²), as if it were known which values are outliers."""
        share = values["outlier_share"]
        return numpy.sqrt(values["variance"] / (1.0 - share + share / values["outlier_scale"] ** 2))

    def slope(self, residual: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """(P(usual) + P(outlier)/k²) r/σ², with the probabilities of being one given r."""
        share, scale, variance = (values[name] for name in ("outlier_share", "outlier_scale", "variance"))
        falls = np.exp(-0.5 * residual**2 * (1.0 - 1.0 / scale**2) / variance)
        usual = 1.0 / (1.0 + share / ((1.0 - share) * scale * np.maximum(falls, np.finfo(float).tiny)))
        return np.asarray((usual + (1.0 - usual) / scale**2) * residual / variance)

    def beyond(self, scaled: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Probability of a larger value under the mixture."""
        share, sf = values["outlier_share"], scipy.stats.norm.sf
        return np.asarray((1.0 - share) * sf(scaled) + share * sf(scaled / values["outlier_scale"]))

    def draw(
        self,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        unknown: Mapping[str, np.ndarray],
        channels: tuple[str, ...],
        dt: float,
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw which values are outliers, and the errors of both; see `Discrepancy.draw`."""
        values = self._of_draws(unknown, channels, shape[0])
        size = np.where(rng.random(shape) < values["outlier_share"], values["outlier_scale"], 1.0)
        return np.asarray(np.sqrt(values["variance"]) * size * rng.standard_normal(shape))


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


STUDENT_KIND = ErrorModelKind(Student, "student", {"variance": SQUARED, "degrees_of_freedom": ""})
"""The description of Student's errors, by which a study file can name them."""
CONTAMINATED_KIND = ErrorModelKind(
    Contaminated, "contaminated", {"variance": SQUARED, "outlier_share": "", "outlier_scale": ""}
)
"""The description of normal errors with outliers, by which a study file can name them."""
