"""The plain loop in the native engine: at rest, within the region, equal with any threads, never endless."""

import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.world import make_world
from cluttergen_jax.types import Verdict
from tests.helpers.worlds import box, prism

CONFIG = StabilityConfig(both_detectors=True)
OBJECTS = [
    box("long", (0.06, 0.015, 0.01)),
    box("cube", (0.02, 0.02, 0.02)),
    prism("can", 0.02, 0.03),
]


def engine_with(num_threads=1, objects=OBJECTS):
    world = make_world(objects, cuboid_table(0.6, 0.7), CONFIG, ContactConfig())
    return NativePhysics(world.layout, CONFIG, num_threads)


@pytest.fixture(scope="module")
def engine():
    return engine_with()


def asked_for(engine, number, half=(0.15, 0.15), whole=1.0, margin=-np.inf, attempts=5, budget=15):
    """Arrays of a `DropRequest` of so many scenes, each of all objects, and that all are active."""
    rng = np.random.default_rng(3)
    objects = OBJECTS[: engine.layout.num_objects]
    region = (0, 0, engine.layout.top, 1, 0, 0, 0, *half)
    sizes = np.array([asset.half_extents for asset in objects], np.float32)
    return [
        np.array([rng.permutation(len(objects)) for _ in range(number)], np.int32),
        rng.integers(0, 2**32, (number, 2), dtype=np.uint32),
        np.tile(np.array(region, np.float32), (number, 1)),
        np.tile(sizes, (number, 1, 1)),
        np.full(number, whole, np.float32),
        np.full((number, len(objects)), margin, np.float32),
        np.full(number, attempts, np.int32),
        np.full(number, budget, np.int32),
        np.ones(number, bool),
    ]


def test_all_scenes_stand_in_the_last_check_within_their_region(engine):
    asked = asked_for(engine, 4)
    made = engine.make_batch("drop", *asked)
    assert (made.verdict == Verdict.STABLE).all()
    assert (made.releases >= 1).all()
    assert not made.is_left_out.any()
    assert (made.rejected.sum(1) == (made.releases - 1).sum(1)).all()
    assert (made.steps.sum(1) == made.num_steps).all()
    assert (np.abs(made.poses[..., :2]) < 0.15).all()
    standing = engine.stand_batch(made.poses, np.ones((4, 3), bool), np.ones(4, bool))
    assert (standing.verdict == Verdict.STABLE).all()


def test_a_scene_is_the_same_alone_and_with_other_threads(engine):
    asked = asked_for(engine, 4)
    together = engine_with(num_threads=2).make_batch("drop", *asked)
    alone = engine.make_batch("drop", *(each[2:3] for each in asked))
    for name in ("verdict", "poses", "releases", "steps", "rejected", "drift"):
        np.testing.assert_array_equal(getattr(together, name)[2], getattr(alone, name)[0], name)


def test_where_no_spot_is_free_an_object_is_let_go_above_the_others():
    engine = engine_with(objects=OBJECTS[:2])
    # Centres within 5 mm: the second of the two has no room beside the first.
    asked = asked_for(engine, 6, half=(0.005, 0.005), whole=0.0)
    made = engine.make_batch("drop", *asked)
    stable = made.verdict == Verdict.STABLE
    assert stable.any()
    on_top = (made.level[stable] == 1).sum(1)
    np.testing.assert_array_equal(on_top, 1)


def test_what_has_no_room_ends_its_scene_and_the_rest_is_kept(engine):
    # 6 cm: the long one does not fit whole.
    asked = asked_for(engine, 3, half=(0.03, 0.03), attempts=2)
    asked[0][:] = [1, 0, 2]
    made = engine.make_batch("drop", *asked)
    assert (made.verdict == Verdict.OUTSIDE).any()
    assert (made.verdict != Verdict.STABLE).all()
    np.testing.assert_array_equal(made.is_left_out, [[True, False, True]] * 3)
    np.testing.assert_array_equal(made.releases, [[2, 1, 0]] * 3)


def test_the_budget_of_a_scene_ends_it(engine):
    made = engine.make_batch("drop", *asked_for(engine, 2, half=(0.02, 0.02), budget=1))
    assert (made.releases.sum(1) == 1).all()
    assert (made.verdict != Verdict.STABLE).all()


def test_a_margin_that_no_object_has_is_never_reached(engine):
    made = engine.make_batch("drop", *asked_for(engine, 2, margin=1.0))
    assert (made.verdict == Verdict.UNSUPPORTED).all()
    assert (made.rejected[:, Verdict.UNSUPPORTED] == 5).all()
