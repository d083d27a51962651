"""Section of a cyclic test: forces under further displacement histories."""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.figures import cyclic_test as figure
from structid.law_choice.extrapolation import CyclicPrediction
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.tables import file_name, number


def _draw(name: str, prediction: CyclicPrediction) -> Picture:
    low, high = (1e-3 * edge for edge in prediction.band())
    drawn = figure.predicted_force(1e3 * prediction.test.displacement, None, 1e-3 * prediction.mean, (low, high), 0)
    return Picture(f"path_{file_name(name)}", f"{name}: predicted force and its 90 % band.", drawn)


def _drawings(material: CyclicMaterial) -> list[Drawing]:
    return [partial(_draw, name, prediction) for name, prediction in material.predictions.items()]


def _tables(material: CyclicMaterial) -> list[Table]:
    rows = []
    for name, prediction in material.predictions.items():
        peaks = np.quantile(prediction.largest_forces, [0.05, 0.5, 0.95])
        largest = 1e3 * prediction.test.largest_displacement
        rows.append([name, number(largest), *(number(1e-3 * peak) for peak in peaks)])
    heads = ["path", "largest displacement [mm]", "largest force: 5 % [kN]", "50 % [kN]", "95 % [kN]"]
    return [Table("Predicted forces", (heads, rows))] if rows else []


def _words(material: CyclicMaterial) -> list[str]:
    if not material.predictions:
        return []
    return [
        "The specimen begins without damage. The prediction averages the laws as described for the last half-cycles."
    ]


SECTION: Section[CyclicMaterial] = Section("paths", "Other displacements", _drawings, _tables, _words)
