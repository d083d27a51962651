"""Measured responses, their posterior predictions, and hysteresis loops."""

from __future__ import annotations

import functools
from functools import cached_property

import numpy as np

from structid.figures import loops as loop_figures
from structid.figures import response as figures
from structid.inference.prediction.prediction import predict
from structid.report.material.material import PosteriorMaterial, simulated_loops
from structid.report.material.predicted_band import PredictedBand
from structid.report.section import Drawing, Picture, Section, nothing

LOOP_DRAWS = 40
"""Number of draws whose loops are shown together with the loop of the MAP estimate."""
MOST_SPRINGS = 4
"""Largest number of springs with figures; the springs that absorb the most energy are shown."""


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    drawings: list[Drawing] = []
    for index, observation in enumerate(material.observations):
        predicted = _PredictedObservation(material, index)
        drawings += [functools.partial(_band, predicted, column) for column in range(len(observation.channels))]
        # Several observations of one record, such as measurements on several floors, share the figures of the loops.
        first = next(i for i, o in enumerate(material.observations) if o.record is observation.record)
        if first == index:
            loops = _PredictedLoops(material, index)
            for position in range(min(MOST_SPRINGS, len(material.true_posterior.model.loop_channels))):
                drawings += [functools.partial(_loops, loops, position), functools.partial(_energy, loops, position)]
    return drawings


class _PredictedObservation:
    """Prediction of one observation."""

    def __init__(self, material: PosteriorMaterial, index: int) -> None:
        self.material, self.index = material, index
        self.observation = material.observations[index]
        self.suffix = material.suffix(index)

    @cached_property
    def band(self) -> PredictedBand:
        """Response of the draws, with and without errors, and of the MAP estimate."""
        material = self.material
        draws = predict(material.posterior, material.draws, seed=material.result.seed, observation=self.index)
        best = material.posterior.predict(material.best[None], self.index)[0]
        return PredictedBand(draws, best, self.observation)


class _PredictedLoops:
    """Predicted loops of the springs for the record of an observation."""

    def __init__(self, material: PosteriorMaterial, index: int) -> None:
        self.material, self.index = material, index
        self.record = material.observations[index].record
        self.suffix = material.suffix(index)

    @cached_property
    def of_springs(self) -> dict[str, np.ndarray]:
        """Loops of the MAP estimate and the draws by spring, with shape (draw, time, 3)."""
        bound = self.material.true_posterior.likelihood.of[self.index]
        theta = np.vstack([self.material.best, self.material.draws])
        return simulated_loops(bound.model, np.asarray(bound.parameters(theta)), self.record)

    @cached_property
    def drawn(self) -> list[str]:
        """Names of the springs with figures, in the order of the model."""
        absorbed = {name: float(np.nanmax(np.abs(loops[0, :, 2]))) for name, loops in self.of_springs.items()}
        most = sorted(absorbed, key=lambda name: -absorbed[name])[:MOST_SPRINGS]
        return [name for name in self.of_springs if name in most]

    def truth(self, spring: str) -> np.ndarray | None:
        """Loop of a spring of the true model, shape (time, 3); None if unknown."""
        return self.material.true_loops[self.index].get(spring)

    def name(self, what: str, spring: str) -> str:
        """File name of a figure."""
        return f"{what}{'_' if spring else ''}{spring.replace(' ', '_')}{self.suffix}"


def _band(predicted: _PredictedObservation, column: int) -> Picture:
    observation = predicted.observation
    channel = observation.channels[column]
    name = f"response_{channel}{predicted.suffix}"
    unit = observation.channel_unit(channel).display
    return Picture(
        name,
        f"Measured {channel} for {observation.record.name}, and its posterior prediction. The dark band shows the effect of the "
        "parameter uncertainty only. The light band also includes the error model, and should contain about 90 % of the "
        "measured values.",
        predicted.band.draw(column, unit, ("measured", observation.values[:, column])),
    )


def _loops(predicted: _PredictedLoops, number: int) -> Picture:
    spring = predicted.drawn[number]
    loops, truth = predicted.of_springs[spring], predicted.truth(spring)
    figure = loop_figures.loops(
        predicted.record.time,
        None if truth is None else (truth[:, 0] * 1e3, truth[:, 1] * 1e-3),
        (loops[0, :, 0] * 1e3, loops[0, :, 1] * 1e-3),
        names=("truth of the virtual experiment", "model, MAP estimate"),
        draws=[(d[:, 0] * 1e3, d[:, 1] * 1e-3) for d in loops[1 : 1 + LOOP_DRAWS]],
    )
    caption = (
        f"Hysteresis loops{f' of {spring}' if spring else ''} for {predicted.record.name}. Grey: all cycles. Coloured: a few "
        "cycles, from early to late; thin lines are posterior draws."
    )
    caption += (
        ""
        if truth is None
        else " The loops of the virtual experiment are the true ones; the calibration did not use them."
    )
    return Picture(predicted.name("loops", spring), caption, figure)


def _energy(predicted: _PredictedLoops, number: int) -> Picture:
    spring = predicted.drawn[number]
    loops, truth = predicted.of_springs[spring], predicted.truth(spring)
    low, high = np.nanquantile(loops[1:, :, 2], [0.05, 0.95], axis=0)
    figure = figures.energy(
        predicted.record.time,
        None if truth is None else truth[:, 2],
        loops[0, :, 2],
        (low, high),
    )
    caption = f"Energy absorbed{f' by {spring}' if spring else ''} for {predicted.record.name}."
    return Picture(predicted.name("energy", spring), caption, figure)


SECTION = Section(
    "response",
    "Response",
    _drawings,
    nothing,
    under_doubt="The inner band shows the effect of the parameter uncertainty, given this model. The outer band also includes the "
    "error model, and should contain the measurement.",
)
