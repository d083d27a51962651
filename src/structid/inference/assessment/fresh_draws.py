"""True runs at draws of a posterior that was not drawn from the model itself, and those of before."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class FreshDraws:
    """Draws of q, or of something wider, at which the true model was run, and what is known of q besides.

    Parameters
    ----------
    theta : ndarray, shape (draw, parameter)
        In SI; no surrogate was fitted to them.
    log_true : ndarray, shape (draw,)
        Log density of π there up to a constant, −inf where the true run failed.
    log_drawn : ndarray, shape (draw,)
        Log density of q, likewise.
    shares : ndarray, shape (draw,)
        What each counts in an average over q: one for plain draws, see `weight_variation`.
    population : ndarray, shape (point, parameter)
        Many draws of q.
    highest : float
        Largest log density of q among them.
    impossible : ndarray of bool, shape (draw,), optional
        Draws at which −inf is the model's answer, such as a structure that failed, and no failed run. They weigh nothing.
    beside : float
        Coefficient of variation, over q, of the law that `log_drawn` belongs to: zero where that is q itself.
    """

    theta: np.ndarray
    log_true: np.ndarray
    log_drawn: np.ndarray
    shares: np.ndarray
    population: np.ndarray
    highest: float
    impossible: np.ndarray | None = None
    beside: float = 0.0

    @property
    def log_ratios(self) -> np.ndarray:
        """Of each draw, log π/q; −inf where a true run failed."""
        return np.where(np.isfinite(self.log_true), self.log_true - self.log_drawn, -np.inf)

    @property
    def middle(self) -> float:
        """Median of log π/q over the draws whose true run finished."""
        ratios = self.log_ratios[np.isfinite(self.log_ratios)]
        return float(np.median(ratios)) if len(ratios) else 0.0

    @property
    def spread(self) -> float:
        """Standard deviation of log π/q over plain draws; infinite where a true run failed, or without draws."""
        ratios = self.log_ratios[np.isfinite(self.log_true)]
        return float(np.std(ratios)) if len(ratios) and self.failed == 0 else float("inf")

    @property
    def failed(self) -> int:
        """Draws whose true run failed."""
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
    """Log densities at true runs of all rounds.

    Parameters
    ----------
    log_true, log_drawn : ndarray, shape (run,)
        Log densities of π and of q there, at the same discrepancy.
    """

    log_true: np.ndarray = field(default_factory=lambda: np.empty(0))
    log_drawn: np.ndarray = field(default_factory=lambda: np.empty(0))
