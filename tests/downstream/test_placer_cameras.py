"""Several cameras on one query: what each sees, fused; drawn by the pairs' seed."""

import numpy as np
import pytest
from scipy.ndimage import minimum_filter

import cluttergen_jax as cg
from cluttergen_jax.downstream.placer.evaluation.bench import Bench
from cluttergen_jax.downstream.placer.pairs import maker as data
from cluttergen_jax.downstream.placer.pairs import stored as pairs
from cluttergen_jax.downstream.placer.pairs.stored import SPLITS, images_of, load_queries
from cluttergen_jax.downstream.placer.scene_cameras import SceneCameras
from cluttergen_jax.downstream.placer.sight import QueryMaker
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.heightmap import VOID
from cluttergen_jax.sensing.noise import NOISE_OFF, REALSENSE
from cluttergen_jax.sensing.partial import PartialMap, merged
from tests.helpers.placing import write_bank


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Six pairs, free cameras."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (data, pairs):
            patch.setattr(module, "BLOCK_SIZE", 8)
        folder = tmp_path_factory.mktemp("cameras")
        found = write_bank(folder / "bank", seed=SPLITS["test"])
        yield cg.placer_data(folder / "pairs", found.path, num_pairs=6)


@pytest.fixture(scope="module")
def seen(made):
    """Queries by number of cameras, without noise."""
    return {number: load_queries(made, split="test", num_cameras=number) for number in (1, 2, 3)}


def test_more_cameras_hide_less_and_take_nothing_away(seen):
    heights = {number: found[0].heights.height for number, found in seen.items()}
    ceilings = {number: found[0].ceilings.height for number, found in seen.items()}
    for few, many in ((1, 2), (2, 3)):
        # The second camera is the same whether there is a third or not.
        assert (heights[many] >= heights[few]).all()
        assert (ceilings[many] <= np.maximum(ceilings[few], heights[many])).all()
        assert (seen[many][1].unseen <= seen[few][1].unseen + 1e-6).all()
    assert seen[3][1].unseen.mean() < seen[1][1].unseen.mean()


def test_equal_seeds_give_equal_cameras(made, seen):
    again = load_queries(made, split="test", num_pairs=2, num_cameras=2)[0]
    assert np.array_equal(again.cloud, seen[2][0].cloud[:2])
    assert np.array_equal(again.ceilings.height, seen[2][0].ceilings.height[:2])


def test_no_ceiling_lies_below_what_stands(made, seen):
    queries, labels = seen[3]
    true = Bench(made.setup("test"), labels).true_heights()
    for row, heights in enumerate(true):
        is_top = queries.heights.height[row] > VOID
        assert (queries.ceilings.height[row] >= minimum_filter(heights, 3) - 0.004)[is_top].all()


def test_a_query_of_two_cameras_is_their_two_maps_merged(made, seen):
    problem = made.setup("test").problem
    maker, cameras = QueryMaker(problem), SceneCameras(problem, "free")
    labels = seen[1][1]
    table = next(iter(made.tables("test")))
    names = list(problem.world.names)
    scenes = {scene.index: scene for scene in cg.read_bank(made.path.parent / "bank").scenes()}
    for row, first in enumerate(images_of(table, maker.T_world_region)):
        scene, number = scenes[int(labels.scene[row])], int(labels.num_standing[row])
        poses, is_placed = np.zeros((3, 7)), np.zeros(3, bool)
        for name, pose in list(zip(scene.objects, scene.poses, strict=True))[:number]:
            poses[names.index(name)], is_placed[names.index(name)] = pose, True
        (second,) = cameras.further(poses, is_placed, (0, int(labels.pair[row])), 2)
        assert np.abs(second.camera.eye - first.camera.eye).max() > 0.01
        both = merged([PartialMap.of(*view, maker.grid) for view in (first, second)])
        # Poses of pairs are single precision, in another frame.
        wrong = np.abs(both.height - seen[2][0].heights.height[row]) > 1e-3
        assert wrong.mean() < 0.01


def test_each_camera_has_noise_of_its_own(made):
    problem = made.setup("test").problem
    maker = QueryMaker(problem)
    view = next(images_of(next(iter(made.tables("test"))), maker.T_world_region))
    one, again, two = (
        maker.see_all([view] * number, REALSENSE, np.random.default_rng(0)) for number in (1, 1, 2)
    )
    assert np.array_equal(one.heights, maker.see(*view, REALSENSE, np.random.default_rng(0)).heights)
    assert np.array_equal(one.heights, again.heights)
    assert (two.heights >= one.heights).all(), "the first camera's noise is as it was alone"
    assert not np.array_equal(two.heights, one.heights)
    exact = maker.see_all([view] * 2, NOISE_OFF, np.random.default_rng(0))
    np.testing.assert_array_equal(
        exact.heights, maker.see(*view, NOISE_OFF, np.random.default_rng(0)).heights
    )


def test_cameras_that_there_are_not_are_refused(made, tmp_path):
    with pytest.raises(ConfigError, match="cameras = 0"):
        cg.placer_eval(made.path, ("random",), cameras=0)
    bank = write_bank(tmp_path / "bank", 1, SPLITS["test"])
    above = cg.placer_data(tmp_path / "pairs", bank.path, camera="overhead", num_pairs=2)
    with pytest.raises(ConfigError, match="cameras = 2 of the camera 'overhead', of which there is one"):
        cg.placer_eval(above.path, ("random",), cameras=2)


def test_rows_say_how_many_cameras_looked(made):
    found = cg.placer_eval(made.path, ("random",), noise=(0.0,), cameras=2)
    assert found.rows[0]["trial"]["cameras"] == 2
    assert "2 cameras free, fused" in str(found)
