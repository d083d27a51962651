"""Correlated error models by their kernels: first-order autoregressive, Matérn 3/2, damped cosine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.inference.error_models.correlated import Correlated, Matrix
from structid.inference.error_models.error_model_kind import SQUARED, ErrorModelKind
from structid.probability.marginals import LogNormal, Uniform
from structid.probability.truncation import Marginal


def _spanning(low: float, high: float, unit: str) -> Marginal:
    """A lognormal prior with 95 % of its mass between two values."""
    middle, width = 0.5 * (np.log(low) + np.log(high)), (np.log(high) - np.log(low)) / (2.0 * 1.96)
    return LogNormal(log_mean=float(middle), log_sd=float(width), unit=unit)


@dataclass(frozen=True, eq=False)
class CorrelatedInTime(Correlated):
    """Error models whose kernel has one parameter besides its variance, a correlation time."""

    correlation_time: float | Marginal | None = None  # ℓ [s]

    @classmethod
    def _shapes(cls) -> tuple[str, ...]:
        return ("correlation_time",)

    def _default_prior(self, name: str, dt: float, samples: int) -> Marginal:
        return _spanning(dt, 0.1 * samples * dt, "s")


@check_arguments
@dataclass(frozen=True, eq=False)
class AR1(CorrelatedInTime):
    """Exponential kernel, σ² exp(−τ/ℓ): at a constant step dt an AR(1) process with φ = exp(−dt/ℓ), plus white noise.

    Parameters
    ----------
    variance : float, Marginal or None
        σ² of the correlated part, in the square of the channel's SI unit: a number if it is known, or a prior. If left out, its
        prior is U(0, max|y|²).
    white : float, Marginal or None
        Variance of added white noise: a number or a prior. ``white=0.0`` omits it, which may change the evidence by some nats.
    correlation_time : float, Marginal or None
        ℓ [s]: a number or a prior. If left out, its prior is lognormal, with 95 % between dt and a tenth of the duration.

    Examples
    --------
    >>> import structid as si
    >>> errors = si.AR1(correlation_time=si.Uniform(0.01, 1.0, unit="s"))
    >>> errors.describe()["kind"]
    'ar1'
    """

    kind: ClassVar[str] = "ar1"

    def _transition(self, shapes: Mapping[str, Any], dt: float, numpy: Any) -> tuple[Matrix, list[Any]]:
        return [[numpy.exp(-dt / shapes["correlation_time"])]], [numpy.ones_like(shapes["correlation_time"])]


@check_arguments
@dataclass(frozen=True, eq=False)
class Matern32(CorrelatedInTime):
    """Matérn-3/2 kernel, σ² (1 + λτ) exp(−λτ) with λ = √3/ℓ, plus white noise.

    Parameters
    ----------
    variance : float, Marginal or None
        σ² of the correlated part, in the square of the channel's SI unit: a number if it is known, or a prior. If left out, its
        prior is U(0, max|y|²).
    white : float, Marginal or None
        Variance of added white noise: a number or a prior. ``white=0.0`` omits it, which may change the evidence by some nats.
    correlation_time : float, Marginal or None
        ℓ [s]: a number or a prior. If left out, its prior is lognormal, with 95 % between dt and a tenth of the duration.

    Examples
    --------
    >>> import structid as si
    >>> errors = si.Matern32(white=0.0)  # without white noise
    >>> errors.describe()["kind"]
    'matern32'
    """

    kind: ClassVar[str] = "matern32"

    def _transition(self, shapes: Mapping[str, Any], dt: float, numpy: Any) -> tuple[Matrix, list[Any]]:
        rate = np.sqrt(3.0) / shapes["correlation_time"]
        decay = numpy.exp(-rate * dt)
        # exp(A dt) of A = [[0, 1], [−λ², −2λ]]
        transition = [
            [decay * (1.0 + rate * dt), decay * dt],
            [-decay * rate**2 * dt, decay * (1.0 - rate * dt)],
        ]
        return transition, [numpy.ones_like(rate), rate**2]


@check_arguments
@dataclass(frozen=True, eq=False)
class DampedCosine(Correlated):
    """Kernel of a stochastic harmonic oscillator, σ² e^{−ητ} (cos ωτ + η/ω sin ωτ), plus white noise.

    η = ζω₀ and ω = ω₀√(1 − ζ²). The residual of a wrong structural model is narrow-band, around the structure's frequency.

    Parameters
    ----------
    variance : float, Marginal or None
        σ² of the correlated part, in the square of the channel's SI unit: a number if it is known, or a prior. If left out, its
        prior is U(0, max|y|²).
    white : float, Marginal or None
        Variance of added white noise: a number or a prior. ``white=0.0`` omits it, which may change the evidence by some nats.
    frequency : float, Marginal or None
        ω₀/2π [Hz]: a number or a prior. If left out, its prior is lognormal: 95 % between 2 cycles in the duration and 1/(2 dt).
    damping : float, Marginal or None
        ζ, between 0 and 1. If left out, its prior is uniform on this interval.

    Examples
    --------
    >>> import structid as si
    >>> errors = si.DampedCosine(frequency=si.Uniform(1.0, 10.0, unit="Hz"))
    >>> errors.describe()["kind"]
    'damped_cosine'
    """

    frequency: float | Marginal | None = None
    damping: float | Marginal | None = None

    kind: ClassVar[str] = "damped_cosine"

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.damping, (int, float)) and not self.damping < 1.0:
            raise InputError("DampedCosine(damping)", f"{self.damping}", "a ratio below 1, a prior, or None")

    @classmethod
    def _shapes(cls) -> tuple[str, ...]:
        return ("frequency", "damping")

    def _default_prior(self, name: str, dt: float, samples: int) -> Marginal:
        if name == "damping":
            return Uniform(0.0, 0.999)
        return _spanning(1.0 / (0.5 * samples * dt), 0.5 / dt, "Hz")

    def _transition(self, shapes: Mapping[str, Any], dt: float, numpy: Any) -> tuple[Matrix, list[Any]]:
        natural = 2.0 * np.pi * shapes["frequency"]
        eta = shapes["damping"] * natural
        omega = natural * numpy.sqrt(numpy.maximum(1.0 - shapes["damping"] ** 2, 1e-6))
        decay, cosine, sine = numpy.exp(-eta * dt), numpy.cos(omega * dt), numpy.sin(omega * dt)
        # exp(A dt) of A = [[0, 1], [−ω₀², −2η]]
        transition = [
            [decay * (cosine + eta / omega * sine), decay * sine / omega],
            [-decay * natural**2 * sine / omega, decay * (cosine - eta / omega * sine)],
        ]
        return transition, [numpy.ones_like(natural), natural**2]


_VARIANCES = {"variance": SQUARED, "white": SQUARED}

AR1_KIND = ErrorModelKind(AR1, "ar1", {**_VARIANCES, "correlation_time": "s"})
MATERN32_KIND = ErrorModelKind(Matern32, "matern32", {**_VARIANCES, "correlation_time": "s"})
DAMPED_COSINE_KIND = ErrorModelKind(DampedCosine, "damped_cosine", {**_VARIANCES, "frequency": "Hz", "damping": ""})
