"""Section of a comparison: the figures of every class."""

from __future__ import annotations

from structid.report.material.comparison_material import ComparisonMaterial
from structid.report.section import Section, Table, nothing


def _tables(material: ComparisonMaterial) -> list[Table]:
    return [Table("Model classes, the best one first", material.comparison.side_by_side(), of_words=True)]


def _words(material: ComparisonMaterial) -> list[str]:
    return [
        "The evidence is the probability of the measurement before it was made, averaged over the prior: a class that could "
        "explain much else pays for it. The Bayes factor compares it with that of the best class. The probabilities take the "
        "classes as equally likely before the data.",
        "The log density left out is what each class predicts of every stretch of the history from the others (Pareto-smoothed "
        "importance sampling). It depends little on the priors. Both speak of these classes alone: the best of several wrong "
        "models is still wrong, so look at what is left unexplained.",
    ]


SECTION: Section[ComparisonMaterial] = Section("evidence", "Evidence", nothing, _tables, _words)
