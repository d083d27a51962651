"""The measured response against the posterior prediction, and hysteresis loops."""

from __future__ import annotations

import functools
from functools import cached_property

import numpy as np

from structid.figures import loops as loop_figures
from structid.figures import response as figures
from structid.inference.assessment.prediction import predict
from structid.report.material import PosteriorMaterial, simulated_loops
from structid.report.predicted_band import PredictedBand
from structid.report.section import Drawing, Picture, Section, nothing

LOOP_DRAWS = 40
"""Number of draws whose loops are drawn thinly behind that of the MAP estimate."""


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    drawings: list[Drawing] = []
    for index, observation in enumerate(material.observations):
        predicted = _Predicted(material, index)
        drawings += [functools.partial(_band, predicted, column) for column in range(len(observation.channels))]
        if material.true_posterior.model.loop_channels is not None:
            drawings += [functools.partial(_loops, predicted), functools.partial(_energy, predicted)]
    return drawings


class _Predicted:
    """What the posterior predicts of one observation."""

    def __init__(self, material: PosteriorMaterial, index: int) -> None:
        self.material, self.index = material, index
        self.observation = material.observations[index]
        self.suffix = material.suffix(index)

    @cached_property
    def band(self) -> PredictedBand:
        """The response of draws, with and without discrepancy, and of the MAP estimate."""
        material = self.material
        draws = predict(material.posterior, material.draws, self.observation.record, seed=material.result.seed)
        return PredictedBand(draws, material.posterior.predict(material.best[None], self.index)[0])

    @cached_property
    def loops(self) -> np.ndarray:
        """Loops of the MAP estimate and of the draws, shape (draw, time, 3)."""
        bound = self.material.true_posterior.likelihood.of[self.index]
        theta = np.vstack([self.material.best, self.material.draws])
        found = simulated_loops(bound.model, np.asarray(bound.parameters(theta)), self.observation.record)
        assert found is not None
        return found

    @property
    def true_loop(self) -> np.ndarray | None:
        """Loop of the true model, if it is known."""
        return self.material.true_loops[self.index]


def _band(predicted: _Predicted, column: int) -> Picture:
    observation = predicted.observation
    channel = observation.channels[column]
    name = f"response_{channel}{predicted.suffix}"
    unit = observation.channel_unit(channel).display
    return Picture(
        name,
        f"Measured {channel} on {observation.record.name} against the posterior prediction. The dark band is what the "
        "parameters' uncertainty alone does to the model; the light one, with the discrepancy, is where a measurement "
        "would lie.",
        predicted.band.draw(column, unit, ("measured", observation.values[:, column])),
    )


def _loops(predicted: _Predicted) -> Picture:
    found, truth, name = predicted.loops, predicted.true_loop, f"loops{predicted.suffix}"
    figure = loop_figures.loops(
        predicted.observation.record.time,
        None if truth is None else (truth[:, 0] * 1e3, truth[:, 1] * 1e-3),
        (found[0, :, 0] * 1e3, found[0, :, 1] * 1e-3),
        names=("truth of the virtual experiment", "model, MAP estimate"),
        draws=[(d[:, 0] * 1e3, d[:, 1] * 1e-3) for d in found[1 : 1 + LOOP_DRAWS]],
    )
    caption = (
        "Hysteresis loops. A few cycles, from early to late, stand for all (grey); those of posterior draws are thin."
    )
    caption += (
        ""
        if truth is None
        else " The loops of the virtual experiment are the truth; the calibration has not seen them."
    )
    return Picture(name, caption, figure)


def _energy(predicted: _Predicted) -> Picture:
    found, truth, name = predicted.loops, predicted.true_loop, f"energy{predicted.suffix}"
    low, high = np.quantile(found[1:, :, 2], [0.05, 0.95], axis=0)
    figure = figures.energy(
        predicted.observation.record.time,
        None if truth is None else truth[:, 2],
        found[0, :, 2],
        (low, high),
    )
    return Picture(name, "Absorbed energy.", figure)


SECTION = Section(
    "response",
    "Response",
    _drawings,
    nothing,
    under_doubt="The inner band is what the parameters leave open, given this model. The outer one, with the law of the errors, is "
    "meant to hold the measurement.",
)
