"""Training worlds: settings within their ranges, and worlds of one setting that share what is compiled."""

import jax
import numpy as np
import pytest

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.learning.training.worlds import TrainingSetting, WorldMaker
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.heightmap import HeightMapper
from cluttergen_jax.placement.methods.baselines import LowestFit
from cluttergen_jax.placement.problem import ProblemConfig, compose
from cluttergen_jax.placement.rollout import BlockSampler, Rollout
from cluttergen_jax.placement.world import geometry_of, pad_geometry

SETS = (("dinner_plate", "soup_can", "mug"), ("cutting_board", "cereal_box", "fork"))
WIDTH = 6
PLACEMENT = PlacementConfig(history_stride=0, max_attempts=2)


@pytest.fixture(scope="module")
def maker():
    pool = find_pool("all")
    return WorldMaker([[pool[name] for name in names] for names in SETS], PLACEMENT)


def shapes(tree):
    return jax.tree.structure(tree), [
        (leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(tree)
    ]


def run(rollout, world):
    world.start_engine(num_threads=1)
    sampler = BlockSampler(world.rules, LowestFit(world.rules, mapper=world.mapper))
    return rollout.run(sampler, jax.random.key(3), np.arange(WIDTH), np.ones(WIDTH, bool))


def unpadded(world, radius):
    """The scenes of the same objects as everybody else has them."""
    support = find_support(world.setting.support)
    config = ProblemConfig(placement=world.rules.config, engine="native", num_threads=1)
    rules = compose(world.world.objects, support, config).rules
    mapper = HeightMapper.of(rules.geometry, rules.region, radius)
    sampler = BlockSampler(rules, LowestFit(rules, mapper=mapper))
    return Rollout().run(sampler, jax.random.key(3), np.arange(WIDTH), np.ones(WIDTH, bool))


@pytest.mark.parametrize("support", ["table-0.30x0.36", "shelf_desk"])
@pytest.mark.slow
def test_worlds_of_one_setting_share_a_program_and_scenes_are_those_of_unpadded_ones(
    maker, support
):
    worlds = [maker.make(TrainingSetting(support, 3, 1.0), index) for index in range(len(SETS))]
    assert shapes((worlds[0].rules, worlds[0].mapper)) == shapes(
        (worlds[1].rules, worlds[1].mapper)
    )
    rollout = Rollout()
    for world in worlds:
        scenes = run(rollout, world)
        assert rollout.num_programs == 1
        assert scenes.is_success.any()
    # What ran on the program of another world's objects.
    expected = unpadded(world, maker.radius)
    np.testing.assert_array_equal(scenes.object_index, expected.object_index)
    np.testing.assert_array_equal(scenes.poses, expected.poses)
    np.testing.assert_array_equal(scenes.counts.verdicts, expected.counts.verdicts)


def test_padding_adds_nothing_that_was_not_there(maker):
    world = maker.make(TrainingSetting("table-0.30x0.36", 3, 1.0), 1)
    plain = geometry_of(world.world)
    longer = pad_geometry(plain, plain.is_column.shape[1] + 7, len(plain.surface) + 5)
    np.testing.assert_array_equal(longer.is_column.sum(1), plain.is_column.sum(1))

    def points(geometry):
        owner = np.repeat(np.asarray(geometry.surface_owner), geometry.surface.shape[1])
        return {
            tuple(row)
            for row in np.column_stack([owner, np.asarray(geometry.surface).reshape(-1, 3)])
        }

    assert points(longer) == points(plain)
    with pytest.raises(ValueError, match="2 runs of surface too many"):
        pad_geometry(plain, plain.is_column.shape[1], len(plain.surface) - 2)
