"""Segmentation: what the network reads, that it learns, how it is stored, and what is refused."""

import dataclasses
import json

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.downstream.fitting import FitConfig
from cluttergen_jax.downstream.perception.certainty import Certainty, read_certainty, write_certainty
from cluttergen_jax.downstream.perception.evaluate import evaluate_perception
from cluttergen_jax.downstream.perception.segment.network import (
    HEIGHT,
    NO_DEPTH,
    WIDTH,
    SegmentConfig,
    SegmentLearner,
    _mirror,
    _recolour,
    network_images,
    shrink,
    shrink_label,
)
from cluttergen_jax.downstream.perception.segment.network_segmenter import (
    NetworkSegmenter,
    agreeing,
    by_pieces,
    embedded_segmenters,
    enlarge,
    fit_to_depth,
    load_segmenter,
    network_hash,
    segmenter_folder,
    smooth,
    with_raised,
)
from cluttergen_jax.downstream.perception.segment.training import FIT, SegmenterTraining, example_of
from cluttergen_jax.downstream.perception.types import (
    ARM,
    BACKGROUND,
    FIRST_OBJECT,
    check_images,
    confusion,
    intersection_over_union,
    iou_of,
)
from cluttergen_jax.errors import BankError, ConfigError, PoolError
from cluttergen_jax.learning.ppo.checkpoint import save_policy
from cluttergen_jax.learning.training.metrics_log import read_rows
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


def test_noise_is_the_same_for_the_same_seed():
    view = view_of(POSES, overhead())
    first, again, other = (example_of(view, Known, seed) for seed in (0, 0, 1))
    assert np.array_equal(first.rgb, again.rgb)
    assert np.array_equal(first.depth, again.depth)
    assert not np.array_equal(first.rgb, other.rgb)


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


def test_brightness_of_the_whole_picture_does_not_matter():
    example = example_of(view_of(POSES, overhead()), Known, 0)
    dark = np.round(example.rgb * 0.5).astype(np.uint8)
    one, other = (network_images(rgb, example.depth, example.height) for rgb in (example.rgb, dark))
    np.testing.assert_allclose(one, other, atol=0.4)


def test_mirrored_examples_keep_centres_in_their_masks():
    example = example_of(view_of(POSES, overhead()), Known, 0)
    for flips in ([True, False], [False, True], [True, True]):
        turned = _mirror(example, np.array(flips))
        for number, (x, y) in enumerate(np.asarray(turned.center)):
            assert turned.label[int(y), int(x)] == FIRST_OBJECT + number


def test_recoloured_examples_keep_their_objects_and_half_of_their_backgrounds():
    example = example_of(view_of(POSES, overhead()), Known, 0)
    light, is_back = example.rgb.astype(float), example.label == BACKGROUND
    kept = 0
    for key in jax.random.split(jax.random.key(0), 64):
        other = np.asarray(_recolour(example, key).rgb)
        np.testing.assert_allclose(other[~is_back], light[~is_back], atol=1e-3)
        assert other.min() >= 0
        assert other.max() <= 255
        change = np.abs(other - light)[is_back].mean()
        kept += change < 1e-3
        assert change < 1e-3 or change > 5
    assert 16 < kept < 48


def test_single_heights_that_noise_made_are_left_out_and_edges_stay():
    height = np.zeros((9, 12), np.float32)
    height[:, 6:] = 0.05
    height[4, 2], height[4, 9], height[0, 0] = 0.02, -0.01, np.nan
    found = smooth(height)
    assert np.isnan(found[0, 0])
    assert (found[:, :6][np.isfinite(height[:, :6])] == 0).all()
    assert (found[:, 6:] == np.float32(0.05)).all()


def test_a_piece_of_surface_is_of_one_class_and_steps_part_pieces():
    height = np.zeros((8, 12), np.float32)
    height[2:6, 1:6], height[2:6, 6:11] = 0.05, 0.10
    chance = np.zeros((8, 12, 4), np.float32)
    chance[..., BACKGROUND], chance[2:6, 1:6, 2], chance[2:6, 6:11, 3] = 0.1, 1.0, 1.0
    # Some of the first object is taken for the second, and some of the table for the first.
    chance[3, 2], chance[7, :3] = [0, 0, 0.3, 0.7], [0.4, 0, 0.6, 0]
    mixed = by_pieces(chance, 1 - height, height)
    assert (mixed[2:6, 1:6].argmax(-1) == 2).all()
    assert (mixed[2:6, 6:11].argmax(-1) == 3).all()
    np.testing.assert_allclose(mixed[7], chance[7], atol=1e-6)
    unknown = by_pieces(chance, np.full_like(height, np.nan), height)
    np.testing.assert_allclose(unknown, chance, atol=1e-6)


def test_what_is_raised_is_seldom_background():
    chance = np.tile(np.float32([0.8, 0.0, 0.2]), (1, 3, 1))
    fitted = with_raised(chance, np.array([[0.001, 0.02, np.nan]]))
    assert fitted.argmax(-1).tolist() == [[0, 2, 0]]
    assert chance.argmax(-1).tolist() == [[0, 0, 0]]


def test_objects_end_where_the_table_begins_and_have_their_thin_parts():
    height = np.zeros((20, 30), np.float32)
    height[5:10, 5:10] = 0.04
    height[7, 10:13] = 0.02
    height[7, 25] = 0.02
    height[0, 0] = np.nan
    label = np.full(height.shape, BACKGROUND, np.uint8)
    label[4:11, 4:10] = FIRST_OBJECT
    fitted = fit_to_depth(label, height)
    expected = np.zeros(height.shape, bool)
    expected[5:10, 5:10] = expected[7, 10:13] = True
    assert np.array_equal(fitted == FIRST_OBJECT, expected)
    assert (fit_to_depth(np.zeros_like(label), height) == BACKGROUND).all()


# How it is scored


def test_scores_are_those_of_hand_arithmetic():
    true = np.array([[0, 0, 2], [2, 2, 3]])
    found = np.array([[0, 2, 2], [2, 0, 3]])
    confused = confusion(found, true, 2)
    assert confused[0].tolist() == [1, 0, 1, 0]
    np.testing.assert_allclose(iou_of(confused), [1 / 3, np.nan, 2 / 4, 1.0])
    assert np.nanmean(intersection_over_union(true, true, 2)) == 1.0


def test_votes_that_disagree_are_left_out():
    rng = np.random.default_rng(0)
    votes = np.concatenate([rng.normal([40, 60], 3, (80, 2)), rng.normal([120, 30], 3, (30, 2))])
    assert agreeing(votes.astype(np.float32)).tolist() == [True] * 80 + [False] * 30


# What is refused


def refused(rgb, depth, told):
    with pytest.raises(ConfigError, match=told):
        check_images(rgb, depth, overhead())


def test_images_that_cannot_be_used_are_refused():
    view = view_of(POSES, overhead()).view
    refused(view.rgb[:-1], view.depth, "picture of type uint8 and shape")
    refused(view.rgb.astype(np.float32), view.depth, "float32")
    refused(view.rgb, view.depth.T, "a depth image")
    refused(view.rgb, (1000 * view.depth).astype(np.uint16), "not millimetres")
    refused(view.rgb, np.full_like(view.depth, np.nan), "nothing was measured")
    depth = view.depth.copy()
    depth[0] = (np.nan,)
    assert np.isnan(check_images(view.rgb, depth, overhead())[1][0]).all()


# Runs


def run(folder, config):
    return SegmenterTraining(SMALL, config, Taught(), folder, lambda line: None)


def test_the_full_setting_has_half_a_million_weights_and_fits_in_two_megabytes():
    learner = SegmentLearner(SegmentConfig(10))
    shapes = jax.eval_shape(learner.init, jax.random.key(0))
    number = sum(np.prod(leaf.shape) for leaf in jax.tree.leaves(shapes))
    assert 4e5 < number < 6e5
    assert 2 * number < 2e6
    assert FIT.num_epochs > 1


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return run(
        tmp_path_factory.mktemp("run"), FitConfig(num_epochs=6, batch_size=4, learning_rate=5e-3)
    ).run()


def test_what_is_not_there_is_not_told():
    segmenter, view = load_segmenter("household"), drawn_view(0).view
    told = set(np.unique(segmenter(view.rgb, view.depth, view.camera).label)) - {BACKGROUND, ARM}
    assert told
    others = [name for k, name in enumerate(segmenter.names) if FIRST_OBJECT + k not in told]
    among = segmenter(view.rgb, view.depth, view.camera, others)
    assert not told & set(np.unique(among.label))


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


@pytest.mark.slow
def test_a_run_that_was_stopped_ends_as_one_that_was_not(tmp_path, monkeypatch):
    config = FitConfig(num_epochs=2, batch_size=4, learning_rate=5e-3)
    whole, stopped = run(tmp_path / "whole", config).run(), run(tmp_path / "stopped", config)
    batch = SegmenterTraining._batch

    def stop(self, number, *sizes):
        if number == 2:
            import signal

            signal.raise_signal(signal.SIGINT)
        return batch(self, number, *sizes)

    with monkeypatch.context() as patch:
        patch.setattr(SegmenterTraining, "_batch", stop)
        with pytest.raises(KeyboardInterrupt):
            stopped.run()
    again = run(tmp_path / "stopped", config).run()
    weights = [np.load(folder / "weights.npz") for folder in (whole, again)]
    for name in weights[0].files:
        np.testing.assert_array_equal(weights[0][name], weights[1][name])
    with pytest.raises(ConfigError, match="another fit"):
        run(tmp_path / "stopped", dataclasses.replace(config, num_epochs=3))


def stored(folder, **changes):
    learner = SegmentLearner(SMALL)
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


def test_a_segmenter_is_known_by_weights_and_record_but_not_by_its_certainty(tmp_path):
    folders = [stored(tmp_path / "one"), stored(tmp_path / "same"), stored(tmp_path / "other", top=0.5)]
    write_certainty(folders[1], Certainty())
    one, same, other = map(network_hash, folders)
    assert one == same != other


def test_true_masks_are_not_calibrated_with():
    """Said before anything is judged: there are no views here."""
    with pytest.raises(ConfigError, match="calibration with true masks"):
        evaluate_perception(None, "val", "true", (1,), (0.0,), None, 0, None, calibrate=True)


@pytest.mark.parametrize(
    ("call", "given", "told"),
    [
        (cg.perception_train, {"reads": "colours"}, "reads"),
        (cg.perception_train, {"seed": -1}, "seed"),
        (cg.perception_train, {"num_epochs": 0}, "num_epochs"),
        (cg.perception_train, {}, "holds no views"),
        (cg.perception_eval, {"cameras": (3,)}, "cameras"),
        (cg.perception_eval, {"cameras": ()}, "cameras"),
        (cg.perception_eval, {"noise": (-1.0,)}, "noise"),
        (cg.perception_eval, {"num_views": 0}, "num_views"),
        (cg.perception_eval, {}, "holds no views"),
    ],
)
def test_settings_that_cannot_be_are_refused(call, given, told, tmp_path):
    with pytest.raises((ConfigError, BankError), match=told):
        call(tmp_path, **given)
    assert not list(tmp_path.iterdir())


def test_the_segmenters_of_the_package_are_small_and_know_their_pools_objects():
    assert embedded_segmenters()
    for pool, folder in embedded_segmenters().items():
        assert load_segmenter(pool).names == tuple(asset.name for asset in find_pool(pool).objects)
        assert sum(file.stat().st_size for file in folder.iterdir()) < 2_000_000
        assert read_certainty(folder) != Certainty(), "fitted to poses whose errors are known"
        assert "cluttergen perception train" in (folder / "README.md").read_text()
