"""Views: what is drawn, how they are stored, continued and refused."""

import json

import numpy as np
import pytest

from cluttergen_jax.downstream.perception.frames import Frame, read_frame, write_frame
from cluttergen_jax.downstream.perception.types import ARM, FIRST_OBJECT
from cluttergen_jax.downstream.robot.cameras import SIZE
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.sensing import View
from studies.perception import view_store as stored
from studies.perception.view_maker import PerceptionViewConfig, PerceptionViews, write_views
from studies.perception.view_store import VIEWS, row_of
from tests.helpers.drawing import IS_DRAWING, STATUS, needs_gl
from tests.helpers.perception import POSES, overhead, view_of
from tests.helpers.placing import seen_trio, write_bank
from tests.helpers.records import unsigned

CONFIG = PerceptionViewConfig(seed=5, arm=0.0)


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


@pytest.mark.parametrize("num_banks", [1, 2, 3])
def test_so_many_views_have_the_arm_as_were_asked_for(num_banks):
    for seed in range(5):
        drawn = PerceptionViews(
            [None] * num_banks, None, PerceptionViewConfig(seed=seed, arm=0.3), "train", None, 3
        )
        pairs = range(30 * num_banks)
        assert sum(map(drawn.has_arm, pairs)) == 9 * num_banks
        assert sum(map(drawn.is_robots, pairs)) == 18 * num_banks
        assert abs(sum(map(drawn.has_arm, pairs[:10])) - 3) <= 1


# What is stored


def test_a_row_holds_the_view_to_a_tenth_of_a_millimetre():
    view = view_of(POSES, overhead())
    depth = view.view.depth.copy()
    depth[0, 0] = np.inf
    depth[0, 1] = 9.0
    seen = stored.StoredView(
        7, View(depth, view.view.label, view.view.camera, view.view.rgb), *_rest(view)
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
        camera = each.view.camera
        label = each.view.label
        for number, pose in zip(each.objects, each.poses, strict=True):
            mask = label == FIRST_OBJECT + number
            if mask.sum() < 30:
                continue
            points = camera.points(each.view.depth)[mask]
            radius = seen_trio()[number].radius
            far = np.linalg.norm(points - pose[:3], axis=1)
            assert (far < radius + 0.01).mean() > 0.98


@needs_gl
def test_the_same_settings_make_the_same_views_and_more_goes_on(views, bank, tmp_path):
    again = write_views(tmp_path / "more", {"made": bank}, "train", 2, CONFIG)
    short = list(again.views("train"))
    more = write_views(tmp_path / "more", {"made": bank}, "train", 6, CONFIG)
    assert rows_of(more.path) == rows_of(views.path)
    assert np.array_equal(short[1].view.rgb, list(more.views("train"))[1].view.rgb)
    with pytest.raises(BankError, match="another seed"):
        write_views(more.path, {"made": bank}, "train", 6, PerceptionViewConfig(seed=6, arm=0.0))
    record = json.loads((more.path / VIEWS.store.index).read_text())
    (more.path / VIEWS.store.index).write_text(json.dumps(unsigned(record) | {"names": ["a"]}))
    with pytest.raises(BankError, match="other objects"):
        write_views(more.path, {"made": bank}, "train", 6, CONFIG)


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
