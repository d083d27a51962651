"""Section of a cyclic test: the laws compared, and the mechanisms that the test shows."""

from __future__ import annotations

from structid.report.law_tables import tables_of_laws
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.section import Section, Table, nothing


def _words(material: CyclicMaterial) -> list[str]:
    return [str(material.test)]


def _tables(material: CyclicMaterial) -> list[Table]:
    choice = material.choice
    return tables_of_laws(choice, "force", choice.weights if choice.on_parts else {})


SECTION: Section[CyclicMaterial] = Section("laws", "Which hysteretic law?", nothing, _tables, _words)
