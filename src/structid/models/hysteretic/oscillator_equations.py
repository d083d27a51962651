"""Equations of motion of the single-degree-of-freedom oscillator.

Equation numbers refer to the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.mechanics.hysteresis import Law, known
from structid.mechanics.hysteretic_system import HystereticSystem, State


class OscillatorEquations(HystereticSystem):
    """Equation u″ = −a_g − 2ζω u′ − α ω² u − (1 − α) ω² z, with only the state variables that a run needs."""

    def __init__(self, values: dict[str, Any], channels: tuple[str, ...], kind: str) -> None:
        law = Law(**{name: values[name] for name in Law._fields})
        super().__init__(law, values["mass"], values["stiffness"], kind, set(channels))
        self.values, self.channels = values, channels
        self.omega_squared = values["stiffness"] / values["mass"]
        self.viscous = self._viscous(self.omega_squared)
        self.driven = kind == "displacement"

    def _viscous(self, omega_squared: Any) -> Any:
        """Return c/m = 2 ζ ω."""
        if self.values["damping"] is not None:
            return self.values["damping"] / self.mass
        ratio = self.values["damping_ratio"]
        return 2.0 * (0.0 if ratio is None else ratio) * jnp.sqrt(omega_squared)

    def initial_state(self, like: Float[Array, " run"]) -> State:
        """Return the state at the first sample."""
        zero = jnp.zeros_like(like)
        state = {"z": zero + self.values["initial_hysteretic_displacement"]}
        if not self.driven:
            state["u"] = zero + self.values["initial_displacement"]
            state["v"] = zero + self.values["initial_velocity"]
        return self.with_energies(state, zero)

    def inputs(self, step: float) -> Callable[[Any], tuple[Any, Any, Any]]:
        """Return the function that maps the excitation at the start, middle and end of a step to the inputs of `rate`."""
        if not self.driven:
            return lambda stage: (stage[0], stage[1], stage[2])

        def displacement_and_velocity(stage: Any) -> tuple[Any, Any, Any]:
            # The displacement is the parabola through the three values, or a straight line if the record is linear there.
            a, b, c = stage[0], stage[1], stage[2]
            return (a, (-3 * a + 4 * b - c) / step), (b, (c - a) / step), (c, (a - 4 * b + 3 * c) / step)

        return displacement_and_velocity

    def kinematics(self, state: State, signal: Any) -> tuple[Any, Any]:
        """Return displacement and velocity, imposed or from the state; see `HystereticSystem.kinematics`."""
        imposed: tuple[Any, Any] = signal
        return imposed if self.driven else (state["u"], state["v"])

    def largest_square_of_frequency(self) -> Any:
        """Return ω²; see `HystereticSystem.largest_square_of_frequency`."""
        return 0.0 * self.omega_squared if self.driven else self.omega_squared

    def deformation(self, motion: Any) -> Any:
        """Return the motion of the mass, which deforms the spring; see `HystereticSystem.deformation`."""
        return motion

    def _force_per_mass(self, u: Any, z: Any) -> Any:
        # α ω² u + (1−α) ω² z                                                                     [3.13]
        return self.elastic * u + self.hysteretic * z

    def spring_force(self, deformation: Any, z: Any) -> Any:
        """Return the restoring force, with the offset of its measurement; see `HystereticSystem.spring_force`."""
        force = self.mass * self._force_per_mass(deformation, z)
        return force if known(self.values["force_offset"], 0.0) else force + self.values["force_offset"]

    def acceleration(self, u: Any, v: Any, z: Any, signal: Any) -> Any:
        """Return the acceleration of the mass; see `HystereticSystem.acceleration`."""
        # u″ = −a_g − 2ζω v − α ω² u − (1−α) ω² z, or f/m instead of −a_g                     [3.12]
        drive = signal / self.mass if self.kind == "force" else -signal
        return drive - self.viscous * v - self._force_per_mass(u, z)

    def observe(self, state: State, signal: Any) -> Float[Array, "channel run"]:
        """Return the channels at a sample."""
        zero = jnp.zeros_like(state["z"])  # all runs share an imposed motion
        return jnp.stack([self.channel(name, state, signal) + zero for name in self.channels])
