"""Exports: what goes out comes back in the program that reads it, and stands where that program simulates."""

import json
import runpy
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.shading import linear
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.judging.verify import verify_scene
from cluttergen_jax.scene.export import FORMATS, export_scenes
from tests.helpers.exports import CLOSE, PLAIN_FORMATS, assert_same_pose, matrix, spread
from tests.helpers.worlds import trio


@pytest.mark.parametrize("format", PLAIN_FORMATS)
def test_folders_stand_by_themselves(folder_of, scene, format):
    folder = folder_of(format)
    record = json.loads((folder / "MANIFEST.json").read_text())
    assert record["export_format"] == format
    assert {each["name"] for each in record["assets"]} == {"mug", "fork", "soup_can"}
    for asset in record["assets"]:
        assert asset["licence"]
        assert len(asset["hash"]) == 64
    (own,) = record["scenes"]
    assert (own["seed"], own["method"], own["verdict"]) == (3, "clear", "stable")
    assert (folder / own["file"]).is_file()
    for entry, pose in zip(own["objects"], scene.poses, strict=True):
        assert_same_pose(entry["position"], entry["quaternion_wxyz"], pose)
    licences = (folder / "LICENSES.txt").read_text()
    assert all(f"object {name}" in licences for name in ("mug", "fork", "soup_can"))
    assert "support round_table" in licences
    # Nothing may point out of the folder.
    for path in folder.rglob("*"):
        if path.suffix in {".xml", ".urdf", ".sdf", ".json", ".py"}:
            assert str(folder) not in path.read_text()
            assert str(Path.home()) not in path.read_text()


def test_mjcf_comes_back_and_stands(folder_of, scene):
    path = folder_of("mjcf") / "scenes" / "000000.xml"
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.opt.timestep == scene.stability.file_timestep
    np.testing.assert_allclose(model.key("scene").qpos, scene.poses.ravel(), atol=CLOSE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        body = model.body(name)
        assert_same_pose(data.body(name).xpos, data.body(name).xquat, pose)
        assert body.mass[0] == pytest.approx(asset.mass, rel=1e-6)
        moments = np.sort(np.linalg.eigvalsh(asset.inertia))
        np.testing.assert_allclose(np.sort(body.inertia), moments, rtol=1e-5)
        np.testing.assert_allclose(body.ipos, asset.center_of_mass, atol=1e-7)
    friction = model.geom_friction[model.geom_contype > 0]
    np.testing.assert_allclose(friction, np.tile(scene.contact.friction, (len(friction), 1)))
    assert verify_scene(path).stands


def test_pybullet_reads_masses_and_poses_and_the_scene_stands(folder_of, scene):
    pybullet = pytest.importorskip("pybullet", reason="needs the extra peers")
    folder = folder_of("urdf")
    loader = runpy.run_path(str(folder / "load_pybullet.py"))
    client = pybullet.connect(pybullet.DIRECT)
    try:
        bodies = loader["load_scene"](folder / "scenes" / "000000.json", client)
        for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
            position, (x, y, z, w) = loader["object_pose"](bodies[name], client)
            assert_same_pose(position, (w, x, y, z), pose)
            info = pybullet.getDynamicsInfo(bodies[name], -1, physicsClientId=client)
            assert info[0] == pytest.approx(asset.mass, rel=1e-6)
            moments = np.linalg.eigvalsh(asset.inertia)
            np.testing.assert_allclose(np.sort(info[2]), moments, rtol=1e-4)
        # From elsewhere, paths are seen from the script.
        assert loader["find_scene"]("scenes/000000.json") == folder / "scenes" / "000000.json"
        with pytest.raises(FileNotFoundError, match=r"no scene .*1\.json; .*: 000000.json to 0"):
            loader["load_scene"]("scenes/000001.json", client)
        for _ in range(480):
            pybullet.stepSimulation(physicsClientId=client)
        for name, pose in zip(scene.names, scene.poses, strict=True):
            position, _ = loader["object_pose"](bodies[name], client)
            # Bullet makes every hull a millimetre thicker, so that objects rise by as much.
            assert np.linalg.norm(np.array(position) - pose[:3]) < 0.003, name
    finally:
        pybullet.disconnect(client)


def test_sdf_is_well_formed_and_complete(folder_of, scene):
    path = folder_of("sdf") / "scenes" / "000000.sdf"
    root = ET.parse(path).getroot()
    assert (root.tag, root.get("version")) == ("sdf", "1.9")
    models = {model.get("name"): model for model in root.findall("world/model")}
    assert models.pop("support").findtext("static") == "true"
    assert tuple(models) == scene.names
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        model = models[name]
        assert model.find("pose").get("rotation_format") == "quat_xyzw"
        values = np.array(model.findtext("pose").split(), float)
        assert_same_pose(values[:3], values[[6, 3, 4, 5]], pose)
        inertial = model.find("link/inertial")
        assert float(inertial.findtext("mass")) == pytest.approx(asset.mass, rel=1e-8)
        for row, column in np.ndindex(3, 3):
            key = "i" + "xyz"[min(row, column)] + "xyz"[max(row, column)]
            value = float(inertial.findtext(f"inertia/{key}"))
            assert value == pytest.approx(asset.inertia[row][column], abs=1e-12, rel=1e-6)
        assert len(model.findall("link/collision")) == len(asset.parts)
        assert all(float(each.text) == 0.5 for each in model.iter("mu"))
    # What Drake is told of every part and box; others skip what has its prefix.
    drake = "{http://drake.mit.edu}"
    for collision in root.iter("collision"):
        told = collision.find(f"{drake}proximity_properties")
        assert told.find(f"{drake}compliant_hydroelastic") is not None
        assert float(told.findtext(f"{drake}hydroelastic_modulus")) == 1e9
        # Beside it Drake would warn of the usual elements, which say the same.
        assert told.find(f"{drake}mu_dynamic") is None
    for uri in root.iter("uri"):
        assert (path.parent / uri.text).is_file()
    names = [each.get("name") for each in root.find("world/model/link")]
    assert len(names) == len(set(names))


def test_glb_comes_back_with_y_up(folder_of, scene):
    data = (folder_of("glb") / "scenes" / "000000.glb").read_bytes()
    assert data[:4] == b"glTF"
    assert int.from_bytes(data[8:12], "little") == len(data)
    read = trimesh.load(folder_of("glb") / "scenes" / "000000.glb")
    y_up = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    frames = {node: read.graph[node][0] for node in read.graph.nodes}
    for name, pose in zip(scene.names, scene.poses, strict=True):
        np.testing.assert_allclose(frames[name], y_up @ matrix(pose), atol=CLOSE)
    # The lowest point of the whole scene is the floor, and up is y.
    assert read.bounds[0][1] == pytest.approx(0.0, abs=1e-4)


def test_glb_holds_masses_parts_and_linear_colours(folder_of, scene):
    data = (folder_of("glb") / "scenes" / "000000.glb").read_bytes()
    size = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + size])
    nodes = {node["name"]: node for node in document["nodes"]}
    for name, asset in zip(scene.names, scene.objects, strict=True):
        assert nodes[name]["extras"]["mass"] == pytest.approx(asset.mass)
        np.testing.assert_allclose(nodes[name]["extras"]["inertia"], asset.inertia)
        parts = document["meshes"][nodes[f"{name}/collision"]["mesh"]]["primitives"]
        assert len(parts) == len(asset.parts)
    assert [each["name"] for each in document["scenes"]] == ["scene", "collision"]
    # Both mugs are one mesh.
    assert nodes["mug"]["mesh"] == nodes["mug#2"]["mesh"]
    colours = {
        tuple(each["pbrMetallicRoughness"]["baseColorFactor"]) for each in document["materials"]
    }
    assert tuple(linear(scene.objects[0].pieces[0].rgba)) in colours


@pytest.mark.parametrize("format", ["maniskill", "robosuite", "libero"])
def test_adapters_carry_poses_and_files(folder_of, scene, format):
    folder = folder_of(format)
    record = json.loads((folder / "scenes" / "000000.json").read_text())
    assert all((folder / script).is_file() for script in FORMATS[format].scripts)
    for entry, pose in zip(record["objects"], scene.poses, strict=True):
        assert_same_pose(entry["position"], entry["quaternion_wxyz"], pose)
    for name, own in record["assets"].items():
        asset = scene.assets[name]
        if format in ("robosuite", "libero"):
            spec = mujoco.MjSpec.from_file(str(folder / own["file"]))
            body = spec.compile().body("object")
            assert body.mass[0] == pytest.approx(asset.mass, rel=1e-6)
            np.testing.assert_allclose(
                np.sort(body.inertia), np.sort(np.linalg.eigvalsh(asset.inertia)), rtol=1e-5
            )
        else:
            assert len(own["parts"]) == len(asset.parts)
            assert all((folder / own["folder"] / part).is_file() for part in own["parts"])
    if format == "maniskill":
        for name, row in record["env_state"]["actors"].items():
            np.testing.assert_allclose(row[:7], scene.poses[scene.names.index(name)])
            assert row[7:] == [0.0] * 6


def test_existing_folders_are_left_alone(tmp_path):
    scene = spread(trio(), cuboid_table())
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.txt").write_text("important")
    for overwrite in (False, True):
        with pytest.raises(ConfigError, match="exists"):
            export_scenes([scene], out, "mjcf", overwrite=overwrite)
    assert (out / "thesis.txt").read_text() == "important"
    export_scenes([scene], tmp_path / "new", "mjcf")
    with pytest.raises(ConfigError, match="exists"):
        export_scenes([scene], tmp_path / "new", "sdf")
    export_scenes([scene], tmp_path / "new", "sdf", overwrite=True)
    assert (tmp_path / "new" / "scenes" / "000000.sdf").is_file()
    assert not (tmp_path / "new" / "scenes" / "000000.xml").exists()


@pytest.mark.parametrize("is_drawn", [True, False])
def test_convex_parts_of_a_support_go_everywhere(tmp_path, is_drawn):
    support = find_support("tilted_board_10")
    support = support if is_drawn else replace(support, pieces=())
    scene = spread(trio()[:1], support)
    count = len(support.boxes) + 1
    for format in (*PLAIN_FORMATS, "usd"):
        if format == "usd":
            pytest.importorskip("pxr", reason="needs the extra usd")
        folder = export_scenes([scene], tmp_path / f"in_{format}", format)
        if format.startswith("mjcf") or format == "molmospaces":
            model = mujoco.MjModel.from_xml_path(str(next(folder.glob("scenes/*.xml"))))
            data = mujoco.MjData(model)
            mujoco.mj_kinematics(model, data)
            index = model.geom("support.part-0").id
            mesh = model.mesh("support.part-0")
            own = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
            vertices = own @ data.geom_xmat[index].reshape(3, 3).T + data.geom_xpos[index]
            apart = np.linalg.norm(vertices[:, None] - support.parts[0].vertices, axis=-1)
            assert apart.min(0).max() < 1e-5
        elif format in ("robosuite", "libero", "robocasa"):
            model = mujoco.MjModel.from_xml_path(str(folder / "assets/support/support.xml"))
            assert (model.geom_contype > 0).sum() == count
        elif format == "urdf":
            link = ET.parse(folder / "assets/support/support.urdf").find("link")
            assert len(link.findall("collision")) == count
            assert (
                folder / "assets/support" / link.find("collision/geometry/mesh").get("filename")
            ).is_file()
        elif format == "sdf":
            root = ET.parse(next(folder.glob("scenes/*.sdf")))
            assert len(root.findall(".//model[@name='support']/link/collision")) == count
        elif format == "glb":
            model = trimesh.load(next(folder.glob("scenes/*.glb")))
            assert len(model.geometry) > 0
        elif format == "maniskill":
            record = json.loads(next(folder.glob("scenes/*.json")).read_text())["support"]
            assert len(record["boxes"]) + len(record["parts"]) == count
            assert (folder / record["folder"] / record["parts"][0]).is_file()
        elif format == "usd":
            text = (folder / "assets/support/support.usda").read_text()
            assert text.count("PhysicsCollisionAPI") == count
