"""Learning from the tests of a programme: a posterior from some tests, and the prediction of a later test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from structid.calibration.calibration_result import CalibrationResult
from structid.calibration.sequential import calibrate
from structid.campaign.store import CALIBRATION_FOLDER
from structid.core.errors import Status
from structid.ground_motion.record import GroundMotion
from structid.histories import Histories
from structid.hybrid.programme import ProgrammeResult
from structid.hybrid.virtual_experiment import VirtualHybridTest
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import sample
from structid.inference.sampling_result import SamplingResult
from structid.models.hysteretic.imposed_displacements import ImposedDisplacements
from structid.report.material.programme_material import Learnt, PredictedTest
from structid.study.building.observations import build_discrepancy
from structid.study.building.priors import parameter_space
from structid.study.building.samplers import build_plan, build_sampler
from structid.study.building.surrogates import surrogate_settings
from structid.study.programmes.planned_programme import PlannedProgramme
from structid.study.timings import Stage, StepProgress, Timings, silent

CHAINS = "learnt.h5"
"""Draws from the posterior, computed with the model itself."""
LEARNING = "learning.json"
"""Durations of the stages of a calibration."""
MOST_PIECES = 64
"""Largest number of substeps per move in a predicted test; a run that needs more substeps diverges."""


def posterior_of(planned: PlannedProgramme, programme: ProgrammeResult) -> Posterior:
    """Build the posterior of the specimen's parameters."""
    file, model = planned.file, planned.learnable()
    assert file.learning is not None  # checked when the programme was built
    driven = ImposedDisplacements(model, pieces=file.learning.pieces)
    observation = programme.observation(file.learning.from_test, driven.channels, planned.known_sd())
    units = dict(zip(observation.channels, observation.error_units, strict=True))
    return Posterior(parameter_space(file), driven, observation, build_discrepancy(file, units))


def learnt_of(
    planned: PlannedProgramme, programme: ProgrammeResult, folder: Path, stage: Stage = silent
) -> Learnt | None:
    """Compute the posterior from the tests, and predict a later test."""
    learning = planned.file.learning
    if learning is None or learning.from_test not in programme.tests or not programme.tests[learning.from_test].steps:
        return None
    posterior = posterior_of(planned, programme)
    result, calibration = _drawn(planned, posterior, folder, stage)
    of_model = [posterior.names.index(name) for name in posterior.model.free]
    fitted = posterior.model.simulate(result.map_estimate[None, of_model], posterior.observations[0].record).values[0]
    prediction = None
    if learning.predict is not None and learning.predict in programme.tests and programme.tests[learning.predict].steps:
        draws = result.thinned(learning.draws)[:, of_model]
        prediction = _predicted(planned, programme, learning.predict, draws)
    return Learnt(learning.from_test, posterior.observations[0], result, fitted, prediction, calibration)


def _drawn(
    planned: PlannedProgramme, posterior: Posterior, folder: Path, stage: Stage
) -> tuple[SamplingResult, CalibrationResult | None]:
    """Draws from the posterior, with a certified surrogate or with the model itself."""
    file = planned.file
    if (plan := build_plan(file.calibration)) is None:
        with stage("learning") as progress:
            return sample(posterior, build_sampler(file.sampler), file.seed, folder / CHAINS, progress=progress), None
    settings = None if file.surrogate.kind == "none" else surrogate_settings(file.surrogate)
    sampler = build_sampler(file.sampler) if "sampler" in file.model_fields_set else None
    with StepProgress(stage, Timings(folder / LEARNING)) as report:
        calibration = calibrate(
            posterior.model,
            posterior.model_space,
            posterior.observations,
            settings,
            posterior.error_model,
            plan=plan,
            sampler=sampler,
            seed=file.seed,
            store=folder / CALIBRATION_FOLDER,
            progress=report,
        )
    return calibration.sampling, calibration


def _predicted(planned: PlannedProgramme, programme: ProgrammeResult, name: str, draws: np.ndarray) -> PredictedTest:
    """Predict a test from posterior draws, starting from the specimen's state after the earlier tests."""
    section, learning = planned.section_of(name), planned.file.learning
    assert learning is not None  # checked in learnt_of
    numerical, physical = planned.parts(section.modes)
    virtual = VirtualHybridTest(
        numerical,
        physical,
        planned.learnable(),
        planned.file.dt,
        planned.coupling,
        learning.pieces,
        programme.way_to(name),
        ("displacement_1",),
    )
    measured = programme.tests[name].coarse
    steps = programme.tests[name].feasibility.steps
    record = _at_steps(planned.record_of(section), planned.file.dt, steps)
    runs = followed_in_pieces(virtual, draws, record)
    failed, reason = int((~runs.done).sum()), next((reason for reason in runs.reasons if reason), "")
    return PredictedTest(
        name, record.time, runs.values[runs.done, :, 0], measured.physical.displacement[:, 0], failed, reason
    )


def followed_in_pieces(
    virtual: VirtualHybridTest, draws: Float[np.ndarray, "draw parameter"], record: GroundMotion
) -> Histories:
    """Simulate with as many substeps per move as the hysteretic model needs.

    The displacement increments of a stronger test are larger than those of the tests used for learning, and possibly too large
    for one step of the model.
    """
    runs = virtual.simulate(draws, record)
    while np.any(runs.status == Status.DIVERGED) and virtual.pieces < MOST_PIECES:
        virtual = replace(virtual, pieces=2 * virtual.pieces)
        runs = virtual.simulate(draws, record)
    return runs


def _at_steps(record: GroundMotion, dt: float, steps: int) -> GroundMotion:
    """The part of a record used by a test, sampled at the programme's coarse time step."""
    return GroundMotion(record.values_at(np.arange(steps + 1) * dt), dt, name=record.name)
