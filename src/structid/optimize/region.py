"""The feasible region: bounds and linear inequalities, in coordinates scaled to the bounds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.streams import Purpose, derived_seed
from structid.probability.designs import unit_design
from structid.probability.expressions import parse_expression
from structid.probability.space import ParameterSpace


class Objective(Protocol):
    """The function to minimise, evaluated for a batch of points; `linearised` gives its derivatives if it has any."""

    names: tuple[str, ...]
    space: ParameterSpace
    scale: float
    differentiable: bool

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        """Return the values (run,) at ``theta[run, parameter]``."""
        ...

    def linearised(self, theta: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the values, gradients and positive semi-definite curvatures."""
        ...


@dataclass(frozen=True, eq=False)
class Region:
    """A x ≤ b in coordinates x = (θ − low)/(high − low); its first 2d rows are the bounds 0 ≤ x ≤ 1."""

    low: Float[np.ndarray, " parameter"]  # lower bounds in SI
    width: Float[np.ndarray, " parameter"]  # upper minus lower bounds in SI
    matrix: Float[np.ndarray, "constraint parameter"]  # A with rows of unit length
    limit: Float[np.ndarray, " constraint"]  # b
    faces: tuple[str, ...]  # name of each constraint: the parameter of a bound, or the inequality

    def to_theta(self, x: Float[np.ndarray, "... parameter"]) -> Float[np.ndarray, "... parameter"]:
        """Convert scaled coordinates to SI."""
        theta: np.ndarray = self.low + x * self.width
        return theta

    def to_scaled(self, theta: Float[np.ndarray, "... parameter"]) -> Float[np.ndarray, "... parameter"]:
        """Convert SI to scaled coordinates."""
        x: np.ndarray = (np.asarray(theta) - self.low) / self.width
        return x

    def slack(self, x: Float[np.ndarray, "... parameter"]) -> Float[np.ndarray, "... constraint"]:
        """Distance to every constraint, b − A x."""
        slack: np.ndarray = self.limit - x @ self.matrix.T
        return slack

    def longest_step(self, x: Float[np.ndarray, " parameter"], direction: Float[np.ndarray, " parameter"]) -> float:
        """Longest step along a direction that stays inside the region."""
        rate = self.matrix @ direction
        leaving = rate > 1e-14 * np.abs(direction).max(initial=1e-300)
        if not leaving.any():
            return float("inf")
        return float(max((self.slack(x)[leaving] / rate[leaving]).min(), 0.0))

    def interior_starts(self, count: int, seed: int) -> Float[np.ndarray, "count parameter"]:
        """Latin hypercube points well inside the region."""
        dimension = self.low.size
        for oversampling in (1, 4, 16, 64, 256):
            x = 0.01 + 0.98 * unit_design(
                count * oversampling, dimension, derived_seed(seed, Purpose.SEARCH_STARTS), "latin_hypercube"
            )
            inside = x[(self.slack(x) > 1e-3).all(axis=1)]
            if len(inside) >= count:
                return inside[:count]
        raise InputError(
            "constraints",
            "almost no point within the bounds satisfies them",
            "inequalities that leave a feasible region within the bounds",
        )


def region(objective: Objective, bounds: dict[str, tuple[float, float]] | None, constraints: Sequence[str]) -> Region:
    """Build the region for an objective."""
    space, names = objective.space, objective.names
    box = np.array([m.support for m in space.marginals.values()])
    tails = np.array([m.quantile(np.array([1e-4, 1 - 1e-4])) for m in space.marginals.values()])
    box = np.where(np.isfinite(box), box, tails)
    for name, pair in (bounds or {}).items():
        if name not in names:
            raise InputError("bounds", f"unknown name '{name}'", ", ".join(names))
        box[names.index(name)] = pair
    if not (box[:, 0] < box[:, 1]).all():
        name = names[int(np.argmin(box[:, 1] - box[:, 0]))]
        raise InputError(f"bounds of '{name}'", "low ≥ high", "low < high")
    low, width = box[:, 0], box[:, 1] - box[:, 0]
    identity = np.eye(len(names))
    rows, limits = [identity, -identity], [np.ones(len(names)), np.zeros(len(names))]
    for text in constraints:
        coefficient, constant = _linear(text, names)
        # a·θ + c ≤ 0 with θ = low + width x
        row = coefficient * width
        length = np.linalg.norm(row)
        rows.append(row[None, :] / length)
        limits.append(np.array([-(constant + coefficient @ low) / length]))
    return Region(low, width, np.concatenate(rows), np.concatenate(limits), (*names, *names, *constraints))


def _linear(text: str, names: tuple[str, ...]) -> tuple[np.ndarray, float]:
    """Coefficients and constant of an inequality in the form a·θ + c ≤ 0."""
    sides = re.split(r"(<=|>=)", text)
    if len(sides) != 3:
        raise InputError("constraint", f"'{text}'", "one linear inequality such as 'gamma <= beta'")
    left, sign, right = sides
    function, needed = parse_expression(f"({left}) - ({right})", f"constraint '{text}'")
    for name in needed:
        if name not in names:
            raise InputError(f"constraint '{text}'", f"unknown name '{name}'", ", ".join(names))

    def at(point: np.ndarray) -> float:
        return float(function(dict(zip(names, point, strict=True))))

    constant = at(np.zeros(len(names)))
    coefficient = np.array([at(row) - constant for row in np.eye(len(names))])
    probe = np.linspace(0.3, 1.7, len(names))
    if not np.isclose(at(probe), constant + coefficient @ probe, rtol=1e-9) or not coefficient.any():
        raise InputError(f"constraint '{text}'", "it is not linear in the parameters", "a linear inequality")
    return (coefficient, constant) if sign == "<=" else (-coefficient, -constant)


def starting_points(where: Region, starts: int | np.ndarray, seed: int) -> Float[np.ndarray, "start parameter"]:
    """Return the starting points in scaled coordinates; given points are checked, others are drawn."""
    if isinstance(starts, (int, np.integer)):
        return where.interior_starts(int(starts), seed)
    x = where.to_scaled(np.atleast_2d(starts))
    bad = np.flatnonzero((where.slack(x) < -1e-9).any(axis=1))
    if bad.size:
        raise InputError("starts", f"point {bad[0]} violates the bounds or constraints", "feasible points")
    return x
