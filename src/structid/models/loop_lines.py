"""Initial and final stiffness of a measured loop by two straight lines, for the first moments of priors.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from structid.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class LoopLines:
    """Two straight lines through a force-displacement loop.

    Parameters
    ----------
    initial_stiffness, final_stiffness : float
        Slopes k_i and k_u [N/m].
    yield_force : float
        Force at which the final line meets zero displacement [N].
    displacement, force : ndarray, shape (time,)
        The loop [m], [N].
    """

    initial_stiffness: float
    final_stiffness: float
    yield_force: float
    displacement: np.ndarray = field(repr=False)
    force: np.ndarray = field(repr=False)

    @property
    def alpha(self) -> float:
        """Final over initial stiffness, α = k_u/k_i."""
        return self.final_stiffness / self.initial_stiffness

    def plot(self, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the loop and the lines.

        Parameters
        ----------
        save : path-like, optional
            Where to save it, without ending: PNG and PDF are written.

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
            (elastic, elastic * self.initial_stiffness * 1e-6, f"initial, {self.initial_stiffness * 1e-6:.3g} kN/mm")
        ]
        for side in (-1.0, 1.0):
            x = side * np.array([0.3, 1.0]) * end
            text = f"final, {self.final_stiffness * 1e-6:.3g} kN/mm (α = {self.alpha:.3g})"
            lines.append((x, side * self.yield_force * 1e-3 + x * self.final_stiffness * 1e-6, text))
        return loops.two_lines(u, f, lines, save=save)


def two_lines(displacement: np.ndarray, force: np.ndarray, elastic: float = 0.1, yielded: float = 0.75) -> LoopLines:
    """Fit the initial and the final stiffness of a measured loop by two linear regressions (the thesis's figure 3.7).

    The initial line is fitted to the samples before the displacement first leaves ± `elastic` of its peak, f = k_i u; the final one
    to the loading samples beyond ± `yielded` of the peak, f = ± f_y + k_u u with one slope for both sides.

    Parameters
    ----------
    displacement, force : ndarray, shape (time,)
        [m], [N].
    elastic, yielded : float
        Fractions of the peak displacement.

    Returns
    -------
    LoopLines
        The stiffnesses: means for the priors of `stiffness` and `alpha`.

    Raises
    ------
    InputError
        If a line has fewer than three samples.
    """
    u, f = np.asarray(displacement, dtype=np.float64), np.asarray(force, dtype=np.float64)
    if u.shape != f.shape or u.ndim != 1:
        raise InputError("two_lines", f"shapes {u.shape} and {f.shape}", "two histories of one length")
    peak = np.abs(u).max()
    left = np.flatnonzero(np.abs(u) > elastic * peak)
    first = slice(0, int(left[0]) if left.size else u.size)
    loading = (np.abs(u) > yielded * peak) & (u * np.gradient(u) > 0.0)
    if np.count_nonzero(u[first]) < 3 or loading.sum() < 3:
        raise InputError(
            "two_lines",
            f"{np.count_nonzero(u[first])} samples on the initial and {loading.sum()} on the final line",
            "three or more on each",
            "Change the fractions elastic and yielded.",
        )
    initial = float(u[first] @ f[first] / (u[first] @ u[first]))
    columns = np.column_stack([u[loading], np.sign(u[loading])])
    (final, yield_force), *_ = np.linalg.lstsq(columns, f[loading], rcond=None)
    return LoopLines(initial, float(final), float(yield_force), u, f)
