"""AIES: the affine-invariant ensemble sampler, several independent ensembles in one batch.

J. Goodman & J. Weare (2010), "Ensemble samplers with affine invariance", Comm. App. Math. Comp. Sci. 5, 65-80,
doi 10.2140/camcos.2010.5.65; differential-evolution moves after C. ter Braak (2006), doi 10.1007/s11222-006-8769-1.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.special import logsumexp

from structid.errors import ConvergenceError, InputError
from structid.inference.sampler import (
    BLOCK_STEPS,
    Block,
    Drawn,
    Keep,
    Sampler,
    block_lengths,
    joined,
    stream,
    without_cut_off,
)
from structid.inference.target import Target
from structid.models.base import Progress

SETTLING_GAP = 30.0
"""Nats below the median from which a walker is taken to be caught in a false mode while the ensemble settles."""
DEGREES_OF_FREEDOM = 10.0
"""Of the laws that an independence move draws from: tails heavier than a Gaussian's, so that far walkers are not left there."""
LAYERS = ((1.0, 0.7), (0.5, 0.1), (0.25, 0.1), (0.125, 0.1))
"""Of these laws: the share of the walkers, the densest, that each is fitted to, and its share of the moves."""
START_TRIES = 50
"""Rounds of drawing starting points of finite density."""
_PURPOSE = {"start": 1, "moves": 2, "settling": 3}


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
        Fraction of the steps that use a differential-evolution move in the place of the stretch.
    discard : float
        Fraction of the steps dropped at the start.
    start_candidates : int
        Points drawn from the prior for every walker; a walker starts at one of them, chosen with a probability that grows
        with its density rank. 1 starts from plain prior draws.
    settling_steps : int
        During this many first steps, at the end of every block, walkers whose log density is more than `SETTLING_GAP` below
        their ensemble's median are put where a random healthy walker of that ensemble is. It frees walkers caught in a
        false mode; it is no Markov move, so these steps must lie within the discarded part.
    """

    walkers: int = 100
    steps: int = 700
    ensembles: int = 4
    stretch: float = 2.0
    differential_evolution: float = 0.0
    discard: float = 0.5
    start_candidates: int = 1
    settling_steps: int = 0

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
            if not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(f"AIES.{name}", f"{value!r}", f"a whole number, {least} or more")
        if self.walkers % 2:
            raise InputError("AIES.walkers", f"{self.walkers}", "an even number: the ensemble moves in two halves")
        if not self.stretch > 1.0:
            raise InputError("AIES.stretch", f"{self.stretch}", "a number above 1")
        for name in ("differential_evolution", "discard"):
            if not 0.0 <= getattr(self, name) < 1.0 + (name == "differential_evolution"):
                raise InputError(f"AIES.{name}", f"{getattr(self, name)}", "a fraction between 0 and 1")
        if self.settling_steps > int(self.discard * self.steps):
            raise InputError(
                "AIES.settling_steps",
                f"{self.settling_steps}",
                f"at most the {int(self.discard * self.steps)} steps that are discarded",
                "Settling is no Markov move: its steps must not be kept.",
            )

    def describe(self) -> dict[str, float]:
        """Settings that decide the draws: all but the number of steps and what is dropped.

        Returns
        -------
        dict
            For hashes; more steps continue the same chain.
        """
        return {k: v for k, v in asdict(self).items() if k not in ("steps", "discard")}

    @property
    def in_words(self) -> str:
        """The settings in a line, for a report."""
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
        """Draw; see `Sampler.run`.

        Parameters
        ----------
        target : Target
            What to sample.
        seed : int
            Seed.
        start : ndarray (point, parameter) or None
            Points in SI among which the walkers start; drawn from the target when left out.
        blocks : list of dict
            What is already on disk.
        keep : callable
            Puts a block on disk.
        progress : callable, optional
            Told how many steps are done.

        Returns
        -------
        Drawn
            Every step, the discarded ones included.
        """
        lengths = list(block_lengths(self.steps))
        blocks = without_cut_off(blocks, lengths)
        if blocks:
            state, start_failures = EnsembleState(blocks[-1]["phi"][-1], blocks[-1]["log_density"][-1]), 0
        else:
            state, start_failures = starting_state(target, self, seed, start)
        for index in range(len(blocks), len(lengths)):
            if 0 < index * BLOCK_STEPS <= self.settling_steps:
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


class EnsembleState(NamedTuple):
    """Where every walker is. With the seed and the block's number it decides all that follows.

    Parameters
    ----------
    phi : ndarray, shape (ensemble, walker, parameter)
        Unconstrained coordinates.
    log_density : ndarray, shape (ensemble, walker)
        Their log density.
    """

    phi: np.ndarray
    log_density: np.ndarray


def stretch_proposal(
    rng: np.random.Generator, moving: np.ndarray, resting: np.ndarray, a: float
) -> tuple[np.ndarray, np.ndarray]:
    """Stretch move.

    x* = x_j + Z (x_i − x_j) with x_j from the resting half and Z ~ g(z) ∝ 1/√z on [1/a, a], accepted with
    min{1, Z^(d−1) π(x*)/π(x_i)}. (The source prints x_i + Z (x_j − x_i) [2.31], which is not the move that its acceptance [2.33]
    belongs to.)

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    moving, resting : ndarray, shape (ensemble, walker, parameter)
        The two halves.
    a : float
        Stretch parameter.

    Returns
    -------
    tuple of ndarray
        Proposals (ensemble, walker, parameter) and the log of the factor Z^(d−1) (ensemble, walker).
    """
    ensembles, walkers, dimension = moving.shape
    # Inverse of the cdf of g: √z is uniform between 1/√a and √a.
    z = ((a - 1.0) * rng.random((ensembles, walkers)) + 1.0) ** 2 / a
    partner = rng.integers(resting.shape[1], size=(ensembles, walkers))
    anchor = np.take_along_axis(resting, partner[:, :, None], axis=1)
    return anchor + z[:, :, None] * (moving - anchor), (dimension - 1.0) * np.log(z)


def differential_proposal(
    rng: np.random.Generator, moving: np.ndarray, resting: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Differential-evolution move.

    x* = x_i + γ (x_j − x_k) with two different walkers of the resting half and γ = 2.38/√(2d), in a tenth of the moves γ = 1
    (which jumps between modes), each γ spread by 5 %. The law of γ does not depend on the walkers, so the move is symmetric.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    moving, resting : ndarray, shape (ensemble, walker, parameter)
        The two halves.

    Returns
    -------
    tuple of ndarray
        Proposals (ensemble, walker, parameter) and zeros (ensemble, walker).
    """
    ensembles, walkers, dimension = moving.shape
    count = resting.shape[1]
    first = rng.integers(count, size=(ensembles, walkers))
    second = (first + rng.integers(1, count, size=(ensembles, walkers))) % count
    difference = np.take_along_axis(resting, first[:, :, None], 1) - np.take_along_axis(resting, second[:, :, None], 1)
    gamma = np.where(rng.random((ensembles, walkers)) < 0.1, 1.0, 2.38 / np.sqrt(2.0 * dimension))
    gamma = gamma * (1.0 + 0.05 * rng.standard_normal((ensembles, walkers)))
    return moving + gamma[:, :, None] * difference, np.zeros((ensembles, walkers))


def independent_proposal(
    rng: np.random.Generator, moving: np.ndarray, resting: np.ndarray, log_density: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Independence move.

    x* is drawn from a law q that the resting half decides, wherever x_i is, and accepted with
    min{1, π(x*) q(x_i) / (π(x_i) q(x*))} (N. Chopin 2002, doi 10.1093/biomet/89.3.539). What is accepted has forgotten where it
    came from, and q does not depend on what moves. q is the mixture of the Student laws of `LAYERS`, each of
    `DEGREES_OF_FREEDOM` about the mean of the densest walkers at rest with their covariance for a scale: where a narrow peak rises
    out of a wide slope, the law of all walkers hardly ever proposes the peak, and those that are in it would not leave.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    moving, resting : ndarray, shape (ensemble, walker, parameter)
        The two halves.
    log_density : ndarray, shape (ensemble, walker)
        Of the resting half; only its order counts.

    Returns
    -------
    tuple of ndarray
        Proposals (ensemble, walker, parameter) and log q(x_i)/q(x*) (ensemble, walker).
    """
    ensembles, walkers, dimension = moving.shape
    sizes = _layers(resting.shape[1], dimension)
    shares = list(sizes.values())
    middle, factor = _fitted(resting, log_density, list(sizes))
    log_share = np.log(shares)[:, None]
    log_volume = np.log(np.einsum("elii->eli", factor)).sum(axis=2)[:, :, None]
    whitening = np.linalg.inv(factor)

    def log_law(x: np.ndarray) -> np.ndarray:
        whitened = whitening @ (x[:, None] - middle[:, :, None]).swapaxes(2, 3)
        student = -0.5 * (DEGREES_OF_FREEDOM + dimension) * np.log1p((whitened**2).sum(axis=2) / DEGREES_OF_FREEDOM)
        return logsumexp(log_share - log_volume + student, axis=1)

    layer = rng.choice(len(shares), p=shares, size=(ensembles, walkers))
    ensemble = np.arange(ensembles)[:, None]
    tails = np.sqrt(DEGREES_OF_FREEDOM / rng.chisquare(DEGREES_OF_FREEDOM, (ensembles, walkers, 1)))
    steps = np.einsum("ewij,ewj->ewi", factor[ensemble, layer], rng.standard_normal(moving.shape))
    proposal = middle[ensemble, layer] + tails * steps
    return proposal, log_law(moving) - log_law(proposal)


def _layers(walkers: int, dimension: int) -> dict[int, float]:
    """How many walkers, the densest, each law of `LAYERS` is fitted to, and its share of the moves."""
    sizes: dict[int, float] = {}
    for densest, share in LAYERS:
        # No covariance from fewer than four walkers for each of its dimensions; of few walkers, several layers are one.
        size = min(walkers, max(round(densest * walkers), 4 * dimension))
        sizes[size] = sizes.get(size, 0.0) + share
    return sizes


def _fitted(walkers: np.ndarray, log_density: np.ndarray, sizes: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and Cholesky factor of the covariance of the densest so many walkers, for several such numbers.

    Shapes (ensemble, layer, parameter) and (ensemble, layer, parameter, parameter).
    """
    ordered = np.take_along_axis(walkers, np.argsort(-log_density, axis=1, kind="stable")[:, :, None], axis=1)
    middles, covariances = [], []
    for size in sizes:
        middles.append(ordered[:, :size].mean(axis=1))
        away = ordered[:, :size] - middles[-1][:, None]
        covariances.append(away.swapaxes(1, 2) @ away / size)
    covariance = np.stack(covariances, axis=1)
    # Few walkers, or copies of one another, may lie in a plane: a little width across it keeps the factor regular.
    own = np.einsum("elii->eli", covariance)
    width = 1e-9 * np.where(own > 0.0, own, 1.0)
    return np.stack(middles, axis=1), np.linalg.cholesky(covariance + width[..., None] * np.eye(walkers.shape[2]))


def proposed(
    rng: np.random.Generator,
    moving: np.ndarray,
    resting: np.ndarray,
    resting_density: np.ndarray,
    stretch: float,
    differential_evolution: float,
    independent: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Propose an independence move in a fraction of the steps, and in the others a differential-evolution or a stretch move.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    moving, resting : ndarray, shape (ensemble, walker, parameter)
        The two halves.
    resting_density : ndarray, shape (ensemble, walker)
        Log density of the resting half.
    stretch : float
        a of the stretch move.
    differential_evolution : float
        Fraction of differential-evolution moves among those that are not independent.
    independent : float
        Fraction of independence moves.

    Returns
    -------
    tuple of ndarray
        Proposals (ensemble, walker, parameter) and the log of the factor in their acceptance (ensemble, walker).
    """
    if independent > 0.0 and rng.random() < independent:
        return independent_proposal(rng, moving, resting, resting_density)
    if rng.random() < differential_evolution:
        return differential_proposal(rng, moving, resting)
    return stretch_proposal(rng, moving, resting, stretch)


def halves(walkers: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Split an ensemble: first one half moves and the other rests, then the other way round.

    Parameters
    ----------
    walkers : int
        In an ensemble; an even number.

    Returns
    -------
    tuple of tuple of slice
        Moving and resting walkers, twice.
    """
    first, second = slice(0, walkers // 2), slice(walkers // 2, None)
    return (first, second), (second, first)


def starting_state(
    target: Target, settings: AIES, seed: int, points: np.ndarray | None = None
) -> tuple[EnsembleState, int]:
    """Choose starting points of finite density.

    Parameters
    ----------
    target : Target
        What to sample.
    settings : AIES
        Walkers, ensembles, candidates.
    seed : int
        Seed.
    points : array-like, shape (point, parameter), optional
        Where walkers may start, in SI; drawn from the target when left out.

    Returns
    -------
    tuple of EnsembleState and int
        The state, and the number of failed simulations.

    Raises
    ------
    ConvergenceError
        If the density is finite almost nowhere the target suggests.
    """
    if settings.walkers < 2 * target.dimension:
        raise InputError(
            "AIES.walkers",
            f"{settings.walkers} for {target.dimension} parameters",
            f"{2 * target.dimension} or more: an ensemble must span the space",
        )
    rng = stream(seed, _PURPOSE["start"], 0)
    total = settings.ensembles * settings.walkers
    wanted = total * settings.start_candidates
    phi, density = np.empty((0, target.dimension)), np.empty(0)
    failed_simulations = 0
    for _ in range(START_TRIES):
        fresh = target.initial(wanted, rng) if points is None else _chosen(target, points, wanted, rng)
        value, failed = target.evaluate(fresh)
        failed_simulations += int(failed.sum())
        good = np.isfinite(value)
        phi, density = np.concatenate([phi, fresh[good]]), np.concatenate([density, value[good]])
        if len(phi) >= wanted:
            break
    else:
        raise ConvergenceError(
            f"Only {len(phi)} of {START_TRIES * wanted} starting points have a finite log density "
            f"({failed_simulations} simulations failed). Check the priors: most of what they allow cannot be simulated "
            "or has no likelihood."
        )
    phi, density = phi[:wanted], density[:wanted]
    if settings.start_candidates > 1:
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
    """Draw starting points from given ones, each used as seldom as possible."""
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
    """Move every walker a number of times.

    Parameters
    ----------
    target : Target
        What to sample.
    settings : AIES
        The moves.
    state : EnsembleState
        Where the walkers are.
    seed, index : int
        Seed, and number of the block: together they give its random stream.
    steps : int
        How many times every walker moves.

    Returns
    -------
    tuple of EnsembleState and dict
        The state after, and ``phi`` (step, ensemble, walker, parameter), ``log_density``, ``accepted`` (step, ensemble, walker)
        and ``failed`` simulations (step,).
    """
    rng = stream(seed, _PURPOSE["moves"], index)
    phi, density = state.phi.copy(), state.log_density.copy()
    ensembles, walkers, dimension = phi.shape
    block: Block = {
        "phi": np.empty((steps, ensembles, walkers, dimension)),
        "log_density": np.empty((steps, ensembles, walkers)),
        "accepted": np.empty((steps, ensembles, walkers), dtype=bool),
        "failed": np.zeros(steps, dtype=np.int64),
    }
    for step in range(steps):
        for moving, resting in halves(walkers):
            accepted, failed = move_walkers(
                rng, target, phi[:, moving], density[:, moving], phi[:, resting], density[:, resting],
                settings.stretch, settings.differential_evolution,
            )  # fmt: skip
            block["accepted"][step, :, moving] = accepted
            block["failed"][step] += failed
        block["phi"][step], block["log_density"][step] = phi, density
    return EnsembleState(phi, density), block


def move_walkers(
    rng: np.random.Generator,
    target: Target,
    phi: np.ndarray,
    density: np.ndarray,
    resting: np.ndarray,
    resting_density: np.ndarray,
    stretch: float,
    differential_evolution: float,
    independent: float = 0.0,
) -> tuple[np.ndarray, int]:
    """Move one half of every ensemble, in place: one batched call of the target.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    target : Target
        What is sampled.
    phi : ndarray, shape (ensemble, walker, parameter)
        The half that moves; changed.
    density : ndarray, shape (ensemble, walker)
        Its log density; changed.
    resting : ndarray, shape (ensemble, walker, parameter)
        The other half.
    resting_density : ndarray, shape (ensemble, walker)
        Its log density.
    stretch : float
        a of the stretch move.
    differential_evolution, independent : float
        Fractions of the moves; see `proposed`.

    Returns
    -------
    tuple of ndarray of bool (ensemble, walker), int
        Which moved, and how many simulations failed.
    """
    proposal, log_factor = proposed(rng, phi, resting, resting_density, stretch, differential_evolution, independent)
    value, failed = target.evaluate(proposal.reshape(-1, phi.shape[2]))
    value = value.reshape(log_factor.shape)
    accepted = np.log(rng.random(log_factor.shape)) < log_factor + value - density
    phi[accepted], density[accepted] = proposal[accepted], value[accepted]
    return accepted, int(failed.sum())


def settle(state: EnsembleState, seed: int, index: int) -> EnsembleState:
    """Put walkers caught in a false mode where healthy ones of their ensemble are.

    Parameters
    ----------
    state : EnsembleState
        After a block.
    seed, index : int
        Seed, and number of the block.

    Returns
    -------
    EnsembleState
        Every walker within `SETTLING_GAP` nats of its ensemble's median.
    """
    rng = stream(seed, _PURPOSE["settling"], index)
    phi, density = state.phi.copy(), state.log_density.copy()
    for ensemble in range(len(phi)):
        lost = density[ensemble] < np.median(density[ensemble]) - SETTLING_GAP
        hosts = rng.choice(np.flatnonzero(~lost), size=int(lost.sum()))
        phi[ensemble, lost], density[ensemble, lost] = phi[ensemble, hosts], density[ensemble, hosts]
    return EnsembleState(phi, density)
