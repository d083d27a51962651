"""The interface of every surrogate of response histories: a fitted model with an error estimate and a range."""

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
    """Interface of the settings of every kind of surrogate.

    Attributes
    ----------
    warm_start : bool
        Whether `fit` accepts ``start=``, a surrogate fitted to fewer runs, as the start of its search.
    weighted : bool
        Whether `fit` accepts ``weights=``, the weights of the errors of the runs.
    """

    warm_start: ClassVar[bool]
    weighted: ClassVar[bool]

    @property
    def limit(self) -> float:
        """Largest mean relative error accepted in a posterior."""

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against planned runs.

        Parameters
        ----------
        design : Design
            Points of the planned runs.
        records : sequence of Excitation
            Records of the planned runs.
        channels : sequence of str
            Channels of the planned runs.

        Raises
        ------
        InputError
            If no surrogate can be fitted to the planned runs.
        """

    def fit(self, runs: Runs, progress: Progress | None = None) -> Surrogate:
        """Fit a surrogate to runs.

        Parameters
        ----------
        runs : Runs
            Runs of the replaced model.
        progress : callable, optional
            Callback whose arguments are the finished percentage of the fit, and 100.

        Returns
        -------
        Surrogate
            The fitted surrogate.
        """


class Surrogate(TraceableModel, StandIn):
    """A model fitted to runs of another model.

    Parameters
    ----------
    fit : Fit
        Record of the fit.

    Attributes
    ----------
    validation : Validation or None
        Result of the last call of `validate`.

    Examples
    --------
    A fitted surrogate is a model with an error estimate; `tests/architecture/trial/new_surrogate.py` is a complete example.

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
        self.trusted = False  # allowed in a posterior whatever its error; see `trust`

    # --- to be implemented by each kind of surrogate ------------------------------------------------------------

    @abstractmethod
    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse an excitation for which the surrogate is not valid."""

    @abstractmethod
    def standard_deviation(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        values: Float[np.ndarray, "run time channel"],
    ) -> Float[np.ndarray, "run time channel"]:
        """Return the standard deviation of the surrogate's error.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI.
        excitation : Excitation
            Excitation of the model.
        values : ndarray, shape (run, time, channel)
            Predictions of the surrogate.

        Returns
        -------
        ndarray, shape (run, time, channel)
            Standard deviations in SI.
        """

    @property
    def kind_in_words(self) -> str:
        """Kind of the surrogate, as a phrase to follow the article "a"."""
        return f"{self.fitted.kind} surrogate"

    @property
    def structure_in_words(self) -> list[tuple[str, str]]:
        """Additional lines of a report besides the settings: names and values."""
        return []

    @abstractmethod
    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the contents of the surrogate other than `fitted`, for a file.

        Returns
        -------
        tuple of dict
            JSON-compatible contents, and arrays.
        """

    @classmethod
    @abstractmethod
    def from_plain(cls, fit: Fit, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> Surrogate:
        """Rebuild a surrogate from the result of `to_plain`.

        Parameters
        ----------
        fit : Fit
            Record of the fit.
        plain : dict
            JSON-compatible contents.
        arrays : mapping of str to ndarray
            Arrays of the surrogate.

        Returns
        -------
        Surrogate
            The same surrogate.
        """

    # --- common to all kinds ------------------------------------------------------------------------------------

    @property
    def stand_in(self) -> StandIn:
        """The surrogate itself, since it replaces the model to which it was fitted."""
        return self

    @property
    def relative_error(self) -> float:
        """Mean relative error; see `error`."""
        return self.error

    @property
    def error(self) -> float:
        """Mean relative error from the validation, or, without a validation, estimated during the fit."""
        return self.fitted.error if self.validation is None else self.validation.mean

    def before_run(self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation) -> None:
        """Check the excitation, and warn of points outside the range of the design."""
        self.check_excitation(excitation)
        if not np.isfinite(theta).all():
            bad = int(np.count_nonzero(~np.isfinite(theta).all(axis=1)))
            raise InputError(f"{self.fitted.kind}.simulate", f"{bad} points are not finite", "finite numbers")
        outside = self.outside(theta)
        if self.fitted.outside == "allow" or not outside.any():
            return
        came = f"{np.count_nonzero(outside)} of {len(theta)} points are outside the range of the {self.fitted.runs} training runs"
        allowed = self._range()
        if self.fitted.outside == "refuse":
            raise InputError(
                f"{self.fitted.kind}.simulate",
                came,
                allowed,
                "Fit the surrogate to runs at such points, or set outside=….",
            )
        warnings.warn(
            f"{self.fitted.kind}: {came} ({allowed}). There the response is computed {self._beyond_in_words}.",
            StructidWarning,
            stacklevel=3,
        )

    def outside(self, theta: Float[np.ndarray, "run parameter"]) -> Bool[np.ndarray, " run"]:
        """Return a mask of the points outside the range of the design."""
        return np.asarray(self._beyond(theta))

    def _beyond(self, theta: Any) -> Any:
        return ((theta < self.fitted.low) | (theta > self.fitted.high)).any(axis=1)

    def held_inside(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run parameter"]:
        """Move points beyond the permitted extrapolation to its boundary, since polynomials diverge far from the design.

        Parameters
        ----------
        theta : ndarray or jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        array, shape (run, parameter)
            Points, with the array type of `theta`.
        """
        return namespace(theta).clip(theta, *self.fitted.ends)

    @property
    def _beyond_in_words(self) -> str:
        if not self.fitted.reach:
            return "at the nearest point of the range"
        return f"by extrapolation up to {self.fitted.reach:g} times the range's width, and beyond this limit at its nearest point"

    def admitted(self, theta: Float[Array, "run parameter"]) -> Bool[Array, " run"]:
        """Return a mask of the points for a posterior: all points, unless points outside the range are refused.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        jax.Array of bool, shape (run,)
            False for points without density.
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
        """Simulate, on request with the uncertainty of the surrogate.

        Parameters
        ----------
        design : Design or array-like, shape (run, parameter)
            Parameters in SI.
        excitation : Excitation
            Excitation of the model.
        return_std : bool
            Also return the standard deviation of the surrogate's error.

        Returns
        -------
        Histories, or tuple of Histories and ndarray (run, time, channel)
            Responses, and standard deviations in SI.
        """
        histories = self.simulate(design, excitation)
        if not return_std:
            return histories
        theta = self.parameters(design)
        return histories, self.standard_deviation(theta, excitation, histories.values)

    def sampled(
        self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation, rng: np.random.Generator
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw responses from the error estimate of the surrogate.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI; one draw for each point.
        excitation : Excitation
            Excitation of the model.
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        ndarray, shape (run, time, channel)
            Responses in SI. By default, each drawn error has one sign over time, which is the worst case.
        """
        values = self.run(theta, excitation).values
        error = rng.standard_normal((len(theta), 1, values.shape[2]))
        return np.asarray(values + error * self.standard_deviation(theta, excitation, values))

    def validate(self, runs: Runs, progress: Progress | None = None, fitted: bool = False) -> Validation:
        """Compare the surrogate with independent runs. The stored result decides whether a posterior may use the surrogate.

        Parameters
        ----------
        runs : Runs
            Runs of the replaced model.
        progress : callable, optional
            Callback whose arguments are the number of compared runs and the total number.
        fitted : bool
            Allow training runs, to determine the residuals of the fit. These residuals give no information about other
            runs, so the result is not stored.

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
                came, allowed = f"{again} of the runs are training runs", "runs that were not used in the fit"
                raise InputError(
                    f"{self.fitted.kind}.validate",
                    came,
                    allowed,
                    "Draw other points: space.sample(500, seed=2). For the residuals of the training runs: fitted=True.",
                )
        self.validation = validate(self, runs, progress)
        return self.validation

    def trust(self) -> None:
        """Allow the surrogate in a posterior whatever its error; the caller takes responsibility."""
        self.trusted = True

    def check_fitness(self) -> None:
        """Refuse use in a posterior if the error exceeds the limit."""
        if self.trusted or self.error <= self.fitted.limit:
            return
        source = "estimated during the fit" if self.validation is None else "on the validation runs"
        raise InputError(
            f"{self.fitted.kind} in a posterior",
            f"a mean relative error of {self.error:.2g} ({source})",
            f"an error of {self.fitted.limit:.2g} or less",
            "Fit the surrogate to more runs, raise its limit, or call trust() if this error is acceptable.",
        )

    def with_limit(self, limit: float) -> Self:
        """Return a copy of this surrogate with another error limit.

        Parameters
        ----------
        limit : float
            Largest mean error accepted in a posterior.

        Returns
        -------
        Surrogate
            The copy.
        """
        other = copy.copy(self)
        other.fitted = replace(self.fitted, limit=limit)
        return other

    def search_range(self) -> dict[str, tuple[float, float]]:
        """Return the range of the design, since a search beyond it would not be reliable."""
        edges = zip(self.free, self.fitted.low, self.fitted.high, strict=True)
        return {name: (float(low), float(high)) for name, low, high in edges}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the surrogate to an HDF5 file, completely or not at all.

        Parameters
        ----------
        path : path-like
            The file; an existing file is replaced.

        Returns
        -------
        Path
            The file written.
        """
        return storage.write(path, self.fitted, *self.to_plain(), self.validation)

    @property
    def content_hash(self) -> str:
        """Hash of all data on which a response depends."""
        plain, arrays = self.to_plain()
        fit, prior = self.fitted, self.space.to_plain()
        # Derived parameters that are functions appear only by name in a file, and no response depends on them.
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
        failed = f", {fit.left_out} other runs left out" if fit.left_out else ""
        lines = [
            f"{fit.kind} of {', '.join(self.channels)} over {', '.join(self.free) or 'no parameter'}",
            f"  fitted to {fit.runs} runs{failed} in {fit.seconds:.1f} s; mean error estimated during the fit {fit.error:.1e}",
        ]
        if self.validation is not None:
            lines += [f"  {line}" for line in str(self.validation).splitlines()]
        return "\n".join(lines)
