"""What a model is: parameters and an excitation in, response histories out; the same face for every kind of model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar

import numpy as np

from structid.errors import InputError, Status, suggestion
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.probability.space import Design

Progress = Callable[[int, int], None]
"""Told how many runs (or steps) are done, and of how many."""

Map = Callable[..., Iterable[Any]]
"""Applies a function to every element of a sequence, in order, like ``concurrent.futures.Executor.map``."""

LARGEST_BATCH = 2000
"""Runs compiled and kept in memory at once."""


class Model(ABC):
    """Maps parameters and an excitation to response histories.

    Everything that has this face can be calibrated: the built-in oscillators, somebody's external solver, a surrogate.
    A class that implements it is final; its settings are in its constructor and do not change.
    """

    free: tuple[str, ...]
    channels: tuple[str, ...]

    certified: bool | None = None
    """Whether runs of the model it stands for have shown that its posterior is theirs; for surrogates. None: nobody has asked."""

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
            Told how many runs are done.
        map : callable, optional
            Spreads the runs of an external model, like ``Executor.map``. Built-in models run in batches and do not need it.

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
        theta: np.ndarray,
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

    def before_run(self, theta: np.ndarray, excitation: Excitation) -> None:  # noqa: B027 - most models take anything
        """Check parameters and excitation before a run; a model that knows its own range says here what lies outside it.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`.
        excitation : Excitation
            What drives it.
        """

    def check_excitation(self, excitation: Excitation) -> None:  # noqa: B027 - most models take anything
        """Refuse an excitation the model knows nothing of; a surrogate may.

        Parameters
        ----------
        excitation : Excitation
            What is to drive it.
        """

    @property
    def relative_error(self) -> float:
        """Mean of Σ(y − ŷ)²/Σ(y − ȳ)² against the model it stands for; 0 for a model that stands for itself."""
        return 0.0

    def outside(self, theta: np.ndarray) -> np.ndarray:
        """Say which points lie outside the range the model is known to be good for; a model itself has no such range.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI, in the order of `free`.

        Returns
        -------
        ndarray of bool, shape (run,)
            All False, unless a kind of model says otherwise.
        """
        return np.zeros(len(theta), dtype=bool)

    def check_fitness(self) -> None:  # noqa: B027
        """Refuse to stand in a posterior; a surrogate that is known to be poor does."""

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
        )

    @property
    @abstractmethod
    def content_hash(self) -> str:
        """Hash of everything a response depends on beside parameters and excitation."""

    def parameters(self, design: Design | np.ndarray) -> np.ndarray:
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
        theta = np.asarray(design, dtype=np.float64)
        if theta.ndim != 2 or theta.shape[1] != len(self.free):
            raise InputError(
                "parameters",
                f"an array of shape {theta.shape}",
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


class JaxModel(Model):
    """A model whose response is a pure JAX function of many runs.

    Inside JAX histories are [time, channel, run], as the scan over time makes them and as vector units like them; `simulate`
    turns them into [run, time, channel].

    Attributes
    ----------
    loops : bool
        Whether a response is a loop over time, which XLA runs on one core, so that batches are spread over the cores.
    """

    loops: ClassVar[bool] = True

    @abstractmethod
    def response(self, theta: Any, excitation: Excitation, stages: Any) -> tuple[Any, Any]:
        """Respond inside JAX; `excitation` gives only its kind, step and length.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : Excitation
            Its type, dt and lead-in decide what is compiled.
        stages : jax.Array, shape (time − 1, substeps, 3)
            Its values, from `Excitation.stage_values`.

        Returns
        -------
        tuple of jax.Array
            Values (time, channel, run), and whether the state stayed finite to the end (run,).
        """

    substeps: int

    def error_variance(self, theta: Any, excitation: Excitation, values: Any) -> Any:
        """Variance of the model's own error beside what it stands for, averaged over time, inside JAX.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : Excitation
            What drives it.
        values : jax.Array, shape (time, channel, run)
            Its response there.

        Returns
        -------
        jax.Array, shape (channel, run)
            In the square of each channel's SI unit; zero for a model that stands for itself.
        """
        from structid.device import jnp

        return jnp.zeros(values.shape[1:])

    def reduction(self, excitation: Excitation, values: np.ndarray, channels: tuple[str, ...]) -> Any:
        """What a misfit to a measurement needs of it, for a model that has a shorter way to it than the response.

        Parameters
        ----------
        excitation : Excitation
            What drives the model.
        values : ndarray, shape (time, channel)
            The measurement.
        channels : tuple of str
            Its channels.

        Returns
        -------
        tree of arrays or None
            For `squared_misfit` and `marginal_log_likelihood`; None where there is no shorter way.
        """
        return None

    def marginal_log_likelihood(
        self, theta: Any, excitation: Excitation, reduction: Any, variance: Any
    ) -> tuple[Any, Any] | None:
        """Log density of a measurement with independent errors, the model's own error integrated out, inside JAX.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : Excitation
            What drives it.
        reduction : tree of arrays
            What is needed of the measurement; see `reduction`.
        variance : jax.Array, shape (channel, run)
            Of the independent errors.

        Returns
        -------
        tuple of jax.Array, or None
            Log density and whether it is finite (run,); None for a model that does not know the law of its error.
        """
        return None

    def squared_misfit(self, theta: Any, excitation: Excitation, reduction: Any) -> tuple[Any, Any]:
        """Sum over time of (measured − response)², inside JAX, by a model's shorter way.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : Excitation
            What drives it.
        reduction : tree of arrays
            What is needed of the measurement; see `reduction`.

        Returns
        -------
        tuple of jax.Array
            Sums (channel, run) and whether they are finite (run,).
        """
        raise NotImplementedError(f"{type(self).__name__} has no shorter way to a misfit than its response")

    def run(
        self,
        theta: np.ndarray,
        excitation: Excitation,
        progress: Progress | None = None,
        map: Map | None = None,
    ) -> Histories:
        """Run rows of parameters in batches, spread over the machine's cores.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`.
        excitation : Excitation
            What drives it.
        progress : callable, optional
            Told how many runs are done.
        map : callable, optional
            Not used.

        Returns
        -------
        Histories
            ``values[run, time, channel]`` in SI. A run whose state leaves the finite range is `Status.DIVERGED`: it
            has its time of failure, and NaN from there on.
        """
        run = self._compiled(excitation)
        stages = excitation.stage_values(self.substeps)
        parts = []
        for start in range(0, len(theta), LARGEST_BATCH):
            parts.append(run(theta[start : start + LARGEST_BATCH], stages))
            if progress is not None:
                progress(min(start + LARGEST_BATCH, len(theta)), len(theta))
        # [time, channel, run] in memory, seen as [run, time, channel] without a copy.
        values = np.moveaxis(_joined([p[0] for p in parts]), 2, 0)
        finite = _joined([p[1] for p in parts])
        return _with_status(values, finite, excitation, self.channels)

    def compiled_for(self, excitation: Excitation) -> tuple[Any, ...]:
        """Return what a compiled response depends on.

        Parameters
        ----------
        excitation : Excitation
            The excitation.

        Returns
        -------
        tuple
            A dictionary key; of the excitation itself only kind, step, length and lead-in, unless a model says otherwise.
        """
        return response_key(excitation)

    def _compiled(self, excitation: Excitation) -> Callable[..., Any]:
        from structid.device import over_runs

        cache: dict[Any, Any] = self.__dict__.setdefault("_compiled_responses", {})
        key = self.compiled_for(excitation)
        if key not in cache:

            def responses(theta: Any, stages: Any) -> tuple[Any, Any]:
                return self.response(theta, excitation, stages)

            cache[key] = over_runs(responses, run_axes=(2, 0))
        return cache[key]


def response_key(excitation: Excitation) -> tuple[Any, ...]:
    """Return what a compiled response depends on: kind, step, length, lead-in; not the values.

    Parameters
    ----------
    excitation : Excitation
        The excitation.

    Returns
    -------
    tuple
        A dictionary key.
    """
    return (
        excitation.kind,
        excitation.dt,
        len(excitation),
        excitation.interpolation,
        excitation.lead_in_periods,
    )


def _one_for_each_run(excitations: Sequence[Excitation], runs: int) -> list[Excitation]:
    given = list(excitations) if isinstance(excitations, (list, tuple)) else []
    if not given or not all(isinstance(e, Excitation) for e in given):
        raise InputError(
            "simulate",
            f"a {type(excitations).__name__} as the excitation",
            "a GroundMotion, ForceHistory, …, or a list of them",
        )
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


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)


def _with_status(
    values: np.ndarray, finite: np.ndarray, excitation: Excitation, channels: tuple[str, ...]
) -> Histories:
    """Mark the runs whose state left the finite range, and blank what comes after."""
    time = np.full(len(values), np.nan)
    for run in np.flatnonzero(~finite):
        good = np.isfinite(values[run]).all(axis=1)
        first_bad = len(good) if good.all() else int(np.argmin(good))
        values[run, first_bad:] = np.nan
        time[run] = min(first_bad, len(good) - 1) * excitation.dt
    status = np.where(finite, Status.DONE, Status.DIVERGED)
    reasons = tuple("" if good else f"not finite from {t:g} s on" for good, t in zip(finite, time, strict=True))
    return Histories(values, excitation.dt, channels, status, time, excitation.name, reasons)
