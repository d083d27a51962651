"""Comparison of model and measurement before any long run, which reveals wrong units, reversed signs and time shifts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.channels import ChannelUnit
from structid.core.units import factor
from structid.ground_motion.excitation import Excitation
from structid.inference.prediction.best_prediction import comparable
from structid.observation import Observation

OUT_OF_TUNE = 3.0
"""Ratio of main frequencies above which a unit is suspect; a ratio of 3 is nine times the stiffness or the mass."""

SHARED = 0.1
"""Relative spectral amplitude near the other history's main frequency that indicates a common mode."""

FEWEST_CYCLES = 3
"""Minimum number of cycles of a main frequency; fewer indicate a drift, for example to a residual displacement."""

NEAR = 0.2
"""Relative half-width of the neighbourhood of a frequency."""

OPPOSITE = -0.6
"""Correlation of model and measurement below which a sign is probably reversed."""

ALIKE, UNLIKE = 0.7, 0.5
"""Smallest correlation with a probably real time shift, and largest fraction of it that remains without the shift."""


@dataclass(frozen=True, eq=False)
class SideBySide:
    """One channel of a response, modelled and measured."""

    channel: str  # name of the channel
    unit: str  # display unit
    modelled: Float[np.ndarray, " time"]  # modelled history in SI, as the instrument would show it
    measured: Float[np.ndarray, " time"]  # measured history in SI
    observation: Observation  # the observation

    @classmethod
    def of(
        cls, response: Mapping[str, np.ndarray], units: Mapping[str, ChannelUnit], observation: Observation
    ) -> tuple[SideBySide, ...]:
        """Pair a response with an observation, channel by channel."""
        gain = 1.0 if observation.gain is None else float(observation.gain.quantile(np.array([0.5]))[0])
        gain *= observation.instrument.signs[0]
        return tuple(
            cls(
                channel,
                units[channel].display,
                gain * np.asarray(observation.instrument.sampled(np.asarray(response[channel]))),
                observation.values[:, i],
                observation,
            )
            for i, channel in enumerate(observation.channels)
        )

    @property
    def _about_means(self) -> tuple[np.ndarray, np.ndarray]:
        """Model and measurement without the model where a value is missing, both about the mean of the measured values."""
        known = np.isfinite(self.measured)
        modelled, measured = (np.where(known, x - x[known].mean(), 0.0) for x in (self.modelled, self.measured))
        return modelled, measured

    @property
    def record(self) -> Excitation:
        """The common excitation."""
        return self.observation.record

    @property
    def _peaks(self) -> list[float]:
        known = np.isfinite(self.measured)
        return [float(np.abs(values[known]).max()) for values in (self.modelled, self.measured)]

    @property
    def _frequencies(self) -> list[float]:
        return [_main_frequency(values, self.observation.step) for values in self._about_means]

    @property
    def sentence(self) -> str:
        """Sentence on the peaks and main frequencies of model and measurement, without "the" before its first word."""
        shown = [
            f"{peak / factor(self.unit):.3g} {self.unit} (mainly at {frequency:.2g} Hz)"
            for peak, frequency in zip(self._peaks, self._frequencies, strict=True)
        ]
        return f"model's {self.channel} reaches {shown[0]}, the measured {self.channel} {shown[1]}."

    @property
    def questions(self) -> dict[str, str]:
        """Mismatches of model and measurement, one sentence each on amplitude, frequency, sign and time base."""
        questions = {
            "size": self._of_size,
            "frequency": self._of_frequency,
            "sign": self._of_sign,
            "clock": self._of_clock,
        }
        return {kind: sentence for kind, sentence in questions.items() if sentence}

    @property
    def _of_size(self) -> str:
        if comparable(*self._peaks):
            return ""
        return (
            f"The model's peak {self.channel} is {self._peaks[0] / self._peaks[1]:.2g} times the measured peak. Are all units "
            "right? Numbers without a unit are in SI."
        )

    @property
    def _of_frequency(self) -> str:
        """Question if the main frequencies differ and neither spectrum contains the other's main frequency."""
        modelled, measured = self._frequencies
        low, high = sorted((modelled, measured))
        if high <= OUT_OF_TUNE * max(low, 1.0 / (self.observation.step * len(self.measured))):
            return ""
        shares = [
            _share_near(values, self.observation.step, frequency)
            for values, frequency in zip(self._about_means, (measured, modelled), strict=True)
        ]
        if max(shares) > SHARED:
            return ""
        return (
            f"The model's {self.channel} is mainly at {modelled:.2g} Hz, the measured {self.channel} at {measured:.2g} "
            "Hz. Are mass and stiffness in the intended units?"
        )

    @property
    def _sign_known(self) -> bool:
        """Whether the prior of the gain allows only one sign."""
        gain = self.observation.gain
        of_gain = gain is None or float(gain.cdf(np.zeros(1))[0]) in (0.0, 1.0)
        return of_gain and len(self.observation.instrument.signs) == 1

    @property
    def _together(self) -> float:
        """Correlation of model and measurement; 0 if one of them is constant."""
        modelled, measured = self._about_means
        moving = bool(measured.std() and modelled.std())
        return float(np.corrcoef(modelled, measured)[0, 1]) if moving else 0.0

    @property
    def _of_sign(self) -> str:
        together = self._together
        if together >= OPPOSITE or not self._sign_known:
            return ""
        other = "normal" if self.observation.polarity == "reversed" else "reversed"
        return (
            f"Model and measured {self.channel} have a correlation of {together:.2f}: they nearly agree with the sign reversed. "
            f"Does the instrument's positive direction match the record's? If not, set polarity = '{other}'."
        )

    @property
    def _of_clock(self) -> str:
        """Question if model and measurement agree only after a time shift; a reversed sign is not a shift."""
        if self._together < OPPOSITE:
            return ""
        shift, shifted, together = _best_shift(*self._about_means)
        if self.observation.time_shift is not None or shifted < ALIKE or together > UNLIKE * shifted:
            return ""
        seconds = shift * self.observation.step
        return (
            f"Model and measured {self.channel} have a correlation of {together:.2f}, but of {shifted:.2f} if the measurement is "
            f"moved {abs(seconds):.3g} s {'back' if seconds > 0 else 'ahead'}. Do measurement and record have the same time base? "
            f"If not, set 'time_shift' {abs(seconds):.3g} s {'higher' if seconds > 0 else 'lower'} than now, or to a prior around "
            "this value."
        )


def _best_shift(modelled: np.ndarray, measured: np.ndarray) -> tuple[int, float, float]:
    """Delay of the measurement [samples] for the largest correlation, that correlation, and the correlation without a shift."""
    first, second = (values - values.mean() for values in (modelled, measured))
    norm = np.linalg.norm(first) * np.linalg.norm(second)
    if norm == 0.0:
        return 0, 0.0, 0.0
    correlation = scipy.signal.correlate(second, first) / norm
    shifts = scipy.signal.correlation_lags(len(second), len(first))
    best = int(np.argmax(correlation))
    return int(shifts[best]), float(correlation[best]), float(correlation[shifts == 0][0])


def _spectrum(values: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and amplitudes of the Fourier spectrum, with the mean removed."""
    return np.fft.rfftfreq(len(values), dt), np.abs(np.fft.rfft(values - values.mean()))


def _main_frequency(values: np.ndarray, dt: float) -> float:
    """Frequency of the largest amplitude [Hz]; if that is a drift, from the spectrum of the time derivative."""
    frequencies, amplitude = _spectrum(values, dt)
    largest = int(np.argmax(amplitude))
    if largest < FEWEST_CYCLES:
        largest = int(np.argmax(frequencies * amplitude))
    return float(frequencies[largest])


def _share_near(values: np.ndarray, dt: float, frequency: float) -> float:
    """Largest amplitude near a frequency [Hz] relative to the largest amplitude; 0 for a constant history."""
    frequencies, amplitude = _spectrum(values, dt)
    near = np.abs(frequencies - frequency) <= max(NEAR * frequency, 1.0 / (dt * len(values)))
    return float(amplitude[near].max() / amplitude.max()) if amplitude.any() else 0.0
