"""Delay compensation: commands that allow for the delay of a transfer system.

Sources: T. Horiuchi, M. Inoue, T. Konno & Y. Namita (1999, Earthq. Eng. Struct. Dyn. 28, 1121) for the polynomial; Y.
Chae, K. Kazemibidokhti & J. M. Ricles (2013, Earthq. Eng. Struct. Dyn. 42, 1697) for the adaptive time series. The
docstring of `AdaptiveTimeSeries` describes the modifications.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from math import comb

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.validation import check_arguments

CUBIC_SLOPE, CUBIC_CURVATURE = np.array([11.0, -18.0, 9.0, -2.0]) / 6.0, np.array([2.0, -5.0, 4.0, -1.0])
"""Weights of the first and second derivative of a cubic at the last of four points; unit spacing, last point first."""


class Compensator(ABC):
    """State of a delay compensation during one test."""

    @abstractmethod
    def commands(self, targets: Float[np.ndarray, "sample channel"]) -> Float[np.ndarray, "sample channel"]:
        """Convert targets of the specimen to commands for the actuators."""

    def observe(  # noqa: B027 - most do not adapt
        self, commands: Float[np.ndarray, "sample channel"], measured: Float[np.ndarray, "sample channel"]
    ) -> None:
        """Adapt the compensation to the measured response."""


class Compensation(ABC):
    """A compensation method with its settings.

    Attributes
    ----------
    learns : bool
        Whether it needs a measured displacement at every controller step, which only a continuous motion provides.
    """

    learns: bool = False

    @abstractmethod
    def begin(self, channels: int, controller_step: float, time_scale: float) -> Compensator:
        """Start the compensation for a test.

        Parameters
        ----------
        channels : int
            Number of channels of the specimen.
        controller_step : float
            T_c [s] of wall time.
        time_scale : float
            λ, ratio of wall time to simulated time.

        Returns
        -------
        Compensator
            Compensator in its initial state.
        """

    @abstractmethod
    def gain(self, omega: float, delay: float) -> complex:
        """Return the gain c/u, the ratio of the command to the target for a harmonic motion.

        Compensation and a delay of τ multiply the specimen's force by G = gain · e^(−iωτ). This adds Δζ ≈ p Im G/2 to
        the damping ratio of a mode if the specimen provides the fraction p of the modal stiffness.

        Parameters
        ----------
        omega : float
            ω in wall time [rad/s].
        delay : float
            τ of the transfer system [s]; an adaptive compensation identifies it.

        Returns
        -------
        complex
            Gain c/u.
        """


@check_arguments
@dataclass(frozen=True)
class PolynomialExtrapolation(Compensation):
    """Extrapolation of a polynomial through past targets by the delay: c(t) = Σ_i a_i u(t − i τ), i = 0 … n.

    a_i = (−1)^i C(n+1, i+1); for n = 3: 4, −6, 4, −1. The loop factor is G = 1 − (1 − e^(−iθ))^(n+1) with θ = ωτ. This
    factor adds damping for θ up to π/2 (n = 3) or π/3 (n = 2); for n = 0 and 1, it removes damping. Noise grows by
    √Σ a_i², 8.3 for n = 3.

    Parameters
    ----------
    delay : float
        τ [s] of wall time.
    order : int
        Order n, from 0 to 5.

    Examples
    --------
    >>> import structid as si
    >>> si.PolynomialExtrapolation(delay=0.017).weights.tolist()
    [4.0, -6.0, 4.0, -1.0]
    """

    delay: float
    order: int = 3

    def __post_init__(self) -> None:
        if not (np.isfinite(self.delay) and self.delay > 0.0):
            raise InputError("PolynomialExtrapolation.delay", f"{self.delay!r}", "a positive time in seconds")
        if self.order not in range(6):
            raise InputError("PolynomialExtrapolation.order", f"{self.order!r}", "a whole number from 0 to 5")

    @property
    def weights(self) -> np.ndarray:
        """a_i, shape (n + 1,)."""
        return np.array([(-1.0) ** i * comb(self.order + 1, i + 1) for i in range(self.order + 1)])

    def begin(self, channels: int, controller_step: float, time_scale: float) -> Compensator:
        """Start the compensation for a test; see `Compensation.begin`."""
        return _Extrapolator(self.weights, self.delay / controller_step, channels)

    def gain(self, omega: float, delay: float) -> complex:
        """Return the gain Σ_k a_k e^(−ikωτ′), where `delay` in the settings is τ′; see `Compensation.gain`."""
        turns = np.exp(-1j * omega * self.delay * np.arange(self.order + 1))
        return complex(self.weights @ turns)


class _Extrapolator(Compensator):
    """Extrapolation Σ a_i u(t − i τ) during a test."""

    def __init__(self, weights: np.ndarray, spacing: float, channels: int) -> None:
        self.weights, self.past = weights, _Past(spacing * np.arange(len(weights)), channels)

    def commands(self, targets: np.ndarray) -> np.ndarray:
        """Extrapolate the targets; see `Compensator.commands`."""
        return np.asarray(np.einsum("i,tic->tc", self.weights, self.past.before(targets)))


class _Past:
    """Buffer of past targets, which are zero before the test and interpolated linearly between controller steps."""

    def __init__(self, lags: np.ndarray, channels: int) -> None:
        self.lags, self.kept = lags, np.zeros((int(np.ceil(lags[-1])) + 2, channels))

    def before(self, targets: np.ndarray) -> np.ndarray:
        """Return the targets `lags` controller steps before each new target, shape (sample, lag, channel)."""
        first = len(self.kept)
        history = np.concatenate([self.kept, targets])
        self.kept = history[len(targets) :]
        places = first + np.arange(len(targets))[:, None] - self.lags
        low = np.floor(places).astype(int)
        share = (places - low)[..., None]
        return np.asarray((1.0 - share) * history[low] + share * history[np.minimum(low + 1, len(history) - 1)])


@check_arguments
@dataclass(frozen=True)
class AdaptiveTimeSeries(Compensation):
    """A Taylor series whose coefficients are estimated during the test: c = a₀ u + a₁ u′ + ½ a₁² u″.

    In a moving window, a least-squares fit of past commands to measured displacements and their rates gives a₀ and a₁.
    The published method is sensitive to noise: with 5 µm of noise and λ = 10, it estimates a delay of 5 ms instead of
    29 ms. Commands and measurements therefore pass through the same causal Butterworth filter, whose delay cancels in
    the fit. The coefficient of u″ follows from a₁. Window and filter are defined in *simulated* time. u′ and u″ are
    derivatives of the cubic through four values, spaced by the measured delay. Differences of controller steps would
    turn the small jumps at the end of coarse steps into spikes.

    Parameters
    ----------
    delay : float
        Measured delay of the transfer system, the initial estimate [s] of wall time.
    window : float
        Length of the window [s] of simulated time.
    cutoff : float
        Cut-off frequency of the filter [Hz] in simulated time.
    amplitudes : tuple of float
        Allowed range of a₀.

    Examples
    --------
    >>> import structid as si
    >>> compensation = si.AdaptiveTimeSeries(delay=0.012)
    >>> compensation.window
    0.5
    """

    delay: float
    window: float = 0.5
    cutoff: float = 20.0
    amplitudes: tuple[float, float] = (0.7, 1.3)

    learns = True

    def __post_init__(self) -> None:
        for name in ("delay", "window", "cutoff"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"AdaptiveTimeSeries.{name}", f"{value!r}", "a positive number")
        low, high = self.amplitudes
        if not 0.0 < low <= 1.0 <= high:
            raise InputError("AdaptiveTimeSeries.amplitudes", f"{self.amplitudes!r}", "a range around 1")

    def begin(self, channels: int, controller_step: float, time_scale: float) -> Compensator:
        """Start the compensation for a test; see `Compensation.begin`."""
        return _Adapting(self, channels, controller_step, time_scale)

    def gain(self, omega: float, delay: float) -> complex:
        """Return the gain 1 + τ D₁(ω) + ½ τ² D₂(ω) after the delay has been identified; see `Compensation.gain`."""
        spacing = self.delay
        turns = np.exp(-1j * omega * spacing * np.arange(4))
        share = delay / spacing
        return complex(1.0 + share * (CUBIC_SLOPE @ turns) + 0.5 * share**2 * (CUBIC_CURVATURE @ turns))


class _Adapting(Compensator):
    """State of an adaptive time series during a test, with separate coefficients for each channel."""

    def __init__(self, settings: AdaptiveTimeSeries, channels: int, step: float, scale: float) -> None:
        self.settings, self.step = settings, step
        self.coefficients = np.tile([1.0, settings.delay], (channels, 1))
        """a₀, and a₁ [s], shape (channel, 2)."""
        rate = scale / step  # samples per second of simulated time
        length = max(round(settings.window * rate), 3)
        self.window: deque[tuple[np.ndarray, np.ndarray, np.ndarray]] = deque(maxlen=length)
        # The cut-off must be below the Nyquist frequency.
        corner = min(settings.cutoff / (0.5 * rate), 0.99)
        self.numerator, self.denominator = scipy.signal.butter(2, corner)
        self.memories = np.zeros((2, channels, 2))
        self.sums = np.zeros((channels, 5))
        self.last_filtered = np.zeros(channels)
        self.past = _Past(settings.delay / step * np.arange(4), channels)

    def commands(self, targets: np.ndarray) -> np.ndarray:
        """Extrapolate with the current coefficients; see `Compensator.commands`."""
        before, spacing = self.past.before(targets), self.settings.delay
        rate = np.einsum("i,tic->tc", CUBIC_SLOPE, before) / spacing
        curvature = np.einsum("i,tic->tc", CUBIC_CURVATURE, before) / spacing**2
        amplitude, lead = self.coefficients.T
        return np.asarray(amplitude * targets + lead * rate + 0.5 * lead**2 * curvature)

    def observe(self, commands: np.ndarray, measured: np.ndarray) -> None:
        """Refit the coefficients to the data in the window; see `Compensator.observe`."""
        for command, position in zip(commands, measured, strict=True):
            filtered = self._filtered(0, command)
            filtered_position = self._filtered(1, position)
            rate = (filtered_position - self.last_filtered) / self.step
            self.last_filtered = filtered_position
            if len(self.window) == self.window.maxlen:
                self.sums -= self._products(*self.window[0])
            self.window.append((filtered, filtered_position, rate))
            self.sums += self._products(filtered, filtered_position, rate)
        if len(self.window) == self.window.maxlen:
            self._refit()

    def _filtered(self, which: int, value: np.ndarray) -> np.ndarray:
        """Pass one value through a filter (transposed direct form)."""
        memory, b, a = self.memories[which], self.numerator, self.denominator
        out = b[0] * value + memory[:, 0]
        memory[:, 0] = b[1] * value - a[1] * out + memory[:, 1]
        memory[:, 1] = b[2] * value - a[2] * out
        return np.asarray(out)

    @staticmethod
    def _products(command: np.ndarray, seen: np.ndarray, rate: np.ndarray) -> np.ndarray:
        return np.stack([seen * seen, seen * rate, rate * rate, seen * command, rate * command], axis=1)

    def _refit(self) -> None:
        """Solve the normal equations of each channel; a channel that has not moved keeps its coefficients."""
        uu, uv, vv, uc, vc = self.sums.T
        determinant = uu * vv - uv * uv
        for channel in np.flatnonzero(determinant > 1e-9 * uu * vv):
            amplitude = (vv[channel] * uc[channel] - uv[channel] * vc[channel]) / determinant[channel]
            amplitude = float(np.clip(amplitude, *self.settings.amplitudes))
            lead = (vc[channel] - amplitude * uv[channel]) / vv[channel]
            self.coefficients[channel] = amplitude, max(lead, 0.0)
