"""Section of a comparison: the parameters of the classes."""

from __future__ import annotations

from structid.report.material.comparison_material import ComparisonMaterial
from structid.report.material.learnt_parameters import LearntParameter, learnt_parameters
from structid.report.section import Section, Table, nothing


def _tables(material: ComparisonMaterial) -> list[Table]:
    learnt = [{p.name: p for p in learnt_parameters(one.material)} for one in material.classes]
    every = {name: p for of_one in learnt for name, p in of_one.items()}
    has_truth = any(p.truth is not None for p in every.values())
    heads = ["parameter", *material.names, *(["truth"] if has_truth else [])]
    rows = [
        [p.label, *(_cell(of_one.get(name)) for of_one in learnt), *([p.true_value] if has_truth else [])]
        for name, p in every.items()
    ]
    return [Table("Mean and 90 % interval", (heads, rows))]


def _cell(learnt: LearntParameter | None) -> str:
    return "–" if learnt is None else f"{learnt.value} ({learnt.in_words(learnt.honest)})"


def _words(material: ComparisonMaterial) -> list[str]:
    wrong = [one.name for one in material.classes if one.material.result.verdict().wrong_model]
    if not wrong:
        return []
    return [
        f"The intervals of {' and '.join(wrong)} are intervals for another record: the model is wrong for these data, and its "
        "parameters drift. The parameters compensate for model error, so the intervals need not contain the true values."
    ]


SECTION: Section[ComparisonMaterial] = Section("parameters", "Parameters", nothing, _tables, _words)
