"""The equations of motion of the shear frame for a batch of runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.mechanics.hysteresis import Law
from structid.mechanics.hysteretic_system import HystereticSystem, State


class FrameEquations(HystereticSystem):
    """Equations m_j u_j″ = −m_j a_g − (C u′)_j − f_j + f_(j+1); every part of the state has shape (storey, run)."""

    def __init__(
        self,
        storeys: int,
        channels: tuple[str, ...],
        values: dict[str, Any],
        kind: str,
        runs: int,
        damping: str | np.ndarray,
        rayleigh_mode: int,
    ) -> None:
        self.storeys, self.runs, self.channels = storeys, runs, channels
        self.stiffness = self._full(values["stiffness"])
        law = Law(**{name: values[name] for name in Law._fields})
        recorded = {channel.rpartition("_")[0] for channel in channels}
        super().__init__(law, self._full(values["mass"]), self.stiffness, kind, recorded)
        self.viscous = viscous_matrices(self.mass, self.stiffness, damping, rayleigh_mode, values["damping_ratio"])

    def _full(self, value: Any) -> Any:
        return jnp.broadcast_to(value, (self.storeys, self.runs))

    def initial_state(self, zero: Float[Array, "storey run"]) -> State:
        """Return the state of the frame at rest."""
        return self.with_energies({"u": zero, "v": zero, "z": zero}, zero)

    def largest_square_of_frequency(self) -> Any:
        """Return Gershgorin's bound max 2 (k_j + k_(j+1))/m_j; see `HystereticSystem.largest_square_of_frequency`."""
        above = jnp.concatenate([self.stiffness[1:], jnp.zeros_like(self.stiffness[:1])])
        return (2.0 * (self.stiffness + above) / self.mass).max(axis=0)

    def deformation(self, motion: Float[Array, "storey run"]) -> Float[Array, "storey run"]:
        """Return the drifts d_j = u_j − u_(j−1), or their rates; see `HystereticSystem.deformation`."""
        return motion - jnp.concatenate([jnp.zeros_like(motion[:1]), motion[:-1]])

    def spring_force(
        self, deformation: Float[Array, "storey run"], z: Float[Array, "storey run"]
    ) -> Float[Array, "storey run"]:
        """Return the storey shears f_j = k_j (α_j d_j + (1 − α_j) z_j); see `HystereticSystem.spring_force`."""
        return self.stiffness * (self.law.alpha * deformation + (1.0 - self.law.alpha) * z)

    def acceleration(
        self, u: Float[Array, "storey run"], v: Float[Array, "storey run"], z: Float[Array, "storey run"], signal: Any
    ) -> Float[Array, "storey run"]:
        """Return the accelerations of the floors; see `HystereticSystem.acceleration`."""
        shear = self.spring_force(self.deformation(u), z)
        above = jnp.concatenate([shear[1:], jnp.zeros_like(shear[:1])])
        damping = jnp.einsum("ijr,jr->ir", self.viscous, v)
        motion = -damping + (above - shear) / self.mass
        if self.kind == "force":
            return jnp.concatenate([motion[:-1], motion[-1:] + signal / self.mass[-1:]])
        return motion - signal

    def observe(self, state: State, signal: Any) -> Float[Array, "channel run"]:
        """Return the channels at a sample."""
        rows = []
        for channel in self.channels:
            name, _, number = channel.rpartition("_")
            base_shear = channel == "base_shear"
            storey = 0 if base_shear else int(number) - 1
            rows.append(self.channel("restoring_force" if base_shear else name, state, signal)[storey])
        return jnp.stack(rows)


def viscous_matrices(
    mass: Float[Array, "storey run"],
    stiffness: Float[Array, "storey run"],
    damping: str | np.ndarray,
    rayleigh_mode: int,
    damping_ratio: Any,
) -> Float[Array, "storey storey run"]:
    """Return M⁻¹ C of every run, for modal or Rayleigh damping of the initial stiffness, or for a given matrix C."""
    if not isinstance(damping, str):
        return jnp.asarray(damping)[:, :, None] / mass[:, None, :]
    storeys, runs = mass.shape
    root = jnp.sqrt(mass.T)
    squares, modes = jnp.linalg.eigh(_stiffness_matrices(stiffness) / (root[:, :, None] * root[:, None, :]))
    omega = jnp.sqrt(squares)
    zeta = jnp.broadcast_to(damping_ratio, (runs,))[:, None]
    if damping == "modal":
        rates = 2.0 * zeta * omega
    else:
        # a/(2ω) + bω/2 = ζ at both modes, so that 2ζω of every mode becomes a + b ω²
        first, second = omega[:, :1], omega[:, min(rayleigh_mode, storeys) - 1, None]
        rates = 2.0 * zeta / (first + second) * (first * second + omega**2)
    symmetric = jnp.einsum("rim,rm,rjm->rij", modes, rates, modes)
    # M⁻¹ C = M^(−½) S M^½
    return (symmetric * root[:, None, :] / root[:, :, None]).transpose(1, 2, 0)


def _stiffness_matrices(stiffness: Float[Array, "storey run"]) -> Float[Array, "run storey storey"]:
    """Return K of every run."""
    k = stiffness.T
    above = jnp.concatenate([k[:, 1:], jnp.zeros((len(k), 1))], axis=1)
    upper = jnp.eye(k.shape[1], k=1) * above[:, :, None]
    return (k + above)[:, :, None] * jnp.eye(k.shape[1]) - upper - upper.swapaxes(1, 2)


def stiffness_matrix(stiffness: Float[np.ndarray, " storey"]) -> Float[np.ndarray, "storey storey"]:
    """Return the tridiagonal stiffness matrix for storey stiffnesses from the ground up."""
    matrix = np.diag(stiffness + np.append(stiffness[1:], 0.0))
    return matrix - np.diag(stiffness[1:], 1) - np.diag(stiffness[1:], -1)


def natural_frequencies(
    stiffness: Float[np.ndarray, " storey"], mass: Float[np.ndarray, " storey"]
) -> Float[np.ndarray, " storey"]:
    """Return the natural frequencies [Hz] for storey stiffnesses and floor masses, in ascending order."""
    matrix = stiffness_matrix(stiffness) / np.sqrt(np.outer(mass, mass))
    return np.asarray(np.sqrt(np.linalg.eigvalsh(matrix)) / (2.0 * np.pi))
