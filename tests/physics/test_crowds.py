"""Crowds in the native engine: drawn together until they touch, at rest, the same whoever is made beside."""

import dataclasses

import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.physics.convex_outlines import gaps_in_plan, move_together, reaches_of_boxes
from cluttergen_jax.physics.crowds import LEANS
from cluttergen_jax.physics.margin import TOUCH_REACH, UNDER_REACH, OverlapProbe
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.world import make_world
from cluttergen_jax.types import Verdict
from tests.helpers.worlds import TOP, box, prism

CONFIG = StabilityConfig(both_detectors=True, side_support=True)
OBJECTS = [
    box("one", (0.03, 0.03, 0.03)),
    box("two", (0.03, 0.02, 0.02)),
    prism("can", 0.03, 0.04),
    box("tall", (0.02, 0.02, 0.09)),
]
NUMBER = len(OBJECTS)
REGION = (0, 0, TOP, 1, 0, 0, 0, 0.3, 0.3)
PLACES = np.array([[0.12, 0.12], [-0.12, 0.12], [-0.12, -0.1], [0.1, -0.12]])


def engine_of(num_threads=1):
    world = make_world(OBJECTS, cuboid_table(0.8, 0.8, TOP), CONFIG, ContactConfig())
    return NativePhysics(world.layout, CONFIG, num_threads)


@pytest.fixture(scope="module")
def engine():
    return engine_of()


def asked_for(number, side, lean=0.0, region=REGION, may_tip=False):
    """Arrays of a `CrowdRequest` of so many scenes of all four objects, each a little elsewhere."""
    rng = np.random.default_rng(5)
    half = np.array([asset.half_extents for asset in OBJECTS])
    poses = np.zeros((number, NUMBER, 7), np.float32)
    poses[..., :2] = PLACES + rng.uniform(-0.03, 0.03, (number, NUMBER, 2))
    poses[..., 2] = TOP + half[:, 2]
    yaw = rng.uniform(0, np.pi, (number, NUMBER))
    poses[..., 3] = np.cos(yaw / 2)
    poses[..., 6] = np.sin(yaw / 2)
    return [
        poses,
        np.ones((number, NUMBER), bool),
        rng.random((number, 3, NUMBER)).astype(np.float32),
        np.tile(np.array(region, np.float32), (number, 1)),
        np.tile(half.astype(np.float32), (number, 1, 1)),
        np.zeros(number, np.float32),
        np.zeros((number, 0, 5), np.float32),
        np.zeros((number, NUMBER), np.float32),
        np.full(number, side, np.float32),
        np.full(number, lean, np.float32),
        np.full(number, may_tip),
        np.zeros(number, bool),
        np.ones(number, bool),
    ]


def row_of(piling, index):
    return {field.name: getattr(piling, field.name)[index] for field in dataclasses.fields(piling)}


def test_a_crowd_touches_from_the_side_as_often_as_asked_and_stands(engine):
    asked = asked_for(4, side=0.75)
    made = engine.make_batch("crowd", *asked)
    assert (made.verdict == Verdict.STABLE).all()
    # Three pairs of four objects: every one is part of the group.
    assert (made.num_beside >= 3).all()
    assert (made.num_leaning == 0).all()
    assert not made.releases.any()
    probe = OverlapProbe(engine.layout, reach=TOUCH_REACH)
    for row in range(4):
        assert probe.depths(made.poses[row], asked[1][row]).max() < 0.0005
        assert probe.beside().any(1).all()
        assert np.triu(probe.beside()).sum() == made.num_beside[row]
    standing = engine.stand_batch(made.poses, asked[1], asked[-1])
    assert (standing.verdict == Verdict.STABLE).all()


def test_objects_apart_do_not_touch_before(engine):
    asked = asked_for(1, side=0.75)
    probe = OverlapProbe(engine.layout, reach=TOUCH_REACH)
    probe.depths(asked[0][0], asked[1][0])
    assert not probe.beside().any()


def test_what_is_asked_for_less_is_drawn_less(engine):
    little = engine.make_batch("crowd", *asked_for(4, side=0.25))
    assert (little.verdict == Verdict.STABLE).all()
    assert (little.num_beside >= 1).all()
    apart = np.linalg.norm(
        little.poses[..., :2] - little.poses[..., :2].mean(1, keepdims=True), axis=-1
    )
    much = engine.make_batch("crowd", *asked_for(4, side=1.0)).poses[..., :2]
    dense = np.linalg.norm(much - much.mean(1, keepdims=True), axis=-1)
    assert dense.mean() < apart.mean()


def test_a_crowd_is_the_same_alone_and_with_other_threads(engine):
    asked = asked_for(3, side=0.75)
    together = engine.make_batch("crowd", *asked)
    for other in (engine, engine_of(num_threads=2)):
        alone = other.make_batch("crowd", *(each[1:2] for each in asked))
        for name, value in row_of(together, 1).items():
            np.testing.assert_array_equal(value, row_of(alone, 0)[name], err_msg=name)


def test_a_crowd_keeps_out_of_boxes(engine):
    asked = asked_for(4, side=1.0)
    free = engine.make_batch("crowd", *asked).poses[..., :2]
    half = 0.08
    # Wider than the box by the radius of the smallest outline.
    assert (np.abs(free).max(-1) < half + 0.02).any()
    asked[6] = np.tile(np.array([0, 0, half, half, 0], np.float32), (4, 1, 1))
    made = engine.make_batch("crowd", *asked)
    assert (made.verdict == Verdict.STABLE).all()
    is_placed = asked[1] & ~made.is_left_out
    assert is_placed.any()
    assert (np.abs(made.poses[..., :2]).max(-1) > half + 0.02)[is_placed].all()


def test_outlines_are_as_far_apart_as_boxes(engine):
    poses = asked_for(1, side=0.0)[0].astype(np.float64)
    poses[..., 3:] = (1, 0, 0, 0)
    places = poses[..., :2]
    reaches = engine.outlines.reaches(poses)
    gaps, towards = gaps_in_plan(places, reaches, places, reaches)
    one, two = places[0, :2]
    assert gaps[0, 0, 1] == pytest.approx(one[0] - two[0] - 0.06, abs=1e-6)
    np.testing.assert_allclose(towards[0, 0, 1], (-1, 0), atol=1e-6)
    box_reaches = reaches_of_boxes(np.array([[[0.1, 0.05]]]), np.array([[np.pi / 2]]))
    gap, _ = gaps_in_plan(places, reaches, np.array([[[0.12, 0.4]]]), box_reaches)
    assert gap[0, 0, 0] == pytest.approx(0.4 - 0.1 - one[1] - 0.03, abs=1e-6)


def test_what_is_moved_together_comes_near_and_never_overlaps(engine):
    asked = asked_for(4, side=0.0)
    poses = asked[0].astype(np.float64)
    probe = OverlapProbe(engine.layout)
    moved = move_together(
        poses[..., :2],
        engine.outlines.reaches(poses),
        np.tile(np.eye(NUMBER, dtype=bool), (4, 1, 1)),
        asked[1],
        np.zeros((4, NUMBER, 2)),
        (np.zeros((4, 0, 2)), np.zeros((4, 0, 32))),
        num_moves=20,
    )
    assert (np.linalg.norm(moved, axis=-1) < np.linalg.norm(poses[..., :2], axis=-1)).all()
    near = OverlapProbe(engine.layout, reach=0.003)
    for row in range(4):
        poses[row, :, :2] = moved[row]
        assert not probe.depths(poses[row], asked[1][row])[:-1, :-1].any()
        near.depths(poses[row], asked[1][row])
        assert near.beside().any()


def test_what_is_not_active_is_left_alone(engine):
    asked = asked_for(2, side=0.75)
    asked[-1][0] = False
    made = engine.make_batch("crowd", *asked)
    assert made.verdict[0] == Verdict.NONE
    assert not made.poses[0].any()
    assert made.verdict[1] == Verdict.STABLE


def test_tall_things_lean_where_that_is_asked_for_and_only_there(engine):
    asked = asked_for(4, side=0.75, lean=0.25, may_tip=True)
    asked[7][:] = -1.0
    made = engine.make_batch("crowd", *asked)
    assert (made.verdict == Verdict.STABLE).all()
    height = 1 - 2 * (made.poses[..., 4] ** 2 + made.poses[..., 5] ** 2)
    is_tilted = np.arccos(np.clip(height, -1, 1)) > LEANS
    np.testing.assert_array_equal(is_tilted.sum(1), made.num_leaning)
    assert made.num_leaning.any()


def test_what_leaves_the_region_is_left_out(engine):
    # A region beside the group, to whose middle all but what begins there is drawn.
    region = (-0.12, 0, *REGION[2:7], 0.1, 0.3)
    made = engine.make_batch("crowd", *asked_for(2, side=1.2, region=region))
    assert (made.verdict == Verdict.STABLE).all()
    is_inside = np.abs(made.poses[..., 0] + 0.12) <= 0.1
    assert made.is_left_out.any()
    np.testing.assert_array_equal(made.is_left_out, ~is_inside | ~made.poses.any(-1))


def test_what_tips_over_is_left_out_and_the_others_stand(engine):
    asked = asked_for(1, side=0.0)
    # Let go at an angle of 45 degrees it comes to lie, or to stand.
    asked[0][0, 3, 3:] = (np.cos(np.pi / 8), np.sin(np.pi / 8), 0, 0)
    asked[0][0, 3, 2] += 0.03
    made = engine.make_batch("crowd", *asked)
    assert made.verdict[0] == Verdict.STABLE
    assert made.is_left_out[0].tolist() == [False, False, False, True]
    assert not made.poses[0, 3].any()
    is_placed = ~made.is_left_out
    standing = engine.stand_batch(made.poses, is_placed, asked[-1])
    assert standing.verdict[0] == Verdict.STABLE


def test_what_is_right_under_something_is_seen_where_nothing_presses(engine):
    poses = asked_for(1, side=0.75)[0][0].astype(float)
    lower, upper = (0, 1)
    poses[upper] = poses[lower]
    poses[upper, 2] += 0.03 + 0.02 + 0.001
    is_placed = np.arange(NUMBER) < 2
    assert UNDER_REACH > 0.001
    lies = []
    for probe in (engine.probe, engine.under_probe):
        assert probe.depths(poses, is_placed) is not None
        lies.append(np.argwhere(probe.lies_on()).tolist())
    assert lies == [[], [[upper, lower]]]
