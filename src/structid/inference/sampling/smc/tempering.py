"""One tempering step of SMC: choose the exponent, weight, resample and move the particles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from structid.core.errors import ConvergenceError
from structid.core.streams import Purpose, stream
from structid.inference.sampling.base import Block, correlation
from structid.inference.sampling.moves import EnsembleState, IndependenceProposal, Moves, halves
from structid.inference.sampling.smc.falling_root import root_of_falling
from structid.inference.sampling.smc.proposal_weights import NOTHING, sums_of_weights, together
from structid.inference.target import Target


class PopulationSettings(Protocol):
    """Settings for drawing and moving a population of particles; see `SMC`."""

    @property
    def ensembles(self) -> int:
        """Independent populations."""

    @property
    def particles(self) -> int:
        """Particles of each population."""

    @property
    def effective_share(self) -> float:
        """Fraction of the particles that stays effective under the weights of a step."""

    @property
    def correlation(self) -> float:
        """Correlation of the particles with their start below which the moves of a step may end."""

    @property
    def least_moves(self) -> int:
        """Minimum number of moves in a step."""

    @property
    def most_moves(self) -> int:
        """Maximum number of moves in a step."""

    @property
    def stretch(self) -> float:
        """Parameter a of the stretch move."""

    @property
    def independent(self) -> float:
        """Fraction of the moves that are independence moves."""

    @property
    def differential_evolution(self) -> float:
        """Fraction of the other moves that are differential-evolution moves."""


LEAST_LIKELIHOOD = -1e60
"""Smallest log-likelihood of a particle with non-zero likelihood."""


@dataclass(frozen=True, eq=False)
class Population:
    """Particles at one exponent."""

    phi: Float[np.ndarray, "ensemble particle parameter"]  # unconstrained coordinates
    prior: Float[np.ndarray, "ensemble particle"]  # log prior density there, with respect to φ
    likelihood: Float[np.ndarray, "ensemble particle"]  # log-likelihood there
    exponent: float  # β

    @property
    def log_density(self) -> np.ndarray:
        """Log π₀ L^β, shape (ensemble, particle)."""
        return tempered(self.prior, self.likelihood, self.exponent)

    @classmethod
    def of(cls, block: Block) -> Population:
        """Particles at the end of a block."""
        last = {name: array[-1] for name, array in block.items()}
        return cls(last["phi"], last["prior"], last["likelihood"], float(last["exponent"]))


def tempered(prior: np.ndarray, likelihood: np.ndarray, exponent: float) -> np.ndarray:
    """Log π₀ L^β; at β = 0 a log-likelihood of −inf is ignored."""
    return prior + exponent * likelihood if exponent > 0.0 else prior


def starting_population(settings: PopulationSettings, target: Target, seed: int, index: int = 0) -> Population:
    """Draw particles from the prior, or from the reference density in its place."""
    shape = (settings.ensembles, settings.particles)
    phi = target.initial(settings.ensembles * settings.particles, stream(seed, Purpose.SMC_START, index))
    prior, likelihood, _ = _evaluated(target, phi)
    if np.isfinite(likelihood).sum() < 2 * target.dimension:
        raise ConvergenceError(
            f"Only {np.isfinite(likelihood).sum()} of {len(phi)} draws of the prior have a finite "
            "log-likelihood. Check the priors: most of their range cannot be simulated."
        )
    return Population(phi.reshape(*shape, -1), prior.reshape(shape), likelihood.reshape(shape), 0.0)


def _evaluated(target: Target, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log prior, log-likelihood and failure; a finite log-likelihood below `LEAST_LIKELIHOOD` is raised to it."""
    prior, likelihood, failed = target.evaluate_parts(phi)
    return prior, np.where(likelihood > -np.inf, np.maximum(likelihood, LEAST_LIKELIHOOD), -np.inf), failed


def run_stage(
    settings: PopulationSettings, target: Target, population: Population, rng: np.random.Generator
) -> tuple[Population, Block]:
    """Make one tempering step: weight, resample, move."""
    exponent = next_exponent(population.likelihood, population.exponent, settings.effective_share)
    log_weights = (exponent - population.exponent) * population.likelihood
    weights = np.exp(log_weights - logsumexp(log_weights, axis=1, keepdims=True))
    rows = np.stack([_systematic(w, rng) for w in weights])
    drawn = replace(
        population,
        phi=np.take_along_axis(population.phi, rows[:, :, None], axis=1),
        prior=np.take_along_axis(population.prior, rows, axis=1),
        likelihood=np.take_along_axis(population.likelihood, rows, axis=1),
        exponent=exponent,
    )
    moved_population, accepted, failed = drawn, np.zeros(rows.shape, dtype=bool), 0
    passed = [drawn.likelihood]
    for count in range(1, settings.most_moves + 1):
        moved_population, accepted, more, _ = move(settings, target, moved_population, rng)
        failed += more
        passed.append(moved_population.likelihood)
        left = correlation(*(np.dstack([p.phi, p.likelihood]) for p in (drawn, moved_population)))
        if count >= settings.least_moves and left < settings.correlation and _at_rest(passed):
            break
    rise = (moved_population.likelihood - drawn.likelihood).mean(axis=1)
    return moved_population, block_of([moved_population], [accepted], [failed], None, rise, left)


def _at_rest(passed: list[np.ndarray]) -> bool:
    """Whether the mean log-likelihood is constant, within two standard errors, over the later half of the moves."""
    change = passed[-1] - passed[len(passed) // 2]
    return bool(abs(change.mean()) <= 2.0 * change.std() / np.sqrt(change.size))


def run_moves(
    settings: PopulationSettings, target: Target, population: Population, rng: np.random.Generator, steps: int
) -> tuple[Population, Block]:
    """Move particles at a constant exponent."""
    history, accepted, failed, proposed = [], [], [], []
    for _ in range(steps):
        population, has_moved, lost, sums = move(settings, target, population, rng)
        history.append(population)
        accepted.append(has_moved)
        failed.append(lost)
        proposed.append(sums)
    return population, block_of(history, accepted, failed, proposed)


def move(
    settings: PopulationSettings, target: Target, population: Population, rng: np.random.Generator
) -> tuple[Population, np.ndarray, int, Float[np.ndarray, "ensemble column"]]:
    """Move every particle once: one half of each population, then the other; also return sums of the proposals' weights."""
    phi, prior, likelihood = (a.copy() for a in (population.phi, population.prior, population.likelihood))
    moves = Moves(settings.stretch, settings.differential_evolution, settings.independent)
    failed_simulations = 0
    accepted, proposed = np.zeros(prior.shape, dtype=bool), [np.tile(NOTHING, (len(prior), 1))]
    for moving, resting in halves(settings.particles):
        now = tempered(prior, likelihood, population.exponent)
        kind, others = moves.kind(rng), EnsembleState(phi, now).part(resting)
        fitted = IndependenceProposal.fitted(others) if kind == "independent" else None
        proposal, log_factor = replace(moves, proposal=fitted).propose(rng, kind, phi[:, moving], others)
        parts = _evaluated(target, proposal.reshape(-1, phi.shape[2]))
        new_prior, new_likelihood = (p.reshape(log_factor.shape) for p in parts[:2])
        failed_simulations += int(parts[2].sum())
        then = tempered(new_prior, new_likelihood, population.exponent)
        if fitted is not None and population.exponent == 1.0:
            proposed.append(sums_of_weights(then - fitted.log_density(proposal), then, now))
        better = np.log(rng.random(log_factor.shape)) < log_factor + then - now[:, moving]
        phi[:, moving][better] = proposal[better]
        prior[:, moving][better] = new_prior[better]
        likelihood[:, moving][better] = new_likelihood[better]
        accepted[:, moving] = better
    moved_population = replace(population, phi=phi, prior=prior, likelihood=likelihood)
    return moved_population, accepted, failed_simulations, together(np.stack(proposed))


def next_exponent(likelihood: Float[np.ndarray, "ensemble particle"], exponent: float, share: float) -> float:
    """Largest exponent whose weights leave the given fraction of the particles effective, ESS = (Σw)²/Σw²."""
    # Particles of zero likelihood are lost at the smallest step; no choice of exponent can save them.
    with np.errstate(over="ignore", invalid="ignore"):
        below_best = likelihood - likelihood.max(axis=1, keepdims=True)
    usable = int(np.isfinite(below_best).sum())
    below_best = np.where(np.isfinite(below_best), below_best, -np.inf)

    def lacking(log_increment: float) -> float:
        with np.errstate(invalid="ignore"):
            weights = np.where(below_best > -np.inf, np.exp(np.exp(log_increment) * below_best), 0.0)
        # The mean over the populations, so that no single population decides; one without usable particles counts for nothing.
        size = weights.sum(axis=1) ** 2 / np.maximum((weights**2).sum(axis=1), np.finfo(np.float64).tiny)
        return float(size.sum() - usable * share)

    largest = np.log(1.0 - exponent)
    if lacking(largest) >= 0.0:
        return 1.0
    return float(exponent + np.exp(root_of_falling(lacking, largest, 1e-6)))


def _systematic(weights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw rows by systematic resampling: each as often as its weight requires, up to rounding."""
    places = (rng.random() + np.arange(len(weights))) / len(weights)
    return np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)


def block_of(
    populations: list[Population],
    accepted: list[np.ndarray],
    failed: list[int],
    proposed: list[np.ndarray] | None = None,
    rise: Float[np.ndarray, " ensemble"] | None = None,
    left: float = 0.0,
) -> Block:
    """Make a block of some steps."""
    several = ("phi", "prior", "likelihood", "log_density", "exponent")
    block = {name: np.stack([np.asarray(getattr(p, name)) for p in populations]) for name in several}
    has_moved = np.stack(accepted) if accepted else np.zeros(block["prior"].shape, dtype=bool)
    return block | {
        "accepted": has_moved,
        "failed": np.array(failed) if failed else np.zeros(len(populations), dtype=int),
        "rise": np.zeros(block["prior"].shape[:2]) if rise is None else rise[None],
        "left": np.full(len(populations), left),
        "risen": np.zeros(len(populations), dtype=bool),
        "proposed": np.stack(proposed) if proposed else np.tile(NOTHING, (*block["prior"].shape[:2], 1)),
    }
