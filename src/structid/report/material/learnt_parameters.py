"""What was learnt of each parameter of the model, as a reader asks: its value, its interval, and what was known before."""

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
"""Standard deviations from the mean to the ends of such an interval of a normal law."""
DIGITS = 4.0
"""Part of an interval's width to which its ends are given, with two digits of it."""
LITTLE = 1.4
"""Times that an interval is narrower than the prior's at least, if the data say more than little."""


@dataclass(frozen=True)
class LearntParameter:
    """One parameter of the model, in its display unit."""

    name: str  # As in the study
    unit: str  # Display unit
    mean: float  # Of the posterior
    sd: float  # Of the posterior
    interval: tuple[float, float]  # In which it lies with 90 % probability, given the model
    # The same for another record, where the parameters drift with time; None where they do not
    elsewhere: tuple[float, float] | None
    prior: tuple[float, float]  # The prior's 90 % interval
    truth: float | None  # Of a virtual experiment

    @property
    def label(self) -> str:
        """Name and unit."""
        return label(pretty(self.name), pretty_unit(self.unit))

    @property
    def honest(self) -> tuple[float, float]:
        """The interval that a reader should use: that for another record, where the model is wrong."""
        return self.interval if self.elsewhere is None else self.elsewhere

    @property
    def narrowed(self) -> float:
        """How many times narrower the interval is than the prior's, given the model."""
        return self._narrowed(self.interval)

    @property
    def unknown_elsewhere(self) -> bool:
        """Whether the interval for another record is about the prior's."""
        return self.elsewhere is not None and self._narrowed(self.elsewhere) < LITTLE

    def _narrowed(self, interval: tuple[float, float]) -> float:
        return (self.prior[1] - self.prior[0]) / max(interval[1] - interval[0], np.finfo(np.float64).tiny)

    @property
    def holds_truth(self) -> bool | None:
        """Whether the truth lies in the interval to be used; None where it is not known."""
        return None if self.truth is None else self.honest[0] <= self.truth <= self.honest[1]

    def in_words(self, interval: tuple[float, float]) -> str:
        """An interval with as many digits as it deserves."""
        low, high = interval
        return f"{number(low, (high - low) / DIGITS)} to {number(high, (high - low) / DIGITS)}"

    @property
    def value(self) -> str:
        """The mean, with as many digits as the interval deserves."""
        return number(self.mean, self.sd)

    @property
    def true_value(self) -> str:
        """The truth, or a dash where it is not known."""
        return "–" if self.truth is None else f"{self.truth:.4g}"

    @property
    def bar(self) -> dict[str, float]:
        """Places in a bar that spans the prior's interval, widened to hold everything [%]: prior, both intervals and truth."""
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
        """How much the data say of it: how many times narrower the interval to be used is than the prior's."""
        times = self._narrowed(self.honest)
        if times < LITTLE:
            return "hardly"
        return f"{times:.2g} times" if times < 10 else f"{times:.0f} times"


def learnt_parameters(material: PosteriorMaterial) -> list[LearntParameter]:
    """Say what was learnt of each parameter of the model."""
    posterior, summary = material.posterior, material.summary
    count = posterior.model_space.dimension
    space, factors = posterior.space, posterior.factors
    prior = space.quantile(np.repeat(np.array(INTERVAL)[:, None], space.dimension, axis=1)) / factors
    bounds = (space.bounds / factors[:, None])[:count]
    found = []
    for place, name in enumerate(posterior.names[:count]):
        row = summary.names.index(name)
        told = {key: float(values[row]) for key, values in summary.columns.items()}
        truth = material.true_values.get(name)
        found.append(
            LearntParameter(
                name,
                summary.units[row],
                told["mean"],
                told["sd"],
                (told["q05"], told["q95"]),
                _elsewhere(told, bounds[place]),
                (float(prior[0, place]), float(prior[1, place])),
                None if truth is None else float(truth / factors[place]),
            )
        )
    return found


def _elsewhere(told: dict[str, float], bounds: np.ndarray) -> tuple[float, float] | None:
    """The interval for another record: of a normal law with the sd and the drift together, within the prior's bounds.

    It holds that of the measured record, which is of no normal law.
    """
    if not told.get("sd_elsewhere", 0.0) > told["sd"]:
        return None
    ends = told["mean"] + NORMAL * told["sd_elsewhere"] * np.array([-1.0, 1.0])
    low, high = np.clip(ends, *bounds)
    return min(float(low), told["q05"]), max(float(high), told["q95"])
