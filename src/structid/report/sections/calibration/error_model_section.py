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
            "Independent errors are assumed. The choice of an error model by evidence needs tens of thousands of model runs, which "
            "are too expensive with this solver. Use a surrogate for this choice."
        )
    else:
        sentences.append(f"Error model: {material.posterior.error_model.describe()['kind'].replace('_', ' ')}.")
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
    heads = ["error model", "log evidence", "difference from the largest", ""]
    return [Table("Error models, with the same model", (heads, rows))]


SECTION = Section("error-model", "Error model", nothing, _tables, _words)
