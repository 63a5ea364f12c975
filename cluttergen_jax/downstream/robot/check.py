"""A robot's description tried as a whole: does its hand close, does its arm reach, does it lift a cube?"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from cluttergen_jax.assets import (
    Mesh,
    ObjectAsset,
    Rectangle,
    SupportAsset,
    find_pool,
    find_support,
)
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import (
    HINT,
    RobotDescription,
    RobotLike,
    compile_model,
    find_robot,
)
from cluttergen_jax.downstream.robot.episode import EpisodeResult, robot_episode
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps, make_grasps
from cluttergen_jax.downstream.robot.gripper import Gripper, gripper_of
from cluttergen_jax.downstream.robot.model import (
    Robot,
    add_pedestals,
    base_pose,
    hand_spec,
    with_robot,
)
from cluttergen_jax.downstream.robot.motion.execute import Trace
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics, first_axis, sampled_tools
from cluttergen_jax.downstream.transforms import rigid
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotate_in_plane, yaw_matrix
from cluttergen_jax.rendering import (
    CameraView,
    Trail,
    add_lighting,
    contact_sheet,
    fit_camera,
    open_renderer,
    set_range,
)
from cluttergen_jax.scene import Scene
from cluttergen_jax.tables import aligned_table

USUAL_REGION = 0.5
"""Metres a side of the region that a robot works in, where its description says nothing else."""
NUM_POSES = 50
_HEIGHTS = (0.02, 0.15)
"""Metres over the table of the poses that are drawn."""
_LEAST_SHARE = 0.7
_MEET = 0.001
"""Metres between pads that have met."""
_NUM_GRASPS = 8
_LARGEST_CUBE = 0.04
_DENSITY = 500.0
# What counts as over the region, of tools of joints at random.
_NEAR = 0.1
_HIGHEST = 0.4
_DOWN = -0.7
_FINGER = 0.04
_GREEN = (0.2, 0.65, 0.3)
_RED = (0.85, 0.2, 0.15)
_SIZE = (560, 420)
_EVERY = 48
_SAMPLES = 8
_LINK = 0.06
"""Metres around the middles of an arm's links that are in the picture."""


@dataclass(frozen=True)
class CheckedNumber:
    """One number of a check.

    Attributes:
      name, value: in words. fault: what to try, where it is not as it should be; "" where it is.
    """

    name: str
    value: str
    fault: str = ""


@dataclass(frozen=True, eq=False)
class RobotCheck:
    """What a check of a robot found; printed, a table and what to try.

    Attributes:
      robot: its name. numbers: ten. reached: f64[50, 4], of poses over its region, x, y, z of the tool in the
        world, and whether the arm brings it there, the hand straight down.
    """

    robot: str
    numbers: tuple[CheckedNumber, ...]
    reached: np.ndarray

    @property
    def is_good(self) -> bool:
        """Nothing failed."""
        return not any(each.fault for each in self.numbers)

    def __str__(self) -> str:
        rows = [(each.name, each.value, "fails" if each.fault else "") for each in self.numbers]
        table = aligned_table((self.robot, "", ""), rows)
        faults = [f"{each.name}: {each.fault}" for each in self.numbers if each.fault]
        return "\n".join([table, *(["", *faults] if faults else [])])


def usable_robot(robot: RobotLike | None = None) -> RobotDescription:
    """A robot (`find_robot`) whose hand closes and whose arm reaches over its region.

    Raises:
      ConfigError: there is none of that name, or its description fails in one of these.
      MissingExtraError: the package that carries its models is not installed.
    """
    found = find_robot(robot)
    gripper_of(found)
    check_reach(found)
    return found


def check_reach(robot: RobotDescription) -> None:
    """Looks where random joints bring the tool.

    Raises:
      ConfigError: none brings it over the region with the hand down.
    """
    tools = sampled_tools(robot)
    axis = first_axis(robot)
    far = robot.distance
    height = tools[:, 2, 3] + robot.height
    off = np.linalg.norm(tools[:, :2, 3] - [far, 0.0], axis=1)
    if axis.sign:
        away = np.linalg.norm(tools[:, :2, 3] - axis.anchor[:2], axis=1)
        off = np.abs(away - abs(far - axis.anchor[0]))
    is_low = (height > 0) & (height < _HIGHEST)
    is_over = is_low & (tools[:, 2, 2] < _DOWN) & (off < _NEAR)
    if is_over.any():
        return
    reach = float(np.linalg.norm(tools[:, :2, 3] - axis.anchor[:2], axis=1).max())
    is_there = off < _NEAR
    lowest = f"; the lowest there is {height[is_there].min():.2f} m high" if is_there.any() else ""
    raise ConfigError(
        f"robot {robot.name} reaches nothing: of {len(tools)} random joints none brings its tool, z down, "
        f"over a table {far:g} m away (it reaches {reach:.2f} m{lowest})",
        "an arm that brings its hand straight down over the region's middle",
        "`distance`, `height`, wider `arm.limits`, or the z of gripper.tool, the direction of approach; "
        + HINT,
    )


def region_for(robot: RobotDescription, support: SupportAsset) -> Rectangle:
    """The middle of a support's region, which the arm reaches."""
    width, depth = (USUAL_REGION, USUAL_REGION) if robot.scenes is None else robot.scenes.region
    half_x, half_y = support.region.half_extents
    return replace(support.region, half_extents=(min(half_x, width / 2), min(half_y, depth / 2)))


def check_robot_whole(
    robot: RobotLike, seed: int, num_threads: int, with_picture: bool
) -> tuple[RobotCheck, np.ndarray | None]:
    """Tries a robot: its hand, 50 poses, a cube; and u8[H, W, 3], a picture of the poses and of the cube."""
    begun = time.process_time()
    found = usable_robot(robot)
    gripper = gripper_of(found)
    support = find_support("table" if found.scenes is None else found.scenes.support)
    support = replace(support, region=region_for(found, support))
    base = base_pose(support, found)
    kinematics = ArmKinematics(base, found)
    reached = _try_poses(kinematics, support, seed)
    cube = _cube(min(_LARGEST_CUBE, round(gripper.max_opening, 3)) / 2)
    scene = Scene(("cube",), (cube,), _standing(cube, support), support)
    with Rollout(nthread=num_threads) as pool:
        grasps = make_grasps(cube, _NUM_GRASPS, seed, pool, found)
    trace = Trace(_EVERY)
    ending = robot_episode(scene, 0, grasps, seed, trace=trace, robot=found)
    tools = sampled_tools(found)
    reach = np.linalg.norm(tools[:, :2, 3] - first_axis(found).anchor[:2], axis=1).max()
    numbers = (
        *_of_hand(found, gripper),
        CheckedNumber("reach from the first axis", f"{reach:.2f} m"),
        _of_poses(reached),
        *_of_cube(grasps, ending, cube),
        CheckedNumber("time", f"{time.process_time() - begun:.1f} CPU-s"),
    )
    check = RobotCheck(found.name, numbers, reached)
    return check, _picture(found, scene, reached, trace) if with_picture else None


def _of_hand(robot: RobotDescription, gripper: Gripper) -> tuple[CheckedNumber, ...]:
    gap = _gap(robot, gripper)
    aside = 1e3 * gripper.side
    return (
        CheckedNumber(
            "joints", f"{len(robot.arm.joints)} of the arm, {gripper.joints.shape[1]} of the hand"
        ),
        CheckedNumber("the hand opens to", f"{2e3 * gripper.max_opening:.0f} mm"),
        CheckedNumber(
            "pads apart when closed",
            f"{1e3 * gap:.1f} mm",
            "" if gap <= _MEET else "`closed` further on, or other `pads`",
        ),
        CheckedNumber("their middle moves by", f"{np.ptp(aside):.1f} mm"),
    )


def _gap(robot: RobotDescription, gripper: Gripper) -> float:
    """Metres between the pads where the table says that they meet; 0 where they overlap, or are not named."""
    if not robot.gripper.pads:
        return 0.0
    model = compile_model(hand_spec(ContactConfig(), robot), robot.name)
    data = mujoco.MjData(model)
    data.qpos[:] = gripper.joints_of(0.0)
    mujoco.mj_kinematics(model, data)
    pads = [model.geom(name).id for name in robot.gripper.pads]
    return max(float(mujoco.mj_geomDistance(model, data, *pads, 1.0, None)), 0.0)


def _of_poses(reached: np.ndarray) -> CheckedNumber:
    share = reached[:, 3].mean()
    return CheckedNumber(
        "poses reached, hand down",
        f"{round(share * len(reached))} of {len(reached)}",
        ""
        if share >= _LEAST_SHARE
        else "another `distance` or `height`, a smaller `scenes.region`, or wider `arm.limits`",
    )


def _of_cube(grasps: Grasps, ending: EpisodeResult, cube: ObjectAsset) -> tuple[CheckedNumber, ...]:
    side = f"{2e3 * cube.half_extents[0]:.0f} mm"
    nothing = "the tool between the pads, `pads` that touch first, more `force`, or `pad`, half their length"
    good = len(grasps) > 0
    slip, turn = (
        (float(np.median(grasps.slip)), float(np.median(grasps.turn))) if good else (np.nan, np.nan)
    )
    lifted = "yes" if ending.is_success else f"no: {ending.outcome} ({ending.detail})"
    return (
        CheckedNumber(
            f"grasps of a cube of {side}",
            f"{len(grasps)} of {grasps.num_tested} tested",
            "" if good else nothing,
        ),
        CheckedNumber(
            "it slips in the hand", f"{1e3 * slip:.1f} mm, {np.degrees(turn):.1f} degrees"
        ),
        CheckedNumber(
            "the cube lifted by 12 cm",
            lifted,
            ""
            if ending.is_success
            else "the picture shows how far it came; `arm.gain` and `arm.speed`, "
            "`gripper.force`, `distance`",
        ),
    )


def _try_poses(kinematics: ArmKinematics, support: SupportAsset, seed: int) -> np.ndarray:
    """f64[50, 4]: x, y, z of poses over the region, the hand down, and whether the arm comes there."""
    rng = np.random.default_rng(seed)
    region = support.region
    place = rng.uniform(-1, 1, (NUM_POSES, 2)) * region.half_extents
    xy = np.asarray(region.center) + rotate_in_plane(place, region.yaw)
    z = support.top + rng.uniform(*_HEIGHTS, NUM_POSES)
    yaw = rng.uniform(-np.pi, np.pi, NUM_POSES)
    found = np.zeros((NUM_POSES, 4))
    for row, x, y, up, turn in zip(found, *xy.T, z, yaw, strict=True):
        target = rigid(yaw_matrix(turn) @ np.diag([1.0, -1.0, -1.0]), np.array([x, y, up]))
        row[:] = x, y, up, next(kinematics.solutions(target, 2), None) is not None
    return found


def _cube(half: float) -> ObjectAsset:
    corners = (
        np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(-1, 3) * half
    )
    faces = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]],
        np.int32,
    )
    faces = faces[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    mass = _DENSITY * (2 * half) ** 3
    # All else is as that of any object that stands upright.
    like = find_pool("household").objects[0]
    piece = replace(
        like.pieces[0],
        mesh=Mesh(corners, faces),
        rgba=(0.85, 0.45, 0.15, 1.0),
        uv=None,
        texture=None,
        colours=None,
        finish=None,
    )
    return replace(
        like,
        name="cube",
        label="cube",
        pieces=(piece,),
        parts=(Mesh.points(corners),),
        mass=mass,
        center_of_mass=np.zeros(3),
        inertia=np.eye(3) * mass * (2 * half) ** 2 / 6,
        resting=(replace(like.resting[0], quaternion=(1.0, 0.0, 0.0, 0.0), height=half),),
    )


def _standing(cube: ObjectAsset, support: SupportAsset) -> np.ndarray:
    """f64[1, 7]: in the middle of the region."""
    x, y = support.region.center
    return np.array([[x, y, support.top + cube.half_extents[2], 1.0, 0.0, 0.0, 0.0]])


def _picture(
    robot: RobotDescription, scene: Scene, reached: np.ndarray, trace: Trace
) -> np.ndarray:
    """Where the hand comes, green, and does not, red; and the cube in the end."""
    spec = with_robot(scene, robot)
    add_pedestals(spec, base_pose(scene.support, robot))
    width, height = _SIZE

    def draw(drawn: mujoco.MjSpec, state: np.ndarray, trails: Sequence[Trail]) -> np.ndarray:
        model = add_lighting(drawn).compile()
        data = mujoco.MjData(model)
        data.qpos[:] = state
        mujoco.mj_forward(model, data)
        arm = data.xpos[Robot.of(model, robot).is_arm]
        content = np.concatenate([arm - _LINK, arm + _LINK, reached[:, :3]])
        view = CameraView()
        reach = set_range(model, content, view, width, height)
        camera = fit_camera(content, view, width, height)
        with open_renderer(model, width, height) as renderer:
            image: np.ndarray = renderer.average(data, camera, _SAMPLES, reach, trails=trails)
        return image

    trails = [
        Trail(np.array([[x, y, z + _FINGER], [x, y, z]]), _GREEN if is_reached else _RED)
        for x, y, z, is_reached in reached
    ]
    end = trace.data.qpos
    pictures = [
        draw(spec, trace.states[0] if trace.states else end, trails),
        draw(trace.spec_on_pedestals(), end, ()),
    ]
    count = int(reached[:, 3].sum())
    captions = [f"{robot.name}: {count} of {len(reached)} poses reached", "the cube in the end"]
    return contact_sheet(pictures, captions, 2)
