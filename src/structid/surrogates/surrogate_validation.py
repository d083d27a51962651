"""Validation of a surrogate: errors over independent runs.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import scipy
from jaxtyping import Bool, Float

from structid.campaign.runs import Runs
from structid.core.channels import base_channel, standard_unit
from structid.core.errors import InputError
from structid.core.progress import Progress
from structid.core.units import factor
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.probability.designs import Design

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BATCH = 250
"""Number of runs that are compared in one batch."""

COVERED = 500
"""Approximate number of runs for the coverage, because the standard deviation may cost more than the prediction."""

COVERAGE_FACTOR = 1.96
"""Half-width of the central 95 % interval of a normal distribution, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Validation:
    """Result of the comparison of a surrogate with independent runs."""

    channels: tuple[str, ...]
    # ε = Σ(y − ŷ)²/Σ(y − ȳ)² (thesis eqs. 2.69, 2.70); infinite if the surrogate diverged
    errors: Float[np.ndarray, "run channel"]
    peaks: Float[np.ndarray, "run channel"]  # largest |y| of the model, in SI
    predicted_peaks: Float[np.ndarray, "run channel"]  # Largest |ŷ| of the surrogate
    coverage: float  # fraction of samples within 1.96 predicted standard deviations
    outside: int  # number of runs with parameters outside the range of the fit
    left_out: int  # number of failed runs of the model
    shown: tuple[int, int, int]  # indices of the best, the median and the worst run
    # Histories of the model and of the surrogate for these three runs (3, time, channel), and the time step [s]
    histories: tuple[np.ndarray, np.ndarray, float]
    # Thinned samples of the model and of the surrogate from all runs (sample, channel)
    clouds: tuple[np.ndarray, np.ndarray]

    @property
    def overall(self) -> np.ndarray:
        """Mean error over the channels, infinite for a run that diverged, shape (run,)."""
        return np.asarray(self.errors.mean(axis=1))

    @property
    def mean(self) -> float:
        """Mean error; infinite if a run diverged."""
        return float(self.overall.mean())

    @property
    def median(self) -> float:
        """Median error."""
        return float(np.median(self.overall))

    @property
    def q95(self) -> float:
        """Error exceeded by 5 % of the runs."""
        return float(np.quantile(self.overall, 0.95, method="higher"))

    @property
    def worst(self) -> float:
        """Largest error; infinite if a run diverged."""
        return float(self.overall.max())

    @property
    def diverged(self) -> int:
        """Number of runs that diverged."""
        return int(np.count_nonzero(~np.isfinite(self.overall)))

    @property
    def peak_error(self) -> float:
        """Mean relative error of the peak response, | max|ŷ| − max|y| | / max|y|, without diverged runs."""
        relative = np.abs(self.predicted_peaks - self.peaks) / self.peaks
        return float(relative[np.isfinite(self.overall)].mean())

    @property
    def per_channel(self) -> dict[str, dict[str, float]]:
        """Mean, median, 95 % quantile and worst error of each channel."""
        return {c: _measures(e) for c, e in zip(self.channels, self.errors.T, strict=True)}

    def summary(self) -> dict[str, float]:
        """Return all results by name."""
        return {
            "runs": len(self.errors),
            "mean": self.mean,
            "median": self.median,
            "q95": self.q95,
            "worst": self.worst,
            "diverged": self.diverged,
            "peak_error": self.peak_error,
            "coverage": self.coverage,
            "outside": self.outside,
            "left_out": self.left_out,
        }

    def __str__(self) -> str:
        lines = [
            f"validated on {len(self.errors)} runs: mean error {self.mean:.2e}, median {self.median:.2e}, "
            f"95 % {self.q95:.2e}, worst {self.worst:.2e}, {self.diverged} diverged",
            f"mean error of the peak response {self.peak_error:.2%}; "
            f"{self.coverage:.1%} of the samples within 1.96 predicted standard deviations",
        ]
        if len(self.channels) > 1:
            lines += [f"{c}: mean {e['mean']:.2e}, worst {e['worst']:.2e}" for c, e in self.per_channel.items()]
        if self.outside or self.left_out:
            lines.append(f"{self.outside} runs outside the fitted range, {self.left_out} other runs left out")
        return "\n".join(lines)

    def plot(self, channel: str | None = None, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the best, median and worst run, all peaks, thinned samples, and the distribution of the errors."""
        from structid.figures import surrogate as figures

        index = 0 if channel is None else self.channels.index(channel)
        name = self.channels[index]
        unit = standard_unit(name).display
        scale = factor(unit)
        true, predicted, dt = self.histories
        return figures.validation(
            np.arange(true.shape[1]) * dt,
            true[:, :, index] / scale,
            predicted[:, :, index] / scale,
            self.errors[list(self.shown), index],
            self.peaks[:, index] / scale,
            self.predicted_peaks[:, index] / scale,
            self.clouds[0][:, index] / scale,
            self.clouds[1][:, index] / scale,
            self.errors[:, index],
            name,
            unit,
            _displacement(true[2, :, index], predicted[2, :, index], dt) if base_channel(name) == "velocity" else None,
            save=save,
        )


def _displacement(true: np.ndarray, predicted: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Integrate two velocities to displacements [mm], which shows accumulated errors (figure 3.16 of the thesis)."""
    both = (scipy.integrate.cumulative_trapezoid(v, dx=dt, initial=0.0) / factor("mm") for v in (true, predicted))
    first, second = both
    return first, second


def _measures(errors: np.ndarray) -> dict[str, float]:
    q95 = np.quantile(errors, 0.95, method="higher")
    return {
        "mean": float(errors.mean()),
        "median": float(np.median(errors)),
        "q95": float(q95),
        "worst": float(errors.max()),
    }


def relative_errors(
    true: Float[np.ndarray, "run time channel"], predicted: Float[np.ndarray, "run time channel"]
) -> Float[np.ndarray, "run channel"]:
    """Return ε = Σ(y − ŷ)²/Σ(y − ȳ)² over time; infinite if a prediction is not finite."""
    spread = np.sum((true - true.mean(axis=1, keepdims=True)) ** 2, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.sum((true - predicted) ** 2, axis=1) / spread
    return np.where(np.isfinite(error), error, np.inf)


class Validated(Protocol):
    """Interface of a surrogate for the validation."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of the response."""

    def parameters(self, design: Design) -> Float[np.ndarray, "run parameter"]:
        """Sort the columns of a design into the order of the parameters."""

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse an excitation for which the surrogate is not valid."""

    def run(self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation) -> Histories:
        """Compute the response without a warning about points outside the range."""

    def outside(self, theta: Float[np.ndarray, "run parameter"]) -> Bool[np.ndarray, " run"]:
        """Return a mask of the points outside the range."""

    def standard_deviation(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        values: Float[np.ndarray, "run time channel"],
    ) -> Float[np.ndarray, "run time channel"]:
        """Return the standard deviation of the surrogate's error."""


def validate(surrogate: Validated, runs: Runs, progress: Progress | None = None) -> Validation:
    """Compare a surrogate with runs of the model it replaces, in batches."""
    if not isinstance(runs, Runs):
        raise InputError("validate", f"a {type(runs).__name__}", "Runs, the result of a Campaign")
    missing = [c for c in surrogate.channels if c not in runs.channels]
    if missing:
        raise InputError("validate", f"runs without the channel '{missing[0]}'", ", ".join(surrogate.channels))
    done = runs[runs.done]
    if len(done) == 0:
        raise InputError("validate", "no finished run", "one or more finished runs")
    order: list[np.ndarray] = []
    result: list[_Compared] = []
    compared = 0
    every = max(1, len(done) // COVERED)
    for number in np.unique(done.record_of_run):
        rows = np.flatnonzero(done.record_of_run == number)
        for start in range(0, len(rows), BATCH):
            part = rows[start : start + BATCH]
            result.append(_compare(surrogate, done[part].on(int(number)), every))
            order.append(part)
            compared += len(part)
            if progress is not None:
                progress(compared, len(done))
    back = np.argsort(np.concatenate(order))
    errors = np.concatenate([f.errors for f in result])[back]
    shown = _shown(errors.mean(axis=1))
    inside = np.concatenate([f.inside for f in result])
    return Validation(
        surrogate.channels,
        errors,
        np.concatenate([f.peaks for f in result])[back],
        np.concatenate([f.predicted_peaks for f in result])[back],
        float(inside.mean()) if len(inside) else float("nan"),
        int(np.count_nonzero(surrogate.outside(surrogate.parameters(done.design)))),
        len(runs) - len(done),
        shown,
        _histories(surrogate, done, shown),
        tuple(np.concatenate([f.cloud[i] for f in result]) for i in (0, 1)),  # type: ignore[arg-type]
    )


@dataclass(frozen=True, eq=False)
class _Compared:
    """Results of one batch: errors, peaks and coverage per run, and thinned samples of the model and the surrogate."""

    errors: np.ndarray
    peaks: np.ndarray
    predicted_peaks: np.ndarray
    inside: np.ndarray
    cloud: tuple[np.ndarray, np.ndarray]


def _compare(surrogate: Validated, runs: Runs, every: int) -> _Compared:
    true = _values(surrogate, runs)
    predicted = _predicted(surrogate, runs)
    chosen = np.arange(0, len(runs), every)
    theta = surrogate.parameters(runs.design)[chosen]
    deviation = surrogate.standard_deviation(theta, runs.records[0], predicted[chosen])
    within = np.abs(true[chosen] - predicted[chosen]) <= COVERAGE_FACTOR * deviation
    thin = (chosen[:: max(1, len(chosen) // 10)], slice(None, None, max(1, true.shape[1] // 200)))
    return _Compared(
        relative_errors(true, predicted),
        np.abs(true).max(axis=1),
        np.abs(predicted).max(axis=1),
        within.mean(axis=(1, 2)),
        (true[thin].reshape(-1, true.shape[2]), predicted[thin].reshape(-1, true.shape[2])),
    )


def _values(surrogate: Validated, runs: Runs) -> np.ndarray:
    columns = [runs.channels.index(c) for c in surrogate.channels]
    return runs.values[:, : len(runs.records[0]), columns]


def _predicted(surrogate: Validated, runs: Runs) -> np.ndarray:
    surrogate.check_excitation(runs.records[0])
    # Points outside the range are counted, but cause no warning or error here.
    return surrogate.run(surrogate.parameters(runs.design), runs.records[0]).values


def _shown(overall: np.ndarray) -> tuple[int, int, int]:
    ranked = np.argsort(overall)
    return int(ranked[0]), int(ranked[len(ranked) // 2]), int(ranked[-1])


def _histories(surrogate: Validated, runs: Runs, shown: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, float]:
    """Return histories (run, time, channel) of the model and the surrogate for the plotted runs, and the time step."""
    singles: list[Any] = [runs[np.array([row])].on(int(runs.record_of_run[row])) for row in shown]
    samples = max(len(s.records[0]) for s in singles)
    true, predicted = (np.full((len(shown), samples, len(surrogate.channels)), np.nan) for _ in range(2))
    for i, single in enumerate(singles):
        count = len(single.records[0])
        true[i, :count] = _values(surrogate, single)[0]
        predicted[i, :count] = _predicted(surrogate, single)[0]
    return true, predicted, singles[0].records[0].dt
