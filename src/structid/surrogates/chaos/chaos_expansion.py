"""A fitted polynomial chaos expansion: values, moments, Sobol' indices and bootstrap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.core.streams import Purpose, stream
from structid.probability.space import ParameterSpace
from structid.surrogates.chaos.polynomial_basis import PolynomialBasis


@dataclass(frozen=True, eq=False)
class ChaosExpansion:
    """A fitted polynomial chaos expansion of one or many outputs."""

    word: ClassVar[str] = "ChaosExpansion"
    basis: PolynomialBasis  # Terms used by any output
    coefficients: Float[np.ndarray, "term output"]  # Zero for terms that an output does not use
    # Corrected leave-one-out error relative to the variance of the output
    leave_one_out_error: Float[np.ndarray, " output"]
    truncation: tuple[tuple[int, float], ...]  # Selected degree and hyperbolic norm of each output
    theta: Float[np.ndarray, "run parameter"]  # Training points in SI
    outputs: Float[np.ndarray, "run output"]  # Training outputs

    @property
    def terms(self) -> np.ndarray:
        """Number of terms of each output, shape (output,)."""
        return np.asarray(np.count_nonzero(self.coefficients, axis=0))

    @property
    def mean(self) -> np.ndarray:
        """Mean of each output under the prior, the coefficient of the constant term, shape (output,)."""
        return np.asarray(self.prior_coefficients[self._constant].sum(axis=0))

    @cached_property
    def prior_coefficients(self) -> np.ndarray:
        """Coefficients (term, output) of polynomials orthonormal under the prior; they give moments and Sobol' indices."""
        return self.basis.to_prior(self.coefficients)

    @property
    def variance(self) -> np.ndarray:
        """Variance of each output under the prior, Σ_{α≠0} c_α², shape (output,)."""
        return np.asarray(np.sum(self.prior_coefficients[~self._constant] ** 2, axis=0))

    @property
    def _constant(self) -> np.ndarray:
        return np.asarray(~self.basis.indices.any(axis=1))

    def predict(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run output"]:
        """Predict the outputs."""
        return self.basis.evaluate(theta) @ self.coefficients

    def deviation(self, theta: Float[Array, "run parameter"]) -> None:
        """Return None: an expansion has no error estimate that varies with the point; see `Regression.deviation`."""

    def predict_with_deviation(self, theta: Float[Array, "run parameter"]) -> tuple[Any, None]:
        """Predict the outputs; there are no standard deviations; see `Regression.predict_with_deviation`."""
        return self.predict(theta), None

    def sobol_indices(self, order: int | Literal["total"] = 1) -> Float[np.ndarray, "*parameter output"]:
        """Compute Sobol' indices, which are fractions of the variance (Sudret 2008, doi 10.1016/j.ress.2007.04.002)."""
        if order not in (1, 2, "total"):
            raise InputError("sobol_indices: order", f"{order!r}", '1, 2 or "total"')
        if self.basis.space.correlation is not None:
            raise InputError("sobol_indices", "correlated parameters", "independent parameters", "Change the prior.")
        used = self.basis.indices > 0
        share = self.prior_coefficients**2 / self.variance
        count = used.sum(axis=1)
        if order == 2:
            pairs = used[count == 2].astype(float)
            indices = np.einsum("ti,tj,to->ijo", pairs, pairs, share[count == 2])
            indices[np.arange(used.shape[1]), np.arange(used.shape[1])] = 0.0
            return np.asarray(indices)
        keep = used & (count == 1)[:, None] if order == 1 else used
        return np.asarray(keep.T.astype(float) @ share)

    def bootstrap(self, replicates: int, seed: int) -> Float[np.ndarray, "replicate term output"]:
        """Refit the coefficients of the selected terms to runs drawn with replacement (Efron 1979)."""
        if self.basis.box is not None:
            raise InputError(
                "bootstrap",
                "an expansion whose coefficients shrink with the degree",
                "an expansion by another method",
                "Use another method, since this one has too many terms for least squares.",
            )
        rng = stream(seed, Purpose.BOOTSTRAP)
        columns = self.basis.evaluate(self.theta)
        coefficients = np.zeros((replicates, *self.coefficients.shape))
        for r in range(replicates):
            rows = rng.integers(len(columns), size=len(columns))
            for k in range(self.coefficients.shape[1]):
                active = np.flatnonzero(self.coefficients[:, k])
                drawn = columns[np.ix_(rows, active)]
                coefficients[r, active, k] = np.linalg.lstsq(drawn, self.outputs[rows, k], rcond=None)[0]
        return coefficients

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the contents of the expansion, without its parameter space, for a file."""
        arrays = {
            "indices": self.basis.indices,
            **({} if self.basis.box is None else {"box": self.basis.box}),
            "coefficients": self.coefficients,
            "leave_one_out_error": self.leave_one_out_error,
            "truncation": np.array(self.truncation, dtype=np.float64),
            "theta": self.theta,
            "outputs": self.outputs,
        }
        return {}, arrays

    @classmethod
    def from_plain(
        cls, space: ParameterSpace, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> ChaosExpansion:
        """Rebuild an expansion from the result of `to_plain`."""
        return cls(
            PolynomialBasis(space, arrays["indices"], arrays.get("box")),
            arrays["coefficients"],
            arrays["leave_one_out_error"],
            tuple((int(d), float(q)) for d, q in arrays["truncation"]),
            arrays["theta"],
            arrays["outputs"],
        )

    def __str__(self) -> str:
        degrees = sorted({d for d, _ in self.truncation})
        return (
            f"polynomial chaos of {self.basis.space.dimension} parameters, {self.coefficients.shape[1]} outputs: "
            f"{len(self.basis)} terms, degrees {degrees[0]} to {degrees[-1]}, "
            f"leave-one-out error up to {self.leave_one_out_error.max():.1e}"
        )
