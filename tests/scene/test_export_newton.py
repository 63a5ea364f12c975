"""Exported scenes as worlds of Newton, in the interpreter that CLUTTERGEN_NEWTON_PYTHON names.

python -m venv newton && newton/bin/pip install "newton[sim]==1.8.0" trimesh scipy
"""

import os

import mujoco
import pytest

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.scene.export import export_scenes
from tests.helpers.environments import ask_peer
from tests.helpers.exports import assert_same_pose, spread

SECONDS = 0.25
SETS = (("mug", "fork", "soup_can"), ("bowl", "bottle", "fork"))


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_worlds_of_other_objects_stand_side_by_side(tmp_path):
    python = os.environ.get("CLUTTERGEN_NEWTON_PYTHON")
    if not python:
        pytest.skip("CLUTTERGEN_NEWTON_PYTHON names no interpreter that has newton")
    pool = find_pool("dining")
    support = find_support("round_table")
    scenes = [
        spread([pool[name] for name in names], support, names, index)
        for index, names in enumerate(SETS)
    ]
    folder = export_scenes(scenes, tmp_path / "out", "mjcf")
    report = ask_peer("newton", python, folder, SECONDS, seconds=2800)
    assert report["finite"]
    assert report["cone"] == mujoco.mjtCone.mjCONE_ELLIPTIC
    for scene, world in zip(scenes, report["worlds"], strict=True):
        assert set(world["poses"]) == set(scene.names)
        for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
            assert_same_pose(world["poses"][name][:3], world["poses"][name][3:], pose)
            assert world["mass"][name] == pytest.approx(asset.mass, rel=1e-5)
            assert world["shift"][name] < 0.001, name
