"""The poses in which a body rests, and which of them is the usual one."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.solid import solid_of
from cluttergen_jax.assets.stances import stances, usual_poses

TURN = Rotation.random(random_state=3).as_matrix()


def box(*sides):
    return trimesh.creation.box(sides)


def can(radius, height):
    return trimesh.creation.cylinder(radius, height, sections=48)


def up_of(mesh, turn):
    """Where up is, in the frame of the mesh, after it was turned and set down as people put it."""
    solid = solid_of([Mesh(np.asarray(mesh.vertices) @ turn.T, np.asarray(mesh.faces))])
    choice = usual_poses(solid, turn @ np.asarray(mesh.center_mass))
    return turn.T @ (np.array([0, 0, 1.0]) if choice.is_kept else choice.poses[0][0].up)


def test_a_box_rests_on_each_side_and_tips_over_an_edge():
    a, b, c = sides = 0.06, 0.1, 0.16
    found = stances(np.asarray(box(*sides).vertices), np.zeros(3))
    assert len(found) == 6
    for each in found:
        height = sides[np.abs(each.up).argmax()]
        shorter = min(side for side in sides if side != height)
        assert each.height == pytest.approx(height)
        assert each.tip == pytest.approx(np.arctan2(shorter, height))
    # The solid angle of a box's side, seen from its middle, in closed form.
    share = np.arctan(b * c / (a * np.sqrt(a**2 + b**2 + c**2))) / np.pi
    widest = [each.likelihood for each in found if each.height == pytest.approx(a)]
    assert sum(widest) == pytest.approx(2 * share)
    assert sum(each.likelihood for each in found) == pytest.approx(1)


@pytest.mark.parametrize("seed", range(3))
def test_poses_turn_with_the_body(seed):
    points = np.random.default_rng(seed).normal(size=(40, 3)) * (0.03, 0.05, 0.02)
    turn = Rotation.random(random_state=seed).as_matrix()
    before = stances(points, np.zeros(3))
    after = stances(points @ turn.T, np.zeros(3))
    np.testing.assert_allclose(
        [each.tip for each in before], [each.tip for each in after], atol=1e-6
    )
    np.testing.assert_allclose(
        [turn @ each.up for each in before], [each.up for each in after], atol=1e-6
    )


LIES = Rotation.from_euler("x", 90, degrees=True).as_matrix()
STANDING = [can(0.033, 0.1), can(0.043, 0.033), box(0.07, 0.07, 0.2)]


@pytest.mark.parametrize("mesh", STANDING, ids=["soup can", "tuna can", "carton"])
@pytest.mark.parametrize("turn", [np.eye(3), TURN, LIES], ids=["upright", "anyhow", "on its side"])
def test_cans_and_cartons_stand(mesh, turn):
    assert abs(up_of(mesh, turn)[2]) > np.cos(np.radians(15))
