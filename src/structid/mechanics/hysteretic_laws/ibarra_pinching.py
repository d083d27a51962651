"""Modified Ibarra–Medina–Krawinkler law with pinched reloading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.engine.array_module import namespace
from structid.mechanics.hysteretic_laws.base import Memory, parameter
from structid.mechanics.hysteretic_laws.default_priors import between
from structid.mechanics.hysteretic_laws.ibarra_peak_oriented import IbarraPeakOriented


@dataclass(frozen=True, eq=False)
class IbarraPinching(IbarraPeakOriented):
    """`IbarraPeakOriented` whose reloading first passes a pinching point.

    From zero force at d_0, the path aims at the largest deformation (d_g, f_g) until the deformation (1 − κ_D) d_p, with the
    force lowered by κ_F. Here d_p = d_g − f_g/k_u is where unloading from there would end.
    """

    word: ClassVar[str] = "ibarra_pinching"
    title: ClassVar[str] = "modified Ibarra–Medina–Krawinkler law, pinching"
    use: ClassVar[str] = "timber walls, joints and shear-critical members up to collapse"
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "capping_displacement": 0.5,
        "capping_ratio": 1.3,
        "post_capping_displacement": 3.0,
        "pinching_force": 0.4,
        "pinching_displacement": 0.5,
    }
    opensees: ClassVar[str] = "IMKPinching: as IMKPeakOriented, then pinching_force, pinching_displacement"

    pinching_force: Any = parameter(
        "force of the pinching point, relative to the line to the peak, κ_F",
        between(0.0, 1.0),
        high=1.0,
        default=1.0,
        neutral=1.0,
        mechanism="pinching",
    )
    pinching_displacement: Any = parameter(
        "distance of the pinching point from the end of unloading, κ_D", between(0.0, 1.0), high=1.0, default=0.0
    )

    def _pinching(self, side: Memory, start: Any, unloading: Any) -> tuple[Any, Any, Any]:
        """Return the pinching point of a path, and whether the path passes it."""
        d = (1.0 - self.pinching_displacement) * (side["d_global"] - side["f_global"] / unloading)
        length = side["d_global"] - start
        to_global = (d - start) / namespace(start).where(length > 0.0, length, 1.0)
        return d, self.pinching_force * side["f_global"] * to_global, start < d
