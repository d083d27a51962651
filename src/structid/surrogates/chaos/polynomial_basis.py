"""Truncated tensor products of the orthonormal polynomials of a parameter space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from structid.core.arrays import Array
from structid.engine.array_module import namespace
from structid.probability.space import ParameterSpace
from structid.surrogates.chaos.isoprobabilistic_transform import standard_normal
from structid.surrogates.chaos.orthogonal_polynomials import OrthonormalFamily

MORE_NODES = 60
"""Number of quadrature nodes in addition to the degree, for functions that are constant outside a range."""


@dataclass(frozen=True, eq=False)
class PolynomialBasis:
    """Tensor products of the orthonormal polynomials of a parameter space.

    Dependent parameters are first transformed to independent standard normal variables.
    """

    space: ParameterSpace  # The parameters
    indices: Int[np.ndarray, "term parameter"]  # Degree of every parameter in every term
    # If given, the basis has Legendre polynomials on this range of each variable, which are small in the whole range.
    # Outside the range they keep their value at the edge. Units of the range: SI for an independent parameter, the
    # logarithm for a lognormal parameter, standard normal variables for dependent parameters
    box: Float[np.ndarray, "parameter 2"] | None = None

    @cached_property
    def families(self) -> tuple[OrthonormalFamily, ...]:
        """Polynomial family of each parameter."""
        degrees = self.indices.max(axis=0, initial=0)
        if self.box is not None:
            return tuple(OrthonormalFamily.legendre(a, b, int(d)) for (a, b), d in zip(self.box, degrees, strict=True))
        return self.prior_families(degrees)

    def prior_families(self, degrees: Int[np.ndarray, " parameter"]) -> tuple[OrthonormalFamily, ...]:
        """Return the families that are orthonormal under the prior."""
        if self.space.correlation is not None:
            return tuple(OrthonormalFamily.standard_normal(int(d)) for d in degrees)
        return tuple(
            OrthonormalFamily.of(m, int(d)) for m, d in zip(self.space.marginals.values(), degrees, strict=True)
        )

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, terms: Any) -> PolynomialBasis:
        """Return the basis with selected terms."""
        return PolynomialBasis(self.space, self.indices[terms], self.box)

    def evaluate(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run term"]:
        """Evaluate every term."""
        numpy = namespace(theta)
        germ = self.variables(theta)
        degrees = self.indices.max(axis=0, initial=0)
        product = numpy.ones((theta.shape[0], len(self.indices)))
        if not degrees.any():
            return product
        for i, (family, degree) in enumerate(zip(self.families, degrees, strict=True)):
            if degree:
                values = numpy.stack(family.evaluate(germ[:, i], int(degree)), axis=1)
                product = product * values[:, self.indices[:, i]]
        return product

    def variables(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run parameter"]:
        """Return the variables of the polynomials, which are the parameters or their transformation; see `box`."""
        if self.space.correlation is not None and self.box is None:
            return standard_normal(self.space, theta)
        if self.box is None:
            return theta
        return namespace(theta).clip(box_variables(self.space, theta), self.box[:, 0], self.box[:, 1])

    def to_prior(self, coefficients: Float[np.ndarray, "term output"]) -> Float[np.ndarray, "term output"]:
        """Convert the coefficients of a function to the basis that is orthonormal under the prior."""
        if self.box is None:
            return coefficients
        degrees = self.indices.max(axis=0, initial=0)
        row_of_index = {tuple(index): row for row, index in enumerate(self.indices)}
        converted = coefficients
        for i, (mine, prior) in enumerate(zip(self.families, self.prior_families(degrees + MORE_NODES), strict=True)):
            change = prior.expansion_of(mine, int(degrees[i]), *self.box[i])  # change[m, n] = E[p_m q_n]
            next_coefficients = np.zeros_like(converted)
            for row, index in enumerate(self.indices):
                for lower in range(index[i] + 1):
                    target = row_of_index[(*index[:i], lower, *index[i + 1 :])]
                    next_coefficients[target] += change[lower, index[i]] * converted[row]
            converted = next_coefficients
        return converted


def box_variables(space: ParameterSpace, theta: Float[Array, "run parameter"]) -> Float[Array, "run parameter"]:
    """Return the variables of a `box`: standard normal if correlated, logarithms if lognormal, otherwise SI values."""
    if space.correlation is not None:
        return standard_normal(space, theta)
    numpy = namespace(theta)
    logarithmic = [m.family == "LogNormal" for m in space.marginals.values()]
    columns = [numpy.log(theta[:, i]) if log else theta[:, i] for i, log in enumerate(logarithmic)]
    return numpy.stack(columns, axis=1)
