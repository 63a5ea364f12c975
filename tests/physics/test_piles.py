"""Piles in the native engine: inside, at rest, the same whoever makes them beside, and never without end."""

import dataclasses

import numpy as np
import pytest

from cluttergen_jax.assets.modeller.bins import open_container
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.world import make_world
from cluttergen_jax.types import Verdict
from tests.helpers.worlds import box, prism

CONFIG = StabilityConfig(both_detectors=True)
SIZE = (0.16, 0.14, 0.10)
OBJECTS = [
    box("long", (0.06, 0.015, 0.01)),
    box("cube", (0.02, 0.02, 0.02)),
    prism("can", 0.02, 0.03),
]


def engine_on(support, num_threads=1):
    return NativePhysics(
        make_world(OBJECTS, support, CONFIG, ContactConfig()).layout, CONFIG, num_threads
    )


@pytest.fixture(scope="module")
def engine():
    return engine_on(open_container("bin", SIZE))


def asked_for(number, region, budget=15, is_active=True):
    """Arrays of a `PileRequest` of so many scenes, each of the three objects."""
    rng = np.random.default_rng(3)
    half = np.array([asset.half_extents for asset in OBJECTS])
    draws = np.concatenate(
        [rng.normal(size=(number, 5, 3, 4)), rng.uniform(-1, 1, (number, 5, 3, 2))], -1
    )
    return [
        np.array([rng.permutation(3) for _ in range(number)], np.int32),
        draws.astype(np.float32),
        np.tile(np.array(region, np.float32), (number, 1)),
        np.tile(half.astype(np.float32), (number, 1, 1)),
        np.zeros(number, np.float32),
        np.full(number, budget, np.int32),
        np.full(number, is_active),
    ]


IN_BIN = (0, 0, 0.708, 1, 0, 0, 0, SIZE[0] / 2, SIZE[1] / 2)


def rows(piling, index):
    return {field.name: getattr(piling, field.name)[index] for field in dataclasses.fields(piling)}


def assert_same(first, second):
    for name, value in first.items():
        np.testing.assert_array_equal(value, second[name], err_msg=name)


def test_a_pile_lies_in_its_bin_and_stands_the_last_check(engine):
    asked = asked_for(3, IN_BIN)
    made = engine.make_batch("pile", *asked)
    assert (made.verdict == Verdict.STABLE).all()
    assert (np.abs(made.poses[..., :2]) <= [0.08, 0.07]).all()
    assert (made.poses[..., 2] > 0.708).all()
    assert (made.releases >= 1).all()
    assert (made.steps.sum(1) == made.num_steps).all()
    is_placed = np.ones((3, 3), bool)
    standing = engine.stand_batch(made.poses, is_placed, np.ones(3, bool))
    assert (standing.verdict == Verdict.STABLE).all()
    np.testing.assert_array_equal(standing.shift.max(1), made.drift)
    for row in range(3):
        depths = engine.probe.depths(made.poses[row], is_placed[row])
        assert depths.max() <= 0.001
        np.testing.assert_array_equal(made.touches[row], depths[:3, :3] > 0)
    # Any orientation: something leans or lies on another side than it was authored on.
    assert (np.abs(made.poses[..., 3]) < 0.95).any()


def test_a_pile_is_the_same_alone_and_with_other_threads(engine):
    asked = asked_for(3, IN_BIN)
    together = engine.make_batch("pile", *asked)
    for other in (engine, engine_on(open_container("bin", SIZE), num_threads=2)):
        alone = other.make_batch("pile", *(each[1:2] for each in asked))
        assert_same(rows(together, 1), rows(alone, 0))


def test_what_is_not_active_is_left_alone(engine):
    asked = asked_for(2, IN_BIN)
    asked[-1][0] = False
    made = engine.make_batch("pile", *asked)
    assert made.verdict[0] == Verdict.NONE
    assert not made.releases[0].any()
    assert not made.poses[0].any()
    assert made.verdict[1] == Verdict.STABLE


@pytest.mark.parametrize(("budget", "most"), [(15, 15), (4, 4)])
def test_what_has_no_room_is_released_again_and_in_the_end_given_up(engine, budget, most):
    asked = asked_for(1, (*IN_BIN[:7], 0.01, 0.01), budget)
    # Whole boxes have to lie within 2 cm.
    asked[4][:] = 1
    made = engine.make_batch("pile", *asked)
    assert made.verdict[0] == Verdict.OUTSIDE
    assert 3 <= made.releases[0].sum() <= most
    assert made.releases[0].max() == (5 if budget == 15 else 1)
