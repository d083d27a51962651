"""Section of a programme: hysteresis loops of the specimen."""

from __future__ import annotations

from functools import partial

from structid.figures import hybrid as figure
from structid.report.material.programme_material import ProgrammeMaterial
from structid.report.section import Drawing, Picture, Section, nothing

DISPLAYED = {"m": ("mm", 1e3, "kN", 1e-3), "rad": ("mrad", 1e3, "kN m", 1e-3)}
"""For each SI unit of a displacement channel: display unit and factor of the displacement, and of the force."""


def _draw(material: ProgrammeMaterial, channel: int) -> Picture:
    described = material.first.description.channels[channel]
    unit, by, force_unit, force_by = DISPLAYED[described.unit]
    curves = [
        (name, by * (test.datum[channel] + test.moves.measured[:, channel]), force_by * test.moves.force[:, channel])
        for name, test in material.begun.items()
    ]
    name = f"loops_{described.name}"
    return Picture(
        name,
        f"Force over measured {described.name}, relative to the initial zero of the specimen; grey: earlier tests.",
        figure.loops_of_tests(curves, (described.name, "force"), (unit, force_unit)),
    )


def _drawings(material: ProgrammeMaterial) -> list[Drawing]:
    count = len(material.first.description.channels) if material.begun else 0
    return [partial(_draw, material=material, channel=k) for k in range(count)]


SECTION: Section[ProgrammeMaterial] = Section("loops", "Loops of the specimen", _drawings, nothing)
