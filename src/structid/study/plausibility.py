"""Plausibility of model and measurement before any long run, which reveals wrong units."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.core.errors import Status
from structid.core.units import STANDARD_GRAVITY, factor
from structid.figures import response as figures
from structid.ground_motion.excitation import DisplacementHistory
from structid.ground_motion.record import GroundMotion
from structid.inference.validation.recorded_faults import clipped, gap, questions_of_the_measurement
from structid.inference.validation.side_by_side import SideBySide
from structid.models.hysteretic.prior_checks import unstable_in_words, unstable_share
from structid.models.integration_error import IntegrationError, integration_error
from structid.models.traceable import TraceableModel
from structid.probability.designs import Design
from structid.study.building.built_study import BuiltStudy

PRIOR_DRAWS = 1024
"""Draws of the priors for derived quantities."""

LARGEST_PGA = 5.0
"""Largest plausible ground acceleration [g]: more than the 4.4 g (vector sum) at IWTH25 in Iwate-Miyagi in 2008."""

FREQUENCIES = (0.03, 300.0)
"""Range of the lowest natural frequency [Hz] of test structures: from a suspension bridge to a stiff small specimen."""

BETWEEN = 0.25
"""Prior probability of each parameter at the point run between two runs of one point."""

SAME = 1e-6
"""Difference of two runs of one point, relative to the peak, that may be rounding in another order of summation."""


@dataclass(frozen=True)
class Plausibility:
    """Comparison of a run at the priors' medians with the measurement."""

    said: tuple[str, ...]  # findings, one sentence each
    questions: tuple[str, ...]  # probable mistakes, one sentence each
    # For each observation whose simulation succeeded, model and measurement channel by channel, for `plot`
    pairs: tuple[tuple[SideBySide, ...], ...] = field(default=(), repr=False)

    def plot(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Draw each measurement with its record and the model's response at the priors' medians."""
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
                [(values, *index) for values, index in zip(shown[0], places, strict=True)],
                shown[1],
                title=f"Measured on {record.name}" if record.name else "",
                save=name,
            )
            written.append(name.with_suffix(".png"))
        return written


def plausibility(study: BuiltStudy, tell: Callable[[str], None] | None = None) -> Plausibility:
    """Compare the response at the priors' medians with each measured history; see `SideBySide`."""
    questions = _of_the_records(study)
    if study.posterior is None:
        return Plausibility((), tuple(questions))
    findings: list[str] = []

    def say(*sentences: str) -> None:
        findings.extend(sentences)
        if tell is not None:
            for sentence in sentences:
                tell(sentence)

    medians = study.model.parameters(_point(study, 0.5))
    say(*([] if study.loop is None else [str(study.loop)]), *_of_the_priors(study))
    unstable = unstable_in_words(unstable_share(study.space, study.model))
    questions += [unstable] if unstable else []
    for error in _errors_of_the_integration(study, medians):
        say(*([] if error.too_large else [str(error)]))
        questions += [error.question] if error.too_large else []
    questions += _of_the_frequency(study, medians)
    compared: list[tuple[SideBySide, ...]] = []
    for observation in study.posterior.observations:
        questions += questions_of_the_measurement(observation, study.model.channel_units)
        run = study.model.simulate(medians, observation.record)
        if not run.done[0]:
            who = "structure" if run.status[0] == Status.STRUCTURE_FAILED else "model"
            reason = run.reasons[0].rstrip(".")
            questions.append(
                f"At the priors' medians the {who} fails on {observation.record.name}: {reason}. Are priors and units right?"
            )
            continue
        pairs = SideBySide.of({c: run.channel(c)[0] for c in run.channels}, run.units, observation)
        compared.append(pairs)
        for pair in pairs:
            say(f"At the priors' medians the {pair.sentence}")
            questions += pair.questions.values() if np.ptp(pair.measured) > 0.0 else ()
    if compared and not study.model.batched:
        questions += _of_memory(study, compared[0])
    return Plausibility(tuple(findings), tuple(questions), tuple(compared))


def _point(study: BuiltStudy, probability: float) -> Design:
    """The point at which every parameter has this prior probability."""
    space = study.space
    return Design(space.from_uniform(np.full((1, space.dimension), probability)), space)


def _of_the_records(study: BuiltStudy) -> list[str]:
    """Faults that the ground motions show by themselves."""
    measured = [o.record for o in study.posterior.observations] if study.posterior is not None else []
    records = {
        id(r): r for r in (*measured, *study.campaign_records, *study.other_records) if isinstance(r, GroundMotion)
    }
    questions = []
    for record in records.values():
        name = f"record {record.name}" if record.name else "record"
        if record.pga > LARGEST_PGA * STANDARD_GRAVITY:
            questions.append(
                f"The {name} has a PGA of {record.pga / STANDARD_GRAVITY:.3g} g, more than any ground has shown (4.4 g). "
                "Is the unit of its file right? A specimen at a reduced scale may see more."
            )
        questions += [gap(name, record.values, record.dt), clipped(name, record.values, record.unit)]
    return [question for question in questions if question]


def _of_the_frequency(study: BuiltStudy, theta: np.ndarray) -> list[str]:
    """Whether the natural frequency is plausible: a forgotten unit makes a stiffness a million times too small."""
    frequency = study.model.natural_frequency(theta)
    assert study.posterior is not None
    shaken = any(not isinstance(o.record, DisplacementHistory) for o in study.posterior.observations)
    if frequency is None or not shaken or FREQUENCIES[0] <= float(frequency[0]) <= FREQUENCIES[1]:
        return []
    return [
        f"At the priors' medians the lowest natural frequency is {float(frequency[0]):.2g} Hz, which no structure has. Are mass "
        "and stiffness in the units you mean, and a number without a unit in SI?"
    ]


def _errors_of_the_integration(study: BuiltStudy, theta: np.ndarray) -> list[IntegrationError]:
    """The largest integration error over the records; none for an external model."""
    if study.posterior is None or not isinstance(study.model, TraceableModel):
        return []
    records = {o.record.content_hash: o.record for o in study.posterior.observations}.values()
    errors = [integration_error(study.model, theta, record) for record in records]
    return sorted((e for e in errors if e is not None), key=lambda e: e.error)[-1:]


def _of_memory(study: BuiltStudy, first: tuple[SideBySide, ...]) -> list[str]:
    """Whether an external model repeats its result after another point, which a certificate requires."""
    record = first[0].record
    study.model.simulate(study.model.parameters(_point(study, BETWEEN)), record)
    again = study.model.simulate(study.model.parameters(_point(study, 0.5)), record)
    if not again.done[0]:
        return [f"Run twice at the priors' medians, the model finishes once: {again.reasons[0]}"]
    pairs = SideBySide.of({c: again.channel(c)[0] for c in again.channels}, again.units, first[0].observation)
    differences = [
        float(np.abs(one.modelled - other.modelled).max()) / float(np.abs(one.modelled).max() or 1.0)
        for one, other in zip(first, pairs, strict=True)
    ]
    if max(differences) < SAME:
        return []
    return [
        f"Run twice at the priors' medians, with another point between, the model differs by {max(differences):.2g} of its peak. "
        "Does it keep something of the run before, or draw random numbers? Start each run anew, with a fixed seed."
    ]


def _of_the_priors(study: BuiltStudy) -> list[str]:
    """Derived quantities under the priors, such as a yield displacement."""
    draws = study.model.parameters(study.space.sample(PRIOR_DRAWS, 0, "sobol"))
    findings = []
    for name, (values, unit) in study.model.derived_quantities(draws).items():
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95), method="inverted_cdf") / factor(unit)
        upper = f"{low:.3g} to {high:.3g} {unit}" if np.isfinite(high) else f"above {low:.3g} {unit}"
        findings.append(f"By the priors the {name} is {upper} with 90 % probability, its median {middle:.3g} {unit}.")
    return findings
