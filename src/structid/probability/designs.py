"""Designs: points of a parameter space; random, Latin hypercube (plain, maximin) or scrambled Sobol' points of the unit cube."""

from __future__ import annotations

import inspect
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError, check_choice
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

DENSITY_POINTS = 200
"""Number of points at which a prior's density is plotted."""

METHODS = {
    "latin_hypercube": Purpose.LATIN_HYPERCUBE,
    "maximin": Purpose.MAXIMIN,
    "sobol": Purpose.SOBOL,
    "random": Purpose.RANDOM_DESIGN,
}
"""Names of the methods, and the random stream of each."""


@dataclass(frozen=True)
class Design:
    """Points of a parameter space.

    Parameters
    ----------
    values : ndarray, shape (run, parameter)
        Points in SI.
    space : ParameterSpace
        The space.

    Examples
    --------
    >>> import structid as si
    >>> space = si.ParameterSpace(stiffness=si.Uniform(6.0, 9.0, unit="kN/mm"), alpha=si.Uniform(0.0, 0.2))
    >>> design = space.sample(8, seed=1)
    >>> design.values.shape
    (8, 2)
    >>> design.columns(["alpha"]).shape
    (8, 1)
    """

    values: np.ndarray
    space: Any  # a ParameterSpace, whose module imports this one

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.space.names)

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, rows: slice | np.ndarray) -> Design:
        return Design(self.values[rows], self.space)

    def __add__(self, more: Design) -> Design:
        """The points of this design, followed by the points of another design of the same space."""
        if not isinstance(more, Design) or more.space.content_hash != self.space.content_hash:
            came = f"a {type(more).__name__} of another space"
            raise InputError("Design + Design", came, "a design of the same space")
        return Design(np.vstack([self.values, more.values]), self.space)

    def columns(self, names: Sequence[str]) -> np.ndarray:
        """Values of named parameters, including derived parameters.

        Parameters
        ----------
        names : sequence of str
            Names of the parameters.

        Returns
        -------
        ndarray, shape (run, name)
            Values in SI.
        """
        return np.asarray(self.space.columns(self.values, names))

    def plot(self, save: str | os.PathLike[str] | None = None) -> Figure:
        """Plot the points, such as samples of a prior: every parameter, and every pair of parameters (the thesis's figure 3.8).

        Parameters
        ----------
        save : path-like, optional
            File name without extension; PNG and PDF files are written.

        Returns
        -------
        matplotlib.figure.Figure
            Figure in display units, with the prior's density over the histograms.

        Raises
        ------
        InputError
            If there are fewer than two points, or no parameters.
        """
        from structid.figures.designs import samples

        if len(self) < 2 or not self.names:
            raise InputError("Design.plot", f"{len(self)} points of {len(self.names)} parameters", "two points or more")
        factors, units = self.space.factors, self.space.units
        low, high = self.values.min(axis=0), self.values.max(axis=0)
        places = np.linspace(low, high, DENSITY_POINTS)
        laws = self.space.marginals.values()
        densities = np.stack([np.exp(law.log_density(places[:, i])) * factors[i] for i, law in enumerate(laws)], axis=1)
        return samples(
            self.names, [units[n] for n in self.names], self.values / factors, places / factors, densities, save=save
        )

    @check_arguments
    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write the points in display units, one column for each parameter.

        Parameters
        ----------
        path : path-like
            The file.

        Returns
        -------
        Path
            The file written.
        """
        header = ",".join(f"{n} [{u}]" if u else n for n, u in self.space.units.items())
        np.savetxt(path, self.values / self.space.factors, delimiter=",", header=header, comments="", fmt="%.12g")
        return Path(path)

    def to_xarray(self) -> xarray.Dataset:
        """Return the points as an xarray Dataset with dimension run.

        Returns
        -------
        xarray.Dataset
            A variable for each parameter, in SI.
        """
        import xarray  # slow to import

        return xarray.Dataset({n: ("run", self.values[:, i]) for i, n in enumerate(self.names)})


def unit_design(count: int, dimension: int, seed: int, method: str) -> Float[np.ndarray, "count dimension"]:
    """Design of experiments in the unit cube."""
    check_choice("sample: method", method, METHODS)
    if count < 1:
        raise InputError("sample: count", f"{count}", "1 or more")
    rng = stream(seed, METHODS[method])
    if method == "random":
        points = rng.random((count, dimension))
    elif method == "sobol":
        # Draw up to the next power of two, where the sequence is balanced, and keep the first points.
        power = int(np.ceil(np.log2(max(count, 2))))
        points = scipy.stats.qmc.Sobol(dimension, scramble=True, **_generator(rng)).random_base2(power)[:count]
    else:
        points = scipy.stats.qmc.LatinHypercube(dimension, **_generator(rng)).random(count)
        if method == "maximin" and count > 2:
            points = _maximin(points, rng)
    return np.clip(points, 1e-12, 1.0 - 1e-12)


def _generator(rng: np.random.Generator) -> dict[str, Any]:
    # SciPy 1.15 renamed the argument from seed to rng.
    return {"rng" if "rng" in inspect.signature(scipy.stats.qmc.LatinHypercube.__init__).parameters else "seed": rng}


def smallest_distance(points: Float[np.ndarray, "point coordinate"]) -> float:
    """Smallest distance between two points of a design."""
    return float(scipy.spatial.cKDTree(points).query(points, k=2)[0][:, 1].min())


def _maximin(points: np.ndarray, rng: np.random.Generator, sweeps: int = 300) -> np.ndarray:
    """Increase the smallest distance between points of a Latin hypercube by exchanging coordinates of the closest pair."""
    best = smallest_distance(points)
    for _ in range(sweeps):
        distance = scipy.spatial.cKDTree(points).query(points, k=2)[0][:, 1]
        row, column = int(np.argmin(distance)), int(rng.integers(points.shape[1]))
        other = int(rng.integers(points.shape[0]))
        trial = points.copy()
        trial[[row, other], column] = trial[[other, row], column]
        candidate = smallest_distance(trial)
        if candidate > best:
            points, best = trial, candidate
    return points
