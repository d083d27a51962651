"""The error model, the reasons for its choice, and the drift of parameters."""

from __future__ import annotations

from structid.inference.error_model_choice import ErrorModelChoice
from structid.report.material.material import PosteriorMaterial
from structid.report.section import Section, Table, nothing


def _words(material: PosteriorMaterial) -> list[str]:
    choice, drift = material.results.get(ErrorModelChoice), material.result.drift
    sentences = []
    if choice is not None:
        sentences.append(choice.sentence)
    elif material.left_to_the_data:
        sentences.append(
            "Independent errors are assumed. To choose an error model by its evidence would take tens of thousands of "
            "runs of this solver: a surrogate makes that possible."
        )
    else:
        sentences.append(f"The error model: {material.posterior.error_model.describe()['kind'].replace('_', ' ')}.")
    drift_is_in_the_choice = choice is not None and choice.posterior.error_model.inside
    if drift is not None and drift.found and not drift_is_in_the_choice:
        sentences.append(drift.sentence(material.result.mean))
    return sentences


def _tables(material: PosteriorMaterial) -> list[Table]:
    choice = material.results.get(ErrorModelChoice)
    if choice is None:
        return []
    best = max(e.value for e in choice.evidences if e.value == e.value)
    rows = [
        [
            error_model,
            f"{e.value:.1f} ± {e.error:.1f}",
            f"{e.value - best:.1f}",
            "chosen" if index == choice.chosen else "",
        ]
        for index, (error_model, e) in enumerate(zip(choice.error_models, choice.evidences, strict=True))
    ]
    return [
        Table("Error models, each with the same model", (["error model", "log evidence", "to the largest", ""], rows))
    ]


SECTION = Section("error-model", "Error model", nothing, _tables, _words)
