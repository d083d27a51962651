"""What a study will cost, from a few timed runs of its model."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from structid.study.build import BuiltStudy


@dataclass(frozen=True)
class Cost:
    """Expected cost of a study.

    Parameters
    ----------
    runs : int
        Model runs in sampling.
    seconds_per_batch, batch : float and int
        One batched call of the posterior.
    seconds : float
        Expected time of the sampling.
    """

    runs: int
    seconds_per_batch: float
    batch: int
    seconds: float

    def __str__(self) -> str:
        each = 1e3 * self.seconds_per_batch / self.batch
        return (
            f"Sampling: {self.runs:,} model runs in batches of {self.batch}, {each:.3g} ms a run: about {self.seconds:.0f} s "
            "on this machine, with the deterministic searches and the report beside it."
        )


def estimate(study: BuiltStudy) -> Cost:
    """Time a few batches of the posterior and scale them up.

    Parameters
    ----------
    study : BuiltStudy
        The study.

    Returns
    -------
    Cost
        What sampling will take.
    """
    sampler = study.sampler
    batch = sampler.ensembles * sampler.walkers // 2
    phi = study.posterior.initial(batch, np.random.default_rng(0))
    study.posterior.evaluate(phi)  # compilation
    seconds = []
    for _ in range(5):
        began = time.perf_counter()
        study.posterior.evaluate(phi)
        seconds.append(time.perf_counter() - began)
    each = float(np.median(seconds))
    runs = sampler.steps * sampler.ensembles * sampler.walkers
    return Cost(runs, each, batch, each * 2 * sampler.steps)
