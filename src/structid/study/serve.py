"""Models that a UM-Bridge server offers for a study: "forward" is its model, "posterior" its log posterior density."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from structid.inference.likelihood.posterior import Posterior
from structid.models.external.um_bridge import Served, ServedModel
from structid.study.building.built_study import BuiltStudy


class ServedPosterior(Served):
    """A posterior with the interface of ``umbridge.serve_models``: the input is all parameters in SI, the output one number."""

    def __init__(self, posterior: Posterior, name: str = "posterior") -> None:
        super().__init__(name, differentiable=False)
        self.posterior = posterior

    def get_input_sizes(self, config: Mapping[str, Any]) -> list[int]:
        """Sizes of the input vectors."""
        return [self.posterior.dimension]

    def get_output_sizes(self, config: Mapping[str, Any]) -> list[int]:
        """Sizes of the output vectors."""
        return [1]

    def __call__(self, parameters: list[list[float]], config: Mapping[str, Any]) -> list[list[float]]:
        """Log posterior density; the most negative number for zero density, since JSON has no infinity."""
        density = float(self.posterior.log_density(np.array(parameters))[0])
        return [[max(density, -np.finfo(float).max)]]


def offered(study: BuiltStudy) -> list[Any]:
    """Models that a study can serve."""
    models: list[Any] = [ServedModel(study.model, study.record)]
    if study.posterior is not None:
        models.append(ServedPosterior(study.posterior))
    return models
