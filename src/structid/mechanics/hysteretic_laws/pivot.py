"""Pivot law of reinforced concrete and masonry members."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.engine.array_module import namespace
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, parameter
from structid.mechanics.hysteretic_laws.default_priors import ASYMMETRY, HARDENING, STRENGTH, around, between


@dataclass(frozen=True, eq=False)
class Pivot(HystereticLaw):
    """Bilinear backbone; unloading aims at a primary pivot, reloading passes a pinching pivot.

    The pivots lie on the elastic line, of slope k through the origin. Unloading from positive forces aims at the force −α F_y
    on this line until the force is zero. Loading then aims at the force −β F_y on this line, from there at the largest
    negative deformation on the backbone, and follows the backbone beyond it. Negative forces are mirrored.
    """

    word: ClassVar[str] = "pivot"
    title: ClassVar[str] = "Pivot law"
    use: ClassVar[str] = "reinforced concrete and masonry members, with pinching"
    source: ClassVar[str] = "Dowell, Seible & Wilson (1998)"
    dissipative: ClassVar[bool] = False
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "hardening": 0.05,
        "primary": 4.0,
        "pinching": 0.4,
        "asymmetry": 0.9,
    }

    yield_force: Any = parameter("yield force F_y", STRENGTH, "N")
    hardening: Any = parameter(
        "stiffness after yielding, relative to the initial stiffness, r",
        HARDENING,
        high=1.0,
        default=0.0,
        neutral=0.0,
        mechanism="hardening",
    )
    primary: Any = parameter("force of the primary pivot, relative to F_y, α", around(5.0, 5.0), default=10.0)
    pinching: Any = parameter(
        "force of the pinching pivot, relative to F_y, β",
        between(0.0, 1.0),
        high=1.0,
        default=1.0,
        neutral=1.0,
        mechanism="pinching",
    )
    asymmetry: Any = parameter(
        "negative yield force, relative to the positive one, ρ",
        ASYMMETRY,
        default=1.0,
        neutral=1.0,
        mechanism="asymmetric strength",
    )

    def at_rest(self, zero: Any) -> Memory:
        """Return deformation, force and, for each side, peak and start of the reloading path; see `HystereticLaw.at_rest`."""
        u_y = self.yield_force / self.stiffness + 0.0 * zero
        return {
            "d": zero,
            "f": zero,
            "peak_positive": u_y,
            "peak_negative": self.asymmetry * u_y,
            # Deformation at which the force was last zero, from where the reloading path of a side starts
            "start_positive": zero,
            "start_negative": zero,
            # Deformation up to which this path has been followed, which unloading leaves behind
            "reached_positive": zero,
            "reached_negative": zero,
        }

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`. All of it is mirrored so that the move is in the positive direction."""
        xp = namespace(deformation)
        positive = deformation >= memory["d"]
        sign = xp.where(positive, 1.0, -1.0)
        d, f, to = sign * memory["d"], sign * memory["f"], sign * deformation
        u_y = self.yield_force / self.stiffness
        ahead = u_y * xp.where(positive, 1.0, self.asymmetry)
        behind = u_y * xp.where(positive, self.asymmetry, 1.0)
        peak = xp.where(positive, memory["peak_positive"], memory["peak_negative"])
        start = xp.where(positive, memory["start_positive"], sign * memory["start_negative"])
        reached = xp.where(positive, memory["reached_positive"], sign * memory["reached_negative"])
        # Below zero force the line aims at the pivot behind; it crosses zero force at `crossing`.
        unloading = self._slope_to_pivot(-d, -f, behind)
        crossing = d - f / unloading
        crosses = (f < 0.0) & (to >= crossing)
        start = xp.where(crosses, crossing, xp.where(f == 0.0, xp.where(d == 0.0, start, d), start))
        # Within a side a move upwards retraces the unloading line of this side until it meets the reloading path.
        retraces = (f > 0.0) & (to < reached)
        retraced = f + self._slope_to_pivot(d, f, ahead) * (to - d)
        unloads = (f < 0.0) & (to < crossing)
        loads = ~(retraces | unloads)
        on_path = xp.where(retraces, retraced, self._reloading(to, start, peak, ahead))
        force = xp.where(unloads, f + unloading * (to - d), on_path)
        reached = xp.where(loads, to, reached)
        peak = xp.where(loads, xp.maximum(peak, to), peak)
        return {
            "d": deformation,
            "f": sign * force,
            "peak_positive": xp.where(positive, peak, memory["peak_positive"]),
            "peak_negative": xp.where(positive, memory["peak_negative"], peak),
            "start_positive": xp.where(positive, start, memory["start_positive"]),
            "start_negative": xp.where(positive, memory["start_negative"], sign * start),
            "reached_positive": xp.where(positive, reached, memory["reached_positive"]),
            "reached_negative": xp.where(positive, memory["reached_negative"], sign * reached),
        }

    def _slope_to_pivot(self, d: Any, f: Any, u_y: Any) -> Any:
        """Return the slope of the line from a point of the positive side to the primary pivot; at most the initial stiffness."""
        xp = namespace(d)
        distance = d + self.primary * u_y
        before = distance > 0.0
        slope = (f + self.primary * self.stiffness * u_y) / xp.where(before, distance, 1.0)
        return xp.where(before, xp.minimum(slope, self.stiffness), self.stiffness)

    def _reloading(self, d: Any, start: Any, peak: Any, u_y: Any) -> Any:
        """Return the force of the path from zero force at `start` over the pinching pivot and the peak to the backbone."""
        xp = namespace(d)
        backbone = self.stiffness * (u_y + self.hardening * (xp.maximum(d, peak) - u_y))
        at_peak = self.stiffness * (u_y + self.hardening * (peak - u_y))
        pinched_d, pinched_f = self.pinching * u_y, self.stiffness * self.pinching * u_y
        pinched = start < pinched_d
        from_d, from_f = xp.where(pinched, pinched_d, start), xp.where(pinched, pinched_f, 0.0)
        to_pivot = pinched_f * (d - start) / xp.where(pinched, pinched_d - start, 1.0)
        to_peak = from_f + (at_peak - from_f) * (d - from_d) / xp.where(peak > from_d, peak - from_d, 1.0)
        return xp.where(d >= peak, backbone, xp.where(pinched & (d < pinched_d), to_pivot, to_peak))
