"""Whether model and measurement are of similar size, before any long run: a wrong unit shows here."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.errors import Status
from structid.figures import response as figures
from structid.inference.assessment.side_by_side import SideBySide
from structid.models.prior_checks import unstable_in_words, unstable_share
from structid.probability.designs import Design
from structid.study.building.built_study import BuiltStudy
from structid.units import factor

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
    pairs: tuple[tuple[SideBySide, ...], ...] = field(default=(), repr=False)

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
    """Compare the response at the priors' medians with each measured history; see `SideBySide`.

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
    compared: list[tuple[SideBySide, ...]] = []
    for observation in study.posterior.observations:
        run = study.model.simulate(study.model.parameters(medians), observation.record)
        if not run.done[0]:
            who = "structure" if run.status[0] == Status.STRUCTURE_FAILED else "model"
            questions.append(
                f"At the priors' medians the {who} fails on {observation.record.name}: {run.reasons[0]} Are priors and units right?"
            )
            continue
        pairs = SideBySide.of({c: run.channel(c)[0] for c in run.channels}, run.units, observation)
        compared.append(pairs)
        for pair in pairs:
            said.append(f"At the priors' medians the {pair.sentence}")
            questions += pair.questions.values()
    return Plausibility(tuple(said), tuple(questions), tuple(compared))


def _of_the_priors(study: BuiltStudy) -> list[str]:
    """What the priors say of what follows from the parameters, such as a yield displacement."""
    draws = study.model.parameters(study.space.sample(PRIOR_DRAWS, 0, "sobol"))
    said = []
    for name, (values, unit) in study.model.derived_quantities(draws).items():
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95), method="inverted_cdf") / factor(unit)
        upper = f"{low:.3g} to {high:.3g} {unit}" if np.isfinite(high) else f"above {low:.3g} {unit}"
        said.append(f"By the priors the {name} is {upper} with 90 % probability, its median {middle:.3g} {unit}.")
    return said
