"""What the script for Isaac Lab asks of it, against stand-ins of its documented interface.

Isaac Sim, which wants a GPU, has not run it. CLUTTERGEN_ISAACLAB_PYTHON names an interpreter that has torch.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.scene.export import export_scenes
from tests.helpers.environments import ask_peer
from tests.helpers.exports import spread

SETS = (("mug", "fork"), ("mug", "fork"), ("bowl", "mug"))
NUM_WORLDS = 5


@pytest.fixture(scope="module")
def scenes():
    pool = find_pool("dining")
    return [
        spread([pool[name] for name in names], cuboid_table(), names, index, 0.3 + index)
        for index, names in enumerate(SETS)
    ]


@pytest.fixture(scope="module")
def folder(scenes, tmp_path_factory):
    pytest.importorskip("pxr", reason="needs the extra usd")
    return export_scenes(scenes, tmp_path_factory.mktemp("usd") / "out", "usd")


def asked(folder, lab_version):
    """What the script did with so many worlds, all but the first of which are reset."""
    python = os.environ.get("CLUTTERGEN_ISAACLAB_PYTHON")
    if not python:
        pytest.skip("CLUTTERGEN_ISAACLAB_PYTHON names no interpreter that has torch")
    return ask_peer("isaaclab", python, folder, lab_version, NUM_WORLDS)


@pytest.mark.parametrize("lab_version", [2, 3])
def test_worlds_are_put_as_in_scenes_of_their_objects(folder, scenes, lab_version):
    report = asked(folder, lab_version)
    assert report["order"] == {2: "wxyz", 3: "xyzw"}[lab_version]
    assert report["mode"] == "reset"
    assert report["env_ids"] == list(range(1, NUM_WORLDS))
    assert report["sets"] == [["fork", "mug"], ["bowl", "mug"]]
    assert np.ptp(report["velocities"]) == 0
    for world, poses in zip(report["env_ids"], report["poses"], strict=True):
        found = np.array(poses)
        found[:, :3] -= report["origins"][world]
        if lab_version == 3:
            found = found[:, [0, 1, 2, 6, 3, 4, 5]]
        names = report["sets"][report["sets_of_worlds"][world]]
        known = [
            [dict(zip(each.names, each.poses, strict=True))[name] for name in names]
            for each in scenes
            if set(each.names) == set(names)
        ]
        assert min(np.abs(np.array(known) - found).max((1, 2))) < 1e-5


def test_worlds_take_the_files_of_their_set_in_order(folder):
    report = asked(folder, 2)
    assert len({tuple(each) for each in report["spawned"]}) == len(report["slots"])
    for slot, (path, files, is_random) in enumerate(report["slots"].values()):
        assert path == f"{{ENV_REGEX_NS}}/Clutter_{slot}"
        wanted = [names[slot] for names in report["sets"]]
        if len(set(wanted)) == 1:
            assert isinstance(files, str)
            wanted = wanted[:1]
            files = [files]
        else:
            assert is_random is False
        assert [Path(each).stem for each in files] == wanted
        assert all(Path(each).is_file() for each in files)
    assert Path(report["support"][1]).is_file()


def test_what_the_collection_takes_is_a_rigid_body_at_its_root(folder):
    from pxr import Usd, UsdPhysics

    for path in folder.glob("assets/objects/*/usd/*.usda"):
        stage = Usd.Stage.Open(str(path))
        assert stage.GetDefaultPrim().HasAPI(UsdPhysics.RigidBodyAPI)


def test_an_unknown_interface_is_refused_at_once(folder):
    assert "outside the known versions" in asked(folder, 0)["error"]
