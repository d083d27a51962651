"""Tempered sequential Monte Carlo: from the prior to the posterior by tempering steps, with the evidence.

P. Del Moral, A. Doucet & A. Jasra (2006), doi 10.1111/j.1467-9868.2006.00553.x; adaptive exponents after J. Ching &
Y.-C. Chen (2007), doi 10.1061/(ASCE)0733-9399(2007)133:7(816). Particles move like the walkers of an ensemble, or to a
draw from a proposal fitted to the resting particles, so the target needs no gradient. The target may run an external
solver, whose failures are counted. Every tempering step is on disk before the next begins.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import ClassVar

import numpy as np

from structid.core.errors import ConvergenceError, InputError
from structid.core.progress import Progress
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments
from structid.inference.sampling.base import (
    BLOCK_STEPS,
    Block,
    Drawn,
    Evidence,
    Keep,
    Sampler,
    block_lengths,
    joined,
    without_cut_off,
)
from structid.inference.sampling.moves import EnsembleState
from structid.inference.sampling.smc.bridge_sampling import evidence_of
from structid.inference.sampling.smc.lost_modes import Mode, densest, lost_modes, thin_modes
from structid.inference.sampling.smc.particle_mixing import still_moving
from structid.inference.sampling.smc.proposal_weights import evidence_of_proposals
from structid.inference.sampling.smc.reference_density import FromReference
from structid.inference.sampling.smc.tempering import Population, block_of, run_moves, run_stage, starting_population
from structid.inference.target import Target

MOST_STAGES = 200
"""Largest number of tempering steps before the run stops with an error."""
EVALUATIONS = (1.4, 25.0)
"""Evaluations per particle in a tempering run with d parameters: the smaller of d² times the first value and d times
the second; see `SMC.evaluations`. Posteriors of 5 to 36 parameters take half to twice as many."""
NEGLIGIBLE = 1e-3
"""Mass of a lost mode, relative to the mass found, below which particles do not restart."""
RISEN = 0.01
"""Mass of a mode that has risen at β = 1, relative to the evidence, from which the particles restart."""
MORE_BY = 3.0
"""Standard errors by which the evidence of a second tempering run must exceed the first's to replace it."""


@check_arguments
@dataclass(frozen=True)
class SMC(Sampler):
    """Settings of tempered sequential Monte Carlo.

    Particles begin as draws of the prior π₀ and pass through π₀ L^β with β rising from 0 to 1. Each tempering step weights
    them by L^Δβ, resamples them by these weights, and moves them. The evidence ∫ π₀ L is a product over neighbouring steps: the
    ratios of their normalising constants, each by Bennett's acceptance ratio from the particles of both.

    Parameters
    ----------
    particles : int
        Particles of a population, even and at least twice the number of parameters.
    ensembles : int
        Independent populations; R-hat compares them, and the evidence's error comes from them.
    steps : int
        Moves of every particle once β = 1 is reached; these are kept.
    effective_share : float
        Effective fraction of the particles after the weighting of a tempering step. It determines Δβ.
    correlation : float
        Particles move in a tempering step until no parameter, nor the log-likelihood, correlates by more than this with its value
        at the start of the step, and until the mean log-likelihood has stopped rising.
    least_moves, most_moves : int
        Smallest and largest number of moves in a tempering step. If the largest is too small, the error of the evidence grows.
    stretch : float
        a of the stretch move.
    independent : float
        Fraction of the moves that are independence moves, drawn from proposals fitted to the resting particles. If these
        resemble the posterior, such a move makes a particle independent of its start. With dozens of parameters they do not;
        0 then saves these moves.
    differential_evolution : float
        Fraction of the other moves that are differential-evolution moves instead of stretch moves.
    scouts : int
        Prior draws for each particle, from which lost modes are searched. If a lost mode is found, the particles restart around
        all known modes. 0 disables the search.

    Examples
    --------
    >>> import structid as si
    >>> si.SMC(particles=500, ensembles=2).particles
    500
    """

    particles: int = 1000
    ensembles: int = 4
    steps: int = 100
    effective_share: float = 0.7
    correlation: float = 0.2
    least_moves: int = 3
    most_moves: int = 40
    stretch: float = 2.0
    independent: float = 0.6
    differential_evolution: float = 0.5
    scouts: int = 1

    discard = 0.0  # no field: no start is discarded
    # Particles begin in the posterior. Within one τ, copies of a particle have separated.
    needed_length: ClassVar[float] = 1.0
    starts_elsewhere: ClassVar[bool] = False

    def __post_init__(self) -> None:
        counts = {"particles": 4, "ensembles": 1, "steps": 1, "least_moves": 1, "most_moves": 1, "scouts": 0}
        for name, least in counts.items():
            value = getattr(self, name)
            if not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(f"SMC.{name}", f"{value!r}", f"a whole number, {least} or more")
        if self.particles % 2:
            raise InputError("SMC.particles", f"{self.particles}", "an even number: a population moves in two halves")
        for name in ("effective_share", "correlation"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError(f"SMC.{name}", f"{getattr(self, name)}", "a fraction between 0 and 1")
        for name in ("independent", "differential_evolution"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"SMC.{name}", f"{getattr(self, name)}", "a fraction from 0 to 1")
        if not self.stretch > 1.0:
            raise InputError("SMC.stretch", f"{self.stretch}", "a number above 1")

    @property
    def walkers(self) -> int:
        """Particles of a population."""
        return self.particles

    def describe(self) -> dict[str, float | str]:
        """Settings that determine the draws: all except the number of kept steps."""
        return {"kind": "smc", **{k: v for k, v in asdict(self).items() if k != "steps"}}

    def evaluations(self, dimension: int) -> int:
        """Approximate number of density evaluations; see `Sampler.evaluations`."""
        # A larger effective share takes more tempering steps, and a smaller correlation takes more moves.
        longer = np.log(self.correlation) / np.log(self.effective_share)
        tempering = dimension * min(EVALUATIONS[0] * dimension, EVALUATIONS[1]) * longer
        return int(self.ensembles * self.particles * (tempering + self.scouts * (15 + dimension) + self.steps))

    @property
    def in_words(self) -> str:
        """The settings in one line, for a report."""
        return (
            f"tempered SMC, {self.ensembles} populations × {self.particles} particles, {self.steps} moves at β = 1, "
            f"{self.independent:.0%} independence moves, {self.differential_evolution:.0%} of the others differential evolution"
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
        self._refuse(target, start)
        blocks = _without_cut_off(blocks, self.steps)
        self._to_the_posterior(target, seed, blocks, keep, progress)
        if self._may_have_lost(blocks):
            reference = self._around_lost_modes(target, seed, blocks)
            if reference is not None:
                self._to_the_posterior(reference, seed, blocks, keep, progress, ordinal=1)
        if not _restarted(blocks):
            self._in_the_posterior(target, seed, blocks, keep, progress)
        if _restarted(blocks) or _divided(blocks)[1][-1]["risen"][-1]:
            self._restart(target, seed, blocks, keep, progress)
        return self._drawn(blocks)

    def _restart(self, target: Target, seed: int, blocks: list[Block], keep: Keep, progress: Progress | None) -> None:
        """Temper and move once more, from a reference density around risen modes; or go on with it."""
        (temperings, moves), restarted = _divided(blocks), _restarted(blocks)
        if not (restarted and moves):
            reference = self._around_risen_modes(target, blocks)
            self._to_the_posterior(reference, seed, blocks, keep, progress, len(temperings) - restarted)
        self._in_the_posterior(target, seed, blocks, keep, progress)

    def _refuse(self, target: Target, start: np.ndarray | None) -> None:
        """Refuse starting points, and too few particles."""
        if start is not None:
            raise InputError(
                "sample(start)", "starting points for SMC", "no starting points: SMC particles start from the prior"
            )
        if self.particles < 2 * target.dimension:
            raise InputError(
                "SMC.particles",
                f"{self.particles} for {target.dimension} parameters",
                f"{2 * target.dimension} or more: a population must span the space",
            )

    def _to_the_posterior(
        self,
        target: Target,
        seed: int,
        blocks: list[Block],
        keep: Keep,
        progress: Progress | None,
        ordinal: int = 0,
    ) -> None:
        """Append a block for each tempering step until β = 1; `ordinal` counts the runs from other references before this one."""
        temperings, _ = _divided(blocks)
        if len(temperings) <= ordinal:
            population = starting_population(self, target, seed, ordinal)
            self._append(block_of([population], [], []), blocks, keep)
        population, first = Population.of(blocks[-1]), len(blocks) - len(_divided(blocks)[0][-1])
        while population.exponent < 1.0 and len(_divided(blocks)[0]) == 1 + ordinal:
            number = len(blocks)
            if number - first == MOST_STAGES:
                raise ConvergenceError(
                    f"The tempering has reached the exponent {population.exponent:.2g} after {MOST_STAGES} tempering steps. Check "
                    "the likelihood: it is finite almost nowhere, or far too narrow for this number of particles."
                )
            population, block = run_stage(self, target, population, stream(seed, Purpose.SMC_STAGE, number))
            self._append(block, blocks, keep)
            if progress is not None:
                progress(int(50 * min(1.0, max(0.0, 1 + np.log10(population.exponent) / 6))), 100)

    @staticmethod
    def _append(block: Block, blocks: list[Block], keep: Keep) -> None:
        """Store a block on disk and append it to the earlier blocks."""
        keep(len(blocks), block)
        blocks.append(block)

    def _may_have_lost(self, blocks: list[Block]) -> bool:
        """Whether to search for lost modes: after the first tempering run, and while a second is in progress."""
        temperings, moves = _divided(blocks)
        if self.scouts == 0 or moves or _restarted(blocks):
            return False
        return len(temperings) == 1 or bool(temperings[1][-1]["exponent"][-1] < 1.0)

    def _around_lost_modes(self, target: Target, seed: int, blocks: list[Block]) -> FromReference | None:
        """A reference density around known modes, lost ones, and those with too few particles; None if there are none of these."""
        stages, _ = _divided(blocks)
        end = Population.of(stages[0][-1])
        scouts = target.initial(self.scouts * self.ensembles * self.particles, stream(seed, Purpose.SMC_SCOUTS))
        particles = end.phi.reshape(-1, target.dimension), end.log_density.ravel()
        evidence = _evidence(stages[0]).value
        lost = [m for m in lost_modes(target, *particles, scouts) if m.log_mass > evidence + np.log(NEGLIGIBLE)]
        modes = lost + thin_modes(target, *particles, densest(scouts, target.evaluate(scouts)[0]), evidence)
        return FromReference(target, EnsembleState(end.phi, end.log_density), modes) if modes else None

    def _risen_modes(self, target: Target, blocks: list[Block]) -> list[Mode]:
        """Narrow modes that particles have reached while they moved at β = 1, and where too few of them are."""
        temperings, moves = _divided(blocks)
        phi, log_density = (np.concatenate([b[name] for b in moves]) for name in ("phi", "log_density"))
        phi, log_density = phi.reshape(-1, target.dimension), log_density.ravel()
        evenly = np.linspace(0, len(phi) - 1, self.ensembles * self.particles).astype(int)
        evidence = _fullest(temperings)[1].value
        modes = thin_modes(target, phi[evenly], log_density[evenly], densest(phi, log_density), evidence)
        return [mode for mode in modes if mode.log_mass > evidence + np.log(RISEN)]

    def _around_risen_modes(self, target: Target, blocks: list[Block]) -> FromReference:
        """A reference density around known and risen modes."""
        before = blocks[: len(blocks) - len(_divided(blocks)[0][-1])] if _restarted(blocks) else blocks
        end = Population.of(before[-1])
        return FromReference(target, EnsembleState(end.phi, end.log_density), self._risen_modes(target, before))

    def _in_the_posterior(
        self, target: Target, seed: int, blocks: list[Block], keep: Keep, progress: Progress | None
    ) -> None:
        """Append the blocks of the moves at β = 1."""
        temperings, moves = _divided(blocks)
        population = Population.of(moves[-1] if moves else _fullest(temperings)[0][-1])
        for index, length in enumerate(block_lengths(self.steps)):
            if index < len(moves):
                continue
            number = index + len(temperings) * _restarted(blocks) * MOST_STAGES
            population, block = run_moves(self, target, population, stream(seed, Purpose.SMC_MOVES, number), length)
            is_last = (index + 1) * BLOCK_STEPS >= self.steps
            if is_last and self.scouts > 0 and not _restarted(blocks):
                block["risen"][-1] = bool(self._risen_modes(target, [*blocks, block]))
            self._append(block, blocks, keep)
            if progress is not None:
                progress(50 + 50 * min((index + 1) * BLOCK_STEPS, self.steps) // self.steps, 100)

    def _drawn(self, blocks: list[Block]) -> Drawn:
        """Draws at β = 1, and the evidence."""
        temperings, moves = _divided(blocks)
        kept = joined(moves, self.steps)
        evidence = replace(
            _more_precise(_fullest(temperings)[1], evidence_of_proposals(kept["proposed"])),
            smallest_basin=3.0 / (self.scouts * self.ensembles * self.particles) if self.scouts else float("nan"),
            at_rest=not still_moving(kept["phi"], kept["log_density"]),
        )
        failed = int(sum(b["failed"].sum() for b in blocks))
        return Drawn(kept["phi"], kept["log_density"], kept["accepted"], failed, evidence)


def _divided(blocks: list[Block]) -> tuple[list[list[Block]], list[Block]]:
    """The blocks of each tempering run, which begins at β = 0, and the blocks of the moves at β = 1 after the last run."""
    temperings: list[list[Block]] = []
    moves: list[Block] = []
    for number, block in enumerate(blocks):
        if block["exponent"][0] == 0.0:
            temperings.append([block])
            moves = []
        elif blocks[number - 1]["exponent"][-1] == 1.0:
            moves.append(block)
        else:
            temperings[-1].append(block)
    return temperings, moves


def _restarted(blocks: list[Block]) -> bool:
    """Whether a tempering run began after moves at β = 1, around modes that had risen during them."""
    temperings, moves = _divided(blocks)
    return len(blocks) > len(moves) + sum(map(len, temperings))


def _evidence(stages: list[Block]) -> Evidence:
    """Evidence of a tempering run."""
    arrays = (np.concatenate([b[name] for b in stages]) for name in ("rise", "left"))
    return evidence_of([Population.of(b) for b in stages], *arrays)


def _fullest(temperings: list[list[Block]]) -> tuple[list[Block], Evidence]:
    """The tempering run to use: a later one if its evidence is larger, since lost mass is missing from the evidence."""
    best, *others = [(stages, _evidence(stages)) for stages in temperings]
    for other in others:
        more, error = other[1] - best[1]
        best = other if more > MORE_BY * error else best
    return best


def _more_precise(tempering: Evidence, proposals: Evidence | None) -> Evidence:
    """The evidence with the smaller standard error."""
    return tempering if proposals is None or proposals.error >= tempering.error else proposals


def _without_cut_off(blocks: list[Block], steps: int) -> list[Block]:
    """The blocks of the tempering steps and of the later moves, without a last block that a shorter run truncated."""
    _, moves = _divided(blocks)
    return blocks[: len(blocks) - len(moves)] + without_cut_off(moves, list(block_lengths(steps)))
