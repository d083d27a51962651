"""Equations of an oscillator on a spring with any hysteretic law."""

from __future__ import annotations

from typing import Any

from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.engine.time_loop import State, all_finite
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory
from structid.mechanics.spring_motion import SpringMotion, short_enough


class LawOscillator(SpringMotion):
    """Equation m u″ = −m a_g − c u′ − f(u), or with a force in place of −m a_g; arrays have the shape (run,)."""

    def __init__(
        self, law: HystereticLaw, values: dict[str, Any], channels: tuple[str, ...], kind: str, like: Any
    ) -> None:
        self.law, self.channels, self.kind = law, channels, kind
        self.mass, self.offset, self.like = values["mass"], values["force_offset"], 0.0 * like
        self.prepared = law.prepare(self.like)
        self.viscous = None if kind == "displacement" else self._viscous(values)

    def _viscous(self, values: dict[str, Any]) -> Any:
        """Return c/m, or 2 ζ ω of the initial stiffness."""
        if values["damping"] is not None:
            return values["damping"] / self.mass
        ratio = 0.0 if values["damping_ratio"] is None else values["damping_ratio"]
        return 2.0 * ratio * jnp.sqrt(self.law.stiffness / self.mass)

    def at_rest(self) -> tuple[State, Any, Any]:
        """Return the spring, displacement and velocity at rest; see `SpringMotion.at_rest`."""
        return self.law.at_rest(self.like), self.like, self.like

    def moved(self, springs: Memory, deformation: Float[Array, " run"]) -> Memory:
        """Move the spring; see `SpringMotion.moved`."""
        return self.law.moved(self.prepared, springs, deformation)

    def force(self, springs: Memory) -> Float[Array, " run"]:
        """Return the force of the law, without the constant offset; see `SpringMotion.force`."""
        return springs["f"]

    def deformation(self, motion: Any) -> Any:
        """Return the motion of the mass, which deforms the spring; see `SpringMotion.deformation`."""
        return motion

    def acceleration(self, u: Any, v: Any, force: Any, signal: Any) -> Any:
        """Return the acceleration of the mass; see `SpringMotion.acceleration`."""
        drive = signal / self.mass if self.kind == "force" else -signal
        return drive - self.viscous * v - force / self.mass

    def usable(self, state: State, step: float) -> Any:
        """Return the accurate runs; see `SpringMotion.usable`."""
        omega_squared = 0.0 if self.kind == "displacement" else self.law.stiffness / self.mass
        followed = short_enough(state["longest"], self.law.longest_move(), omega_squared + self.like, step)
        return followed & all_finite({"force": self.force(state["springs"]), "u": state["u"], "v": state["v"]})

    def observe(self, state: State, signal: Any) -> Float[Array, "channel run"]:
        """Return the channels at a sample; see `SpringMotion.observe`."""
        return jnp.stack([self._channel(name, state, signal) + self.like for name in self.channels])

    def _channel(self, name: str, state: State, signal: Any) -> Any:
        u, v, force = state["u"], state["v"], self.force(state["springs"])
        match name:
            case "displacement":
                return u
            case "velocity":
                return signal if self.kind == "displacement" else v
            case "restoring_force":
                return force + self.offset
            case "absorbed_energy":
                return state["work"]
            case "relative_acceleration":
                return self.acceleration(u, v, force, signal)
            case _:
                ground = signal if self.kind == "ground_motion" else 0.0
                return self.acceleration(u, v, force, signal) + ground
