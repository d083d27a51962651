"""Walls cut into blocks: the published counts, other façades, and what cannot be a wall."""

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.models.masonry.finite_elements.layout import DOOR, FACADE, Opening, Wall
from structid.models.masonry.finite_elements.mesh import mesh_of

WINDOWS = Wall(
    width=5.0,
    height=3.0,
    openings=(Opening(1.0, 1.0, 1.0, 1.2), Opening(3.0, 1.0, 1.0, 1.2)),
    courses=None,
    course_height=0.2,
)


def test_the_default_has_the_published_counts():
    mesh = mesh_of(FACADE)
    assert (len(mesh.blocks), len(mesh.joints), len(mesh.bars), len(mesh.nodes)) == (15, 34, 7, 60)
    assert len(mesh.free) == 112 and (mesh.bar_lengths == 0.02).sum() == 3
    assert str(mesh) == "Mesh: 15 blocks, 34 joints, 7 bars, 60 nodes, 112 free degrees of freedom"
    assert len({joint.name for joint in mesh.joints}) == 34


def test_areas_of_blocks_and_joints():
    for wall in (FACADE, Wall(), WINDOWS):
        blocks = sum((b.right - b.left) * (b.top - b.bottom) for b in wall.blocks)
        assert blocks == pytest.approx(wall.width * wall.height - sum(o.width * o.height for o in wall.openings))
        mesh = mesh_of(wall)
        at_sill = [j.area for j in mesh.joints if j.normal == (0.0, 1.0) and abs(j.place[1] - wall.zones[0][1]) < 1e-9]
        solid = wall.width - sum(o.width for o in wall.openings if o.bottom <= wall.zones[0][1] <= o.top)
        assert sum(at_sill) == pytest.approx(solid * wall.thickness)


@pytest.mark.parametrize("points", ["ends", "gauss"])
def test_normals_point_from_lower_to_upper_and_from_left_to_right(points):
    mesh = mesh_of(WINDOWS, points)
    for joint in mesh.joints:
        centres = [
            mesh.nodes[4 * (face[0] // 4) : 4 * (face[0] // 4) + 4].mean(axis=0) for face in (joint.lower, joint.upper)
        ]
        assert np.dot(centres[1] - centres[0], joint.normal) > 0.1
        ends = [
            np.average(mesh.nodes[list(face)], axis=0, weights=joint.weights) for face in (joint.lower, joint.upper)
        ]
        np.testing.assert_allclose(ends, [joint.place, joint.place], atol=1e-12)


def test_a_wall_on_joints_and_finer_blocks():
    standing = mesh_of(FACADE, base_joint=True)
    assert len(standing.joints) == 38 and len(standing.free) == 120
    fine = Wall(courses=None, course_height=0.2, block_length=0.3)
    assert max(b.right - b.left for b in fine.blocks) < 0.3 + 1e-9 and len(fine.blocks) > 90


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(openings=(Opening(1.0, 0.0, 3.0, 1.0),)), "does not fit.*2.7 m wide"),
        (dict(openings=(DOOR, Opening(2.0, 0.0, 0.5, 1.0))), "overlaps the opening from .1.2, 0."),
        (dict(courses=None, course_height=0.3), "does not fit: the zone from 0 to 1.6 m"),
        (dict(courses=(2,)), "one for each of the 2 zones"),
        (dict(courses=((4, 3, 2), 2)), "whole number from 1, or one for each of the 2 bays"),
        (dict(thickness=0.0), "Wall.thickness: 0"),
        (dict(widht=3.0), "Did you mean 'width'"),
    ],
)
def test_what_is_no_wall(settings, words):
    with pytest.raises(InputError, match=words):
        Wall(**settings)


def test_blocks_that_nothing_supports():
    with pytest.raises(InputError, match="nothing supports zone 2"):
        mesh_of(
            Wall(
                openings=(Opening(0.0, 0.0, 1.35, 1.0), Opening(1.35, 0.0, 1.35, 1.0)), courses=None, course_height=0.2
            )
        )
