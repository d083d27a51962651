"""The interface of every model, which computes response histories from parameters and an excitation."""

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
"""Function that applies another function to every element of a sequence in order, like ``concurrent.futures.Executor.map``."""


class StandIn(ABC):
    """Additional information about a model that replaces another model, such as a surrogate."""

    @property
    @abstractmethod
    def relative_error(self) -> float:
        """Mean of Σ(y − ŷ)²/Σ(y − ȳ)², with the responses y of the replaced model and ŷ of its replacement."""

    @abstractmethod
    def outside(self, theta: Float[np.ndarray, "run parameter"]) -> Bool[np.ndarray, " run"]:
        """Find the points outside the range in which the replacement is valid.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI, in the order of the model's `free`.

        Returns
        -------
        ndarray of bool, shape (run,)
            True for points outside the range.
        """

    @abstractmethod
    def search_range(self) -> dict[str, tuple[float, float]]:
        """Range of each parameter for a search, in SI.

        Returns
        -------
        dict of str to tuple of float
            Smallest and largest value of each parameter.
        """

    @abstractmethod
    def check_fitness(self) -> None:
        """Refuse use in a posterior if the replacement is known to be inaccurate.

        Raises
        ------
        InputError
            If the replacement is inaccurate.
        """

    @abstractmethod
    def error_variance(
        self, theta: Float[Array, "run parameter"], excitation: Any, values: Float[Array, "time channel run"]
    ) -> Float[Array, "channel run"]:
        """Return the variance of the replacement's error, averaged over time, inside JAX.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of the model's `free`.
        excitation : TracedExcitation
            Excitation of the model.
        values : jax.Array, shape (time, channel, run)
            Response of the replacement.

        Returns
        -------
        jax.Array, shape (channel, run)
            Variance in the square of each channel's SI unit.
        """


class Model(ABC):
    """A map from parameters and an excitation to response histories.

    Every model with this interface can be calibrated: a built-in oscillator, an external solver, a surrogate.
    A class that implements the interface is final; its settings are constructor arguments and do not change.

    Attributes
    ----------
    free : tuple of str
        Names of the parameters that are given with every run, in the order of the columns.
    channels : tuple of str
        Names of the channels that a run returns.
    traceable : bool
        Whether the response is a JAX function with derivatives; such a model is a `TraceableModel`.
    batched : bool
        Whether many runs are computed in one call. A run is then cheap, and workers are not needed.
    guarded : bool
        Whether runs are computed one by one in guarded child processes. An executor may use several processes at a time.

    Examples
    --------
    A model that computes many runs per call:

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
        """Information about the model as a replacement of another model; None if it replaces no model."""
        return None

    @property
    def can_drift(self) -> bool:
        """Whether the parameters may change during the response: true for a model that steps through time and is no surrogate."""
        return False

    @property
    def channel_units(self) -> dict[str, ChannelUnit]:
        """SI unit and display unit of every channel; by default the units of the standard channel names."""
        return {channel: standard_unit(channel) for channel in self.channels}

    @property
    def loop_channels(self) -> Mapping[str, tuple[str, str, str]]:
        """Channel names of displacement, force and absorbed energy, for every spring with a hysteresis loop.

        The keys are names of springs; the only spring of a model has an empty name. A copy of
        the model from `recording` records these channels.
        """
        return {}

    @property
    def kind_in_words(self) -> str:
        """Descriptive name of the model."""
        return "model"

    def pictures(self, theta: Float[np.ndarray, " parameter"], excitation: Excitation) -> Sequence[ModelPicture]:
        """Return pictures of the structure in one run; none if the model cannot draw any.

        Parameters
        ----------
        theta : ndarray, shape (parameter,)
            Parameters in SI; the parameters of the space come first.
        excitation : Excitation
            Excitation of the model.

        Returns
        -------
        sequence of ModelPicture
            Pictures, each drawn when it is needed.
        """
        return ()

    def derived_quantities(self, theta: Float[np.ndarray, "run parameter"]) -> Mapping[str, DerivedQuantity]:
        """Return quantities derived from the parameters that are easier to interpret, such as a yield displacement.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`.

        Returns
        -------
        mapping of str to DerivedQuantity
            Quantities with descriptive names; empty if the model defines none.
        """
        return {}

    def natural_frequency(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"] | None:
        """Return the lowest natural frequency before yielding.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`.

        Returns
        -------
        ndarray, shape (run,), or None
            Frequency [Hz]; None if the model defines none.
        """
        return None

    def working_in(self, folder: Path) -> Model:
        """Return this model with a folder for the files of its runs, if the runs write files.

        Parameters
        ----------
        folder : Path
            The folder; it is created if it does not exist.

        Returns
        -------
        Model
            The same model.
        """
        return self

    @check_arguments
    def recording(self, *channels: str) -> Model:
        """Return a copy of this model that records other channels.

        Parameters
        ----------
        *channels : str
            The channels.

        Returns
        -------
        Model
            The same model with these channels.

        Raises
        ------
        InputError
            If the model cannot record these channels.
        """
        if set(channels) <= set(self.channels):
            return self
        raise InputError(
            "channels",
            f"{', '.join(channels)}",
            f"channels that this {type(self).__name__} records: {', '.join(self.channels)}",
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
            Parameters in SI; the columns of an array are in the order of `free`.
        excitation : Excitation or sequence of Excitation
            One excitation for all runs, or one for each run; all must have the same time step and length.
        progress : callable, optional
            Callback whose arguments are the number of finished runs and the total number.
        map : callable, optional
            Function that maps the runs of an external model, like ``Executor.map``. Built-in models run in batches and
            ignore it.

        Returns
        -------
        Histories
            ``values[run, time, channel]`` in SI. A failed run has a status, a time of failure, a reason, and NaN after that
            time.
        """
        theta = self.parameters(design)
        if len(theta) == 0:
            raise InputError("simulate", "no runs", "at least one row of parameters")
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
        """Run the model with checked parameters on one excitation; every kind of model implements this method.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`; at least one row.
        excitation : Excitation
            Excitation of the model.
        progress, map : callable, optional
            As for `simulate`.

        Returns
        -------
        Histories
            One row for each run.
        """

    def before_run(self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation) -> None:
        """Check parameters and excitation before a run.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`.
        excitation : Excitation
            Excitation of the model.

        Raises
        ------
        InputError
            If the parameters or the excitation are invalid for the model.
        """
        self.check_excitation(excitation)

    def check_excitation(self, excitation: Excitation) -> None:  # noqa: B027 - most models take anything
        """Refuse an excitation for which the model cannot compute a response.

        Parameters
        ----------
        excitation : Excitation
            Intended excitation.

        Raises
        ------
        InputError
            If the model cannot compute a response to the excitation.
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
        """Hash of all data on which a response depends, except parameters and excitation."""

    @check_arguments
    def parameters(self, design: Design | np.ndarray) -> Float[np.ndarray, "run parameter"]:
        """Check a design against the free parameters, and sort its columns into their order.

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
            If a free parameter has no column, or a column has no free parameter.
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
        """Check that the parameters of a space match the free parameters of the model.

        Parameters
        ----------
        sampled, all_names : tuple of str
            Names of the parameters with a prior, and names of all parameters including derived parameters.

        Raises
        ------
        InputError
            If the names do not match.
        """
        for name in self.free:
            if name not in all_names:
                raise InputError(
                    f"{type(self).__name__}.free",
                    f"'{name}' has no prior",
                    ", ".join(all_names) or "nothing",
                    suggestion(name, all_names) or "Give the parameter a prior, or a value in the model.",
                )
        if set(sampled) == set(all_names):
            for name in sampled:
                if name not in self.free:
                    raise InputError(
                        "parameter space",
                        f"'{name}' is not a free parameter of this {type(self).__name__}",
                        ", ".join(self.free) or "none",
                        suggestion(name, self.free) or "Remove the parameter, or name it in the model's free.",
                    )

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse priors that are impossible for the model's parameters; by default all priors are allowed.

        Parameters
        ----------
        space : ParameterSpace
            The unknown parameters.

        Raises
        ------
        InputError
            If the unit or the range of a prior is wrong.
        """
        return


def _one_for_each_run(excitations: Sequence[Excitation], runs: int) -> list[Excitation]:
    given = list(excitations)
    if len(given) != runs:
        raise InputError(
            "simulate", f"{len(given)} excitations for {runs} runs", "one excitation for all runs, or one for each run"
        )
    if len({(len(e), e.dt) for e in given}) > 1:
        raise InputError(
            "simulate",
            "excitations with different time steps or lengths",
            "one time step and length for all excitations",
            "Use a Campaign, which allows different excitations, or resample and trim them.",
        )
    return given
