"""Section of a cyclic test: the last half-cycles, predicted from the first."""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.figures import cyclic_test as figure
from structid.law_choice.extrapolation import CyclicPrediction
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.section import Drawing, Picture, Section, nothing


def _draw(prediction: CyclicPrediction) -> Picture:
    low, high = (1e-3 * edge for edge in prediction.band())
    test = prediction.test
    drawn = figure.predicted_force(
        1e3 * test.displacement, 1e-3 * test.force, 1e-3 * prediction.mean, (low, high), prediction.start
    )
    return Picture(
        "held_out", "Last half-cycles: measured force, and the prediction from the earlier half-cycles.", drawn
    )


def _drawings(material: CyclicMaterial) -> list[Drawing]:
    return [] if material.held_out is None else [partial(_draw, material.held_out)]


def _words(material: CyclicMaterial) -> list[str]:
    prediction = material.held_out
    if prediction is None:
        return [
            "The last half-cycles are not predicted: the test has too few half-cycles, or every law fails in a part of it."
        ]
    test = prediction.test
    error = np.sqrt(np.mean((test.force - prediction.mean)[prediction.start :] ** 2)) / test.largest_force
    return [
        f"The laws were fitted to the first {prediction.start:,} of {len(test.force):,} samples, and predict the rest. The mean of "
        f"the laws errs by {error:.1%} of the largest force (root mean square). The 90 % band holds {prediction.coverage:.0%} of "
        "these samples. The band contains the error of the model, which grows with the largest and the cumulative displacement "
        "beyond the data.",
        _energy(prediction),
        material.choice.averaging,
    ]


def _energy(prediction: CyclicPrediction) -> str:
    """The dissipated energy of the predicted half-cycles, in a sentence."""
    part = slice(prediction.start, None)
    measured = np.trapezoid(prediction.test.force[part], prediction.test.displacement[part])
    low, middle, high = (1e-3 * energy for energy in np.quantile(prediction.energies, [0.05, 0.5, 0.95]))
    return (
        f"In these half-cycles the specimen dissipates {1e-3 * measured:.3g} kJ; {middle:.3g} kJ are predicted (90 %: {low:.3g} to "
        f"{high:.3g} kJ)."
    )


SECTION: Section[CyclicMaterial] = Section("held-out", "Prediction of the last half-cycles", _drawings, nothing, _words)
