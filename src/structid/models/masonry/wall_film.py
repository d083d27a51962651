"""Motion of all nodes of a wall in one run: pictures at selected instants, film, files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.models.masonry.displacement_field import DisplacementField, von_mises_strain
from structid.models.masonry.finite_elements.elements import shape_functions, strain_matrix
from structid.models.masonry.finite_elements.mesh import Joint, Mesh

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MILESTONES = 5
"""Number of instants in a picture."""
GRID = 0.025
"""Spacing [m] of the grid on which displacements are evaluated, as in a camera measurement."""


@check_arguments
@dataclass(frozen=True, eq=False)
class WallFilm:
    """Motion of every node of a wall in one run."""

    mesh: Mesh  # The wall
    dt: float  # time step [s]
    # Displacements from the unloaded wall [m], up to the end of the run
    displacements: Float[np.ndarray, "time node 2"] = field(repr=False)
    drift: Float[np.ndarray, " time"] = field(repr=False)  # displacement of the top left corner from rest [m]
    base_shear: Float[np.ndarray, " time"] = field(repr=False)  # base shear [N]

    @property
    def time(self) -> np.ndarray:
        """Times of the samples [s], shape (time,)."""
        return np.arange(len(self.drift)) * self.dt

    @cached_property
    def since_rest(self) -> np.ndarray:
        """Displacements relative to the wall at rest under its load [m], shape (time, node, 2)."""
        return np.asarray(self.displacements - self.displacements[:1])

    @cached_property
    def jumps(self) -> np.ndarray:
        """Opening and slip of every joint [m], shape (time, joint, 2)."""
        ground = np.zeros((len(self.displacements), 1, 2))
        u = np.concatenate([self.displacements, ground], axis=1)  # the last node is node −1, the ground
        jumps = np.empty((len(u), len(self.mesh.joints), 2))
        for number, joint in enumerate(self.mesh.joints):
            jump = _on_face(u, joint, joint.upper) - _on_face(u, joint, joint.lower)
            n = np.array(joint.normal)
            jumps[:, number, 0], jumps[:, number, 1] = jump @ n, jump @ np.array([n[1], -n[0]])
        return jumps

    def milestones(self, count: int = MILESTONES) -> list[int]:
        """Select the instants of the peak drifts of the largest swings."""
        swings = np.split(np.arange(len(self.drift)), np.flatnonzero(np.diff(np.sign(self.drift))) + 1)
        extremes = [int(s[np.argmax(np.abs(self.drift[s]))]) for s in swings if len(s)]
        extremes = [i for i in extremes if self.drift[i]]
        largest = sorted(extremes, key=lambda i: -abs(float(self.drift[i])))[:count]
        return sorted(largest)

    @check_arguments
    def displacement_field(self, instants: Sequence[int] | None = None, step: float = GRID) -> DisplacementField:
        """Return the displacements relative to the wall at rest on a regular grid, as a camera measures them."""
        chosen = self.milestones() if instants is None else list(instants)
        wall, u = self.mesh.wall, self.since_rest[chosen]
        if not 0.0 < step <= min(wall.width, wall.height):
            raise InputError(
                "WallFilm.displacement_field(step)", f"{step:g}", "a positive length, smaller than the wall"
            )
        x, y = (_between(length, step) for length in (wall.width, wall.height))
        fields = np.full((2, len(chosen), len(y), len(x)), np.nan)
        for nodes in self.mesh.blocks:
            corners = self.mesh.nodes[nodes]
            (left, bottom), (right, top) = corners[0], corners[2]
            columns, rows = np.flatnonzero((x >= left) & (x <= right)), np.flatnonzero((y >= bottom) & (y <= top))
            for row in rows:
                for column in columns:
                    r, s = (
                        2.0 * (x[column] - left) / (right - left) - 1.0,
                        2.0 * (y[row] - bottom) / (top - bottom) - 1.0,
                    )
                    values, _ = shape_functions(float(r), float(s))
                    fields[:, :, row, column] = np.einsum("n,tnd->dt", values, u[:, nodes])
        return DisplacementField(self.time[chosen], x, y, *fields)

    # --- pictures -----------------------------------------------------------------------------------------------

    @check_arguments
    def plot(
        self,
        instants: Sequence[int] | None = None,
        scale: float | None = None,
        save: str | os.PathLike[str] | None = None,
    ) -> Figure:
        """Draw the deformed wall, with joints coloured by opening."""
        from structid.figures import wall as figures

        chosen = self.milestones() if instants is None else list(instants)
        by = self._scale if scale is None else scale
        return figures.deformed(
            self.mesh.nodes[self.mesh.blocks],
            [by * self.since_rest[i][self.mesh.blocks] for i in chosen],
            _faces(self.mesh),
            [1e3 * self.jumps[i, :, 0] for i in chosen],
            [
                f"{number}: {self.time[i]:.2f} s, {1e3 * self.drift[i]:.1f} mm"
                for number, i in enumerate(chosen, start=1)
            ],
            by,
            (1e3 * self.drift, 1e-3 * self.base_shear, chosen),
            save=save,
        )

    @property
    def _scale(self) -> float:
        largest = float(np.abs(self.since_rest).max())
        return max(1.0, float(f"{0.1 * self.mesh.wall.height / largest:.1g}")) if largest > 0.0 else 1.0

    @check_arguments
    def plot_strains(
        self, instants: Sequence[int] | None = None, step: float = GRID, save: str | os.PathLike[str] | None = None
    ) -> Figure:
        """Draw maps of the von Mises strain as a camera measures it; an open joint appears as a line of large strain."""
        return self.displacement_field(instants, step).plot(save=save)

    @check_arguments
    def animate(self, path: str | os.PathLike[str], frames: int = 100, per_second: int = 20) -> Path:
        """Write a film of the deformed wall, with a plot of the drift below it."""
        from structid.figures import wall_film as figures

        chosen = np.unique(np.linspace(0, len(self.drift) - 1, frames).round().astype(int))
        return figures.animation(
            Path(path),
            self.mesh.nodes[self.mesh.blocks],
            self._scale * self.since_rest[chosen][:, self.mesh.blocks],
            self.time,
            1e3 * self.drift,
            chosen,
            self._scale,
            per_second,
        )

    # --- files --------------------------------------------------------------------------------------------------

    @check_arguments
    def to_vtu(self, folder: str | os.PathLike[str], instants: Sequence[int] | None = None) -> Path:
        """Write the wall for ParaView: a VTU file for every instant, and ``wall.pvd``, which lists the files with their times.

        Blocks are quadrilaterals with the von Mises strain at their centres. Joints are points with opening and slip.
        """
        try:
            import meshio
        except ImportError:
            raise InputError(
                "WallFilm.to_vtu", "meshio is not installed", "the extra 'vtk'", "Run: pip install 'structid[vtk]'."
            ) from None
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        chosen = np.unique(np.linspace(0, len(self.drift) - 1, 100).astype(int)) if instants is None else instants
        places = np.array([joint.place for joint in self.mesh.joints])
        points = np.concatenate([self.mesh.nodes, places])
        cells = [
            ("quad", self.mesh.blocks),
            ("vertex", len(self.mesh.nodes) + np.arange(len(places))[:, None]),
        ]
        lines = []
        for number, i in enumerate(chosen):
            displacements = np.concatenate([self.since_rest[i], self._of_joints(int(i))])
            none = np.zeros(len(self.mesh.blocks))
            jumps = {
                name: [none, self.jumps[i, :, column]] for column, name in enumerate(("joint opening", "joint slip"))
            }
            strain = [self._strain_of_blocks(int(i)), np.zeros(len(places))]
            meshio.Mesh(
                np.pad(points, ((0, 0), (0, 1))),
                cells,
                point_data={"displacement": np.pad(displacements, ((0, 0), (0, 1)))},
                cell_data={"von Mises strain": strain, **jumps},
            ).write(folder / f"wall_{number:04d}.vtu")
            lines.append(f'<DataSet timestep="{self.time[i]:.9g}" file={quoteattr(f"wall_{number:04d}.vtu")}/>')
        head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1"><Collection>\n'
        (folder / "wall.pvd").write_text(head + "\n".join(lines) + "\n</Collection></VTKFile>\n", encoding="utf-8")
        return folder / "wall.pvd"

    def _of_joints(self, instant: int) -> np.ndarray:
        """Return the displacements of the lower side of every joint, relative to rest [m], shape (joint, 2)."""
        u = np.concatenate([self.since_rest[instant], np.zeros((1, 2))])
        return np.array([_on_face(u, joint, joint.lower) for joint in self.mesh.joints])

    def _strain_of_blocks(self, instant: int) -> np.ndarray:
        """Return the von Mises strain at the centre of every block, shape (block,)."""
        strains = []
        for nodes in self.mesh.blocks:
            b, _ = strain_matrix(self.mesh.nodes[nodes], 0.0, 0.0)
            strains.append(von_mises_strain(*(b @ self.since_rest[instant][nodes].ravel())))
        return np.array(strains)


def _on_face(u: np.ndarray, joint: Joint, face: tuple[int, int]) -> np.ndarray:
    """Return the displacements of one side of a joint, interpolated from its nodes (..., node, 2)."""
    return np.asarray(joint.weights[0] * u[..., face[0], :] + joint.weights[1] * u[..., face[1], :])


def _between(length: float, step: float) -> np.ndarray:
    """Divide a length into equal parts, each at most one step long, and return their midpoints."""
    parts = int(np.ceil(length / step - 1e-9))
    return (np.arange(parts) + 0.5) * length / parts


def _faces(mesh: Mesh) -> np.ndarray:
    """Return for every joint the block above or to the right, and two of its corners, shape (joint, 3)."""
    faces = []
    for joint in mesh.joints:
        block = joint.upper[0] // 4
        faces.append((block, joint.upper[0] - 4 * block, joint.upper[1] - 4 * block))
    return np.array(faces)
