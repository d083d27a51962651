"""Linear elastic spring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory


@dataclass(frozen=True, eq=False)
class Linear(HystereticLaw):
    """Force f = k d."""

    word: ClassVar[str] = "linear"
    title: ClassVar[str] = "linear spring"
    use: ClassVar[str] = "storeys and springs that stay elastic"
    source: ClassVar[str] = ""
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
    }
    opensees: ClassVar[str] = "Elastic tag, stiffness"

    def at_rest(self, zero: Any) -> Memory:
        """Return deformation and force; see `HystereticLaw.at_rest`."""
        return {"d": zero, "f": zero}

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`."""
        return {"d": deformation, "f": self.stiffness * deformation}
