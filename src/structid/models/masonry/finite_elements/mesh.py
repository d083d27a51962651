"""Nodes, blocks, joints and bars of a wall, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from structid.core.errors import InputError, check_choice
from structid.models.masonry.finite_elements.layout import TOLERANCE, Block, Wall

SHORT_BAR = 0.02
"""Length [m] from which the stiffness E A / L of a bar between two coincident nodes is computed."""


class Joint(NamedTuple):
    """A joint: a point at which the faces of two blocks touch."""

    # End nodes of the face of the lower or left block; −1 is the ground
    lower: tuple[int, int]
    # End nodes of the face of the upper or right block; −1 is the ground
    upper: tuple[int, int]
    weights: tuple[float, float]  # weights of the end nodes in the displacement of the point
    normal: tuple[float, float]  # direction from the lower to the upper block, or from the left to the right block
    area: float  # area [m²]
    place: tuple[float, float]  # coordinates [m]
    name: str  # location, such as ``"between zone 1, bay 1, course 1 and zone 1, bay 1, course 2, left"``


@dataclass(frozen=True, eq=False)
class Mesh:
    """The mesh of a wall as arrays."""

    wall: Wall  # wall of the mesh
    nodes: Float[np.ndarray, "node 2"] = field(repr=False)  # coordinates [m]; each block has four separate nodes
    blocks: Int[np.ndarray, "block 4"] = field(repr=False)  # nodes of every block, counterclockwise from the lower left
    block_names: tuple[str, ...] = field(repr=False)  # locations of the blocks
    joints: tuple[Joint, ...] = field(repr=False)
    bars: Int[np.ndarray, "bar 2"] = field(repr=False)  # End nodes of the loading beam's bars, from left to right
    bar_lengths: Float[np.ndarray, " bar"] = field(repr=False)  # lengths [m]; `SHORT_BAR` if both nodes coincide
    fixed: Int[np.ndarray, " fixed"] = field(repr=False)  # fixed nodes

    @property
    def free(self) -> np.ndarray:
        """Free degrees of freedom: node i has the number 2 i horizontally and 2 i + 1 vertically."""
        return np.setdiff1d(np.arange(2 * len(self.nodes)), np.concatenate([2 * self.fixed, 2 * self.fixed + 1]))

    @property
    def support(self) -> np.ndarray:
        """Opening and slip [m] at which each joint loses its support, shape (joint, 2).

        A bed joint loses its support if it slides by half its length or opens by half the height of the block above. A
        head joint, between neighbours in a course, supports nothing, so its limits are infinite.
        """
        support = np.full((len(self.joints), 2), np.inf)
        for number, joint in enumerate(self.joints):
            if joint.normal[1]:
                corners = self.nodes[self.blocks[joint.upper[0] // 4]]
                support[number] = 0.5 * np.ptp(corners[:, 1]), 0.5 * np.ptp(corners[:, 0])
        return support

    @property
    def top_blocks(self) -> np.ndarray:
        """Blocks under the beam, from left to right."""
        tops = self.nodes[self.blocks[:, 2], 1]
        top = np.flatnonzero(tops > self.wall.height - TOLERANCE)
        return np.asarray(top[np.argsort(self.nodes[self.blocks[top, 0], 0])])

    def corner(self, name: str) -> int:
        """Find the node at a top corner of the wall."""
        check_choice("Mesh.corner", name, ("top_left", "top_right"))
        blocks = self.blocks[self.top_blocks]
        return int(blocks[0, 3] if name == "top_left" else blocks[-1, 2])

    def __str__(self) -> str:
        return (
            f"Mesh: {len(self.blocks)} blocks, {len(self.joints)} joints, {len(self.bars)} bars, {len(self.nodes)} nodes, "
            f"{len(self.free)} free degrees of freedom"
        )


def mesh_of(wall: Wall, joint_points: str = "ends", base_joint: bool = False) -> Mesh:
    """Mesh a wall."""
    check_choice("joint_points", joint_points, ("ends", "gauss"))
    blocks = wall.blocks
    corners = np.array([[(b.left, b.bottom), (b.right, b.bottom), (b.right, b.top), (b.left, b.top)] for b in blocks])
    numbers = np.arange(4 * len(blocks)).reshape(-1, 4)
    nodes = corners.reshape(-1, 2)
    joints = _joints(blocks, numbers, wall.thickness, joint_points, base_joint)
    at_base = np.flatnonzero(nodes[:, 1] < TOLERANCE)
    fixed = np.array([], dtype=int) if base_joint else at_base
    _check_supported(blocks, joints)
    bars, lengths = _bars(blocks, numbers, wall.height)
    return Mesh(wall, nodes, numbers, tuple(b.name for b in blocks), tuple(joints), bars, lengths, fixed)


def _joints(blocks: list[Block], numbers: np.ndarray, thickness: float, points: str, base_joint: bool) -> list[Joint]:
    """Return the joints: two on every line along which two blocks touch."""
    joints: list[Joint] = []
    for i, one in enumerate(blocks):
        if base_joint and one.bottom < TOLERANCE:
            face, ends = (int(numbers[i, 0]), int(numbers[i, 1])), ((one.left, 0.0), (one.right, 0.0))
            joints += _on_a_line(
                (-1, -1), face, ends, (0.0, 1.0), thickness, points, f"between the ground and {one.name}"
            )
        for j, other in enumerate(blocks):
            name = f"between {one.name} and {other.name}"
            if _same(one.top, other.bottom) and _same(one.left, other.left) and _same(one.right, other.right):
                lower, upper = (int(numbers[i, 3]), int(numbers[i, 2])), (int(numbers[j, 0]), int(numbers[j, 1]))
                ends = ((one.left, one.top), (one.right, one.top))
                joints += _on_a_line(lower, upper, ends, (0.0, 1.0), thickness, points, name)
            elif _same(one.right, other.left) and _same(one.bottom, other.bottom) and _same(one.top, other.top):
                lower, upper = (int(numbers[i, 1]), int(numbers[i, 2])), (int(numbers[j, 0]), int(numbers[j, 3]))
                ends = ((one.right, one.bottom), (one.right, one.top))
                joints += _on_a_line(lower, upper, ends, (1.0, 0.0), thickness, points, name)
    return joints


def _on_a_line(
    lower: tuple[int, int],
    upper: tuple[int, int],
    ends: tuple[tuple[float, float], tuple[float, float]],
    normal: tuple[float, float],
    thickness: float,
    points: str,
    name: str,
) -> list[Joint]:
    length = float(np.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]))
    share = 1.0 if points == "ends" else 0.5 + 0.5 / np.sqrt(3.0)
    sides = ("left", "right") if normal[1] else ("below", "above")
    result = []
    for weights, side in zip(((share, 1.0 - share), (1.0 - share, share)), sides, strict=True):
        position = (
            weights[0] * ends[0][0] + weights[1] * ends[1][0],
            weights[0] * ends[0][1] + weights[1] * ends[1][1],
        )
        result.append(Joint(lower, upper, weights, normal, 0.5 * length * thickness, position, f"{name}, {side}"))
    return result


def _same(a: float, b: float) -> bool:
    return abs(a - b) < TOLERANCE


def _bars(blocks: list[Block], numbers: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the bars of the beam, which connect neighbouring nodes of the top."""
    top = sorted((i for i, b in enumerate(blocks) if _same(b.top, height)), key=lambda i: blocks[i].left)
    row = [int(n) for i in top for n in (numbers[i, 3], numbers[i, 2])]
    places = [x for i in top for x in (blocks[i].left, blocks[i].right)]
    gaps = np.diff(places)
    return np.array(list(pairwise(row))), np.where(gaps > TOLERANCE, gaps, SHORT_BAR)


def _check_supported(blocks: list[Block], joints: list[Joint]) -> None:
    """Refuse a block that is not connected to the base by a chain of joints."""
    touching: dict[int, set[int]] = {i: set() for i in range(len(blocks))}
    for joint in joints:
        one, other = (face[0] // 4 if face[0] >= 0 else None for face in (joint.lower, joint.upper))
        if one is not None and other is not None:
            touching[one].add(other)
            touching[other].add(one)
    reached = {i for i, b in enumerate(blocks) if b.bottom < TOLERANCE}
    edge = set(reached)
    while edge:
        edge = {j for i in edge for j in touching[i]} - reached
        reached |= edge
    lost = [b.name for i, b in enumerate(blocks) if i not in reached]
    if lost:
        raise InputError(
            "Wall", f"nothing supports {'; '.join(lost[:3])}", "blocks supported by other blocks down to the base"
        )
