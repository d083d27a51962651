"""Warnings about marginals at a bound of their prior, or far out in its tail."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.probability.space import ParameterSpace

BOUND_WIDTH = 0.02
"""Width of the strip along a prior bound, relative to the range between the prior's 5 and 95 % quantiles."""
BOUND_MASS = 0.2
"""Posterior mass in that strip above which a marginal is at the bound."""
TAIL_PROBABILITY = 1e-3
"""Prior probability beyond which a posterior median indicates that prior and data disagree."""
AT_BOUND_SDS, AT_BOUND_MASS = 0.25, 0.05
"""A bound truncates a marginal with at least this mass within this many posterior standard deviations of it."""


class PriorWarning(NamedTuple):
    """A parameter on which prior and data disagree."""

    said: str  # the disagreement
    cure: str  # what to do, as a sentence; empty where it may be harmless


def prior_warnings(space: ParameterSpace, draws_of_all: Float[np.ndarray, "draw parameter"]) -> list[PriorWarning]:
    """Find where prior and data disagree."""
    warnings = []
    for i, (name, marginal) in enumerate(space.marginals.items()):
        draws, on_bound = draws_of_all[:, i], False
        strip = BOUND_WIDTH * float(np.diff(marginal.quantile(np.array([0.05, 0.95])))[0])
        for side, bound in zip(("lower", "upper"), marginal.support, strict=True):
            distance = np.abs(draws - bound)
            # A posterior that is narrow and close to the bound falls off towards it; one that the bound cuts does not.
            cut = (
                np.mean(distance < strip) > BOUND_MASS
                and np.mean(distance < AT_BOUND_SDS * draws.std()) > AT_BOUND_MASS
            )
            # A small error variance is a good fit, not a bound that binds.
            if cut and not (side == "lower" and name.startswith("sigma2")):
                on_bound = True
                # Zero is mostly what physics allows, and a good answer.
                at_zero = side == "lower" and bound == 0.0
                further = (
                    "the data show nothing of it, or would go below zero" if at_zero else "the data would go further"
                )
                sentence = f"the posterior of {name} sits on the {side} bound of its prior: {further}"
                cure = "" if at_zero else "Widen the prior if the structure may be beyond it, and run again."
                warnings.append(PriorWarning(sentence, cure))
        p = float(marginal.cdf(np.median(draws)))
        if min(p, 1.0 - p) < TAIL_PROBABILITY and not on_bound and not name.startswith("sigma2"):
            where = f"in the far tail of its prior (at probability {p:.1g})"
            sentence = f"the posterior of {name} lies {where}: prior and data disagree"
            warnings.append(
                PriorWarning(sentence, "Look whether the prior, the units or the model are right, and run again.")
            )
    return warnings
