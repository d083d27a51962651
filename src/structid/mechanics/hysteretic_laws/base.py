"""Interface of hysteretic laws: parameters with units and default priors, and the force along a path of deformations."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from structid.engine.array_module import namespace
from structid.mechanics.hysteretic_laws.default_priors import STIFFNESS
from structid.probability.truncation import Marginal

Memory = dict[str, Any]
"""State of springs: deformation ``d`` [m], force ``f`` [N] and the law's own variables; arrays (spring, run), (run,) or numbers."""


class LawParameter(NamedTuple):
    """Description of one parameter of a hysteretic law."""

    meaning: str  # what the parameter is, with its symbol
    unit: str  # SI unit
    low: float  # physically possible values, including both ends
    high: float
    # Default prior, in units of the test: stiffness, force and displacement relative to the initial stiffness, the largest
    # force and the largest displacement of the test; None for a parameter that keeps its default unless it is named free
    prior: Marginal | None
    default: float | None  # value of a parameter that is not given; None for a parameter without which there is no law
    neutral: float | None  # value at which the parameter has no effect; None if there is none
    mechanism: str = ""  # what a test shows if the parameter is not neutral, such as "pinching"


def parameter(
    meaning: str,
    prior: Marginal | None,
    unit: str = "",
    *,
    low: float = 0.0,
    high: float = np.inf,
    default: float | None = None,
    neutral: float | None = None,
    mechanism: str = "",
) -> Any:
    """Declare a field of a law as a parameter."""
    described = LawParameter(meaning, unit, low, high, prior, default, neutral, mechanism)
    return dataclasses.field(default=default, metadata={"parameter": described})


@dataclass(frozen=True, eq=False)
class HystereticLaw(ABC):
    """Force of a spring as a function of its deformation history; rate independent.

    The fields of a law are its parameters. A field is a number, None for a free parameter, or, inside a simulation, an array
    (run,) or (spring, run).
    """

    word: ClassVar[str]
    """Name in study files."""
    title: ClassVar[str]
    """Name in reports."""
    use: ClassVar[str]
    """What the law is for, in one sentence."""
    source: ClassVar[str] = ""
    """Publication."""
    example: ClassVar[dict[str, float]]
    """Typical values of the parameters, for forces and deformations of about 1 in any units."""
    opensees: ClassVar[str] = ""
    """The same law in OpenSees: the material, and its arguments in their order by the names used here."""
    accurate_move: ClassVar[float] = np.inf
    """Longest move of a cyclic test in one step, relative to the largest deformation of the test; inf for a law whose force is
    exact for a monotonic move of any length."""
    dissipative: ClassVar[bool] = True
    """Whether a closed cycle can never produce energy."""

    stiffness: Any = parameter("initial stiffness k", STIFFNESS, "N/m")

    @classmethod
    def parameters(cls) -> dict[str, LawParameter]:
        """Return the description of every parameter by name."""
        return {f.name: f.metadata["parameter"] for f in dataclasses.fields(cls) if "parameter" in f.metadata}

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with other values of some parameters."""
        return dataclasses.replace(self, **values)

    def prepare(self, zero: Any) -> Any:
        """Return numbers that depend on the parameters only; a loop over time computes them once, before it starts.

        `zero` has the shape of a deformation.
        """
        return ()

    @abstractmethod
    def at_rest(self, zero: Any) -> Memory:
        """Return the state of springs that have never moved; `zero` has the shape of a deformation."""

    @abstractmethod
    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Return the state after a monotonic move to another deformation."""

    def forces_along(self, path: np.ndarray) -> np.ndarray:
        """Return the force of one spring, or of one for each run, at every deformation of a path (time,) or (time, run)."""
        zero = 0.0 * np.asarray(path[0])
        memory, prepared, forces = self.at_rest(zero), self.prepare(zero), []
        for deformation in path:
            memory = self.moved(prepared, memory, np.asarray(deformation))
            forces.append(memory["f"])
        return np.array(forces)

    def longest_move(self) -> Any:
        """Return the length of a move above which the force is wrong [m]; inf for a law without such a length."""
        return np.inf


def clip(value: Any, low: Any, high: Any) -> Any:
    """Limit a value to a range; the order of the operations is that of compiled code."""
    xp = namespace(value)
    return xp.minimum(xp.maximum(value, low), high)
