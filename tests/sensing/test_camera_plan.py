"""Cameras by name and from files: where they stand, what is drawn anew, and what is refused."""

import json

import numpy as np
import pytest

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.sensing.camera import Camera, parse_cameras
from tests.helpers.worlds import TOP, cuboid_table

SUPPORT = cuboid_table()


def stored(tmp_path, *cameras):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"cameras": cameras}))
    return str(path)


def drawn(plan, seed=0):
    return plan.draw(SUPPORT, np.random.default_rng(seed))


def test_named_cameras_see_the_region():
    plans = parse_cameras(["free:2", "overhead", "side"], (200, 150))
    assert [plan.name for plan in plans] == ["free-0", "free-1", "overhead", "side"]
    assert [plan.is_fixed for plan in plans] == [False, False, True, True]
    for plan in plans:
        camera = drawn(plan)
        assert (camera.width, camera.height) == (200, 150)
        pixels, depth = camera.project(np.array([*SUPPORT.region.center, SUPPORT.top]))
        assert depth > 0.3
        assert np.abs(pixels - [100, 75]).max() < 20
        moved = np.abs(camera.eye - drawn(plan, 1).eye).max()
        assert (moved == 0) == plan.is_fixed


def test_cameras_of_a_file(tmp_path):
    turned = Camera.looking([0.0, -1.0, 1.5], [0.0, 0.0, 1.0]).T_world_camera
    path = stored(
        tmp_path,
        {"name": "front", "width": 300, "height": 200, "fovy": 60, "eye": [0.5, 0, 0.4]},
        {"name": "world", "frame": "world", "eye": [1, 0, 2], "target": [0, 0, 1], "focal": 500},
        {
            "name": "mine",
            "K": [[400, 0, 320], [0, 410, 240], [0, 0, 1]],
            "T_world_camera": turned.tolist(),
        },
        {"name": "ring", "azimuth": [0, 90], "elevation": [30, 40], "distance": [0.8, 0.9]},
    )
    front, world, mine, ring = parse_cameras([path])
    camera = drawn(front)
    np.testing.assert_allclose(camera.eye, [0.5, 0, TOP + 0.4])
    assert (camera.width, camera.height) == (300, 200)
    np.testing.assert_allclose(camera.K[1, 1], 100 / np.tan(np.radians(30)))
    np.testing.assert_allclose(drawn(world).eye, [1, 0, 2])
    np.testing.assert_allclose(drawn(mine).T_world_camera, turned)
    np.testing.assert_allclose(drawn(mine).K, [[400, 0, 320], [0, 410, 240], [0, 0, 1]])
    for seed in range(20):
        away = drawn(ring, seed).eye - [0, 0, TOP]
        assert 0.8 <= np.linalg.norm(away) <= 0.9
        assert 30 <= np.degrees(np.arcsin(away[2] / np.linalg.norm(away))) <= 40
        assert away[0] > 0 < away[1]
    # At half of its size a camera sees the same.
    (half,) = parse_cameras(
        [stored(tmp_path, {"name": "a", "focal": 500, "eye": [1, 0, 1]})], (320, 240)
    )
    (whole,) = parse_cameras([stored(tmp_path, {"name": "a", "focal": 500, "eye": [1, 0, 1]})])
    np.testing.assert_allclose(drawn(half).K[:2], drawn(whole).K[:2] / 2)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ([], "one camera or more"),
        ("free", "one camera or more"),
        (["fre"], r"camera 'fre'.*Did you mean 'free'"),
        (["free:0"], "free:1 to free:1000"),
        (["side:2"], "one side, which is always the same"),
        (["free", "free"], "cameras of one name: free"),
        (["nowhere.json"], r"nowhere\.json cannot be read"),
    ],
)
def test_what_is_no_camera_is_refused(asked, message):
    with pytest.raises(ConfigError, match=message):
        parse_cameras(asked)


def test_a_size_of_another_shape_is_none_for_a_given_lens(tmp_path):
    lens = {"name": "a", "eye": [1, 0, 1], "K": [[300, 0, 320], [0, 300, 240], [0, 0, 1]]}
    with pytest.raises(ConfigError, match="at 320 x 320, K of 640 x 480"):
        parse_cameras([stored(tmp_path, lens)], (320, 320))
    with pytest.raises(ConfigError, match="has no camera"):
        parse_cameras([stored(tmp_path)])


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ({"eye": [1, 0, 1]}, "name"),
        ({"name": "a"}, "0 of T_world_camera, eye and azimuth"),
        (
            {"name": "a", "eye": [1, 0, 1], "azimuth": [0, 1]},
            "2 of T_world_camera, eye and azimuth",
        ),
        ({"name": "a", "eye": [1, 0, 1], "fovy": 40, "focal": 3}, "2 of K, focal and fovy"),
        ({"name": "a", "eye": [1, 0, 1], "fovy": 179}, "1 to 170 degrees"),
        ({"name": "a", "eye": [1, 0]}, "eye|length 3"),
        ({"name": "a", "azimuth": [9, 1]}, "a range, low first"),
        ({"name": "a", "azimuth": [0, 1], "distance": [0, 1]}, "metres above 0"),
        ({"name": "a", "eye": [1, 0, 1], "fov": 4}, "fov"),
        (
            {"name": "a", "eye": [1, 0, 1], "K": [[300, 9, 160], [0, 300, 120], [0, 0, 1]]},
            "without skew",
        ),
    ],
)
def test_a_file_that_says_too_little_or_too_much_is_refused(tmp_path, camera, message):
    with pytest.raises(ConfigError, match=message):
        parse_cameras([stored(tmp_path, camera)])
