"""Doors are closed in physics: what they hit is named, and what is in a drawer goes with it."""

import numpy as np
import pytest

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.physics.doors import CLOSED_SHIFT, CLOSED_TURN, door_text
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import ProblemConfig, compose
from cluttergen_jax.types import Verdict

NAMES = ("mug", "soup_can", "bowl")
UPPER = 0.4155
LOWER = 0.098
DRAWER = 0.735
TRAVEL = 0.322
"""Metres: heights of the cupboard's shelves and its drawer, and how far that opens."""
INSIDE = ((-0.2, 0.0, UPPER), (0.2, 0.0, UPPER), (0.0, 0.0, LOWER))


def problem(**changes):
    pool = find_pool("dining", names=NAMES)
    settings = {"num_objects": 3, "doors": "closed"} | changes.pop("placement", {})
    config = ProblemConfig(
        objects=NAMES,
        support="cupboard",
        placement=PlacementConfig(**settings),
        stability=StabilityConfig(both_detectors=True),
        num_threads=1,
        **changes,
    )
    return compose(
        [pool[name] for name in NAMES], find_support("cupboard").on_surface("all"), config
    )


@pytest.fixture(scope="module")
def made():
    return problem()


def poses_at(made, places):
    poses = np.zeros((3, 7), np.float32)
    poses[:, 3] = 1
    for index, (x, y, z) in enumerate(places):
        poses[index, :3] = x, y, z + made.world.objects[index].half_extents[2] + 0.0005
    return poses


def close(made, *scenes):
    poses = np.stack([poses_at(made, scene) for scene in scenes])
    is_placed = np.ones(poses.shape[:2], bool)
    closing = made.rules.simulator.stand_batch(poses, is_placed, np.ones(len(poses), bool))
    return poses, closing


def said(made, closing, row):
    names = made.world.doors.names
    return door_text(names, int(closing.door[row]), int(closing.hit[row]), made.world.names)


def test_doors_close_on_what_is_inside_and_name_what_they_hit(made):
    mug_out = ((-0.2, -0.19, UPPER), *INSIDE[1:])
    can_out = (INSIDE[0], (0.25, -0.19, LOWER), (0.0, 0.05, UPPER))
    poses, closing = close(made, INSIDE, mug_out, can_out)
    verdicts = [Verdict(int(each)) for each in closing.verdict]
    assert verdicts == [Verdict.STABLE, Verdict.BLOCKED, Verdict.BLOCKED]
    assert [said(made, closing, row) for row in range(3)] == [
        "",
        "door_left hits mug",
        "door_right hits soup_can",
    ]
    away = np.abs(closing.travel - made.world.doors.travel)
    assert (away[0] <= [CLOSED_SHIFT, CLOSED_TURN, CLOSED_TURN]).all()
    assert (away[1:, 1:] > CLOSED_TURN).all()
    np.testing.assert_allclose(closing.poses[0], poses[0], atol=0.001)
    # The door is inwards of the mug's place: it was pushed.
    assert closing.poses[1, 0, 1] > poses[1, 0, 1] + 0.004


def test_what_is_in_a_drawer_goes_with_it_and_does_not_slide(made):
    in_drawer = (INSIDE[0], (0.2, -0.34, DRAWER), (-0.15, -0.34, DRAWER))
    poses, closing = close(made, in_drawer)
    assert closing.verdict[0] == Verdict.STABLE
    np.testing.assert_allclose(closing.poses[0, 1:, 1] - poses[0, 1:, 1], TRAVEL, atol=1e-4)
    np.testing.assert_allclose(closing.poses[0, :, 0], poses[0, :, 0], atol=1e-4)
    assert closing.poses[0, 0, 1] == pytest.approx(poses[0, 0, 1], abs=1e-4)


def test_closing_is_repeated_to_the_bit_in_any_batch(made):
    scenes = (INSIDE, ((-0.2, -0.19, UPPER), *INSIDE[1:]))
    _, one = close(made, *scenes)
    _, other = close(made, *scenes[::-1])
    np.testing.assert_array_equal(one.poses, other.poses[::-1])
    np.testing.assert_array_equal(one.verdict, other.verdict[::-1])


def test_an_attempt_that_ends_in_the_way_of_a_door_is_refused_at_once(made):
    # Where an attempt ends lower than the lowest surface is asked of, it fell: all are asked for here.
    for places, verdict in (
        (INSIDE, Verdict.STABLE),
        (((-0.2, -0.19, UPPER), *INSIDE[1:]), Verdict.OUTSIDE),
    ):
        poses = poses_at(made, places)[None]
        arrays = np.ones((1, 3), bool), np.array([0]), np.array([True])
        settling = made.rules.simulator.settle_batch(poses, *arrays)
        assert settling.verdict[0] == verdict


def test_inactive_scenes_and_diverged_ones_are_left_alone(made):
    poses = np.stack([poses_at(made, INSIDE)] * 2)
    poses[1, 0, 0] = np.nan
    is_placed = np.ones(poses.shape[:2], bool)
    closing = made.rules.simulator.stand_batch(poses, is_placed, np.array([False, True]))
    assert closing.verdict.tolist() == [Verdict.NONE, Verdict.NON_FINITE]


def test_what_cannot_be_asked_for_with_doors_is_said_before_work():
    with pytest.raises(ConfigError, match="engine 'jax' with doors"):
        problem(engine="jax")
    with pytest.raises(ConfigError, match="a method that makes each scene at once"):
        problem(is_whole=True)
    assert problem(placement={"doors": "open"}).world.doors is None
