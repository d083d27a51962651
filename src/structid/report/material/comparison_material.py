"""Data for the comparison of finished studies of one measurement."""

from __future__ import annotations

from dataclasses import dataclass

from structid.inference.model_comparison.comparison import Comparison, ModelClass
from structid.inference.prediction.prediction import Prediction
from structid.observation import Observation
from structid.report.material.material import PosteriorMaterial


@dataclass(frozen=True, eq=False)
class ComparedClass:
    """One model class."""

    figures: ModelClass  # its evidence and predictive density
    material: PosteriorMaterial  # data of its calibration
    predictions: tuple[Prediction, ...]  # predictions of each observation

    @property
    def name(self) -> str:
        """Name of the model class on a page."""
        return self.figures.name


@dataclass(frozen=True, eq=False)
class ComparisonMaterial:
    """Model classes of one measurement."""

    classes: tuple[ComparedClass, ...]  # two or more, in the given order

    @property
    def comparison(self) -> Comparison:
        """Comparison of the evidence and predictive density of the model classes."""
        return Comparison(tuple(one.figures for one in self.classes))

    @property
    def best(self) -> ComparedClass:
        """The model class that the data favour."""
        best = self.comparison.best
        return next(one for one in self.classes if one.figures is best)

    @property
    def names(self) -> list[str]:
        """Names of the classes."""
        return [one.name for one in self.classes]

    @property
    def observations(self) -> tuple[Observation, ...]:
        """The measurements, common to all model classes."""
        return self.classes[0].material.observations
