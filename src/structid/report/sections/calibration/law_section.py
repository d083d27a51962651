"""The hysteretic law, if the data have chosen it."""

from __future__ import annotations

from structid.law_choice.law_comparison import LawComparison
from structid.report.law_tables import tables_of_laws
from structid.report.material.material import PosteriorMaterial
from structid.report.section import Section, Table, nothing


def _words(material: PosteriorMaterial) -> list[str]:
    comparison = material.results.get(LawComparison)
    return [] if comparison is None else [comparison.sentence]


def _tables(material: PosteriorMaterial) -> list[Table]:
    comparison = material.results.get(LawComparison)
    return [] if comparison is None else tables_of_laws(comparison, "responses", {})


SECTION = Section("law", "Which hysteretic law?", nothing, _tables, _words)
