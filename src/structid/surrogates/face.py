"""What every surrogate of response histories is: a model fitted to runs, that knows how good it is and where it was fitted."""

from __future__ import annotations

import time
import warnings
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np

from structid.errors import InputError, StructidWarning
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.journal import digest
from structid.models.face import JaxModel, Progress
from structid.probability.space import Design, ParameterSpace
from structid.runs import Runs
from structid.surrogates.array_module import namespace
from structid.surrogates.validation import Validation, validate

FEWEST_RUNS = 10
"""Fewer finished runs than this are taken for a mistake."""


@dataclass(frozen=True, eq=False)
class Fit:
    """How a surrogate came about.

    Parameters
    ----------
    kind : str
        Its settings' class, such as ``"PODKriging"``.
    settings : dict
        Its settings, as JSON can say them.
    space : ParameterSpace
        The parameters.
    channels : tuple of str
        Of the histories.
    excitation : str
        Kind of the records.
    dt : float
        Their time step [s].
    low, high : ndarray, shape (parameter,)
        The range of the design.
    runs, left_out : int
        Runs it was fitted to, those held out among them, and those that had failed.
    error : float
        Mean relative error estimated while fitting: by leaving runs out, or over the runs held out.
    limit : float
        Largest mean error with which it may stand in a posterior.
    outside : str
        What happens beyond the range: ``"warn"``, ``"refuse"``, ``"allow"``.
    seconds : float
        Wall time of the fit.
    seen : tuple of str
        A digest of each run it was fitted to: those cannot validate it.
    """

    kind: str
    settings: dict[str, Any]
    space: ParameterSpace
    channels: tuple[str, ...]
    excitation: str
    dt: float
    low: np.ndarray
    high: np.ndarray
    runs: int
    left_out: int
    error: float
    limit: float
    outside: Literal["warn", "refuse", "allow"]
    seconds: float = field(default=float("nan"))
    seen: tuple[str, ...] = ()


class SurrogateSettings(Protocol):
    """What the settings of every kind of surrogate can do."""

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
        """

    def fit(self, runs: Runs, progress: Progress | None = None) -> Surrogate:
        """Fit to runs.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for.
        progress : callable, optional
            Told how far the fit is, in hundredths.

        Returns
        -------
        Surrogate
            The fitted surrogate.
        """


class Surrogate(JaxModel):
    """A model fitted to runs of another one.

    Parameters
    ----------
    fit : Fit
        How it came about.

    Attributes
    ----------
    validation : Validation or None
        What the last call of `validate` found.
    """

    substeps = 1

    def __init__(self, fit: Fit) -> None:
        self.fitted = fit
        self.space = fit.space
        self.free = fit.space.names
        self.channels = fit.channels
        self.validation: Validation | None = None
        self._trusted = False

    # --- what a kind of surrogate implements --------------------------------------------------------------------

    @abstractmethod
    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse an excitation the surrogate knows nothing of.

        Parameters
        ----------
        excitation : Excitation
            What is to drive it.

        Raises
        ------
        InputError
            If it is of another kind or step, or another record where only the fitted ones will do.
        """

    @abstractmethod
    def standard_deviation(self, theta: np.ndarray, excitation: Excitation, values: np.ndarray) -> np.ndarray:
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

    @abstractmethod
    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Give what the surrogate consists of beside `fitted`, for a file.

        Returns
        -------
        tuple of dict
            What JSON can say, and arrays.
        """

    # --- the same for all ---------------------------------------------------------------------------------------

    @property
    def relative_error(self) -> float:
        """Mean relative error; see `error`."""
        return self.error

    @property
    def error(self) -> float:
        """Mean relative error: as validated, or as estimated while fitting."""
        return self.fitted.error if self.validation is None else self.validation.mean

    def before_run(self, theta: np.ndarray, excitation: Excitation) -> None:
        """Check the excitation, and say which points lie outside the range of the design.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI.
        excitation : Excitation
            What drives them.

        Raises
        ------
        InputError
            If the excitation is not one the surrogate knows, or points lie outside and are to be refused.
        """
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
            f"{self.fitted.kind}: {came} it was fitted to ({allowed}); there it responds as at the edge.",
            StructidWarning,
            stacklevel=3,
        )

    def outside(self, theta: np.ndarray) -> np.ndarray:
        """Say which points lie outside the range of the design.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI.

        Returns
        -------
        ndarray of bool, shape (run,)
            True where some parameter is below or above everything the surrogate was fitted to.
        """
        return np.asarray(self._beyond(theta))

    def _beyond(self, theta: Any) -> Any:
        return ((theta < self.fitted.low) | (theta > self.fitted.high)).any(axis=1)

    def held_inside(self, theta: Any) -> Any:
        """Move points outside the range of the design to its edge: beyond it nothing is known, and polynomials run away.

        Parameters
        ----------
        theta : ndarray or jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        array, shape (run, parameter)
            Of the kind `theta` is.
        """
        return namespace(theta).clip(theta, self.fitted.low, self.fitted.high)

    def admitted(self, theta: Any) -> Any:
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

    def validate(self, runs: Runs, progress: Progress | None = None) -> Validation:
        """Compare with runs the surrogate was not fitted to, and keep the outcome: it decides whether it may be used.

        Parameters
        ----------
        runs : Runs
            Runs of the model it stands for.
        progress : callable, optional
            Told how many are compared.

        Returns
        -------
        Validation
            Errors, peaks, coverage.
        """
        if isinstance(runs, Runs) and self.fitted.seen:
            again = len(set(self.fitted.seen) & set(run_digests(runs)))
            if again:
                raise InputError(
                    f"{self.fitted.kind}.validate",
                    f"{again} of the runs it was fitted to",
                    "runs it has not seen",
                    "Draw others: space.sample(500, seed=2).",
                )
        self.validation = validate(self, runs, progress)
        return self.validation

    def trust(self) -> None:
        """Let the surrogate stand in a posterior whatever its error: the caller knows better."""
        self._trusted = True

    def check_fitness(self) -> None:
        """Refuse to stand in a posterior with an error past the limit.

        Raises
        ------
        InputError
            If the validated error, or that estimated while fitting, is past `Fit.limit`, and nobody has called `trust`.
        """
        if self._trusted or self.error <= self.fitted.limit:
            return
        source = "estimated while fitting" if self.validation is None else "on the validation runs"
        raise InputError(
            f"{self.fitted.kind} in a posterior",
            f"a mean relative error of {self.error:.2g} ({source})",
            f"{self.fitted.limit:.2g} or less",
            "Fit it to more runs, raise its limit, or call trust() if that is good enough.",
        )

    def save(self, path: Any) -> Any:
        """Write the surrogate to an HDF5 file.

        Parameters
        ----------
        path : path-like
            The file.

        Returns
        -------
        Path
            The file written.
        """
        from structid.surrogates.storage import save

        return save(self, path)

    @property
    def content_hash(self) -> str:
        """Hash of everything a response depends on."""
        plain, arrays = self.to_plain()
        fit, prior = self.fitted, self.space.to_plain()
        # Derived parameters that are functions are named only in a file, and no response depends on them.
        told = [fit.kind, self.channels, fit.excitation, fit.dt, fit.outside, prior["marginals"], prior["correlation"]]
        return digest(told, fit.low, fit.high, plain, *[arrays[k] for k in sorted(arrays)])

    def __str__(self) -> str:
        fit = self.fitted
        failed = f", {fit.left_out} failed ones left out" if fit.left_out else ""
        lines = [
            f"{fit.kind} of {', '.join(self.channels)} over {', '.join(self.free) or 'no parameter'}",
            f"  fitted to {fit.runs} runs{failed} in {fit.seconds:.1f} s; mean error estimated while fitting {fit.error:.1e}",
        ]
        if self.validation is not None:
            lines += [f"  {line}" for line in str(self.validation).splitlines()]
        return "\n".join(lines)


def fitting_runs(where: str, runs: Any, fewest: int = FEWEST_RUNS) -> tuple[Runs, int]:
    """Check runs to fit to, and leave out those that failed.

    Parameters
    ----------
    where : str
        The function, for messages.
    runs : Runs
        What came.
    fewest : int
        Fewer finished runs are refused.

    Returns
    -------
    tuple of Runs and int
        The finished ones, and how many were left out.

    Raises
    ------
    InputError
        If there are too few, a value is not finite, or a channel does not vary.
    """
    if not isinstance(runs, Runs):
        raise InputError(where, f"a {type(runs).__name__}", "Runs, as a Campaign returns them")
    done = runs[runs.done]
    left_out = len(runs) - len(done)
    check_enough(where, len(done), f"{len(done)} finished runs and {left_out} others", fewest)
    if not np.isfinite(done.design.values).all():
        raise InputError(where, "parameters that are not finite", "finite numbers")
    spread = np.zeros(len(done.channels))
    for batch in done.batches():
        values = _known_samples(batch)
        if not all(np.isfinite(v).all() for v in values):
            raise InputError(
                where, "histories with values that are not finite in runs said to be done", "finite numbers",
                "Set their status, so that they are left out.",
            )  # fmt: skip
        spread = np.maximum(spread, np.max([np.ptp(v, axis=0) for v in values], axis=0))
    constant = [c for c, s in zip(done.channels, spread, strict=True) if s == 0.0]
    if constant:
        raise InputError(where, f"the channel '{constant[0]}', constant in every run", "channels that vary")
    return done, left_out


def checked_weights(where: str, weights: np.ndarray, runs: Runs) -> np.ndarray:
    """Check how much runs count, and leave out those that failed.

    Parameters
    ----------
    where : str
        The function, for messages.
    weights : ndarray, shape (run,)
        Of all runs.
    runs : Runs
        The runs.

    Returns
    -------
    ndarray, shape (finished run,)
        One on average.

    Raises
    ------
    InputError
        If they are not as many positive numbers as there are runs.
    """
    weights = np.asarray(weights, dtype=np.float64)
    if weights.shape != (len(runs),) or not (np.isfinite(weights) & (weights > 0.0)).all():
        raise InputError(f"{where}: weights", f"an array of shape {weights.shape}", f"{len(runs)} positive numbers")
    kept = weights[runs.done]
    return np.asarray(kept / kept.mean())


def check_enough(where: str, runs: int, came: str, fewest: int = FEWEST_RUNS) -> None:
    """Refuse too few runs.

    Parameters
    ----------
    where : str
        The function, for messages.
    runs : int
        How many have finished, or will.
    came : str
        What to say of them.
    fewest : int
        How many there must be.

    Raises
    ------
    InputError
        If there are fewer.
    """
    if runs < fewest:
        raise InputError(where, came, f"{fewest} finished ones or more")


def _known_samples(runs: Runs) -> list[np.ndarray]:
    values = runs.values
    return [v[: len(runs.records[r])] for v, r in zip(values, runs.record_of_run, strict=True)]


def run_digests(runs: Runs) -> tuple[str, ...]:
    """Tell runs apart by their point and their record.

    Parameters
    ----------
    runs : Runs
        The runs.

    Returns
    -------
    tuple of str
        One for each.
    """
    hashes = [r.content_hash for r in runs.records]
    return tuple(
        digest(point, hashes[record])[:16] for point, record in zip(runs.design.values, runs.record_of_run, strict=True)
    )


def fitted_range(design: Design) -> tuple[np.ndarray, np.ndarray]:
    """Range of a design, a hundredth of its width wider, but not beyond the support of the prior.

    Parameters
    ----------
    design : Design
        Points.

    Returns
    -------
    tuple of ndarray, shape (parameter,)
        Smallest and largest values that count as inside.
    """
    low, high = design.values.min(axis=0, initial=np.inf), design.values.max(axis=0, initial=-np.inf)
    margin = 0.01 * (high - low)
    support = design.space.bounds
    return np.maximum(low - margin, support[:, 0]), np.minimum(high + margin, support[:, 1])


def common_step(where: str, records: Sequence[Excitation]) -> tuple[str, float]:
    """Return the kind and time step that all records share.

    Parameters
    ----------
    where : str
        The function, for messages.
    records : sequence of Excitation
        The records.

    Returns
    -------
    tuple of str and float
        Kind and step [s].

    Raises
    ------
    InputError
        If they differ.
    """
    kinds, steps = {r.kind for r in records}, {r.dt for r in records}
    if len(kinds) > 1 or max(steps) / min(steps) - 1.0 > 1e-9:
        raise InputError(
            where,
            f"records of {len(kinds)} kinds and the steps {', '.join(f'{s:g} s' for s in sorted(steps))}",
            "records of one kind and one step",
            "Resample them, or fit one surrogate for each.",
        )
    return kinds.pop(), records[0].dt


class Stopwatch:
    """Seconds since it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Seconds so far."""
        return time.perf_counter() - self._start
