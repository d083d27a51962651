"""Equations of a shear frame whose storeys are springs with hysteretic laws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.engine.time_loop import State, all_finite
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.spring_motion import SpringMotion, short_enough
from structid.models.hysteretic.frame_equations import viscous_matrices


class LawFrame(SpringMotion):
    """Equations m_j u_j″ = −m_j a_g − (C u′)_j − f_j + f_(j+1); motions have the shape (storey, run)."""

    def __init__(
        self,
        laws: Sequence[HystereticLaw],
        mass: Float[Array, "storey run"],
        damping: Any,
        rayleigh_mode: int,
        damping_ratio: Any,
        channels: tuple[str, ...],
        kind: str,
    ) -> None:
        self.laws, self.mass, self.channels, self.kind = laws, mass, channels, kind
        self.zero = 0.0 * mass
        self.prepared = [law.prepare(self.zero[0]) for law in laws]
        self.stiffness = jnp.stack([law.stiffness + self.zero[0] for law in laws])
        self.viscous = viscous_matrices(mass, self.stiffness, damping, rayleigh_mode, damping_ratio)

    def at_rest(self) -> tuple[State, Any, Any]:
        """Return springs, displacements and velocities at rest; see `SpringMotion.at_rest`."""
        return {str(j): law.at_rest(self.zero[0]) for j, law in enumerate(self.laws)}, self.zero, self.zero

    def moved(self, springs: State, deformation: Float[Array, "storey run"]) -> State:
        """Move the springs of all storeys; see `SpringMotion.moved`."""
        return {
            str(j): law.moved(prepared, springs[str(j)], deformation[j])
            for j, (law, prepared) in enumerate(zip(self.laws, self.prepared, strict=True))
        }

    def force(self, springs: State) -> Float[Array, "storey run"]:
        """Return the storey shears; see `SpringMotion.force`."""
        return jnp.stack([springs[str(j)]["f"] for j in range(len(self.laws))])

    def deformation(self, motion: Float[Array, "storey run"]) -> Float[Array, "storey run"]:
        """Return the drifts d_j = u_j − u_(j−1), or their rates; see `SpringMotion.deformation`."""
        return motion - jnp.concatenate([0.0 * motion[:1], motion[:-1]])

    def acceleration(self, u: Any, v: Any, force: Any, signal: Any) -> Any:
        """Return the accelerations of the floors, relative to the base; see `SpringMotion.acceleration`."""
        above = jnp.concatenate([force[1:], 0.0 * force[:1]])
        motion = (above - force) / self.mass - jnp.einsum("ijr,jr->ir", self.viscous, v)
        if self.kind == "force":
            return jnp.concatenate([motion[:-1], motion[-1:] + signal / self.mass[-1:]])
        return motion - signal

    def usable(self, state: State, step: float) -> Any:
        """Return the accurate runs; see `SpringMotion.usable`."""
        above = jnp.concatenate([self.stiffness[1:], 0.0 * self.stiffness[:1]])
        # Gershgorin's bound of the largest ω²
        omega_squared = (2.0 * (self.stiffness + above) / self.mass).max(axis=0)
        followed = all_finite({"f": self.force(state["springs"]), "u": state["u"], "v": state["v"]})
        for j, law in enumerate(self.laws):
            followed = followed & short_enough(state["longest"][j], law.longest_move(), omega_squared, step)
        return followed

    def observe(self, state: State, signal: Any) -> Float[Array, "channel run"]:
        """Return the channels at a sample; see `SpringMotion.observe`."""
        force = self.force(state["springs"])
        return jnp.stack([self._channel(name, state, force, signal) for name in self.channels])

    def _channel(self, channel: str, state: State, force: Any, signal: Any) -> Any:
        if channel == "base_shear":
            return force[0]
        name, _, number = channel.rpartition("_")
        storey, u, v = int(number) - 1, state["u"], state["v"]
        match name:
            case "displacement":
                return u[storey]
            case "velocity":
                return v[storey]
            case "drift":
                return self.deformation(u)[storey]
            case "restoring_force":
                return force[storey]
            case "absorbed_energy":
                return state["work"][storey]
            case "relative_acceleration":
                return self.acceleration(u, v, force, signal)[storey]
            case _:
                ground = signal if self.kind == "ground_motion" else 0.0
                return self.acceleration(u, v, force, signal)[storey] + ground
