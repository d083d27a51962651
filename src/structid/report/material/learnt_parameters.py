"""Posterior of each model parameter: its mean, its interval, and the prior interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.units import label
from structid.figures.style import pretty, pretty_unit
from structid.report.material.material import PosteriorMaterial
from structid.report.tables import number

INTERVAL = (0.05, 0.95)
"""Probabilities at the bounds of a 90 % interval."""
NORMAL = 1.645
"""Half-width of a normal distribution's 90 % interval, in standard deviations."""
DIGITS = 4.0
"""The bounds of an interval are rounded to two digits of its width divided by this number."""
LITTLE = 1.4
"""Ratio of prior to posterior interval width below which the data hardly constrain a parameter."""


@dataclass(frozen=True)
class LearntParameter:
    """Posterior of one model parameter, in its display unit."""

    name: str  # name in the study
    unit: str  # display unit
    mean: float  # posterior mean
    sd: float  # posterior standard deviation
    interval: tuple[float, float]  # 90 % interval, given the model
    # 90 % interval for another record, if the parameters drift with time; otherwise None
    elsewhere: tuple[float, float] | None
    prior: tuple[float, float]  # 90 % interval of the prior
    truth: float | None  # true value of a virtual experiment

    @property
    def label(self) -> str:
        """Name and unit."""
        return label(pretty(self.name), pretty_unit(self.unit))

    @property
    def honest(self) -> tuple[float, float]:
        """The recommended interval: for a wrong model, the interval for another record."""
        return self.interval if self.elsewhere is None else self.elsewhere

    @property
    def narrowed(self) -> float:
        """Ratio of the widths of the prior interval and the posterior interval, given the model."""
        return self._narrowed(self.interval)

    @property
    def unknown_elsewhere(self) -> bool:
        """Whether the interval for another record is about as wide as the prior interval."""
        return self.elsewhere is not None and self._narrowed(self.elsewhere) < LITTLE

    def _narrowed(self, interval: tuple[float, float]) -> float:
        return (self.prior[1] - self.prior[0]) / max(interval[1] - interval[0], np.finfo(np.float64).tiny)

    @property
    def holds_truth(self) -> bool | None:
        """Whether the true value lies in the recommended interval; None if the true value is unknown."""
        return None if self.truth is None else self.honest[0] <= self.truth <= self.honest[1]

    def in_words(self, interval: tuple[float, float]) -> str:
        """An interval as a string, with appropriate digits."""
        low, high = interval
        return f"{number(low, (high - low) / DIGITS)} to {number(high, (high - low) / DIGITS)}"

    @property
    def value(self) -> str:
        """The mean as a string, with appropriate digits."""
        return number(self.mean, self.sd)

    @property
    def true_value(self) -> str:
        """The true value as a string, or a dash if it is unknown."""
        return "–" if self.truth is None else f"{self.truth:.4g}"

    @property
    def bar(self) -> dict[str, float]:
        """Positions of the prior, both intervals and the truth in a bar that spans all of them [% of its length]."""
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
    def narrowing(self) -> str:
        """Ratio of the widths of the prior interval and the recommended interval, as a string."""
        times = self._narrowed(self.honest)
        if times < LITTLE:
            return "hardly"
        return f"{times:.2g} times" if times < 10 else f"{times:.0f} times"


def learnt_parameters(material: PosteriorMaterial) -> list[LearntParameter]:
    """Compute the posterior of each model parameter."""
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
    """Interval for another record: normal, with the record-to-record standard deviation, limited to the bounds of the prior.

    It always includes the interval for the measured record, whose distribution need not be normal.
    """
    if not figures.get("sd_elsewhere", 0.0) > figures["sd"]:
        return None
    ends = figures["mean"] + NORMAL * figures["sd_elsewhere"] * np.array([-1.0, 1.0])
    low, high = np.clip(ends, *bounds)
    return min(float(low), figures["q05"]), max(float(high), figures["q95"])
