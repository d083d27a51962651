"""Cycles of a quasi-static test: energy, stiffness, strength and equivalent damping of every cycle."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from structid.core.notebook import ShownAsText

SMALL_RANGE = 0.05
"""Range of a cycle, relative to the range so far, below which it is a reversal within the next cycle."""
CLOSED = 0.05
"""Distance of a cycle's end from its start, relative to its largest displacement, at which the last cycle is complete."""


@dataclass(frozen=True, eq=False)
class Cycles(ShownAsText):
    """Measures of the complete cycles of a test, in their order.

    Parameters
    ----------
    ends : ndarray of int, shape (cycle + 1,)
        First samples of the cycles, and the last sample of the last cycle.
    displacement : ndarray, shape (cycle, 2)
        Smallest and largest displacement [m].
    force : ndarray, shape (cycle, 2)
        Force at these displacements [N].
    strength : ndarray, shape (cycle, 2)
        Smallest and largest force [N].
    energy : ndarray, shape (cycle,)
        Dissipated energy, ∮ f du [J].

    Examples
    --------
    A linear spring dissipates nothing.

    >>> import numpy as np
    >>> import structid as si
    >>> u = 0.01 * np.sin(np.linspace(0.0, 4.0 * np.pi, 401))
    >>> cycles = si.CyclicTest(u, 2e6 * u).cycles
    >>> cycles.stiffness, np.abs(cycles.damping_ratio) < 1e-12
    (array([2000000., 2000000.]), array([ True,  True]))
    """

    ends: np.ndarray = field(repr=False)
    displacement: np.ndarray = field(repr=False)
    force: np.ndarray = field(repr=False)
    strength: np.ndarray = field(repr=False)
    energy: np.ndarray = field(repr=False)

    @property
    def amplitude(self) -> Float[np.ndarray, " cycle"]:
        """Half the range of the displacement [m]."""
        return np.asarray(0.5 * np.diff(self.displacement, axis=1)[:, 0])

    @property
    def stiffness(self) -> Float[np.ndarray, " cycle"]:
        """Secant stiffness between the two ends of every cycle [N/m]."""
        return np.asarray((np.diff(self.force, axis=1) / np.diff(self.displacement, axis=1))[:, 0])

    @property
    def damping_ratio(self) -> Float[np.ndarray, " cycle"]:
        """Equivalent viscous damping ratio ζ = E/(2π k a²), with stiffness k and amplitude a (Jacobsen 1930)."""
        return np.asarray(self.energy / (2.0 * np.pi * self.stiffness * self.amplitude**2))

    def __str__(self) -> str:
        lines = ["cycle  amplitude [mm]  strength [kN]    stiffness [kN/mm]  energy [kJ]  damping ratio"]
        for i in range(len(self.energy)):
            low, high = 1e-3 * self.strength[i]
            lines.append(
                f"{i + 1:5d}{1e3 * self.amplitude[i]:16.4g}  {low:7.4g} {high:7.4g}{1e-6 * self.stiffness[i]:18.4g}"
                f"{1e-3 * self.energy[i]:13.4g}{self.damping_ratio[i]:15.1%}"
            )
        return "\n".join(lines)


def cumulative_displacement(displacement: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """Return the sum of all moves so far [m]."""
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(displacement)))])


def cycles_along(
    displacement: Float[np.ndarray, " time"], force: Float[np.ndarray, " time"], ends: Int[np.ndarray, " end"]
) -> Cycles:
    """Return the measures of the cycles between given samples."""
    parts = [slice(start, end + 1) for start, end in pairwise(ends)]
    at = np.array([[s.start + displacement[s].argmin(), s.start + displacement[s].argmax()] for s in parts], dtype=int)
    at = at.reshape(-1, 2)
    strength = np.array([[force[s].min(), force[s].max()] for s in parts]).reshape(-1, 2)
    energy = np.array([np.trapezoid(force[s], displacement[s]) for s in parts])
    return Cycles(ends, displacement[at], force[at], strength, energy)


def cycle_ends(
    displacement: Float[np.ndarray, " time"], turns: Int[np.ndarray, " turn"], two_sided: bool
) -> Int[np.ndarray, " end"]:
    """Return the samples at which the cycles of a test begin, and the end of the last complete one.

    In a test in two directions, a cycle begins where the displacement passes zero in the direction of the first loading. A small
    reversal near zero begins none. In a test in one direction, a cycle begins at a turning point near zero.
    """
    if not len(turns):
        return np.zeros(1, dtype=int)
    loading = np.sign(displacement[turns[0]] - displacement[0])
    u, last = loading * displacement, len(displacement) - 1
    marks = np.concatenate([turns, [last]])
    ends = [0]
    for low, high in zip(marks[1::2], marks[2::2], strict=False):
        # from a trough to the next peak
        if not two_sided:
            ends.append(int(low))
        elif u[low] < 0.0 <= u[high]:
            ends.append(int(low + np.argmax(u[low : high + 1] >= 0.0)))
    gap = abs(u[last] - u[ends[-1]])
    if gap <= CLOSED * np.abs(u[ends[-1] :]).max() and (turns > ends[-1]).any():
        ends.append(last)
    return np.array(_without_small(u, ends), dtype=int)


def _without_small(u: Float[np.ndarray, " time"], ends: list[int]) -> list[int]:
    """Return the ends of cycles, where a small cycle is a part of the next one."""
    kept = ends[:1]
    for end in ends[1:]:
        if np.ptp(u[kept[-1] : end + 1]) > SMALL_RANGE * np.ptp(u[: end + 1]):
            kept.append(end)
    return kept
