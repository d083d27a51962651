"""Simulation-based calibration of a study: replicas of its measurement with known parameters are simulated and calibrated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from structid.calibration.simulated_calibrations import NOISE, CalibrationRanks, sbc_of_calibration
from structid.campaign.executors import kept_open, run_map
from structid.campaign.runner import Campaign
from structid.core.errors import InputError
from structid.inference.error_model_choice import AUTO
from structid.inference.validation.simulation_based_calibration import Ranks, sbc
from structid.study.building.built_study import BuiltStudy
from structid.study.building.surrogates import fitted_surrogate, surrogate_settings
from structid.study.run import load_of_one_law
from structid.study.timings import Stage, silent
from structid.surrogates.base import Surrogate

_FIGURE, _RUNS = "sbc", "sbc_runs.h5"


def check_by_simulation(
    path: str | Path,
    replicas: int = 200,
    out: str | Path | None = None,
    seed: int | None = None,
    stage: Stage = silent,
    executor: Any = None,
) -> tuple[Ranks, Path | None]:
    """Simulate measurements with the model and the error model of a study, and calibrate to each measurement.

    If a study has a [surrogate] but no [calibration], its surrogate is fitted to its campaign and then tested; the model itself
    simulates the measurements. The surrogate of a certified calibration is valid for one posterior only; for such a study, the
    built-in model itself is sampled.
    """
    study = load_of_one_law(path)
    if study.posterior is None:
        raise InputError(f"{path}", "a study without an observation", "a study with a measurement")
    folder = None if out is None else Path(out)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    by_surrogate = study.campaign is not None and study.has_surrogate
    if not by_surrogate and not study.model.batched:
        raise InputError(
            f"{path}",
            "an external model, which would need a million runs",
            "a [surrogate] fitted to a [campaign] over the whole prior",
            "Remove [calibration] for this check: its surrogate is valid only near one posterior.",
        )
    with kept_open(study.model, executor) as workers:
        posterior = study.posterior.on(_surrogate(study, folder, stage, workers)) if by_surrogate else study.posterior
        with run_map(study.model, workers) as map_of_runs, stage("calibrating replicas") as progress:
            ranks = sbc(
                posterior.mapped_by(map_of_runs),
                replicas,
                seed=study.file.seed if seed is None else seed,
                simulator=study.model if by_surrogate else None,
                progress=progress,
            )
    if folder is None:
        return ranks, None
    ranks.plot(folder / _FIGURE)
    return ranks, folder / f"{_FIGURE}.png"


def check_calibrations_by_simulation(
    path: str | Path,
    replicas: int = 100,
    noise: float = NOISE,
    out: str | Path | None = None,
    seed: int | None = None,
    stage: Stage = silent,
    executor: Any = None,
) -> tuple[CalibrationRanks, Path | None]:
    """Simulate measurements with the model of a study, and make a whole calibration of each; see `sbc_of_calibration`.

    The settings are those of the tables [surrogate], [calibration] and [discrepancy], with their defaults.
    """
    study = load_of_one_law(path)
    if study.posterior is None:
        raise InputError(f"{path}", "a study without an observation", "a study with a measurement")
    folder = None if out is None else Path(out)
    with kept_open(study.model, executor) as workers, stage("calibrating replicas") as progress:
        found = sbc_of_calibration(
            study.model,
            study.posterior.model_space,
            study.posterior.observations,
            surrogate_settings(study.file.surrogate) if study.has_surrogate else None,
            AUTO if study.error_model_is_open else study.posterior.error_model,
            noise=noise,
            replicas=replicas,
            plan=study.plan,
            seed=study.file.seed if seed is None else seed,
            store=folder,
            executor=workers,
            progress=progress,
        )
    if folder is None:
        return found, None
    found.ranks.plot(folder / _FIGURE)
    return found, folder / f"{_FIGURE}.png"


def _surrogate(study: BuiltStudy, folder: Path | None, stage: Stage, executor: Any) -> Surrogate:
    """Run the campaign of a study, and fit its surrogate."""
    assert study.campaign is not None
    store = None if folder is None else folder / _RUNS
    campaign = Campaign(study.model, study.campaign_records, study.campaign, store, assignment="cycle")
    with stage("model runs") as progress:
        runs = campaign.run(executor, progress=progress)
    with stage("fitting the surrogate") as progress:
        return fitted_surrogate(study.file.surrogate, runs, None, progress)
