"""Section of a cyclic test: energy, envelope, stiffness and equivalent damping of the cycles."""

from __future__ import annotations

from functools import partial

from structid.figures import cyclic_test as figure
from structid.law_choice.cycles import Cycles
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.tables import number, percent


def _draw(material: CyclicMaterial) -> Picture:
    test = material.test
    drawn = figure.measures_of_cycles(_curves(test.cycles), _curves(test.cycles_of(material.force)))
    caption = (
        "Measures of the complete cycles. Envelope: force at the ends of the cycles. Stiffness: secant between the two ends. "
        "Damping: equivalent viscous damping ratio."
    )
    return Picture("cycles", caption, drawn)


def _curves(cycles: Cycles) -> figure.CycleCurves:
    return figure.CycleCurves(
        1e3 * cycles.displacement,
        1e-3 * cycles.force,
        1e-3 * cycles.energy,
        1e-6 * cycles.stiffness,
        100.0 * cycles.damping_ratio,
    )


def _drawings(material: CyclicMaterial) -> list[Drawing]:
    return [partial(_draw, material)] if len(material.test.cycles.energy) else []


def _tables(material: CyclicMaterial) -> list[Table]:
    measured, model = material.test.cycles, material.test.cycles_of(material.force)
    heads = ["cycle", "amplitude [mm]", "strength − [kN]", "strength + [kN]", "stiffness [kN/mm]"]
    heads += ["energy [kJ]", "energy of the law [kJ]", "damping", "damping of the law"]
    rows = [
        [
            str(i + 1),
            number(1e3 * measured.amplitude[i]),
            number(1e-3 * measured.strength[i, 0]),
            number(1e-3 * measured.strength[i, 1]),
            number(1e-6 * measured.stiffness[i]),
            number(1e-3 * measured.energy[i]),
            number(1e-3 * model.energy[i]),
            percent(measured.damping_ratio[i]),
            percent(model.damping_ratio[i]),
        ]
        for i in range(len(measured.energy))
    ]
    return [Table("Complete cycles", (heads, rows))] if rows else []


def _words(material: CyclicMaterial) -> list[str]:
    measured, model = material.test.cycles.energy.sum(), material.test.cycles_of(material.force).energy.sum()
    if not measured > 0.0:
        return []
    return [
        f"The complete cycles dissipate {number(1e-3 * measured)} kJ; the law dissipates {number(1e-3 * model)} kJ, "
        f"{model / measured - 1.0:+.1%}."
    ]


SECTION: Section[CyclicMaterial] = Section("cycles", "Energy, stiffness, strength, damping", _drawings, _tables, _words)
