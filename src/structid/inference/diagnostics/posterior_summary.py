"""The table of a sampling result: moments, quantiles, best point, diagnostics."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from structid.core.notebook import ShownAsText
from structid.core.units import factor, label

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class ErrorSD:
    """Standard deviation of the errors of a channel, in its display unit."""

    variance: str  # name of the error variance
    unit: str  # display unit
    low: float  # 5 % quantile
    median: float  # median
    high: float  # 95 % quantile

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"the root of {self.variance}: {self.median:.3g}{unit} (90 %: {self.low:.3g} to {self.high:.3g}{unit})"


@dataclass(frozen=True)
class Summary(ShownAsText):
    """Posterior moments, quantiles, best point and diagnostics, one row per parameter, in display units."""

    names: tuple[str, ...]  # parameters
    units: tuple[str, ...]  # display units
    # ``mean``, ``sd``, ``robust_sd`` (of a posterior on a built-in model or a surrogate), ``q05``, ``median``, ``q95``,
    # ``map``, ``r_hat``, ``ess_bulk``, ``ess_tail``, ``tau``
    columns: dict[str, np.ndarray]
    # Display unit of the errors' standard deviation, by the name of their variance
    sd_units: dict[str, str] = field(default_factory=dict)

    def of(self, places: list[int]) -> Summary:
        """Select some of the parameters."""
        columns = {key: column[places] for key, column in self.columns.items()}
        names, units = (tuple(column[i] for i in places) for column in (self.names, self.units))
        sds = {name: unit for name, unit in self.sd_units.items() if name in names}
        return replace(self, names=names, units=units, columns=columns, sd_units=sds)

    def row(self, name: str) -> dict[str, float]:
        """All columns of one parameter, by name."""
        index = self.names.index(name)
        return {column: float(values[index]) for column, values in self.columns.items()}

    @property
    def error_sds(self) -> list[ErrorSD]:
        """Standard deviations of the errors (square roots of the error variances), in the unit of the measurement."""
        sds = []
        for name, unit in self.sd_units.items():
            row, variance = self.row(name), factor(self.units[self.names.index(name)])
            # The square root is monotone and therefore maps quantiles to quantiles.
            low, median, high = (np.sqrt(row[key] * variance) / factor(unit) for key in ("q05", "median", "q95"))
            sds.append(ErrorSD(name, unit, float(low), float(median), float(high)))
        return sds

    def to_pandas(self) -> pandas.DataFrame:
        """The table as a pandas DataFrame."""
        import pandas

        return pandas.DataFrame({"unit": list(self.units), **self.columns}, index=list(self.names))

    def __str__(self) -> str:
        heads = [label(n, u) for n, u in zip(self.names, self.units, strict=True)]
        width = max(len(h) for h in heads)
        lines = ["".ljust(width) + "".join(c.rjust(13) for c in self.columns)]
        for i, head in enumerate(heads):
            lines.append(head.ljust(width) + "".join(f"{values[i]:13.5g}" for values in self.columns.values()))
        return "\n".join([*lines, *(f"sd of the errors, {spread}" for spread in self.error_sds)])
