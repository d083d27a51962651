"""Truncated support: checks of the model where a given density is zero.

Samplers that classify points can exclude parts of the parameter space. The ratio π/q of a model run in such a part is infinite.
If π is low there and falls on the path from the draws, little of π is missing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy

from structid.certification.external.drawn_density import DrawnDensity
from structid.certification.fresh_draws import FreshDraws
from structid.certification.known_points import Points
from structid.certification.limits import Limits

FOLLOWED = 10
"""Largest number of excluded points from which the path to the draws is examined."""
ON_THE_WAY = (1.0 / 3.0, 2.0 / 3.0)
"""Positions on that path."""
VALLEY = 1.0
"""Depth of log π on the path, below its value at the excluded point, that counts as a valley [nat]."""


def with_what_is_excluded(
    drawn: DrawnDensity, fresh: FreshDraws, runs: Points, run: Callable[[np.ndarray], np.ndarray], limits: Limits
) -> tuple[FreshDraws, tuple[str, ...]]:
    """Allow for the fraction of π that may lie where q is zero.

    If a fraction δ of π is missing and q is right elsewhere, dq/dπ = 1/(1 − δ) in the support of q, so that means are shifted by
    at most √(δ/(1 − δ)) standard deviations. For a normal distribution truncated h nats below its highest density,
    δ = P(χ²_d > 2h). This estimate holds for the mode of the draws. A valley between it and an excluded point indicates
    another mode.
    """
    theta, log_true = runs
    highest = fresh.log_true.max(initial=-np.inf)
    outside = np.isfinite(log_true) & (log_true >= max(highest, log_true.max(initial=-np.inf)) - limits.reach)
    outside[outside] = ~np.isfinite(drawn.log_density(theta[outside])) if outside.any() else False
    if not (outside.any() and np.isfinite(highest)):
        return fresh, ()
    depth = max(float(highest - log_true[outside].max()), 0.0)
    missing = float(scipy.stats.chi2.sf(2.0 * depth, theta.shape[1]))
    if missing > limits.mean**2 / (1.0 + limits.mean**2):
        return replace(fresh, missing=missing), (
            f"the given density ends where the posterior is still high: at an excluded point, the model's log density is only "
            f"{depth:.2g} nats below its maximum. A normal density truncated there would lack {missing:.0%} of its mass",
        )
    return replace(fresh, missing=missing), _valleys(drawn, (theta[outside], log_true[outside]), run)


def _valleys(drawn: DrawnDensity, beyond: Points, run: Callable[[np.ndarray], np.ndarray]) -> tuple[str, ...]:
    """Search for valleys on the paths from excluded points to the draws."""
    theta, log_true = beyond
    if len(theta) > FOLLOWED:
        return (f"the given density excludes {len(theta)} relevant model runs, and only {FOLLOWED} can be checked",)
    ways = _ways(drawn, theta)
    result = run(ways.reshape(-1, theta.shape[1])).reshape(ways.shape[:2])
    divided = int((result.min(axis=0) < log_true - VALLEY).sum())
    if not divided:
        return ()
    return (
        f"a valley of the posterior separates the draws from {divided} of {len(theta)} model runs that the given density excludes: "
        "the given density may lack a mode there",
    )


def _ways(drawn: DrawnDensity, theta: np.ndarray) -> np.ndarray:
    """Points on straight paths, in unconstrained coordinates, to the nearest draws: (position, path, parameter), in SI."""
    phi, sd = drawn.bijection.inverse(theta), drawn.phi.std(axis=0)
    nearest = scipy.spatial.KDTree(drawn.phi / sd).query(phi / sd)[1]
    ways = np.stack([(1.0 - position) * phi + position * drawn.phi[nearest] for position in ON_THE_WAY])
    return drawn.bijection(ways.reshape(-1, phi.shape[1]))[0].reshape(ways.shape)
