"""Bouc-Wen-Baber-Noori springs under imposed displacements, as in a quasi-static test without inertia.

Numbers in brackets, such as [3.4], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.engine.array_module import namespace
from structid.mechanics.hysteresis import LONGEST_STEP, Law, hysteretic_rate, law_rate
from structid.mechanics.runge_kutta import runge_kutta_4

State = dict[str, Any]
"""State of springs: ``z``, and ``e_h`` per mass; arrays (spring,) or (spring, run)."""
SHORT_STEP = 0.25
"""Length of the pieces into which a large displacement increment is divided, relative to the characteristic length."""
MOST_PIECES = 1000
"""Largest number of pieces of a displacement increment. It allows 250 characteristic lengths, several metres for a
storey; only a diverging run has larger increments."""
NEWTON_ITERATIONS = 4
"""Newton iterations for the point where z = 0; after a linear first guess, three are exact to the last digit."""


def moved(law: Law, hysteretic: Any, state: State, change: Any) -> State:
    """Deform springs from d to d + Δ: one Runge-Kutta step for z and e_h along d + s Δ, 0 ≤ s ≤ 1.

    dz/ds = law(Δ, z, e_h),    de_h/ds = (1 − α) k/m z Δ                            [3.4, 3.14]

    For an exponent of 1 the law has a kink at z = 0, which would reduce the order of accuracy. An increment that
    crosses the kink is therefore split there.
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


def followed_by(law: Law, hysteretic: Any, state: State, change: Any) -> tuple[State, Any]:
    """Deform springs by an increment, and report whether the increment is small enough for accurate Runge-Kutta steps.

    Outside JAX an increment that is too large is divided into at most `MOST_PIECES` pieces. Inside JAX the number of
    pieces must not depend on the parameters, so an increment that is too large is only reported.
    """
    xp = namespace(state["z"])
    if xp is np:
        pieces = _pieces(law, state, change)
        if not pieces <= MOST_PIECES:
            return moved(law, hysteretic, state, change), False
        for _ in range(int(pieces)):
            state = moved(law, hysteretic, state, change / pieces)
        return state, True
    after = moved(law, hysteretic, state, change)
    length = law_rate(change, xp.maximum(xp.abs(state["z"]), xp.abs(after["z"])), after["e_h"], law)
    followed = length <= LONGEST_STEP
    return after, followed if followed.ndim == 0 else followed.all(axis=0)


def _pieces(law: Law, state: State, change: Any) -> float:
    """Return the number of pieces of an increment: one, unless it exceeds `LONGEST_STEP` at the largest possible z.

    The number is infinite or NaN for an unbounded increment.
    """
    largest = np.abs(state["z"]) + law.amplitude * np.abs(change)
    both = law.beta + law.gamma
    bounded = np.asarray(both) > 0.0
    ultimate = (law.amplitude / np.where(bounded, both, 1.0)) ** (1.0 / np.asarray(law.exponent))
    ultimate = ultimate * np.maximum(law.asymmetry, 1.0)
    largest = np.where(bounded, np.minimum(largest, np.maximum(ultimate, np.abs(state["z"]))), largest)
    length = float(np.max(law_rate(change, largest, state["e_h"], law), initial=0.0))
    return 1 if length <= LONGEST_STEP else float(np.ceil(length / SHORT_STEP))


def crosses_zero(before: Any, after: Any) -> Any:
    """Whether z crosses zero, the kink of the law."""
    return before * after < 0.0
