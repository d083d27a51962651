"""The interface of samplers: their settings, which draw from a target in blocks, and their results."""

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
"""Steps between two writes to the store. Random streams are derived block by block, so an interrupted run repeats one block."""

Keep = Callable[[int, Block], None]
"""Function that adds the wall time to a block and stores the block on disk under its number."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """log Z, Z = ∫ π₀(θ) L(θ) dθ."""

    value: float  # log Z
    error: float  # standard error of log Z
    each: Float[np.ndarray, " population"]  # log Z of independent populations
    # Smallest basin of attraction, as a fraction of the prior, whose mode is found with a probability of 95 %. Modes with
    # smaller basins may be missing in Z. NaN without a search
    smallest_basin: float = float("nan")
    # Whether the particles reached equilibrium. If not, regions they have not reached are missing in Z, and the error
    # does not include this
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
            return f"{text}, without regions that the particles have not reached: they are not in equilibrium"
        return text if np.isnan(self.smallest_basin) else f"{text} ({self.reach})"

    def __sub__(self, other: Evidence) -> LogBayesFactor:
        """Log Bayes factor against another model of the same measurement: log Z − log Z′, with its standard error."""
        return LogBayesFactor(self.value - other.value, float(np.hypot(self.error, other.error)))

    @property
    def reach(self) -> str:
        """Description of the modes that the evidence includes."""
        return f"includes modes whose basin of attraction covers {100 * self.smallest_basin:.2g} % of the prior or more"


class LogBayesFactor(NamedTuple):
    """Evidence of a measurement for one model against another."""

    value: float  # log of the ratio of both evidences [nat]; 5 nats are a ratio of 148
    error: float  # standard error of `value`

    def __str__(self) -> str:
        return f"log Bayes factor {self.value:.2f} ± {self.error:.2f}"


@dataclass(frozen=True)
class Cost:
    """Cost of a chain whose proposals come from a surrogate."""

    true_runs: int  # runs of the model itself, including the runs for starting points
    surrogate_runs: int  # runs of the surrogate in sub-chains
    acceptance: float  # fraction of proposals that the model accepted, over the kept steps
    sub_steps: int  # moves of a sub-chain, as tuned

    @property
    def speed_up(self) -> float:
        """Accepted moves of the chain per run of the model. Without the surrogate, each move takes one model run."""
        return self.acceptance * self.surrogate_runs / max(self.true_runs, 1)

    def __str__(self) -> str:
        return (
            f"{self.true_runs} model runs, {self.surrogate_runs} surrogate runs ({self.sub_steps} per proposal, "
            f"{self.acceptance:.0%} of the proposals accepted): {self.speed_up:.0f} moves per model run"
        )


@dataclass(frozen=True, eq=False)
class Drawn:
    """The draws of a sampler."""

    # Unconstrained coordinates of every step, including discarded steps
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
    `tests/architecture/trial/new_sampler.py` is a complete example: a random walk that continues after an interruption.

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
    """Whether the sampler draws from the posterior of the model itself and uses a surrogate only for proposals."""

    starts_elsewhere: ClassVar[bool] = True
    """Whether walkers start away from the posterior and may never reach it."""
    compared: ClassVar[bool] = False
    """Whether the draws are compared with an independent population, since a few chains may miss a tail or a mode."""

    @property
    def proposal_model(self) -> Model | None:
        """The surrogate that makes proposals; None if the target itself makes them."""
        return None

    def proposing_by(self, surrogate: Model) -> Sampler:
        """Return these settings with a surrogate that makes the proposals; for samplers that are exact.

        Parameters
        ----------
        surrogate : Model
            Surrogate of the sampled model.

        Returns
        -------
        Sampler
            The complete settings.
        """
        raise NotImplementedError(f"{type(self).__name__} does not use a surrogate's proposals")

    @property
    @abstractmethod
    def walkers(self) -> int:
        """Number of interacting walkers, particles or chains in each ensemble."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Settings that determine the draws, for hashes; without the number of steps, since more steps continue a chain.

        Returns
        -------
        dict
            Settings by name.
        """

    def evaluations(self, dimension: int) -> int:
        """Approximate number of density evaluations, including the start and discarded draws.

        Parameters
        ----------
        dimension : int
            Number of parameters.

        Returns
        -------
        int
            Number of evaluations of the target.
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
            Target to sample.
        seed : int
            Seed; with the number of a block it gives the block's random stream.
        start : ndarray (point, parameter) or None
            Points in SI to start from, for samplers that take them.
        blocks : list of dict
            Blocks already on disk, in order.
        keep : callable
            Stores a block on disk.
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
    """Largest correlation, among the parameters, between the walkers' positions before and after some moves."""
    a, b = (p - p.mean(axis=1, keepdims=True) for p in (before, after))
    scale = np.sqrt((a**2).sum(axis=(0, 1)) * (b**2).sum(axis=(0, 1)))
    return float(np.max((a * b).sum(axis=(0, 1)) / np.where(scale > 0, scale, 1.0)))


def joined(blocks: list[Block], steps: int) -> dict[str, np.ndarray]:
    """Concatenate blocks, without a copy if they are the consecutive parts of one array, as a finished store reads them."""
    return {name: _whole([b[name] for b in blocks])[:steps] for name in blocks[0]}


def _whole(parts: list[np.ndarray]) -> np.ndarray:
    """Concatenate arrays, or return the array whose consecutive parts they are."""
    whole = parts[0].base
    if whole is None or whole.shape != (sum(map(len, parts)), *parts[0].shape[1:]):
        return np.concatenate(parts)
    starts = whole.ctypes.data + whole.strides[0] * np.cumsum([0, *map(len, parts[:-1])])
    is_consecutive = [p.base is whole and p.ctypes.data == at for p, at in zip(parts, starts, strict=True)]
    return whole if all(is_consecutive) else np.concatenate(parts)


def block_lengths(steps: int) -> Iterator[int]:
    """Lengths of the blocks of a run."""
    for begin in range(0, steps, BLOCK_STEPS):
        yield min(BLOCK_STEPS, steps - begin)


def without_cut_off(blocks: list[Block], lengths: Sequence[int]) -> list[Block]:
    """Drop a last block that an earlier, shorter run truncated: its random stream belongs to a whole block."""
    cut_off = 0 < len(blocks) <= len(lengths) and len(blocks[-1]["log_density"]) < lengths[len(blocks) - 1]
    return blocks[:-1] if cut_off else blocks
