"""What every sampler is: settings that draw from a target, block by block, and what they return."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.special import logsumexp

from structid.inference.target import Target
from structid.models.base import Progress

Block = dict[str, np.ndarray]
"""Arrays with a leading step axis."""

Keep = Callable[[int, Block], None]
"""Adds to a block how long it took, and puts it on disk under its number."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """log Z, Z = ∫ π₀(θ) L(θ) dθ.

    Parameters
    ----------
    value : float
        log Z.
    error : float
        Its standard error.
    each : ndarray, shape (population,)
        log Z of independent populations.
    """

    value: float
    error: float
    each: np.ndarray

    @classmethod
    def of_populations(cls, each: np.ndarray, variance: np.ndarray) -> Evidence:
        """Average the evidence of independent populations.

        Parameters
        ----------
        each : ndarray, shape (population,)
            log Z of each.
        variance : ndarray, shape (population,)
            Variance of each log Z if its particles were independent.

        Returns
        -------
        Evidence
            The mean of Z; its error the larger of what the populations differ by and what independent particles would have.
        """
        count = len(each)
        value = float(logsumexp(each) - np.log(count))
        between = each.var(ddof=1) if count > 1 else 0.0
        return cls(value, float(np.sqrt(max(between, variance.mean()) / count)), each)

    def __str__(self) -> str:
        return f"log evidence {self.value:.2f} ± {self.error:.2f}"


@dataclass(frozen=True, eq=False)
class Drawn:
    """What a sampler has drawn.

    Parameters
    ----------
    phi : ndarray, shape (step, ensemble, walker, parameter)
        Unconstrained coordinates of every step, the discarded ones included.
    log_density : ndarray, shape (step, ensemble, walker)
        Log density with respect to φ.
    accepted : ndarray of bool, shape (step, ensemble, walker)
        Whether each proposal was accepted.
    failed : int
        Simulations that failed.
    log_evidence : Evidence, optional
        Of samplers that know it.
    """

    phi: np.ndarray
    log_density: np.ndarray
    accepted: np.ndarray
    failed: int
    log_evidence: Evidence | None = None


class Sampler(ABC):
    """Settings of a sampler; `structid.sample` draws with it."""

    ensembles: int
    steps: int
    discard: float

    needed_length: ClassVar[float]
    """Kept steps, in autocorrelation times, of a converged run."""

    @property
    @abstractmethod
    def walkers(self) -> int:
        """Walkers, particles or chains that know one another, in each ensemble."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Settings that decide the draws, for hashes: more steps continue the same chain.

        Returns
        -------
        dict
            By name.
        """

    @property
    @abstractmethod
    def in_words(self) -> str:
        """The settings in a line, for a report."""

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
        """Draw, going on from the blocks that are there.

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
            Told how far it is.

        Returns
        -------
        Drawn
            All draws.
        """


def joined(blocks: list[Block], steps: int) -> dict[str, np.ndarray]:
    """Put blocks together.

    Parameters
    ----------
    blocks : list of dict
        In order.
    steps : int
        Steps that are wanted; a stored run may have more.

    Returns
    -------
    dict of str to ndarray
        With a leading step axis.
    """
    return {name: np.concatenate([b[name] for b in blocks])[:steps] for name in blocks[0]}


def stream(seed: int, purpose: int, index: int) -> np.random.Generator:
    """Random numbers of one block of one sampler.

    Parameters
    ----------
    seed : int
        The run's.
    purpose : int
        What they are for; another number for everything that draws.
    index : int
        The block's.

    Returns
    -------
    numpy.random.Generator
        The same for the same three.
    """
    return np.random.default_rng(np.random.SeedSequence([seed, purpose, index]))
