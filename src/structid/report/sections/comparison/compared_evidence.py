"""Section of a comparison: evidence and predictive density of the classes."""

from __future__ import annotations

from structid.report.material.comparison_material import ComparisonMaterial
from structid.report.section import Section, Table, nothing


def _tables(material: ComparisonMaterial) -> list[Table]:
    return [Table("Model classes, the best first", material.comparison.side_by_side(), of_words=True)]


def _words(material: ComparisonMaterial) -> list[str]:
    return [
        "The evidence of a class is the probability density of the measurement, averaged over the prior. A class that could also "
        "explain many other measurements has a lower evidence. The Bayes factor compares this evidence with the evidence of the "
        "best class. The probabilities assume equal prior probabilities of the classes.",
        "The cross-validated log density measures how well a class predicts each segment of the history from the other segments "
        "(Pareto-smoothed importance sampling). It depends only weakly on the priors. Both measures compare only these classes. "
        "The best of several wrong models is still wrong, so check the unexplained variance.",
    ]


SECTION: Section[ComparisonMaterial] = Section("evidence", "Evidence", nothing, _tables, _words)
