"""Model runs at fresh draws of a posterior that was not sampled with the model itself, and stored runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from structid.certification.limits import Limits


class DensityDifference(NamedTuple):
    """Average difference between q and the densities that are fitted without one fold of draws."""

    variation: float = 0.0  # coefficient of variation of the ratio of their density to q
    mean: Float[np.ndarray, " parameter"] = np.zeros(1)  # difference of their means, in standard deviations of q
    sd: Float[np.ndarray, " parameter"] = np.zeros(1)  # relative difference of their standard deviations

    @classmethod
    def average(cls, some: Sequence[DensityDifference]) -> DensityDifference:
        """Average the differences of several densities; the triangle inequality holds for each and for the average."""
        parts = [np.mean(part, axis=0) for part in zip(*some, strict=True)]
        return cls(float(parts[0]), *parts[1:])

    def to_entry(self) -> dict[str, np.ndarray]:
        """Convert to arrays for a journal."""
        return {f"beside_{name}": np.asarray(value) for name, value in self._asdict().items()}

    @classmethod
    def of(cls, entry: Mapping[str, np.ndarray]) -> DensityDifference:
        """Rebuild from a journal entry; its other items are ignored."""
        return cls(float(entry["beside_variation"]), entry["beside_mean"], entry["beside_sd"])


THEMSELVES = DensityDifference()
"""The difference of q from itself."""


@dataclass(frozen=True, eq=False)
class FreshDraws:
    """Draws from q, or from a wider density, at which the model was run."""

    theta: Float[np.ndarray, "draw parameter"]  # in SI; no surrogate was fitted to them
    # Quantities of the draws whose means and standard deviations are compared; see `Target.compared`
    compared: Float[np.ndarray, "draw parameter"]
    log_true: Float[np.ndarray, " draw"]  # log π there up to a constant, −inf where the model run failed
    log_drawn: Float[np.ndarray, " draw"]  # log q there, up to a constant
    # Weight of each draw in an average over q, one for plain draws; see `weight_variation`
    shares: Float[np.ndarray, " draw"]
    population: Float[np.ndarray, "point parameter"]  # many draws of q, in the compared quantities
    highest: float  # largest log q among them
    # Draws at which the model's density is zero, for example for a failed structure, not a failed run. Their weight is zero
    impossible: Bool[np.ndarray, " draw"] | None = None
    difference: DensityDifference = THEMSELVES  # average difference from q of the densities behind `log_drawn`
    # Fraction of π that may lie where q is zero and where no draw of q, and no weight, can reveal it
    missing: float = 0.0

    def repeated(self, times: int) -> FreshDraws:
        """The same draws several times: what more draws would show if they varied as these do."""
        theta, compared, log_true, log_drawn, shares = (
            np.concatenate([values] * times)
            for values in (self.theta, self.compared, self.log_true, self.log_drawn, self.shares)
        )
        return replace(
            self, theta=theta, compared=compared, log_true=log_true, log_drawn=log_drawn, shares=shares, impossible=None
        )

    @property
    def log_ratios(self) -> np.ndarray:
        """Log π/q of each draw; −inf where a model run failed."""
        return np.where(np.isfinite(self.log_true), self.log_true - self.log_drawn, -np.inf)

    @property
    def middle(self) -> float:
        """Median of log π/q over the draws with a completed model run."""
        ratios = self.log_ratios[np.isfinite(self.log_ratios)]
        return float(np.median(ratios)) if len(ratios) else 0.0

    @property
    def spread(self) -> float:
        """Standard deviation of log π/q over the draws; infinite if a model run failed or if there are no draws."""
        ratios = self.log_ratios[np.isfinite(self.log_true)]
        return float(np.std(ratios)) if len(ratios) and self.failed == 0 else float("inf")

    @property
    def failed(self) -> int:
        """Number of draws whose model run failed."""
        stopped = ~np.isfinite(self.log_true)
        return int((stopped if self.impossible is None else stopped & ~self.impossible).sum())

    @property
    def weights(self) -> np.ndarray:
        """Weights of the draws in averages over π, which sum to one."""
        ratios = self.log_ratios
        if not np.isfinite(ratios).any():
            return np.full(len(ratios), 1.0 / len(ratios))
        weights = self.shares * np.exp(ratios - ratios.max())
        return np.asarray(weights / weights.sum())


@dataclass(frozen=True, eq=False)
class StoredRuns:
    """Log densities at the model runs of all rounds."""

    log_true: Float[np.ndarray, " run"] = field(default_factory=lambda: np.empty(0))  # log π
    # Log q at the same error-model parameters
    log_drawn: Float[np.ndarray, " run"] = field(default_factory=lambda: np.empty(0))

    @property
    def _ran(self) -> np.ndarray:
        return np.asarray(np.isfinite(self.log_true))

    def above(self, highest: float) -> float:
        """Excess of the best run's log density over the best draw's."""
        return float(self.log_true[self._ran].max() - highest) if self._ran.any() else float("-inf")

    def excess(self, middle: float, reach: float) -> tuple[float, int]:
        """Largest log π/q of the relevant runs, relative to the median over the draws."""
        if not self._ran.any():
            return float("-inf"), 0
        near = self._ran & (self.log_true >= self.log_true[self._ran].max() - reach)
        gap = self.log_true[near] - self.log_drawn[near]
        return float(gap.max() - middle), int(near.sum())

    def understated(self, middle: float, limits: Limits) -> int:
        """Number of runs beyond reach whose density q understates by more than a fraction of their depth."""
        if not self._ran.any():
            return 0
        depth = self.log_true[self._ran].max() - self.log_true[self._ran]
        gap = self.log_true[self._ran] - self.log_drawn[self._ran] - middle
        far = depth > limits.reach
        return int(np.count_nonzero(far & (gap > np.maximum(limits.excess, limits.understated * depth))))
