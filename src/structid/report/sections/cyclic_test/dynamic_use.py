"""Section of a cyclic test: the chosen law as the spring of an oscillator."""

from __future__ import annotations

from functools import partial

from structid.figures import cyclic_test as figure
from structid.report.material.cyclic_material import CyclicMaterial, PredictedResponse
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.tables import file_name, number


def _draw(name: str, response: PredictedResponse) -> Picture:
    low, high = (1e3 * edge for edge in response.band(0))
    caption = f"{name}: displacement of the mass, band of the draws from 5 to 95 %."
    return Picture(f"response_{file_name(name)}", caption, figure.response_band(response.time, low, high))


def _drawings(material: CyclicMaterial) -> list[Drawing]:
    return [partial(_draw, name, response) for name, response in material.responses.items() if len(response.values)]


def _tables(material: CyclicMaterial) -> list[Table]:
    rows = []
    for name, response in material.responses.items():
        shown = ["–"] * 6
        if len(response.values):
            displacement, force = response.peaks(0), response.peaks(1)
            shown = [number(1e3 * v) for v in displacement] + [number(1e-3 * v) for v in force]
        rows.append([name, *shown, str(response.failed)])
    heads = [
        "record",
        *(f"displacement: {q} % [mm]" for q in (5, 50, 95)),
        *(f"force: {q} % [kN]" for q in (5, 50, 95)),
    ]
    return [Table("Largest displacement and force", ([*heads, "failed runs"], rows))] if rows else []


def _words(material: CyclicMaterial) -> list[str]:
    law, largest = material.choice.chosen.law, 1e3 * material.test.largest_displacement
    words = [
        "The parameters of the law do not depend on a mass. In Python, choice.oscillator(mass, damping_ratio) gives the oscillator "
        f"with the {law.title}. In a study file, add a [dynamics] table with the mass and the records."
    ]
    beyond = [name for name, r in material.responses.items() if len(r.values) and 1e3 * r.peaks(0)[1] > largest]
    if beyond:
        words.append(
            f"Under {', '.join(beyond)}, the displacement is larger than {number(largest)} mm, the largest of the test: the law is "
            "extrapolated, and the band of the draws is too narrow."
        )
    return words


SECTION: Section[CyclicMaterial] = Section("dynamics", "Use the specimen dynamically", _drawings, _tables, _words)
