"""Short names for the default priors of hysteretic laws, in units of the test."""

from __future__ import annotations

import math

from structid.probability.marginals import LogNormal, Normal, Uniform
from structid.probability.truncation import Marginal

NORMAL_95 = 1.645
"""95 % quantile of the standard normal distribution."""


def around(median: float, factor: float, low: float | None = None, high: float | None = None) -> Marginal:
    """Return a lognormal prior with 90 % between the median divided by a factor and the median times the factor."""
    return LogNormal(log_mean=math.log(median), log_sd=math.log(factor) / NORMAL_95, low=low, high=high)


def up_to(largest: float, high: float | None = None) -> Marginal:
    """Return a half-normal prior from zero, with 90 % below a value; its density is largest at zero, where the term is absent."""
    return Normal(0.0, largest / NORMAL_95, low=0.0, high=high)


def near_zero(spread: float) -> Marginal:
    """Return a normal prior about zero, with 90 % within ± a value."""
    return Normal(0.0, spread / NORMAL_95)


def between(low: float, high: float) -> Marginal:
    """Return a uniform prior."""
    return Uniform(low, high)


STIFFNESS = around(1.0, 3.0)
"""Initial stiffness, relative to the initial stiffness of the test."""
STRENGTH = around(0.8, 2.0)
"""Yield force, relative to the largest force of the test."""
HARDENING = up_to(0.2, high=1.0)
"""Stiffness after yielding, relative to the initial stiffness."""
ASYMMETRY = around(1.0, 1.4)
"""Strength under negative forces, relative to the strength under positive forces."""
STIFFNESS_OF_BACKBONE = around(1.5, 4.0)
"""Initial stiffness of a backbone that bends from the first deformation on."""
STRENGTH_OF_BACKBONE = around(1.5, 4.0)
"""Strength that a bending backbone approaches, before damage, relative to the largest force of the test."""
SHARPNESS = around(1.0, 4.0, low=0.2, high=30.0)
"""Exponent N of the backbone x/(1 + x^N)^(1/N)."""
PEAK_DAMAGE = up_to(0.6)
"""Loss of strength per peak ductility."""
ENERGY_DAMAGE = up_to(0.3)
"""Loss of strength per energy of the yield force and the yield displacement."""


def scaled(prior: Marginal, scale: float, unit: str) -> Marginal:
    """Return a default prior for a test, from the scale of the test in a unit."""
    low, high = (scale * bound if math.isfinite(bound) else None for bound in (prior.low, prior.high))
    loc, spread = prior.parameters.get("loc", 0.0), prior.parameters.get("scale", 1.0)
    match prior.family:
        case "LogNormal":
            return LogNormal(log_mean=loc + math.log(scale), log_sd=spread, low=low, high=high, unit=unit)
        case "Normal":
            return Normal(scale * loc, scale * spread, low=low, high=high, unit=unit)
        case _:
            ends = prior.support
            return Uniform(scale * ends[0], scale * ends[1], unit=unit)
