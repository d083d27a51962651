"""Section of a cyclic test: the laws compared, and the mechanisms that the test shows."""

from __future__ import annotations

import numpy as np

from structid.law_choice.choose_model import ABSENT, DECISIVE
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.section import Section, Table, nothing
from structid.report.tables import percent


def _words(material: CyclicMaterial) -> list[str]:
    return [str(material.test)]


def _tables(material: CyclicMaterial) -> list[Table]:
    choice = material.choice
    heads = ["law", "parameters", "log evidence", "force unexplained", "error of the predicted half-cycles", "weight"]
    weights = choice.weights if choice.on_parts else {}
    rows = []
    for candidate in sorted(choice.candidates, key=lambda c: -c.fit.log_evidence):
        error = candidate.prediction_error
        name = f"{candidate.name} (chosen)" if candidate is choice.chosen else candidate.name
        rows.append(
            [
                name.replace("_", " "),
                str(len(candidate.fit.model.free)),
                f"{candidate.fit.log_evidence:.1f}",
                percent(candidate.unexplained),
                percent(error) if np.isfinite(error) else "–",
                f"{weights.get(candidate.law.word, 0.0):.2f}",
            ]
        )
    gains = [
        [words, f"{gain:.1f}", "shown" if gain > DECISIVE else "absent" if gain < ABSENT else "not decided"]
        for words, gain in choice.mechanisms.items()
    ]
    tables = [
        Table(
            "Laws and error models. The error is relative to the largest force. Weight: share of the law in predictions.",
            (heads, rows),
        )
    ]
    if gains:
        tables.append(Table("Mechanisms of the chosen law", (["mechanism", "log evidence for it", "test"], gains)))
    if choice.dropped:
        dropped = [[word.replace("_", " "), percent(left)] for word, left in choice.dropped.items()]
        tables.append(Table("Laws given up after the search", (["law", "force unexplained"], dropped)))
    return tables


SECTION: Section[CyclicMaterial] = Section("laws", "Which hysteretic law?", nothing, _tables, _words)
