"""The table of a sampling: moments, quantiles, best point, diagnostics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from structid.notebook import ShownAsText
from structid.units import label

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Summary(ShownAsText):
    """Posterior moments, quantiles, best point and diagnostics, one row per parameter, in display units.

    Parameters
    ----------
    names, units : tuple of str
        Parameters and their display units.
    columns : dict of str to ndarray, shape (parameter,)
        ``mean``, ``sd``, ``robust_sd`` (of a posterior on a built-in model or a surrogate), ``q05``, ``median``, ``q95``,
        ``map``, ``r_hat``, ``ess_bulk``, ``ess_tail``, ``tau``.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: dict[str, np.ndarray]

    def of(self, places: list[int]) -> Summary:
        """Select some of the parameters.

        Parameters
        ----------
        places : list of int
            Which rows.

        Returns
        -------
        Summary
            Of these alone.
        """
        columns = {key: column[places] for key, column in self.columns.items()}
        return Summary(tuple(self.names[i] for i in places), tuple(self.units[i] for i in places), columns)

    def row(self, name: str) -> dict[str, float]:
        """One parameter's figures.

        Parameters
        ----------
        name : str
            The parameter.

        Returns
        -------
        dict of str to float
            By column.
        """
        index = self.names.index(name)
        return {column: float(values[index]) for column, values in self.columns.items()}

    def to_pandas(self) -> pandas.DataFrame:
        """Give the table as pandas has it.

        Returns
        -------
        pandas.DataFrame
            A row for each parameter, in display units, which are in the column ``unit``.
        """
        import pandas

        return pandas.DataFrame({"unit": list(self.units), **self.columns}, index=list(self.names))

    def __str__(self) -> str:
        heads = [label(n, u) for n, u in zip(self.names, self.units, strict=True)]
        width = max(len(h) for h in heads)
        lines = ["".ljust(width) + "".join(c.rjust(13) for c in self.columns)]
        for i, head in enumerate(heads):
            lines.append(head.ljust(width) + "".join(f"{values[i]:13.5g}" for values in self.columns.values()))
        return "\n".join(lines)
