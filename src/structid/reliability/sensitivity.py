"""Sensitivity of a response quantity: Sobol' indices from a polynomial chaos expansion in the coordinates of a space."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.notebook import ShownAsText
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace
from structid.reliability.passage_probability import coordinate_names, coordinates_of
from structid.surrogates.chaos.pce import PCE
from structid.surrogates.in_coordinates import fitted_in_coordinates
from structid.surrogates.regression import Regression

POINTS = 4096
"""Size of each of the two samples whose columns are exchanged; a power of 2."""
RESAMPLES = 199
"""Number of resamples for the intervals of the indices. SciPy's bootstrap also computes a jackknife over all points, which takes
twenty times as long."""
BINS = 64
"""Number of bins of equal probability, along one coordinate, for the conditional mean."""


@dataclass(frozen=True, eq=False)
class Sensitivity(ShownAsText):
    """Sobol' indices: fractions of the variance of a quantity that the parameters explain.

    Parameters
    ----------
    names : tuple of str
        Names of the parameters.
    first, total : ndarray, shape (parameter,)
        S_i = V[E(y | θ_i)] / V[y] and T_i = E[V(y | θ_~i)] / V[y].
    first_error, total_error : ndarray, shape (parameter,)
        Half-widths of the 95 % intervals of these indices, by resampling.
    coordinates : tuple of str
        Names of the coordinates.
    alone : ndarray, shape (coordinate,)
        V[E(y | x_i)] / V[y] of each coordinate. Coordinates that share a parameter are dependent, so these fractions may sum to
        more than 1.
    left_out : float
        Fraction of the variance that the expansion does not explain, by its leave-one-out error.
    regression : Regression
        The polynomial chaos expansion.
    """

    names: tuple[str, ...]
    first: Float[np.ndarray, " parameter"]
    total: Float[np.ndarray, " parameter"]
    first_error: Float[np.ndarray, " parameter"]
    total_error: Float[np.ndarray, " parameter"]
    coordinates: tuple[str, ...]
    alone: Float[np.ndarray, " coordinate"]
    left_out: float
    regression: Regression = field(repr=False)

    def __str__(self) -> str:
        lines = [f"Sobol' indices; the expansion does not explain {self.left_out:.1%} of the variance"]
        for name, first, total in zip(self.names, self.first, self.total, strict=True):
            lines.append(f"  {name:<24} first {max(first, 0.0):6.3f}   total {max(total, 0.0):6.3f}")
        for name, alone in zip(self.coordinates, self.alone, strict=True):
            lines.append(f"  {name:<24} alone {alone:6.3f}")
        return "\n".join(lines)


@check_arguments
def sensitivity(design: Design, values: np.ndarray, settings: PCE | None = None, seed: int = 0) -> Sensitivity:
    """Compute the Sobol' indices of a quantity, which measure its dependence on each parameter.

    Parameters
    ----------
    design : Design
        Design points with independent parameters. The expansion uses the coordinates of the space, if it has any.
    values : ndarray, shape (run,)
        Value of the quantity in each run; NaN for a run without a value.
    settings : PCE, optional
        Settings of the expansion; default: sparse, up to degree 8.
    seed : int
        Seed of the samples.

    Returns
    -------
    Sensitivity
        Indices by the estimators of Saltelli et al. (2010, doi 10.1016/j.cpc.2009.09.018), applied to the expansion.

    Raises
    ------
    InputError
        If the parameters are correlated: these indices are defined for independent parameters only.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> space = si.ParameterSpace(a=si.Uniform(0.0, 1.0), b=si.Uniform(0.0, 1.0))
    >>> design = space.sample(64, seed=1)
    >>> indices = si.sensitivity(design, design.values[:, 0] + 2.0 * design.values[:, 1])
    >>> np.round(indices.first, 2)
    array([0.2, 0.8])
    """
    space: ParameterSpace = design.space
    if space.correlation is not None:
        raise InputError(
            "sensitivity", "correlated parameters", "independent parameters", "Use a prior without correlation."
        )
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (len(design.values),):
        raise InputError(
            "sensitivity(values)",
            f"an array of shape {values.shape} for {len(design.values)} runs",
            f"shape ({len(design.values)},): one value for each run",
            "Give NaN for a run without a value.",
        )
    finite = np.flatnonzero(np.isfinite(values))
    chosen = PCE(degree=tuple(range(1, 9))) if settings is None else settings
    fitted = fitted_in_coordinates(design[finite], lambda points: chosen.fit(points, values[finite]))

    def predicted(theta: np.ndarray) -> np.ndarray:
        return np.asarray(fitted.predict(np.asarray(theta)))[:, 0]

    rng = stream(seed, Purpose.SENSITIVITY)
    first, total, first_error, total_error = _sobol_indices(predicted, space, rng)
    theta = space.from_uniform(rng.uniform(size=(4 * POINTS, space.dimension)))
    value, coordinates = predicted(theta), coordinates_of(space, theta)
    alone = np.array([_alone(column, value) for column in coordinates.T])
    return Sensitivity(
        space.names,
        first,
        total,
        first_error,
        total_error,
        coordinate_names(space),
        alone,
        float(fitted.leave_one_out_error[0]),
        fitted,
    )


def _sobol_indices(
    predicted: Callable[[np.ndarray], np.ndarray], space: ParameterSpace, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """First-order and total indices, and the half-widths of their 95 % intervals; every array has shape (parameter,)."""
    if space.dimension == 1:  # the only parameter explains all of the variance; SciPy's estimator needs two
        return np.ones(1), np.ones(1), np.zeros(1), np.zeros(1)
    # Two independent samples A and B, and for each parameter a copy of A with the column of that parameter from B.
    sample = scipy.stats.qmc.Sobol(2 * space.dimension, bits=64, rng=rng).random(POINTS)
    a, b = np.split(sample, 2, axis=1)
    mixed = [np.where(np.arange(space.dimension) == k, b, a) for k in range(space.dimension)]
    of_a, of_b, *of_mixed = (predicted(space.from_uniform(u)) for u in (a, b, *mixed))
    responses = {"f_A": of_a[None], "f_B": of_b[None], "f_AB": np.array(of_mixed)[:, None]}
    first, total = _of_responses(responses)
    again = [_of_responses(responses, rows) for rows in rng.integers(POINTS, size=(RESAMPLES, POINTS))]
    first_error, total_error = 1.96 * np.std(again, axis=0, ddof=1)
    return first, total, first_error, total_error


def _of_responses(
    responses: dict[str, np.ndarray], rows: np.ndarray | slice = slice(None)
) -> tuple[np.ndarray, np.ndarray]:
    """First-order and total indices from some rows of the samples; both arrays have shape (parameter,)."""
    chosen = {name: values[..., rows] for name, values in responses.items()}
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # SciPy warns about an index that is 0 in every resample
        indices = scipy.stats.sobol_indices(func=chosen, n=POINTS)
    return np.ravel(indices.first_order), np.ravel(indices.total_order)


def _alone(column: Any, value: np.ndarray) -> float:
    """V[E(y | x)] / V[y] from means over bins of equal probability, corrected for the scatter within the bins."""
    parts = np.array_split(value[np.argsort(column)], BINS)
    means = np.array([part.mean() for part in parts])
    noise = np.mean([part.var(ddof=1) / len(part) for part in parts])
    return float(max(means.var() - noise, 0.0) / value.var())
