"""Data of a study for its report, and simulations that several sections share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.calibration.calibration_result import CalibrationResult
from structid.campaign.runs import Runs
from structid.core.by_type import ByType
from structid.ground_motion.excitation import Excitation
from structid.ground_motion.record import GroundMotion
from structid.inference.diagnostics.identifiability import Identifiability, identifiability
from structid.inference.diagnostics.posterior_summary import Summary
from structid.inference.error_model_choice import ErrorModelChoice
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult
from structid.models.base import Model
from structid.models.finer_steps import simulate_in_steps_it_needs
from structid.models.hysteretic.loop_lines import LoopLines
from structid.observation import Observation
from structid.reliability.parameter_study import ParameterStudy
from structid.surrogates.base import Surrogate


@dataclass(frozen=True, eq=False)
class RunsMaterial:
    """Data of a study without a measurement."""

    title: str  # title
    settings: str  # text of the study file
    results: ByType  # results of its stages, by type

    @property
    def runs(self) -> Runs | None:
        """The runs of the campaign, or the runs over the priors."""
        runs, study = self.results.get(Runs), self.results.get(ParameterStudy)
        return study.runs if runs is None and study is not None else runs


@dataclass(frozen=True, eq=False)
class PosteriorMaterial(RunsMaterial):
    """Data of a calibration."""

    # Posterior with the model itself, for channels and records that a surrogate does not predict
    true_posterior: Posterior
    raw_record: GroundMotion  # first record before processing
    record: GroundMotion  # first record after processing
    truths: tuple[Model | None, ...]  # true model of a virtual experiment for each observation, or None
    true_values: dict[str, float]  # true parameters in SI
    other_records: tuple[GroundMotion, ...]  # records to predict
    prediction_draws: int  # number of draws for the bands
    left_to_the_data: bool = False  # whether the study lets the data choose the error model
    predicted_channels: tuple[str, ...] = ()  # channels predicted for other records; empty: the measured channels
    loop: LoopLines | None = None  # lines through a measured loop, from which priors are derived

    @property
    def runs(self) -> Runs | None:
        """The training runs of a surrogate."""
        return self.results.get(Runs)

    @property
    def result(self) -> SamplingResult:
        """The posterior draws and their verdict."""
        return self.results[SamplingResult]

    @property
    def calibration(self) -> CalibrationResult | None:
        """The certified calibration, if the study has one."""
        return self.results.get(CalibrationResult)

    @property
    def posterior(self) -> Posterior:
        """The sampled posterior."""
        assert isinstance(self.result.target, Posterior)
        return self.result.target

    @property
    def observations(self) -> tuple[Observation, ...]:
        """The measurements."""
        return self.posterior.observations

    @property
    def best(self) -> np.ndarray:
        """The MAP estimate in SI, shape (parameter,)."""
        return self.result.map_estimate

    @cached_property
    def draws(self) -> np.ndarray:
        """Draws for the bands in SI, shape (draw, parameter)."""
        return self.result.thinned(self.prediction_draws)

    @cached_property
    def summary(self) -> Summary:
        """Moments and quantiles, re-weighted if the certificate requires it."""
        return self.result.summary() if self.calibration is None else self.calibration.summary()

    @property
    def weighted_draws(self) -> tuple[np.ndarray, np.ndarray | None]:
        """All draws in SI, shape (draw, parameter), and their weights if the certificate requires them."""
        if self.calibration is not None and self.calibration.reweighted:
            return self.calibration.certificate.draws, self.calibration.certificate.weights
        return self.result.flat, None

    @cached_property
    def shared(self) -> dict[str, Any]:
        """Cache of simulations for tables and figures, by name."""
        return {}

    @cached_property
    def information(self) -> Identifiability | None:
        """Fisher information at the MAP estimate, for a model with derivatives."""
        return identifiability(self.posterior, self.best) if self.posterior.model.traceable else None

    def suffix(self, index: int) -> str:
        """Suffix of file names that distinguishes the figures of several observations."""
        return "" if len(self.observations) == 1 else f"_{index + 1}"

    @cached_property
    def true_loops(self) -> tuple[dict[str, np.ndarray], ...]:
        """Loops of the true model for each observation, by spring, with shape (time, 3); empty if unknown."""
        return tuple(
            {}
            if truth is None
            else {name: loop[0] for name, loop in simulated_loops(truth, np.zeros((1, 0)), o.record).items()}
            for truth, o in zip(self.truths, self.observations, strict=True)
        )

    def completed(self, theta: Float[np.ndarray, " model_parameter"]) -> Float[np.ndarray, " parameter"]:
        """Append the nuisance and error-model parameters of the MAP estimate to model parameters."""
        return np.concatenate([theta, self.best[len(theta) :]])


def calibration_results(calibration: CalibrationResult) -> ByType:
    """Collect the results of a certified calibration by type."""
    return ByType(
        {
            CalibrationResult: calibration,
            Runs: calibration.runs,
            Surrogate: calibration.surrogate,
            ErrorModelChoice: calibration.error_model_choice,
            SamplingResult: calibration.sampling,
        }
    )


def simulated_loops(
    model: Model, parameters: Float[np.ndarray, "run parameter"], record: Excitation
) -> dict[str, np.ndarray]:
    """Simulate the hysteresis loops of a model."""
    loops = model.loop_channels
    if not loops:
        return {}
    recording = model.recording(*(channel for channels_of_loop in loops.values() for channel in channels_of_loop))
    histories = simulate_in_steps_it_needs(recording, parameters, record)
    columns = {
        name: [histories.channels.index(channel) for channel in channels_of_loop]
        for name, channels_of_loop in loops.items()
    }
    return {name: histories.values[:, :, channels_of_loop] for name, channels_of_loop in columns.items()}
