"""A robot in a bank's scenes in JAX: `reset` and `step` to be compiled, mapped and scanned, on MJX."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from cluttergen_jax.downstream.environments.mjx_controls import MjxControls
from cluttergen_jax.downstream.environments.mjx_judge import (
    EpisodeEnd,
    HandSensors,
    JudgeMemory,
    MjxJudge,
    Seen,
    Start,
    distance_to_region,
    is_closing,
    moved_others,
)
from cluttergen_jax.downstream.environments.world import RobotWorld
from cluttergen_jax.downstream.episodes.progress import grasp_progress, place_progress
from cluttergen_jax.downstream.episodes.simulation import MAX_FORCE
from cluttergen_jax.downstream.robot.episode import stand_beside
from cluttergen_jax.downstream.words import MjxTask, RobotReward
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation import BankArrays, WorldState
from cluttergen_jax.geometry import Array
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.physics import faces_first, soften_contacts

_MAX_STATE = 1e10
"""MuJoCo's own limit (mjMAXVAL): what is larger has diverged."""
_FEW_SHAPES = 16
"""Colliding shapes with which pure JAX compiles in some minutes."""
_OF_PHYSICS = (
    "body_mass",
    "body_inertia",
    "body_subtreemass",
    "body_invweight0",
    "dof_invweight0",
    "dof_M0",
    "geom_friction",
)
"""Fields of a model that may differ from world to world; others, such as colours, move nothing."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MjxState:
    """A step of an episode, as trainers of MuJoCo Playground and Brax take it; a pytree.

    Attributes:
      data: the simulation, after the kinematics. obs: f32[D]. reward, done: f32.
      metrics: f32 each, of this step: `success` and the failures by name, 1 in the step that ends so;
        `progress`, 0 to 1; `displaced`, metres that another object is from where it stood at most.
      info: `scene`, its number in the bank; `ending`, i32, an `EpisodeEnd`; `is_late`, f32, the time is over;
        the others are the environment's own, and those of wrappers.
    """

    data: mjx.Data
    obs: Array
    reward: Array
    done: Array
    metrics: dict[str, Array]
    info: dict[str, Any]

    @property
    def pipeline_state(self) -> mjx.Data:
        """`data`, as Brax calls it."""
        return self.data

    def replace(self, **changes: Any) -> MjxState:
        """A changed state; `pipeline_state` stands for `data`."""
        if "pipeline_state" in changes:
            changes["data"] = changes.pop("pipeline_state")
        return replace(self, **changes)


class MjxRobotEnv:
    """One robot in the scenes of a bank; made by `cg.make_mjx_env`, which says what it does.

    Attributes:
      world: the model and its resets. task: "grasp" or "place".
      episode_length: steps of control of the longest episode, for wrappers.
      observation_size, action_size: D and n + 1.
      dt, sim_dt: seconds of a step of control and of the simulation; n_substeps: of these in one of those.
    """

    backend = "mjx"

    def __init__(
        self,
        world: RobotWorld,
        task: MjxTask,
        places: np.ndarray,
        impl: str,
        num_envs: int,
        reward: RobotReward,
        control_hz: float,
        max_seconds: float,
    ) -> None:
        world, self._sensors = HandSensors.added_to(world, by_geom=impl == "jax")
        # Within this, MJX in pure JAX finds all contacts of flat faces.
        self._contacts = faces_first if impl == "jax" else nullcontext
        if impl == "jax":
            world = replace(world, model=soften_contacts(world.model))
        self.world = world
        self.task = task
        self._places = jnp.asarray(places)
        model = world.model
        self.sim_dt = float(model.opt.timestep)
        self.n_substeps = max(1, round(1 / control_hz / self.sim_dt))
        self.dt = self.n_substeps * self.sim_dt
        self._is_dense = reward == "dense"
        self._controls = MjxControls(world, self.dt)
        self.action_size = self._controls.action_size
        self.observation_size = self._controls.observation_size
        max_steps = max(1, round(max_seconds / self.dt))
        self._judge = MjxJudge(task, world.support, self.dt, max_steps)
        self.episode_length = max_steps + self._judge.watch_steps
        room = {}
        if impl == "warp":
            contacts, rows = world.limits
            most = contacts * num_envs
            room = {"naconmax": most, "naccdmax": most, "njmax": rows}
        self._mjx_model = _on_device(model, impl)
        self._blank = mjx.make_data(model, impl=impl, **room)
        resting = [each.resting[0] for each in world.bank.compiled.objects]
        self._resting = jnp.array([[each.height, *each.quaternion] for each in resting])

    @with_own_settings
    def reset(self, key: Array) -> MjxState:
        """The beginning of an episode in a scene of the bank, drawn by one PRNG key, of either style."""
        scene_key, own_key, turn_key = jax.random.split(key, 3)
        number = jax.random.randint(scene_key, (), 0, len(self._places))
        scene = self.world.bank.scene(self._places[number])
        return self._begin(scene, self.world.state_of(scene, own_key), turn_key)

    def _begin(self, scene: BankArrays, state: WorldState, key: Array) -> MjxState:
        target = scene.object_index[(scene.object_index >= 0).sum() - 1]
        qpos = state.qpos
        if self.task == "place":
            address = jnp.asarray(self.world.object_qpos)[target]
            qpos = qpos.at[address].set(self._pose_on_stand(target, key))
        fields = {name: state.fields[name] for name in _OF_PHYSICS if name in state.fields}
        data = self._blank.replace(
            qpos=qpos, qvel=state.qvel, ctrl=state.ctrl, xfrc_applied=state.xfrc_applied
        )
        with self._contacts():
            data = mjx.forward(self._model_of(fields), data)
        start = Start(self._controls.poses(qpos), scene.is_present, target)
        zero = jnp.zeros(())
        metrics = dict.fromkeys((*_COUNTED, "progress", "displaced"), zero)
        info = {
            "scene": scene.index,
            "slots": scene.object_index,
            "start": start,
            "memory": JudgeMemory.new(),
            "fields": fields,
            "ending": jnp.zeros((), jnp.int32),
            "is_late": zero,
        }
        obs = self._controls.observe(data, start, scene.object_index)
        return MjxState(data, obs, zero, zero, metrics, info)

    def _pose_on_stand(self, target: Array, key: Array) -> Array:
        """f32[7]: an object on the stand, somehow turned."""
        support = self.world.support
        half = jax.random.uniform(key, (), minval=-jnp.pi, maxval=jnp.pi) / 2
        rest = self._resting[target]
        turn = _product(jnp.array([jnp.cos(half), 0.0, 0.0, jnp.sin(half)]), rest[1:])
        x, y, _ = stand_beside(support).center
        return jnp.concatenate([jnp.array([x, y, support.top + rest[0]]), turn])

    def _model_of(self, fields: Mapping[str, Array]) -> mjx.Model:
        return self._mjx_model.tree_replace(dict(fields)) if fields else self._mjx_model

    @with_own_settings
    def step(self, state: MjxState, action: Array) -> MjxState:
        """A step of control. While an object that was let go is watched, actions move nothing.

        Args:
          action: f32[n + 1], clipped to -1 to 1.
        """
        info = state.info
        start = info["start"]
        # Wrappers that begin again put back the simulation alone.
        memory = _where(state.data.time > 0, info["memory"], JudgeMemory.new())
        before = self._progress(state.data, start, memory)
        data, is_pressing = self._advance(state, action, memory.is_watching)
        is_finite = (jnp.abs(data.qpos) < _MAX_STATE).all() & (
            jnp.abs(data.qvel) < _MAX_STATE
        ).all()
        found, _ = self._sensors.read(data.sensordata)
        arm = self.world.robot
        seen = Seen(
            poses=self._controls.poses(data.qpos),
            tool=data.site_xpos[arm.site],
            is_touching=found[start.target],
            is_closing=is_closing(self.world.description, data.ctrl[arm.grip]),
            is_pressing=is_pressing,
            is_finite=is_finite,
        )
        memory, ending = self._judge.judge(start, memory, seen)
        is_success = ending == EpisodeEnd.SUCCESS
        is_over = (ending != EpisodeEnd.NONE) & (ending != EpisodeEnd.TIME_LIMIT)
        progress = self._progress(data, start, memory)
        progress = jnp.where(is_success, 1.0, jnp.where(is_finite, progress, before))
        reward = is_success + (progress - before if self._is_dense else 0.0)
        displaced = jnp.where(is_finite, moved_others(start, seen.poses)[1], 0.0)
        obs = self._controls.observe(data, start, info["slots"])
        counted = {name: (ending == end).astype(jnp.float32) for name, end in _COUNTED.items()}
        return MjxState(
            data=data,
            obs=jnp.where(is_finite, obs, 0.0),
            reward=reward.astype(jnp.float32),
            done=is_over.astype(jnp.float32),
            metrics={**state.metrics, **counted, "progress": progress, "displaced": displaced},
            info={
                **info,
                "memory": memory,
                "ending": ending,
                "is_late": (ending == EpisodeEnd.TIME_LIMIT).astype(jnp.float32),
            },
        )

    def _advance(
        self, state: MjxState, action: Array, is_watching: Array
    ) -> tuple[mjx.Data, Array]:
        """The simulation after a step of control, and bool: an unplanned contact pressed too hard."""
        model = self._model_of(state.info["fields"])
        first = state.data.ctrl
        last = jnp.where(is_watching, first, self._controls.ctrl_of(action, first))
        is_target = jnp.arange(self._sensors.num_objects + 1) == state.info["start"].target
        is_planned = is_target & ~is_watching

        def advance(carry: tuple[mjx.Data, Array], share: Array) -> tuple[Any, None]:
            data, is_pressing = carry
            with self._contacts():
                data = mjx.step(model, data.replace(ctrl=first + (last - first) * share))
            _, force = self._sensors.read(data.sensordata)
            return (data, is_pressing | ((force > MAX_FORCE) & ~is_planned).any()), None

        shares = jnp.arange(1, self.n_substeps + 1) / self.n_substeps
        (data, is_pressing), _ = jax.lax.scan(
            advance, (state.data, jnp.zeros((), bool)), shares.astype(jnp.float32)
        )
        return mjx.kinematics(model, data), is_pressing

    def _progress(self, data: mjx.Data, start: Start, memory: JudgeMemory) -> Array:
        """f32, 0 to 1: how far an episode has come."""
        poses = self._controls.poses(data.qpos)
        target = poses[start.target]
        found, _ = self._sensors.read(data.sensordata)
        is_held = found[start.target]
        distance = jnp.linalg.norm(target[:3] - data.site_xpos[self.world.robot.site])
        displaced = moved_others(start, poses)[1]
        if self.task == "grasp":
            height = target[2] - start.poses[start.target, 2]
            return grasp_progress(jnp, distance, displaced, is_held, height)
        away = distance_to_region(self.world.support, target)
        return place_progress(jnp, distance, displaced, is_held, away, memory.is_watching)

    def ending_text(self, state: MjxState) -> Any:
        """How an episode ended, in words as of `make_robot_env`; "" before that. Of a batch, a list."""
        endings = np.asarray(state.info["ending"])
        words = np.vectorize(lambda number: EpisodeEnd(number).text, otypes=[object])(endings)
        return words.tolist()

    @property
    def unwrapped(self) -> MjxRobotEnv:
        """Itself."""
        return self

    @property
    def mj_model(self) -> mujoco.MjModel:
        """Of C MuJoCo."""
        return self.world.model

    @property
    def mjx_model(self) -> mjx.Model:
        """On the device."""
        return self._mjx_model

    @property
    def xml_path(self) -> str:
        """The bank that the model is made of."""
        return str(Path(self.world.bank.bank.path) / "bank.json")


_COUNTED = {
    end.name.lower(): end
    for end in EpisodeEnd
    if end not in (EpisodeEnd.NONE, EpisodeEnd.TIME_LIMIT)
}
"""Endings that metrics count, by name."""


def _on_device(model: mujoco.MjModel, impl: str) -> mjx.Model:
    """The model for an engine; who waits long for it is warned.

    Raises:
      ConfigError: pure JAX has no collision of some of its shapes.
    """
    num_shapes = int(((model.geom_contype > 0) | (model.geom_conaffinity > 0)).sum())
    if impl == "jax" and num_shapes > _FEW_SHAPES:
        warnings.warn(
            f"MJX in pure JAX compiles for many minutes with {num_shapes} colliding shapes; impl='warp' "
            "(extra gpu) takes two, on a CPU, too",
            stacklevel=4,
        )
    try:
        return mjx.put_model(model, impl=impl)
    except NotImplementedError as error:
        raise ConfigError(
            f"impl = {impl!r} for this bank and robot: {error}", "warp", "impl='warp', extra gpu"
        ) from error


def _where(condition: Array, one: JudgeMemory, other: JudgeMemory) -> JudgeMemory:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)


def _product(a: Array, b: Array) -> Array:
    """f32[4]: quaternions multiplied, wxyz."""
    w = a[0] * b[0] - a[1:] @ b[1:]
    return jnp.concatenate([w[None], a[0] * b[1:] + b[0] * a[1:] + jnp.cross(a[1:], b[1:])])
