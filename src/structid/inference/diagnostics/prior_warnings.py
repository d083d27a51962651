"""Marginals that lie on a bound of their prior, or far out in its tail."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.probability.space import ParameterSpace

BOUND_WIDTH = 0.02
"""The strip along a prior bound, as a fraction of the range between the prior's 5 and 95 % quantiles."""
BOUND_MASS = 0.2
"""A marginal is said to sit on the bound if it has at least this posterior mass in that strip."""
TAIL_PROBABILITY = 1e-3
"""A posterior median beyond this prior probability says that prior and data disagree."""
AT_BOUND_SDS, AT_BOUND_MASS = 0.25, 0.05
"""A bound cuts a marginal that has at least this mass within so many posterior standard deviations of it."""


class PriorWarning(NamedTuple):
    """A parameter of which prior and data disagree."""

    said: str  # Where they do
    cure: str  # What to do about it, as a sentence; empty where it may be well


def prior_warnings(space: ParameterSpace, draws_of_all: Float[np.ndarray, "draw parameter"]) -> list[PriorWarning]:
    """Say where prior and data disagree."""
    found = []
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
                said = f"the posterior of {name} sits on the {side} bound of its prior: {further}"
                cure = "" if at_zero else "Widen the prior if the structure may be beyond it, and run again."
                found.append(PriorWarning(said, cure))
        p = float(marginal.cdf(np.median(draws)))
        if min(p, 1.0 - p) < TAIL_PROBABILITY and not on_bound and not name.startswith("sigma2"):
            said = f"the posterior of {name} lies in the far tail of its prior (at probability {p:.1g}): prior and data disagree"
            found.append(PriorWarning(said, "Look whether the prior, the units or the model are right, and run again."))
    return found
