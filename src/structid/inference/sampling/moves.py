"""Moves of an ensemble's walkers: one half moves, guided by the other half, which rests.

J. Goodman & J. Weare (2010), "Ensemble samplers with affine invariance", Comm. App. Math. Comp. Sci. 5, 65-80,
doi 10.2140/camcos.2010.5.65; differential-evolution moves after C. ter Braak (2006), doi 10.1007/s11222-006-8769-1; independence
moves after N. Chopin (2002), doi 10.1093/biomet/89.3.539, who uses particles.

Numbers in brackets, such as [2.31], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln

from structid.inference.target import Target

DEGREES_OF_FREEDOM = 10.0
"""Degrees of freedom of the Student-t proposals, whose heavier-than-Gaussian tails reach distant walkers."""
LAYERS = ((1.0, 0.7), (0.5, 0.1), (0.25, 0.1), (0.125, 0.1))
"""For each component: the fraction of walkers (those of highest density) to which it is fitted, and its fraction of the
moves."""
Kind = Literal["independent", "differential evolution", "stretch"]
"""Kind of a move; all moving walkers make the same kind of move."""


class EnsembleState(NamedTuple):
    """Positions of all walkers, or of one half of them."""

    phi: Float[np.ndarray, "ensemble walker parameter"]  # Unconstrained coordinates
    log_density: Float[np.ndarray, "ensemble walker"]  # log of the sampled density there

    def part(self, walkers: slice) -> EnsembleState:
        """Selected walkers of every ensemble, as a view."""
        return EnsembleState(self.phi[:, walkers], self.log_density[:, walkers])

    def copied(self) -> EnsembleState:
        """A deep copy."""
        return EnsembleState(self.phi.copy(), self.log_density.copy())


def halves(walkers: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Split an ensemble: first one half moves and the other rests, then the other way round."""
    first, second = slice(0, walkers // 2), slice(walkers // 2, None)
    return (first, second), (second, first)


def stretch_proposal(
    rng: np.random.Generator,
    moving: Float[np.ndarray, "ensemble walker parameter"],
    resting: Float[np.ndarray, "ensemble resting_walker parameter"],
    a: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Stretch move.

    x* = x_j + Z (x_i − x_j) with x_j from the resting half and Z ~ g(z) ∝ 1/√z on [1/a, a], accepted with min{1, Z^(d−1)
    π(x*)/π(x_i)}. (The thesis prints x_i + Z (x_j − x_i) [2.31], which does not match its acceptance [2.33].)
    """
    ensembles, walkers, dimension = moving.shape
    # Inverse of the cdf of g: √z is uniform between 1/√a and √a.
    z = ((a - 1.0) * rng.random((ensembles, walkers)) + 1.0) ** 2 / a
    partner = rng.integers(resting.shape[1], size=(ensembles, walkers))
    anchor = np.take_along_axis(resting, partner[:, :, None], axis=1)
    return anchor + z[:, :, None] * (moving - anchor), (dimension - 1.0) * np.log(z)


def differential_proposal(
    rng: np.random.Generator,
    moving: Float[np.ndarray, "ensemble walker parameter"],
    resting: Float[np.ndarray, "ensemble resting_walker parameter"],
) -> tuple[np.ndarray, np.ndarray]:
    """Differential-evolution move.

    x* = x_i + γ (x_j − x_k) with two different walkers of the resting half. γ is 2.38/√(2d), or 1 in a tenth of the moves (which
    jumps between modes), and is varied by 5 %. The distribution of γ does not depend on the walkers, so that the move is
    symmetric.
    """
    ensembles, walkers, dimension = moving.shape
    count = resting.shape[1]
    first = rng.integers(count, size=(ensembles, walkers))
    second = (first + rng.integers(1, count, size=(ensembles, walkers))) % count
    difference = np.take_along_axis(resting, first[:, :, None], 1) - np.take_along_axis(resting, second[:, :, None], 1)
    gamma = np.where(rng.random((ensembles, walkers)) < 0.1, 1.0, 2.38 / np.sqrt(2.0 * dimension))
    gamma = gamma * (1.0 + 0.05 * rng.standard_normal((ensembles, walkers)))
    return moving + gamma[:, :, None] * difference, np.zeros((ensembles, walkers))


class IndependenceProposal(NamedTuple):
    """A mixture of Student-t distributions from which independence moves are drawn.

    Each component has `DEGREES_OF_FREEDOM` degrees of freedom. Its centre and scale are the mean and covariance of all
    walkers, or of the walkers of highest density, according to `LAYERS`. If a narrow peak rises from a wide slope, a
    proposal fitted to all walkers hardly ever proposes a point on the peak, and walkers there would be stuck.
    """

    middle: Float[np.ndarray, "ensemble layer parameter"]  # centre of each component
    factor: Float[np.ndarray, "ensemble layer parameter parameter"]  # Cholesky factor of its covariance
    share: Float[np.ndarray, " layer"]  # its fraction of the moves

    @classmethod
    def fitted(cls, walkers: EnsembleState) -> IndependenceProposal:
        """Fit a distribution to walkers, separately for each ensemble."""
        sizes = _layers(*walkers.phi.shape[1:])
        middle, factor = _layered(walkers, list(sizes))
        return cls(middle, factor, np.array(list(sizes.values())))

    def shared_by(self, ensembles: int) -> IndependenceProposal:
        """Copies of a single ensemble's distribution for several ensembles."""
        return self._replace(
            middle=np.repeat(self.middle, ensembles, axis=0), factor=np.repeat(self.factor, ensembles, axis=0)
        )

    def draw(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "ensemble count parameter"]:
        """Draw from the distribution of every ensemble."""
        ensembles, layers, dimension = self.middle.shape
        layer = rng.choice(layers, p=self.share, size=(ensembles, count))
        ensemble = np.arange(ensembles)[:, None]
        tails = np.sqrt(DEGREES_OF_FREEDOM / rng.chisquare(DEGREES_OF_FREEDOM, (ensembles, count, 1)))
        normal = rng.standard_normal((ensembles, count, dimension))
        return np.asarray(
            self.middle[ensemble, layer] + tails * np.einsum("ewij,ewj->ewi", self.factor[ensemble, layer], normal)
        )

    def log_density(self, x: Float[np.ndarray, "ensemble walker parameter"]) -> Float[np.ndarray, "ensemble walker"]:
        """Log q.

        A Student density is Γ((ν + d)/2) / (Γ(ν/2) (νπ)^(d/2) |Σ|^½) (1 + r²/ν)^(−(ν + d)/2).
        """
        log_share = np.log(self.share)[:, None]
        log_volume = np.log(np.einsum("elii->eli", self.factor)).sum(axis=2)[:, :, None]
        whitened = np.linalg.inv(self.factor) @ (x[:, None] - self.middle[:, :, None]).swapaxes(2, 3)
        degrees, dimension = DEGREES_OF_FREEDOM, x.shape[2]
        exponent = -0.5 * (degrees + dimension)
        constant = gammaln(-exponent) - gammaln(0.5 * degrees) - 0.5 * dimension * np.log(np.pi * degrees)
        student = exponent * np.log1p((whitened**2).sum(axis=2) / DEGREES_OF_FREEDOM)
        return np.asarray(constant + np.logaddexp.reduce(log_share - log_volume + student, axis=1))


def _layers(walkers: int, dimension: int) -> dict[int, float]:
    """Number of highest-density walkers for each component of `LAYERS`, and the component's fraction of the moves."""
    sizes: dict[int, float] = {}
    for densest, share in LAYERS:
        # A covariance needs at least four walkers per dimension. With few walkers, several layers merge into one.
        size = min(walkers, max(round(densest * walkers), 4 * dimension))
        sizes[size] = sizes.get(size, 0.0) + share
    return sizes


def _layered(walkers: EnsembleState, sizes: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and Cholesky factor of the covariance of the walkers of highest density, for several numbers of walkers.

    Shapes (ensemble, layer, parameter) and (ensemble, layer, parameter, parameter).
    """
    order = np.argsort(-walkers.log_density, axis=1, kind="stable")
    ordered = np.take_along_axis(walkers.phi, order[:, :, None], axis=1)
    middles, covariances = [], []
    for size in sizes:
        middles.append(ordered[:, :size].mean(axis=1))
        away = ordered[:, :size] - middles[-1][:, None]
        covariances.append(away.swapaxes(1, 2) @ away / size)
    covariance = np.stack(covariances, axis=1)
    # Few walkers, or copies of one another, may lie in a plane: a little width across it keeps the factor regular.
    diagonal = np.einsum("elii->eli", covariance)
    width = 1e-9 * np.where(diagonal > 0.0, diagonal, 1.0)
    return np.stack(middles, axis=1), np.linalg.cholesky(covariance + width[..., None] * np.eye(ordered.shape[2]))


def independent_proposal(
    rng: np.random.Generator, moving: Float[np.ndarray, "ensemble walker parameter"], proposal: IndependenceProposal
) -> tuple[np.ndarray, np.ndarray]:
    """Independence move.

    x* is drawn from a distribution q that does not depend on x_i, and accepted with min{1, π(x*) q(x_i) / (π(x_i)
    q(x*))}. After an accepted move, a walker is independent of its previous position.
    """
    proposed = proposal.draw(rng, moving.shape[1])
    return proposed, proposal.log_density(moving) - proposal.log_density(proposed)


@dataclass(frozen=True, eq=False)
class Moves:
    """Mixture of the walkers' moves."""

    stretch: float  # a of the stretch move
    differential_evolution: float  # Fraction of differential-evolution moves among the other moves
    independent: float = 0.0  # Fraction of independence moves
    # Proposal of the independence moves. If left out, it is fitted to the resting half for each move
    proposal: IndependenceProposal | None = None

    def kind(self, rng: np.random.Generator) -> Kind:
        """Draw the kind of a move."""
        if self.independent > 0.0 and rng.random() < self.independent:
            return "independent"
        return "differential evolution" if rng.random() < self.differential_evolution else "stretch"

    def there_and_back(self, rng: np.random.Generator, count: int) -> list[Kind]:
        """Draw the kinds of several moves whose sequence is reversible.

        If moves a and b are each reversible, the sequence P_a P_b is not, but P_a P_b P_a and P_a P_b P_b P_a are.
        """
        first = [self.kind(rng) for _ in range((count + 1) // 2)]
        return first + first[::-1][count % 2 :]

    def propose(
        self,
        rng: np.random.Generator,
        kind: Kind,
        moving: Float[np.ndarray, "ensemble walker parameter"],
        resting: EnsembleState,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Propose a new position for every walker of a half."""
        if kind == "independent":
            return independent_proposal(
                rng, moving, IndependenceProposal.fitted(resting) if self.proposal is None else self.proposal
            )
        if kind == "differential evolution":
            return differential_proposal(rng, moving, resting.phi)
        return stretch_proposal(rng, moving, resting.phi, self.stretch)


def move_walkers(
    rng: np.random.Generator,
    target: Target,
    moving: EnsembleState,
    resting: EnsembleState,
    moves: Moves,
    kind: Kind | None = None,
) -> tuple[np.ndarray, int]:
    """Move one half of every ensemble, in place, with one batched call of the target."""
    proposal, log_factor = moves.propose(rng, moves.kind(rng) if kind is None else kind, moving.phi, resting)
    value, failed = target.evaluate(proposal.reshape(-1, proposal.shape[2]))
    value = value.reshape(log_factor.shape)
    # Sums, not differences: a walker may be where a surrogate gives no density, and −inf − (−inf) is NaN.
    accepted = np.log(rng.random(log_factor.shape)) + moving.log_density < log_factor + value
    moving.phi[accepted], moving.log_density[accepted] = proposal[accepted], value[accepted]
    return accepted, int(failed.sum())
