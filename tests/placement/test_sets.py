"""Sets of objects: scenes that have the same ones, each in an order of its own."""

import re

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.rollout import BlockSampler
from tests.helpers.problems import made_up_rules

NUM_SCENES = 60
SETS = 5


def objects_of(indices, **placement):
    """i32[N, S]: the objects of scenes, in the order of placement."""
    rules = made_up_rules(world_size=9, num_objects=4, **placement)
    sampler = BlockSampler(rules, lambda key, episode: np.zeros(4, np.float32))

    @jax.jit
    def draw(key, indices):
        return sampler.begin(key, indices, np.ones(NUM_SCENES, bool)).object_index

    return np.asarray(draw(jax.random.key(7), indices))


@pytest.mark.parametrize("order", ["random", "weighted"])
def test_scenes_of_a_set_have_the_same_objects(order):
    found = objects_of(np.arange(NUM_SCENES), sets=SETS, order=order)
    assert all(len({*scene}) == 4 for scene in found.tolist())
    chosen = np.sort(found, axis=1)
    for number in range(SETS):
        assert (chosen[number::SETS] == chosen[number]).all()
    assert len(np.unique(chosen, axis=0)) == SETS
    assert len({tuple(scene) for scene in found[::SETS].tolist()}) > 4


def test_a_scene_of_a_set_depends_on_its_number_alone():
    found = objects_of(np.arange(NUM_SCENES), sets=SETS)
    later = objects_of(np.arange(NUM_SCENES) + 13, sets=SETS)
    np.testing.assert_array_equal(found[13:], later[: NUM_SCENES - 13])


def test_sets_that_cannot_be_are_refused(tmp_path):
    out = tmp_path / "bank"
    for given, told in (
        ({"sets": 3, "num_scenes": 20}, "a multiple of 3. Try: num_scenes=18, 6 of each"),
        ({"sets": 30, "num_scenes": 20}, "num_scenes=30, 1 of each"),
        ({"sets": 0}, "sets = 0. Allowed: 1 to"),
        ({"sets": 2.5}, "a whole number"),
        ({"sets": 5, "order": "fixed"}, "all scenes have the same objects"),
        (
            {"sets": 4, "num_objects": 2, "objects": ("mug", "bowl", "fork")},
            "4 sets of 2 of 3 objects. Allowed: 1 to 3",
        ),
    ):
        with pytest.raises(ConfigError, match=re.escape(told)):
            cg.generate(out, **{"num_scenes": 20, "render": False, **given})
    assert not out.exists()
    with pytest.raises(ConfigError, match=r"a key has none.*leaving sets out"):
        cg.make_sampler(sets=3)
