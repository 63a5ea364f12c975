"""Finished scenes in plain MuJoCo: models of what stands in them, movement, contacts, how firmly they stand.

Models hold what stands in a scene and nothing else, as its saved file has it; several are simulated at a time
on threads. Scenes are shaken, gravity is tilted, friction is less and contact softer.
"""

from __future__ import annotations

import copy
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import add_object, add_support, new_spec
from cluttergen_jax.config import ContactConfig, Detector, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.margin import margins_of
from cluttergen_jax.physics.simulations import SOFT_SOLIMP, SOFT_SOLREF
from cluttergen_jax.physics.standing import (
    STRIDE,
    Advance,
    has_moved,
    horizons_of,
    keep_awake,
    stepper,
    watch,
)
from cluttergen_jax.placement.world import World

_MAX_MODELS = 64
_FLOOR = (4.0, 4.0, 0.1)
_STRIDE_SECONDS = 0.05

Result = TypeVar("Result")


def by_object(
    object_index: np.ndarray, is_placed: np.ndarray, slot_poses: np.ndarray, num_objects: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scenes by slot (`placement.scenes.SceneBatch`) as scenes by object.

    Args:
      object_index: i[N, S], the object of each slot, -1 where there is none.
      is_placed: bool[N, S], the slot was filled.
      slot_poses: f[N, S, 7], world, metres, wxyz.
      num_objects: K, objects in the compiled world.

    Returns:
      poses f64[N, K, 7] (at the origin, unturned, where not placed), is_placed bool[N, K], and slot i32[N,
      K], the place in the order of placement, -1 where not placed.
    """
    object_index = np.asarray(object_index)
    is_placed = np.asarray(is_placed, bool)
    num_scenes = len(object_index)
    poses = np.tile(np.eye(7)[3], (num_scenes, num_objects, 1))
    placed = np.zeros((num_scenes, num_objects), bool)
    slot = np.full((num_scenes, num_objects), -1, np.int32)
    scene, place = np.nonzero(is_placed & (object_index >= 0))
    which = object_index[scene, place]
    poses[scene, which] = np.asarray(slot_poses)[scene, place]
    placed[scene, which] = True
    slot[scene, which] = place
    return poses, placed, slot


def check_scenes(poses: np.ndarray, is_placed: np.ndarray, num_objects: int | None = None) -> None:
    """Refuses arrays that are not scenes by object index.

    Raises:
      ConfigError: shapes other than [N, K, 7] and [N, K], or a placed object without a finite pose.
    """
    shape = np.shape(is_placed)
    right = len(shape) == 2 and np.shape(poses) == (*shape, 7)
    if not right or (num_objects is not None and shape[1] != num_objects):
        raise ConfigError(
            f"poses of shape {np.shape(poses)} and is_placed of shape {shape}",
            f"(N, K, 7) and (N, K){'' if num_objects is None else f' with K = {num_objects}'}",
            "arrangement.by_object, which makes them of slots",
        )
    if not np.isfinite(np.asarray(poses)[np.asarray(is_placed, bool)]).all():
        raise ConfigError("a placed object whose pose is not finite", "finished scenes only")


@dataclass(frozen=True, eq=False)
class StandingModel:
    """One set of objects on the support, over a floor. n objects.

    Attributes:
      layout: of the compiled model; nothing sleeps, and what diverges is seen, not reset.
      objects: i64[n], which of the world's objects they are, ascending.
    """

    layout: Layout
    objects: np.ndarray

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model, shared by all scenes of these objects: copy it before changing it."""
        return self.layout.model

    def own_model(self) -> mujoco.MjModel:
        """A copy that may be changed."""
        return copy.copy(self.layout.model)

    def start(self, poses: np.ndarray, model: mujoco.MjModel | None = None) -> mujoco.MjData:
        """A simulation at rest with the objects at poses f[K, 7], world, metres, wxyz, forward computed."""
        model = model or self.model
        data = mujoco.MjData(model)
        start = np.asarray(poses, np.float64)[self.objects].copy()
        start[:, 3:] /= np.linalg.norm(start[:, 3:], axis=1, keepdims=True)
        data.qpos[:] = start.ravel()
        mujoco.mj_forward(model, data)
        return data


class SceneModels:
    """Compiles a model for each set of objects that is asked for, and keeps the latest 64.

    Args:
      world: whose objects and support.
      stability: its time step counts.
      contact: friction and solver.
      mass_scale: f[K] or one number, by which each object's mass and inertia are multiplied.
      detector: of convex collisions.
    """

    def __init__(
        self,
        world: World,
        stability: StabilityConfig | None = None,
        contact: ContactConfig | None = None,
        mass_scale: np.ndarray | float = 1.0,
        detector: Detector = "native",
    ) -> None:
        self.world = world
        self.detector = detector
        self.stability = stability or StabilityConfig()
        self.contact = contact or ContactConfig()
        self.mass_scale = np.broadcast_to(np.asarray(mass_scale, np.float64), (world.num_objects,))
        self._cache: OrderedDict[bytes, StandingModel] = OrderedDict()
        self._lock = threading.Lock()

    def with_detector(self, detector: Detector) -> SceneModels:
        """The same scenes with another detector of convex collisions."""
        return SceneModels(self.world, self.stability, self.contact, self.mass_scale, detector)

    def check(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """bool[N, K] `is_placed`, if with poses f[N, K, 7] they are scenes of this world (ConfigError)."""
        check_scenes(poses, is_placed, self.world.num_objects)
        return np.asarray(is_placed, bool)

    def of(self, is_placed: np.ndarray) -> StandingModel:
        """The model of the objects that stand: bool[K]."""
        key = np.asarray(is_placed, bool).tobytes()
        with self._lock:
            if key not in self._cache:
                self._cache[key] = self._compile(np.flatnonzero(is_placed))
                if len(self._cache) > _MAX_MODELS:
                    self._cache.popitem(last=False)
            self._cache.move_to_end(key)
            return self._cache[key]

    def each(
        self,
        run: Callable[[int, StandingModel, np.ndarray], Result],
        poses: np.ndarray,
        is_placed: np.ndarray,
        num_threads: int = 0,
    ) -> list[Result]:
        """`run` of each scene's number, model and poses f[K, 7], on threads (0: one for each core).

        Raises:
          ConfigError: the arrays are not scenes of this world: f[N, K, 7] and bool[N, K].
        """
        is_there = self.check(poses, is_placed)
        return each_scene(
            lambda number: run(number, self.of(is_there[number]), poses[number]),
            len(is_there),
            num_threads,
        )

    def _compile(self, objects: np.ndarray) -> StandingModel:
        spec = new_spec(self.stability.timestep, self.contact)
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=_FLOOR)
        add_support(spec, self.world.support)
        for k in objects:
            add_object(spec, self.world.objects[k], self.world.names[k])
        model = spec.compile()
        keep_awake(model, self.detector)
        scale = self.mass_scale[objects]
        if (scale != 1).any():
            bodies = model.jnt_bodyid
            model.body_mass[bodies] *= scale
            model.body_inertia[bodies] *= scale[:, None]
            mujoco.mj_setConst(model, mujoco.MjData(model))
        return StandingModel(Layout.of(model, self.world.support.top), objects)


def each_scene(
    function: Callable[[int], Result], num_scenes: int, num_threads: int = 0
) -> list[Result]:
    """`function` of 0 to num_scenes - 1, on threads (0: one for each core); MuJoCo's log is silent."""
    threads = num_threads or os.cpu_count() or 1
    with silent_log():
        if threads == 1:
            return [function(scene) for scene in range(num_scenes)]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(function, range(num_scenes)))


@dataclass(frozen=True, eq=False)
class Movement:
    """How far objects were from where they began, at most. N scenes, H horizons, K objects.

    Attributes:
      seconds: f64[H], ascending.
      shift: f64[N, H, K], metres, up to each horizon; zero where not placed, infinite where it diverged.
      turn: f64[N, H, K], radians.
    """

    seconds: np.ndarray
    shift: np.ndarray
    turn: np.ndarray

    @property
    def largest_shift(self) -> np.ndarray:
        """f64[N, H]: metres, of the object that moved the most."""
        return self.shift.max(-1, initial=0.0)

    @property
    def largest_turn(self) -> np.ndarray:
        """f64[N, H]: radians, of the object that turned the most."""
        return self.turn.max(-1, initial=0.0)

    def survives(self) -> np.ndarray:
        """bool[N, H]: nothing went farther than finished scenes allow (docs/contract.md)."""
        return ~has_moved(self.largest_shift, self.largest_turn, StabilityConfig())

    def watch(
        self,
        scene: int,
        objects: np.ndarray,
        advance: Advance,
        start: np.ndarray,
        models: SceneModels,
    ) -> None:
        """Fills in one scene, looked at every 0.05 s and at each horizon.

        Args:
          objects: i[n], which of its objects stand; start: f64[n, 7], where.
          advance: simulates them, in steps as long as the models'.
        """
        timestep = models.stability.timestep
        marks = np.rint(self.seconds / timestep).astype(int).tolist()
        stride = max(round(_STRIDE_SECONDS / timestep), 1)
        for place, (shift, turn) in enumerate(watch(advance, start, marks, stride)):
            self.shift[scene, place, objects] = shift
            self.turn[scene, place, objects] = turn


def no_movement(is_placed: np.ndarray, seconds: Sequence[float]) -> Movement:
    """A movement of zeros, for bool[N, K] and horizons in seconds; see `horizons_of`."""
    horizons = horizons_of(seconds)
    shape = (len(is_placed), len(horizons), is_placed.shape[1])
    return Movement(horizons, np.zeros(shape), np.zeros(shape))


def movement(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    seconds: Sequence[float],
    num_threads: int = 0,
) -> Movement:
    """Simulates scenes from rest and reports the farthest that each object was from its start.

    Objects are looked at every 0.05 s and at each horizon.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      seconds: horizons, ascending.

    Raises:
      ConfigError: the arrays are not scenes of the world, or `horizons_of` refuses the horizons.
    """
    result = no_movement(models.check(poses, is_placed), seconds)

    def run(scene: int, model: StandingModel, at: np.ndarray) -> None:
        data = model.start(at)
        step = stepper(model.model, data)
        result.watch(scene, model.objects, step, data.qpos.reshape(-1, 7), models)

    models.each(run, poses, is_placed, num_threads)
    return result


BORNE_SHARE = 0.1
_SETTLE_SECONDS = 0.1


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of scenes at rest. N scenes, K objects; index K stands for the support and the floor.

    Attributes:
      force: f64[N, K, K + 1, 3], newtons, world: what j does to i, friction included.
      normal: f64[N, K, K + 1, 3], newtons, the same without friction.
      weight: f64[N, K], newtons; zero where not placed.
      count: i32[N], contact points.
      penetration: f64[N], metres, the deepest overlap of any two bodies as the scene was given.
      margin: f64[N, K], metres, each object's support margin (`physics.margin`); NaN where not placed and
        where nothing carries it.
    """

    force: np.ndarray
    normal: np.ndarray
    weight: np.ndarray
    count: np.ndarray
    penetration: np.ndarray
    margin: np.ndarray

    @property
    def rests_on(self) -> np.ndarray:
        """bool[N, K, K + 1]: j bears at least a tenth of i's weight."""
        borne = self.force[..., 2] >= BORNE_SHARE * self.weight[..., None]
        return borne & (self.weight[..., None] > 0)


def contacts_of(
    models: SceneModels, poses: np.ndarray, is_placed: np.ndarray, num_threads: int = 0
) -> Contacts:
    """Forces between the bodies of finished scenes.

    Contacts and overlap are those of the poses as given; forces are read after 0.1 s of simulation,
    everything awake, when those of rounding the poses have died away; margins are the larger of both times.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
    """
    num, size = models.check(poses, is_placed).shape
    result = Contacts(
        force=np.zeros((num, size, size + 1, 3)),
        normal=np.zeros((num, size, size + 1, 3)),
        weight=np.zeros((num, size)),
        count=np.zeros(num, np.int32),
        penetration=np.zeros(num),
        margin=np.full((num, size), np.nan),
    )

    def run(scene: int, model: StandingModel, at: np.ndarray) -> None:
        data = model.start(at)
        result.count[scene] = data.ncon
        margin = _margins(models, model, data)
        result.penetration[scene] = max(-data.contact.dist.min(initial=0.0), 0.0)
        mujoco.mj_step(model.model, data, round(_SETTLE_SECONDS / model.model.opt.timestep))
        mujoco.mj_forward(model.model, data)
        mass = model.model.body_mass[model.layout.body_index]
        result.weight[scene, model.objects] = mass * models.contact.gravity
        _add_forces(model, data, result.force[scene], result.normal[scene])
        # Of a face that lies flat the engine names a few points, now these and now those: no margin is found
        # too large, and the larger of two is nearer to the truth.
        margin = np.maximum(margin, _margins(models, model, data))
        result.margin[scene, model.objects] = np.where(np.isfinite(margin), margin, np.nan)

    models.each(run, poses, is_placed, num_threads)
    return result


def _margins(models: SceneModels, scene: StandingModel, data: mujoco.MjData) -> np.ndarray:
    """f64[n]: the support margin of each object of one scene."""
    objects = np.arange(len(scene.objects))
    return margins_of(scene.layout, data, objects, models.stability.side_support)


def _add_forces(
    scene: StandingModel, data: mujoco.MjData, force: np.ndarray, normal: np.ndarray
) -> None:
    """Adds the contacts of one scene to f64[K, K + 1, 3]."""
    # The world's index of a model's geom; the last one is the support, and the floor.
    index = np.append(scene.objects, force.shape[0])[scene.layout.geom_object]
    wrench = np.zeros(6)
    for number in range(data.ncon):
        contact = data.contact[number]
        mujoco.mj_contactForce(scene.model, data, number, wrench)
        # Rows of the frame are its axes, the first one pointing from the first geom to the second.
        frame = contact.frame.reshape(3, 3)
        first, second = index[contact.geom]
        for onto, by, sign in ((second, first, 1.0), (first, second, -1.0)):
            if onto < force.shape[0]:
                force[onto, by] += sign * (wrench[:3] @ frame)
                normal[onto, by] += sign * wrench[0] * frame[0]


_SHAKEN_STRIDE = 4
"""Steps between two looks at what is shaken, and between two accelerations."""


@dataclass(frozen=True)
class ShakeConfig:
    """A sideways acceleration of the support that grows slowly from zero.

    Attributes:
      rate: m/s^2 per second. What is let go by static friction takes a while for `max_shift`, during which
        the acceleration goes on growing: by (6 * max_shift * rate^2)^(1/3), 0.31 m/s^2 at rate 1.
      limit: m/s^2; a scene that nothing moved by then has this score.
      max_shift: metres that an object must move, relative to the support.
      directions: world directions in which the support is accelerated, a score for each.
    """

    rate: float = 1.0
    limit: float = 10.0
    max_shift: float = StabilityConfig.stand_full_shift
    directions: tuple[tuple[float, float], ...] = ((1.0, 0.0), (0.0, 1.0))

    def __post_init__(self) -> None:
        if not (self.rate > 0 and self.limit > 0 and self.max_shift > 0 and self.directions):
            raise ConfigError(
                f"{self}", "rate, limit and max_shift above zero, one direction or more"
            )


def shake(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    config: ShakeConfig | None = None,
    num_threads: int = 0,
) -> np.ndarray:
    """The sideways acceleration at which something has moved `max_shift` relative to the support.

    Simulated in the support's own frame, where an acceleration a of the support is a gravity of -a: the table
    stands still and gravity tilts.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].

    Returns:
      f64[N, D], m/s^2, for D directions; the limit where nothing moved.
    """
    asked = config or ShakeConfig()

    def run(_: int, model: StandingModel, at: np.ndarray) -> list[float]:
        return [_withstood(model, at, np.array(way), asked) for way in asked.directions]

    scores = models.each(run, poses, is_placed, num_threads)
    return np.array(scores, np.float64).reshape(len(is_placed), len(asked.directions))


def _withstood(
    scene: StandingModel, poses: np.ndarray, direction: np.ndarray, config: ShakeConfig
) -> float:
    """m/s^2 at which one scene gives way."""
    # Gravity belongs to the model, which other threads use at the same time.
    model = scene.own_model()
    data = scene.start(poses, model)
    step = stepper(model, data)
    direction = direction / np.linalg.norm(direction)
    growth = config.rate * _SHAKEN_STRIDE * model.opt.timestep
    accelerations = growth * np.arange(1, np.ceil(config.limit / growth) + 1)
    grows = iter(accelerations)

    def advance(count: int) -> np.ndarray:
        model.opt.gravity[:2] = -next(grows) * direction
        return step(count)

    marks = _SHAKEN_STRIDE * np.arange(1, len(accelerations) + 1)
    looks = watch(advance, data.qpos.reshape(-1, 7), marks.tolist(), _SHAKEN_STRIDE)
    for acceleration, (shift, _) in zip(accelerations, looks, strict=True):
        if shift.max(initial=0.0) > config.max_shift:
            return min(float(acceleration), config.limit)
    return config.limit


@dataclass(frozen=True)
class TiltConfig:
    """Gravity out of the vertical, at once and for good.

    Friction holds up to 26 degrees, so that what moves by so little tips.

    Attributes:
      degrees: by how much, ascending.
      num_directions: evenly over the circle, the first one world x.
      seconds: how long each is simulated.
    """

    degrees: tuple[float, ...] = (1.0, 2.0, 5.0)
    num_directions: int = 8
    seconds: float = 2.0

    def __post_init__(self) -> None:
        ascends = all(
            a < b for a, b in zip((0.0, *self.degrees), (*self.degrees, 90.0), strict=True)
        )
        if not (ascends and self.num_directions > 0 and self.seconds > 0):
            allowed = (
                "degrees that ascend between 0 and 90, one direction or more, seconds above zero"
            )
            raise ConfigError(f"{self}", allowed)


def tilt(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    config: TiltConfig | None = None,
    num_threads: int = 0,
) -> np.ndarray:
    """The share of directions in which a scene stands though gravity is tilted.

    What stands at one angle is taken to stand at every smaller one in the same direction.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].

    Returns:
      f64[N, A], one share for each of the angles.
    """
    asked = config or TiltConfig()
    turns = 2 * np.pi * np.arange(asked.num_directions) / asked.num_directions

    def run(_: int, model: StandingModel, at: np.ndarray) -> np.ndarray:
        return np.mean([_stands(model, at, turn, asked) for turn in turns], axis=0)

    shares = models.each(run, poses, is_placed, num_threads)
    return np.array(shares, np.float64).reshape(len(is_placed), len(asked.degrees))


def _stands(scene: StandingModel, poses: np.ndarray, turn: float, config: TiltConfig) -> np.ndarray:
    """bool[A]: at which angles one scene stands, gravity tilted towards one direction."""
    result = np.ones(len(config.degrees), bool)
    for place in reversed(range(len(config.degrees))):
        angle = np.radians(config.degrees[place])
        sideways = np.sin(angle) * np.array([np.cos(turn), np.sin(turn)])
        # Gravity belongs to the model, which other threads use at the same time.
        down = np.append(sideways, -np.cos(angle))
        if _stays(scene, scene.own_model(), poses, down, config.seconds, 3):
            break
        result[place] = False
    return result


def _stays(
    scene: StandingModel,
    model: mujoco.MjModel,
    poses: np.ndarray,
    down: np.ndarray,
    seconds: float,
    num_axes: int,
) -> bool:
    """Whether nothing moves too far, along the first so many world axes, or turns too much.

    Args:
      model: the scene's own; its gravity is turned towards `down`, a unit vector.
    """
    model.opt.gravity[:] = down * np.linalg.norm(model.opt.gravity)
    data = scene.start(poses, model)
    step = stepper(model, data)
    start = data.qpos.reshape(-1, 7).copy()

    def advance(count: int) -> np.ndarray:
        now = step(count).copy()
        now[:, num_axes:3] = start[:, num_axes:3]
        return now

    num_looks = round(seconds / model.opt.timestep / STRIDE)
    limits = StabilityConfig()
    looks = watch(advance, start, range(STRIDE, STRIDE * num_looks + 1, STRIDE))
    return not any(has_moved(shift, turn, limits).any() for shift, turn in looks)


@dataclass(frozen=True)
class RobustConfig:
    """What a robust scene withstands: tilted gravity, less friction and softer contact, all at once.

    Attributes:
      degrees: by how much gravity is tilted.
      num_directions: evenly over the circle, the first one world x.
      friction: factor of all friction coefficients.
      solref, solimp: of all contacts; by default MuJoCo's own defaults.
      seconds: how long each direction is simulated.
    """

    degrees: float = 3.0
    num_directions: int = 4
    friction: float = 0.7
    solref: tuple[float, float] = SOFT_SOLREF
    solimp: tuple[float, float, float, float, float] = SOFT_SOLIMP
    seconds: float = 2.0


def robust(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    config: RobustConfig | None = None,
    num_threads: int = 0,
) -> np.ndarray:
    """Which scenes stand, everything awake, under tilted gravity with less friction and softer contact.

    A scene is robust if nothing moves too far in plan or turns too much (`physics.standing`), from where it
    was saved, in any direction. In plan, since in soft contact everything sinks by a little, which is no
    fall: what falls also turns or goes sideways.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].

    Returns:
      bool[N].
    """
    asked = config or RobustConfig()
    turns = 2 * np.pi * np.arange(asked.num_directions) / asked.num_directions
    angle = np.radians(asked.degrees)
    sideways = np.sin(angle) * np.stack([np.cos(turns), np.sin(turns)], axis=1)

    def run(_: int, scene: StandingModel, at: np.ndarray) -> bool:
        model = scene.own_model()
        model.geom_friction[:] *= asked.friction
        model.geom_solref[:] = asked.solref
        model.geom_solimp[:] = asked.solimp
        return all(
            _stays(scene, model, at, np.append(to, -np.cos(angle)), asked.seconds, 2)
            for to in sideways
        )

    return np.array(models.each(run, poses, is_placed, num_threads), bool)
