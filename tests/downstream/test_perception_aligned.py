"""Cameras that stand elsewhere than they are said to: what stands on the table tells where."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("small_gicp", reason="needs the extra perception")

from cluttergen_jax.downstream.perception.corrections import correct_camera
from cluttergen_jax.downstream.perception.object_model import ObjectModel
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.sensing import View
from tests.helpers.perception import OBJECTS, POSES, TABLE, overhead, view_of

MODELS = [ObjectModel.of(each) for each in OBJECTS]
CORNERS = np.array([[x, y, TABLE.top] for x in (-0.25, 0.25) for y in (-0.3, 0.3)])


def known(poses=POSES):
    return {k: (MODELS[k], matrix_of(pose)) for k, pose in enumerate(poses)}


@pytest.fixture(scope="module")
def wrong():
    """A look by a camera that is said to be turned by a degree, and 4 mm beside where it is."""
    view = view_of(POSES, overhead()).view
    T = view.camera.T_world_camera.copy()
    T[:3, :3] = yaw_matrix(np.radians(1)) @ T[:3, :3]
    T[:2, 3] += [0.004, -0.002]
    depth = np.where(np.isfinite(view.depth), view.depth, np.nan)
    return View(depth, view.label, replace(view.camera, T_world_camera=T))


def error(look):
    """Metres, the largest of the table's corners: from where they are to where the camera would see them."""
    true = overhead().T_world_camera
    local = (CORNERS - true[:3, 3]) @ true[:3, :3]
    told = look.camera.T_world_camera
    return np.linalg.norm(local @ told[:3, :3].T + told[:3, 3] - CORNERS, axis=1).max()


def test_the_camera_comes_to_where_it_is(wrong):
    assert error(wrong) > 0.008
    found = correct_camera(wrong, known())
    assert error(found) < 0.0015
    # Nothing is made of the picture itself, and height and tilt are left to the table.
    assert found.depth is wrong.depth
    assert found.label is wrong.label
    assert found.camera.T_world_camera[2] == pytest.approx(wrong.camera.T_world_camera[2])
    assert error(wrong) * 0.4 < error(correct_camera(wrong, known(), 0.5)) < error(wrong) * 0.6
    assert error(correct_camera(wrong, known(), 0.0)) == pytest.approx(error(wrong))


def test_what_has_moved_is_outvoted(wrong):
    moved = POSES.copy()
    moved[2, :2] += [0.012, 0.006]
    assert error(correct_camera(wrong, known(moved))) < 0.003
