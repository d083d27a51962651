"""Section of a programme: tracking of the actuators."""

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
        for channel, result in test.tracking.items():
            index = result.index
            rows.append(
                [
                    name,
                    channel,
                    f"{100.0 * result.error:.3g}",
                    "–" if index is None else f"{index.amplitude:.4f}",
                    "–" if index is None else f"{1e3 * index.delay:.3g}",
                    number(float(result.energy[-1])),
                ]
            )
    heads = ["test", "channel", "error [% of RMS]", "amplitude", "delay in simulated time [ms]", "energy error [J]"]
    caption = "Tracking of the commanded u_c by the measured u_m. A positive energy error adds energy to the structure"
    return [Table(caption, (heads, rows))] if rows else []


def _draw(material: ProgrammeMaterial) -> Picture:
    name, test = list(material.begun.items())[-1]
    channel = test.description.channels[0]
    unit, by, _, _ = DISPLAYED[channel.unit]
    result, moves = test.tracking[channel.name], test.moves
    plane = (channel.name, by * moves.target[:, 0], by * moves.measured[:, 0])
    drawn = figure.tracking(plane, moves.time, by**2 * result.indicator, result.energy, unit)
    return Picture(
        "tracking",
        f"Tracking of {channel.name} in test {name}: measured against target displacement, tracking indicator, energy error.",
        drawn,
    )


def _drawings(material: ProgrammeMaterial) -> list[Drawing]:
    return [partial(_draw, material=material)] if material.begun else []


SECTION: Section[ProgrammeMaterial] = Section("tracking", "Actuators", _drawings, _tables)
