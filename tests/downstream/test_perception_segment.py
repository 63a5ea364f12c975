"""Segmentation: what the network reads, that it learns, how it is stored, and what is refused."""

import dataclasses
import json

import jax
import numpy as np
import pytest

from cluttergen_jax.downstream.fitting import FitConfig
from cluttergen_jax.downstream.perception.segmenter import (
    HEIGHT,
    NO_DEPTH,
    WIDTH,
    NetworkSegmenter,
    SegmentConfig,
    SegmentModel,
    enlarge,
    load_segmenter,
    segmenter_folder,
    shrink,
)
from cluttergen_jax.downstream.perception.types import FIRST_OBJECT, check_images
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.learning.ppo.checkpoint import save_policy
from cluttergen_jax.learning.training.run_logger import read_rows
from studies.perception.scoring import confusion, intersection_over_union, iou_of, is_good
from studies.perception.training import SegmenterTraining, _mirror, example_of, shrink_label
from tests.helpers.perception import OBJECTS, POSES, TABLE, ByColour, drawn_view, overhead, view_of

SMALL = SegmentConfig(3, (8, 8, 16, 16))


class Known:
    """As much of a folder of views as examples need."""

    names = ByColour.names
    support = TABLE


class Taught:
    """A source of a few views by rays."""

    views = Known

    @property
    def record(self):
        return {"made": "up"}

    def load(self, split):
        numbers = range(4) if split == "val" else range(10, 18)
        examples = [example_of(drawn_view(number), Known, 0) for number in numbers]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *examples)


# What is read


def test_examples_are_of_the_networks_size_and_centres_lie_in_their_masks():
    view = view_of(POSES, overhead())
    example = example_of(view, Known, 0)
    assert example.rgb.shape == (HEIGHT, WIDTH, 3)
    assert example.depth.shape == example.height.shape == example.label.shape == (HEIGHT, WIDTH)
    for number, (x, y) in enumerate(example.center):
        assert example.label[int(y), int(x)] == FIRST_OBJECT + number
    for number, asset in enumerate(OBJECTS):
        height = example.height[example.label == FIRST_OBJECT + number].astype(float)
        assert np.median(height) == pytest.approx(2 * asset.half_extents[2], abs=0.006)


@pytest.mark.parametrize("size", [(240, 320), (480, 640), (200, 330)])
def test_pictures_of_any_size_are_read_and_answered(size):
    depth = np.full(size, 0.7, np.float32)
    depth[: size[0] // 2] = np.nan
    rgb = np.zeros((*size, 3), np.uint8)
    rgb[:, size[1] // 2 :] = 200
    small, far, _ = shrink(rgb, depth, depth - 0.5)
    assert (far[: HEIGHT // 2 - 1] == NO_DEPTH).all()
    assert far[-1, -1] == np.float16(0.7)
    assert small[0, 0, 0] == 0
    assert small[0, -1, 0] == 200
    label = shrink_label((rgb[..., 0] > 0).astype(np.uint8))
    large = enlarge(label[..., None].astype(np.float32), size)[..., 0] > 0.5
    assert large.shape == size
    assert (large == (rgb[..., 0] > 0)).mean() > 0.98


def test_mirrored_examples_keep_centres_in_their_masks():
    example = example_of(view_of(POSES, overhead()), Known, 0)
    for flips in ([True, False], [False, True], [True, True]):
        turned = _mirror(example, np.array(flips))
        for number, (x, y) in enumerate(np.asarray(turned.center)):
            assert turned.label[int(y), int(x)] == FIRST_OBJECT + number


# How it is scored


def test_scores_are_those_of_hand_arithmetic():
    true = np.array([[0, 0, 2], [2, 2, 3]])
    found = np.array([[0, 2, 2], [2, 0, 3]])
    confused = confusion(found, true, 2)
    assert confused[0].tolist() == [1, 0, 1, 0]
    np.testing.assert_allclose(iou_of(confused), [1 / 3, np.nan, 2 / 4, 1.0])
    assert np.nanmean(intersection_over_union(true, true, 2)) == 1.0


# What is refused


def refused(rgb, depth, told):
    with pytest.raises(ConfigError, match=told):
        check_images(rgb, depth, overhead())


def test_images_that_are_none_are_refused():
    camera = overhead()
    rgb = np.zeros((camera.height, camera.width, 3), np.uint8)
    depth = np.full(rgb.shape[:2], 0.7)
    check_images(rgb, depth, camera)
    refused(rgb.astype(float), depth, "picture")
    refused(rgb, depth[1:], "depth image")
    refused(rgb, (1000 * depth).astype(int), "millimetres")
    refused(rgb, depth * np.nan, "nothing was measured")


def test_a_pose_is_right_within_five_millimetres_and_five_degrees():
    assert is_good(0.0049, np.radians(4.9))
    assert not is_good(0.0051, 0.0)
    assert not is_good(0.0, np.radians(5.1))
    assert not is_good(None, None)


# Runs


def run(folder, config):
    return SegmenterTraining(SMALL, config, Taught(), folder, lambda line: None)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return run(
        tmp_path_factory.mktemp("run"), FitConfig(num_epochs=6, batch_size=4, learning_rate=5e-3)
    ).run()


@pytest.mark.slow
def test_gradient_steps_lower_the_loss_and_leave_a_segmenter(trained):
    rows = read_rows(trained.parent / "metrics.csv")
    assert rows[-1]["loss"] < 0.8 * rows[0]["loss"]
    record = json.loads((trained / "record.json").read_text())
    assert record["names"] == list(ByColour.names)
    assert set(record["validation"]["iou"]) == set(ByColour.names)
    view = drawn_view(0).view
    found = load_segmenter(trained.parent)(view.rgb, view.depth, view.camera)
    assert found.label.shape == view.label.shape
    again = load_segmenter(trained)(view.rgb, view.depth, view.camera)
    assert np.array_equal(found.label, again.label)
    assert (trained / "weights.npz").stat().st_size < 2e6


def stored(folder, **changes):
    learner = SegmentModel(SMALL)
    shapes = jax.eval_shape(learner.init, jax.random.key(0))
    params = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
    record = {
        "kind": "segmenter",
        "network": dataclasses.asdict(SMALL),
        "names": list(ByColour.names),
        "top": TABLE.top,
    }
    save_policy(folder, params, record | changes)
    return folder


def test_a_stored_segmenter_is_read_and_damaged_ones_are_refused(tmp_path):
    found = load_segmenter(stored(tmp_path / "good"))
    assert isinstance(found, NetworkSegmenter)
    assert found.names == ByColour.names
    weights = tmp_path / "good" / "weights.npz"
    weights.write_bytes(weights.read_bytes()[:-200])
    with pytest.raises(PoolError, match="cannot be read"):
        load_segmenter(tmp_path / "good")
    weights.unlink()
    with pytest.raises(PoolError, match="cannot be read"):
        load_segmenter(tmp_path / "good")
    with pytest.raises(PoolError, match="no segmenter 'nowhere'"):
        segmenter_folder("nowhere")
    with pytest.raises(PoolError, match="kind 'placer'"):
        load_segmenter(stored(tmp_path / "other", kind="placer"))
    with pytest.raises(PoolError, match="does not say what network"):
        load_segmenter(stored(tmp_path / "names", names=["a"]))
    with pytest.raises(PoolError, match="does not say what network"):
        load_segmenter(stored(tmp_path / "sizes", network={"num_objects": 3}))
