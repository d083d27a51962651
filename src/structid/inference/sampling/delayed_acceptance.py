"""Delayed acceptance: a surrogate makes long proposals, each accepted or rejected by one run of the model itself.

J. A. Christen & C. Fox (2005), "Markov chain Monte Carlo using an approximation", doi 10.1198/106186005X76983; several steps of
the approximation as one proposal: J. S. Liu (2001), "Monte Carlo Strategies in Scientific Computing", §9.4.3. The draws follow
the model's posterior for any surrogate; a poor surrogate only slows the sampling.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from structid.core.errors import ConvergenceError, InputError
from structid.core.progress import Progress
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.base import Block, Cost, Drawn, Keep, Sampler, correlation, joined
from structid.inference.sampling.moves import EnsembleState, IndependenceProposal, Moves, halves, move_walkers
from structid.inference.sampling.starting_points import tempered_draws
from structid.inference.sampling.transformed_target import TransformedTarget
from structid.inference.target import Target
from structid.models.base import Model

START_TRIES = 5
"""Largest number of attempts to find starting points with a finite density under the model itself."""
GOOD_ACCEPTANCE, POOR_ACCEPTANCE = 0.5, 0.25
"""Second-stage acceptance above which sub-chains double in length, and below which they halve."""
PLAIN_EVERY, PLAIN_EVERY_WITH_A_POOR_ONE = 20, 3
"""Steps between plain moves, for a good and a poor surrogate. Without plain moves, walkers whose density the surrogate
underestimates would never move."""
DECORRELATED = 0.2
"""Correlation between start and end of sub-chains below which longer ones gain little (±0.1 with 128 walkers)."""


@check_arguments
@dataclass(frozen=True, eq=False)
class DelayedAcceptance(Sampler):
    """Settings of delayed acceptance with ensemble moves.

    Every walker x of the moving half of an ensemble makes L moves under the surrogate's posterior π_s. These are stretch and
    differential-evolution moves, which use only the resting half, and independence moves from a proposal learnt in the first
    steps. The end point x′ is one proposal. It costs one run of the model and is accepted with probability
    min{1, π(x′) π_s(x) / [π(x) π_s(x′)]}. Every twentieth step (every third with a poor surrogate) is a plain ensemble move, so
    that the chain is never much worse than a chain without a surrogate.

    Parameters
    ----------
    approximation : Surrogate, Model or Target
        Source of the proposals: a model used instead of the posterior's model, or a density of the same parameters. A study uses
        its fitted surrogate.
    walkers : int
        Walkers in an ensemble, even and at least twice the number of parameters.
    steps : int
        Steps of every walker, each of which is one run of the model.
    ensembles : int
        Ensembles, independent of one another once the proposal of the independence moves is learnt. R-hat compares them.
    discard : float
        Fraction of the steps dropped at the start.
    tuning : int
        Number of first steps that tune L by the acceptance and learn the proposal of the independence moves. They must
        lie within the discarded part. With 1 or 0, this proposal is always fitted to the resting half alone.
    sub_steps : int
        Initial value of L.
    most_sub_steps : int
        Largest value of L.
    stretch : float
        a of the stretch move.
    independent : float
        Fraction of the moves that are independence moves: drawn from a proposal fitted to all walkers of the tuning's later half.
    differential_evolution : float
        Fraction of the other moves that are differential-evolution moves instead of stretch moves.

    Examples
    --------
    >>> import structid as si
    >>> si.DelayedAcceptance(steps=60).exact
    True
    """

    approximation: Model | Target | None = field(default=None, repr=False)
    walkers: int = 32
    steps: int = 30
    ensembles: int = 4
    discard: float = 0.34
    tuning: int = 10
    sub_steps: int = 16
    most_sub_steps: int = 256
    stretch: float = 2.0
    independent: float = 0.5
    differential_evolution: float = 0.5

    # A sub-chain is as long as a walker needs to forget its start under the surrogate's posterior.
    needed_length: ClassVar[float] = 5.0
    exact: ClassVar[bool] = True

    @property
    def proposal_model(self) -> Model | None:
        """The surrogate; None if a bare density makes the proposals."""
        return self.approximation if isinstance(self.approximation, Model) else None

    def proposing_by(self, surrogate: Model) -> DelayedAcceptance:
        """Return these settings with a surrogate for proposals; see `Sampler.proposing_by`."""
        return replace(self, approximation=surrogate)

    def __post_init__(self) -> None:
        for name, least in (
            ("walkers", 4),
            ("steps", 2),
            ("ensembles", 1),
            ("tuning", 0),
            ("sub_steps", 1),
            ("most_sub_steps", 1),
        ):
            value = getattr(self, name)
            if not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(f"DelayedAcceptance.{name}", f"{value!r}", f"a whole number, {least} or more")
        if self.walkers % 2:
            raise InputError(
                "DelayedAcceptance.walkers", f"{self.walkers}", "an even number: two halves move alternately"
            )
        if not self.stretch > 1.0:
            raise InputError("DelayedAcceptance.stretch", f"{self.stretch}", "a number above 1")
        for name in ("independent", "differential_evolution"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"DelayedAcceptance.{name}", f"{getattr(self, name)}", "a fraction from 0 to 1")
        if not 0.0 <= self.discard < 1.0:
            raise InputError("DelayedAcceptance.discard", f"{self.discard}", "a fraction from 0 to below 1")
        if self.tuning > int(self.discard * self.steps):
            raise InputError(
                "DelayedAcceptance.tuning",
                f"{self.tuning}",
                f"at most {int(self.discard * self.steps)}, the number of discarded steps",
                "Reduce it or discard more: a chain during tuning is not a Markov chain and must be discarded.",
            )

    def describe(self) -> dict[str, float | str]:
        """Settings that determine the draws: all except the number of steps and the discarded fraction."""
        settings = {
            f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("approximation", "steps", "discard")
        }
        approximation = "" if self.approximation is None else self.approximation.content_hash
        return {"kind": "delayed_acceptance", "approximation": approximation, **settings}

    @property
    def in_words(self) -> str:
        """The settings in one line, for a report."""
        return (
            f"delayed acceptance, {self.ensembles} ensembles × {self.walkers} walkers × {self.steps} steps, "
            f"{self.discard:.0%} discarded; a model run accepts or rejects every step"
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
        proposing = self._proposing(target)
        if self.walkers < 2 * target.dimension:
            raise InputError(
                "DelayedAcceptance.walkers",
                f"{self.walkers} for {target.dimension} parameters",
                f"{2 * target.dimension} or more (default 32): an ensemble must span the space",
            )
        if not blocks:
            state, runs, failed = self._start(target, proposing, seed, start)
            none, length = np.zeros(state.log_density.shape, dtype=bool), self.sub_steps
            blocks = [_block(state, none, 0, failed, runs, 0, length, length, PLAIN_EVERY)]
            keep(0, blocks[0])
        proposal = self._learnt_proposal(blocks)
        for number in range(len(blocks), self.steps):
            rng, last = stream(seed, Purpose.DELAYED_ACCEPTANCE_STEPS, number), blocks[-1]
            state, length = TwoStageState.of(last), int(last["next_sub_steps"][-1])
            plain_every = int(last["plain_every"][-1])
            if number >= self.tuning and number % plain_every == plain_every - 1:
                block = self._plain_step(target, proposing, state, length, plain_every, rng)
            else:
                moves = self._moves(proposal)
                block = self._step(target, proposing, state, moves, length, plain_every, number < self.tuning, rng)
            keep(number, block)
            blocks = [*blocks, block]
            if number < self.tuning:
                proposal = self._learnt_proposal(blocks)
            if progress is not None:
                progress(number + 1, self.steps)
        every = joined(blocks, self.steps)
        kept = (np.arange(self.steps) >= int(self.discard * self.steps)) & (every["surrogate_runs"] > 0)
        proposals = every["proposals"][kept].sum()
        cost = Cost(
            true_runs=int(every["true_runs"].sum()),
            surrogate_runs=int(every["surrogate_runs"].sum()),
            acceptance=float(every["accepted"][kept].sum() / proposals) if proposals else float("nan"),
            sub_steps=int(every["sub_steps"][-1]),
        )
        return Drawn(every["phi"], every["log_density"], every["accepted"], int(every["failed"].sum()), None, cost)

    def _moves(self, proposal: IndependenceProposal | None = None) -> Moves:
        """Mixture of moves, with the given proposal for independence moves."""
        return Moves(self.stretch, self.differential_evolution, self.independent, proposal)

    def _learnt_proposal(self, blocks: list[Block]) -> IndependenceProposal | None:
        """Proposal fitted to all walkers in the later half of the tuning steps; it then stays fixed.

        None before the first step, since walkers may start anywhere.
        """
        last = min(len(blocks), self.tuning)
        learnt = [TwoStageState.of(block) for block in blocks[max(1, last // 2) : last]]
        if not learnt:
            return None
        phi, log_surrogate = (np.stack([getattr(s, name) for s in learnt]) for name in ("phi", "log_surrogate"))
        together = EnsembleState(phi.reshape(1, -1, phi.shape[-1]), log_surrogate.reshape(1, -1))
        return IndependenceProposal.fitted(together).shared_by(self.ensembles)

    def _proposing(self, target: Target) -> Target:
        """The density that makes the proposals."""
        approximation = self.approximation
        if isinstance(approximation, Model) and isinstance(target, Posterior):
            approximation = target.on(approximation, refuse_unfit=False)  # the draws are exact for any surrogate error
        if not isinstance(approximation, Target) or approximation.names != target.names:
            raise InputError(
                "DelayedAcceptance.approximation",
                "no approximation" if approximation is None else f"a {type(approximation).__name__}",
                f"a surrogate of the posterior's model, or a density of {', '.join(target.names)}",
            )
        same = approximation.bijection == target.bijection
        return approximation if same else TransformedTarget(approximation, target.bijection)

    def _start(
        self, target: Target, proposing: Target, seed: int, points: np.ndarray | None
    ) -> tuple[TwoStageState, int, int]:
        """Starting points at which both densities are finite, with the number of model runs and of failures."""
        rng = stream(seed, Purpose.DELAYED_ACCEPTANCE_START, 0)
        if points is None:
            candidates = tempered_draws(proposing, seed)
        else:
            candidates = target.bijection.inverse(np.asarray(points, dtype=np.float64))
        required = self.ensembles * self.walkers
        phi, log_density = np.empty((0, target.dimension)), np.empty(0)
        runs = failed_runs = 0
        for _ in range(START_TRIES):
            fresh = candidates[rng.integers(len(candidates), size=required - len(phi))]
            value, failed = target.evaluate(fresh)
            runs, failed_runs = runs + len(fresh), failed_runs + int(failed.sum())
            # Where the surrogate's density is zero, no proposal could ever be accepted.
            good = np.isfinite(value) & np.isfinite(proposing.evaluate(fresh)[0])
            phi, log_density = np.concatenate([phi, fresh[good]]), np.concatenate([log_density, value[good]])
            if len(phi) >= required:
                break
        else:
            raise ConvergenceError(
                f"Only {len(phi)} of {runs} points of the surrogate's posterior have a finite density under the model "
                f"itself ({failed_runs} simulations failed). Do more model runs there, for example by structid.calibrate."
            )
        phi, log_density = phi[:required], log_density[:required]
        shape = (self.ensembles, self.walkers)
        log_surrogate = proposing.evaluate(phi)[0].reshape(shape)
        return TwoStageState(phi.reshape(*shape, -1), log_density.reshape(shape), log_surrogate), runs, failed_runs

    def _step(
        self,
        target: Target,
        proposing: Target,
        state: TwoStageState,
        moves: Moves,
        length: int,
        plain_every: int,
        tuning: bool,
        rng: np.random.Generator,
    ) -> Block:
        """Move one half of every ensemble, then the other: a sub-chain and a model run for each walker."""
        before, state = state.phi, state.copied()
        phi, log_density, log_surrogate = state
        ends = phi.copy()
        accepted = np.zeros(log_density.shape, dtype=bool)
        failed_runs = true_runs = surrogate_runs = proposals = 0
        for moving, resting in halves(self.walkers):
            # End points, and log π_s there, of L moves of one half under the surrogate's posterior; the other half is frozen.
            half, others = state.under_surrogate.part(moving).copied(), state.under_surrogate.part(resting)
            for kind in moves.there_and_back(rng, length):
                move_walkers(rng, proposing, half, others, moves, kind)
            proposal, value = half
            surrogate_runs += length * value.size
            ends[:, moving] = proposal
            # From a point where the surrogate's density is zero, nothing can be accepted.
            has_moved = (proposal != phi[:, moving]).any(axis=2) & np.isfinite(log_surrogate[:, moving])
            proposals += int(has_moved.sum())
            new_true, count, failed = _true_density(target, proposal, has_moved)
            true_runs, failed_runs = true_runs + count, failed_runs + failed
            # min{1, π(x′) π_s(x) / [π(x) π_s(x′)]}
            log_now, log_then = log_density[:, moving] + value, new_true + log_surrogate[:, moving]
            better = has_moved & (np.log(rng.random(value.shape)) + log_now < log_then)
            phi[:, moving][better], log_density[:, moving][better] = proposal[better], new_true[better]
            log_surrogate[:, moving][better] = value[better]
            accepted[:, moving] = better
        following = length
        if tuning:
            # Sub-chains of few moves may stay in place: the model has not rejected them, and they should be longer, not shorter.
            acceptance = float(accepted.sum()) / proposals if proposals else 1.0
            following = self._tuned(length, acceptance, before, ends)
            plain_every = PLAIN_EVERY if acceptance > GOOD_ACCEPTANCE else PLAIN_EVERY_WITH_A_POOR_ONE
        return _block(
            state, accepted, proposals, failed_runs, true_runs, surrogate_runs, length, following, plain_every
        )

    def _plain_step(
        self,
        target: Target,
        proposing: Target,
        state: TwoStageState,
        length: int,
        plain_every: int,
        rng: np.random.Generator,
    ) -> Block:
        """Make a single ensemble move without the surrogate."""
        # Unlike a proposal learnt under a poor surrogate, a proposal fitted to the resting half approximates the posterior.
        state, moves = state.copied(), self._moves()
        accepted, failed_runs = np.zeros(state.log_density.shape, dtype=bool), 0
        for moving, resting in halves(self.walkers):
            model = state.under_model
            accepted[:, moving], failed = move_walkers(rng, target, model.part(moving), model.part(resting), moves)
            failed_runs += failed
        log_surrogate = proposing.evaluate(state.phi.reshape(-1, state.phi.shape[2]))[0]
        state = state._replace(log_surrogate=log_surrogate.reshape(state.log_surrogate.shape))
        return _block(state, accepted, accepted.size, failed_runs, accepted.size, 0, length, length, plain_every)

    def _tuned(self, length: int, acceptance: float, before: np.ndarray, ends: np.ndarray) -> int:
        """Length L of the next sub-chain: longer while most proposals are accepted and still correlate with their start."""
        if acceptance < POOR_ACCEPTANCE:
            return max(1, length // 2)
        if acceptance > GOOD_ACCEPTANCE and correlation(before, ends) > DECORRELATED:
            return min(2 * length, self.most_sub_steps)
        return length


class TwoStageState(NamedTuple):
    """Positions of all walkers, and both log densities there."""

    phi: Float[np.ndarray, "ensemble walker parameter"]  # unconstrained coordinates
    log_density: Float[np.ndarray, "ensemble walker"]  # under the model itself, with respect to φ
    log_surrogate: Float[np.ndarray, "ensemble walker"]  # under the surrogate, with respect to φ

    @classmethod
    def of(cls, block: Block) -> TwoStageState:
        """State at the end of a block."""
        return cls(block["phi"][-1], block["log_density"][-1], block["log_surrogate"][-1])

    @property
    def under_model(self) -> EnsembleState:
        """Walkers and their density under the model itself, as views."""
        return EnsembleState(self.phi, self.log_density)

    @property
    def under_surrogate(self) -> EnsembleState:
        """Walkers and their density under the surrogate, as views."""
        return EnsembleState(self.phi, self.log_surrogate)

    def copied(self) -> TwoStageState:
        """A deep copy."""
        return TwoStageState(self.phi.copy(), self.log_density.copy(), self.log_surrogate.copy())


def _block(
    state: TwoStageState,
    accepted: np.ndarray,
    proposals: int,
    failed: int,
    true_runs: int,
    surrogate_runs: int,
    sub_steps: int,
    next_sub_steps: int,
    plain_every: int,
) -> Block:
    return {
        "phi": state.phi[None],
        "log_density": state.log_density[None],
        "log_surrogate": state.log_surrogate[None],
        "accepted": accepted[None],
        "proposals": np.array([proposals]),
        "failed": np.array([failed]),
        "true_runs": np.array([true_runs]),
        "surrogate_runs": np.array([surrogate_runs]),
        "sub_steps": np.array([sub_steps]),
        "next_sub_steps": np.array([next_sub_steps]),
        "plain_every": np.array([plain_every]),
    }


def _true_density(target: Target, proposal: np.ndarray, has_moved: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Log density under the model itself where a sub-chain has moved, with the number of runs and of failures."""
    density = np.full(has_moved.shape, -np.inf)
    # An external solver skips sub-chains that stayed in place. A built-in model keeps the batches for which it is compiled.
    rows = has_moved if target.costs_runs else np.ones_like(has_moved)
    if not rows.any():
        return density, 0, 0
    density[rows], failed = target.evaluate(proposal[rows])
    return density, int(rows.sum()), int(failed.sum())
