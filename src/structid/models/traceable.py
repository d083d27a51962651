"""Models whose response is a JAX function: batches over the cores, exact derivatives."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self, cast

import jax
import numpy as np
from jaxtyping import Float, Int

from structid.core.arrays import Array
from structid.core.channels import ChannelUnit
from structid.core.errors import InputError, Status
from structid.core.progress import Progress
from structid.engine.batches import LARGEST_BATCH
from structid.engine.lanes.in_lanes import InLanes
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.mechanics.restoring_forces import RestoringForce
from structid.models.base import Map, Model

KEPT_EXCITATIONS = 8
"""Prepared excitations that a model keeps; `InLanes` keeps as many compiled functions."""


@dataclass(frozen=True)
class TracedExcitation:
    """An excitation inside JAX: its static properties, and its values as traced arrays.

    Kind, step and length are static: other ones need another compilation. The values are an argument of the compiled function. A
    model receives this instead of an `Excitation`, so that it cannot keep the values of the first record.
    """

    kind: str  # `Excitation.kind`
    dt: float  # time step [s]
    samples: int  # number of samples
    lead_in_periods: int  # periods simulated and discarded first
    interpolation: str  # interpolation between samples
    identity: str  # hash of the whole excitation, for a model restricted to its own records; otherwise empty
    # Values at the start, middle and end of every integration step, from `Excitation.stage_values`. The last row
    # continues the record straight: its start is the last sample, with its slope, and the steps from there on are
    # nobody's
    stages: Any

    @classmethod
    def of(cls, excitation: Excitation, substeps: int, identified: bool = False) -> TracedExcitation:
        """Convert an excitation."""
        return cls(
            excitation.kind,
            excitation.dt,
            len(excitation),
            excitation.lead_in_periods,
            excitation.interpolation,
            excitation.content_hash if identified else "",
            _continued(excitation.stage_values(substeps)),
        )

    @property
    def dropped_samples(self) -> int:
        """Samples of the lead-in, which a response omits."""
        return self.lead_in_periods * self.samples


def _continued(stages: np.ndarray) -> np.ndarray:
    """The same stages and one more row, extrapolated with the last slope."""
    middle, end = stages[-1, -1, 1], stages[-1, -1, 2]
    on = end + np.multiply.outer(np.arange(3.0), end - middle)
    return np.concatenate([stages, np.broadcast_to(on, (1, *stages.shape[1:]))])


jax.tree_util.register_dataclass(
    TracedExcitation,
    data_fields=["stages"],
    meta_fields=["kind", "dt", "samples", "lead_in_periods", "interpolation", "identity"],
)


class Shortcut(ABC):
    """A direct way from parameters to a likelihood of measurements, without the response.

    A JAX tree: its arrays are arguments of the compiled density.
    """

    @abstractmethod
    def for_runs(self, measurement: Int[Array, " run"]) -> Self:
        """Assign each run a measurement of its own."""

    @abstractmethod
    def squares(self, theta: Float[Array, "run parameter"]) -> tuple[Any, Any]:
        """Sum over time of (measured − response)², inside JAX."""

    @abstractmethod
    def marginal_log_likelihood(
        self, theta: Float[Array, "run parameter"], variance: Float[Array, "channel run"]
    ) -> tuple[Any, Any] | None:
        """Log density of the measurement with independent errors, marginalised over the model's own error, inside JAX."""


class TraceableModel(Model):
    """A model whose response is a pure JAX function of many runs.

    Inside JAX histories are [time, channel, run], as the scan over time makes them and as vector units like them; `simulate`
    turns them into [run, time, channel].

    Attributes
    ----------
    loops : bool
        Whether a response is a loop over time, which XLA runs on one core, so that batches are shared out over the cores.
    own_records : bool
        Whether it knows the response only to certain records, as a surrogate may.
    hint_where_not_finite : str
        What is added to the reason of a run that leaves the finite range: what may be done about it.
    steps_setting : str
        Name of the setting that says how many integration steps are made; empty for a model whose steps are not counted.
    substeps : int
        Integration steps per sample.

    Examples
    --------
    The same response as a JAX function, which brings gradients:

    >>> import structid as si
    >>> from structid.models.traceable import TraceableModel
    >>> class RigidBlock(TraceableModel):
    ...     '''Acceleration of a block that follows the ground, times a factor.'''
    ...     free, channels, content_hash = ("factor",), ("acceleration",), "rigid block"
    ...     loops, substeps = False, 1
    ...     def response(self, theta, excitation):
    ...         ground = excitation.stages[: excitation.samples, 0, 0]
    ...         return ground[:, None, None] * theta[:, 0], theta[:, 0] > 0.0
    >>> record = si.GroundMotion([0.0, 1.5, 0.5], dt=0.01)
    >>> RigidBlock().simulate([[2.0]], record).channel("acceleration")[0]
    array([0., 3., 1.])
    """

    traceable: ClassVar[bool] = True
    batched: ClassVar[bool] = True
    loops: ClassVar[bool] = True
    own_records: ClassVar[bool] = False
    hint_where_not_finite: ClassVar[str] = ""
    steps_setting: ClassVar[str] = ""
    substeps: int

    @property
    def can_drift(self) -> bool:
        """Whether its parameters may change during the response; see `Model.can_drift`."""
        return self.loops and self.stand_in is None

    def time_loop(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> TimeLoop | None:
        """Give the loop over time that the response is, inside JAX, for a model whose response is one.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : TracedExcitation
            From `traced`.

        Returns
        -------
        TimeLoop or None
            None for a model that responds in another way, and says how in `response`.
        """
        return None

    def static_force(self, theta: Float[Array, "run parameter"]) -> RestoringForce | None:
        """Give the force of its structure against displacements that are imposed on it, inside JAX.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.

        Returns
        -------
        RestoringForce or None
            Of as many runs; None for a model on which no displacements can be imposed.
        """
        return None

    def response(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> tuple[Any, Any]:
        """Respond inside JAX.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : TracedExcitation
            From `traced`.

        Returns
        -------
        tuple of jax.Array
            Values (time, channel, run), and which runs can be used (run,): their state stayed finite, and was followed.
        """
        loop = self.time_loop(theta, excitation)
        if loop is None:
            raise NotImplementedError(f"{type(self).__name__} has neither a time_loop nor a response")
        return loop.run()

    def steps_in_sample(self, excitation: Excitation) -> int:
        """Count the integration steps from one sample to the next; `substeps` unless they depend on the excitation.

        Parameters
        ----------
        excitation : Excitation
            What drives it.

        Returns
        -------
        int
            One or more.
        """
        return self.substeps

    def traced(self, excitation: Excitation) -> TracedExcitation:
        """Prepare an excitation for `response`.

        Parameters
        ----------
        excitation : Excitation
            What drives it.

        Returns
        -------
        TracedExcitation
            With the values that this model's integration needs.
        """
        kept, key = self._traced_excitations, excitation.content_hash
        if key not in kept:
            if len(kept) >= KEPT_EXCITATIONS:
                kept.pop(next(iter(kept)))
            kept[key] = TracedExcitation.of(excitation, self.steps_in_sample(excitation), self.own_records)
        return kept[key]

    @cached_property
    def _traced_excitations(self) -> dict[str, TracedExcitation]:
        """Prepared excitations by content hash, so that compiled responses are reused."""
        return {}

    def shortcut(
        self, excitation: Excitation, values: Float[np.ndarray, "time channel measurement"], channels: tuple[str, ...]
    ) -> Shortcut | None:
        """Give a shorter way to the likelihood of measurements, for a model that has one.

        Parameters
        ----------
        excitation : Excitation
            What drives the model.
        values : ndarray, shape (time, channel, measurement)
            The measurements.
        channels : tuple of str
            Their channels.

        Returns
        -------
        Shortcut or None
            None where there is no shorter way than the response.
        """
        return None

    def run(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        progress: Progress | None = None,
        map: Map | None = None,
    ) -> Histories:
        """Run rows of parameters in batches, distributed over the machine's cores."""
        traced, parts = self.traced(excitation), []
        for start in range(0, len(theta), LARGEST_BATCH):
            parts.append(self._compiled_response(theta[start : start + LARGEST_BATCH], traced))
            if progress is not None:
                progress(min(start + LARGEST_BATCH, len(theta)), len(theta))
        # [time, channel, run] in memory, seen as [run, time, channel] without a copy.
        values = np.moveaxis(_joined([p[0] for p in parts]), 2, 0)
        finite = _joined([p[1] for p in parts])
        too_long = functools.partial(self._too_long, excitation)
        return _with_status(values, finite, excitation, self.channel_units, too_long, self.hint_where_not_finite)

    def _too_long(self, excitation: Excitation) -> str:
        """Explain a run that stayed finite and is still invalid."""
        steps = self.steps_in_sample(excitation)
        return (
            f"the integration step, {excitation.dt / steps:.3g} s ({steps} in a sample), is too long for the stiffness or the "
            "hysteretic law; give more substeps, or a finer record"
        )

    @cached_property
    def _compiled_response(self) -> Callable[..., Any]:
        return InLanes(self.response, run_axes=(2, 0))


def as_traceable(
    model: Model, where: str, allowed: str = "a built-in model or a surrogate", cure: str = ""
) -> TraceableModel:
    """Return a model that declares itself traceable, as a `TraceableModel`; refuse any other."""
    if not model.traceable:
        raise InputError(where, f"a {type(model).__name__}, which has no derivatives", allowed, cure)
    return cast(TraceableModel, model)


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)


def _with_status(
    values: np.ndarray,
    usable: np.ndarray,
    excitation: Excitation,
    units: dict[str, ChannelUnit],
    too_long: Callable[[], str],
    hint: str,
) -> Histories:
    """Mark invalid runs: those with a state that is not finite, or with steps too long for the law."""
    time, reasons = np.full(len(values), np.nan), [""] * len(values)
    for run in np.flatnonzero(~usable):
        good = np.isfinite(values[run]).all(axis=1)
        # Where the steps were too long, it is not known from when on the history is wrong.
        first_bad = 0 if good.all() else int(np.argmin(good))
        values[run, first_bad:] = np.nan
        time[run] = first_bad * excitation.dt
        reasons[run] = too_long() if good.all() else f"not finite from {time[run]:g} s on{hint}"
    status = np.where(usable, Status.DONE, Status.DIVERGED)
    return Histories(values, excitation.dt, tuple(units), status, time, excitation.name, tuple(reasons), units)
