"""Orthonormal polynomials of a parameter space: one family a marginal, truncated tensor products of them.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.special

from structid.errors import InputError
from structid.probability.space import ParameterSpace
from structid.probability.truncation import Marginal
from structid.units import factor

LARGEST_BASIS = 200_000
"""More terms than this are taken for a mistake."""

MORE_NODES = 60
"""Nodes beyond the degree where a function is no polynomial any more."""

QUADRATURE_NODES = 2000
"""Nodes that stand for a distribution whose recurrence is found numerically."""


@dataclass(frozen=True, eq=False)
class OrthonormalFamily:
    """Polynomials orthonormal under one distribution, by their three-term recurrence.

    x pₙ(x) = bₙ₊₁ pₙ₊₁(x) + aₙ pₙ(x) + bₙ pₙ₋₁(x),  p₀ = 1  (Gautschi 2004, Orthogonal Polynomials, eq. 1.3.13).

    Parameters
    ----------
    name : str
        ``"Legendre"``, ``"Hermite"``, … or ``"numerical"``.
    a : ndarray, shape (degree,)
        Recurrence coefficients a₀, a₁, …
    b : ndarray, shape (degree,)
        Recurrence coefficients b₁, b₂, …
    shift, scale : float
        The polynomials' variable is (g(x) − shift)/scale.
    logarithmic : bool
        Whether g is the logarithm rather than the identity.
    """

    name: str
    a: np.ndarray
    b: np.ndarray
    shift: float
    scale: float
    logarithmic: bool = False

    @classmethod
    def of(cls, marginal: Marginal, degree: int) -> OrthonormalFamily:
        """Choose the family of a marginal, and its recurrence up to a degree.

        A lognormal is taken by its logarithm, since its own polynomials are not complete (Ernst et al. 2012,
        doi 10.1051/m2an/2011045). A truncated distribution, and one that has no classical family, gets a recurrence of its own.

        Parameters
        ----------
        marginal : Marginal
            The distribution, in SI.
        degree : int
            Largest degree.

        Returns
        -------
        OrthonormalFamily
            The polynomials.
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
            log = marginal.numpyro_parameters
            return cls("Hermite", 0 * n, np.sqrt(n[1:]), log["loc"] + np.log(unit), log["scale"], logarithmic=True)
        if marginal.family == "Gamma" and not truncated:
            shape, rate = marginal.numpyro_parameters["concentration"], marginal.numpyro_parameters["rate"]
            # Laguerre, weight x^α e^(−x), α = shape − 1: aₙ = 2n + α + 1, bₙ = √(n (n + α))
            return cls("Laguerre", 2 * n + shape, np.sqrt(n[1:] * (n[1:] + shape - 1)), 0.0, unit / rate)
        if marginal.family == "Beta" and not truncated:
            native = marginal.numpyro_parameters
            a, b = _jacobi_recurrence(native["concentration0"] - 1, native["concentration1"] - 1, degree)
            return cls("Jacobi", a, b, 0.5 * unit, 0.5 * unit)
        return cls._numerical(marginal, degree, logarithmic=marginal.family == "LogNormal")

    @classmethod
    def legendre(cls, low: float, high: float, degree: int) -> OrthonormalFamily:
        """Legendre polynomials, orthonormal under the uniform distribution of a range.

        Parameters
        ----------
        low, high : float
            The range.
        degree : int
            Largest degree.

        Returns
        -------
        OrthonormalFamily
            The polynomials.
        """
        n = np.arange(degree + 1, dtype=np.float64)
        # a = 0, bₙ = n/√(4n² − 1)
        return cls("Legendre", 0 * n, n[1:] / np.sqrt(4 * n[1:] ** 2 - 1), 0.5 * (low + high), 0.5 * (high - low))

    def expansion_of(self, other: OrthonormalFamily, degree: int, low: float, high: float) -> np.ndarray:
        """Coefficients in these polynomials of another family's, held at the edge beyond a range, by Gauss quadrature.

        Parameters
        ----------
        other : OrthonormalFamily
            Polynomials of the same variable: of the logarithm where this family takes one.
        degree : int
            Largest degree; this family's recurrence goes further, and gives the nodes.
        low, high : float
            The range.

        Returns
        -------
        ndarray, shape (degree + 1, degree + 1)
            Column n holds the coefficients of the other's polynomial of degree n.
        """
        # Golub & Welsch 1969: the nodes are eigenvalues of the Jacobi matrix, the weights squares of first components.
        jacobi = np.diag(self.a) + np.diag(self.b, 1) + np.diag(self.b, -1)
        nodes, vectors = np.linalg.eigh(jacobi)
        mine = np.array(self._recurrence(nodes, degree))
        theirs = np.array(other.evaluate(np.clip(nodes * self.scale + self.shift, low, high), degree))
        return (mine * vectors[0] ** 2) @ theirs.T

    @classmethod
    def standard_normal(cls, degree: int) -> OrthonormalFamily:
        """Hermite polynomials of a standard normal variable.

        Parameters
        ----------
        degree : int
            Largest degree.

        Returns
        -------
        OrthonormalFamily
            The polynomials.
        """
        return cls("Hermite", np.zeros(degree + 1), np.sqrt(np.arange(1.0, degree + 1)), 0.0, 1.0)

    @classmethod
    def _numerical(cls, marginal: Marginal, degree: int, logarithmic: bool) -> OrthonormalFamily:
        """Recurrence of the distribution that stands on the quadrature nodes of a marginal."""
        nodes, weights = scipy.special.roots_legendre(QUADRATURE_NODES)
        # p = sin²(φ) crowds the nodes towards both tails, where a quantile function is steep.
        angle = 0.25 * np.pi * (nodes + 1.0)
        x = marginal.quantile(np.sin(angle) ** 2)
        weight = 0.25 * np.pi * weights * np.sin(2 * angle)
        x = np.log(x) if logarithmic else x
        shift = float(weight @ x)
        scale = float(np.sqrt(weight @ (x - shift) ** 2))
        a, b = lanczos_recurrence((x - shift) / scale, weight / weight.sum(), degree)
        return cls("numerical", a, b, shift, scale, logarithmic)

    def evaluate(self, x: Any, degree: int) -> list[Any]:
        """Values of the polynomials.

        Parameters
        ----------
        x : ndarray or jax.Array, shape (run,)
            Where, in SI.
        degree : int
            Largest degree wanted.

        Returns
        -------
        list of array, shape (run,)
            p₀(x), p₁(x), … p_degree(x), of the kind `x` is.
        """
        numpy = namespace(x)
        return self._recurrence(((numpy.log(x) if self.logarithmic else x) - self.shift) / self.scale, degree)

    def _recurrence(self, t: Any, degree: int) -> list[Any]:
        """Values by the recurrence, at points of the polynomials' own variable."""
        values = [namespace(t).ones_like(t)]
        for n in range(degree):
            previous = self.b[n - 1] * values[n - 1] if n else 0.0
            values.append(((t - self.a[n]) * values[n] - previous) / self.b[n])
        return values


def namespace(x: Any) -> Any:
    """Return the module whose functions apply to an array.

    Parameters
    ----------
    x : ndarray or jax.Array
        The array.

    Returns
    -------
    module
        ``numpy`` or ``jax.numpy``.
    """
    if isinstance(x, (np.ndarray, np.generic, float, int)):
        return np
    from structid.device import jnp

    return jnp


def _truncation(marginal: Marginal) -> np.ndarray:
    """Bounds that cut something off a distribution; infinite where they do not."""
    low, high = marginal.base.support()
    cuts = np.array(
        [marginal.low if marginal.low > low else -np.inf, marginal.high if marginal.high < high else np.inf]
    )
    # A bound beyond which nothing lies, in double precision, is none.
    beyond = np.array([marginal.base.cdf(cuts[0]), marginal.base.sf(cuts[1])])
    return np.where(beyond < 1e-16, [-np.inf, np.inf], cuts)


def _jacobi_recurrence(alpha: float, beta: float, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Jacobi, weight (1 − x)^α (1 + x)^β on [−1, 1]; Gautschi 2004, table 1.1."""
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


def lanczos_recurrence(nodes: np.ndarray, weights: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Recurrence coefficients of the polynomials orthonormal on weighted nodes, by Lanczos' method.

    Tridiagonalises diag(nodes) from the start vector √weights, orthogonalising in full, which stays accurate where the
    procedure of Stieltjes does not (Gautschi 2004, section 2.2.3).

    Parameters
    ----------
    nodes, weights : ndarray, shape (node,)
        The distribution; positive weights that sum to 1.
    degree : int
        Largest degree; fewer than there are nodes.

    Returns
    -------
    tuple of ndarray
        a₀ … (degree + 1,) and b₁ … (degree,).
    """
    basis = np.zeros((degree + 1, len(nodes)))
    basis[0] = np.sqrt(weights)
    a, b = np.empty(degree + 1), np.empty(degree)
    for n in range(degree + 1):
        image = nodes * basis[n]
        a[n] = basis[n] @ image
        if n == degree:
            break
        for _ in range(2):  # twice is enough
            image = image - basis[: n + 1].T @ (basis[: n + 1] @ image)
        b[n] = np.linalg.norm(image)
        basis[n + 1] = image / b[n]
    return a, b


def multi_indices(
    dimension: int, degree: int, hyperbolic_norm: float = 1.0, interaction: int | None = None
) -> np.ndarray:
    """Degrees of the tensor products kept: ‖α‖_q ≤ p and at most r of the α non-zero (thesis eqs. 2.37, 2.38).

    Parameters
    ----------
    dimension : int
        Number of parameters.
    degree : int
        Largest total degree p.
    hyperbolic_norm : float
        q of the norm (Σ αᵢ^q)^(1/q), in (0, 1]; 1 keeps every product up to the degree.
    interaction : int, optional
        Most parameters r in one product.

    Returns
    -------
    ndarray of int, shape (term, parameter)
        Ordered by total degree, the constant first.
    """
    if not (0 < hyperbolic_norm <= 1):
        raise InputError("hyperbolic_norm", f"{hyperbolic_norm}", "a number in (0, 1]")
    if degree < 0 or int(degree) != degree:
        raise InputError("degree", f"{degree}", "a whole number, 0 or more")
    order = dimension if interaction is None else min(interaction, dimension)
    budget = degree**hyperbolic_norm * (1 + 1e-12)
    kept = [np.zeros((1, dimension), dtype=int)]
    for count in range(1, order + 1):
        degrees = _degrees_within(count, degree, hyperbolic_norm, budget)
        if len(degrees) == 0:
            break
        for places in itertools.combinations(range(dimension), count):
            block = np.zeros((len(degrees), dimension), dtype=int)
            block[:, places] = degrees
            kept.append(block)
        if sum(map(len, kept)) > LARGEST_BASIS:
            raise InputError(
                "degree",
                f"degree {degree} in {dimension} parameters, more than {LARGEST_BASIS} terms",
                "a smaller basis",
                "Lower the degree, hyperbolic_norm or interaction.",
            )
    indices = np.concatenate(kept)
    return indices[by_degree(indices)]


def by_degree(indices: np.ndarray) -> np.ndarray:
    """Order of multi-indices: by total degree, and then those of the first parameters first.

    Parameters
    ----------
    indices : ndarray of int, shape (term, parameter)
        Degrees.

    Returns
    -------
    ndarray of int, shape (term,)
        Places.
    """
    return np.lexsort((*(-indices.T[::-1]), indices.sum(axis=1)))


def _degrees_within(count: int, degree: int, q: float, budget: float) -> np.ndarray:
    """All `count` positive degrees with Σ αᵢ^q within the budget, shape (n, count)."""
    rows = np.zeros((1, 0), dtype=int)
    for _ in range(count):
        repeated = np.repeat(rows, degree, axis=0)
        added = np.tile(np.arange(1, degree + 1), len(rows))[:, None]
        rows = np.hstack([repeated, added])
        rows = rows[np.sum(rows.astype(float) ** q, axis=1) <= budget]
    return rows


@dataclass(frozen=True, eq=False)
class PolynomialBasis:
    """Tensor products of the orthonormal polynomials of a parameter space.

    Dependent parameters go through the isoprobabilistic transform to independent standard normal variables first.

    Parameters
    ----------
    space : ParameterSpace
        The parameters.
    indices : ndarray of int, shape (term, parameter)
        Degree of every parameter in every term.
    box : ndarray, shape (parameter, 2), optional
        Use Legendre polynomials on this range of each variable instead, which stay small all over it, and beyond it what they
        are at its edge. Of independent parameters the range is in SI, of lognormal ones that of the logarithm, of dependent ones
        in standard normal variables.
    """

    space: ParameterSpace
    indices: np.ndarray
    box: np.ndarray | None = None

    @cached_property
    def families(self) -> tuple[OrthonormalFamily, ...]:
        """The family of each parameter."""
        degrees = self.indices.max(axis=0, initial=0)
        if self.box is not None:
            return tuple(OrthonormalFamily.legendre(a, b, int(d)) for (a, b), d in zip(self.box, degrees, strict=True))
        return self.prior_families(degrees)

    def prior_families(self, degrees: np.ndarray) -> tuple[OrthonormalFamily, ...]:
        """Families orthonormal under the prior.

        Parameters
        ----------
        degrees : ndarray of int, shape (parameter,)
            Largest degree of each.

        Returns
        -------
        tuple of OrthonormalFamily
            One for each parameter.
        """
        if self.space.correlation is not None:
            return tuple(OrthonormalFamily.standard_normal(int(d)) for d in degrees)
        return tuple(
            OrthonormalFamily.of(m, int(d)) for m, d in zip(self.space.marginals.values(), degrees, strict=True)
        )

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, terms: Any) -> PolynomialBasis:
        """Some of the terms."""
        return PolynomialBasis(self.space, self.indices[terms], self.box)

    def evaluate(self, theta: Any) -> Any:
        """Values of every term.

        Parameters
        ----------
        theta : ndarray or jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        array, shape (run, term)
            Of the kind `theta` is.
        """
        numpy = namespace(theta)
        germ = self.variables(theta)
        degrees = self.indices.max(axis=0, initial=0)
        product = numpy.ones((theta.shape[0], len(self.indices)))
        for i, (family, degree) in enumerate(zip(self.families, degrees, strict=True)):
            if degree:
                values = numpy.stack(family.evaluate(germ[:, i], int(degree)), axis=1)
                product = product * values[:, self.indices[:, i]]
        return product

    def variables(self, theta: Any) -> Any:
        """Variables of the polynomials: the parameters, or independent standard normal ones made of them; see `box`.

        Parameters
        ----------
        theta : ndarray or jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        array, shape (run, parameter)
            Of the kind `theta` is.
        """
        if self.space.correlation is not None and self.box is None:
            return standard_normal(self.space, theta)
        if self.box is None:
            return theta
        return namespace(theta).clip(box_variables(self.space, theta), self.box[:, 0], self.box[:, 1])

    def to_prior(self, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients of the same function in the basis that is orthonormal under the prior.

        Parameters
        ----------
        coefficients : ndarray, shape (term, output)
            In this basis, whose indices hold every lower one of each.

        Returns
        -------
        ndarray, shape (term, output)
            Of the same indices.
        """
        if self.box is None:
            return coefficients
        degrees = self.indices.max(axis=0, initial=0)
        place = {tuple(index): row for row, index in enumerate(self.indices)}
        found = coefficients
        for i, (mine, prior) in enumerate(zip(self.families, self.prior_families(degrees + MORE_NODES), strict=True)):
            change = prior.expansion_of(mine, int(degrees[i]), *self.box[i])  # change[m, n] = E[p_m q_n]
            moved = np.zeros_like(found)
            for row, index in enumerate(self.indices):
                for lower in range(index[i] + 1):
                    target = place[(*index[:i], lower, *index[i + 1 :])]
                    moved[target] += change[lower, index[i]] * found[row]
            found = moved
        return found


def box_variables(space: ParameterSpace, theta: Any) -> Any:
    """Variables that polynomials on a box are made of: those of the prior's own, so that each can be written in the other.

    Parameters
    ----------
    space : ParameterSpace
        The parameters.
    theta : ndarray or jax.Array, shape (run, parameter)
        Points in SI.

    Returns
    -------
    array, shape (run, parameter)
        Standard normal variables of dependent parameters, logarithms of lognormal ones, the others as they are.
    """
    if space.correlation is not None:
        return standard_normal(space, theta)
    numpy = namespace(theta)
    logarithmic = [m.family == "LogNormal" for m in space.marginals.values()]
    columns = [numpy.log(theta[:, i]) if log else theta[:, i] for i, log in enumerate(logarithmic)]
    return numpy.stack(columns, axis=1)


def standard_normal(space: ParameterSpace, theta: Any) -> Any:
    """Isoprobabilistic (Nataf) transform to independent standard normal variables, ξ = L⁻¹ Φ⁻¹(F(θ)), L Lᵀ = R.

    Parameters
    ----------
    space : ParameterSpace
        The parameters and their prior.
    theta : ndarray or jax.Array, shape (run, parameter)
        Points in SI.

    Returns
    -------
    array, shape (run, parameter)
        Of the kind `theta` is; points at the edge of the support are kept finite.
    """
    correlation = np.eye(space.dimension) if space.correlation is None else space.correlation
    whitening = np.linalg.inv(np.linalg.cholesky(correlation))
    if isinstance(theta, np.ndarray):
        z = scipy.special.ndtri(np.clip(space.cdf(theta), 1e-15, 1 - 1e-15))
        return z @ whitening.T
    import jax.scipy.special as special

    from structid.device import jnp

    u = jnp.stack([m.jax_cdf(theta[..., i]) for i, m in enumerate(space.marginals.values())], axis=-1)
    return special.ndtri(jnp.clip(u, 1e-15, 1 - 1e-15)) @ whitening.T


def check_points(where: str, theta: Any, dimension: int, names: Sequence[str]) -> np.ndarray:
    """Return points as an array if they fit a space and are finite.

    Parameters
    ----------
    where : str
        The function, for the message.
    theta : array-like, shape (run, parameter)
        What came.
    dimension : int
        How many parameters there are.
    names : sequence of str
        Their names, for the message.

    Returns
    -------
    ndarray, shape (run, parameter)
        The points.

    Raises
    ------
    InputError
        If the shape is another, or a value is not finite.
    """
    points = np.asarray(theta, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != dimension:
        raise InputError(
            where, f"points of shape {points.shape}", f"(run, {dimension}) with the columns {', '.join(names)}"
        )
    if not np.isfinite(points).all():
        raise InputError(
            where, f"{np.count_nonzero(~np.isfinite(points).all(axis=1))} points that are not finite", "finite numbers"
        )
    return points
