"""Models whose response is a JAX function, with batches on all cores and exact derivatives."""

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
"""Number of prepared excitations that a model keeps; `InLanes` keeps as many compiled functions."""


@dataclass(frozen=True)
class TracedExcitation:
    """An excitation inside JAX, with static properties and traced values.

    Kind, time step and length are static: each combination needs its own compilation. The values are an argument of the compiled
    function. A model receives this object instead of an `Excitation`, so that the compiled function cannot
    contain the values of the first record.
    """

    kind: str  # `Excitation.kind`
    dt: float  # time step [s]
    samples: int  # number of samples
    lead_in_periods: int  # number of initial periods that are simulated and discarded
    interpolation: str  # interpolation between samples
    identity: str  # hash of the whole excitation, for a model restricted to its own records; otherwise empty
    # Values at the start, middle and end of every integration step, from `Excitation.stage_values`. The additional
    # last row starts at the last sample and continues the record with its last slope. The steps after the last sample
    # are not used
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
        """Number of lead-in samples, which are not part of a response."""
        return self.lead_in_periods * self.samples


def _continued(stages: np.ndarray) -> np.ndarray:
    """Append the excitation values of one more sample, extrapolated with the last slope of the record."""
    middle, end = stages[-1, -1, 1], stages[-1, -1, 2]
    on = end + np.multiply.outer(np.arange(3.0), end - middle)
    return np.concatenate([stages, np.broadcast_to(on, (1, *stages.shape[1:]))])


jax.tree_util.register_dataclass(
    TracedExcitation,
    data_fields=["stages"],
    meta_fields=["kind", "dt", "samples", "lead_in_periods", "interpolation", "identity"],
)


class Shortcut(ABC):
    """A direct computation of the likelihood from the parameters, which does not compute the response.

    A shortcut is a JAX tree, so its arrays can be arguments of the compiled density.
    """

    @abstractmethod
    def for_runs(self, measurement: Int[Array, " run"]) -> Self:
        """Return a shortcut that compares each run with its own measurement, given by index."""

    @abstractmethod
    def squares(
        self, theta: Float[Array, "run parameter"], coefficients: Float[Array, "channel coefficient run"] | None = None
    ) -> tuple[Any, Any]:
        """Return the sum over time of (measured − reading)², inside JAX.

        Without an instrument, the reading is the response. Otherwise it is c₀ · response + Σ c_i · column_i, with the coefficients
        c₀, c₁, … of each channel and the columns of the instrument.
        """

    @abstractmethod
    def marginal_log_likelihood(
        self, theta: Float[Array, "run parameter"], variance: Float[Array, "channel run"]
    ) -> tuple[Any, Any] | None:
        """Return the log density of the measurement for iid errors, marginalised over the surrogate error, inside JAX."""


class TraceableModel(Model):
    """A model whose response is a pure JAX function of many runs.

    Inside JAX, histories have the axes [time, channel, run], which suits the scan over time and SIMD vectors.
    `simulate` returns them as [run, time, channel].

    Attributes
    ----------
    loops : bool
        Whether a response is a loop over time. XLA runs the loop on one core, so that batches are divided among the cores.
    own_records : bool
        Whether the model is restricted to certain records, as some surrogates are.
    hint_where_not_finite : str
        Advice that is appended to the reason of a run with non-finite values.
    steps_setting : str
        Name of the setting for the number of integration steps; empty for a model without such a setting.
    substeps : int
        Integration steps per sample.

    Examples
    --------
    The same response as a JAX function, which has gradients:

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
        """Whether the parameters may change during the response; see `Model.can_drift`."""
        return self.loops and self.stand_in is None

    def time_loop(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> TimeLoop | None:
        """Return the loop over time inside JAX, for a model whose response is such a loop.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : TracedExcitation
            From `traced`.

        Returns
        -------
        TimeLoop or None
            None for a model that implements `response` without a loop over time.
        """
        return None

    def static_force(self, theta: Float[Array, "run parameter"]) -> RestoringForce | None:
        """Return the restoring force of the structure under imposed displacements, inside JAX.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.

        Returns
        -------
        RestoringForce or None
            Force for all runs; None for a model that does not allow imposed displacements.
        """
        return None

    def response(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> tuple[Any, Any]:
        """Compute the response inside JAX.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : TracedExcitation
            From `traced`.

        Returns
        -------
        tuple of jax.Array
            Values (time, channel, run), and a mask of the usable runs (run,), with a finite state and sufficiently short steps.
        """
        loop = self.time_loop(theta, excitation)
        if loop is None:
            raise NotImplementedError(f"{type(self).__name__} has neither a time_loop nor a response")
        return loop.run()

    def steps_in_sample(self, excitation: Excitation) -> int:
        """Count the integration steps between samples: `substeps`, unless the number depends on the excitation.

        Parameters
        ----------
        excitation : Excitation
            Excitation of the model.

        Returns
        -------
        int
            Number of steps, 1 or more.
        """
        return self.substeps

    def traced(self, excitation: Excitation) -> TracedExcitation:
        """Prepare an excitation for `response`.

        Parameters
        ----------
        excitation : Excitation
            Excitation of the model.

        Returns
        -------
        TracedExcitation
            Excitation with the values needed for the integration.
        """
        kept, key = self._traced_excitations, excitation.content_hash
        if key not in kept:
            if len(kept) >= KEPT_EXCITATIONS:
                kept.pop(next(iter(kept)))
            kept[key] = TracedExcitation.of(excitation, self.steps_in_sample(excitation), self.own_records)
        return kept[key]

    @cached_property
    def _traced_excitations(self) -> dict[str, TracedExcitation]:
        """Prepared excitations by content hash; reusing them also reuses the compiled responses."""
        return {}

    def shortcut(
        self,
        excitation: Excitation,
        values: Float[np.ndarray, "sample channel measurement"],
        channels: tuple[str, ...],
        sampled: Callable[[np.ndarray], np.ndarray] | None = None,
        instrument: Float[np.ndarray, "sample channel column"] | None = None,
    ) -> Shortcut | None:
        """Return a direct computation of the likelihood of measurements, if the model has one.

        Parameters
        ----------
        excitation : Excitation
            Excitation of the model.
        values : ndarray, shape (sample, channel, measurement)
            The measurements.
        channels : tuple of str
            Channels of the measurements.
        sampled : callable, optional
            Linear map of histories (time, channel, part) to the samples of the measurements; by default they are the same.
        instrument : ndarray, shape (sample, channel, column), optional
            Columns that an instrument adds to the response, such as 1 for an offset; see `Shortcut.squares`.

        Returns
        -------
        Shortcut or None
            The shortcut; None if the likelihood requires the response.
        """
        return None

    def run(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        progress: Progress | None = None,
        map: Map | None = None,
    ) -> Histories:
        """Run rows of parameters in batches, distributed over the cores of the machine."""
        traced, parts = self.traced(excitation), []
        for start in range(0, len(theta), LARGEST_BATCH):
            parts.append(self._compiled_response(theta[start : start + LARGEST_BATCH], traced))
            if progress is not None:
                progress(min(start + LARGEST_BATCH, len(theta)), len(theta))
        # The axes in memory are [time, channel, run]; the result is a view [run, time, channel] without a copy.
        values = np.moveaxis(_joined([p[0] for p in parts]), 2, 0)
        finite = _joined([p[1] for p in parts])
        too_long = functools.partial(self._too_long, excitation)
        return _with_status(values, finite, excitation, self.channel_units, too_long, self.hint_where_not_finite)

    def _too_long(self, excitation: Excitation) -> str:
        """Return the reason why a run with finite values is invalid: its integration steps are too long."""
        steps = self.steps_in_sample(excitation)
        return (
            f"the integration step, {excitation.dt / steps:.3g} s ({steps} per sample), is too long for the stiffness or the "
            "hysteretic law; use more substeps or a finer record"
        )

    @cached_property
    def _compiled_response(self) -> Callable[..., Any]:
        return InLanes(self.response, run_axes=(2, 0))


def as_traceable(
    model: Model, where: str, allowed: str = "a built-in model or a surrogate", cure: str = ""
) -> TraceableModel:
    """Return a model as a `TraceableModel`, or refuse it if it is not traceable."""
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
    """Mark invalid runs: runs with a non-finite state, or with integration steps that are too long."""
    time, reasons = np.full(len(values), np.nan), [""] * len(values)
    for run in np.flatnonzero(~usable):
        good = np.isfinite(values[run]).all(axis=1)
        # If the steps were too long, the time at which the history becomes wrong is unknown.
        first_bad = 0 if good.all() else int(np.argmin(good))
        values[run, first_bad:] = np.nan
        time[run] = first_bad * excitation.dt
        reasons[run] = too_long() if good.all() else f"not finite from {time[run]:g} s on{hint}"
    status = np.where(usable, Status.DONE, Status.DIVERGED)
    return Histories(values, excitation.dt, tuple(units), status, time, excitation.name, tuple(reasons), units)
