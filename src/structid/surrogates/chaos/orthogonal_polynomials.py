"""Univariate polynomials orthonormal under a marginal distribution, computed by their three-term recurrence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.units import factor
from structid.engine.array_module import namespace
from structid.probability.quadrature import probability_nodes
from structid.probability.truncation import Marginal

QUADRATURE_NODES = 2000
"""Number of quadrature nodes that represent a distribution with a numerical recurrence."""


@dataclass(frozen=True, eq=False)
class OrthonormalFamily:
    """Polynomials orthonormal under one distribution, computed by their three-term recurrence.

    x pₙ(x) = bₙ₊₁ pₙ₊₁(x) + aₙ pₙ(x) + bₙ pₙ₋₁(x),  p₀ = 1  (Gautschi 2004, Orthogonal Polynomials, eq. 1.3.13).
    """

    name: str  # ``"Legendre"``, ``"Hermite"``, … or ``"numerical"``
    a: Float[np.ndarray, " degree"]  # recurrence coefficients a₀, a₁, …
    b: Float[np.ndarray, " _"]  # recurrence coefficients b₁, b₂, …
    shift: float  # the variable of the polynomials is (g(x) − shift)/scale
    scale: float  # The polynomials' variable is (g(x) − shift)/scale
    logarithmic: bool = False  # whether g is the logarithm; otherwise the identity

    @classmethod
    def of(cls, marginal: Marginal, degree: int) -> OrthonormalFamily:
        """Select the family of a marginal, and compute its recurrence up to a degree.

        For a lognormal variable the polynomials use the logarithm, because polynomials in the variable itself are not a
        complete basis (Ernst et al. 2012, doi 10.1051/m2an/2011045). The recurrence is numerical for a truncated or
        non-classical distribution.
        """
        truncated = np.isfinite(_truncation(marginal)).any()
        n = np.arange(degree + 1, dtype=np.float64)
        unit = factor(marginal.unit)
        if marginal.family == "Uniform":
            return cls.legendre(*marginal.support, degree)
        if marginal.family == "Normal" and not truncated:
            mean, sd = marginal.moments
            return cls("Hermite", 0 * n, np.sqrt(n[1:]), mean, sd)
        if marginal.family == "LogNormal" and not truncated:
            log = marginal.parameters
            return cls("Hermite", 0 * n, np.sqrt(n[1:]), log["loc"] + np.log(unit), log["scale"], logarithmic=True)
        if marginal.family == "Gamma" and not truncated:
            shape, rate = marginal.parameters["concentration"], marginal.parameters["rate"]
            # Laguerre, weight x^α e^(−x), α = shape − 1: aₙ = 2n + α + 1, bₙ = √(n (n + α))
            return cls("Laguerre", 2 * n + shape, np.sqrt(n[1:] * (n[1:] + shape - 1)), 0.0, unit / rate)
        if marginal.family == "Beta" and not truncated:
            native = marginal.parameters
            a, b = _jacobi_recurrence(native["concentration0"] - 1, native["concentration1"] - 1, degree)
            return cls("Jacobi", a, b, 0.5 * unit, 0.5 * unit)
        return cls._numerical(marginal, degree, logarithmic=marginal.family == "LogNormal")

    @classmethod
    def legendre(cls, low: float, high: float, degree: int) -> OrthonormalFamily:
        """Return Legendre polynomials, orthonormal under the uniform distribution on a range."""
        n = np.arange(degree + 1, dtype=np.float64)
        # a = 0, bₙ = n/√(4n² − 1)
        return cls("Legendre", 0 * n, n[1:] / np.sqrt(4 * n[1:] ** 2 - 1), 0.5 * (low + high), 0.5 * (high - low))

    def expansion_of(self, other: OrthonormalFamily, degree: int, low: float, high: float) -> Float[np.ndarray, "_ _"]:
        """Expand the polynomials of another family in this family, by Gauss quadrature.

        Outside the range, the polynomials of the other family keep their value at the edge of the range.
        """
        # Golub & Welsch 1969: the nodes are the eigenvalues of the Jacobi matrix, and the weights are the squared first
        # components of its eigenvectors.
        jacobi = np.diag(self.a) + np.diag(self.b, 1) + np.diag(self.b, -1)
        nodes, vectors = np.linalg.eigh(jacobi)
        mine = np.array(self._recurrence(nodes, degree))
        other_values = np.array(other.evaluate(np.clip(nodes * self.scale + self.shift, low, high), degree))
        return np.asarray((mine * vectors[0] ** 2) @ other_values.T)

    @classmethod
    def standard_normal(cls, degree: int) -> OrthonormalFamily:
        """Return Hermite polynomials, orthonormal under the standard normal distribution."""
        return cls("Hermite", np.zeros(degree + 1), np.sqrt(np.arange(1.0, degree + 1)), 0.0, 1.0)

    @classmethod
    def _numerical(cls, marginal: Marginal, degree: int, logarithmic: bool) -> OrthonormalFamily:
        """Return the recurrence of the discrete distribution on the quadrature nodes of a marginal."""
        p, weight = probability_nodes(QUADRATURE_NODES)
        x = marginal.quantile(p)
        x = np.log(x) if logarithmic else x
        shift = float(weight @ x)
        scale = float(np.sqrt(weight @ (x - shift) ** 2))
        a, b = lanczos_recurrence((x - shift) / scale, weight / weight.sum(), degree)
        return cls("numerical", a, b, shift, scale, logarithmic)

    def evaluate(self, x: Float[Array, " run"], degree: int) -> list[Any]:
        """Evaluate the polynomials."""
        numpy = namespace(x)
        return self._recurrence(((numpy.log(x) if self.logarithmic else x) - self.shift) / self.scale, degree)

    def _recurrence(self, t: Any, degree: int) -> list[Any]:
        """Evaluate the polynomials by their recurrence, at values of the standardised variable."""
        values = [namespace(t).ones_like(t)]
        for n in range(degree):
            previous = self.b[n - 1] * values[n - 1] if n else 0.0
            values.append(((t - self.a[n]) * values[n] - previous) / self.b[n])
        return values


def _truncation(marginal: Marginal) -> np.ndarray:
    """Return the bounds that truncate a distribution; a bound without effect is infinite."""
    low, high = marginal.base.support()
    cuts = np.array(
        [marginal.low if marginal.low > low else -np.inf, marginal.high if marginal.high < high else np.inf]
    )
    # A bound has no effect if the truncated probability is below double precision.
    beyond = np.array([marginal.base.cdf(cuts[0]), marginal.base.sf(cuts[1])])
    return np.where(beyond < 1e-16, [-np.inf, np.inf], cuts)


def _jacobi_recurrence(alpha: float, beta: float, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the recurrence of Jacobi polynomials, weight (1 − x)^α (1 + x)^β on [−1, 1] (Gautschi 2004, table 1.1)."""
    n = np.arange(degree + 1, dtype=np.float64)
    total = alpha + beta
    a = np.empty(degree + 1)
    a[0] = (beta - alpha) / (total + 2)
    a[1:] = (beta**2 - alpha**2) / ((2 * n[1:] + total) * (2 * n[1:] + total + 2))
    m = n[1:]
    square = np.empty(degree)
    if degree:
        square[0] = 4 * (alpha + 1) * (beta + 1) / ((total + 2) ** 2 * (total + 3))
        m = m[1:]
        numerator = 4 * m * (m + alpha) * (m + beta) * (m + total)
        square[1:] = numerator / ((2 * m + total) ** 2 * (2 * m + total + 1) * (2 * m + total - 1))
    return a, np.sqrt(square)


def lanczos_recurrence(
    nodes: Float[np.ndarray, " node"], weights: Float[np.ndarray, " node"], degree: int
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the recurrence of polynomials orthonormal on weighted nodes, by the Lanczos method.

    The method tridiagonalises diag(nodes) from the start vector √weights with full orthogonalisation. It is accurate even if
    the Stieltjes procedure is not (Gautschi 2004, section 2.2.3).
    """
    basis = np.zeros((degree + 1, len(nodes)))
    basis[0] = np.sqrt(weights)
    a, b = np.empty(degree + 1), np.empty(degree)
    for n in range(degree + 1):
        image = nodes * basis[n]
        a[n] = basis[n] @ image
        if n == degree:
            break
        for _ in range(2):  # orthogonalising twice is enough
            image = image - basis[: n + 1].T @ (basis[: n + 1] @ image)
        b[n] = np.linalg.norm(image)
        basis[n + 1] = image / b[n]
    return a, b
