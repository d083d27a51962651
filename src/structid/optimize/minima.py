"""Result of a multistart search: the distinct minima, from best to worst."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from structid.core.journal import write_then_rename
from structid.core.units import label
from structid.optimize.region import Objective, Region

SAME_POINT = 1e-3
"""End points closer than this, as a fraction of the range between bounds, are the same minimum."""


@dataclass(frozen=True)
class Minimum:
    """One of the minima found.

    Parameters
    ----------
    theta : ndarray, shape (parameter,)
        Location in SI.
    value : float
        Value of the objective.
    starts : int
        Number of starts that ended here.
    on_boundary : tuple of str
        Parameters at one of their bounds, and inequalities that hold with equality.
    """

    theta: Float[np.ndarray, " parameter"]
    value: float
    starts: int
    on_boundary: tuple[str, ...]


@dataclass(frozen=True)
class OptimizeResult:
    """Outcome of a multistart search.

    Parameters
    ----------
    method : str
        Name of the search.
    names : tuple of str
        Names of the parameters.
    minima : tuple of Minimum
        Distinct minima, best first.
    evaluations : int
        Number of model runs; a linearisation counts as one, plus one for each parameter.
    scale : float
        Objective of a model that predicts zero, Σ y².
    ends, values : ndarray, shape (start, parameter) and (start,)
        End point of every start in SI, and the objective there.
    units : dict of str to str
        Display unit of every parameter.
    factors : ndarray, shape (parameter,)
        SI value of one display unit.
    """

    method: str
    names: tuple[str, ...]
    minima: tuple[Minimum, ...]
    evaluations: int
    scale: float
    ends: Float[np.ndarray, "start parameter"] = field(repr=False)
    values: Float[np.ndarray, " start"] = field(repr=False)
    units: dict[str, str] = field(repr=False, default_factory=dict)
    factors: Float[np.ndarray, " parameter"] = field(repr=False, default=None)  # type: ignore[arg-type]

    @property
    def best(self) -> Minimum:
        """The lowest minimum."""
        return self.minima[0]

    def __str__(self) -> str:
        """Table of the minima, in display units."""
        heads = [label(n, self.units.get(n, "")) for n in self.names]
        lines = [
            f"{self.method}: {len(self.values)} starts, {self.evaluations} evaluations of the misfit, {len(self.minima)} distinct "
            "minima",
            "  ".join(
                [
                    "objective/scale".rjust(16),
                    "starts",
                    *(h.rjust(max(14, len(h))) for h in heads),
                    "at a bound",
                ]
            ),
        ]
        for minimum in self.minima:
            shown = minimum.theta / self.factors
            lines.append(
                "  ".join(
                    [
                        f"{minimum.value / self.scale:16.6g}",
                        f"{minimum.starts:6d}",
                        *(f"{v:{max(14, len(h))}.8g}" for v, h in zip(shown, heads, strict=True)),
                        ", ".join(minimum.on_boundary) or "-",
                    ]
                )
            )
        return "\n".join(lines)

    def to_text(self, path: str | os.PathLike[str]) -> Path:
        """Write the table to a file.

        Parameters
        ----------
        path : path-like
            The file.

        Returns
        -------
        Path
            The file written.
        """
        write_then_rename(Path(path), (str(self) + "\n").encode())
        return Path(path)


def collect(
    method: str,
    objective: Objective,
    where: Region,
    x: Float[np.ndarray, "start parameter"],
    values: Float[np.ndarray, " start"],
    evaluations: int,
) -> OptimizeResult:
    """Group the end points of a search into distinct minima."""
    left = list(np.argsort(values, kind="stable"))
    minima = []
    while left:
        centre = left[0]
        same = [i for i in left if np.abs(x[i] - x[centre]).max() < SAME_POINT]
        near = np.flatnonzero(where.slack(x[centre]) < 1e-6)
        at = dict.fromkeys(where.faces[i] for i in near)
        minima.append(Minimum(where.to_theta(x[centre]), float(values[centre]), len(same), tuple(at)))
        left = [i for i in left if i not in same]
    return OptimizeResult(
        method,
        objective.names,
        tuple(minima),
        evaluations,
        objective.scale,
        where.to_theta(x),
        values,
        objective.space.units,
        objective.space.factors,
    )


class Searches(dict[str, OptimizeResult]):
    """Results of deterministic calibrations of one posterior, by the name of the method."""
