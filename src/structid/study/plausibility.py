"""Whether model and measurement are of similar size, before any long run: a wrong unit shows here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.errors import Status
from structid.models.prior_checks import TOLERATED, unstable_share
from structid.probability.space import Design
from structid.study.building.built_study import BuiltStudy
from structid.units import factor

WRONG_BY = 10.0
"""Ratio of peaks beyond which a unit is likely to be wrong."""

OUT_OF_TUNE = 3.0
"""The same of main frequencies: nine times the stiffness, or the mass."""

OFFSET = 2.0
"""Mean of a measurement over its standard deviation, beyond which it is likely to have an offset."""

OPPOSITE = -0.6
"""Correlation of model and measurement, below which a sign is likely to be reversed."""


@dataclass(frozen=True)
class Plausibility:
    """What a run at the priors' medians shows beside the measurement.

    Parameters
    ----------
    said : tuple of str
        What was found, a sentence each.
    questions : tuple of str
        What is probably a mistake, a sentence each.
    """

    said: tuple[str, ...]
    questions: tuple[str, ...]


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
    said: list[str] = []
    questions = _stability(study)
    for observation in study.posterior.observations:
        run = study.model.simulate(study.model.parameters(medians), observation.record)
        if not run.done[0]:
            who = "structure" if run.status[0] == Status.STRUCTURE_FAILED else "model"
            questions.append(
                f"At the priors' medians the {who} fails on {observation.record.name}: {run.reasons[0]} Are priors and units right?"
            )
            continue
        for i, channel in enumerate(observation.channels):
            pair = _Pair(
                channel,
                run.units[channel].display,
                run.channel(channel)[0],
                observation.values[:, i],
                observation.record.dt,
                observation.offset is not None,
            )
            said.append(pair.sentence)
            questions += pair.questions
    return Plausibility(tuple(said), tuple(questions))


def _stability(study: BuiltStudy) -> list[str]:
    """Whether |γ| may exceed β, by the prior."""
    free = [name for name in ("beta", "gamma", "gamma_ratio") if name in study.space.all_names]
    draws = study.space.sample(512, 0, "sobol").columns(free)
    values = dict(zip(free, np.asarray(draws).T, strict=True))
    if "gamma" in values and "beta" not in values and isinstance(beta := getattr(study.model, "beta", None), float):
        values["beta"] = np.full(len(values["gamma"]), beta)
    share = unstable_share(values)
    if share <= TOLERATED:
        return []
    return [
        f"In {share:.0%} of the prior |gamma| exceeds beta, where the response need not stay bounded. Is that meant? "
        "gamma_ratio from -1 to 1 keeps it bounded."
    ]


@dataclass(frozen=True, eq=False)
class _Pair:
    """One channel at the priors' medians, and as it was measured."""

    channel: str
    unit: str
    modelled: np.ndarray
    measured: np.ndarray
    dt: float
    offset_is_unknown: bool

    @property
    def _peaks(self) -> list[float]:
        return [float(np.abs(values).max()) for values in (self.modelled, self.measured)]

    @property
    def _frequencies(self) -> list[float]:
        return [_main_frequency(values, self.dt) for values in (self.modelled, self.measured)]

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
                f"The {self.channel} of model and measurement differ by more than ten times. Are all units right?"
            )
        low, high = sorted(self._frequencies)
        if high > OUT_OF_TUNE * max(low, 1.0 / (self.dt * len(self.measured))):
            found.append(
                f"The model's {self.channel} is mainly at {self._frequencies[0]:.2g} Hz, the measured one at "
                f"{self._frequencies[1]:.2g} Hz. Are mass and stiffness in the units you mean?"
            )
        mean, spread = float(self.measured.mean()), float(self.measured.std())
        if abs(mean) > OFFSET * spread and not self.offset_is_unknown:
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
        return found


def _main_frequency(values: np.ndarray, dt: float) -> float:
    """Where the amplitude spectrum is largest [Hz]."""
    amplitude = np.abs(np.fft.rfft(values - values.mean()))
    return float(np.fft.rfftfreq(len(values), dt)[int(np.argmax(amplitude))])
