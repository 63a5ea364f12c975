"""Visual surfaces face outwards whatever their files say, and sheets are drawn from both sides."""

import numpy as np
import pytest

from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.orientation import orient_faces
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.solid import simplify_solid, solid_of
from cluttergen_jax.importing.readers.primitives import cylinder, ellipsoid
from tests.helpers.shapes import open_box_slabs, slab

BALL = ellipsoid(np.full(3, 0.05))
RNG = np.random.default_rng(0)


def inverted(mesh, which=slice(None)):
    faces = mesh.faces.copy()
    faces[which] = faces[which][:, ::-1]
    return Mesh(mesh.vertices, faces)


def turned_outwards(*meshes):
    """All surfaces of the pieces after they have been faced."""
    pieces = orient_faces([Piece(mesh) for mesh in meshes], solid_of(meshes))
    return join_meshes([piece.mesh for piece in pieces])


def winding(mesh, points):
    """How often a closed surface goes around each point: 1 inside, 0 outside (Van Oosterom and Strackee)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(each, axis=2) for each in (a, b, c))
    volume = (a * np.cross(b, c)).sum(2)
    base = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    return np.arctan2(volume, base).sum(1) / (2 * np.pi)


def facing_out(mesh, solid, step=5e-4):
    """The share of the surface's area that has air, not the solid, before it, seen at 200 triangles."""
    solid = simplify_solid(solid, 2e-4)
    corners = mesh.vertices[mesh.faces[np.linspace(0, len(mesh.faces) - 1, 200).astype(int)]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1, keepdims=True)
    before = winding(solid, corners.mean(1) + step * normals / area)
    return float((area[:, 0] * (before < 0.5)).sum() / area.sum())


@pytest.mark.parametrize(
    "mesh",
    [
        inverted(BALL),
        inverted(BALL, RNG.random(len(BALL.faces)) < 0.4),
        inverted(Mesh(BALL.vertices, BALL.faces[1:]), slice(0, 500)),
        inverted(cylinder(0.03, 0.05), slice(None, None, 2)),
    ],
    ids=["closed", "partly", "holed", "striped"],
)
def test_an_inverted_surface_is_turned_outwards(mesh):
    solid = solid_of([mesh]).mesh
    assert facing_out(mesh, solid) < 0.7
    after = turned_outwards(mesh)
    assert facing_out(after, solid) == 1.0
    np.testing.assert_array_equal(np.sort(after.faces, axis=1), np.sort(mesh.faces, axis=1))


def test_what_faces_outwards_stays_as_it_is():
    for meshes in ([BALL], [slab((0.05, 0.04, 0.03)), BALL], open_box_slabs()):
        after = turned_outwards(*meshes)
        np.testing.assert_array_equal(after.faces, join_meshes(meshes).faces)


def test_a_bowl_of_one_sheet_is_seen_from_both_sides():
    is_bowl = BALL.vertices[BALL.faces, 2].max(1) < 0.01
    bowl = inverted(Mesh(BALL.vertices, BALL.faces[is_bowl]), slice(0, 400))
    after = turned_outwards(bowl)
    num = len(bowl.faces)
    assert len(after.faces) == 2 * num
    corners = after.vertices[after.faces]
    outwards = (
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * corners.mean(1)
    ).sum(1)
    assert (outwards[:num] > 0).all()
    assert (outwards[num:] < 0).all()
    # The second side lies inside the first, where it belongs.
    radius = np.linalg.norm(corners.mean(1), axis=1)
    np.testing.assert_allclose(radius[:num] - radius[num:], 0.0002, atol=2e-5)
    (again,) = orient_faces([Piece(bowl)], None)
    assert len(again.mesh.faces) == 2 * num
