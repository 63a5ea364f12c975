"""Rerun's recordings, read by Rerun's own reader."""

import numpy as np
import pytest

from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.scene.export import export_scenes
from cluttergen_jax.scene.export import rerun as own
from tests.helpers.exports import assert_same_pose, exporter
from tests.helpers.reruns import columns_of


@pytest.fixture(scope="module")
def held(scene, tmp_path_factory):
    """By path and column what the recording of the scene holds."""
    pytest.importorskip("rerun", reason="needs the extra rerun")
    folder = exporter(scene, tmp_path_factory, cameras=("front",))("rerun")
    return columns_of(folder / "scenes" / "000000.rrd")


def test_objects_stand_where_the_scene_has_them(held, scene):
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        own = held[f"/world/objects/{name}"]
        (turn,) = own["Transform3D:quaternion"][0]
        (place,) = own["Transform3D:translation"][0]
        x, y, z, w = turn
        assert_same_pose(place, (w, x, y, z), pose)
        parts = [path for path in held if path.startswith(f"/world/objects/{name}/collision/")]
        assert len(parts) == len(asset.parts)
        surfaces = [path for path in held if path.startswith(f"/world/objects/{name}/surface-")]
        assert len(surfaces) == len(asset.drawn_pieces)
        points = np.concatenate([held[path]["Mesh3D:vertex_positions"][0] for path in surfaces])
        drawn = np.concatenate([piece.mesh.vertices for piece in asset.drawn_pieces])
        np.testing.assert_allclose(points.min(0), drawn.min(0), atol=1e-6)
        np.testing.assert_allclose(points.max(0), drawn.max(0), atol=1e-6)


def test_the_camera_sees_what_ours_sees(held, scene, tmp_path):
    own = held["/world/cameras/front"]
    (K,) = own["Pinhole:image_from_camera"][0]
    assert own["Pinhole:resolution"][0] == [[640, 480]]
    # Columns one after another.
    K = np.array(K).reshape(3, 3).T
    (turn,) = own["Transform3D:mat3x3"][0]
    (eye,) = own["Transform3D:translation"][0]
    aim = scene.support.region_points[0] - eye
    column, row, depth = K @ np.array(turn).reshape(3, 3) @ aim
    np.testing.assert_allclose([column / depth, row / depth], [320, 240], atol=0.01)


def test_without_the_extra_it_says_which(scene, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rerun", None)
    with pytest.raises(MissingExtraError, match="extra 'rerun'"):
        own.require_rerun()
    with pytest.raises(MissingExtraError, match="extra 'rerun'"):
        export_scenes([scene], tmp_path / "out", "rerun")
    assert not list(tmp_path.iterdir())
