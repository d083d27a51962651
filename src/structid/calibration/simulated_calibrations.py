"""Simulation-based calibration of a whole calibration: choice of the error model, surrogate, sampling and certificate."""

from __future__ import annotations

import multiprocessing
import os
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from structid.calibration.plan import Plan
from structid.calibration.sequential import calibrate
from structid.core.cores import available_cores
from structid.core.errors import InputError, StructidError, StructidWarning
from structid.core.hashing import digest
from structid.core.journal import Journal
from structid.core.notebook import ShownAsText
from structid.core.progress import Progress
from structid.core.streams import Purpose, derived_seed, stream
from structid.core.validation import check_arguments
from structid.inference.error_models.base import ErrorModel
from structid.inference.likelihood.posterior import Posterior
from structid.inference.validation.simulation_based_calibration import FEWEST_REPLICAS, Ranks, simulated_truths
from structid.models.base import Model
from structid.observation import Observation
from structid.probability.space import ParameterSpace
from structid.surrogates.base import SurrogateSettings

SCHEMA = 1
"""Version of the stored outcomes."""
NOISE = 0.05
"""Default standard deviation of the simulated errors, divided by the RMS of each channel's response."""
THINNED = 100
"""Number of draws of each calibration among which the truth is ranked."""
PROBABILITIES = (0.5, 0.9)


@dataclass(frozen=True, eq=False)
class CalibrationRanks(ShownAsText):
    """Outcome of a simulation-based calibration of whole calibrations.

    Parameters
    ----------
    ranks : Ranks
        Ranks of the model's parameters in all calibrations that ended with draws, certified or not.
    certified : ndarray of bool, shape (replica,)
        Whether the calibration was certified.
    error_models : tuple of str
        Error model of each calibration.
    true_runs : ndarray, shape (replica,)
        Model runs of each calibration.
    seconds : ndarray, shape (replica,)
        Duration of each calibration [s].
    failed : tuple of str
        Messages of the calibrations that ended with an error.
    """

    ranks: Ranks = field(repr=False)
    certified: Bool[np.ndarray, " replica"]
    error_models: tuple[str, ...] = field(repr=False)
    true_runs: Float[np.ndarray, " replica"] = field(repr=False)
    seconds: Float[np.ndarray, " replica"] = field(repr=False)
    failed: tuple[str, ...] = ()

    @cached_property
    def of_certified(self) -> Ranks | None:
        """Ranks in the certified calibrations alone; None if they are too few."""
        if self.certified.sum() < FEWEST_REPLICAS:
            return None
        r = self.ranks
        kept = self.certified
        return replace(r, truth=r.truth[kept], draws=r.draws[kept], ranks=r.ranks[kept])

    @property
    def calibrated(self) -> bool:
        """Whether the ranks of all calibrations, and of the certified ones, are uniform."""
        return self.ranks.uniform and (self.of_certified is None or self.of_certified.uniform)

    def __str__(self) -> str:
        count = len(self.certified)
        models = ", ".join(f"{name} {times}" for name, times in Counter(self.error_models).most_common())
        lines = [
            str(self.ranks),
            f"Certified: {self.certified.sum()} of {count} calibrations, with {np.median(self.true_runs):.0f} model runs and "
            f"{np.median(self.seconds):.0f} s each (medians).",
        ]
        if self.of_certified is not None:
            held = " and ".join(
                f"{self.of_certified.coverage(p).mean():.0%} of the {100 * p:g} % intervals" for p in PROBABILITIES
            )
            lines.append(f"In the certified calibrations, {held} contain the truth.")
        lines.append(f"Error models: {models}.")
        if self.failed:
            ended = "1 calibration" if len(self.failed) == 1 else f"{len(self.failed)} calibrations"
            lines.append(f"{ended} ended with an error: {self.failed[0]}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Task:
    """Everything that a worker needs for one calibration."""

    model: Model
    space: ParameterSpace
    observations: tuple[Observation, ...]
    surrogate: SurrogateSettings | None
    discrepancy: ErrorModel | str | None
    plan: Plan
    seed: int
    executor: Any = None


@check_arguments
def sbc_of_calibration(
    model: Model,
    space: ParameterSpace,
    observations: Observation | Sequence[Observation],
    surrogate: SurrogateSettings | None = None,
    discrepancy: ErrorModel | str | None = None,
    *,
    noise: float = NOISE,
    replicas: int = 100,
    true_runs: int = 500,
    plan: Plan | None = None,
    seed: int = 0,
    store: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    executor: Any = None,
    progress: Progress | None = None,
) -> CalibrationRanks:
    """Simulate measurements with parameters drawn from the prior, and make a whole calibration of each; see `calibrate`.

    Parameters
    ----------
    model : Model
        The true model: built in, or an external solver.
    space : ParameterSpace
        Its unknown parameters and their priors, from which the true parameters are drawn (S. Talts et al. 2018, arXiv 1804.06788).
    observations : Observation or sequence of Observation
        The measurements; simulated ones replace their values. Missing values stay missing.
    surrogate : SurrogateSettings, optional
        Settings of the surrogate; see `calibrate`.
    discrepancy : Discrepancy or "auto", optional
        The error model, or ``"auto"`` for its choice by the data in every calibration.
    noise : float
        Standard deviation of the simulated errors, which are independent and normal, divided by the RMS of each channel's response.
    replicas : int
        Number of calibrations.
    true_runs : int
        Budget of model runs of each calibration.
    plan : Plan, optional
        All further settings of the budget. If given, its own budget replaces `true_runs`.
    seed : int
        Seed.
    store : path-like, optional
        Folder for the outcomes; an interrupted call continues from it.
    workers : int, optional
        Number of processes that share the calibrations of a built-in model; by default one for each core.
    executor : optional
        Executor of an external model's runs; see `Campaign.run`.
    progress : callable, optional
        Called with the number of finished calibrations and of all.

    Returns
    -------
    CalibrationRanks
        Ranks, coverage, certificates and chosen error models, which ``print`` shows.

    Raises
    ------
    InputError
        If there are too few replicas, or the noise is not positive.
    ConvergenceError
        If most simulations at draws of the prior fail.

    Examples
    --------
    >>> import structid as si
    >>> found = si.sbc_of_calibration(model, space, measured, discrepancy="auto", seed=1)  # doctest: +SKIP
    >>> print(found)  # doctest: +SKIP
    """
    if replicas < FEWEST_REPLICAS:
        raise InputError("sbc_of_calibration(replicas)", f"{replicas}", f"{FEWEST_REPLICAS} or more, ideally 100")
    if not 0.0 < noise < np.inf:
        raise InputError("sbc_of_calibration(noise)", f"{noise}", "a positive fraction of the response's RMS")
    measured = (observations,) if isinstance(observations, Observation) else tuple(observations)
    truth, responses = simulated_truths(Posterior(space, model, measured), replicas, seed)
    plan = Plan(true_runs=true_runs) if plan is None else plan
    tasks = [
        Task(
            model,
            space,
            _simulated(measured, [each[index] for each in responses], noise, seed, index),
            surrogate,
            discrepancy,
            plan,
            derived_seed(seed, Purpose.REPLICA_CALIBRATION, index),
            executor,
        )
        for index in range(replicas)
    ]
    journal = None if store is None else Journal(Path(store) / "simulated.journal", _identity(tasks, noise))
    outcomes = {int(entry["index"]): entry for entry in journal or ()}
    left = [index for index in range(replicas) if index not in outcomes]
    for index, outcome in _outcomes(tasks, left, workers):
        outcomes[index] = outcome | {"index": np.array(index)}
        if journal is not None:
            journal.append(outcomes[index])
        if progress is not None:
            progress(len(outcomes), replicas)
    return _ranks(space, truth[:, : space.dimension], [outcomes[index] for index in range(replicas)])


def _simulated(
    measured: tuple[Observation, ...], clean: list[np.ndarray], noise: float, seed: int, index: int
) -> tuple[Observation, ...]:
    """Observations of one replica, with the gaps of the measured ones."""
    rng, simulated = stream(seed, Purpose.REPLICA_NOISE, index), []
    for observation, response in zip(measured, clean, strict=True):
        errors = noise * np.sqrt(np.mean(response**2, axis=0)) * rng.standard_normal(response.shape)
        simulated.append(replace(observation, values=np.where(observation.is_measured, response + errors, np.nan)))
    return tuple(simulated)


def _identity(tasks: list[Task], noise: float) -> dict[str, Any]:
    first = tasks[0]
    posterior = Posterior(first.space, first.model, first.observations)
    return {
        "schema": SCHEMA,
        "posterior": posterior.content_hash,
        "error model": first.discrepancy.describe() if isinstance(first.discrepancy, ErrorModel) else first.discrepancy,
        "surrogate": digest(repr(first.surrogate)),
        "plan": digest(first.plan.describe()),
        "noise": noise,
        "seed": first.seed,
    }


def _outcomes(tasks: list[Task], left: list[int], workers: int | None) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """Outcomes in the order in which they finish; the calibrations of a built-in model run side by side."""
    count = min(available_cores() if workers is None else workers, len(left)) if tasks[0].model.batched else 1
    if count <= 1:
        for index in left:
            yield index, outcome_of(tasks[index])
        return
    # A calibration is mostly serial: one process for each core is faster than one with all cores.
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn")) as pool:
        yield from zip(left, pool.map(outcome_of, [tasks[index] for index in left]), strict=True)


def outcome_of(task: Task) -> dict[str, np.ndarray]:
    """Make one calibration; an error is an outcome, too."""
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StructidWarning)
        try:
            found = calibrate(
                task.model,
                task.space,
                task.observations,
                task.surrogate,
                task.discrepancy,
                plan=task.plan,
                seed=task.seed,
                executor=task.executor,
            )
        except StructidError as error:
            return {"error": np.array(str(error))}
    draws = found.sampling.thinned(THINNED)[:, : task.space.dimension]
    return {
        "error": np.array(""),
        "draws": draws,
        "certified": np.array(found.certificate.certified),
        "error model": np.array(str(found.posterior.error_model.describe()["kind"])),
        "true runs": np.array(found.certificate.true_runs),
        "seconds": np.array(time.perf_counter() - began),
    }


def _ranks(
    space: ParameterSpace, truth: Float[np.ndarray, "replica parameter"], outcomes: list[dict[str, np.ndarray]]
) -> CalibrationRanks:
    """Compare the truth with the draws of every calibration that has some."""
    kept = [index for index, outcome in enumerate(outcomes) if not str(outcome["error"])]
    failed = tuple(str(outcome["error"]) for outcome in outcomes if str(outcome["error"]))
    if not kept:
        raise InputError("sbc_of_calibration", "no calibration with draws", "calibrations that end", failed[0])

    def of(name: str, convert: Callable[[np.ndarray], Any]) -> list[Any]:
        return [convert(outcomes[index][name]) for index in kept]

    draws, true = np.stack(of("draws", np.asarray)), truth[kept]
    ranks = (draws < true[:, None, :]).sum(axis=1)
    return CalibrationRanks(
        Ranks(space.names, tuple(space.units.values()), true, draws, ranks, draws.shape[1]),
        np.array(of("certified", bool)),
        tuple(of("error model", str)),
        np.array(of("true runs", float)),
        np.array(of("seconds", float)),
        failed,
    )
