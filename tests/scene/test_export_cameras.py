"""Cameras of an export: read back from each format, they look at the middle of the region."""

import json
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.scene import CAMERAS, FixedCamera, scene_cameras
from tests.helpers.exports import exporter, spread

NAMES = ("mug", "bottle", "soup_can", "bowl")


@pytest.fixture(scope="module")
def scene():
    pool = find_pool("dining")
    return spread([pool[name] for name in NAMES], cuboid_table(), NAMES)


@pytest.fixture(scope="module")
def folder_of(scene, tmp_path_factory):
    return exporter(scene, tmp_path_factory, cameras=CAMERAS)


def turn_of(w, x, y, z):
    return Rotation.from_quat([x, y, z, w]).as_matrix()


def seen_at(point, position, turn, fovx, fovy):
    """f64[2]: where a point is seen, -1 to 1 from edge to edge, +y up; the camera looks along -z."""
    x, y, z = turn.T @ (np.asarray(point) - position)
    assert z < 0, "it lies behind the camera"
    return np.array([x, y]) / -z / np.tan(np.array([fovx, fovy]) / 2)


def check(cameras, scene):
    """Cameras by name, each (position, rotation, fovx, fovy): all look at the middle, from where they are."""
    assert tuple(cameras) == CAMERAS
    region = scene.support.region
    top = scene.support.top
    middle = np.array([*region.center, top])
    for name, (position, turn, fovx, fovy) in cameras.items():
        np.testing.assert_allclose(
            seen_at(middle, position, turn, fovx, fovy), 0, atol=1e-4, err_msg=name
        )
        # What stands up in the world stands up in the picture.
        assert turn[2, 1] >= -1e-6
        assert np.linalg.det(turn) == pytest.approx(1)
        assert fovx > fovy > 0.5
    positions = {name: each[0] - middle for name, each in cameras.items()}
    np.testing.assert_allclose(positions["overhead"][:2], 0, atol=1e-6)
    np.testing.assert_allclose(cameras["overhead"][1], np.eye(3), atol=1e-6)
    assert positions["front"][1] < 0 < positions["side"][0]
    assert positions["wrist"][2] == pytest.approx(0.3, abs=1e-6)


def test_the_same_camera_in_opencvs_frame(scene):
    """Up in the world is up in the picture, and back again it is the same camera."""
    middle = np.array([*scene.support.region.center, scene.support.top])
    for camera in scene_cameras(scene.support):
        pinhole = camera.pinhole
        np.testing.assert_allclose(pinhole.project(middle)[0], [320, 240], atol=1e-9)
        lifted = middle + 0.01 * camera.rotation[:, 1]
        assert pinhole.project(lifted)[0][1] < 239
        again = FixedCamera.of(camera.name, pinhole)
        for name in ("position", "quaternion", "fovy"):
            np.testing.assert_allclose(getattr(again, name), getattr(camera, name), atol=1e-12)


def test_mjcf_cameras(folder_of, scene):
    model = mujoco.MjModel.from_xml_path(str(folder_of("mjcf") / "scenes" / "000000.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    cameras = {}
    for k in range(model.ncam):
        fovy = np.radians(model.cam_fovy[k])
        fovx = 2 * np.arctan(np.tan(fovy / 2) * 4 / 3)
        cameras[model.camera(k).name] = (
            data.cam_xpos[k],
            data.cam_xmat[k].reshape(3, 3),
            fovx,
            fovy,
        )
    check(cameras, scene)


def test_sdf_cameras(folder_of, scene):
    root = ET.parse(folder_of("sdf") / "scenes" / "000000.sdf").getroot()
    cameras = {}
    for model in root.findall("world/model"):
        sensor = model.find("link/sensor")
        if sensor is None:
            continue
        assert model.findtext("static") == "true"
        values = np.array(model.findtext("pose").split(), float)
        ahead, left, up = turn_of(*values[[6, 3, 4, 5]]).T
        fovx = float(sensor.findtext("camera/horizontal_fov"))
        width, height = (
            int(sensor.findtext(f"camera/image/{side}")) for side in ("width", "height")
        )
        fovy = 2 * np.arctan(np.tan(fovx / 2) * height / width)
        turn = np.stack([-left, up, -ahead], axis=1)
        cameras[sensor.get("name")] = (values[:3], turn, fovx, fovy)
    check(cameras, scene)


def test_usd_cameras(folder_of, scene):
    pxr = pytest.importorskip("pxr", reason="needs the extra usd")
    from pxr import Usd, UsdGeom

    assert pxr
    stage = Usd.Stage.Open(str(folder_of("usd") / "scenes" / "000000.usda"))
    cameras = {}
    for prim in stage.GetPrimAtPath("/World/cameras").GetChildren():
        camera = UsdGeom.Camera(prim).GetCamera(Usd.TimeCode.Default())
        frame = np.array(camera.transform).T
        fovs = (camera.GetFieldOfView(side) for side in (camera.FOVHorizontal, camera.FOVVertical))
        cameras[prim.GetName()] = (frame[:3, 3], frame[:3, :3], *np.radians(list(fovs)))
    check(cameras, scene)


def test_glb_cameras(folder_of, scene):
    data = (folder_of("glb") / "scenes" / "000000.glb").read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    nodes = document["nodes"]
    cameras = {}
    (world,) = (nodes[k] for k in document["scenes"][0]["nodes"])
    (other,) = (nodes[k] for k in document["scenes"][1]["nodes"])
    assert not any("camera" in nodes[k] for k in other["children"])
    for node in (nodes[k] for k in world["children"]):
        if "camera" in node:
            lens = document["cameras"][node["camera"]]["perspective"]
            fovx = 2 * np.arctan(np.tan(lens["yfov"] / 2) * lens["aspectRatio"])
            x, y, z, w = node["rotation"]
            position = np.array(node["translation"])
            cameras[node["name"].split("/")[1]] = (
                position,
                turn_of(w, x, y, z),
                fovx,
                lens["yfov"],
            )
    check(cameras, scene)
