"""The interface of every model: parameters and an excitation in, response histories out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float

from structid.core.arrays import Array
from structid.core.channels import ChannelUnit, standard_unit
from structid.core.errors import InputError, suggestion
from structid.core.progress import Progress
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.models.derived_quantity import DerivedQuantity
from structid.models.pictures import ModelPicture
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace

Map = Callable[..., Iterable[Any]]
"""Applies a function to every element of a sequence, in order, like ``concurrent.futures.Executor.map``."""


class StandIn(ABC):
    """Additional knowledge of a model that replaces another one, such as a surrogate."""

    @property
    @abstractmethod
    def relative_error(self) -> float:
        """Mean of Σ(y − ŷ)²/Σ(y − ȳ)² with respect to the replaced model."""

    @abstractmethod
    def outside(self, theta: Float[np.ndarray, "run parameter"]) -> Bool[np.ndarray, " run"]:
        """Say which points lie outside the range in which it is known to be good.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI, in the order of the model's `free`.

        Returns
        -------
        ndarray of bool, shape (run,)
            True where nothing is known.
        """

    @abstractmethod
    def search_range(self) -> dict[str, tuple[float, float]]:
        """Range of each parameter in which a search may look, in SI.

        Returns
        -------
        dict of str to tuple of float
            Smallest and largest value, by name.
        """

    @abstractmethod
    def check_fitness(self) -> None:
        """Refuse to be used in a posterior if it is known to be poor.

        Raises
        ------
        InputError
            If it is.
        """

    @abstractmethod
    def error_variance(
        self, theta: Float[Array, "run parameter"], excitation: Any, values: Float[Array, "time channel run"]
    ) -> Float[Array, "channel run"]:
        """Variance of its own error, averaged over time, inside JAX.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of the model's `free`.
        excitation : TracedExcitation
            What drives it.
        values : jax.Array, shape (time, channel, run)
            Its response there.

        Returns
        -------
        jax.Array, shape (channel, run)
            In the square of each channel's SI unit.
        """


class Model(ABC):
    """Maps parameters and an excitation to response histories.

    Everything that has this interface can be calibrated: the built-in oscillators, an external solver, a surrogate.
    A class that implements it is final; its settings are in its constructor and do not change.

    Attributes
    ----------
    free : tuple of str
        Parameters that are given with every run, in the order of its columns.
    channels : tuple of str
        What a run returns.
    traceable : bool
        Whether the response is a JAX function, with derivatives; such a model is a `TraceableModel`.
    batched : bool
        Whether many runs are done in one call. A run then costs little, and nobody needs workers for it.
    guarded : bool
        Whether runs are done one by one in child processes, where they can do no harm. An executor may do several at a time.

    Examples
    --------
    A model of many runs a call:

    >>> import structid as si
    >>> from structid.histories import Histories
    >>> from structid.models.base import Model
    >>> class RigidBlock(Model):
    ...     '''Acceleration of a block that follows the ground, times a factor.'''
    ...     batched, free, channels = True, ("factor",), ("acceleration",)
    ...     content_hash = "rigid block"
    ...     def run(self, theta, excitation, progress=None, map=None):
    ...         values = theta[:, :1] * excitation.values
    ...         return Histories(values[:, :, None], excitation.dt, self.channels, units=self.channel_units)
    >>> record = si.GroundMotion([0.0, 1.5, 0.5], dt=0.01)
    >>> RigidBlock().simulate([[2.0]], record).channel("acceleration")[0]
    array([0., 3., 1.])
    """

    free: tuple[str, ...]
    channels: tuple[str, ...]

    traceable: ClassVar[bool] = False
    batched: ClassVar[bool] = False
    guarded: ClassVar[bool] = False

    @property
    def stand_in(self) -> StandIn | None:
        """Its description as a replacement of another model; None for a model that replaces none."""
        return None

    @property
    def can_drift(self) -> bool:
        """Whether its parameters may change during the response: true for a loop over time that replaces no other model."""
        return False

    @property
    def channel_units(self) -> dict[str, ChannelUnit]:
        """SI unit and display unit of every channel; those of the standard names by default."""
        return {channel: standard_unit(channel) for channel in self.channels}

    @property
    def loop_channels(self) -> Mapping[str, tuple[str, str, str]]:
        """Displacement, force and absorbed energy of every spring with a hysteresis loop, by the name of the spring.

        A model's only spring has an empty name. The channels can be requested with `recording`.
        """
        return {}

    @property
    def kind_in_words(self) -> str:
        """Name of the model in an engineer's words."""
        return "model"

    def pictures(self, theta: Float[np.ndarray, " parameter"], excitation: Excitation) -> Sequence[ModelPicture]:
        """Pictures of the structure in one run; none for a model that cannot draw itself.

        Parameters
        ----------
        theta : ndarray, shape (parameter,)
            Parameters in SI, those of the space first.
        excitation : Excitation
            What drives it.

        Returns
        -------
        sequence of ModelPicture
            Each is drawn when it is asked for.
        """
        return ()

    def derived_quantities(self, theta: Float[np.ndarray, "run parameter"]) -> Mapping[str, DerivedQuantity]:
        """What follows from the parameters, and says more to an engineer: a yield displacement, say.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`.

        Returns
        -------
        mapping of str to DerivedQuantity
            By a name in words; none for a model that says nothing of it.
        """
        return {}

    def natural_frequency(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"] | None:
        """Lowest natural frequency before anything yields.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`.

        Returns
        -------
        ndarray, shape (run,), or None
            [Hz]; None for a model that says nothing of it.
        """
        return None

    def working_in(self, folder: Path) -> Model:
        """Return this model with a folder for the files that its runs leave, if they leave any.

        Parameters
        ----------
        folder : Path
            Created if it does not exist.

        Returns
        -------
        Model
            The same model.
        """
        return self

    @check_arguments
    def recording(self, *channels: str) -> Model:
        """Return this model with other channels.

        Parameters
        ----------
        *channels : str
            The channels.

        Returns
        -------
        Model
            The same model, recording them.

        Raises
        ------
        InputError
            If it cannot record them.
        """
        if set(channels) <= set(self.channels):
            return self
        raise InputError(
            "channels",
            f"{', '.join(channels)}",
            f"what this {type(self).__name__} records: {', '.join(self.channels)}",
        )

    @check_arguments
    def simulate(
        self,
        design: Design | np.ndarray,
        excitation: Excitation | Sequence[Excitation],
        *,
        progress: Progress | None = None,
        map: Map | None = None,
    ) -> Histories:
        """Run the model.

        Parameters
        ----------
        design : Design or array-like, shape (run, parameter)
            Parameters in SI; a bare array has its columns in the order of `free`.
        excitation : Excitation or sequence of Excitation
            What drives it: one for all runs, or one for each run, all of the same step and length.
        progress : callable, optional
            Called with the number of finished runs and the total.
        map : callable, optional
            Maps the runs of an external model, like ``Executor.map``. Built-in models run in batches and do not need it.

        Returns
        -------
        Histories
            ``values[run, time, channel]`` in SI. A run that fails is a row with a status, the time of failure, a reason,
            and NaN from there on.
        """
        theta = self.parameters(design)
        if len(theta) == 0:
            raise InputError("simulate", "no runs", "one row of parameters or more")
        if isinstance(excitation, Excitation):
            self.before_run(theta, excitation)
            return self.run(theta, excitation, progress, map)
        return self._run_on_several(theta, _one_for_each_run(excitation, len(theta)), progress, map)

    @abstractmethod
    def run(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        progress: Progress | None = None,
        map: Map | None = None,
    ) -> Histories:
        """Run checked parameters on one excitation; what a kind of model implements.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`; one row or more.
        excitation : Excitation
            What drives it.
        progress, map : callable, optional
            As for `simulate`.

        Returns
        -------
        Histories
            One row a run.
        """

    def before_run(self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation) -> None:
        """Check parameters and excitation before a run.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`.
        excitation : Excitation
            What drives it.

        Raises
        ------
        InputError
            If the model cannot respond to them.
        """
        self.check_excitation(excitation)

    def check_excitation(self, excitation: Excitation) -> None:  # noqa: B027 - most models take anything
        """Refuse an excitation that the model cannot respond to.

        Parameters
        ----------
        excitation : Excitation
            What is to drive it.

        Raises
        ------
        InputError
            If it cannot.
        """

    def _run_on_several(
        self, theta: np.ndarray, excitations: list[Excitation], progress: Progress | None, map: Map | None
    ) -> Histories:
        hashes = np.array([e.content_hash for e in excitations])
        rows_of = [np.flatnonzero(hashes == h) for h in dict.fromkeys(hashes)]
        done, parts = 0, []
        for rows in rows_of:
            self.before_run(theta[rows], excitations[rows[0]])
            parts.append(self.run(theta[rows], excitations[rows[0]], None, map))
            done += len(rows)
            if progress is not None:
                progress(done, len(theta))
        order = np.argsort(np.concatenate(rows_of))
        return Histories(
            np.concatenate([p.values for p in parts])[order],
            parts[0].dt,
            self.channels,
            np.concatenate([p.status for p in parts])[order],
            np.concatenate([p.failure_time for p in parts])[order],
            ", ".join(p.excitation for p in parts),
            tuple(np.concatenate([np.array(p.reasons, dtype=object) for p in parts])[order]),
            parts[0].units,
        )

    @property
    @abstractmethod
    def content_hash(self) -> str:
        """Hash of everything a response depends on besides parameters and excitation."""

    @check_arguments
    def parameters(self, design: Design | np.ndarray) -> Float[np.ndarray, "run parameter"]:
        """Check a design against the free parameters and bring its columns into their order.

        Parameters
        ----------
        design : Design or array-like, shape (run, parameter)
            Points in SI.

        Returns
        -------
        ndarray, shape (run, parameter)
            Points in the order of `free`.

        Raises
        ------
        InputError
            If a free parameter has no column, or a column no parameter.
        """
        if isinstance(design, Design):
            self.check_names(design.space.names, design.space.all_names)
            return np.asarray(design.columns(self.free), dtype=np.float64)
        theta = np.empty(0) if isinstance(design, Mapping) else np.asarray(design, dtype=np.float64)
        if theta.ndim != 2 or theta.shape[1] != len(self.free):
            raise InputError(
                "parameters",
                "values by name" if isinstance(design, Mapping) else f"an array of shape {theta.shape}",
                f"(run, {len(self.free)}) with the columns {', '.join(self.free) or '(none: every parameter is fixed)'}",
            )
        return theta

    def check_names(self, sampled: tuple[str, ...], all_names: tuple[str, ...]) -> None:
        """Check that a space has every free parameter, and none that the model lacks.

        Parameters
        ----------
        sampled, all_names : tuple of str
            The names with a prior, and those together with the derived ones.

        Raises
        ------
        InputError
            If they do not match.
        """
        for name in self.free:
            if name not in all_names:
                raise InputError(
                    f"{type(self).__name__}.free",
                    f"'{name}' has no prior",
                    ", ".join(all_names) or "nothing",
                    suggestion(name, all_names) or "Give it a prior, or a value in the model.",
                )
        if set(sampled) == set(all_names):
            for name in sampled:
                if name not in self.free:
                    raise InputError(
                        "parameter space",
                        f"'{name}' is no free parameter of this {type(self).__name__}",
                        ", ".join(self.free) or "none",
                        suggestion(name, self.free) or "Remove it, or name it in free.",
                    )

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse priors that the model's parameters cannot have; a model that knows nothing of its parameters takes any.

        Parameters
        ----------
        space : ParameterSpace
            The unknown parameters.

        Raises
        ------
        InputError
            If a unit or a range is wrong.
        """
        return


def _one_for_each_run(excitations: Sequence[Excitation], runs: int) -> list[Excitation]:
    given = list(excitations)
    if len(given) != runs:
        raise InputError("simulate", f"{len(given)} excitations for {runs} runs", "one for all, or one for each run")
    if len({(len(e), e.dt) for e in given}) > 1:
        raise InputError(
            "simulate",
            "excitations of different steps or lengths",
            "the same step and length for all",
            "A Campaign takes any; or resample and trim them.",
        )
    return given
