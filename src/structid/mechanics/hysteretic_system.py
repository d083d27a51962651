"""Equations of masses on hysteretic springs: the state, its time derivative, the channels.

Equation numbers refer to the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from structid.engine.array_module import namespace
from structid.mechanics.hysteresis import LONGEST_STEP, Law, degrades, hysteretic_rate, known, law_rate
from structid.mechanics.runge_kutta import Watch

State = dict[str, Any]
"""State: ``u``, ``v``, ``z`` and, if needed, the energies ``e_h``, ``e_e`` per mass; arrays (run,) or (mass, run)."""


class HystereticSystem(ABC):
    """Masses with u″ = a(u, u′, z, x) and springs with z′ = law(d′, z, e_h), under a signal x; d is a spring's deformation.

    Each spring belongs to a mass. The energies per mass are

    e_h′ = (1 − α) k/m z d′,     e_e′ = α k/m d d′                                       [3.14, 3.15]

    The integration includes only energies that the law or a recorded channel needs.
    """

    def __init__(self, law: Law, mass: Any, stiffness: Any, kind: str, recorded: set[str]) -> None:
        self.law, self.mass, self.kind = law, mass, kind
        # Constant products are computed once, not at every stage of every step.
        per_mass = stiffness / mass
        self.elastic = law.alpha * per_mass
        self.hysteretic = (1.0 - law.alpha) * per_mass
        self.needs_hysteretic_energy = degrades(law) or bool(recorded & {"hysteretic_energy", "absorbed_energy"})
        self.needs_elastic_energy = bool(recorded & {"elastic_energy", "absorbed_energy"})

    @abstractmethod
    def deformation(self, motion: Any) -> Any:
        """Compute the deformation of every spring, or its rate, from the motion of the masses."""

    @abstractmethod
    def spring_force(self, deformation: Any, z: Any) -> Any:
        """Restoring force k [α d + (1 − α) z] of every spring [N]."""

    @abstractmethod
    def acceleration(self, u: Any, v: Any, z: Any, signal: Any) -> Any:
        """Acceleration u″ of the masses, relative to the base."""

    def kinematics(self, state: State, signal: Any) -> tuple[Any, Any]:
        """Return the displacements and velocities of the masses."""
        return state["u"], state["v"]

    def with_energies(self, state: State, zero: Any) -> State:
        """Add the required energies to an initial state."""
        if self.needs_hysteretic_energy:
            state["e_h"] = zero
        if self.needs_elastic_energy:
            state["e_e"] = zero
        return state

    def rate(self, state: State, signal: Any) -> State:
        """Return the time derivative of every part of the state."""
        u, v = self.kinematics(state, signal)
        z, deformation_rate = state["z"], self.deformation(v)
        slope = {"z": hysteretic_rate(deformation_rate, z, state.get("e_h"), self.law)}
        if "u" in state:
            slope["u"], slope["v"] = v, self.acceleration(u, v, z, signal)
        if self.needs_hysteretic_energy:
            slope["e_h"] = self.hysteretic * z * deformation_rate  # [3.14]
        if self.needs_elastic_energy:
            slope["e_e"] = self.elastic * self.deformation(u) * deformation_rate  # [3.15]
        return slope

    @abstractmethod
    def largest_square_of_frequency(self) -> Any:
        """Upper bound of ω² of the undamped modes with the initial stiffness [1/s²]; zero for imposed motion."""

    def watch(self, zero: Any) -> Watch:
        """Monitor whether the integration steps are short enough for the springs."""
        start = {"rate": zero} if known(self.law.exponent, 1.0) else {"rate": zero, "z": zero}

        def seen(watched: State, state: State, signal: Any) -> State:
            xp = namespace(state["z"])
            largest = {"rate": self.deformation(self.kinematics(state, signal)[1]), "z": state["z"]}
            return {name: xp.maximum(value, xp.abs(largest[name])) for name, value in watched.items()}

        def followed(state: State, watched: State, step: Any) -> Any:
            xp = namespace(state["z"])
            rate = law_rate(watched["rate"], watched.get("z"), state.get("e_h"), self.law)
            length = step * xp.maximum(rate, xp.sqrt(self.largest_square_of_frequency()))
            # The length is NaN if any value was not finite; the comparison is then false.
            good = length <= LONGEST_STEP
            return good if good.ndim == 1 else good.all(axis=0)

        return Watch(start, seen, followed)

    def channel(self, name: str, state: State, signal: Any) -> Any:
        """Return the value of one channel."""
        u, v = self.kinematics(state, signal)
        z = state["z"]
        match name:
            case "displacement":
                return u
            case "velocity":
                return v
            case "relative_acceleration":
                return self.acceleration(u, v, z, signal)
            case "absolute_acceleration":
                moving_base = signal if self.kind == "ground_motion" else 0.0
                return self.acceleration(u, v, z, signal) + moving_base
            case "drift":
                return self.deformation(u)
            case "restoring_force":
                return self.spring_force(self.deformation(u), z)
            case "hysteretic_displacement":
                return z
            case "hysteretic_energy":
                return self.mass * state["e_h"]
            case "elastic_energy":
                return self.mass * state["e_e"]
            case _:
                return self.mass * (state["e_h"] + state["e_e"])
