"""A hybrid test with a modelled specimen: a model of the whole structure for campaigns, surrogates and posteriors."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from jax import lax

from structid.core.channels import check_channels
from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.validation import check_arguments
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation, check_one_signal
from structid.hybrid.coupling.base import CoupledState, Coupling, Joined
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.substructures.substructure import Substructure
from structid.mechanics.carried_over import CarriedOver, InPieces
from structid.models.traceable import TraceableModel, TracedExcitation, as_traceable
from structid.probability.space import ParameterSpace


@check_arguments
@dataclass(frozen=True, eq=False)
class VirtualHybridTest(TraceableModel):
    """Model of two coupled parts: a model with free parameters gives the force of the physical part.

    The model is integrated like the test, with the same parts, steps, splitting and coupling. It has no actuators;
    `HybridTest.check` computes their effect.

    Parameters
    ----------
    numerical, physical : Substructure
        The parts. Mass, damping and K₀ of the physical part are fixed.
    specimen : TraceableModel
        Model that accepts imposed displacements, such as `BoucWen`. Its free parameters are the only free parameters.
    dt : float
        Coarse step Δt [s]; the time step of the record must be a whole number of coarse steps.
    coupling : Coupling, optional
        Default: `PrakashHjelmstad` without substeps.
    pieces : int
        Number of pieces of each move of the specimen: Runge-Kutta steps, if it consists of hysteretic springs.
    way : array-like, shape (place, dof), optional
        Displacements of the specimen in earlier tests [m], with its present zero in the last row; see
        `ProgrammeResult.way_to`.
    channels : sequence of str
        ``"displacement_1"``, …: degrees of freedom of the physical part, then degrees of freedom of the numerical part outside
        the interface; ``"restoring_force_1"``, …: forces of the physical part.

    Examples
    --------
    >>> import structid as si
    >>> import numpy as np
    >>> from structid.hybrid.coupling.coupling_benchmark import LAW, two_floor_frame
    >>> upper, lower = si.cut_frame(two_floor_frame(), 1)
    >>> storey = si.BoucWen(mass=12e3, free=("stiffness",), **LAW)
    >>> test = si.VirtualHybridTest(upper, lower, storey, dt=0.01)
    >>> histories = test.simulate(np.array([[7.0e6], [7.6e6]]), si.GroundMotion.synthetic(seed=1).trim(2.0, 4.0))
    >>> histories.values.shape
    (2, 201, 1)
    """

    hint_where_not_finite: ClassVar[str] = "; if a move is too long for the hysteretic law, use more pieces"

    numerical: Substructure
    physical: Substructure
    specimen: TraceableModel
    dt: float
    coupling: Coupling = field(default_factory=PrakashHjelmstad)
    pieces: int = 10
    way: np.ndarray | None = field(default=None, repr=False)
    channels: tuple[str, ...] = ("displacement_1",)

    def __post_init__(self) -> None:
        model = as_traceable(self.specimen, "VirtualHybridTest.specimen")
        force = model.static_force(np.zeros((1, len(model.free))) + 1.0)
        if force is None:
            raise InputError(
                "VirtualHybridTest.specimen",
                f"a {model.kind_in_words}",
                "a model that accepts imposed displacements",
            )
        object.__setattr__(
            self, "channels", check_channels("VirtualHybridTest.channels", self.channels, self._known_channels)
        )
        self._joined(np.ones((1, len(model.free))))

    # --- parts and channels -------------------------------------------------------------------------------------

    @property
    def free(self) -> tuple[str, ...]:  # type: ignore[override]
        """Free parameters of the specimen."""
        return self.specimen.free

    @property
    def kind_in_words(self) -> str:
        """Descriptive name of the model."""
        return "virtual hybrid test"

    @property
    def _inner(self) -> list[int]:
        """Degrees of freedom of the numerical part outside the interface."""
        return [int(k) for k in np.flatnonzero(~np.any(np.asarray(self.numerical.interface) != 0.0, axis=0))]

    @cached_property
    def _known_channels(self) -> tuple[str, ...]:
        of_both, physical = self.physical.dofs + len(self._inner), self.physical.dofs
        return (
            *(f"displacement_{k}" for k in range(1, of_both + 1)),
            *(f"restoring_force_{k}" for k in range(1, physical + 1)),
        )

    def _joined(self, theta: Any) -> Joined:
        """Return the coupled parts for a batch of runs, one run per row of `theta`."""
        force = self.specimen.static_force(theta)
        assert force is not None  # checked in __post_init__
        way = np.zeros((1, force.dofs)) if self.way is None else self.way
        force = CarriedOver(InPieces(force, self.pieces), way)
        coupled = self.coupling.joined(self.numerical, replace(self.physical, restoring_force=force), self.dt)
        return replace(coupled, keeps_fine=False)

    # --- response -----------------------------------------------------------------------------------------------

    def steps_in_sample(self, excitation: Excitation) -> int:
        """Count the integration steps in a sample; see `TraceableModel.steps_in_sample`."""
        return round(excitation.dt / self.dt) * self.coupling.substeps

    def time_loop(self, theta: Any, excitation: TracedExcitation) -> TimeLoop:
        """Return the loop over the record; see `TraceableModel.time_loop`."""
        coupled, fine = self._joined(theta), self.coupling.substeps
        stages = excitation.stages.reshape(len(excitation.stages), -1, fine, 3)

        def step(state: CoupledState, row: Any) -> tuple[CoupledState, None]:
            return coupled.step(state, jnp.concatenate([row[:1, 0], row[:, 2]])).state, None

        def sample(state: CoupledState, rows: Any) -> tuple[CoupledState, Any]:
            outputs = self._channel_values(state)
            if len(rows) == 1:
                return step(state, rows[0])[0], outputs
            return lax.scan(step, state, rows)[0], outputs

        start = coupled.start(stages[0, 0, 0, 0], jnp.zeros(theta.shape[0]))
        return TimeLoop(start, sample, stages, excitation.dropped_samples, _finite)

    def _channel_values(self, state: CoupledState) -> Any:
        """Return the values of the channels, shape (channel, run)."""
        physical, numerical = state.physical, state.numerical
        inner = [numerical.displacement[k] for k in self._inner]
        rows = [*physical.displacement, *inner, *physical.force]
        return jnp.stack([rows[self._known_channels.index(channel)] for channel in self.channels])

    # --- interface of a model -----------------------------------------------------------------------------------

    def recording(self, *channels: str) -> VirtualHybridTest:
        """Return this test with other channels."""
        return replace(self, channels=channels)

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse every excitation except a record whose time step is a whole number of coarse steps."""
        check_one_signal("VirtualHybridTest", excitation)
        if excitation.kind != "ground_motion":
            raise InputError("VirtualHybridTest", f"a {excitation.kind}", "a GroundMotion")
        steps = excitation.dt / self.dt
        if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
            raise InputError(
                "VirtualHybridTest.dt",
                f"{self.dt:g} s for a record with a time step of {excitation.dt:g} s",
                "a whole number of coarse steps per time step of the record",
                f"Resample the record: record.resample({self.dt:g}).",
            )

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse priors that the specimen's model refuses; see `Model.check_priors`."""
        self.specimen.check_priors(space)

    @property
    def content_hash(self) -> str:
        """Hash of all inputs of the response."""
        matrices = [
            np.asarray(getattr(part, name))
            for part in (self.numerical, self.physical)
            for name in ("mass", "damping", "stiffness", "interface", "influence")
        ]
        coupling = {f.name: getattr(self.coupling, f.name) for f in fields(self.coupling)}
        way = np.zeros(0) if self.way is None else np.asarray(self.way)
        return digest(
            "VirtualHybridTest",
            *matrices,
            way,
            self.numerical.force.content_hash,
            self.specimen.content_hash,
            self.dt,
            self.pieces,
            type(self.coupling).__name__,
            coupling,
            self.channels,
        )

    def __str__(self) -> str:
        return f"VirtualHybridTest: {self.numerical} + {self.physical}, Δt {self.dt:g} s, free: {', '.join(self.free)}"


def _finite(state: CoupledState) -> Any:
    """Return True for each run with finite displacements."""
    return jnp.isfinite(state.physical.displacement).all(axis=0) & jnp.isfinite(state.numerical.displacement).all(
        axis=0
    )
