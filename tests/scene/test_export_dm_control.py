"""Exported scenes as arenas of dm_control's composer, in an interpreter of its own.

CLUTTERGEN_DM_CONTROL_PYTHON names one that has dm_control 1.0.50 and MuJoCo 3.17; else one is made.
"""

import numpy as np
import pytest

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.scene.export import export_scenes
from tests.helpers.environments import ask_peer, peer_python
from tests.helpers.exports import NAMES, assert_same_pose, spread

SECONDS = 1.0


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_an_arena_has_the_scene_with_free_joints_of_its_own(tmp_path):
    pool = find_pool("dining")
    support = find_support("round_table")
    objects = [pool[name.split("#")[0]] for name in NAMES]
    scenes = [spread(objects, support, NAMES, index, 0.7 + index) for index in range(2)]
    folder = export_scenes(scenes, tmp_path / "out", "mjcf")
    python = peer_python("dm_control", tmp_path / "env", "dm-control==1.0.50", "mujoco==3.17.0")
    report = ask_peer("dm_control_arena", python, folder, SECONDS)
    for episode in (*report["fixed"], *report["drawn"]):
        scene = scenes[episode["scene"]]
        assert set(episode["before"]) == set(scene.names)
        assert episode["finite"]
        for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
            assert_same_pose(episode["before"][name][:3], episode["before"][name][3:], pose)
            assert episode["mass"][name] == pytest.approx(asset.mass, rel=1e-6)
            shift = np.subtract(episode["after"][name][:3], pose[:3])
            assert np.linalg.norm(shift) < 0.001, name
    assert [episode["scene"] for episode in report["fixed"]] == [1, 1]
    alone, given = report["options"]
    assert alone == given
