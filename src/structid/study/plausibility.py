"""Whether model and measurement are of similar size, before any long run: a wrong unit shows here."""

from __future__ import annotations

import numpy as np

from structid.errors import Status
from structid.probability.space import Design
from structid.study.building.built_study import BuiltStudy
from structid.units import factor

WRONG_BY = 10.0
"""Ratio of peaks beyond which a unit is likely to be wrong."""


def plausibility(study: BuiltStudy) -> list[str]:
    """Compare the response at the priors' medians with each measured history: its peak, and where its spectrum is largest.

    Parameters
    ----------
    study : BuiltStudy
        The study.

    Returns
    -------
    list of str
        A sentence for each measured channel; none for a study without an observation.
    """
    if study.posterior is None:
        return []
    space = study.space
    medians = Design(space.from_uniform(np.full((1, space.dimension), 0.5)), space)
    told = []
    for observation in study.posterior.observations:
        run = study.model.simulate(study.model.parameters(medians), observation.record)
        if run.status[0] == Status.STRUCTURE_FAILED:
            told.append(f"At the priors' medians the structure fails on {observation.record.name}: {run.reasons[0]}")
            continue
        if not run.done[0]:
            told.append(f"At the priors' medians the model fails on {observation.record.name}: {run.reasons[0]}")
            continue
        for i, channel in enumerate(observation.channels):
            told.append(
                _compared(
                    channel,
                    run.units[channel].display,
                    run.channel(channel)[0],
                    observation.values[:, i],
                    observation.record.dt,
                )
            )
    return told


def _compared(channel: str, unit: str, modelled: np.ndarray, measured: np.ndarray, dt: float) -> str:
    peaks = [float(np.abs(values).max()) for values in (modelled, measured)]
    shown = [
        f"{peak / factor(unit):.3g} {unit} (mainly at {_main_frequency(values, dt):.2g} Hz)"
        for peak, values in zip(peaks, (modelled, measured), strict=True)
    ]
    sentence = f"At the priors' medians the model's {channel} reaches {shown[0]}, the measured one {shown[1]}."
    wrong = max(peaks) > WRONG_BY * min(peaks)
    return sentence + (" Are all units right?" if wrong else "")


def _main_frequency(values: np.ndarray, dt: float) -> float:
    """Where the amplitude spectrum is largest [Hz]."""
    amplitude = np.abs(np.fft.rfft(values - values.mean()))
    return float(np.fft.rfftfreq(len(values), dt)[int(np.argmax(amplitude))])
