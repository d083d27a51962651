"""Plausibility checks of model and measurement before a long run; they reveal wrong units."""

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
"""Number of prior draws for derived quantities."""

LARGEST_PGA = 5.0
"""Largest plausible ground acceleration [g]: more than the 4.4 g (vector sum) at IWTH25 in Iwate-Miyagi in 2008."""

FREQUENCIES = (0.03, 300.0)
"""Plausible range of the lowest natural frequency [Hz]: from a suspension bridge to a small, stiff specimen."""

BETWEEN = 0.25
"""Prior quantile of all parameters for the run that separates two runs at the prior medians."""

SAME = 1e-6
"""Largest difference between two runs at the same point, relative to the peak, that rounding can cause."""


@dataclass(frozen=True)
class Plausibility:
    """Comparison of a run at the prior medians with the measurement."""

    findings: tuple[str, ...]  # sentences
    questions: tuple[str, ...]  # questions about probable mistakes
    # Model and measurement of each channel, for each observation whose simulation succeeded; used by `plot`
    pairs: tuple[tuple[SideBySide, ...], ...] = field(default=(), repr=False)

    def plot(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Draw each measurement with its record and the model response at the prior medians."""
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
                measured_time=pairs[0].observation.time,
                title=f"Measured on {record.name}" if record.name else "",
                save=name,
            )
            written.append(name.with_suffix(".png"))
        return written


def plausibility(study: BuiltStudy, show: Callable[[str], None] | None = None) -> Plausibility:
    """Compare the response at the prior medians with each measured history; see `SideBySide`."""
    questions = _of_the_records(study)
    if study.posterior is None:
        return Plausibility((), tuple(questions))
    findings: list[str] = []

    def report(*sentences: str) -> None:
        findings.extend(sentences)
        if show is not None:
            for sentence in sentences:
                show(sentence)

    medians = study.model.parameters(_point(study, 0.5))
    report(*([] if study.loop is None else [str(study.loop)]), *_of_the_priors(study))
    unstable = unstable_in_words(unstable_share(study.space, study.model))
    questions += [unstable] if unstable else []
    for error in _errors_of_the_integration(study, medians):
        report(*([] if error.too_large else [str(error)]))
        questions += [error.question] if error.too_large else []
    questions += _of_the_frequency(study, medians)
    compared: list[tuple[SideBySide, ...]] = []
    for observation in study.posterior.observations:
        questions += questions_of_the_measurement(observation, study.model.channel_units)
        if observation.sensor_in_words:
            report(f"The sensor of {' and '.join(observation.channels)}: {observation.sensor_in_words}.")
        run = study.model.simulate(medians, observation.record)
        if not run.done[0]:
            who = "structure" if run.status[0] == Status.STRUCTURE_FAILED else "model"
            reason = run.reasons[0].rstrip(".")
            questions.append(
                f"At the prior medians, the {who} fails for {observation.record.name}: {reason}. Are the priors and units right?"
            )
            continue
        pairs = SideBySide.of({c: run.channel(c)[0] for c in run.channels}, run.units, observation)
        compared.append(pairs)
        for pair in pairs:
            report(f"At the prior medians, the {pair.sentence}")
            questions += pair.questions.values() if np.ptp(pair.measured[np.isfinite(pair.measured)]) > 0.0 else ()
    if compared and not study.model.batched:
        questions += _of_memory(study, compared[0])
    return Plausibility(tuple(findings), tuple(questions), tuple(compared))


def _point(study: BuiltStudy, probability: float) -> Design:
    """The point at which every parameter is at this prior quantile."""
    space = study.space
    return Design(space.from_uniform(np.full((1, space.dimension), probability)), space)


def _of_the_records(study: BuiltStudy) -> list[str]:
    """Check the records for faults, and return a question about each suspected fault."""
    measured = [o.record for o in study.posterior.observations] if study.posterior is not None else []
    records = {
        id(r): r for r in (*measured, *study.campaign_records, *study.other_records) if isinstance(r, GroundMotion)
    }
    questions = []
    for record in records.values():
        name = f"record {record.name}" if record.name else "record"
        if record.pga > LARGEST_PGA * STANDARD_GRAVITY:
            questions.append(
                f"The {name} has a PGA of {record.pga / STANDARD_GRAVITY:.3g} g, above the largest ever recorded (4.4 g). "
                "Is the unit of its file right? Only a test at reduced scale may need a larger PGA."
            )
        questions += [gap(name, record.values, record.dt), clipped(name, record.values, record.unit)]
    return [question for question in questions if question]


def _of_the_frequency(study: BuiltStudy, theta: np.ndarray) -> list[str]:
    """Question an implausible natural frequency: a forgotten unit makes a stiffness a million times too small."""
    frequency = study.model.natural_frequency(theta)
    assert study.posterior is not None
    shaken = any(not isinstance(o.record, DisplacementHistory) for o in study.posterior.observations)
    if frequency is None or not shaken or FREQUENCIES[0] <= float(frequency[0]) <= FREQUENCIES[1]:
        return []
    return [
        f"At the prior medians, the lowest natural frequency is {float(frequency[0]):.2g} Hz, outside the usual range. "
        "Are the units of mass and stiffness right? A number without a unit is in SI."
    ]


def _errors_of_the_integration(study: BuiltStudy, theta: np.ndarray) -> list[IntegrationError]:
    """The largest integration error over all records; empty for an external model."""
    if study.posterior is None or not isinstance(study.model, TraceableModel):
        return []
    records = {o.record.content_hash: o.record for o in study.posterior.observations}.values()
    errors = [integration_error(study.model, theta, record) for record in records]
    return sorted((e for e in errors if e is not None), key=lambda e: e.error)[-1:]


def _of_memory(study: BuiltStudy, first: tuple[SideBySide, ...]) -> list[str]:
    """Question an external model whose result changes after another run; a certificate needs reproducible runs."""
    record = first[0].record
    study.model.simulate(study.model.parameters(_point(study, BETWEEN)), record)
    again = study.model.simulate(study.model.parameters(_point(study, 0.5)), record)
    if not again.done[0]:
        return [f"The second of two runs at the prior medians failed: {again.reasons[0]}"]
    pairs = SideBySide.of({c: again.channel(c)[0] for c in again.channels}, again.units, first[0].observation)
    differences = [
        float(np.abs(one.modelled - other.modelled).max()) / float(np.abs(one.modelled).max() or 1.0)
        for one, other in zip(first, pairs, strict=True)
    ]
    if max(differences) < SAME:
        return []
    return [
        f"Two runs at the prior medians, with another run between them, differ by {max(differences):.2g} of the peak. Does the "
        "model keep state from the previous run, or use random numbers? Start each run afresh, with a fixed seed."
    ]


def _of_the_priors(study: BuiltStudy) -> list[str]:
    """Sentences on derived quantities under the priors, such as a yield displacement."""
    draws = study.model.parameters(study.space.sample(PRIOR_DRAWS, 0, "sobol"))
    findings = []
    for name, (values, unit) in study.model.derived_quantities(draws).items():
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95), method="inverted_cdf") / factor(unit)
        upper = f"{low:.3g} to {high:.3g} {unit}" if np.isfinite(high) else f"above {low:.3g} {unit}"
        findings.append(f"Prior of the {name}: {upper} with 90 % probability, median {middle:.3g} {unit}.")
    return findings
