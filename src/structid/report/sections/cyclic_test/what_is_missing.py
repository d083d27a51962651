"""Section of a cyclic test: terms of the force that the law lacks."""

from __future__ import annotations

from functools import partial

from structid.figures import cyclic_test as figure
from structid.law_choice.cycles import cumulative_displacement
from structid.law_choice.missing_terms import MissingTerms
from structid.mechanics.hysteretic_laws.added_terms import TERMS
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.tables import number

SYMBOLS = (
    "In a term, u is the displacement and p its largest value so far in the same direction, both relative to the largest of the "
    "test; s is the direction of the motion, ±1; z is the force of the law relative to the largest; e is the absorbed energy over "
    "four times the largest displacement and force."
)


def _words(material: CyclicMaterial) -> list[str]:
    missing = material.choice.missing
    if missing is None:
        return []
    return [material.choice.lacking, SYMBOLS] if missing.names else [material.choice.lacking]


def _tables(material: CyclicMaterial) -> list[Table]:
    missing = material.choice.missing
    if missing is None or not missing.names:
        return []
    rows = [
        [name, TERMS[name].meaning, number(1e-3 * coefficient, 1e-3 * abs(coefficient) / 10.0)]
        for name, coefficient in zip(missing.names, missing.coefficients, strict=True)
    ]
    return [Table("Missing terms", (["term", "meaning", "coefficient [kN]"], rows))]


def _draw(material: CyclicMaterial, missing: MissingTerms) -> Picture:
    u = material.test.displacement
    drawn = figure.missing_terms(
        1e3 * u, cumulative_displacement(u), 1e-3 * missing.residuals, 1e-3 * missing.added, missing.start
    )
    text = "Force that the law leaves unexplained, and the missing terms."
    if missing.start < len(missing.residuals):
        text += " The dashed line ends the half-cycles in which they were sought; the rest is predicted."
    return Picture("missing_terms", text, drawn)


def _drawings(material: CyclicMaterial) -> list[Drawing]:
    missing = material.choice.missing
    return [] if missing is None or not missing.names else [partial(_draw, material, missing)]


SECTION: Section[CyclicMaterial] = Section("missing", "What does the law lack?", _drawings, _tables, _words)
