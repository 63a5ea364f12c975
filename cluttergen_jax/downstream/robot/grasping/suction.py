"""A suction cup: where its rim seals, what it carries, and how it lifts things out of clutter.

The seal is that of Dex-Net 3.0 (Mahler et al., ICRA 2018): no part of the rim may be stretched by more than a
tenth as it is laid onto the surface along the cup's axis, and all of it has to lie on the object. What a
sealed cup carries is bounded by their model of a ring: the vacuum's force along the axis, friction across it
and about it, and the torque that bends the rim off, whose stiffness is that of SuctionNet-1Billion (Cao et
al., RA-L 2021).
A lift in a scene is simulated: the cup is welded to what it sealed on, until a bound is passed.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from cluttergen_jax.assets import VISUAL_GROUP, ObjectAsset, object_hash
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.digests import json_digest
from cluttergen_jax.downstream.robot.description import RobotDescription, RobotLike, find_robot
from cluttergen_jax.downstream.robot.grasping.candidates import BACK, CLEARANCE, STEEPEST_UP, Union
from cluttergen_jax.downstream.robot.grasping.clutter import (
    LIFT,
    RAISED,
    ROUNDS,
    TIMESTEP,
    ClutterGrasps,
    LabelledGrasps,
    Lift,
    LiftEnd,
    add_slide,
    spec_to_lift,
)
from cluttergen_jax.downstream.robot.grasping.grasp_check import MAX_LOAD, SHAKE
from cluttergen_jax.downstream.robot.grasping.object_labels import ObjectLabels
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of, rigid, shift_along
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import is_regular_file
from cluttergen_jax.scene import Scene
from cluttergen_jax.schema import SchemaError, convert, parse_yaml, read_written
from cluttergen_jax.sensing import Camera, cast_rays

_CUPS = Path(__file__).with_name("cups")
_USUAL = "suction"
STRETCH = 0.1
"""Share by which a part of the rim may become longer or shorter."""
_RIM = 32
"""Points of the rim that are looked at."""
_ABOVE = 0.1
"""Metres above the surface from which the rim is laid down."""
_TILTED = 0.25
"""Share of candidates of an object that are not along the surface's normal, and by how much, radians."""
_TILT = np.radians(15)

_RISE = 0.5
_HOLD = 0.2
_AT_ONCE = 2
_PREFIX = "suction/"
_BODY = "suction/cup"
_CARRIAGE = "suction/carriage"
_AWAY = (0.0, 0.0, 100.0)
_HINT = "a YAML file with the fields of `SuctionCup`, such as grasping/cups/suction.yaml of this package"


@dataclass(frozen=True)
class SuctionCup:
    """A suction cup at the end of a tube, in place of a robot's hand.

    Its tool's frame has its origin in the middle of the rim, z towards the object.

    Attributes:
      name: a word.
      radius: metres, of the rim. tube_radius, length: of what is behind it.
      travel: metres by which the cup gives way along its axis: within that it touches nothing else.
      force: newtons, with which the vacuum holds at most.
      friction: sliding coefficient of the rim.
      stiffness: newtons; times pi and the radius it is the torque that bends the rim off.
    """

    name: str = _USUAL
    radius: float = 0.015
    tube_radius: float = 0.006
    length: float = 0.10
    travel: float = 0.005
    force: float = 35.0
    friction: float = 0.5
    stiffness: float = 15.6

    def __post_init__(self) -> None:
        numbers = {key: value for key, value in vars(self).items() if key != "name"}
        wrong = [key for key, value in numbers.items() if not (np.isfinite(value) and value > 0)]
        if wrong or not self.name.isidentifier():
            given = ", ".join(f"{key} = {getattr(self, key)!r}" for key in [*wrong, "name"])
            raise ConfigError(
                f"a suction cup with {given}",
                "finite numbers above 0, metres and newtons, and a name of letters, digits and _",
            )

    @property
    def hash(self) -> str:
        """Hex digest of what it is."""
        return json_digest(dataclasses.asdict(self))

    @property
    def bending(self) -> float:
        """N m: the torque that bends the rim off."""
        return float(np.pi * self.radius * self.stiffness)

    def load_of(self, force: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """f64[...]: the share of its bounds that a load takes; it lets go above 1.

        Args:
          force: f64[..., 3], newtons with which the object pulls at the cup, axes of the tool: z above 0
            pulls it off. torque: f64[..., 3], N m, about the middle of the rim.
        """
        press = np.maximum(self.force - force[..., 2], 1e-9)
        grip = self.friction * press
        shares = [
            force[..., 2] / self.force,
            np.linalg.norm(force[..., :2], axis=-1) / grip,
            np.abs(torque[..., 2]) / (self.radius * grip),
            np.linalg.norm(torque[..., :2], axis=-1) / self.bending,
        ]
        most: np.ndarray = np.max(shares, axis=0)
        return most


Hand = RobotDescription | SuctionCup
"""What holds: a robot's hand, or a suction cup."""


def find_hand(robot: RobotLike | SuctionCup) -> Hand:
    """A robot as `find_robot` knows it, or a suction cup: by the name `suction`, as YAML, or as it is.

    Raises:
      ConfigError: there is none of that name, or something in its description is wrong.
      MissingExtraError: the package that carries a robot's models is not installed.
    """
    if isinstance(robot, SuctionCup | RobotDescription):
        return robot if isinstance(robot, SuctionCup) else find_robot(robot)
    path = _CUPS / f"{robot}.yaml" if robot == _USUAL else Path(robot)
    if not is_regular_file(path):
        return find_robot(robot)
    try:
        content = parse_yaml(read_written(path))
        if not (isinstance(content, dict) and "arm" not in content and "radius" in content):
            return find_robot(robot)
        unknown = set(content) - {field.name for field in dataclasses.fields(SuctionCup)}
        if unknown:
            raise SchemaError(f"{', '.join(sorted(unknown))} is unknown")
        return convert(content, SuctionCup)
    except (SchemaError, OSError) as error:
        raise ConfigError(f"suction cup {path}: {error}", _HINT) from error


def seals(union: Union, poses: np.ndarray, cup: SuctionCup) -> np.ndarray:
    """bool[C]: whether the rim of a cup at T_object_tool f64[C, 4, 4] seals on an object."""
    sealed: np.ndarray = rim_stretch(union, poses, cup) <= STRETCH
    return sealed


def rim_stretch(union: Union, poses: np.ndarray, cup: SuctionCup) -> np.ndarray:
    """f64[C]: the largest share by which a part of the rim is stretched that is laid onto an object.

    inf where a part of it misses the object, or has to move by more than the cup's travel.

    Args:
      poses: f64[C, 4, 4], T_object_tool.
    """
    angle = 2 * np.pi * np.arange(_RIM) / _RIM
    ring = cup.radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(_RIM)], axis=1)
    rim = ring @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3]
    along = np.broadcast_to(poses[:, None, :3, 2], rim.shape)
    crossing = union.cast((rim - _ABOVE * along).reshape(-1, 3), along.reshape(-1, 3))
    first = np.where(crossing.enter > 0, crossing.enter, np.inf).min(1).reshape(len(poses), _RIM)
    sunk = first - _ABOVE
    is_on = (np.abs(sunk) <= cup.travel).all(1)
    heights = np.where(is_on[:, None], sunk, 0.0)
    side = 2 * cup.radius * np.sin(np.pi / _RIM)
    length = np.hypot(side, np.diff(heights, axis=1, append=heights[:, :1]))
    return np.where(is_on, length.max(1) / side - 1, np.inf)


def gravity_load(
    asset: ObjectAsset, poses: np.ndarray, down: np.ndarray, cup: SuctionCup
) -> np.ndarray:
    """f64[C]: the share of its bounds that the weight of an object takes, which hangs at rest.

    Args:
      poses: f64[C, 4, 4], T_object_tool. down: f64[3], unit, the direction of gravity in the object's frame.
    """
    pull = asset.mass * ContactConfig().gravity * down
    force, torque = _at_rim(asset, poses, pull[None])
    return cup.load_of(force, torque)[:, 0]


def _at_rim(
    asset: ObjectAsset, poses: np.ndarray, pull: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """f64[C, L, 3] each: forces and torques at the rim, its axes, of L pulls f64[L, 3] at its mass."""
    turn = poses[:, :3, :3]
    force = np.einsum("cji,lj->cli", turn, pull)
    arm = np.einsum("cji,cj->ci", turn, asset.center_of_mass - poses[:, :3, 3])
    return force, np.cross(arm[:, None], force)


def carried_weights(asset: ObjectAsset, poses: np.ndarray, cup: SuctionCup) -> np.ndarray:
    """f64[C]: times its weight that a sealed cup carries of an object, `MAX_LOAD` at most, shaken.

    The object hangs as it stands in scenes, its -z downwards, and is shaken to and fro by `SHAKE` along three
    axes.
    """
    gravity = ContactConfig().gravity
    shakes = SHAKE * np.concatenate([np.eye(3), -np.eye(3)])
    weights = np.linspace(0, MAX_LOAD, 41)[1:]
    apparent = weights[:, None, None] * np.array([0.0, 0.0, -gravity]) + shakes
    force, torque = _at_rim(asset, poses, asset.mass * apparent.reshape(-1, 3))
    worst = cup.load_of(force, torque).reshape(len(poses), len(weights), -1).max(2)
    is_carried = np.logical_and.accumulate(worst <= 1, axis=1)
    carried: np.ndarray = weights[0] * is_carried.sum(1)
    return carried


def surface_poses(
    union: Union, number: int, rng: np.random.Generator, is_down: np.ndarray | None = None
) -> np.ndarray:
    """f64[C, 4, 4]: T_object_tool on points of an object's surface, along the normal, at any turn.

    Args:
      is_down: f64[3], the direction that is down in the object's frame: what faces there is left out.
    """
    points, normals = union.surface_points(4 * number, rng)
    is_outside = union.distance(points + 1e-4 * normals) > 0
    if is_down is not None:
        is_outside &= normals @ is_down < STEEPEST_UP
    points = points[is_outside][:number]
    normals = normals[is_outside][:number]
    return facing_poses(points, -normals, rng.uniform(0, 2 * np.pi, len(points)))


def facing_poses(points: np.ndarray, approach: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """f64[C, 4, 4]: frames at points f[C, 3] whose z is f[C, 3], unit; angle: f[C], radians about it."""
    helper = np.eye(3)[np.argmin(np.abs(approach), axis=1)]
    x = np.cross(helper, approach)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(approach, x)
    turned = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y
    return rigid(np.stack([turned, np.cross(approach, turned), approach], axis=-1), points)


def can_seal(asset: ObjectAsset, cup: SuctionCup) -> bool:
    """Whether a cup seals anywhere on an object, by a quick look."""
    union = Union(asset.parts)
    poses = surface_poses(union, 200, np.random.default_rng(int(object_hash(asset)[:12], 16)))
    return bool(seals(union, poses, cup).any())


def label_cups(asset: ObjectAsset, number: int, seed: int, cup: SuctionCup) -> ObjectLabels:
    """So many places of a cup on an object, those that fail among them; a quarter is tilted by chance."""
    rng = np.random.default_rng([seed, int(object_hash(asset)[:12], 16), 87])
    union = Union(asset.parts)
    pose = surface_poses(union, number, rng)
    points = pose[:, :3, 3]
    tilt = np.zeros((len(pose), 3))
    num_tilted = round(_TILTED * len(pose))
    tilt[:num_tilted, :2] = rng.normal(0, _TILT, (num_tilted, 2))
    approach = pose[:, :3, 2] + np.einsum("cij,cj->ci", pose[:, :3, :3], tilt)
    approach /= np.linalg.norm(approach, axis=1, keepdims=True)
    normals = -pose[:, :3, 2]
    pose = facing_poses(points, approach, rng.uniform(0, 2 * np.pi, len(pose)))
    is_sealed = seals(union, pose, cup)
    still = _CupModel(_alone(asset, cup), cup)
    is_free = np.array([not still.touches(each) for each in pose], bool)
    carried = carried_weights(asset, pose, cup)
    unknown = np.full(len(pose), np.nan)
    return ObjectLabels(
        pose,
        pose.copy(),
        np.stack([points, points], axis=1),
        np.stack([normals, normals], axis=1),
        np.full(len(pose), np.inf),
        is_sealed,
        is_free,
        is_sealed & is_free & (carried >= 1),
        unknown,
        unknown.copy(),
        unknown.copy(),
        np.where(is_sealed & is_free, carried, 0.0),
    )


def draw_cups(
    scene: Scene, still: StillCups, number: int, rng: np.random.Generator
) -> LabelledGrasps:
    """Places of a cup in a scene, along normals that do not face down, and which are free and seal.

    As many are drawn as `label_grasps` draws; `blocked_by` is "no seal" where nothing but that is wrong.
    """
    parts: list[ClutterGrasps] = []
    blockers: list[str] = []
    share = -(-number // max(len(scene.names), 1))
    while len(parts) < ROUNDS and 2 * blockers.count("") < number:
        for index, asset in enumerate(scene.objects):
            T = matrix_of(scene.poses[index])
            union = _union_of(asset)
            local = surface_poses(union, share, rng, -T[2, :3])
            sealed = seals(union, local, still.cup)
            poses = T @ local
            parts.append(
                ClutterGrasps(
                    poses,
                    np.zeros(len(poses)),
                    np.full(len(poses), index),
                    np.zeros(len(poses), bool),
                )
            )
            for pose, is_sealed in zip(poses, sealed, strict=True):
                blockers.append(still.blocker(pose) or ("" if is_sealed else NO_SEAL))
    drawn = ClutterGrasps(*(np.concatenate(each) for each in zip(*parts, strict=True)))
    blocked_by = np.array(blockers)
    is_free = blocked_by == ""
    free = rng.permutation(np.flatnonzero(is_free))[: (number + 1) // 2]
    others = rng.permutation(np.flatnonzero(~is_free))[: number - len(free)]
    chosen = np.sort(np.concatenate([free, others]))
    return LabelledGrasps(drawn.take(chosen), blocked_by[chosen], len(is_free), int(is_free.sum()))


NO_SEAL = "no seal"
"""In place of the body that blocks: the rim does not lie on the object all around."""


@lru_cache(maxsize=1024)
def _union_of(asset: ObjectAsset) -> Union:
    return Union(asset.parts)


class _CupModel:
    """A cup that can be put anywhere among bodies that stand still, and what it touches there."""

    def __init__(self, spec: mujoco.MjSpec, cup: SuctionCup) -> None:
        self.cup = cup
        for geom in spec.geoms:
            geom.margin = CLEARANCE if geom.name.startswith(_PREFIX) else 0.0
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._body = self._model.body(_BODY).id
        self._carriage = self._model.body(_CARRIAGE).id

    def touches(self, pose: np.ndarray, way: tuple[float, ...] = BACK) -> str:
        """The body that the cup touches at T_world_tool f64[4, 4] or on its straight way; "" for none."""
        for back in way:
            self._put(shift_along(pose, (0.0, 0.0, -back)))
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            bodies = self._model.geom_bodyid[self._data.contact.geom]
            others = bodies[(bodies == self._body).sum(1) == 1]
            if len(others):
                return str(self._model.body(others[0][others[0] != self._body][0]).name)
        return ""

    def _put(self, pose: np.ndarray) -> None:
        found = pose_of(pose)
        self._model.body_pos[self._carriage] = found[:3]
        self._model.body_quat[self._body] = found[3:]


class StillCups(_CupModel):
    """A scene that stands still, for looks: what the cup would touch, and what cameras see.

    Args:
      scene: its objects and what carries them. cup: that is put there.
    """

    def __init__(self, scene: Scene, cup: SuctionCup) -> None:
        spec = _spec_with_cup(scene, cup, visual=True)
        for joint in [each for each in spec.joints if each.name in scene.names]:
            spec.delete(joint)
        super().__init__(spec, cup)
        self._groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        self._groups[VISUAL_GROUP] = 1

    def blocker(self, pose: np.ndarray, width: float = 0.0) -> str:
        """The body that the cup touches at T_world_tool f64[4, 4] or on its straight way; "" for none."""
        return self.touches(pose)

    def depth(self, camera: Camera) -> np.ndarray:
        """f32[H, W]: metres along the optical axis, without noise; inf where nothing is."""
        self._put(rigid(np.eye(3), np.array(_AWAY)))
        mujoco.mj_kinematics(self._model, self._data)
        return cast_rays(self._model, self._data, camera, self._groups)[0]


class LiftCups:
    """A scene in which a cup rises by `LIFT` with what it holds; everything is awake.

    Args:
      scene: its objects and what carries them. cup: that lifts.
    """

    def __init__(self, scene: Scene, cup: SuctionCup) -> None:
        self.cup = cup
        spec = _spec_with_cup(scene, cup, visual=False)
        for geom in spec.geoms:
            if geom.name.startswith(_PREFIX):
                geom.contype = geom.conaffinity = 0
        for name in scene.names:
            weld = spec.add_equality(
                name=_PREFIX + name,
                type=mujoco.mjtEq.mjEQ_WELD,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                name1=_BODY,
                name2=name,
                active=False,
            )
            weld.solref[0] = 2 * TIMESTEP
        self._model = model = spec.compile()
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._data = mujoco.MjData(model)
        self._body = model.body(_BODY).id
        self._carriage = model.body(_CARRIAGE).id
        self._bodies = [model.body(name).id for name in scene.names]
        self._welds = [model.equality(_PREFIX + name).id for name in scene.names]

    def lift(self, pose: np.ndarray, target: int) -> Lift:
        """Lifts an object, by its number, with the cup sealed on it at T_world_tool f64[4, 4]."""
        model = self._model
        data = self._data
        mujoco.mj_resetData(model, data)
        found = pose_of(pose)
        model.body_pos[self._carriage] = found[:3]
        model.body_quat[self._body] = found[3:]
        mujoco.mj_forward(model, data)
        start = data.xpos[self._bodies].copy()
        weld = self._welds[target]
        held = self._bodies[target]
        self._set_weld(weld, pose, matrix_of(np.append(data.xpos[held], data.xquat[held])))
        data.eq_active[weld] = 1
        is_off = False
        for step in range(0, round((_RISE + _HOLD) / TIMESTEP), _AT_ONCE):
            share = min(1.0, step * TIMESTEP / _RISE)
            data.ctrl[0] = LIFT * share**2 * (3 - 2 * share)
            mujoco.mj_step(model, data, _AT_ONCE)
            if not np.isfinite(data.qpos).all():
                return Lift(LiftEnd.DIVERGED, -1, 0.0, np.inf)
            if not is_off and self.cup.load_of(*self._load(weld, pose[:3, :3])) > 1:
                data.eq_active[weld] = 0
                is_off = True
        rise = data.xpos[self._bodies, 2] - start[:, 2]
        shift = np.linalg.norm(data.xpos[self._bodies] - start, axis=1)
        if is_off or rise[target] < RAISED * LIFT:
            return Lift(LiftEnd.LOST, -1, 0.0, float(shift.max(initial=0.0)))
        return Lift(LiftEnd.LIFTED, target, 0.0, float(np.delete(shift, target).max(initial=0.0)))

    def _set_weld(self, weld: int, pose: np.ndarray, T_world_object: np.ndarray) -> None:
        """Where the object is now is where it stays: the rim's middle in its frame, and how it is turned."""
        T_object_tool = inverse(T_world_object) @ pose
        values = self._model.eq_data[weld]
        values[:3] = T_object_tool[:3, 3]
        values[3:6] = 0.0
        values[6:10] = pose_of(inverse(T_object_tool))[3:]
        values[10] = 1.0

    def _load(self, weld: int, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """f64[3] each: force and torque of the object on the cup, axes of the tool, by the weld's own forces.

        Its first three rows are along the world's axes, the others half of the turn in the cup's.
        """
        data = self._data
        rows = np.flatnonzero(
            (data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
            & (data.efc_id[: data.nefc] == weld)
        )
        if len(rows) < 6:
            return np.zeros(3), np.zeros(3)
        found = data.efc_force[rows]
        return turn.T @ found[:3], found[3:] / 2


def _alone(asset: ObjectAsset, cup: SuctionCup) -> mujoco.MjSpec:
    """An object that stands still at the origin, and a cup."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name=asset.name)
    for index, part in enumerate(asset.parts):
        spec.add_mesh(name=f"part{index}", uservert=part.vertices.ravel())
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"part{index}", name=f"part{index}")
    _add_cup(spec, cup)
    return spec


def _spec_with_cup(scene: Scene, cup: SuctionCup, visual: bool) -> mujoco.MjSpec:
    """A scene and a cup that can rise, at 100 m."""
    spec = spec_to_lift(scene, visual)
    _add_cup(spec, cup)
    return spec


def _add_cup(spec: mujoco.MjSpec, cup: SuctionCup) -> None:
    """The bellows begin where they can give way no more."""
    carriage = spec.worldbody.add_body(name=_CARRIAGE, pos=_AWAY)
    add_slide(spec, carriage, _CARRIAGE, (0, 0, 1))
    body = carriage.add_body(name=_BODY, mass=0.1, inertia=(1e-4,) * 3, explicitinertial=True)
    body.gravcomp = 1.0
    ends = (
        (cup.radius, -cup.travel - 1e-3, -cup.travel - cup.radius),
        (cup.tube_radius, -cup.travel - cup.radius, -cup.length),
    )
    for index, (radius, front, back) in enumerate(ends):
        body.add_geom(
            name=f"{_PREFIX}{index}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=(radius, (front - back) / 2, 0),
            pos=(0, 0, (front + back) / 2),
        )
