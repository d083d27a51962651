"""Initial and final stiffness of a measured loop, from two straight lines, for the priors of `stiffness` and `alpha`.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.optimize

from structid.core.errors import InputError
from structid.core.notebook import ShownAsText
from structid.core.validation import check_arguments, real_array
from structid.data_files.loop_columns import read_loop_columns
from structid.probability.marginals import LogNormal
from structid.probability.truncation import Marginal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OTHER_ELASTIC = (0.5, 1.5, 2.0)
"""Other end points tried for the initial line, divided by the chosen end point, for the sensitivity of its slope."""

OTHER_YIELDED = (0.6, 1.4)
"""Other starting points tried for the final line: distance to the peak, divided by that of the chosen point."""

FEWEST = 3
"""Minimum number of samples for the fit of a line."""

DUCTILITY = 2.5
"""Minimum ductility at which a loop determines α: peak displacement over the displacement where the lines meet."""

YIELD_SHARE = 0.3
"""Minimum ratio of yield force to largest force; below it the final line nearly passes through the origin."""

NORMAL_90 = 2 * 1.645
"""Width of a 90 % interval of the normal distribution, in standard deviations."""

SMALLEST_SPREAD = {"stiffness": 0.1, "alpha": 0.3}
"""Minimum coefficients of variation of the priors, since the parameters of a smooth loop are not exactly slopes of lines."""


@check_arguments
@dataclass(frozen=True)
class LoopLines(ShownAsText):
    """Two straight lines through a force-displacement loop, created by `fit` or `read`.

    The slope of a smooth loop decreases steadily, so a line's slope depends on the range of the fit. The intervals
    contain the slopes of other ranges. The upper end of the initial interval is raised by the spread of these slopes.
    The final interval also contains the asymptotic slope of a loop that bends as slowly as a Bouc-Wen loop with an
    exponent of 1. A sharper loop has already reached its asymptote.

    Parameters
    ----------
    initial_stiffness, final_stiffness : float
        Slopes k_i and k_u [N/m].
    yield_force : float
        Force at which the final line meets zero displacement [N].
    initial_interval, final_interval : pair of float
        Intervals of k_i and k_u [N/m].
    displacement, force : ndarray, shape (time,)
        Displacement [m] and force [N] of the loop.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> displacement = np.concatenate([np.linspace(0.0, 0.03, 60), np.linspace(0.03, -0.03, 120)[1:]])
    >>> force = 2e5 * np.tanh(displacement / 0.005) + 1e6 * displacement
    >>> lines = si.LoopLines.fit(displacement, force)
    >>> bool(lines.initial_stiffness > lines.final_stiffness)
    True
    """

    initial_stiffness: float
    final_stiffness: float
    yield_force: float
    initial_interval: tuple[float, float]
    final_interval: tuple[float, float]
    displacement: np.ndarray = field(repr=False)
    force: np.ndarray = field(repr=False)

    @classmethod
    def fit(cls, displacement: np.ndarray, force: np.ndarray, elastic: float = 0.1, yielded: float = 0.75) -> LoopLines:
        """Fit both lines by linear regressions (the thesis's figure 3.7).

        The initial line f = f_0 + k_i u fits the samples before the displacement first exceeds ± `elastic` of its peak. The final
        line f = ± f_y + k_u u fits the loading samples beyond ± `yielded` of the peak, with one slope for both sides.

        Parameters
        ----------
        displacement, force : ndarray, shape (time,)
            Histories [m] and [N], starting at rest.
        elastic, yielded : float
            Fractions of the peak displacement.

        Returns
        -------
        LoopLines
            The lines.

        Raises
        ------
        InputError
            If the histories have different lengths or missing values, or a line has fewer than three samples.

        Examples
        --------
        >>> u = 0.02 * np.sin(np.linspace(0.0, 4.0 * np.pi, 4001))
        >>> loop = si.BoucWen(mass=1.0, stiffness="7.6 kN/mm", alpha=0.06, beta=300.0, channels="restoring_force")
        >>> force = loop.simulate(np.zeros((1, 0)), si.DisplacementHistory(u, 0.01)).values[0, :, 0]
        >>> print(si.LoopLines.fit(u, force, elastic=0.02))  # doctest: +SKIP
        """
        u, f = (
            real_array(f"LoopLines.fit({name})", values)
            for name, values in (("displacement", displacement), ("force", force))
        )
        if u.shape != f.shape or u.ndim != 1:
            raise InputError("LoopLines.fit", f"shapes {u.shape} and {f.shape}", "two histories of equal length")
        if missing := int(np.count_nonzero(~np.isfinite(u + f))):
            raise InputError("LoopLines.fit", f"{missing} of {u.size} samples are not finite", "finite numbers")
        if not 0.0 < elastic < yielded < 1.0:
            raise InputError("LoopLines.fit", f"elastic={elastic:g}, yielded={yielded:g}", "0 < elastic < yielded < 1")
        counts = int(_elastic(u, elastic).sum()), int(_yielded(u, yielded).sum())
        if min(counts) < FEWEST:
            raise InputError(
                "LoopLines.fit",
                f"{counts[0]} samples on the initial and {counts[1]} on the final line",
                f"at least {FEWEST} samples on each line",
                "Change the fractions `elastic` and `yielded`.",
            )
        initial = _initial_slope(u, f, elastic)
        low, high = _range([initial, *(_initial_slope(u, f, part * elastic) for part in OTHER_ELASTIC)])
        ranges = [yielded, *(1.0 - part * (1.0 - yielded) for part in OTHER_YIELDED)]
        lines = [_final_line(u, f, part) for part in ranges]
        peak, (final, yield_force) = float(np.abs(u).max()), lines[0]
        slopes = [slope for slope, _ in lines]
        middles = [0.5 * (1.0 + part) * peak for part in ranges]
        asymptotes = [_asymptote(initial, *line, middle) for line, middle in zip(lines, middles, strict=True)]
        return cls(initial, final, yield_force, (low, high + (high - low)), _range([*slopes, *asymptotes]), u, f)

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        displacement_unit: str,
        force_unit: str,
        displacement_column: int | str = 0,
        force_column: int | str = 1,
        elastic: float = 0.1,
        yielded: float = 0.75,
    ) -> LoopLines:
        """Fit both lines to a loop in a file; see `fit`.

        Parameters
        ----------
        path : path-like
            A table of columns, of any format that `GroundMotion.read` reads.
        displacement_unit, force_unit : str
            Units of the columns.
        displacement_column, force_column : int or str
            Columns: numbers, counted from 0, or titles.
        elastic, yielded : float
            Fractions of the peak displacement.

        Returns
        -------
        LoopLines
            The lines.

        Raises
        ------
        InputError
            If the file cannot be read, or the lines cannot be fitted.
        """
        columns = read_loop_columns(path, displacement_unit, force_unit, displacement_column, force_column)
        return cls.fit(*columns, elastic, yielded)

    @property
    def alpha(self) -> float:
        """Ratio of final to initial stiffness, α = k_u/k_i."""
        return self.final_stiffness / self.initial_stiffness

    @property
    def alpha_interval(self) -> tuple[float, float]:
        """Interval of α; the upper end is valid even for a structure that has hardly yielded."""
        ratios = [final / initial for final in self.final_interval for initial in self.initial_interval]
        return min(ratios), min(1.0, max(ratios))

    @property
    def ductility(self) -> float:
        """Ratio of the peak displacement to the displacement at which the two lines meet."""
        # f_y + k_u u_y = k_i u_y
        yield_displacement = self.yield_force / (self.initial_stiffness - self.final_stiffness)
        return float(np.abs(self.displacement).max() / yield_displacement)

    @property
    def yielded(self) -> bool:
        """Whether the structure has yielded enough for the final line to determine α."""
        return (
            self.final_stiffness < self.initial_stiffness
            and self.yield_force >= YIELD_SHARE * float(np.abs(self.force).max())
            and self.ductility >= DUCTILITY
        )

    def priors(self) -> dict[str, Marginal]:
        """Return priors of `stiffness` and `alpha` (the means in the thesis are 7.42 kN/mm and 0.063).

        The prior means are the midpoints of `initial_interval` and `alpha_interval`, which are the 90 % intervals of the priors.
        The coefficients of variation are at least 0.1 and 0.3. If the loop is also the measurement, the study uses
        the data twice. Keep the priors wide in this case.

        Returns
        -------
        dict of str to Marginal
            Lognormal priors; the prior of α is truncated at 1.

        Raises
        ------
        InputError
            If the structure has hardly yielded, or its strength decreases: the loop then does not determine α.

        Examples
        --------
        >>> lines = si.LoopLines.read("loop.csv", "mm", "kN")  # doctest: +SKIP
        >>> space = si.ParameterSpace(**lines.priors(), beta=si.Uniform(55, 65, unit="1/m"))  # doctest: +SKIP
        """
        if not self.yielded:
            raise InputError(
                "LoopLines.priors",
                self._hardly,
                "a loop well beyond yielding",
                "Use only initial_stiffness, and choose a wide prior of alpha yourself.",
            )
        if self.final_stiffness <= 0.0:
            raise InputError(
                "LoopLines.priors",
                f"the final line decreases, with {self._kilonewtons(self.final_stiffness)}",
                "a final line that increases",
                "The loop loses strength: use a hysteretic law with degradation, and choose a prior of alpha yourself.",
            )
        stiffness, alpha = self.initial_interval, (max(self.alpha_interval[0], 0.0), self.alpha_interval[1])
        return {
            "stiffness": LogNormal(*(1e-6 * moment for moment in _moments("stiffness", stiffness)), unit="kN/mm"),
            "alpha": LogNormal(*_moments("alpha", alpha), high=1.0),
        }

    @property
    def _hardly(self) -> str:
        return (
            f"the structure hardly yielded: the final line has {self.alpha:.2f} times the initial stiffness and a yield force "
            f"of {self.yield_force * 1e-3:.3g} kN, and the peak force is {np.abs(self.force).max() * 1e-3:.3g} kN"
        )

    @staticmethod
    def _kilonewtons(stiffness: float) -> str:
        return f"{stiffness * 1e-6:.3g} kN/mm"

    def __str__(self) -> str:
        low, high = (f"{end * 1e-6:.3g}" for end in self.initial_interval)
        text = f"The loop's initial stiffness is {self._kilonewtons(self.initial_stiffness)} ({low} to {high})."
        if not self.yielded:
            return f"{text} In this loop {self._hardly}. The loop only shows that alpha is at most {self.alpha_interval[1]:.2f}."
        first, last = self.alpha_interval
        return (
            f"{text} Alpha is {self.alpha:.3f} ({first:.3f} to {last:.3f}), the yield force {self.yield_force * 1e-3:.3g} kN, "
            f"and the ductility {self.ductility:.2g}."
        )

    def plot(self, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the loop and the lines.

        Parameters
        ----------
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        from structid.figures import loops

        u, f = self.displacement * 1e3, self.force * 1e-3
        end = np.abs(u).max()
        elastic = np.array([-1.0, 1.0]) * min(np.abs(f).max() / (self.initial_stiffness * 1e-6), end)
        lines = [
            (elastic, elastic * self.initial_stiffness * 1e-6, f"initial, {self._kilonewtons(self.initial_stiffness)}")
        ]
        for side in (-1.0, 1.0):
            x = side * np.array([0.3, 1.0]) * end
            text = f"final, {self._kilonewtons(self.final_stiffness)} (α = {self.alpha:.3g})"
            lines.append((x, side * self.yield_force * 1e-3 + x * self.final_stiffness * 1e-6, text))
        title = "" if self.yielded else "hardly yielded: the final line does not determine α"
        return loops.loop_and_lines(u, f, lines, title, save=save)


def _elastic(u: np.ndarray, part: float) -> Any:
    """Return a mask of the samples before the displacement first exceeds this fraction of its peak."""
    return np.logical_and.accumulate(np.abs(u) <= part * np.abs(u).max()) & (u != 0.0)


def _yielded(u: np.ndarray, part: float) -> Any:
    """Return a mask of the samples beyond this fraction of the peak displacement at which |u| increases."""
    return (np.abs(u) > part * np.abs(u).max()) & (u * np.gradient(u) > 0.0)


def _initial_slope(u: np.ndarray, f: np.ndarray, part: float) -> float:
    """Return k_i [N/m] of f = f_0 + k_i u; NaN for too few samples."""
    first = _elastic(u, part)
    if first.sum() < FEWEST:
        return float("nan")
    about = u[first] - u[first].mean()
    return float(about @ f[first] / (about @ about))


def _final_line(u: np.ndarray, f: np.ndarray, part: float) -> tuple[float, float]:
    """Return k_u [N/m] and f_y [N] of f = ± f_y + k_u u; NaN for too few samples.

    The fit has a separate f_y for each loading direction, so that an offset of the loop does not change the slope.
    """
    loading = _yielded(u, part)
    if loading.sum() < FEWEST:
        return float("nan"), float("nan")
    sides = [(u[there], f[there]) for there in (loading & (u > 0.0), loading & (u < 0.0)) if there.any()]
    about = [(x - x.mean(), y) for x, y in sides]
    final = sum(x @ y for x, y in about) / sum(x @ x for x, _ in about)
    yield_forces = [np.sign(x[0]) * (y.mean() - final * x.mean()) for x, y in sides]
    return float(final), float(np.mean(yield_forces))


def _asymptote(initial: float, slope: float, yield_force: float, middle: float) -> float:
    """Return the limit [N/m] of the final line's slope, for a Bouc-Wen loop with an exponent of 1.

    The tangent of the loop f = α k_i u + (1 - α) k_i z_u (1 - e^{-u/z_u}) at u = μ z_u is k_i (α + (1 - α) e^{-μ}). For any α the
    tangent meets the initial line at u divided by the factor μ (1 - e^{-μ})/(1 - (1 + μ) e^{-μ}).
    """
    ratio = middle * (initial - slope) / yield_force if yield_force > 0.0 else 0.0
    if not ratio > 2.0:  # 2 is the ratio for a tangent at zero
        return float("nan")
    mu = scipy.optimize.brentq(lambda m: m * (1.0 - np.exp(-m)) / (1.0 - (1.0 + m) * np.exp(-m)) - ratio, 1e-3, ratio)
    left = np.exp(-mu)
    return float((slope - left * initial) / (1.0 - left))


def _range(slopes: list[float]) -> tuple[float, float]:
    return float(np.nanmin(slopes)), float(np.nanmax(slopes))


def _moments(name: str, interval: tuple[float, float]) -> tuple[float, float]:
    """Return the mean and standard deviation of a prior with this interval and a minimum spread."""
    mean = 0.5 * (interval[0] + interval[1])
    return mean, max((interval[1] - interval[0]) / NORMAL_90, SMALLEST_SPREAD[name] * mean)
