"""Symmetries in space: of shapes whose groups are known, and of what breaks them."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.symmetry import symmetries_of

# Off the origin, and turned: nothing of it is along the axes.
ELSEWHERE = np.eye(4)
ELSEWHERE[:3, :3] = Rotation.from_euler("zyx", [0.4, 0.9, -0.3]).as_matrix()
ELSEWHERE[:3, 3] = 0.02, -0.01, 0.03


def piece(mesh, rgba=(0.5, 0.5, 0.5, 1.0)):
    return Piece(Mesh(np.array(mesh.vertices), np.array(mesh.faces)), rgba)


def prism(sides, height=0.05, radius=0.04):
    return trimesh.creation.cylinder(radius, height, sections=sides)


SHAPES = {
    "oblong": (trimesh.creation.box((0.06, 0.10, 0.04)), 0, 3),
    "square": (trimesh.creation.box((0.08, 0.08, 0.03)), 0, 7),
    "cube": (trimesh.creation.box((0.07, 0.07, 0.07)), 0, 23),
    "six sides": (prism(6), 0, 11),
    "cylinder": (prism(64), 1, 1),
    "cone": (trimesh.creation.cone(0.04, 0.09, sections=64), 1, 0),
    "ball": (trimesh.creation.icosphere(2, 0.04), 3, 0),
    "wedge": (
        trimesh.convex.convex_hull([[0, 0, 0], [0.1, 0, 0], [0, 0.06, 0], [0, 0, 0.04]]),
        0,
        0,
    ),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("place", [np.eye(4), ELSEWHERE], ids=["upright", "elsewhere"])
def test_known_shapes_have_their_groups(name, place):
    shape, num_axes, num_motions = SHAPES[name]
    moved = shape.copy().apply_transform(place)
    found = symmetries_of([piece(moved)])
    assert (len(found.axes), len(found.motions)) == (num_axes, num_motions)
    for motion in found.motions:
        np.testing.assert_allclose(motion[:3, :3] @ motion[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(motion[:3, :3]) == pytest.approx(1.0)
        # With the one that moves nothing it is a group: any two make a third.
        known = [np.eye(4), *found.motions]
        for other in known:
            assert min(np.abs(motion @ other - each).max() for each in known) < 1e-9
        points = trimesh.transform_points(moved.vertices, motion)
        assert trimesh.proximity.closest_point_naive(moved, points[:8])[1].max() < 0.003
    for axis in found.axes:
        turn = trimesh.transformations.rotation_matrix(1.0, axis, found.point)
        points = trimesh.transform_points(moved.vertices[:8], turn)
        assert trimesh.proximity.closest_point_naive(moved, points)[1].max() < 0.003
