"""Warnings about posterior marginals at a bound or in the far tail of their prior."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.probability.space import ParameterSpace

BOUND_WIDTH = 0.02
"""Width of the strip along a prior bound, relative to the range between the prior's 5 and 95 % quantiles."""
BOUND_MASS = 0.2
"""Posterior mass in the strip along a prior bound above which a marginal counts as being at the bound."""
TAIL_PROBABILITY = 1e-3
"""Prior tail probability at the posterior median below which prior and data disagree."""
AT_BOUND_SDS, AT_BOUND_MASS = 0.25, 0.05
"""A bound truncates a marginal if at least this mass lies within this many posterior standard deviations of the bound."""


class PriorWarning(NamedTuple):
    """A parameter on which prior and data disagree."""

    said: str  # the disagreement
    cure: str  # advice, as a sentence; empty if the disagreement may be harmless


def prior_warnings(space: ParameterSpace, draws_of_all: Float[np.ndarray, "draw parameter"]) -> list[PriorWarning]:
    """Find the parameters for which prior and data disagree."""
    warnings = []
    for i, (name, marginal) in enumerate(space.marginals.items()):
        draws, on_bound = draws_of_all[:, i], False
        strip = BOUND_WIDTH * float(np.diff(marginal.quantile(np.array([0.05, 0.95])))[0])
        for side, bound in zip(("lower", "upper"), marginal.support, strict=True):
            distance = np.abs(draws - bound)
            # A narrow posterior close to the bound decreases towards it; a truncated posterior does not.
            cut = (
                np.mean(distance < strip) > BOUND_MASS
                and np.mean(distance < AT_BOUND_SDS * draws.std()) > AT_BOUND_MASS
            )
            # A small error variance indicates a good fit, not a restrictive bound.
            if cut and not (side == "lower" and name.startswith("sigma2")):
                on_bound = True
                # Zero is usually a physical limit and a plausible value.
                at_zero = side == "lower" and bound == 0.0
                further = "the data favour zero, or values below it" if at_zero else "the data favour values beyond it"
                sentence = f"the posterior of {name} lies at the {side} bound of its prior: {further}"
                cure = "" if at_zero else "Widen the prior if values beyond it are possible, and run again."
                warnings.append(PriorWarning(sentence, cure))
        p = float(marginal.cdf(np.median(draws)))
        if min(p, 1.0 - p) < TAIL_PROBABILITY and not on_bound and not name.startswith("sigma2"):
            where = f"in the far tail of its prior (tail probability {min(p, 1.0 - p):.1g})"
            sentence = f"the posterior of {name} lies {where}: prior and data disagree"
            warnings.append(PriorWarning(sentence, "Check the prior, the units and the model, and run again."))
    return warnings
