"""Whether model and measurement are of similar size, before any long run: a wrong unit shows here."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import scipy

from structid.errors import Status
from structid.figures import response as figures
from structid.ground_motion.excitation import Excitation
from structid.models.prior_checks import unstable_in_words, unstable_share
from structid.observation import Observation
from structid.probability.designs import Design
from structid.study.building.built_study import BuiltStudy
from structid.units import factor

WRONG_BY = 8.0
"""Ratio of peaks beyond which a unit is likely to be wrong: g for m/s² is a factor of 9.8."""

OUT_OF_TUNE = 3.0
"""The same of main frequencies: nine times the stiffness, or the mass."""

OFFSET = 2.0
"""Mean of a measurement over its standard deviation, beyond which it is likely to have an offset."""

OPPOSITE = -0.6
"""Correlation of model and measurement, below which a sign is likely to be reversed."""

ALIKE, UNLIKE = 0.7, 0.5
"""Correlation after a shift in time above which it is likely to be real, if without it there is less than this share of it."""

PRIOR_DRAWS = 1024
"""Draws of the priors that say what follows from them."""


@dataclass(frozen=True)
class Plausibility:
    """What a run at the priors' medians shows beside the measurement.

    Parameters
    ----------
    said : tuple of str
        What was found, a sentence each.
    questions : tuple of str
        What is probably a mistake, a sentence each.
    pairs : tuple of tuple
        For each observation whose simulation succeeded, model and measurement channel by channel, for `plot`.
    """

    said: tuple[str, ...]
    questions: tuple[str, ...]
    pairs: tuple[tuple[_Pair, ...], ...] = field(default=(), repr=False)

    def plot(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Draw each measurement on its record, with the model's response at the priors' medians.

        Parameters
        ----------
        folder : path-like
            Where a PNG and a PDF are written for each observation; made if it is not there.

        Returns
        -------
        list of Path
            The PNG files.
        """
        Path(folder).mkdir(parents=True, exist_ok=True)
        written = []
        for number, pairs in enumerate(self.pairs, start=1):
            record, places = pairs[0].record, [(p.channel, p.unit) for p in pairs]
            shown = [
                [values / factor(unit) for values, (_, unit) in zip(columns, places, strict=True)]
                for columns in ([p.measured for p in pairs], [p.modelled for p in pairs])
            ]
            name = Path(folder) / f"measurement_{number}"
            figures.measurement_on_record(
                record.time,
                (record.values, record.kind, record.unit),
                [(values, *place) for values, place in zip(shown[0], places, strict=True)],
                shown[1],
                title=f"Measured on {record.name}" if record.name else "",
                save=name,
            )
            written.append(name.with_suffix(".png"))
        return written


def plausibility(study: BuiltStudy) -> Plausibility:
    """Compare the response at the priors' medians with each measured history: its peak, its spectrum, its sign, its offset.

    Parameters
    ----------
    study : BuiltStudy
        The study.

    Returns
    -------
    Plausibility
        Empty for a study without an observation.
    """
    if study.posterior is None:
        return Plausibility((), ())
    space = study.space
    medians = Design(space.from_uniform(np.full((1, space.dimension), 0.5)), space)
    said: list[str] = _of_the_priors(study)
    unstable = unstable_in_words(unstable_share(space, study.model))
    questions = [unstable] if unstable else []
    compared: list[tuple[_Pair, ...]] = []
    for observation in study.posterior.observations:
        run = study.model.simulate(study.model.parameters(medians), observation.record)
        if not run.done[0]:
            who = "structure" if run.status[0] == Status.STRUCTURE_FAILED else "model"
            questions.append(
                f"At the priors' medians the {who} fails on {observation.record.name}: {run.reasons[0]} Are priors and units right?"
            )
            continue
        pairs = tuple(
            _Pair(channel, run.units[channel].display, run.channel(channel)[0], observation.values[:, i], observation)
            for i, channel in enumerate(observation.channels)
        )
        compared.append(pairs)
        for pair in pairs:
            said.append(pair.sentence)
            questions += pair.questions
    return Plausibility(tuple(said), tuple(questions), tuple(compared))


@dataclass(frozen=True, eq=False)
class _Pair:
    """One channel at the priors' medians, and as it was measured."""

    channel: str
    unit: str
    modelled: np.ndarray
    measured: np.ndarray
    observation: Observation

    @property
    def record(self) -> Excitation:
        """What drove both."""
        return self.observation.record

    @property
    def _peaks(self) -> list[float]:
        return [float(np.abs(values).max()) for values in (self.modelled, self.measured)]

    @property
    def _frequencies(self) -> list[float]:
        return [_main_frequency(values, self.record.dt) for values in (self.modelled, self.measured)]

    @property
    def sentence(self) -> str:
        """Peaks and main frequencies of both."""
        shown = [
            f"{peak / factor(self.unit):.3g} {self.unit} (mainly at {frequency:.2g} Hz)"
            for peak, frequency in zip(self._peaks, self._frequencies, strict=True)
        ]
        return f"At the priors' medians the model's {self.channel} reaches {shown[0]}, the measured one {shown[1]}."

    @property
    def questions(self) -> list[str]:
        """What does not fit."""
        found = []
        if max(self._peaks) > WRONG_BY * min(self._peaks):
            found.append(
                f"The {self.channel} of the model is {self._peaks[0] / self._peaks[1]:.2g} times the measured one. Are all units "
                "right, and a number without a unit in SI?"
            )
        low, high = sorted(self._frequencies)
        if high > OUT_OF_TUNE * max(low, 1.0 / (self.record.dt * len(self.measured))):
            found.append(
                f"The model's {self.channel} is mainly at {self._frequencies[0]:.2g} Hz, the measured one at "
                f"{self._frequencies[1]:.2g} Hz. Are mass and stiffness in the units you mean?"
            )
        mean, spread = float(self.measured.mean()), float(self.measured.std())
        if abs(mean) > OFFSET * spread and self.observation.offset is None:
            found.append(
                f"The measured {self.channel} has a mean of {mean / factor(self.unit):.3g} {self.unit}, {abs(mean) / spread:.1f} "
                "times its standard deviation. Is it an offset of the instrument? Then give 'offset' a prior, or take it out."
            )
        together = np.corrcoef(self.modelled, self.measured)[0, 1] if spread and self.modelled.std() else 0.0
        if together < OPPOSITE:
            found.append(
                f"Model and measured {self.channel} correlate by {together:.2f}: nearly the same with the sign reversed. Is "
                "the instrument's positive direction that of the record?"
            )
        return found + self._shift_questions()

    def _shift_questions(self) -> list[str]:
        """Whether model and measurement are alike after a shift in time, and not without."""
        shift, shifted, together = _best_shift(self.modelled, self.measured)
        if self.observation.time_shift is not None or shifted < ALIKE or together > UNLIKE * shifted:
            return []
        seconds = shift * self.record.dt
        return [
            f"Model and measured {self.channel} correlate by {together:.2f}, and by {shifted:.2f} if the measured one is moved "
            f"{abs(seconds):.3g} s {'back' if seconds > 0 else 'ahead'}. Does its clock begin with the record's? If not, "
            f"'time_shift' says what it shows then: {abs(seconds):.3g} s {'more' if seconds > 0 else 'less'} than now, or a prior "
            "about that."
        ]


def _of_the_priors(study: BuiltStudy) -> list[str]:
    """What the priors say of what follows from the parameters, such as a yield displacement."""
    draws = study.model.parameters(study.space.sample(PRIOR_DRAWS, 0, "sobol"))
    said = []
    for name, (values, unit) in study.model.derived_quantities(draws).items():
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95), method="inverted_cdf") / factor(unit)
        upper = f"{low:.3g} to {high:.3g} {unit}" if np.isfinite(high) else f"above {low:.3g} {unit}"
        said.append(f"By the priors the {name} is {upper} with 90 % probability, its median {middle:.3g} {unit}.")
    return said


def _best_shift(modelled: np.ndarray, measured: np.ndarray) -> tuple[int, float, float]:
    """Samples by which the measurement is late where both are most alike, their correlation there, and without a shift."""
    first, second = (values - values.mean() for values in (modelled, measured))
    norm = np.linalg.norm(first) * np.linalg.norm(second)
    if norm == 0.0:
        return 0, 0.0, 0.0
    correlation = scipy.signal.correlate(second, first) / norm
    shifts = scipy.signal.correlation_lags(len(second), len(first))
    best = int(np.argmax(correlation))
    return int(shifts[best]), float(correlation[best]), float(correlation[shifts == 0][0])


def _main_frequency(values: np.ndarray, dt: float) -> float:
    """Where the amplitude spectrum is largest [Hz]."""
    amplitude = np.abs(np.fft.rfft(values - values.mean()))
    return float(np.fft.rfftfreq(len(values), dt)[int(np.argmax(amplitude))])
