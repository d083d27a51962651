"""Test by Stein's identity whether draws follow a density that is known only at the draws.

Over draws from a density q, the gradient of log q averages to 0, and its product with the distance from the mean to −1:

E_q[∂ log q/∂z_j] = 0,    E_q[z_j ∂ log q/∂z_j] = −1

(C. Stein 1972, Proc. 6th Berkeley Symp. 2, 583–602; as a test of samples J. Gorham & L. Mackey 2015, Advances in Neural
Information Processing Systems 28). Both identities follow from integration by parts if q falls to zero. If the draws end where q
is not zero, the boundary term is missing. Draws that lack a part of q, or come from an unconverged chain, are therefore detected
from q at the draws alone. A mode far from all draws is not detected.

The gradients come from Kriging surrogates that interpolate log q between a few hundred draws.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from structid.certification.external.drawn_density import DrawnDensity
from structid.certification.external.kriged_density import (
    CORRELATIONS,
    KrigedDensity,
    in_parameters,
    normal_by,
    standardised_by,
)
from structid.inference.convergence import standard_error

INTERPOLATED = 200
"""Largest number of draws that a Kriging surrogate interpolates. Two surrogates fitted to different draws give an
estimate of their error."""
COMPARED = 3000
"""Approximate limit on the number of draws over which gradients are averaged."""
SLOPE, SPREAD = 0.1, 0.2
"""Accepted deviations of the averages from 0 and −1, in addition to their errors. For a normal distribution, they correspond to
errors of 0.1 standard deviations in the mean and of 10 % in the standard deviation."""
TELLING = 0.4
"""Error of the first average above which the test is undecided: half a normal distribution has an average of 0.48."""
ERRORS = 3.0
"""Number of standard errors allowed for an average."""
STEP = 1e-3
"""Step of a difference quotient, in standard deviations."""


class _Averages(NamedTuple):
    """E[∂ log q/∂z_j] and −E[z_j ∂ log q/∂z_j] over the draws, each with its error, shape (parameter,)."""

    slope: np.ndarray
    slope_error: np.ndarray
    spread: np.ndarray
    spread_error: np.ndarray


def not_its_draws(drawn: DrawnDensity, rng: np.random.Generator) -> tuple[str, ...]:
    """Explain, by Stein's identity, why the draws do not follow the given density; empty if no contradiction is found."""
    averages = _averages(drawn, rng)
    slope = np.abs(averages.slope) - averages.slope_error - SLOPE
    spread = np.abs(averages.spread - 1.0) - averages.spread_error - SPREAD
    if max(slope.max(), spread.max()) <= 0.0:
        return _undecided(float(averages.slope_error.max()))
    if slope.max() >= spread.max():
        worst = int(np.argmax(slope))
        finding = f"the gradient of log q must average to 0, not {averages.slope[worst]:+.2f}"
    else:
        worst = int(np.argmax(spread))
        finding = f"the gradient of log q times (x − mean) must average to -1, not {-averages.spread[worst]:.2f}"
    return (
        f"these are not draws of the given density q: {finding} along {drawn.posterior.names[worst]}, in standard "
        "deviations (Stein's identity). The draws lack a part of q, or their chain has not converged",
    )


def _undecided(error: float) -> tuple[str, ...]:
    if error <= TELLING:
        return ()
    return (
        "the values of the given density at the draws cannot decide whether the draws follow it: the error of the average "
        f"gradient is {error:.2g}, while half a normal density has an average of 0.48 (Stein's identity). Give the density as "
        "a function, or more draws",
    )


def _averages(drawn: DrawnDensity, rng: np.random.Generator) -> _Averages:
    values = drawn.at_draws + drawn.bijection(drawn.phi)[1]
    krigings, off = _interpolated(drawn, values, rng)
    chains = drawn.in_order(drawn.phi)[:, :: max(1, len(drawn.phi) // COMPARED)]
    root = _symmetric_root(drawn.phi)
    z = (chains - drawn.phi.mean(axis=0)) @ np.linalg.inv(root)
    slopes = [_slope(kriged, chains.reshape(-1, len(root)), root).reshape(z.shape) for kriged in krigings]
    first, second = ((s.mean(axis=(0, 1)), -(z * s).mean(axis=(0, 1))) for s in slopes)
    # An error e of the Kriging adds E[z e] and E[(z² − 1) e] for normal draws, at most its standard deviation and √2 times that.
    by_chance = [
        [standard_error(x[..., j].T[:, :, None]) for j in range(len(root))] for x in (slopes[0], z * slopes[0])
    ]
    return _Averages(
        0.5 * (first[0] + second[0]),
        ERRORS * np.array(by_chance[0]) + np.abs(first[0] - second[0]) + off,
        0.5 * (first[1] + second[1]),
        ERRORS * np.array(by_chance[1]) + np.abs(first[1] - second[1]) + np.sqrt(2.0) * off,
    )


def _interpolated(
    drawn: DrawnDensity, values: np.ndarray, rng: np.random.Generator
) -> tuple[list[KrigedDensity], float]:
    """Two Kriging surrogates of log q, and the root mean square of their errors at draws they have not used [nat]."""
    rows = drawn.distinct(3 * INTERPOLATED, rng)
    first, second, unseen = np.array_split(rows, 3)
    charts = [in_parameters(drawn.bijection, drawn.flat), standardised_by(drawn.phi), normal_by(drawn.fitted)]
    forms = [(chart, correlation) for chart in charts for correlation in CORRELATIONS]
    best = KrigedDensity.best(forms, drawn.phi[first], values[first], np.ones(len(first)))
    other = KrigedDensity.fitted(best.chart, best.correlation, drawn.phi[second], values[second], best.kriging)
    errors = [kriged.at(drawn.phi[unseen])[0] - values[unseen] for kriged in (best, other)]
    return [best, other], float(np.sqrt(np.mean(np.square(errors))))


def _slope(kriged: KrigedDensity, phi: np.ndarray, root: np.ndarray) -> np.ndarray:
    """∂ log q/∂z at φ = μ + root z, (point, parameter)."""
    steps = STEP * root.T
    ahead, behind = (np.stack([kriged.at(phi + sign * step)[0] for step in steps], axis=1) for sign in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * STEP))


def _symmetric_root(phi: np.ndarray) -> np.ndarray:
    """Return the symmetric root of the covariance, whose coordinates are closest to the parameters themselves."""
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(phi.T)))
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)
