"""AIES: the affine-invariant ensemble sampler, several independent ensembles in one batch.

J. Goodman & J. Weare (2010), "Ensemble samplers with affine invariance", Comm. App. Math. Comp. Sci. 5, 65-80,
doi 10.2140/camcos.2010.5.65; differential-evolution moves after C. ter Braak (2006), doi 10.1007/s11222-006-8769-1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from structid.core.errors import ConvergenceError, InputError
from structid.core.progress import Progress
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments
from structid.inference.sampling.base import (
    BLOCK_STEPS,
    Block,
    Drawn,
    Keep,
    Sampler,
    block_lengths,
    joined,
    without_cut_off,
)
from structid.inference.sampling.moves import EnsembleState, Moves, halves, move_walkers
from structid.inference.target import Target

SETTLING_GAP = 30.0
"""While the ensemble settles, a walker this many nats below the median is considered trapped in a false mode."""
USUAL_CANDIDATES, USUAL_SETTLING = 20, 100
"""Default number of candidate starting points per walker, and default number of settling steps."""
START_TRIES = 50
"""Largest number of attempts to draw starting points of finite density."""


@check_arguments
@dataclass(frozen=True)
class AIES(Sampler):
    """Settings of the affine-invariant ensemble sampler.

    Parameters
    ----------
    walkers : int
        Walkers in an ensemble, even and at least twice the number of parameters.
    steps : int
        Steps of every walker.
    ensembles : int
        Independent ensembles; R-hat compares them.
    stretch : float
        a of the stretch move: Z ~ 1/√z on [1/a, a].
    differential_evolution : float
        Fraction of the steps that use a differential-evolution move instead of the stretch move.
    discard : float
        Fraction of the steps dropped at the start.
    start_candidates : int, optional
        Points drawn from the prior for every walker; a walker starts at one of them, chosen with a probability that grows
        with its density rank. 1 starts from plain prior draws. By default 20, but 1 for an external solver and for given
        starting points.
    settling_steps : int, optional
        Number of first steps during which, at the end of every block, walkers whose log density is more than `SETTLING_GAP` below
        their ensemble's median are moved to a random healthy walker of that ensemble. This frees walkers caught in a false mode.
        It is not a Markov move, so these steps must lie within the discarded part. By default 100, but at most the discarded steps.

    Examples
    --------
    >>> import structid as si
    >>> si.AIES(walkers=20, steps=400).ensembles
    4
    """

    walkers: int = 100
    steps: int = 4000
    ensembles: int = 4
    stretch: float = 2.0
    differential_evolution: float = 0.7
    discard: float = 0.25
    start_candidates: int | None = None
    settling_steps: int | None = None

    needed_length: ClassVar[float] = 50.0

    def __post_init__(self) -> None:
        for name, least in (
            ("walkers", 4),
            ("steps", 2),
            ("ensembles", 1),
            ("start_candidates", 1),
            ("settling_steps", 0),
        ):
            value = getattr(self, name)
            if value is None and name in ("start_candidates", "settling_steps"):
                continue
            if not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(f"AIES.{name}", f"{value!r}", f"a whole number, {least} or more")
        if self.walkers % 2:
            raise InputError("AIES.walkers", f"{self.walkers}", "an even number: the ensemble moves in two halves")
        if not self.stretch > 1.0:
            raise InputError("AIES.stretch", f"{self.stretch}", "a number above 1")
        for name in ("differential_evolution", "discard"):
            value = getattr(self, name)
            if not (0.0 <= value < 1.0 or (value == 1.0 and name == "differential_evolution")):
                raise InputError(f"AIES.{name}", f"{value}", "a fraction between 0 and 1")
        if self.settling_steps is not None and self.settling_steps > int(self.discard * self.steps):
            raise InputError(
                "AIES.settling_steps",
                f"{self.settling_steps}",
                f"at most {int(self.discard * self.steps)}, the number of discarded steps",
                "Reduce it or discard more: settling steps are not Markov moves and must be discarded.",
            )

    def describe(self) -> dict[str, float]:
        """Settings that determine the draws: all except the number of steps and the discarded fraction."""
        settings = {k: v for k, v in asdict(self).items() if k not in ("steps", "discard")}
        return settings | {"settling_steps": self.settled_steps}

    @property
    def settled_steps(self) -> int:
        """Number of initial steps during which the ensemble settles."""
        usual = min(USUAL_SETTLING, int(self.discard * self.steps)) // BLOCK_STEPS * BLOCK_STEPS
        return usual if self.settling_steps is None else self.settling_steps

    @property
    def in_words(self) -> str:
        """The settings in one line, for a report."""
        return (
            f"AIES, {self.ensembles} ensembles × {self.walkers} walkers × {self.steps} steps, {self.discard:.0%} discarded, "
            f"{self.differential_evolution:.0%} differential-evolution moves"
        )

    def run(
        self,
        target: Target,
        seed: int,
        start: np.ndarray | None,
        blocks: list[Block],
        keep: Keep,
        progress: Progress | None = None,
    ) -> Drawn:
        """Draw; see `Sampler.run`."""
        lengths = list(block_lengths(self.steps))
        blocks = without_cut_off(blocks, lengths)
        if blocks:
            state, start_failures = EnsembleState(blocks[-1]["phi"][-1], blocks[-1]["log_density"][-1]), 0
        else:
            state, start_failures = starting_state(target, self, seed, start)
        for index in range(len(blocks), len(lengths)):
            if 0 < index * BLOCK_STEPS <= self.settled_steps:
                state = settle(state, seed, index)
            state, block = run_block(target, self, state, seed, index, lengths[index])
            if index == 0:
                block["failed"][0] += start_failures
            keep(index, block)
            blocks = [*blocks, block]
            if progress is not None:
                progress(sum(lengths[: index + 1]), self.steps)
        every = joined(blocks, self.steps)
        return Drawn(every["phi"], every["log_density"], every["accepted"], int(every["failed"].sum()))


def starting_state(
    target: Target, settings: AIES, seed: int, points: np.ndarray | None = None
) -> tuple[EnsembleState, int]:
    """Choose starting points of finite density."""
    if settings.walkers < 2 * target.dimension:
        raise InputError(
            "AIES.walkers",
            f"{settings.walkers} for {target.dimension} parameters",
            f"{2 * target.dimension} or more: an ensemble must span the space",
            "Use more walkers: the default of a study is 32.",
        )
    rng = stream(seed, Purpose.ENSEMBLE_START, 0)
    total = settings.ensembles * settings.walkers
    usual = 1 if target.costs_runs or points is not None else USUAL_CANDIDATES
    candidates = usual if settings.start_candidates is None else settings.start_candidates
    required = total * candidates
    phi, density = np.empty((0, target.dimension)), np.empty(0)
    failed_simulations = 0
    for _ in range(START_TRIES):
        fresh = target.initial(required, rng) if points is None else _chosen(target, points, required, rng)
        value, failed = target.evaluate(fresh)
        failed_simulations += int(failed.sum())
        good = np.isfinite(value)
        phi, density = np.concatenate([phi, fresh[good]]), np.concatenate([density, value[good]])
        if len(phi) >= required:
            break
    else:
        raise ConvergenceError(
            f"Only {len(phi)} of {START_TRIES * required} starting points have a finite log density "
            f"({failed_simulations} simulations failed). Check the priors: most of their range cannot be simulated "
            "or has zero likelihood."
        )
    phi, density = phi[:required], density[:required]
    if candidates > 1:
        # Each ensemble draws its own walkers from its own candidates; Gumbel noise on the ranks keeps them dispersed.
        groups = density.reshape(settings.ensembles, -1)
        rank = np.argsort(np.argsort(groups, axis=1), axis=1)
        score = rank / settings.walkers + rng.gumbel(size=rank.shape)
        chosen = np.argsort(-score, axis=1)[:, : settings.walkers]
        chosen = (chosen + np.arange(settings.ensembles)[:, None] * groups.shape[1]).ravel()
        phi, density = phi[chosen], density[chosen]
    shape = (settings.ensembles, settings.walkers)
    return EnsembleState(phi.reshape(*shape, -1), density.reshape(shape)), failed_simulations


def _chosen(target: Target, points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw starting points from given points, with as few repetitions as possible."""
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    if points.shape[1] != target.dimension or len(points) < 2 * target.dimension:
        raise InputError(
            "sample(start)",
            f"an array of shape {points.shape}",
            f"({2 * target.dimension} points or more, {target.dimension} parameters)",
        )
    rows = np.concatenate([rng.permutation(len(points)) for _ in range(-(-count // len(points)))])[:count]
    return target.bijection.inverse(points[rows])


def run_block(
    target: Target, settings: AIES, state: EnsembleState, seed: int, index: int, steps: int
) -> tuple[EnsembleState, Block]:
    """Move every walker `steps` times."""
    rng = stream(seed, Purpose.ENSEMBLE_MOVES, index)
    state, moves = state.copied(), Moves(settings.stretch, settings.differential_evolution)
    ensembles, walkers, dimension = state.phi.shape
    block: Block = {
        "phi": np.empty((steps, ensembles, walkers, dimension)),
        "log_density": np.empty((steps, ensembles, walkers)),
        "accepted": np.empty((steps, ensembles, walkers), dtype=bool),
        "failed": np.zeros(steps, dtype=np.int64),
    }
    for step in range(steps):
        for moving, resting in halves(walkers):
            accepted, failed = move_walkers(rng, target, state.part(moving), state.part(resting), moves)
            block["accepted"][step, :, moving] = accepted
            block["failed"][step] += failed
        block["phi"][step], block["log_density"][step] = state
    return state, block


def settle(state: EnsembleState, seed: int, index: int) -> EnsembleState:
    """Move walkers trapped in a false mode to healthy walkers of their ensemble."""
    rng = stream(seed, Purpose.ENSEMBLE_SETTLING, index)
    phi, density = state.copied()
    for ensemble in range(len(phi)):
        lost = density[ensemble] < np.median(density[ensemble]) - SETTLING_GAP
        hosts = rng.choice(np.flatnonzero(~lost), size=int(lost.sum()))
        phi[ensemble, lost], density[ensemble, lost] = phi[ensemble, hosts], density[ensemble, hosts]
    return EnsembleState(phi, density)


def study_defaults(given: Mapping[str, Any]) -> dict[str, Any]:
    """Default settings of a study file; the benchmark study converges with them."""
    defaults: dict[str, Any] = {
        "walkers": 32,
        "steps": 3000,
        "ensembles": 4,
        "differential_evolution": 0.8,
        "discard": 0.3,
        "start_candidates": 10,
    }
    settings = {**defaults, **given}
    return {**defaults, "settling_steps": min(500, int(settings["discard"] * settings["steps"]))}
