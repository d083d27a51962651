"""Section of a programme: how well the actuators followed."""

from __future__ import annotations

from functools import partial

from structid.figures import hybrid as figure
from structid.report.material.programme_material import ProgrammeMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.sections.programme.specimen_loops import DISPLAYED
from structid.report.tables import number


def _tables(material: ProgrammeMaterial) -> list[Table]:
    rows = []
    for name, test in material.begun.items():
        for channel, found in test.tracking.items():
            index = found.index
            rows.append(
                [
                    name, channel, f"{100.0 * found.error:.3g}",
                    "–" if index is None else f"{index.amplitude:.4f}",
                    "–" if index is None else f"{1e3 * index.delay:.3g}",
                    number(float(found.energy[-1])),
                ]
            )  # fmt: skip
    heads = ["test", "channel", "error [% of RMS]", "amplitude", "delay in simulated time [ms]", "energy error [J]"]
    return [Table("Indicators: u_m over u_c. Energy above 0 fed the structure", (heads, rows))] if rows else []


def _draw(material: ProgrammeMaterial) -> Picture:
    name, test = list(material.begun.items())[-1]
    told = test.description.channels[0]
    unit, by, _, _ = DISPLAYED[told.unit]
    found, moves = test.tracking[told.name], test.moves
    plane = (told.name, by * moves.target[:, 0], by * moves.measured[:, 0])
    drawn = figure.tracking(plane, moves.time, by**2 * found.indicator, found.energy, unit)
    return Picture(
        "tracking",
        f"How {told.name} followed in test {name}: where it was over where it should be, and what grew of it.",
        drawn,
    )


def _drawings(material: ProgrammeMaterial) -> list[Drawing]:
    return [partial(_draw, material=material)] if material.begun else []


SECTION: Section[ProgrammeMaterial] = Section("tracking", "Actuators", _drawings, _tables)
