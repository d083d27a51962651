"""The interface of samplers: settings that draw from a target in blocks, and the results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import logsumexp

from structid.core.progress import Progress
from structid.inference.target import Target
from structid.models.base import Model

Block = dict[str, np.ndarray]
"""Arrays with a leading step axis."""

BLOCK_STEPS = 50
"""Steps between two writes to the store. Random streams are derived block by block, so a killed run repeats one block."""

Keep = Callable[[int, Block], None]
"""Adds the wall time to a block, and stores it on disk under its number."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """log Z, Z = ∫ π₀(θ) L(θ) dθ."""

    value: float  # log Z
    error: float  # Its standard error
    each: Float[np.ndarray, " population"]  # log Z of independent populations
    # Share of the prior in the basin of a mode (from where a way uphill leads to it) from which on the mode is found
    # with a probability of 95 %. Modes with smaller basins may be missing in Z. NaN where none were searched for
    smallest_basin: float = float("nan")
    # Whether the particles had come to rest. Where they had not, Z lacks what they had not reached, and the error does
    # not know
    at_rest: bool = True

    @classmethod
    def of_populations(
        cls,
        each: Float[np.ndarray, " population"],
        variance: Float[np.ndarray, " population"],
        lacking: Float[np.ndarray, " population"],
    ) -> Evidence:
        """Average the evidence of independent populations."""
        count = len(each)
        value = float(logsumexp(each) - np.log(count))
        between, unsure = (each.var(ddof=1), lacking.var(ddof=1)) if count > 1 else (0.0, 0.0)
        error = np.sqrt((max(between, variance.mean()) + unsure) / count + lacking.mean() ** 2)
        return cls(value, float(error), each)

    def __str__(self) -> str:
        text = f"log evidence {self.value:.2f} ± {self.error:.2f}"
        if not self.at_rest:
            return f"{text}, without what the particles have not reached: they are not at rest"
        return text if np.isnan(self.smallest_basin) else f"{text} ({self.reach})"

    def __sub__(self, other: Evidence) -> LogBayesFactor:
        """Log Bayes factor against another model of the same measurement: log Z − log Z′, with both errors."""
        return LogBayesFactor(self.value - other.value, float(np.hypot(self.error, other.error)))

    @property
    def reach(self) -> str:
        """Which modes it includes."""
        return f"of the modes whose basin holds {100 * self.smallest_basin:.2g} % of the prior or more"


class LogBayesFactor(NamedTuple):
    """Evidence of a measurement for one model against another."""

    value: float  # log of the ratio of both evidences [nat]: e^5 is 148 to 1
    error: float  # Its standard error

    def __str__(self) -> str:
        return f"log Bayes factor {self.value:.2f} ± {self.error:.2f}"


@dataclass(frozen=True)
class Cost:
    """Cost of a chain whose proposals come from a surrogate."""

    true_runs: int  # runs of the model itself, including those of the start
    surrogate_runs: int  # runs of the surrogate in sub-chains
    acceptance: float  # fraction of proposals that the model accepted, over the kept steps
    sub_steps: int  # moves of a sub-chain, as tuned

    @property
    def speed_up(self) -> float:
        """Accepted moves of the chain per run of the model. Without the surrogate, each move takes a run."""
        return self.acceptance * self.surrogate_runs / max(self.true_runs, 1)

    def __str__(self) -> str:
        return (
            f"{self.true_runs} model runs, {self.surrogate_runs} of the surrogate ({self.sub_steps} to a proposal, "
            f"{self.acceptance:.0%} of them accepted): {self.speed_up:.0f} moves for each model run"
        )


@dataclass(frozen=True, eq=False)
class Drawn:
    """The draws of a sampler."""

    # Unconstrained coordinates of every step, the discarded ones included
    phi: Float[np.ndarray, "step ensemble walker parameter"]
    log_density: Float[np.ndarray, "step ensemble walker"]  # log density with respect to φ
    accepted: Bool[np.ndarray, "step ensemble walker"]  # whether each proposal was accepted
    failed: int  # failed simulations
    log_evidence: Evidence | None = None  # for samplers that estimate it
    cost: Cost | None = None  # for samplers that run both a model and its surrogate
    divergent: int = 0  # trajectories that did not conserve energy


class Sampler(ABC):
    """Settings of a sampler; `structid.sample` draws with it.

    Examples
    --------
    `tests/architecture/trial/new_sampler.py` is a complete one, a random walk that a killed run continues.

    >>> import structid as si
    >>> sampler = si.AIES(walkers=20, steps=400)
    >>> sampler.evaluations(dimension=4)
    32000
    """

    ensembles: int
    steps: int
    discard: float

    needed_length: ClassVar[float]
    """Number of autocorrelation times that the kept steps of a converged run must span."""
    needs_derivatives: ClassVar[bool] = False
    """Whether the target's density must be a JAX function."""
    interacting: ClassVar[bool] = True
    """Whether walkers interact, so that an ensemble must have at least twice as many walkers as there are parameters."""
    exact: ClassVar[bool] = False
    """Whether it draws from the posterior of the model itself, with a surrogate that only proposes."""

    starts_elsewhere: ClassVar[bool] = True
    """Whether walkers start away from the posterior, so that one may never get there."""
    compared: ClassVar[bool] = False
    """Whether its draws are compared with those of an independent population: few chains can miss a tail or a mode together."""

    @property
    def proposal_model(self) -> Model | None:
        """The surrogate that makes proposals; None where the target itself does."""
        return None

    def proposing_by(self, surrogate: Model) -> Sampler:
        """Return these settings with a surrogate that makes the proposals; for samplers that are exact.

        Parameters
        ----------
        surrogate : Model
            Of the model that is sampled.

        Returns
        -------
        Sampler
            The settings, complete.
        """
        raise NotImplementedError(f"{type(self).__name__} has no use for a surrogate's proposals")

    @property
    @abstractmethod
    def walkers(self) -> int:
        """Interacting walkers, particles or chains in each ensemble."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Settings that decide the draws, for hashes: more steps continue the same chain.

        Returns
        -------
        dict
            By name.
        """

    def evaluations(self, dimension: int) -> int:
        """Densities that will be evaluated, about; those of the start and of discarded draws included.

        Parameters
        ----------
        dimension : int
            Number of parameters.

        Returns
        -------
        int
            Of the target that is sampled.
        """
        return self.steps * self.ensembles * self.walkers

    @property
    @abstractmethod
    def in_words(self) -> str:
        """The settings in one line, for a report."""

    @abstractmethod
    def run(
        self,
        target: Target,
        seed: int,
        start: np.ndarray | None,
        blocks: list[Block],
        keep: Keep,
        progress: Progress | None = None,
    ) -> Drawn:
        """Draw, continuing from the blocks on disk.

        Parameters
        ----------
        target : Target
            What to sample.
        seed : int
            Seed; with the number of a block it gives the block's random stream.
        start : ndarray (point, parameter) or None
            Points in SI to start from, for samplers that take them.
        blocks : list of dict
            What is already on disk, in order.
        keep : callable
            Puts a block on disk.
        progress : callable, optional
            Called with the amount done and the total.

        Returns
        -------
        Drawn
            All draws.
        """


def correlation(
    before: Float[np.ndarray, "ensemble walker parameter"], after: Float[np.ndarray, "ensemble walker parameter"]
) -> float:
    """Largest correlation, over the parameters, between two positions of every walker."""
    a, b = (p - p.mean(axis=1, keepdims=True) for p in (before, after))
    scale = np.sqrt((a**2).sum(axis=(0, 1)) * (b**2).sum(axis=(0, 1)))
    return float(np.max((a * b).sum(axis=(0, 1)) / np.where(scale > 0, scale, 1.0)))


def joined(blocks: list[Block], steps: int) -> dict[str, np.ndarray]:
    """Concatenate blocks."""
    return {name: np.concatenate([b[name] for b in blocks])[:steps] for name in blocks[0]}


def block_lengths(steps: int) -> Iterator[int]:
    """Lengths of the blocks of a run."""
    for begin in range(0, steps, BLOCK_STEPS):
        yield min(BLOCK_STEPS, steps - begin)


def without_cut_off(blocks: list[Block], lengths: Sequence[int]) -> list[Block]:
    """Drop a last block that an earlier, shorter run truncated: its random stream is that of a whole block."""
    cut_off = 0 < len(blocks) <= len(lengths) and len(blocks[-1]["log_density"]) < lengths[len(blocks) - 1]
    return blocks[:-1] if cut_off else blocks
