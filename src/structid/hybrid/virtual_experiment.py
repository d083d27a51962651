"""A hybrid test whose specimen is also a model: a model of the whole, for campaigns, surrogates and posteriors."""

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
    """Two coupled parts, the physical one with the force of a model whose parameters may be free.

    It integrates as the test does: the same parts, steps, splitting and coupling. Actuators are left out; what they add is in
    `HybridTest.check`.

    Parameters
    ----------
    numerical, physical : Substructure
        The parts. Mass, damping and K₀ of the physical one stay as they are.
    specimen : TraceableModel
        On which displacements can be imposed, such as `BoucWen`. Its free parameters are those of the whole.
    dt : float
        Coarse step Δt [s]; a sample of the record must be a whole number of them.
    coupling : Coupling, optional
        `PrakashHjelmstad` without substeps when left out.
    pieces : int
        In which every move of the specimen is done: Runge-Kutta steps of a law of springs.
    way : array-like, shape (place, dof), optional
        Where the specimen was moved to in the tests before, the last place being its zero since then [m]; see
        `ProgrammeResult.way_to`.
    channels : sequence of str
        ``"displacement_1"``, … of the degrees of freedom of the physical part, then of those of the numerical part that are not at
        the interface; ``"restoring_force_1"``, … of the physical part.

    Examples
    --------
    >>> import structid as si
    >>> import numpy as np
    >>> from structid.hybrid.coupling.coupling_benchmark import LAW, two_floor_frame
    >>> upper, lower = si.cut_frame(two_floor_frame(), 1)
    >>> storey = si.BoucWen(mass=12e3, free=("stiffness",), **LAW)
    >>> test = si.VirtualHybridTest(upper, lower, storey, dt=0.01)
    >>> found = test.simulate(np.array([[7.0e6], [7.6e6]]), si.GroundMotion.synthetic(seed=1).trim(2.0, 4.0))
    >>> found.values.shape
    (2, 201, 1)
    """

    hint_where_not_finite: ClassVar[str] = ", as where a move is too long for the hysteretic law; more pieces follow it"

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
                "a model on which displacements can be imposed",
            )
        object.__setattr__(
            self, "channels", check_channels("VirtualHybridTest.channels", self.channels, self._known_channels)
        )
        self._joined(np.ones((1, len(model.free))))

    # --- what it is made of -------------------------------------------------------------------------------------

    @property
    def free(self) -> tuple[str, ...]:  # type: ignore[override]
        """Free parameters of the specimen."""
        return self.specimen.free

    @property
    def kind_in_words(self) -> str:
        """Name of the model in an engineer's words."""
        return "virtual hybrid test"

    @property
    def _inner(self) -> list[int]:
        """Degrees of freedom of the numerical part away from the interface."""
        return [int(k) for k in np.flatnonzero(~np.any(np.asarray(self.numerical.interface) != 0.0, axis=0))]

    @cached_property
    def _known_channels(self) -> tuple[str, ...]:
        of_both, physical = self.physical.dofs + len(self._inner), self.physical.dofs
        return (
            *(f"displacement_{k}" for k in range(1, of_both + 1)),
            *(f"restoring_force_{k}" for k in range(1, physical + 1)),
        )

    def _joined(self, theta: Any) -> Joined:
        """Both parts, for as many runs as there are rows."""
        force = self.specimen.static_force(theta)
        assert force is not None  # __post_init__ has looked
        way = np.zeros((1, force.dofs)) if self.way is None else self.way
        force = CarriedOver(InPieces(force, self.pieces), way)
        coupled = self.coupling.joined(self.numerical, replace(self.physical, restoring_force=force), self.dt)
        return replace(coupled, keeps_fine=False)

    # --- response -----------------------------------------------------------------------------------------------

    def steps_in_sample(self, excitation: Excitation) -> int:
        """Count the integration steps in a sample; see `TraceableModel.steps_in_sample`."""
        return round(excitation.dt / self.dt) * self.coupling.substeps

    def time_loop(self, theta: Any, excitation: TracedExcitation) -> TimeLoop:
        """Give the loop over the record; see `TraceableModel.time_loop`."""
        coupled, fine = self._joined(theta), self.coupling.substeps
        stages = excitation.stages.reshape(len(excitation.stages), -1, fine, 3)

        def step(state: CoupledState, row: Any) -> tuple[CoupledState, None]:
            return coupled.step(state, jnp.concatenate([row[:1, 0], row[:, 2]])).state, None

        def sample(state: CoupledState, rows: Any) -> tuple[CoupledState, Any]:
            outputs = self._seen(state)
            if len(rows) == 1:
                return step(state, rows[0])[0], outputs
            return lax.scan(step, state, rows)[0], outputs

        start = coupled.start(stages[0, 0, 0, 0], jnp.zeros(theta.shape[0]))
        return TimeLoop(start, sample, stages, excitation.dropped_samples, _finite)

    def _seen(self, state: CoupledState) -> Any:
        """The channels, shape (channel, run)."""
        physical, numerical = state.physical, state.numerical
        inner = [numerical.displacement[k] for k in self._inner]
        rows = [*physical.displacement, *inner, *physical.force]
        return jnp.stack([rows[self._known_channels.index(channel)] for channel in self.channels])

    # --- what others ask ----------------------------------------------------------------------------------------

    def recording(self, *channels: str) -> VirtualHybridTest:
        """Return this test with other channels."""
        return replace(self, channels=channels)

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse anything but a ground motion whose samples are a whole number of coarse steps."""
        check_one_signal("VirtualHybridTest", excitation)
        if excitation.kind != "ground_motion":
            raise InputError("VirtualHybridTest", f"a {excitation.kind}", "a GroundMotion")
        steps = excitation.dt / self.dt
        if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
            raise InputError(
                "VirtualHybridTest.dt",
                f"{self.dt:g} s, and the record has a sample every {excitation.dt:g} s",
                "a whole number of coarse steps in a sample",
                f"Resample the record: record.resample({self.dt:g}).",
            )

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse what the specimen's model refuses; see `Model.check_priors`."""
        self.specimen.check_priors(space)

    @property
    def content_hash(self) -> str:
        """Hash of everything a response depends on."""
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
    """Which runs have stayed finite."""
    return jnp.isfinite(state.physical.displacement).all(axis=0) & jnp.isfinite(state.numerical.displacement).all(
        axis=0
    )
