"""A structure under imposed displacements, as in a cyclic or hybrid test; its response is the restoring force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from structid.core.channels import check_channels
from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.validation import check_arguments
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import CombinedExcitation, DisplacementHistory, Excitation, RotationHistory
from structid.mechanics.carried_over import InPieces
from structid.mechanics.restoring_forces import RestoringForce
from structid.models.traceable import TraceableModel, TracedExcitation, as_traceable
from structid.probability.space import ParameterSpace

KINDS = {"m": DisplacementHistory.kind, "rad": RotationHistory.kind}
"""Kind of excitation for each unit of displacement."""


def force_channels(units: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the force channels."""
    if len(units) == 1:
        return ("moment",) if units[0] == "rad" else ("restoring_force",)
    return tuple(f"{'moment' if unit == 'rad' else 'restoring_force'}_{k}" for k, unit in enumerate(units, start=1))


@check_arguments
@dataclass(frozen=True, eq=False)
class ImposedDisplacements(TraceableModel):
    """The structure of a model under imposed displacements, without inertia and dashpots.

    Forces are measured relative to the start, where all displacements are zero.

    Parameters
    ----------
    model : TraceableModel
        A model that allows imposed displacements, such as `BoucWen` or `MasonryWall`; the free parameters are the same. A rigid
        beam moves the top of a wall: u_x, u_y and the rotation about the middle of the top.
    pieces : int
        Number of pieces into which the displacement increment between two samples is divided.
    channels : sequence of str, optional
        Forces to record, from `force_channels`; all forces by default.

    Examples
    --------
    >>> import structid as si
    >>> import numpy as np
    >>> storey = si.BoucWen(mass=12e3, alpha=0.05, beta=63.0, gamma_ratio=1.0, free=("stiffness",))
    >>> path = si.DisplacementHistory(0.02 * np.sin(np.linspace(0.0, 6.28, 101)), 1.0)
    >>> forces = si.ImposedDisplacements(storey).simulate(np.array([[7.6e6]]), path)
    >>> print(f"{forces.values.max() / 1e3:.1f} kN")
    60.3 kN
    """

    hint_where_not_finite: ClassVar[str] = "; if a move is too long for the hysteretic law, use more pieces"

    model: TraceableModel
    pieces: int = 10
    channels: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        as_traceable(self.model, "ImposedDisplacements.model")
        if self._force(jnp.ones((1, len(self.free)))) is None:
            raise InputError(
                "ImposedDisplacements.model",
                f"a {self.model.kind_in_words}",
                "a model that allows imposed displacements",
            )
        if not self.pieces >= 1:
            raise InputError("ImposedDisplacements.pieces", f"{self.pieces!r}", "a whole number of 1 or more")
        available = force_channels(self._units)
        requested = (self.channels,) if isinstance(self.channels, str) else tuple(self.channels)
        object.__setattr__(
            self, "channels", check_channels("ImposedDisplacements.channels", requested or available, available)
        )

    @property
    def free(self) -> tuple[str, ...]:  # type: ignore[override]
        """Free parameters of the model."""
        return self.model.free

    @property
    def kind_in_words(self) -> str:
        """Descriptive name of the model."""
        return f"{self.model.kind_in_words} under imposed displacements"

    def _force(self, theta: Any) -> RestoringForce | None:
        force = self.model.static_force(theta)
        return None if force is None else InPieces(force, self.pieces)

    @cached_property
    def _units(self) -> tuple[str, ...]:
        force = self._force(jnp.ones((1, len(self.free))))
        assert force is not None  # __post_init__ has looked
        return force.units

    def static_force(self, theta: Any) -> RestoringForce | None:
        """Return the static force of the model; see `TraceableModel.static_force`."""
        return self.model.static_force(theta)

    def steps_in_sample(self, excitation: Excitation) -> int:
        """Count the integration steps in a sample; see `TraceableModel.steps_in_sample`."""
        return 1

    def time_loop(self, theta: Any, excitation: TracedExcitation) -> TimeLoop:
        """Return the loop over the samples; see `TraceableModel.time_loop`."""
        force, count = self._force(theta), len(self._units)
        assert force is not None  # __post_init__ has looked
        rows = [force_channels(self._units).index(channel) for channel in self.channels]
        nothing = jnp.zeros((count, theta.shape[0]))
        at_zero, memory = force.force_at_rest(nothing), force.at_rest(nothing)

        def sample(carried: tuple[Any, Any], row: Any) -> tuple[tuple[Any, Any], Any]:
            imposed = nothing + row[0, 0].reshape(count, 1)
            result, after = force.at(carried[0], imposed)
            return (after, carried[1] & jnp.isfinite(result).all(axis=0)), jnp.stack(
                [(result - at_zero)[row] for row in rows]
            )

        start = memory, jnp.isfinite(at_zero).all(axis=0)
        return TimeLoop(start, sample, excitation.stages, excitation.dropped_samples, lambda carried: carried[1])

    def recording(self, *channels: str) -> ImposedDisplacements:
        """Return a copy of this model that records other channels."""
        return replace(self, channels=channels)

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse any excitation except one imposed displacement for each degree of freedom."""
        parts = excitation.parts if isinstance(excitation, CombinedExcitation) else (excitation,)
        requested, came = [KINDS[unit] for unit in self._units], [part.kind for part in parts]
        if came != requested:
            allowed = ", ".join(f"a {kind.capitalize()}History" for kind in requested)
            raise InputError(
                "ImposedDisplacements",
                ", ".join(came),
                allowed,
                "Combine these histories, in this order, in one CombinedExcitation.",
            )

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse priors that the model refuses; see `Model.check_priors`."""
        self.model.check_priors(space)

    @property
    def content_hash(self) -> str:
        """Hash of all settings."""
        return digest("ImposedDisplacements", self.model.content_hash, self.pieces, self.channels)

    def __str__(self) -> str:
        return f"ImposedDisplacements: {self.model}"
