"""How a surrogate came about, and what every fit asks of its runs."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from structid.campaign.runs import Runs
from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.ground_motion.excitation import Excitation
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace

FEWEST_RUNS = 10
"""Fewer finished runs than this are taken for a mistake."""

OutsideRule = Literal["warn", "refuse", "allow"]
"""What happens beyond the range of the design."""


@dataclass(frozen=True, eq=False)
class Fit:
    """How a surrogate came about."""

    kind: str  # Its settings' class, such as ``"PODKriging"``
    settings: dict[str, Any]  # Its settings, in a form that JSON can hold
    space: ParameterSpace  # The parameters
    channels: tuple[str, ...]  # Of the histories
    excitation: str  # Kind of the records
    dt: float  # Their time step [s]
    low: Float[np.ndarray, " parameter"]  # The range of the design
    high: Float[np.ndarray, " parameter"]  # The range of the design
    runs: int  # Runs it was fitted to, including those held out; and runs that had failed
    left_out: int  # Runs it was fitted to, including those held out; and runs that had failed
    error: float  # Mean relative error estimated while fitting: by leaving runs out, or over the runs held out
    limit: float  # Largest mean error with which it may be used in a posterior
    outside: Literal["warn", "refuse", "allow"]  # What happens beyond the range: ``"warn"``, ``"refuse"``, ``"allow"``
    seconds: float = field(default=float("nan"))  # Wall time of the fit
    seen: tuple[str, ...] = ()  # A digest of each run it was fitted to. These runs cannot validate it
    # How far beyond the range of the design it extrapolates, as a share of the range's width; further out it responds
    # as there
    reach: float = 0.0

    @property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest values of the parameters between which it responds by itself: the range and its reach beyond."""
        margin, support = self.reach * (self.high - self.low), self.space.bounds
        return np.maximum(self.low - margin, support[:, 0]), np.minimum(self.high + margin, support[:, 1])

    def to_plain(self) -> dict[str, Any]:
        """Give it in words and numbers, for a file."""
        said = {f.name: getattr(self, f.name) for f in fields(self)}
        return said | {"space": self.space.to_plain(), "low": self.low.tolist(), "high": self.high.tolist()}

    @classmethod
    def from_plain(cls, said: Mapping[str, Any]) -> Fit:
        """Make it again from what `to_plain` gave."""
        arrays = {"low": np.array(said["low"]), "high": np.array(said["high"])}
        tuples = {"channels": tuple(said["channels"]), "seen": tuple(said["seen"])}
        return cls(**{**said, **arrays, **tuples, "space": ParameterSpace.from_plain(said["space"])})


def fitting_runs(where: str, runs: Any, fewest: int = FEWEST_RUNS) -> tuple[Runs, int]:
    """Check runs to fit to, and leave out those that failed."""
    if not isinstance(runs, Runs):
        raise InputError(where, f"a {type(runs).__name__}", "Runs, as a Campaign returns them")
    done = runs[runs.done]
    left_out = len(runs) - len(done)
    check_enough(where, len(done), f"{len(done)} finished runs and {left_out} others", fewest)
    if not np.isfinite(done.design.values).all():
        raise InputError(where, "parameters that are not finite", "finite numbers")
    spread = np.zeros(len(done.channels))
    for batch in done.batches():
        values = _known_samples(batch)
        if not all(np.isfinite(v).all() for v in values):
            raise InputError(
                where, "histories with values that are not finite in runs said to be done", "finite numbers",
                "Set their status, so that they are left out.",
            )  # fmt: skip
        spread = np.maximum(spread, np.max([np.ptp(v, axis=0) for v in values], axis=0))
    constant = [c for c, s in zip(done.channels, spread, strict=True) if s == 0.0]
    if constant:
        raise InputError(where, f"the channel '{constant[0]}', constant in every run", "channels that vary")
    return done, left_out


def checked_weights(where: str, weights: Float[np.ndarray, " run"], runs: Runs) -> Float[np.ndarray, " finished_run"]:
    """Check how much runs count, and leave out those that failed."""
    weights = np.asarray(weights, dtype=np.float64)
    if weights.shape != (len(runs),) or not (np.isfinite(weights) & (weights > 0.0)).all():
        raise InputError(f"{where}: weights", f"an array of shape {weights.shape}", f"{len(runs)} positive numbers")
    kept = weights[runs.done]
    return np.asarray(kept / kept.mean())


def check_enough(where: str, runs: int, came: str, fewest: int = FEWEST_RUNS) -> None:
    """Refuse too few runs."""
    if runs < fewest:
        raise InputError(where, came, f"{fewest} finished ones or more")


def _known_samples(runs: Runs) -> list[np.ndarray]:
    values = runs.values
    return [v[: len(runs.records[r])] for v, r in zip(values, runs.record_of_run, strict=True)]


def run_digests(runs: Runs) -> tuple[str, ...]:
    """Tell runs apart by their point and their record."""
    hashes = [r.content_hash for r in runs.records]
    return tuple(
        digest(point, hashes[record])[:16] for point, record in zip(runs.design.values, runs.record_of_run, strict=True)
    )


def fitted_range(design: Design) -> tuple[np.ndarray, np.ndarray]:
    """Range of a design, a hundredth of its width wider, but not beyond the support of the prior."""
    low, high = design.values.min(axis=0, initial=np.inf), design.values.max(axis=0, initial=-np.inf)
    margin = 0.01 * (high - low)
    support = design.space.bounds
    return np.maximum(low - margin, support[:, 0]), np.minimum(high + margin, support[:, 1])


def common_step(where: str, records: Sequence[Excitation]) -> tuple[str, float]:
    """Return the kind and time step that all records share."""
    kinds, steps = {r.kind for r in records}, {r.dt for r in records}
    if len(kinds) > 1 or max(steps) / min(steps) - 1.0 > 1e-9:
        raise InputError(
            where,
            f"records of {len(kinds)} kinds and the steps {', '.join(f'{s:g} s' for s in sorted(steps))}",
            "records of one kind and one step",
            "Resample them, or fit one surrogate for each.",
        )
    return kinds.pop(), records[0].dt


class Stopwatch:
    """Seconds since it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Seconds so far."""
        return time.perf_counter() - self._start
