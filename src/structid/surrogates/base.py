"""The interface of every surrogate of response histories: a model fitted to runs, with its error and its range."""

from __future__ import annotations

import copy
import os
import warnings
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from jaxtyping import Bool, Float

from structid.campaign.runs import Runs
from structid.core.arrays import Array
from structid.core.errors import InputError, StructidWarning
from structid.core.hashing import digest
from structid.core.progress import Progress
from structid.engine.array_module import namespace
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.models.base import StandIn
from structid.models.traceable import TraceableModel
from structid.probability.designs import Design
from structid.surrogates import storage
from structid.surrogates.fit import Fit, run_digests
from structid.surrogates.surrogate_validation import Validation, validate


class SurrogateSettings(Protocol):
    """What the settings of every kind of surrogate can do.

    Attributes
    ----------
    warm_start : bool
        Whether `fit` takes ``start=``, a surrogate fitted to fewer runs from which its search begins.
    weighted : bool
        Whether `fit` takes ``weights=``, how much the error of each run counts.
    """

    warm_start: ClassVar[bool]
    weighted: ClassVar[bool]

    @property
    def limit(self) -> float:
        """Largest mean relative error with which it may be used in a posterior."""

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against runs that are yet to be made.

        Parameters
        ----------
        design : Design
            Their points.
        records : sequence of Excitation
            What will drive them.
        channels : sequence of str
            What they will return.

        Raises
        ------
        InputError
            If no surrogate can be fitted to them.
        """

    def fit(self, runs: Runs, progress: Progress | None = None) -> Surrogate:
        """Fit to runs.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for.
        progress : callable, optional
            Called with the percentage of the fit that is done, and 100.

        Returns
        -------
        Surrogate
            The fitted surrogate.
        """


class Surrogate(TraceableModel, StandIn):
    """A model fitted to runs of another one.

    Parameters
    ----------
    fit : Fit
        How it came about.

    Attributes
    ----------
    validation : Validation or None
        What the last call of `validate` found.

    Examples
    --------
    A fitted surrogate is a model, with an error of its own; `tests/architecture/trial/new_surrogate.py` is a complete one.

    >>> import structid as si
    >>> space = si.ParameterSpace(stiffness=si.Uniform(5e6, 9e6))
    >>> model = si.BoucWen(mass=12e3, damping_ratio=0.03, alpha=0.05, beta=60.0, gamma=60.0, free=space.names)
    >>> record = si.GroundMotion.synthetic(seed=1).trim(0.0, 4.0)
    >>> surrogate = si.PODKriging().fit(si.Campaign(model, record, space.sample(20, seed=1)).run())
    >>> surrogate.simulate([[7e6]], record).values.shape
    (1, 401, 1)
    >>> surrogate.error < 0.01
    True
    """

    substeps = 1

    def __init__(self, fit: Fit) -> None:
        self.fitted = fit
        self.space = fit.space
        self.free = fit.space.names
        self.channels = fit.channels
        self.validation: Validation | None = None
        self.trusted = False  # whatever its error; see `trust`

    # --- what a kind of surrogate implements --------------------------------------------------------------------

    @abstractmethod
    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse an excitation the surrogate knows nothing about."""

    @abstractmethod
    def standard_deviation(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        values: Float[np.ndarray, "run time channel"],
    ) -> Float[np.ndarray, "run time channel"]:
        """Standard deviation of the surrogate's own error.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI.
        excitation : Excitation
            What drives it.
        values : ndarray, shape (run, time, channel)
            The predictions there.

        Returns
        -------
        ndarray, shape (run, time, channel)
            In SI.
        """

    @property
    def kind_in_words(self) -> str:
        """Its kind in a few words that follow "a"."""
        return f"{self.fitted.kind} surrogate"

    @property
    def structure_in_words(self) -> list[tuple[str, str]]:
        """Further lines of its report besides the settings: names and values."""
        return []

    @abstractmethod
    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Give what the surrogate consists of besides `fitted`, for a file.

        Returns
        -------
        tuple of dict
            What JSON can hold, and arrays.
        """

    @classmethod
    @abstractmethod
    def from_plain(cls, fit: Fit, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> Surrogate:
        """Make a surrogate again from what `to_plain` gave.

        Parameters
        ----------
        fit : Fit
            How it came about.
        plain : dict
            What JSON can hold.
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        Surrogate
            The same surrogate.
        """

    # --- the same for all ---------------------------------------------------------------------------------------

    @property
    def stand_in(self) -> StandIn:
        """Itself: it replaces the model it was fitted to."""
        return self

    @property
    def relative_error(self) -> float:
        """Mean relative error; see `error`."""
        return self.error

    @property
    def error(self) -> float:
        """Mean relative error: as validated, or as estimated during the fit."""
        return self.fitted.error if self.validation is None else self.validation.mean

    def before_run(self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation) -> None:
        """Check the excitation, and say which points lie outside the range of the design."""
        self.check_excitation(excitation)
        if not np.isfinite(theta).all():
            bad = int(np.count_nonzero(~np.isfinite(theta).all(axis=1)))
            raise InputError(f"{self.fitted.kind}.simulate", f"{bad} points that are not finite", "finite numbers")
        outside = self.outside(theta)
        if self.fitted.outside == "allow" or not outside.any():
            return
        came = f"{np.count_nonzero(outside)} of {len(theta)} points outside the range of the {self.fitted.runs} runs"
        allowed = self._range()
        if self.fitted.outside == "refuse":
            raise InputError(
                f"{self.fitted.kind}.simulate", came, allowed, "Fit it to more runs there, or allow it (outside=…)."
            )
        warnings.warn(
            f"{self.fitted.kind}: {came} it was fitted to ({allowed}); there it responds {self._beyond_in_words}.",
            StructidWarning,
            stacklevel=3,
        )

    def outside(self, theta: Float[np.ndarray, "run parameter"]) -> Bool[np.ndarray, " run"]:
        """Say which points lie outside the range of the design."""
        return np.asarray(self._beyond(theta))

    def _beyond(self, theta: Any) -> Any:
        return ((theta < self.fitted.low) | (theta > self.fitted.high)).any(axis=1)

    def held_inside(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run parameter"]:
        """Move points further outside the range of the design than it reaches to where it ends: polynomials run away.

        Parameters
        ----------
        theta : ndarray or jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        array, shape (run, parameter)
            Of the kind `theta` is.
        """
        return namespace(theta).clip(theta, *self.fitted.ends)

    @property
    def _beyond_in_words(self) -> str:
        if not self.fitted.reach:
            return "as at the edge"
        return f"by extrapolation, up to {self.fitted.reach:g} times that range, and as there further out"

    def admitted(self, theta: Float[Array, "run parameter"]) -> Bool[Array, " run"]:
        """Say which points a posterior may use: all, unless those outside are to be refused.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        jax.Array of bool, shape (run,)
            False has no density.
        """
        return ~self._beyond(theta) | (self.fitted.outside != "refuse")

    def _range(self) -> str:
        units, factors = self.space.units, self.space.factors
        low, high = self.fitted.low / factors, self.fitted.high / factors
        each = zip(self.free, low, high, strict=True)
        return ", ".join(f"{n} {a:.4g} to {b:.4g} {units[n]}".rstrip() for n, a, b in each)

    def predict(
        self, design: Design | np.ndarray, excitation: Excitation, return_std: bool = False
    ) -> Histories | tuple[Histories, np.ndarray]:
        """Simulate, with the surrogate's own uncertainty if asked for.

        Parameters
        ----------
        design : Design or array-like, shape (run, parameter)
            Parameters in SI.
        excitation : Excitation
            What drives it.
        return_std : bool
            Also give the standard deviation of the surrogate's error.

        Returns
        -------
        Histories, or tuple of Histories and ndarray (run, time, channel)
            In SI.
        """
        histories = self.simulate(design, excitation)
        if not return_std:
            return histories
        theta = self.parameters(design)
        return histories, self.standard_deviation(theta, excitation, histories.values)

    def sampled(
        self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation, rng: np.random.Generator
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw responses from what the surrogate knows of its own error.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI, a draw for each.
        excitation : Excitation
            What drives it.
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        ndarray, shape (run, time, channel)
            In SI. Unless the kind of surrogate knows better, an error keeps its sign over time: the worst that it can do.
        """
        values = self.run(theta, excitation).values
        error = rng.standard_normal((len(theta), 1, values.shape[2]))
        return np.asarray(values + error * self.standard_deviation(theta, excitation, values))

    def validate(self, runs: Runs, progress: Progress | None = None, fitted: bool = False) -> Validation:
        """Compare with runs the surrogate was not fitted to, and keep the outcome, which decides whether it may be used.

        Parameters
        ----------
        runs : Runs
            Runs of the model it stands for.
        progress : callable, optional
            Called with the number of compared runs and the total.
        fitted : bool
            Allow runs it was fitted to, to see what the fit leaves of them. That says nothing of other runs, so the outcome is not
            kept.

        Returns
        -------
        Validation
            Errors, peaks, coverage.
        """
        if fitted:
            return validate(self, runs, progress)
        if isinstance(runs, Runs) and self.fitted.seen:
            again = len(set(self.fitted.seen) & set(run_digests(runs)))
            if again:
                came, allowed = f"{again} of the runs it was fitted to", "runs it has not seen"
                raise InputError(
                    f"{self.fitted.kind}.validate",
                    came,
                    allowed,
                    "Draw others: space.sample(500, seed=2). To see what the fit leaves of its own runs: fitted=True.",
                )
        self.validation = validate(self, runs, progress)
        return self.validation

    def trust(self) -> None:
        """Allow the surrogate in a posterior whatever its error; the caller takes responsibility."""
        self.trusted = True

    def check_fitness(self) -> None:
        """Refuse to be used in a posterior if the error exceeds the limit."""
        if self.trusted or self.error <= self.fitted.limit:
            return
        source = "estimated while fitting" if self.validation is None else "on the validation runs"
        raise InputError(
            f"{self.fitted.kind} in a posterior",
            f"a mean relative error of {self.error:.2g} ({source})",
            f"{self.fitted.limit:.2g} or less",
            "Fit it to more runs, raise its limit, or call trust() if that is good enough.",
        )

    def with_limit(self, limit: float) -> Self:
        """Return this surrogate with another limit of its error.

        Parameters
        ----------
        limit : float
            Largest mean error with which it may be used in a posterior.

        Returns
        -------
        Surrogate
            A copy with that limit.
        """
        other = copy.copy(self)
        other.fitted = replace(self.fitted, limit=limit)
        return other

    def search_range(self) -> dict[str, tuple[float, float]]:
        """Range of the design: beyond it little is known of the model, and a search would lose its way."""
        edges = zip(self.free, self.fitted.low, self.fitted.high, strict=True)
        return {name: (float(low), float(high)) for name, low, high in edges}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the surrogate to an HDF5 file, whole or not at all.

        Parameters
        ----------
        path : path-like
            The file; an existing one is replaced.

        Returns
        -------
        Path
            The file written.
        """
        return storage.write(path, self.fitted, *self.to_plain(), self.validation)

    @property
    def content_hash(self) -> str:
        """Hash of everything a response depends on."""
        plain, arrays = self.to_plain()
        fit, prior = self.fitted, self.space.to_plain()
        # Derived parameters that are functions are named only in a file, and no response depends on them.
        contents = [
            fit.kind,
            self.channels,
            fit.excitation,
            fit.dt,
            fit.outside,
            prior["marginals"],
            prior["correlation"],
        ]
        contents += [fit.reach] * (fit.reach > 0.0)
        return digest(contents, fit.low, fit.high, plain, *[arrays[k] for k in sorted(arrays)])

    def __str__(self) -> str:
        fit = self.fitted
        failed = f", {fit.left_out} others left out" if fit.left_out else ""
        lines = [
            f"{fit.kind} of {', '.join(self.channels)} over {', '.join(self.free) or 'no parameter'}",
            f"  fitted to {fit.runs} runs{failed} in {fit.seconds:.1f} s; mean error estimated while fitting {fit.error:.1e}",
        ]
        if self.validation is not None:
            lines += [f"  {line}" for line in str(self.validation).splitlines()]
        return "\n".join(lines)
