"""Scores of a density that is known only at draws: the gradient of its logarithm, from a Kriging surrogate.

A Kriging surrogate k interpolates log q between a few hundred draws. With the weights exp(k)/q, draws of q are draws of exp(k),
whose scores are exact: an error of the Kriging makes a test by Stein's identity weaker, and not wrong. This holds where the weights
are even enough; a Kriging that extends beyond the draws has few draws with all the weight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from structid.certification.external.drawn_density import DrawnDensity
from structid.certification.external.fitted_density import FittedDensity
from structid.certification.external.kriged_density import (
    CORRELATIONS,
    KrigedDensity,
    in_parameters,
    normal_by,
    standardised_by,
)
from structid.inference.convergence import weighted_size

INTERPOLATED = 200
"""Largest number of draws that the Kriging surrogate interpolates; half of the draws if these are fewer."""
COMPARED = 3000
"""Approximate limit on the number of draws whose scores are computed."""
BLOCKS = 20
"""Smallest number of blocks of successive draws, for the jackknife and for random signs."""
LENGTH = 10.0
"""Length of a block for random signs, in autocorrelation times."""
NARROWEST = 0.05
"""Smallest eigenvalue of P: a wider q is refused with this value, too."""
TINY = 1e-6
"""Smallest eigenvalue of a covariance, in variances of the draws."""
STEP = 1e-3
"""Step of a difference quotient, in standard deviations."""
IN_KERNEL = 1000
"""Largest number of draws in the kernel Stein discrepancy."""
REPLICATES = 10_000
"""Number of bootstrap replicates of a null distribution."""


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates z of draws with mean zero and unit covariance, y = μ + R z: of φ, or of the normal coordinates of a fit.

    Parameters
    ----------
    fitted : FittedDensity or None
        A density fitted to the draws, if y are its normal coordinates; otherwise y = φ.
    mean : ndarray, shape (parameter,)
        μ.
    root : ndarray, shape (parameter, parameter)
        R, the symmetric root of the covariance: these coordinates are closest to y.
    """

    fitted: FittedDensity | None
    mean: np.ndarray
    root: np.ndarray

    @classmethod
    def of(cls, phi: Float[np.ndarray, "draw parameter"], fitted: FittedDensity | None) -> Coordinates:
        """Standardise the coordinates of draws."""
        y = phi if fitted is None else fitted.in_normal_coordinates(phi)[0]
        return cls(fitted, y.mean(axis=0), power_of(np.atleast_2d(np.cov(y.T)), 0.5))

    def standard(self, phi: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, "point parameter"]:
        """Return z."""
        y = phi if self.fitted is None else self.fitted.in_normal_coordinates(phi)[0]
        return np.asarray(np.linalg.solve(self.root, (y - self.mean).T).T)

    def phi(self, z: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, "point parameter"]:
        """Return φ."""
        y = self.mean + z @ self.root
        return y if self.fitted is None else self.fitted.of_normal_coordinates(y)

    def log_density(
        self, kriged: KrigedDensity, z: Float[np.ndarray, "point parameter"]
    ) -> Float[np.ndarray, " point"]:
        """Log density of a surrogate with respect to z, up to a constant."""
        phi = self.phi(z)
        return kriged.mean_at(phi) - (0.0 if self.fitted is None else self.fitted.in_normal_coordinates(phi)[1])


class Interpolation(NamedTuple):
    """A Kriging surrogate of log q with respect to φ."""

    coordinates: Coordinates  # those in which it predicts best
    kriged: KrigedDensity
    rows: Int[np.ndarray, " run"]  # the interpolated draws


@dataclass(frozen=True, eq=False)
class Scores:
    """Draws with the scores of a surrogate k of their log density.

    Parameters
    ----------
    z : ndarray, shape (draw, parameter)
        Draws; see `Coordinates`.
    values : ndarray, shape (draw, parameter)
        Scores ∂k/∂z.
    weights : ndarray, shape (draw,)
        exp(k)/q; they sum to one.
    blocks : ndarray, shape (draw,)
        Numbers of the blocks of successive draws.
    """

    z: np.ndarray
    values: np.ndarray
    weights: np.ndarray
    blocks: np.ndarray

    @classmethod
    def of(cls, drawn: DrawnDensity, interpolation: Interpolation) -> Scores:
        """Compute the scores at draws that a surrogate does not interpolate."""
        coordinates, kriged, known = interpolation
        places = drawn.in_order(np.arange(float(len(drawn.phi)))[:, None])[..., 0].astype(int)
        places = places[:, :: max(1, len(drawn.phi) // COMPARED)]
        others = ~np.isin(places, known)  # the Kriging has no error at the known draws
        rows, blocks = places[others], _blocks_of(*places.shape)[others]
        z = coordinates.standard(drawn.phi[rows])
        excess = kriged.mean_at(drawn.phi[rows]) - log_density_of(drawn)[rows]
        weights = np.exp(excess - excess.max())
        return cls(z, _gradient(partial(coordinates.log_density, kriged), z), weights / weights.sum(), blocks)

    def __getitem__(self, rows: np.ndarray) -> Scores:
        weights = self.weights[rows]
        return Scores(self.z[rows], self.values[rows], weights / weights.sum(), self.blocks[rows])

    @property
    def effective_share(self) -> float:
        """Share of the draws that the weights leave effective."""
        return weighted_size(self.weights) / len(self.weights)

    @property
    def moments_of_q(self) -> tuple[Float[np.ndarray, " parameter"], Float[np.ndarray, "parameter parameter"]]:
        """Mean and covariance of q, in the coordinates z."""
        mean, mean_score = self.weights @ self.z, self.weights @ self.values
        covariance = covariance_of(self.z, self.weights)
        cross = (self.weights[:, None] * (self.z - mean)).T @ (self.values - mean_score)
        slope = -np.linalg.solve(covariance, cross)
        values, vectors = np.linalg.eigh(0.5 * (slope + slope.T))
        inverse = (vectors / np.maximum(values, NARROWEST)) @ vectors.T
        # The moments of exp(k) are mean + P⁻¹ E[s] and P⁻¹. Those of q differ by as much as the draws do without their weights.
        equal = np.full(len(self.z), 1.0 / len(self.z))
        return equal @ self.z + inverse @ mean_score, inverse + covariance_of(self.z, equal) - covariance

    def moment_probability(self, independent: float, rng: np.random.Generator) -> float:
        """Probability, over draws of q, of averages E[s] and E[z sᵀ] + 1 as far from zero as those of the draws."""
        linear = self.z[:, :, None] * self.values[:, None, :] + np.eye(self.z.shape[1])
        functions = np.concatenate([self.values, linear.reshape(len(self.z), -1)], axis=1)
        functions = self.weights[:, None] * functions
        sums = np.add.reduceat(functions, self._starts(independent), axis=0)
        sums /= np.maximum(np.sqrt(np.sum(sums**2, axis=0)), np.finfo(float).tiny)
        signs = rng.choice([-1.0, 1.0], size=(REPLICATES, len(sums)))
        return _exceeding(np.sum((signs @ sums) ** 2, axis=1), float(np.sum(sums.sum(axis=0) ** 2)))

    def kernel_probability(self, independent: float, rng: np.random.Generator) -> float:
        """Probability, over draws of q, of a kernel Stein discrepancy as large as that of the draws.

        The kernel is (1 + |z − z'|²/d)^(−1/2) (J. Gorham & L. Mackey 2017, Proc. 34th ICML).
        """
        chosen = self[np.sort(rng.permutation(len(self.z))[:IN_KERNEL])]
        products = chosen.weights[:, None] * _stein_kernel(chosen.z, chosen.values) * chosen.weights
        starts = chosen._starts(independent)
        sums = np.add.reduceat(np.add.reduceat(products, starts, axis=0), starts, axis=1)
        signs = rng.choice([-1.0, 1.0], size=(REPLICATES, len(sums)))
        return _exceeding(np.einsum("ij,ij->i", signs @ sums, signs), float(sums.sum()))

    def _starts(self, independent: float) -> np.ndarray:
        """Starts of blocks that are nearly independent; their random signs give a null distribution."""
        count = int(np.clip(independent / LENGTH, BLOCKS, len(self.z)))
        return np.unique(np.arange(count) * len(self.z) // count)


def _exceeding(replicates: np.ndarray, observed: float) -> float:
    """Probability of a value as large as the observed one."""
    return float(1 + np.sum(replicates >= observed)) / (len(replicates) + 1)


def _blocks_of(chains: int, steps: int) -> np.ndarray:
    """Numbers of blocks (chain, step): parts of few chains, or groups of many."""
    if chains >= BLOCKS:
        return np.broadcast_to(np.arange(chains)[:, None] % BLOCKS, (chains, steps))
    parts = -(-BLOCKS // chains)
    return np.arange(chains)[:, None] * parts + np.arange(steps) * parts // steps


def log_density_of(drawn: DrawnDensity) -> Float[np.ndarray, " draw"]:
    """Log q with respect to φ at the draws."""
    return np.asarray(drawn.at_draws + drawn.bijection(drawn.phi)[1])


def interpolated(drawn: DrawnDensity, rng: np.random.Generator) -> Interpolation:
    """Interpolate the log density between some draws, in the coordinates in which the Kriging predicts best."""
    rows = drawn.distinct(min(INTERPOLATED, len(drawn.phi) // 2), rng)
    phi, values, equal = drawn.phi[rows], log_density_of(drawn)[rows], np.ones(len(rows))
    charts = {
        None: (in_parameters(drawn.bijection, drawn.flat), standardised_by(drawn.phi)),
        drawn.fitted: (normal_by(drawn.fitted),),
    }
    best = {
        fitted: KrigedDensity.best([(chart, name) for chart in of_these for name in CORRELATIONS], phi, values, equal)
        for fitted, of_these in charts.items()
    }
    fitted = min(best, key=lambda one: best[one].error(equal))
    return Interpolation(Coordinates.of(drawn.phi, fitted), best[fitted], rows)


def _gradient(function: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    """∂f/∂z, (point, parameter)."""
    steps = STEP * np.eye(z.shape[1])
    return np.stack([(function(z + step) - function(z - step)) / (2.0 * STEP) for step in steps], axis=1)


def _stein_kernel(z: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Stein's operator on both arguments of the kernel c(r) = (1 + r)^(−1/2), r = |z − z'|²/d: (draw, draw).

    s·s' c + s·∂c/∂z' + s'·∂c/∂z + tr ∂²c/∂z∂z'
    """
    dimension = z.shape[1]
    r = np.maximum(np.sum(z**2, axis=1)[:, None] + np.sum(z**2, axis=1) - 2.0 * z @ z.T, 0.0) / dimension
    kernel, first, second = (1.0 + r) ** -0.5, -0.5 * (1.0 + r) ** -1.5, 0.75 * (1.0 + r) ** -2.5
    along = np.sum(z * scores, axis=1)[:, None] - scores @ z.T  # s·(z − z')
    return np.asarray(
        scores @ scores.T * kernel
        - 2.0 / dimension * first * (along + along.T)
        - 2.0 * first
        - 4.0 / dimension * second * r
    )


def covariance_of(z: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Covariance of weighted draws."""
    return np.atleast_2d(np.cov(z.T, aweights=weights, bias=True))


def power_of(matrix: np.ndarray, exponent: float) -> np.ndarray:
    """Power of a symmetric positive matrix; round-off and errors may make its smallest eigenvalues negative."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, TINY) ** exponent) @ vectors.T)
