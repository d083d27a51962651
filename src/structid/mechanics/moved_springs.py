"""Bouc-Wen-Baber-Noori springs that are moved by displacements, as in a quasi-static test: no time, no inertia.

Numbers in brackets, such as [3.4], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.array_module import namespace
from structid.mechanics.hysteresis import Law, hysteretic_rate
from structid.mechanics.runge_kutta import runge_kutta_4

State = dict[str, Any]
"""``z``, and ``e_h`` per mass; arrays (spring,) or (spring, run)."""
NEWTON_ITERATIONS = 4
"""Towards the place where z = 0. A straight line is the first guess, so that every digit is there after three."""


def moved(law: Law, hysteretic: Any, state: State, change: Any) -> State:
    """Move springs of deformation d by Δ: z and e_h along d + s Δ, 0 ≤ s ≤ 1, by one Runge-Kutta step.

        dz/ds = law(Δ, z, e_h),    de_h/ds = (1 − α) k/m z Δ                            [3.4, 3.14]

    The law has a kink at z = 0 where its exponent is 1, which would cost a step its order. A move that crosses it is therefore
    split there.

    Parameters
    ----------
    law : Law
        Of the springs.
    hysteretic : float or array
        (1 − α) k/m [1/s²].
    state : dict
        Before the move.
    change : array
        Δ [m].

    Returns
    -------
    dict
        After it.
    """
    before = state["z"]
    xp = namespace(before)

    def rate(state: State, velocity: Any) -> State:
        z = state["z"]
        return {"z": hysteretic_rate(velocity, z, state["e_h"], law), "e_h": hysteretic * z * velocity}

    def along(state: State, share: Any) -> State:
        after: State = runge_kutta_4(rate, state, (change, change, change), share)
        return after

    whole = along(state, 1.0)
    crosses = crosses_zero(before, whole["z"])
    if isinstance(crosses, np.ndarray) and not crosses.any():
        return whole
    share = xp.where(crosses, before / xp.where(crosses, before - whole["z"], 1.0), 1.0)
    for _ in range(NEWTON_ITERATIONS):
        there = along(state, share)
        slope = xp.where(crosses, rate(there, change)["z"], 1.0)
        share = xp.where(crosses, xp.clip(share - there["z"] / slope, 0.0, 1.0), 1.0)
    return along(along(state, share), 1.0 - share)


def crosses_zero(before: Any, after: Any) -> Any:
    """Whether z passes the kink of the law on its way.

    Parameters
    ----------
    before, after : array
        z at both ends [m].

    Returns
    -------
    array of bool
        False where it begins or ends there.
    """
    return before * after < 0.0
