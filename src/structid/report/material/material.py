"""What a study leaves for its report, and the simulations that several sections share."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.calibration.calibration_result import CalibrationResult
from structid.campaign.runs import Runs
from structid.ground_motion.excitation import Excitation
from structid.ground_motion.record import GroundMotion
from structid.inference.diagnostics.identifiability import Identifiability, identifiability
from structid.inference.diagnostics.posterior_summary import Summary
from structid.inference.error_model_choice import LawChoice
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult
from structid.models.base import Model
from structid.models.hysteretic.loop_lines import LoopLines
from structid.observation import Observation
from structid.optimize.minima import OptimizeResult
from structid.reliability.fragility import Fragility
from structid.reliability.parameter_study import ParameterStudy
from structid.surrogates.base import Surrogate


@dataclass(frozen=True, eq=False)
class RunsMaterial:
    """What a study without a measurement leaves."""

    title: str  # Title, and the study file's text
    settings: str  # Title, and the study file's text
    runs: Runs | None  # The true runs
    surrogate: Surrogate | None  # What was fitted to them
    parameter_study: ParameterStudy | None = field(default=None, kw_only=True)  # What runs over the priors tell


@dataclass(frozen=True, eq=False)
class PosteriorMaterial(RunsMaterial):
    """What a calibration leaves."""

    result: SamplingResult  # Of a `Posterior`
    # The posterior under the model itself, for channels and records that a surrogate does not know
    true_posterior: Posterior
    searches: dict[str, OptimizeResult]  # Deterministic calibrations by method
    raw_record: GroundMotion  # First record before and after processing
    record: GroundMotion  # First record before and after processing
    truths: tuple[Model | None, ...]  # For each observation the true model of a virtual experiment, or None
    true_values: dict[str, float]  # True parameters in SI
    other_records: tuple[GroundMotion, ...]  # Records to predict for
    prediction_draws: int  # Draws of the bands
    calibration: CalibrationResult | None = None  # Certificate and rounds, where the study asks for them
    left_to_the_data: bool = False  # Whether the study lets the data choose the law of the errors
    law_choice: LawChoice | None = None  # What they have chosen
    fragility: Fragility | None = None  # The probability of a passage, given the data
    predicted_channels: tuple[str, ...] = ()  # What is predicted for other records; empty for what was measured
    loop: LoopLines | None = None  # Lines through a measured loop, of which priors were made

    @property
    def posterior(self) -> Posterior:
        """The posterior that was sampled."""
        assert isinstance(self.result.target, Posterior)
        return self.result.target

    @property
    def observations(self) -> tuple[Observation, ...]:
        """What was measured."""
        return self.posterior.observations

    @property
    def best(self) -> np.ndarray:
        """The MAP estimate in SI, shape (parameter,)."""
        return self.result.map_estimate

    @cached_property
    def draws(self) -> np.ndarray:
        """Draws of the bands in SI, shape (draw, parameter)."""
        return self.result.thinned(self.prediction_draws)

    @cached_property
    def summary(self) -> Summary:
        """Moments and quantiles, re-weighted where the certificate asks for it."""
        return self.result.summary() if self.calibration is None else self.calibration.summary()

    @property
    def weighted_draws(self) -> tuple[np.ndarray, np.ndarray | None]:
        """All draws in SI, shape (draw, parameter), and their weights where the certificate asks for them."""
        if self.calibration is not None and self.calibration.reweighted:
            return self.calibration.certificate.draws, self.calibration.certificate.weights
        return self.result.flat, None

    @cached_property
    def shared(self) -> dict[str, Any]:
        """What a section simulates once for its tables and its figures, by a name of its own."""
        return {}

    @cached_property
    def information(self) -> Identifiability | None:
        """Fisher information at the MAP estimate, of a model with derivatives."""
        return identifiability(self.posterior, self.best) if self.posterior.model.traceable else None

    def suffix(self, index: int) -> str:
        """Suffix of a file name that distinguishes the figures of several observations."""
        return "" if len(self.observations) == 1 else f"_{index + 1}"

    @cached_property
    def true_loops(self) -> tuple[dict[str, np.ndarray], ...]:
        """For each observation the loops of the true model by its springs' names, each (time, 3); empty where it is not known."""
        return tuple(
            {}
            if truth is None
            else {name: loop[0] for name, loop in simulated_loops(truth, np.zeros((1, 0)), o.record).items()}
            for truth, o in zip(self.truths, self.observations, strict=True)
        )

    def completed(self, theta: Float[np.ndarray, " model_parameter"]) -> Float[np.ndarray, " parameter"]:
        """Add nuisances and discrepancy parameters of the MAP estimate to parameters of the model."""
        return np.concatenate([theta, self.best[len(theta) :]])


def simulated_loops(
    model: Model, parameters: Float[np.ndarray, "run parameter"], record: Excitation
) -> dict[str, np.ndarray]:
    """Simulate the hysteresis loops of a model."""
    loops = model.loop_channels
    if not loops:
        return {}
    histories = model.recording(*(channel for own in loops.values() for channel in own)).simulate(parameters, record)
    columns = {name: [histories.channels.index(channel) for channel in own] for name, own in loops.items()}
    return {name: histories.values[:, :, own] for name, own in columns.items()}
