"""Pictures of a wall: the mesh with loads and supports, and the pictures in a report."""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from structid.mechanics.cohesive_laws import CohesiveLaw, JointLaw
from structid.models.masonry.equations.wall_channels import is_point, point_of
from structid.models.masonry.finite_elements.assembly import Assembly
from structid.models.masonry.wall_film import GRID, WallFilm
from structid.models.pictures import Film, ModelPicture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PATH = (0.0, 2.0, 0.0, 6.0)
"""Turning points of the path of a drawn joint law, in characteristic lengths: loading, unloading, reloading."""
CLOSURE = 0.6
"""Over-closure at which the drawn curves of the normal traction begin, in characteristic lengths."""
PATH_POINTS = 121
"""Number of points on each part of the path."""

FRAMES = 60
"""Number of frames of the film in a report."""


def drawn_mesh(assembly: Assembly, channels: tuple[str, ...], save: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the mesh of a wall: blocks with their numbers, joints, beam, supports, loads, recorded points."""
    from structid.figures import wall as figures

    mesh, masonry = assembly.mesh, assembly.masonry
    loads: dict[tuple[float, float], float] = {}  # loads of neighbouring blocks act at the same point
    for node, share in assembly.beam_shares(everywhere=False):
        point = float(mesh.nodes[node, 0]), float(mesh.nodes[node, 1])
        loads[point] = loads.get(point, 0.0) + 1e-3 * masonry.vertical_load * share
    nodes = dict.fromkeys(point_of(mesh, channel)[0] for channel in (*channels, "ux_top_left") if is_point(channel))
    return figures.mesh(
        mesh.nodes[mesh.blocks],
        np.array([joint.place for joint in mesh.joints]).reshape(-1, 2),
        mesh.nodes[mesh.bars],
        mesh.nodes[mesh.fixed],
        [(*point, force) for point, force in loads.items()],
        [(f"node {node}", *mesh.nodes[node]) for node in nodes],
        f"{len(mesh.blocks)} blocks, {len(mesh.nodes)} nodes, {len(mesh.free)} degrees of freedom; "
        f"{1e-3 * masonry.upper_mass:g} t on the beam",
        save=save,
    )


def drawn_joint(law: CohesiveLaw, joint: JointLaw, save: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the tractions of a joint against opening and slip, with one cycle of unloading and reloading."""
    from structid.figures import wall as figures

    of_one = CohesiveLaw(*(np.ravel(value)[0] for value in law))
    path = np.concatenate([np.linspace(a, b, PATH_POINTS) for a, b in pairwise(PATH)])
    normal, tangential = path * of_one.normal_length, path * of_one.tangential_length
    pressed = np.linspace(-CLOSURE, 0.0, PATH_POINTS) * of_one.normal_length
    curves = [
        [
            (np.r_[pressed, normal], _tractions(of_one, joint, np.r_[pressed, normal], 0.0)[0], "no slip"),
            (normal, _tractions(of_one, joint, normal, of_one.tangential_length)[0], "slip of δt"),
        ],
        [
            (tangential, _tractions(of_one, joint, 0.0, tangential)[1], "closed"),
            (tangential, _tractions(of_one, joint, of_one.normal_length, tangential)[1], "opening of δn"),
        ],
    ]
    return figures.joint_law([[(1e3 * x, 1e-6 * y, name) for x, y, name in panel] for panel in curves], save=save)


def _tractions(law: CohesiveLaw, joint: JointLaw, opening: Any, slip: Any) -> tuple[np.ndarray, np.ndarray]:
    """Compute T_n and T_t [Pa] along a path of jumps, step by step with memory."""
    memory, tractions = np.zeros((joint.memories, 1)), []
    for jumps in zip(*np.broadcast_arrays(opening, slip), strict=True):
        at = tuple(np.array([jump]) for jump in jumps)
        response = joint.respond(law, memory, *at)
        tractions.append((response.normal[0], response.tangential[0]))
        memory = joint.remembered(law, memory, *at)
    normal, tangential = np.array(tractions).T
    return normal, tangential


def pictures_of(plot: Callable[[], Figure], film: Callable[[], WallFilm]) -> list[ModelPicture]:
    """Return the pictures of a wall in one run."""
    at = "at the peak drifts of its largest swings"
    strains = (
        f"Von Mises strain {at}, as a camera measures it on a grid of {1e3 * GRID:g} mm. "
        "Open or sliding joints appear as lines."
    )
    return [
        ModelPicture("wall", "The wall.", plot),
        ModelPicture("wall_deformed", f"The deformed wall {at}.", lambda: film().plot()),
        ModelPicture("wall_strains", strains, lambda: film().plot_strains()),
        ModelPicture("wall_film", "The wall in motion.", lambda: Film(lambda path: film().animate(path, FRAMES))),
    ]
