"""Section of a programme: displacement histories of the structure."""

from __future__ import annotations

from functools import partial

from structid.figures import hybrid as figure
from structid.report.material.programme_material import ProgrammeMaterial
from structid.report.section import Drawing, Picture, Section, Table

SHOWN = 3
"""Largest number of degrees of freedom in the figure."""


def _draw(material: ProgrammeMaterial) -> Picture:
    tests = material.begun
    channels = material.first.description.channels
    metres = [k for k, channel in enumerate(channels) if channel.unit == "m"]
    others = range(len(channels), material.first.coarse.u.shape[1]) if len(channels) == 1 else ()
    shown = [*metres[:2], *others][:SHOWN]
    names = [channels[k].name if k < len(channels) else f"floor {k + 1}" for k in shown]
    curves = [
        [(name, test.coarse.time, 1e3 * test.coarse.u[:, k]) for name, k in zip(names, shown, strict=True)]
        for test in tests.values()
    ]
    ends = [None if test.finished else float(test.coarse.time[-1]) for test in tests.values()]
    drawn = figure.histories_of_tests(curves, list(tests), "mm", ends)
    return Picture("histories", "Displacements over simulated time; dashed: early end of a test.", drawn)


def _drawings(material: ProgrammeMaterial) -> list[Drawing]:
    return [partial(_draw, material=material)] if material.begun else []


def _tables(material: ProgrammeMaterial) -> list[Table]:
    rows = [
        [name, f"{1e6 * test.coarse.gap.max():.3g}", f"{abs(test.coarse.pseudo_energy.sum()):.2g}"]
        for name, test in material.begun.items()
    ]
    heads = ["test", "largest gap [µm]", "pseudo-energy of the interface [W/s]"]
    caption = "Interface: the velocities are equal; the displacements differ by the gap"
    return [Table(caption, (heads, rows))] if rows else []


SECTION: Section[ProgrammeMaterial] = Section("histories", "Histories", _drawings, _tables)
