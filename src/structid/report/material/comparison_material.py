"""What finished studies of one measurement leave for a comparison."""

from __future__ import annotations

from dataclasses import dataclass

from structid.inference.model_comparison.comparison import Comparison, ModelClass
from structid.inference.prediction.prediction import Prediction
from structid.observation import Observation
from structid.report.material.material import PosteriorMaterial


@dataclass(frozen=True, eq=False)
class ComparedClass:
    """One model class."""

    figures: ModelClass  # Its evidence, and how well it predicts
    material: PosteriorMaterial  # What its calibration has left
    predictions: tuple[Prediction, ...]  # Of each observation

    @property
    def name(self) -> str:
        """Of the class, as a page shows it."""
        return self.figures.name


@dataclass(frozen=True, eq=False)
class ComparisonMaterial:
    """Model classes of one measurement."""

    classes: tuple[ComparedClass, ...]  # Two or more, in the order in which they were given

    @property
    def comparison(self) -> Comparison:
        """Their figures side by side."""
        return Comparison(tuple(one.figures for one in self.classes))

    @property
    def best(self) -> ComparedClass:
        """The class that the data favour."""
        best = self.comparison.best
        return next(one for one in self.classes if one.figures is best)

    @property
    def names(self) -> list[str]:
        """Of the classes."""
        return [one.name for one in self.classes]

    @property
    def observations(self) -> tuple[Observation, ...]:
        """What was measured, the same for all classes."""
        return self.classes[0].material.observations
