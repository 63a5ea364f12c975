"""Exports for programs that bring libraries of objects or scenes of their own, opened by their own loaders.

Each is asked in an interpreter of its own: the one that CLUTTERGEN_NAME_PYTHON names, or one that is made for
the test. `tests/peers` holds what runs there; RoboCasa, which no index has, is stood for by robosuite.
"""

import json
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.pool import EMBEDDED, find_pool
from cluttergen_jax.assets.shape import Texture
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.bank_reader import Bank
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene.export import BANK_FORMATS, export_scenes
from tests.helpers.drawing import needs_gl
from tests.helpers.environments import ask_peer, named_python, peer_python
from tests.helpers.exports import assert_same_pose, fourteen_scenes, matrix, spread
from tests.helpers.placing import write_bank

ROOT = Path(__file__).parents[2]

POSES = {
    "mug": [[0.01, 0.02, 0.03, 0.5, 0.5, 0.5, 0.5], [0, 0, 0.05, 0, 1, 0, 0]],
    "fork": [[0, 0, 0.01, 0, 1, 0, 0]],
}
"""T_object_tool of grasps."""


def test_robocasa_objects_know_their_box(folder_of, scene):
    folder = folder_of("robocasa")
    record = json.loads((folder / "scenes" / "000000.json").read_text())
    for name, asset in scene.assets.items():
        assert record["assets"][name]["file"] == f"objects/cluttergen/{name}/{name}/model.xml"
        model = mujoco.MjModel.from_xml_path(str(folder / record["assets"][name]["file"]))
        box = model.geom("reg_bbox")
        np.testing.assert_allclose(box.size, asset.half_extents, rtol=1e-6)
        assert (box.contype, box.conaffinity, box.group) == (0, 0, 1)
        assert model.body("object").mass == pytest.approx(asset.mass, rel=1e-6)


def test_robocasa_is_told_of_objects_by_kind(folder_of, monkeypatch):
    kitchen = ModuleType("kitchen_object_utils")
    kitchen.OBJ_CATEGORIES = {"mug": {"objaverse": None}}
    kitchen.OBJ_GROUPS = {"mug": ["mug"], "all": []}
    kitchen.ObjCat = lambda name, **properties: {"name": name, **properties}
    package = ModuleType("robocasa.models.objects")
    package.kitchen_object_utils = kitchen
    for name in ("robocasa", "robocasa.models", "robosuite"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, "robocasa.models.objects", package)
    monkeypatch.syspath_prepend(folder_of("robocasa"))
    module = runpy.run_path(str(folder_of("robocasa") / "cluttergen_robocasa.py"))
    assert (
        module["register"](washable=True)
        == module["register"](washable=True)
        == ["fork", "mug", "soup_can"]
    )
    assert kitchen.OBJ_GROUPS["cluttergen"] == ["fork", "mug", "soup_can"]
    assert set(kitchen.OBJ_CATEGORIES["mug"]) == {"objaverse", "cluttergen"}
    kind = kitchen.OBJ_CATEGORIES["mug"]["cluttergen"]
    assert (kind["friction"], kind["washable"]) == ((0.5, 0.005, 0.0001), True)
    assert kind["model_folders"] == [str(folder_of("robocasa") / "objects" / "cluttergen" / "mug")]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_robocasa_objects_load_as_robosuite_objects(folder_of, scene, tmp_path):
    packages = ("robosuite==1.5.2", "mujoco==3.3.7")
    report = ask_peer(
        "robocasa", peer_python("robosuite", tmp_path, *packages), folder_of("robocasa")
    )
    assert set(report["objects"]) == set(scene.assets)
    for name, asset in scene.assets.items():
        told = report["objects"][name]
        np.testing.assert_allclose(told["size"], asset.half_extents, rtol=1e-5)
        np.testing.assert_allclose(told["twice"], 2 * asset.half_extents, rtol=1e-5)
        assert told["pos"] == [0, 0, 0]
        assert told["bottom"][2] == pytest.approx(-asset.half_extents[2], rel=1e-5)
        assert told["mass"] == pytest.approx(asset.mass, rel=1e-5)
        assert told["num_colliding"] == len(asset.parts)


@pytest.fixture(scope="module")
def grasps(scene, tmp_path_factory):
    """A file as `robot grasps` writes it, with the columns that are read."""
    rows = [
        (name, object_hash(scene.assets[name]), pose)
        for name, poses in POSES.items()
        for pose in poses
    ]
    names, hashes, poses = zip(*rows, strict=True)
    kinds = (pa.string(), pa.string(), pa.list_(pa.float64(), 7))
    arrays = [
        pa.array(each, kind) for each, kind in zip((names, hashes, poses), kinds, strict=True)
    ]
    path = tmp_path_factory.mktemp("grasps") / "grasps.parquet"
    table = pa.table(arrays, names=["object", "hash", "pose"])
    pq.write_table(table.replace_schema_metadata({"hand": "panda"}), path)
    return path


def test_grasps_lie_beside_their_objects(scene, grasps, tmp_path):
    folder = export_scenes([scene], tmp_path / "out", "molmospaces", grasps=grasps)
    found = {
        path.parts[-3]: np.load(path)["transforms"] for path in folder.rglob("*/franka/grasps.npz")
    }
    assert set(found) == set(POSES)
    for name, transforms in found.items():
        np.testing.assert_allclose(
            transforms, [matrix(np.array(pose)) for pose in POSES[name]], atol=1e-12
        )


def test_grasps_that_cannot_be_written_are_refused(scene, grasps, tmp_path):
    def refused(match, path=grasps, format="molmospaces"):
        with pytest.raises(ConfigError, match=match):
            export_scenes([scene], tmp_path / "out", format, grasps=path)
        assert not (tmp_path / "out").exists()

    refused("grasps with: molmospaces", format="mjcf")
    refused("No such file", tmp_path / "none.parquet")
    table = pq.read_table(grasps)
    bad = tmp_path / "bad.parquet"
    other = tmp_path / "other.parquet"
    pq.write_table(table.set_column(1, "hash", [["0" * 64] * len(table)]), other)
    refused("of none of the objects", other)
    pq.write_table(table.drop_columns("pose"), bad)
    refused("cluttergen robot grasps", bad)
    for hand, told in (
        ({"hand": "another"}, "tested with another hand"),
        ({}, "that it does not name"),
    ):
        pq.write_table(table.replace_schema_metadata(hand), bad)
        refused(told, bad)
    turns = pa.array([[0.0] * 7] * len(table), pa.list_(pa.float64(), 7))
    pq.write_table(table.set_column(2, "pose", turns), bad)
    refused("a quaternion is not of unit length", bad)
    bad.write_bytes(grasps.read_bytes()[:-20])
    refused("cluttergen robot grasps", bad)


def test_molmospaces_is_told_what_objects_are(folder_of, scene):
    folder = folder_of("molmospaces")
    about = json.loads((folder / "scenes" / "000000_metadata.json").read_text())["objects"]
    model = mujoco.MjModel.from_xml_path(str(folder / "scenes" / "000000.xml"))
    assert {name: each["asset_id"] for name, each in about.items()} == {
        name: asset.name for name, asset in zip(scene.names, scene.objects, strict=True)
    }
    assert all(model.body(name).jntnum == 1 for name in about)
    for name, asset in scene.assets.items():
        record = json.loads((folder / "assets" / "objects" / name / f"{name}.json").read_text())
        assert (record["assetId"], record["description"]) == (name, f"A {asset.label}.")
        assert asset.label.endswith(record["description_short"]["one_word"])


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_molmospaces_loads_objects_scenes_and_grasps(scene, grasps, tmp_path):
    # Of what it asks for, what these loaders use: the whole has PyTorch.
    needs = (
        "boto3 compress-json einops h5py huggingface_hub imageio lmdb~=1.7.5 lxml matplotlib mujoco~=3.5.0 "
        "mujoco-warp==3.5.0 networkx nltk~=3.9.2 numpy-quaternion omegaconf opencv-python-headless psutil "
        "pydantic requests scipy shapely stringcase tyro zstandard~=0.25.0"
    )
    alone = ("molmo-spaces==0.2.9", "molmospaces-resources==0.0.2")
    python = peer_python("molmospaces", tmp_path / "env", *needs.split(), alone=alone)
    folder = export_scenes([scene], tmp_path / "out", "molmospaces", grasps=grasps)
    report = ask_peer("molmospaces", python, folder, 2.0)
    assert set(report["objects"]) == set(scene.assets)
    for name, told in report["objects"].items():
        assert (told["package"], told["nbody"], told["category"]) == ("cluttergen", 2, name)
        assert told["mass"] == pytest.approx(scene.assets[name].mass, rel=1e-6)
        assert (np.array(told["box"]) > np.array(told["size"]) - 1e-6).all()
    for name, poses in POSES.items():
        np.testing.assert_allclose(
            report["grasps"][name], [matrix(np.array(pose)) for pose in poses]
        )
    for name, pose in zip(scene.names, scene.poses, strict=True):
        np.testing.assert_allclose(report["bodies"][name]["pose"], matrix(pose), atol=1e-5)
        assert report["bodies"][name]["shift"] < 0.002


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_dm_control_opens_scenes(folder_of, scene, tmp_path):
    # Its newest version asks for fields that MuJoCo 4 has no more.
    python = peer_python("dm_control", tmp_path, "dm-control==1.0.50", "mujoco==3.17.0")
    report = ask_peer("dm_control", python, folder_of("mjcf") / "scenes" / "000000.xml", 2.0)
    for kind in ("file", "tree"):
        for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
            np.testing.assert_allclose(
                report[kind]["before"][name], [*pose[:3], *pose[:3]], atol=1e-6
            )
            assert report[kind]["mass"][name] == pytest.approx(asset.mass, rel=1e-6)
            assert report[kind]["shift"][name] < 0.002


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_embedded_objects_are_simready_props(tmp_path):
    pytest.importorskip("pxr", reason="needs the extra usd")
    packages = ("simready-validate==2026.8.0", "simready-foundation-tier-core==2026.8.0")
    python = peer_python(
        "simready", tmp_path / "env", *packages, "usd-validation-nvidia[usd]==1.22.0"
    )
    objects = [each for pool in EMBEDDED for each in find_pool(pool).objects]
    assert len(objects) == 50
    folder = export_scenes([spread(objects, cuboid_table())], tmp_path / "out", "usd")
    mug = objects[0]
    image = Texture.of(Image.new("RGB", (8, 8), "red"))
    painted = [replace(each, uv=each.mesh.vertices[:, :2], texture=image) for each in mug.pieces]
    one = spread([replace(mug, name="painted", pieces=tuple(painted))], cuboid_table())
    one = export_scenes([one], tmp_path / "one", "usd")
    report = ask_peer("simready", python, folder, "4.0.0", seconds=600)
    report |= ask_peer("simready", python, one, "3.0.0", "3.1.0", "3.2.0", "3.3.0")
    assert len(report) == 54
    for name, told in report.items():
        assert told["is_passed"], (name, told["issues"])
        assert told["issues"] == []
        required = ("FET_000_STANDARD", "FET_001_STANDARD", "FET_003_STANDARD")
        physics = (
            () if name.endswith("3.0.0") else ("FET_003_MUJOCO", "FET_003_NEWTON", "FET_003_PHYSX")
        )
        assert all(told["features"][each] for each in required + physics), (name, told["features"])


@pytest.mark.parametrize(
    ("format", "line", "file"),
    [
        ("lerobot", "from lerobot.envs.factory import make_env", "env.py"),
        ("playground", "playground==0.2.0 '.[robot]'", "cluttergen_playground.py"),
    ],
)
def test_a_line_that_users_type_is_the_same_wherever_it_stands(format, line, file):
    script = ROOT / "cluttergen_jax/scene/export/scripts" / file
    for text in (
        (ROOT / "docs/guide/hosts.md").read_text(),
        BANK_FORMATS[format].opens_in,
        script.read_text(),
    ):
        assert line in text


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    """Scenes of three convex objects, of which twelve stand."""
    return fourteen_scenes(tmp_path_factory.mktemp("banks"))


def test_a_bank_goes_with_its_script(bank, tmp_path):
    for format, script, others in (
        ("mjlab", "cluttergen_mjlab", ()),
        ("playground", "cluttergen_playground", ("host_checks.py",)),
    ):
        folder = cg.export(bank, tmp_path / format, format)
        assert {path.name for path in folder.iterdir()} == {
            *(
                "LICENSES.txt",
                "MANIFEST.json",
                "README.txt",
                "bank",
                "bank_reader.py",
                f"{script}.py",
                *others,
            )
        }
        record = json.loads((folder / "MANIFEST.json").read_text())
        assert record["scenes"] == [scene.index for scene in Bank(folder / "bank").successes()]
        assert len(record["scenes"]) == 12
        compile((folder / f"{script}.py").read_text(), script, "exec")
    with pytest.raises(ConfigError, match="exists"):
        cg.export(bank, tmp_path / "mjlab", "mjlab")
    there = tmp_path / "mjlab"
    assert cg.export(bank, there, "playground", overwrite=True) == there
    for given in ({"scenes": [0]}, {"cameras": ["front"]}, {"grasps": "grasps.parquet"}):
        with pytest.raises(ConfigError, match="takes the whole bank"):
            cg.export(bank, tmp_path / "other", "mjlab", **given)
    assert not (tmp_path / "other").exists()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_playground_resets_to_scenes(tmp_path):
    bank = write_bank(tmp_path / "bank").path
    packages = ("playground==0.2.0", f"{ROOT}[robot]")
    python = peer_python("playground", tmp_path / "env", *packages)
    told = ask_peer(
        "playground", python, cg.export(bank, tmp_path / "out", "playground"), 12, seconds=900
    )
    scenes = Bank(bank)
    for world in told["worlds"]:
        scene = scenes.scene(world["scene"])
        assert set(world["there"]) == set(scene.names)
        assert world["target"] == scene.names[-1]
        for name, pose in zip(scene.names, scene.poses, strict=True):
            assert_same_pose(world["poses"][name][:3], world["poses"][name][3:], pose)
            assert world["shift"][name] < 0.001
        assert (world["late"], world["progress"] > 0) == ([0, 1], True)
        # Playground has begun another episode by then.
        assert world["again"] < 1e-6
    slots = max(len(each.names) for each in scenes.successes())
    # The class that extends the environment observes the time, too, and charges for actions.
    size = 22 + 11 * slots + 1
    assert told["sizes"] == [8, size, [2, size]]
    assert told["is_known"]
    assert told["ppo"]["episode_length"] == 300
    masses = np.array([world["masses"] for world in told["worlds"]])
    assert (np.abs(masses[0] - masses[1]) > 0).all()
    assert (masses >= 0.8 * np.array(told["usual"]) - 1e-6).all()
    assert (masses <= 1.25 * np.array(told["usual"]) + 1e-6).all()
    assert told["worlds"][0]["friction"] != told["worlds"][1]["friction"]
    # What is gained of the progress, which may be lost again, less one for the action.
    for world in told["worlds"]:
        assert world["reward"] == pytest.approx(world["gained"] - 1.0, abs=1e-5)
        assert abs(world["gained"]) < 0.5
    assert told["dt"] == pytest.approx(0.05)


@needs_gl
@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_lerobot_makes_environments_of_a_folder(tmp_path):
    """LeRobot's own `make_env`, beside its MuJoCo; the same episodes as in `robot.make_env`."""
    python = named_python("lerobot")
    bank = write_bank(tmp_path / "bank").path
    tasks = ("place", "grasp", "rearrange")
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (3, 12, 8)).astype(np.float32)
    np.savez(tmp_path / "actions.npz", tasks=tasks, seeds=(3, 4, 5), actions=actions)
    folder = cg.export(bank, tmp_path / "out", "lerobot")
    told = ask_peer("lerobot", python, folder, tmp_path / "actions.npz", seconds=900)
    assert told["suite"] == "cluttergen"
    # What LeRobot makes of `environment_state` differs between its versions.
    expected = {
        "observation.images.front": [2, 3, 240, 320],
        "observation.images.hand": [2, 3, 240, 320],
        "observation.state": [2, 22],
    }
    assert told["seen"].items() >= expected.items()
    assert told["steps"] == [800, 800]
    assert all(task.startswith("put the ") for task in told["tasks"])
    assert not told["jax"]
    for task, seed, own, end in zip(tasks, (3, 4, 5), actions, told["ends"], strict=True):
        env = cg.robot.make_env(task, bank, action="joint_delta")
        _, info = env.reset(seed=seed)
        for action in own:
            seen, *_ = env.step(action)
        assert (end["scene"], end["target"]) == (info["scene"], info["target"])
        state = np.concatenate([seen["agent_pos"], seen["environment_state"]])
        # Metres, radians and radians a second: another version of MuJoCo rounds otherwise.
        np.testing.assert_allclose(end["state"], state, atol=5e-3)
