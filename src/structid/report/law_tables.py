"""Tables of hysteretic laws compared on a test."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from structid.law_choice.law_comparison import ABSENT, DECISIVE, LawComparison
from structid.report.section import Table
from structid.report.tables import percent


def tables_of_laws(comparison: LawComparison, measured: str, weights: Mapping[str, float]) -> list[Table]:
    """Return the tables of the laws with what was measured in words, of the mechanisms, and of the laws given up.

    `weights` are the weights of the laws in predictions, if these are averaged over laws.
    """
    heads = ["law", "parameters", "log evidence", f"{measured} unexplained", "error of the predicted rest"]
    rows = []
    for candidate in sorted(comparison.candidates, key=lambda c: -c.fit.log_evidence):
        error = candidate.prediction_error
        name = f"{candidate.name} (chosen)" if candidate is comparison.chosen else candidate.name
        rows.append(
            [
                name.replace("_", " "),
                str(len(candidate.fit.fitted)),
                f"{candidate.fit.log_evidence:.1f}",
                percent(candidate.unexplained),
                percent(error) if np.isfinite(error) else "–",
                *([f"{weights.get(candidate.law.word, 0.0):.2f}"] if weights else []),
            ]
        )
    title = "Laws and error models. The error is relative to the largest value."
    if weights:
        heads, title = [*heads, "weight"], f"{title} Weight: share of the law in predictions."
    tables = [Table(title, (heads, rows))]
    gains = [
        [words, f"{gain:.1f}", "shown" if gain > DECISIVE else "absent" if gain < ABSENT else "not decided"]
        for words, gain in comparison.mechanisms.items()
    ]
    if gains:
        tables.append(Table("Mechanisms of the chosen law", (["mechanism", "log evidence for it", "test"], gains)))
    if comparison.dropped:
        dropped = [[word.replace("_", " "), percent(left)] for word, left in comparison.dropped.items()]
        tables.append(Table("Laws given up after the search", (["law", f"{measured} unexplained"], dropped)))
    return tables
