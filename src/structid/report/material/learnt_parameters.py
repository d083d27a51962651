"""What was learnt of each model parameter: its value, its interval, and its prior interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.units import label
from structid.figures.style import pretty, pretty_unit
from structid.report.material.material import PosteriorMaterial
from structid.report.tables import number

INTERVAL = (0.05, 0.95)
"""Probabilities at the ends of an interval."""
NORMAL = 1.645
"""Standard deviations from the mean to the ends of such an interval of a normal distribution."""
DIGITS = 4.0
"""Fraction of an interval's width to which its ends are rounded, with two digits."""
LITTLE = 1.4
"""Ratio of the prior's interval to the posterior's below which the data say little."""


@dataclass(frozen=True)
class LearntParameter:
    """One model parameter, in its display unit."""

    name: str  # name in the study
    unit: str  # Display unit
    mean: float  # Of the posterior
    sd: float  # Of the posterior
    interval: tuple[float, float]  # 90 % interval, given the model
    # The same for another record, where the parameters drift with time; None where they do not
    elsewhere: tuple[float, float] | None
    prior: tuple[float, float]  # 90 % interval of the prior
    truth: float | None  # true value of a virtual experiment

    @property
    def label(self) -> str:
        """Name and unit."""
        return label(pretty(self.name), pretty_unit(self.unit))

    @property
    def honest(self) -> tuple[float, float]:
        """The interval to be used: that for another record, where the model is wrong."""
        return self.interval if self.elsewhere is None else self.elsewhere

    @property
    def narrowed(self) -> float:
        """Ratio of the prior's interval to the posterior's, given the model."""
        return self._narrowed(self.interval)

    @property
    def unknown_elsewhere(self) -> bool:
        """Whether the interval for another record is about the prior's."""
        return self.elsewhere is not None and self._narrowed(self.elsewhere) < LITTLE

    def _narrowed(self, interval: tuple[float, float]) -> float:
        return (self.prior[1] - self.prior[0]) / max(interval[1] - interval[0], np.finfo(np.float64).tiny)

    @property
    def holds_truth(self) -> bool | None:
        """Whether the truth lies in the interval to be used; None where it is unknown."""
        return None if self.truth is None else self.honest[0] <= self.truth <= self.honest[1]

    def in_words(self, interval: tuple[float, float]) -> str:
        """An interval with appropriate digits."""
        low, high = interval
        return f"{number(low, (high - low) / DIGITS)} to {number(high, (high - low) / DIGITS)}"

    @property
    def value(self) -> str:
        """The mean, with appropriate digits."""
        return number(self.mean, self.sd)

    @property
    def true_value(self) -> str:
        """The truth, or a dash where it is unknown."""
        return "–" if self.truth is None else f"{self.truth:.4g}"

    @property
    def bar(self) -> dict[str, float]:
        """Positions in a bar that spans the prior's interval, widened to hold everything [%]: prior, both intervals and truth."""
        inside = [*self.prior, *self.interval, *self.honest, *([] if self.truth is None else [self.truth])]
        first, span = min(inside), max(inside) - min(inside)

        def place(value: float) -> float:
            return round(100.0 * (value - first) / span, 2)

        ends = {"prior": self.prior, "interval": self.interval, "honest": self.honest}
        places = {
            f"{name}_{end}": place(pair[k]) for name, pair in ends.items() for k, end in enumerate(("low", "high"))
        }
        return places | ({} if self.truth is None else {"truth": place(self.truth)})

    @property
    def told(self) -> str:
        """Information of the data: how many times narrower the interval to be used is than the prior's."""
        times = self._narrowed(self.honest)
        if times < LITTLE:
            return "hardly"
        return f"{times:.2g} times" if times < 10 else f"{times:.0f} times"


def learnt_parameters(material: PosteriorMaterial) -> list[LearntParameter]:
    """What was learnt of each model parameter."""
    posterior, summary = material.posterior, material.summary
    count = posterior.model_space.dimension
    space, factors = posterior.space, posterior.factors
    prior = space.quantile(np.repeat(np.array(INTERVAL)[:, None], space.dimension, axis=1)) / factors
    bounds = (space.bounds / factors[:, None])[:count]
    parameters = []
    for index, name in enumerate(posterior.names[:count]):
        row = summary.names.index(name)
        figures = {key: float(values[row]) for key, values in summary.columns.items()}
        truth = material.true_values.get(name)
        parameters.append(
            LearntParameter(
                name,
                summary.units[row],
                figures["mean"],
                figures["sd"],
                (figures["q05"], figures["q95"]),
                _elsewhere(figures, bounds[index]),
                (float(prior[0, index]), float(prior[1, index])),
                None if truth is None else float(truth / factors[index]),
            )
        )
    return parameters


def _elsewhere(figures: dict[str, float], bounds: np.ndarray) -> tuple[float, float] | None:
    """The interval for another record: normal, with the sd and the drift combined, within the prior's bounds.

    It includes the interval for the measured record, which need not be normal.
    """
    if not figures.get("sd_elsewhere", 0.0) > figures["sd"]:
        return None
    ends = figures["mean"] + NORMAL * figures["sd_elsewhere"] * np.array([-1.0, 1.0])
    low, high = np.clip(ends, *bounds)
    return min(float(low), figures["q05"]), max(float(high), figures["q95"])
