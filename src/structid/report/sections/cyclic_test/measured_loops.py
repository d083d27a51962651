"""Section of a cyclic test: loops measured and of the chosen law."""

from __future__ import annotations

from functools import partial

from structid.figures import cyclic_test as figure
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.section import Drawing, Picture, Section, nothing


def _draw(material: CyclicMaterial) -> Picture:
    test = material.test
    drawn = figure.loops_of_law(1e3 * test.displacement, 1e-3 * test.force, 1e-3 * material.force)
    caption = (
        f"Loops: measured, {material.choice.chosen.law.title}, and the difference. All samples; the law has the "
        "parameters of least squares."
    )
    return Picture("loops", caption, drawn)


def _drawings(material: CyclicMaterial) -> list[Drawing]:
    return [partial(_draw, material)]


SECTION: Section[CyclicMaterial] = Section("loops", "Loops", _drawings, nothing)
