"""What a study will cost, from a few timed runs of its model."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from structid.calibration.plan import Plan
from structid.errors import InputError, Status
from structid.study.building.built_study import BuiltStudy

USUAL_ROUNDS = 4
"""Rounds that a calibration of the benchmark study takes."""
SLOW = 20.0
"""Seconds of a batch, beyond which it is timed once."""


@dataclass(frozen=True)
class Cost:
    """Expected cost of a study.

    Parameters
    ----------
    true_runs, sampling_runs : int
        Model runs of the campaign, and in sampling.
    batch : int
        Runs done together; 1 for an external model.
    seconds_per_run : float
        Time of one run.
    through_a_surrogate : bool
        Whether a surrogate is fitted to the campaign and sampled, at a cost that timing the model does not show.
    plan : Plan or None
        How the campaign's runs are spent on a certified calibration.
    """

    true_runs: int
    sampling_runs: int
    batch: int
    seconds_per_run: float
    through_a_surrogate: bool = False
    plan: Plan | None = None

    def __str__(self) -> str:
        together = f"in batches of {self.batch}, " if self.batch > 1 else "one after another, "
        lines = []
        for what, runs in (("Campaign", self.true_runs), ("Sampling", self.sampling_runs)):
            if runs:
                each, total = 1e3 * self.seconds_per_run, duration(runs * self.seconds_per_run)
                lines.append(
                    f"{what}: {runs:,} model runs {together}{each:.3g} ms a run: about {total} on this machine"
                )
        if self.plan is not None:
            lines.append(_rounds(self.plan))
        if self.through_a_surrogate:
            lines.append("Fitting and sampling the surrogate come on top: half a minute to a few minutes.")
        if self.batch == 1:
            lines.append(
                "With --executor the runs of an external model are shared out: divide by the number of workers."
            )
        return "\n".join(lines)


def _rounds(plan: Plan) -> str:
    """Say how a plan spends its runs, and whether that leaves room to improve the surrogate."""
    told = (
        f"Of them {plan.start} make the first surrogate and {plan.needed} the certificate; between them there is room for "
        f"{plan.rounds} x {plan.batch} more."
    )
    if plan.rounds < USUAL_ROUNDS:
        enough = plan.start + USUAL_ROUNDS * plan.batch + plan.needed
        told += f" A surrogate mostly takes {USUAL_ROUNDS} to be good enough: calibration.true_runs = {enough} has room for them."
    return told


def duration(seconds: float) -> str:
    """Say a duration in the unit a person would use.

    Parameters
    ----------
    seconds : float
        The duration.

    Returns
    -------
    str
        ``"5 hours"``, ``"12 s"``, ``"40 ms"``.
    """
    for size, unit in ((86400.0, "days"), (3600.0, "hours"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s" if seconds >= 2 else f"{1e3 * seconds:.0f} ms"


def estimate(study: BuiltStudy) -> Cost:
    """Time a few batches of the posterior and scale them up.

    Parameters
    ----------
    study : BuiltStudy
        The study.

    Returns
    -------
    Cost
        What true runs and sampling will take.
    """
    true_runs = 0 if study.campaign is None else len(study.campaign)
    if study.plan is not None:
        true_runs = study.plan.true_runs * len({o.record.content_hash for o in study.sampled.observations})
    elif study.has_surrogate:  # samples itself, in seconds
        true_runs += study.validation_runs
    if study.sampler.exact:
        true_runs += study.sampler.steps * study.sampler.ensembles * study.sampler.walkers
    sampling_runs = (
        0
        if study.posterior is None or study.has_surrogate
        else study.sampler.steps * study.sampler.ensembles * study.sampler.walkers
    )
    if study.model.batched:
        batch = study.sampler.ensembles * study.sampler.walkers // 2
        each = _median_time(study, batch, repeats=6)[1:]
    else:
        batch, each = 1, _median_time(study, 1, repeats=4)[1:]  # the first starts a process
    return Cost(true_runs, sampling_runs, batch, float(np.median(each)), study.has_surrogate, study.plan)


def _median_time(study: BuiltStudy, batch: int, repeats: int) -> list[float]:
    """Seconds per run of a batch from the prior, for each repeat. The first may include a compilation."""
    theta = study.model.parameters(study.space.sample(batch, seed=study.file.seed))
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        found = study.model.simulate(theta, study.record)
        seconds.append((time.perf_counter() - began) / batch)
        if all(Status(status).run_failed for status in found.status):
            raise InputError(
                "model", f"its trial run {Status(found.status[0]).words}: {found.reasons[0]}",
                "a model that runs at a draw from the priors", "Correct the model, its files or the priors.",
            )  # fmt: skip
        if seconds[0] * batch > SLOW:
            return seconds * 2
    return seconds
