"""A robot in a bank's scenes, for Gymnasium: place, rearrange or grasp, judged as the robot's trials are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from numbers import Integral, Real
from typing import Any, Literal, get_args

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces

from cluttergen_jax.downstream.episodes.outcome import Failed, Outcome
from cluttergen_jax.downstream.episodes.pictures import Pictures, check_cameras
from cluttergen_jax.downstream.episodes.robot_parts import GripShare
from cluttergen_jax.downstream.episodes.starts import EpisodeStart, SavedStart
from cluttergen_jax.downstream.episodes.tasks import Task, WorldExecution
from cluttergen_jax.downstream.episodes.world import SimulatedWorld, numbers_of
from cluttergen_jax.downstream.transforms import pose_of
from cluttergen_jax.downstream.words import RenderMode, RobotReward, check_choice
from cluttergen_jax.errors import ConfigError, range_text

RobotAction = Literal["joint", "joint_delta", "tool"]
TIME_LIMIT = "time limit"
"""The outcome of an episode that ends in nothing else."""
# m/s and rad/s of a tool action of length 1.
MAX_TOOL_SPEED = 0.5
MAX_TURN_SPEED = 2.0

_OBJECT_ROW = 11
_POSE = 7
# Of numbers that are told apart, and of shares of a step.
_ROUNDING = 1e-6
_REACHED = 1e-3
_AXES = ("x", "y", "z", "qw", "qx", "qy", "qz")
_HALF = ("half_x", "half_y", "half_z")
_TOOL_MOTION = ("move_x", "move_y", "move_z", "turn_x", "turn_y", "turn_z")
Info = dict[str, Any]


def _pose_names(what: str) -> list[str]:
    """The names of the seven numbers of a pose."""
    return [f"{what}_{axis}" for axis in _AXES]


def _joint_names(limits: np.ndarray) -> list[str]:
    return [f"joint{k + 1}" for k in range(len(limits))]


class RobotEnv(gymnasium.Env):
    """One robot in the scenes of a bank; made by `cg.robot.make_env`, which says what it does.

    Observations and actions are those of recordings too (docs/contract.md): f32, metres and radians, world
    frame, quaternions wxyz. `state_names`, `object_names` and `action_names` name each number.

    - `agent_pos` [2 n + 8]: the arm's n joints, their speeds, metres of a finger from the middle,
      T_world_tool.
    - `environment_state` [N * 11], of each object, the target first: T_world_object, half extents, and 1; 0
      where a scene has fewer. For `rearrange` [N * 18]: then T_world_object where it shall go.
    - `pixels`, with cameras: u8[height, width, 3] of each.

    Actions run from -1 to 1. The last number is the gripper's: from 0 to 1 how far it opens, below 0 how
    hard it presses.

    - `joint` [n + 1]: the arm's joints, each over its range.
    - `joint_delta` [n + 1]: changes of their set-points, as shares of what the robot's speed limits allow.
    - `tool` [7]: how the tool moves (0.5 m/s) and turns (2 rad/s, rotation vector), in world axes.

    Rewards are 1 at success, else 0; dense ones are more by the change of progress. `info` has `is_success`,
    `outcome` ("" before the end, then an `Outcome`, one of rearrangement's, or "time limit"), `detail`,
    `scene` and `target`; `progress`, 0 to 1, how far the episode has come; and of the episode so far,
    `num_outside`: numbers of actions beyond -1 to 1, which were taken as -1 or 1;
    `num_limited`: numbers that asked for more than the speed limits allow in a step, which were followed as
    far as these.

    Attributes:
      world: the model and its resets. task: what is to be done. start: how this episode began.
      execution: the simulation.
      recording: that `reset(options={"episode": k})` begins episodes of; None if it has none.
      is_drawing: whether pictures are observed; without them a step takes far less time.
    """

    metadata: Info = {"render_modes": ["rgb_array"]}  # noqa: RUF012  Gymnasium looks for it on the class.

    def __init__(
        self,
        world: SimulatedWorld,
        task: Task,
        action: RobotAction,
        cameras: tuple[str, ...],
        image_size: tuple[int, int],
        control_hz: float,
        max_seconds: float | None,
        recipe: partial[RobotEnv] | None = None,
        recording: Any = None,
        draws_scenes: bool = True,
        reward: RobotReward = "sparse",
        render_mode: RenderMode | None = "rgb_array",
    ) -> None:
        # Users of this package ask it for more than a `SimulatedWorld` has.
        self.world: Any = world
        self._is_dense = reward == "dense"
        self._progress = 0.0
        self.task_kind = task
        self.recipe = recipe
        self.recording = recording
        self.is_drawing = True
        # Where episodes are begun again others need not be there to be drawn.
        self._places = task.places(world.bank) if draws_scenes else None
        check_cameras(world.model, cameras, world.prefix)
        self._action = action
        self._cameras = cameras
        self.render_mode = render_mode
        self._substeps = max(1, round(1 / control_hz / world.model.opt.timestep))
        self._period = self._substeps * float(world.model.opt.timestep)
        self.metadata = {**self.metadata, "render_fps": round(1 / self._period)}
        self._num_slots = int((np.asarray(world.bank.object_index) >= 0).sum(1).max())
        seconds = max_seconds or task.seconds * (self._num_slots if task.has_goals else 1)
        self._max_episode_steps = max(1, round(seconds / self._period))
        self.task = task.name
        self.task_description = task.name
        arm = world.robot
        self._low = arm.low
        self._high = arm.high
        self._most = np.array(world.speed) * self._period
        self._share = GripShare(world.gripper, world.opened)
        self._pictures = Pictures(world.model, *image_size, world.prefix, world.new_context)
        is_tool = action == "tool"
        self._kinematics = world.kinematics() if is_tool else None
        number = 7 if is_tool else len(arm.qpos) + 1
        self.action_space = spaces.Box(-1.0, 1.0, (number,), np.float32)
        columns = _OBJECT_ROW + _POSE * task.has_goals
        infinite = partial(spaces.Box, -np.inf, np.inf, dtype=np.float32)
        parts: dict[str, spaces.Space] = {
            "agent_pos": infinite(shape=(2 * len(arm.qpos) + 1 + _POSE,)),
            "environment_state": infinite(shape=(self._num_slots * columns,)),
        }
        if cameras:
            image = spaces.Box(0, 255, (*image_size, 3), np.uint8)
            parts["pixels"] = spaces.Dict(dict.fromkeys(cameras, image))
        self.observation_space = spaces.Dict(parts)
        self.execution: WorldExecution | None = None
        self.start: EpisodeStart | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        if self.recipe is None:
            raise TypeError(
                "it holds a simulation, so the call that made it is pickled; it was made otherwise"
            )
        return self.recipe, ()

    @property
    def state_names(self) -> list[str]:
        """Of the numbers of `agent_pos`."""
        joints = self.action_names[:-1] if self._action != "tool" else _joint_names(self._low)
        return [
            *joints,
            *(f"{name}_speed" for name in joints),
            "finger_opening",
            *_pose_names("tool"),
        ]

    @property
    def action_names(self) -> list[str]:
        """Of the numbers of an action."""
        moved = _TOOL_MOTION if self._action == "tool" else _joint_names(self._low)
        return [*moved, "gripper"]

    @property
    def object_names(self) -> list[str]:
        """Of the numbers of `environment_state`."""
        goal = _pose_names("goal") if self.task_kind.has_goals else []
        each = [*_pose_names("pose"), *_HALF, "is_there", *goal]
        return [f"object{k + 1}_{name}" for k in range(self._num_slots) for name in each]

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Any, Info]:
        """A new episode.

        Args:
          options: `scene`, its number in the bank; or `episode`, that of a recording's episode, which begins
            again as it began (`make_env(recording=...)`).

        Raises:
          ConfigError: there is no such option, scene or episode, or the environment has no recording.
        """
        super().reset(seed=seed)
        scene, episode = self._read_options(options)
        if episode is not None:
            return self.begin(self._start_of_episode(episode))
        place = self._place_of(scene)
        index = int(self.world.bank.index[place])
        drawn = int(self.np_random.integers(2**31))
        state = self.world.reset(drawn, index=index)
        start = self.task_kind.begin(self.world.scene(state), self.world, place, self.np_random)
        return self._begin(state, start, index, drawn)

    def begin(self, start: SavedStart) -> tuple[Any, Info]:
        """Begins an episode that began before (`saved_start`), as `reset`.

        Raises:
          BankError: the scene that it began in is another one here.
        """
        state, found = start.of(self.world)
        return self._begin(state, found, start.scene, start.seed, start.words)

    @property
    def scenes(self) -> list[int]:
        """The numbers of the bank's scenes that the task can be done in, which `reset` draws from.

        Raises:
          ConfigError: there is none.
        """
        return np.asarray(self.world.bank.index)[self._known_places()].tolist()

    @property
    def saved_start(self) -> SavedStart:
        """How this episode began, as numbers and names."""
        if self.start is None:
            raise gymnasium.error.ResetNeeded(
                "reset() has to be called before an episode has a start"
            )
        scene = self.start.scene
        return SavedStart(
            self._info["scene"],
            self._seed,
            self._info["target"],
            scene.names,
            np.array(scene.poses, np.float64),
            np.array(self.start.goals, np.float64),
            self.task_description,
        )

    def _begin(
        self, state: Any, start: EpisodeStart, index: int, seed: int, words: str = ""
    ) -> tuple[Any, Info]:
        self.start = start
        scene = start.scene
        self._seed = seed
        self._num_outside = 0
        self._num_limited = 0
        self.execution = WorldExecution(self.world, state, self.start.scene, self.start.target)
        self._judge = self.task_kind.judge(self.start, self.execution)
        self._progress = self._judge.progress
        self._order = [
            self.start.target,
            *(k for k in range(len(scene.names)) if k != self.start.target),
        ]
        self._tool = self.execution.tool
        self._num_steps = 0
        objects = [self.start.scene.objects[k] for k in self._order]
        self._extents = np.array([asset.half_extents for asset in objects])
        self.task_description = words or self.task_kind.sentence([asset.label for asset in objects])
        self._info: Info = {"scene": index, "target": scene.names[self.start.target]}
        return self._observe(), self._info_at("", "")

    def _read_options(self, options: Info | None) -> tuple[Any, Any]:
        """The scene and the episode that a reset asks for, None for none (ConfigError: anything else)."""
        options = {} if options is None else options
        if not isinstance(options, Mapping):
            raise ConfigError(
                f"reset(options={options!r})", "a dict", 'reset(options={"scene": 0})'
            )
        # LeRobot tells every environment of a new rollout.
        names = sorted(str(each) for each in options)
        known = ("scene", "episode")
        if unknown := [
            each for each in names if each not in known and not each.startswith("lerobot_")
        ]:
            raise ConfigError(
                f"options {unknown} of reset", "scene or episode", 'reset(options={"scene": 0})'
            )
        scene, episode = (options.get(name) for name in known)
        if scene is not None and episode is not None:
            raise ConfigError("options scene and episode of reset", "one of them")
        return scene, episode

    def _start_of_episode(self, episode: Any) -> SavedStart:
        if self.recording is None:
            raise ConfigError(
                f"episode {episode!r} of an environment without a recording",
                "an environment of a recording",
                "make_env(recording=FOLDER)",
            )
        number = len(self.recording)
        if (
            isinstance(episode, bool)
            or not isinstance(episode, Integral)
            or not 0 <= int(episode) < number
        ):
            raise ConfigError(
                f"episode {episode!r} of {self.recording.path}", range_text(0, number - 1)
            )
        return self.recording.start(int(episode))

    def _known_places(self) -> np.ndarray:
        if self._places is None:
            self._places = self.task_kind.places(self.world.bank)
        return self._places

    def _place_of(self, number: Any) -> int:
        places = self._known_places()
        if number is None:
            return int(self.np_random.choice(places))
        known = np.asarray(self.world.bank.index)[places]
        if isinstance(number, bool) or not isinstance(number, Integral) or number not in known:
            raise ConfigError(
                f"scene {number!r} for {self.task}", f"one of {', '.join(map(str, known[:20]))}"
            )
        return int(places[np.flatnonzero(known == number)[0]])

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Info]:
        """One step of control. After the episode's last one, `reset` has to follow."""
        if self.execution is None:
            raise gymnasium.error.ResetNeeded(
                "reset() has to be called before the first step of an episode"
            )
        ctrl = self._ctrl_of(action)
        self._num_steps += 1
        outcome = ""
        detail = ""
        try:
            self.execution.advance(ctrl, self._substeps)
            outcome = str(Outcome.SUCCESS) if self._judge.check() else ""
        except Failed as failure:
            outcome = str(failure.outcome)
            detail = failure.detail
        before = self._progress
        is_success = outcome == Outcome.SUCCESS
        # What came of an episode is kept where it fails: to come near is worth something in any case.
        self._progress = 1.0 if is_success else self._finite_progress()
        reward = is_success + (self._progress - before if self._is_dense else 0.0)
        is_late = not outcome and self._num_steps >= self._max_episode_steps
        seen = self._observe()
        told = self._info_at(TIME_LIMIT if is_late else outcome, detail)
        if outcome or is_late:
            self.execution = None
        return seen, float(reward), bool(outcome), is_late, told

    def _finite_progress(self) -> float:
        """The progress of now; that of before where the simulation diverged."""
        found = self._judge.progress
        return found if np.isfinite(found) else self._progress

    def _info_at(self, outcome: str, detail: str) -> Info:
        is_success = outcome == Outcome.SUCCESS
        ending = {"is_success": is_success, "outcome": outcome, "detail": detail}
        counted = {
            "num_outside": self._num_outside,
            "num_limited": self._num_limited,
            "progress": self._progress,
        }
        return {**self._info, **ending, **counted}

    def _ctrl_of(self, action: Any) -> np.ndarray:
        """f64[nu]: the set-points that an action asks for, as far as speed limits let them come."""
        run = self.execution
        arm = self.world.robot
        assert run is not None
        values = numbers_of(action)
        if values.shape != self.action_space.shape or not np.isfinite(values).all():
            raise ConfigError(
                f"an action {action!r}"[:200],
                f"{self.action_space.shape[0]} finite numbers, -1 to 1",
            )
        self._num_outside += int((np.abs(values) > 1 + _ROUNDING).sum())
        values = np.clip(values, -1, 1)
        ctrl = run.data.ctrl.copy()
        now = ctrl[arm.ctrl]
        most = self._most
        if self._action == "joint":
            wanted = self._low + (values[:-1] + 1) / 2 * (self._high - self._low)
        elif self._action == "joint_delta":
            wanted = now + values[:-1] * most
        else:
            wanted = self._solve(values[:6], now)
        self._num_limited += int((np.abs(wanted - now) > most + _ROUNDING).sum())
        ctrl[arm.ctrl] = np.clip(now + np.clip(wanted - now, -most, most), self._low, self._high)
        if self._kinematics is not None:
            # Where speed limits let it come: the next action goes on from there.
            self._tool = self._kinematics.tool(ctrl[arm.ctrl])
        grip = self._share.control_of(float(values[-1]))
        step = self._share.speed * self._period
        self._num_limited += int(abs(grip - ctrl[arm.grip]) > step * (1 + _ROUNDING))
        ctrl[arm.grip] += np.clip(grip - ctrl[arm.grip], -step, step)
        return ctrl

    def _solve(self, values: np.ndarray, now: np.ndarray) -> np.ndarray:
        """Joints for the tool moved by f64[6]; where none are found the arm stays."""
        assert self._kinematics is not None
        shift, turn = np.split(values * self._period, 2)
        target = move_tool(self._tool, shift * MAX_TOOL_SPEED, turn * MAX_TURN_SPEED)
        joints = self._kinematics.solve(target, now)
        return now if joints is None else joints

    def action_of(self, ctrl: np.ndarray) -> np.ndarray:
        """f32[n + 1]: the action that brings the set-points to f64[nu] from where they are now.

        Raises:
          ConfigError: actions are the tool's, or none that lies in the box does it.
        """
        arm = self.world.robot
        return self.action_to(ctrl[arm.ctrl], float(ctrl[arm.grip]))

    def action_to(self, joints: np.ndarray, grip: float) -> np.ndarray:
        """As `action_of`, of set-points f64[n] of the arm and one of the gripper.

        Changes that speed limits do not allow are cut to these and counted in `info["num_limited"]`.
        """
        if self._action == "tool" or self.execution is None:
            raise ConfigError(
                "set-points as an action of the tool", "action='joint' or 'joint_delta'"
            )
        if self._action == "joint":
            share = 2 * (joints - self._low) / (self._high - self._low) - 1
        else:
            asked = (joints - self.execution.set_point) / self._most
            share = np.clip(asked, -1, 1)
            self._num_limited += int((np.abs(asked - share) > _REACHED).sum())
        action = np.array([*share, self._share.share_of(grip)])
        if (np.abs(action) > 1 + _REACHED).any():
            raise ConfigError(
                f"set-points that an action {action.round(3).tolist()} would bring about",
                "an action from -1 to 1",
                "action='joint', or smaller steps",
            )
        return np.clip(action, -1, 1).astype(np.float32)

    @property
    def substeps(self) -> int:
        """Steps of the simulation in one of control."""
        return self._substeps

    def render(self) -> np.ndarray | None:
        """u8[height, width, 3]: the camera `front`; the first of the environment's own if it has some.

        None with `render_mode=None`.
        """
        if self.render_mode is None:
            return None
        if self.start is None or not hasattr(self, "_data"):
            raise gymnasium.error.ResetNeeded("reset() has to be called before render()")
        return self._pictures.draw(self._data, self._cameras[0] if self._cameras else "front")

    @property
    def cameras(self) -> tuple[str, ...]:
        """Whose pictures are observed."""
        return self._cameras

    def draw(self, data: mujoco.MjData, name: str) -> np.ndarray:
        """u8[height, width, 3]: what the camera of this name sees. Raises RendererError: nothing can draw."""
        return self._pictures.draw(data, name)

    def close(self) -> None:
        """Frees what pictures are drawn with."""
        self._pictures.close()

    @property
    def simulation_state(self) -> np.ndarray:
        """f64[D]: the whole episode: how it began, how many steps it had, positions, speeds, set-points.

        Of what is judged it lacks what the hand touched before.
        """
        run = self.execution
        assert run is not None
        start = self.saved_start
        data = run.data
        rows = np.zeros((2, self._num_slots, _POSE))
        rows[:, : len(start.names)] = [start.poses, start.goals]
        first = (start.scene, start.seed, start.names.index(start.target), self._num_steps)
        moving = (data.qpos, data.qvel, data.ctrl, data.qacc_warmstart)
        return np.concatenate([first, rows.ravel(), *moving])

    def set_simulation_state(self, state: np.ndarray) -> tuple[Any, Info]:
        """Goes on from f64[D] of `simulation_state`; what a reset returns.

        Raises:
          ConfigError: it is of another environment.
        """
        model = self.world.model
        sizes = [4, 2 * self._num_slots * _POSE, model.nq, model.nv, model.nu, model.nv]
        values = numbers_of(state)
        if values.shape != (sum(sizes),) or not np.isfinite(values).all():
            raise ConfigError(
                f"a state of shape {values.shape}",
                f"{sum(sizes)} finite numbers, as of `simulation_state`",
            )
        first, rows, *moving = np.split(values, np.cumsum(sizes)[:-1])
        scene, seed, target, num_steps = (int(each) for each in first)
        names = self.world.scene(self.world.reset(0, index=scene)).names
        poses, goals = rows.reshape(2, self._num_slots, _POSE)[:, : len(names)]
        start = SavedStart(scene, seed, names[target], names, poses, goals, "")
        told = self.begin(start)
        self._num_steps = num_steps
        if not num_steps:
            return told
        assert self.execution is not None
        data = self.execution.data
        for name, each in zip(("qpos", "qvel", "ctrl", "qacc_warmstart"), moving, strict=True):
            getattr(data, name)[:] = each
        warmstart = data.qacc_warmstart.copy()
        mujoco.mj_forward(model, data)
        data.qacc_warmstart[:] = warmstart
        self._progress = self._judge.progress
        return self._observe(), {**told[1], "progress": self._progress}

    def _observe(self) -> dict[str, Any]:
        run = self.execution
        arm = self.world.robot
        assert run is not None
        assert self.start is not None
        self._data = run.data
        poses = run.poses()[self._order]
        speed = run.data.qvel[arm.dofs]
        hand = np.array([*run.joints, *speed, run.opening, *pose_of(run.tool)])
        columns = _OBJECT_ROW + _POSE * self.task_kind.has_goals
        rows = np.zeros((self._num_slots, columns))
        rows[: len(poses), :_OBJECT_ROW] = np.column_stack(
            [poses, self._extents, np.ones(len(poses))]
        )
        if self.task_kind.has_goals:
            rows[: len(poses), _OBJECT_ROW:] = self.start.goals[self._order]
        seen: dict[str, Any] = {
            "agent_pos": hand.astype(np.float32),
            "environment_state": rows.ravel().astype(np.float32),
        }
        if self._cameras and self.is_drawing:
            seen["pixels"] = {name: self.draw(run.data, name) for name in self._cameras}
        return seen


def move_tool(T_world_tool: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """f64[4, 4]: a pose moved by f[3] metres and turned by the rotation vector f[3], in world axes."""
    angle = float(np.linalg.norm(turn))
    axis = turn / angle if angle else np.array([1.0, 0.0, 0.0])
    quaternion = np.empty(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    pose = T_world_tool.copy()
    pose[:3, 3] += shift
    pose[:3, :3] = rotation.reshape(3, 3) @ pose[:3, :3]
    return pose


def check_settings(
    action: str,
    cameras: Sequence[str],
    image_size: Sequence[int],
    control_hz: float,
    max_seconds: float | None,
    reward: str,
    render_mode: str | None,
) -> None:
    """Refuses what no environment can have (ConfigError)."""
    check_choice("action", action, RobotAction)
    check_choice("reward", reward, RobotReward)
    if render_mode is not None and render_mode not in get_args(RenderMode):
        raise ConfigError(f"render_mode = {render_mode!r}", "rgb_array, or None")
    if not isinstance(cameras, (tuple, list)) or len(set(cameras)) < len(cameras):
        raise ConfigError(
            f"cameras = {cameras!r}", "a sequence of names, each once", 'cameras=("front",)'
        )
    is_size = isinstance(image_size, (tuple, list)) and len(image_size) == 2
    if not is_size or not all(isinstance(side, int) and 16 <= side <= 4096 for side in image_size):
        raise ConfigError(f"image_size = {image_size!r}", "height and width, 16 to 4096 pixels")
    if not isinstance(control_hz, Real) or not 1 <= control_hz <= 240:
        raise ConfigError(f"control_hz = {control_hz!r}", "1 to 240", "control_hz=20")
    if max_seconds is not None and not (
        isinstance(max_seconds, Real) and 0.1 <= max_seconds <= 3600
    ):
        raise ConfigError(f"max_seconds = {max_seconds!r}", "0.1 to 3600, or None")
