"""A hysteretic law of one's own: an elastic spring that stiffens."""

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, parameter
from structid.mechanics.hysteretic_laws.default_priors import up_to


@dataclass(frozen=True, eq=False)
class Cubic(HystereticLaw):
    """Force f = k d (1 + c d²)."""

    word: ClassVar[str] = "cubic"
    title: ClassVar[str] = "cubic spring"
    use: ClassVar[str] = "a trial"
    example: ClassVar[dict[str, float]] = {"stiffness": 10.0, "stiffening": 0.5}

    stiffening: Any = parameter("stiffening c", up_to(1.0), "1/m^2", default=0.0, neutral=0.0)

    def at_rest(self, zero: Any) -> Memory:
        return {"d": zero, "f": zero}

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        return {"d": deformation, "f": self.stiffness * deformation * (1.0 + self.stiffening * deformation**2)}
