"""Section of a programme: table of the tests, and table of their events."""

from __future__ import annotations

import numpy as np

from structid.report.material.programme_material import ProgrammeMaterial
from structid.report.section import Section, Table, nothing
from structid.report.tables import number


def _tables(material: ProgrammeMaterial) -> list[Table]:
    heads = [
        "test",
        "λ",
        "steps",
        "largest drift [mm]",
        "largest force [kN]",
        "residual [mm]",
        "stiffness / K₀",
        "end",
    ]
    rows, events = [], []
    for name, test in material.programme.tests.items():
        scale = test.feasibility.wall_time / max(test.feasibility.steps, 1)
        step = float(test.coarse.time[1]) if test.steps else np.nan
        drift = 1e3 * np.abs(test.coarse.physical.displacement[:, 0]).max() if test.steps else np.nan
        force = 1e-3 * np.abs(test.moves.force[:, 0]).max() if test.steps else np.nan
        end = "completed" if test.finished else (test.events[-1].what if test.events else "ended early")
        rows.append(
            [
                name,
                number(scale / step),
                f"{test.steps} of {test.feasibility.steps}",
                number(drift),
                number(force),
                number(1e3 * float(test.datum[0])),
                number(test.stiffness_ratio),
                end,
            ]
        )
        events += [[name, f"{event.time:.3f}", event.what] for event in test.events]
    tables = [Table("Tests. Residual: displacement of the specimen at zero force before the test.", (heads, rows))]
    if events:
        tables.append(Table("Events", (["test", "time [s]", "event"], events), of_words=True))
    return tables


def _words(material: ProgrammeMaterial) -> list[str]:
    test = material.first
    described = test.description
    kind = "The specimen was simulated." if described.simulated else "The specimen was a physical structure."
    channels = ", ".join(f"{c.name} [{c.unit}], delay {1e3 * c.delay:g} ms" for c in described.channels)
    warnings = [f"{name}: {w}" for name, t in material.programme.tests.items() for w in t.feasibility.warnings]
    return [f"Specimen: {described.name}. {kind} Channels: {channels}.", *dict.fromkeys(warnings)]


SECTION: Section[ProgrammeMaterial] = Section("tests", "Tests", nothing, _tables, _words)
