"""Tempered sequential Monte Carlo: from the prior to the posterior by degrees, and the evidence on the way.

P. Del Moral, A. Doucet & A. Jasra (2006), doi 10.1111/j.1467-9868.2006.00553.x; adaptive exponents after J. Ching & Y.-C. Chen
(2007), doi 10.1061/(ASCE)0733-9399(2007)133:7(816). Particles move as the walkers of an ensemble do, or to a draw of
a law fitted to those at rest, so that a target needs no gradient: an external solver can be sampled, its failures are counted, and
every stage is on disk before the next.
"""

from __future__ import annotations

import itertools
from dataclasses import asdict, dataclass, replace
from typing import ClassVar

import numpy as np
import scipy.integrate
import scipy.optimize
from scipy.special import expit, logsumexp

from structid.errors import ConvergenceError, InputError
from structid.inference.sampling.moves import EnsembleState, Moves, halves
from structid.inference.sampling.sampler import (
    BLOCK_STEPS,
    Block,
    Drawn,
    Evidence,
    Keep,
    Sampler,
    block_lengths,
    correlation,
    joined,
    without_cut_off,
)
from structid.inference.target import Target
from structid.models.face import Progress
from structid.streams import Purpose, stream

MOST_STAGES = 200
"""Stages after which the tempering is given up."""


@dataclass(frozen=True)
class SMC(Sampler):
    """Settings of tempered sequential Monte Carlo.

    Particles begin as draws of the prior π₀ and pass through π₀ L^β with β rising from 0 to 1. Each stage weighs them by L^Δβ,
    draws them anew by these weights, and moves them. The evidence ∫ π₀ L is the product of the ratios of neighbouring stages'
    normalising constants, each by Bennett's acceptance ratio from the particles of both.

    Parameters
    ----------
    particles : int
        Particles of a population, even and at least twice the number of parameters.
    ensembles : int
        Independent populations; R-hat compares them, and the evidence's error comes from them.
    steps : int
        Moves of every particle once β = 1 is reached; these are kept.
    effective_share : float
        Share of the particles that the weights of a stage leave effective: it sets Δβ.
    correlation : float
        Particles move in a stage until no parameter, nor the log-likelihood, correlates by more than this with where it began, and
        until the mean log-likelihood has stopped rising.
    least_moves, most_moves : int
        Moves in a stage at least and at most. Where the most were too few, the evidence's error says so.
    stretch : float
        a of the stretch move.
    independent : float
        Fraction of the moves that are independence moves: drawn from laws fitted to the particles at rest. They forget where a
        particle was, where laws of that kind are anything like the posterior; in dozens of parameters it is not, and 0 saves them.
    differential_evolution : float
        Fraction of the other moves that are differential-evolution moves in the place of the stretch.
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

    discard = 0.0  # no field: there is no start to forget
    # Particles begin where the posterior is; in one τ those that were copied from one another have parted.
    needed_length: ClassVar[float] = 1.0

    def __post_init__(self) -> None:
        for name, least in (("particles", 4), ("ensembles", 1), ("steps", 1), ("least_moves", 1), ("most_moves", 1)):
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
        """Settings that decide the draws: all but the number of kept steps.

        Returns
        -------
        dict
            For hashes; more steps continue the same particles.
        """
        return {"kind": "smc", **{k: v for k, v in asdict(self).items() if k != "steps"}}

    @property
    def in_words(self) -> str:
        """The settings in a line, for a report."""
        return (
            f"tempered SMC, {self.ensembles} populations × {self.particles} particles, {self.steps} moves of the posterior, "
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
        """Draw; see `Sampler.run`.

        Parameters
        ----------
        target : Target
            What to sample; it must know its prior.
        seed : int
            Seed.
        start : ndarray or None
            Not taken: particles start from the prior, or the evidence would be wrong.
        blocks : list of dict
            What is already on disk.
        keep : callable
            Puts a block on disk.
        progress : callable, optional
            Told how far it is, in hundredths.

        Returns
        -------
        Drawn
            The draws at β = 1.
        """
        self._refuse(target, start)
        blocks = _without_cut_off(blocks, self.steps)
        self._to_the_posterior(target, seed, blocks, keep, progress)
        self._in_the_posterior(target, seed, blocks, keep, progress)
        return _drawn(blocks, self.steps)

    def _refuse(self, target: Target, start: np.ndarray | None) -> None:
        """Refuse what these particles cannot do."""
        if start is not None:
            raise InputError(
                "sample(start)", "points to start from, for SMC", "none: its particles start from the prior"
            )
        if self.particles < 2 * target.dimension:
            raise InputError(
                "SMC.particles",
                f"{self.particles} for {target.dimension} parameters",
                f"{2 * target.dimension} or more: a population must span the space",
            )

    def _to_the_posterior(
        self, target: Target, seed: int, blocks: list[Block], keep: Keep, progress: Progress | None
    ) -> None:
        """Append a block for each stage until β = 1."""
        if not blocks:
            blocks.append(_block([starting_population(self, target, seed)], [], []))
            keep(0, blocks[0])
        population = Population.of(blocks[-1])
        while population.exponent < 1.0:
            number = len(blocks)
            if number == MOST_STAGES:
                raise ConvergenceError(
                    f"The tempering has reached the exponent {population.exponent:.2g} after {MOST_STAGES} stages. Check the "
                    "likelihood: it is finite almost nowhere, or far too narrow for these particles."
                )
            population, block = run_stage(self, target, population, stream(seed, Purpose.SMC_STAGE, number))
            keep(number, block)
            blocks.append(block)
            if progress is not None:
                progress(int(50 * min(1.0, max(0.0, 1 + np.log10(population.exponent) / 6))), 100)

    def _in_the_posterior(
        self, target: Target, seed: int, blocks: list[Block], keep: Keep, progress: Progress | None
    ) -> None:
        """Append the blocks of the moves at β = 1."""
        population = Population.of(blocks[-1])
        first = sum(b["exponent"][-1] < 1.0 for b in blocks) + 1  # blocks before those of moves alone
        for index, length in enumerate(block_lengths(self.steps)):
            if first + index < len(blocks):
                continue
            population, block = run_moves(self, target, population, stream(seed, Purpose.SMC_MOVES, index), length)
            keep(first + index, block)
            blocks.append(block)
            if progress is not None:
                progress(50 + 50 * min((index + 1) * BLOCK_STEPS, self.steps) // self.steps, 100)


@dataclass(frozen=True, eq=False)
class Population:
    """Particles at one exponent.

    Parameters
    ----------
    phi : ndarray, shape (ensemble, particle, parameter)
        Unconstrained coordinates.
    prior, likelihood : ndarray, shape (ensemble, particle)
        Log densities there, the prior's with respect to φ.
    exponent : float
        β.
    """

    phi: np.ndarray
    prior: np.ndarray
    likelihood: np.ndarray
    exponent: float

    @property
    def log_density(self) -> np.ndarray:
        """Log π₀ L^β, shape (ensemble, particle)."""
        return tempered(self.prior, self.likelihood, self.exponent)

    @classmethod
    def of(cls, block: Block) -> Population:
        """Particles at the end of a block.

        Parameters
        ----------
        block : dict
            As `run_stage` and `run_moves` make it.

        Returns
        -------
        Population
            Where to go on.
        """
        last = {name: array[-1] for name, array in block.items()}
        return cls(last["phi"], last["prior"], last["likelihood"], float(last["exponent"]))


def tempered(prior: np.ndarray, likelihood: np.ndarray, exponent: float) -> np.ndarray:
    """Log π₀ L^β; at β = 0 a likelihood of −inf does not count.

    Parameters
    ----------
    prior, likelihood : ndarray
        Log densities.
    exponent : float
        β.

    Returns
    -------
    ndarray
        Log density.
    """
    return prior + exponent * likelihood if exponent > 0.0 else prior


def starting_population(settings: SMC, target: Target, seed: int) -> Population:
    """Draw particles from the prior.

    Parameters
    ----------
    settings : SMC
        How many.
    target : Target
        With the prior.
    seed : int
        Seed.

    Returns
    -------
    Population
        At β = 0.
    """
    shape = (settings.ensembles, settings.particles)
    phi = target.initial(settings.ensembles * settings.particles, stream(seed, Purpose.SMC_START, 0))
    prior, likelihood, _ = target.evaluate_parts(phi)
    if np.isfinite(likelihood).sum() < 2 * target.dimension:
        raise ConvergenceError(
            f"Only {np.isfinite(likelihood).sum()} of {len(phi)} draws of the prior have a likelihood. Check the priors: most of "
            "what they allow cannot be simulated."
        )
    return Population(phi.reshape(*shape, -1), prior.reshape(shape), likelihood.reshape(shape), 0.0)


def run_stage(
    settings: SMC, target: Target, population: Population, rng: np.random.Generator
) -> tuple[Population, Block]:
    """Raise the exponent: weigh, draw anew, move.

    Parameters
    ----------
    settings : SMC
        How far, and how.
    target : Target
        What is sampled.
    population : Population
        Before.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    tuple of Population and dict
        After, and its block of one step.
    """
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
    moved, accepted, failed = drawn, np.zeros(rows.shape, dtype=bool), 0
    passed = [drawn.likelihood]
    for count in range(1, settings.most_moves + 1):
        moved, accepted, more = move(settings, target, moved, rng)
        failed += more
        passed.append(moved.likelihood)
        left = correlation(*(np.dstack([p.phi, p.likelihood]) for p in (drawn, moved)))
        if count >= settings.least_moves and left < settings.correlation and _at_rest(passed):
            break
    rise = (moved.likelihood - drawn.likelihood).mean(axis=1)
    return moved, _block([moved], [accepted], [failed], rise, left)


def _at_rest(passed: list[np.ndarray]) -> bool:
    """Whether the mean log-likelihood, after every move so far, has gone nowhere in the later half of them, within two errors."""
    change = passed[-1] - passed[len(passed) // 2]
    return bool(abs(change.mean()) <= 2.0 * change.std() / np.sqrt(change.size))


def run_moves(
    settings: SMC, target: Target, population: Population, rng: np.random.Generator, steps: int
) -> tuple[Population, Block]:
    """Move particles at a constant exponent.

    Parameters
    ----------
    settings : SMC
        How.
    target : Target
        What is sampled.
    population : Population
        Before.
    rng : numpy.random.Generator
        Source of randomness.
    steps : int
        How often.

    Returns
    -------
    tuple of Population and dict
        After, and the block of all steps.
    """
    history, accepted, failed = [], [], []
    for _ in range(steps):
        population, moved, lost = move(settings, target, population, rng)
        history.append(population)
        accepted.append(moved)
        failed.append(lost)
    return population, _block(history, accepted, failed)


def move(
    settings: SMC, target: Target, population: Population, rng: np.random.Generator
) -> tuple[Population, np.ndarray, int]:
    """Move every particle once: one half of each population, then the other.

    Parameters
    ----------
    settings : SMC
        Which moves.
    target : Target
        What is sampled.
    population : Population
        Before.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    tuple of Population, ndarray of bool (ensemble, particle), int
        After, which moved, and how many simulations failed.
    """
    phi, prior, likelihood = (a.copy() for a in (population.phi, population.prior, population.likelihood))
    moves = Moves(settings.stretch, settings.differential_evolution, settings.independent)
    failed_simulations = 0
    accepted = np.zeros(prior.shape, dtype=bool)
    for moving, resting in halves(settings.particles):
        now = tempered(prior, likelihood, population.exponent)
        proposal, log_factor = moves.propose(
            rng, moves.kind(rng), phi[:, moving], EnsembleState(phi, now).part(resting)
        )
        parts = target.evaluate_parts(proposal.reshape(-1, phi.shape[2]))
        new_prior, new_likelihood = (p.reshape(log_factor.shape) for p in parts[:2])
        failed_simulations += int(parts[2].sum())
        then = tempered(new_prior, new_likelihood, population.exponent)
        better = np.log(rng.random(log_factor.shape)) < log_factor + then - now[:, moving]
        phi[:, moving][better] = proposal[better]
        prior[:, moving][better] = new_prior[better]
        likelihood[:, moving][better] = new_likelihood[better]
        accepted[:, moving] = better
    return replace(population, phi=phi, prior=prior, likelihood=likelihood), accepted, failed_simulations


def next_exponent(likelihood: np.ndarray, exponent: float, share: float) -> float:
    """Largest exponent whose weights leave a share of the particles effective, ESS = (Σw)²/Σw².

    Parameters
    ----------
    likelihood : ndarray, shape (ensemble, particle)
        Log-likelihoods.
    exponent : float
        The present one.
    share : float
        Of the particles.

    Returns
    -------
    float
        At most 1.
    """
    # Particles without any likelihood are left behind by the smallest step, and are not for the exponent to save.
    usable = int(np.isfinite(likelihood).sum())

    def lacking(log_increment: float) -> float:
        weights = np.exp(log_increment) * likelihood
        # The mean of the populations' sizes: none of them decides alone.
        size = 2.0 * logsumexp(weights, axis=1) - logsumexp(2.0 * weights, axis=1)
        return float(logsumexp(size) - np.log(usable) - np.log(share))

    largest = np.log(1.0 - exponent)
    if lacking(largest) >= 0.0:
        return 1.0
    smallest = largest
    while lacking(smallest) < 0.0:
        smallest -= 5.0
    return float(exponent + np.exp(scipy.optimize.brentq(lacking, smallest, largest, xtol=1e-6)))


def _systematic(weights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rows drawn with probabilities, each as often as its expectation but for rounding."""
    places = (rng.random() + np.arange(len(weights))) / len(weights)
    return np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)


def _block(
    populations: list[Population],
    accepted: list[np.ndarray],
    failed: list[int],
    rise: np.ndarray | None = None,
    left: float = 0.0,
) -> Block:
    """A block of the steps; of a stage, how far its mean log-likelihoods rose, and the correlation left with where it began."""
    several = ("phi", "prior", "likelihood", "log_density", "exponent")
    block = {name: np.stack([np.asarray(getattr(p, name)) for p in populations]) for name in several}
    moved = np.stack(accepted) if accepted else np.zeros(block["prior"].shape, dtype=bool)
    return block | {
        "accepted": moved,
        "failed": np.array(failed) if failed else np.zeros(len(populations), dtype=int),
        "rise": np.zeros(block["prior"].shape[:2]) if rise is None else rise[None],
        "left": np.full(len(populations), left),
    }


def evidence_of(stages: list[Population], rise: np.ndarray, left: np.ndarray) -> Evidence:
    """Evidence from the particles of all stages.

    Weighing and drawing anew should leave particles of the next exponent's law, which moves do not change on average. Where a
    narrow peak takes over, too few of them are on it: they lag behind, and their mean log-likelihood rises while they move. Of
    such a deficit D the share ρ is left when they correlate by ρ with where they began: after a rise of (1 − ρ) D, ρ D.

    Parameters
    ----------
    stages : list of Population
        From β = 0 to β = 1.
    rise : ndarray, shape (stage, ensemble)
        Of the mean log-likelihoods while the particles moved.
    left : ndarray, shape (stage,)
        ρ, the correlation at the end of each stage with where it began.

    Returns
    -------
    Evidence
        Σ log Z_{k+1}/Z_k of each population, and their mean.
    """
    left = np.clip(left, 0.0, 1.0 - np.finfo(np.float64).eps)
    each = np.zeros(len(stages[0].prior))
    variance = np.zeros_like(each)
    for stage, (now, then) in enumerate(itertools.pairwise(stages)):
        for row in range(len(each)):
            increment = then.exponent - now.exponent
            ratio, own = bennett_ratio(increment * now.likelihood[row], increment * then.likelihood[row])
            each[row] += ratio
            # Stages that correlate by ρ, each with the next, add up to a variance (1 + ρ) / (1 − ρ) times that of independent ones.
            variance[row] += own * (1.0 + left[stage + 1]) / (1.0 - left[stage + 1])
    # log Z = ∫ ⟨log L⟩ dβ (thermodynamic integration): what mean log-likelihoods lack, log Z lacks.
    lacking = scipy.integrate.trapezoid(
        rise * (left / (1.0 - left))[:, None], [stage.exponent for stage in stages], axis=0
    )
    return Evidence.of_populations(each, variance, lacking)


def bennett_ratio(forward: np.ndarray, backward: np.ndarray) -> tuple[float, float]:
    """Log Z₁/Z₀ of two densities from draws of both (C. H. Bennett 1976, doi 10.1016/0021-9991(76)90078-4).

    With f(x) = 1/(1 + eˣ) and as many draws of each, log Z₁/Z₀ is the C of Σ₀ f(C − w) = Σ₁ f(w − C).

    Parameters
    ----------
    forward, backward : ndarray, shape (draw,)
        w, the log of the unnormalised second density over the first, at draws of the first and of the second.

    Returns
    -------
    tuple of float
        log Z₁/Z₀, and its variance if the draws were independent.
    """

    def difference(constant: float) -> float:
        return float(expit(forward - constant).sum() - expit(constant - backward).sum())

    known = np.concatenate([forward[np.isfinite(forward)], backward])
    found = scipy.optimize.brentq(difference, known.min() - 50.0, known.max() + 50.0, xtol=1e-10)
    shares = (expit(forward - found), expit(found - backward))
    variance = sum(float(np.mean(f**2) / np.mean(f) ** 2 - 1.0) / len(f) for f in shares)
    return float(found), variance


def _without_cut_off(blocks: list[Block], steps: int) -> list[Block]:
    """The stages, and those of the moves after them that a run of so many steps has whole."""
    stages = next((i + 1 for i, b in enumerate(blocks) if b["exponent"][-1] == 1.0), len(blocks))
    return blocks[:stages] + without_cut_off(blocks[stages:], list(block_lengths(steps)))


def _drawn(blocks: list[Block], steps: int) -> Drawn:
    stages = [b for b in blocks if b["exponent"][0] < 1.0]
    stages = blocks[: len(stages) + 1]  # and the one that reached β = 1
    kept = joined(blocks[len(stages) :], steps)
    return Drawn(
        kept["phi"],
        kept["log_density"],
        kept["accepted"],
        int(sum(b["failed"].sum() for b in blocks)),
        evidence_of(
            [Population.of(b) for b in stages], *(np.concatenate([b[n] for b in stages]) for n in ("rise", "left"))
        ),
    )
