"""The record of a surrogate's fit, and checks of the training runs."""

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
"""Minimum number of completed runs."""

OutsideRule = Literal["warn", "refuse", "allow"]
"""Treatment of points outside the range of the design."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Record of how a surrogate was fitted."""

    kind: str  # class name of the settings, such as ``"PODKriging"``
    settings: dict[str, Any]  # settings of the surrogate, JSON-compatible
    space: ParameterSpace  # The parameters
    channels: tuple[str, ...]  # channels of the histories
    excitation: str  # kind of the records
    dt: float  # time step of the records [s]
    low: Float[np.ndarray, " parameter"]  # lower end of the design's range
    high: Float[np.ndarray, " parameter"]  # upper end of the design's range
    runs: int  # number of runs used, including held-out runs
    left_out: int  # number of failed runs
    error: float  # mean relative error estimated during the fit, by leave-one-out or on held-out runs
    limit: float  # largest mean error accepted in a posterior
    outside: Literal[
        "warn", "refuse", "allow"
    ]  # treatment of points outside the range: ``"warn"``, ``"refuse"``, ``"allow"``
    seconds: float = field(default=float("nan"))  # wall time of the fit
    seen: tuple[str, ...] = ()  # digest of each run used; these runs cannot validate the surrogate
    # Distance of extrapolation beyond the range of the design, as a fraction of the range's width; the response is
    # constant further out
    reach: float = 0.0

    @property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest parameter values of direct predictions: the design range plus the extrapolation."""
        margin, support = self.reach * (self.high - self.low), self.space.bounds
        return np.maximum(self.low - margin, support[:, 0]), np.minimum(self.high + margin, support[:, 1])

    def to_plain(self) -> dict[str, Any]:
        """Convert to JSON-compatible values."""
        plain = {f.name: getattr(self, f.name) for f in fields(self)}
        return plain | {"space": self.space.to_plain(), "low": self.low.tolist(), "high": self.high.tolist()}

    @classmethod
    def from_plain(cls, said: Mapping[str, Any]) -> Fit:
        """Rebuild from the result of `to_plain`."""
        arrays = {"low": np.array(said["low"]), "high": np.array(said["high"])}
        tuples = {"channels": tuple(said["channels"]), "seen": tuple(said["seen"])}
        return cls(**{**said, **arrays, **tuples, "space": ParameterSpace.from_plain(said["space"])})


def fitting_runs(where: str, runs: Any, fewest: int = FEWEST_RUNS) -> tuple[Runs, int]:
    """Check the runs for a fit, and drop failed runs."""
    if not isinstance(runs, Runs):
        raise InputError(where, f"a {type(runs).__name__}", "Runs, the result of a Campaign")
    done = runs[runs.done]
    left_out = len(runs) - len(done)
    check_enough(where, len(done), f"{len(done)} finished runs and {left_out} other runs", fewest)
    if not np.isfinite(done.design.values).all():
        raise InputError(where, "some parameters are not finite", "finite numbers")
    spread = np.zeros(len(done.channels))
    for batch in done.batches():
        values = _known_samples(batch)
        if not all(np.isfinite(v).all() for v in values):
            raise InputError(
                where,
                "histories of finished runs have values that are not finite",
                "finite numbers",
                "Set the status of these runs to a failure, so that they are left out.",
            )
        spread = np.maximum(spread, np.max([np.ptp(v, axis=0) for v in values], axis=0))
    constant = [c for c, s in zip(done.channels, spread, strict=True) if s == 0.0]
    if constant:
        raise InputError(where, f"the channel '{constant[0]}' is constant in every run", "channels that vary")
    return done, left_out


def checked_weights(where: str, weights: Float[np.ndarray, " run"], runs: Runs) -> Float[np.ndarray, " finished_run"]:
    """Check the weights of runs, and drop the weights of failed runs."""
    weights = np.asarray(weights, dtype=np.float64)
    if weights.shape != (len(runs),) or not (np.isfinite(weights) & (weights > 0.0)).all():
        raise InputError(f"{where}: weights", f"an array of shape {weights.shape}", f"{len(runs)} positive numbers")
    kept = weights[runs.done]
    return np.asarray(kept / kept.mean())


def check_enough(where: str, runs: int, came: str, fewest: int = FEWEST_RUNS) -> None:
    """Refuse too few runs."""
    if runs < fewest:
        raise InputError(where, came, f"at least {fewest} finished runs")


def _known_samples(runs: Runs) -> list[np.ndarray]:
    values = runs.values
    return [v[: len(runs.records[r])] for v, r in zip(values, runs.record_of_run, strict=True)]


def run_digests(runs: Runs) -> tuple[str, ...]:
    """Return a digest of point and record for each run."""
    hashes = [r.content_hash for r in runs.records]
    return tuple(
        digest(point, hashes[record])[:16] for point, record in zip(runs.design.values, runs.record_of_run, strict=True)
    )


def fitted_range(design: Design) -> tuple[np.ndarray, np.ndarray]:
    """Return the range of a design, widened by 1 % on each side but not beyond the support of the prior."""
    low, high = design.values.min(axis=0, initial=np.inf), design.values.max(axis=0, initial=-np.inf)
    margin = 0.01 * (high - low)
    support = design.space.bounds
    return np.maximum(low - margin, support[:, 0]), np.minimum(high + margin, support[:, 1])


def common_step(where: str, records: Sequence[Excitation]) -> tuple[str, float]:
    """Return the kind and time step shared by all records."""
    kinds, steps = {r.kind for r in records}, {r.dt for r in records}
    if len(kinds) > 1 or max(steps) / min(steps) - 1.0 > 1e-9:
        raise InputError(
            where,
            f"records of {len(kinds)} kinds and the time steps {', '.join(f'{s:g} s' for s in sorted(steps))}",
            "records of one kind and one time step",
            "Resample the records, or fit a surrogate for each kind and step.",
        )
    return kinds.pop(), records[0].dt


class Stopwatch:
    """A stopwatch that measures the seconds since its creation."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Elapsed seconds."""
        return time.perf_counter() - self._start
