"""A robot in the scenes of a bank, as environments for trainers."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from importlib.util import find_spec
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast, get_args

from cluttergen_jax.config import check_range
from cluttergen_jax.downstream.rearrange import api as rearrange_api
from cluttergen_jax.downstream.robot import api as robot_api
from cluttergen_jax.downstream.words import (
    MjxImpl,
    MjxTask,
    RecordFormat,
    RenderMode,
    RobotCamera,
    RobotEnvTask,
    RobotPhysics,
    RobotReward,
    check_choice,
)
from cluttergen_jax.errors import ConfigError, MissingExtraError, closest
from cluttergen_jax.files import check_folder
from cluttergen_jax.numerics import with_own_settings

if TYPE_CHECKING:
    import numpy as np

    from cluttergen_jax.downstream.environments.evaluation import Bound, Policy, PolicyEvaluation
    from cluttergen_jax.downstream.environments.mjx_env import MjxRobotEnv
    from cluttergen_jax.downstream.environments.randomization import RandomizationConfig
    from cluttergen_jax.downstream.environments.recordings import Recording
    from cluttergen_jax.downstream.episodes.env import RobotAction, RobotEnv
    from cluttergen_jax.downstream.robot.description import RobotDescription, RobotLike
    from cluttergen_jax.generation import BankArrays

_MOST_ENVS = 1_000_000
Result = TypeVar("Result", bound=Callable[..., Any])
CAMERAS = ("front", "hand")
"""That are recorded and observed if nothing else is said."""
_BANK = "bank"
_MOST_EPISODES = 1_000_000
_MOST_SEED = 999_999


def make_robot_env(
    task: RobotEnvTask = "place",
    bank: BankArrays | str | Path = _BANK,
    robot: RobotLike = "panda",
    *,
    recording: Recording | str | Path | None = None,
    action: RobotAction = "joint",
    cameras: Sequence[str] = (),
    image_size: tuple[int, int] = (240, 320),
    physics: RobotPhysics = "accurate",
    randomization: RandomizationConfig | None = None,
    control_hz: float = 20.0,
    max_seconds: float | None = None,
    reward: RobotReward = "sparse",
    render_mode: RenderMode | None = "rgb_array",
) -> RobotEnv:
    """A `gymnasium.Env`: a robot in the scenes of a bank. Extras `gym` and `robot`.

    `gymnasium.make("cluttergen/Place-v1", bank=..., robot=...)` makes it, too, and `gymnasium.make_vec` many;
    the ids are cluttergen/Place-v1, cluttergen/Grasp-v1 and cluttergen/Rearrange-v1. Those that run in
    processes of their own need `vector_kwargs={"context": "spawn"}`: JAX hangs in forked ones.

    Every reset draws a scene of the bank; equal seeds give equal episodes. Actions are set-points, reached
    evenly within a step of control. The judge is that of `robot place` and `rearrange`, and its rules hold:
    an episode fails when the arm, or the hand on anything but the object that it moves, presses harder than
    2 N; it is judged once the object was let go and the hand has left it (`grasp`: once it is 10 cm up).

    Args:
      task: "place", bring an object from a stand beside the table into the region, among the others; "grasp",
        lift the scene's last object out of them; "rearrange", bring all objects to where another scene of the
        bank has them.
      bank: a folder, OWNER/NAME on a hub, or what `load_bank` gives.
      robot: a name, the path of a YAML file, or a `RobotDescription`. Its n joints and one gripper make
        actions of n + 1 numbers.
      recording: the environment that a recording was made in: its folder, robomimic's file, or what
        `read_recording` gives. `reset(options={"episode": k})` begins its episode k again. What else is given
        may be `bank`, where that has moved, `cameras`, `image_size`, `reward` and `render_mode`.
      action: "joint" (set-points), "joint_delta" (their changes) or "tool" (changes of the tool's pose).
      cameras: whose pictures are observed: overhead, front, side and wrist, which stand still, and hand.
      image_size: height and width, pixels.
      physics: "accurate" or "learning" (`with_robot`).
      randomization: what differs between episodes.
      control_hz: steps of control in a second.
      max_seconds: of an episode; 40 for "place", 15 for "grasp", 25 for each object for "rearrange".
      reward: "sparse", 1 at success; or "dense", more by the change of `info["progress"]` (`make_mjx_env`; of
        "rearrange" by how near objects are to their goals).
      render_mode: "rgb_array", what `render` gives, or None.

    Raises:
      ConfigError: a setting is out of range, or no scene of the bank suits the task.
      BankError: the bank cannot be read, or no scene in it is stable; or the recording is of another
        version, or its bank or robot is gone or has changed.
      MissingExtraError: an extra is not installed.
    """
    from cluttergen_jax.downstream.environments.build import build_env

    given: dict[str, Any] = {
        "action": action,
        "cameras": cameras,
        "image_size": image_size,
        "physics": physics,
        "randomization": randomization,
        "control_hz": control_hz,
        "max_seconds": max_seconds,
        "reward": reward,
        "render_mode": render_mode,
    }
    if recording is None:
        return build_env(task, bank, robot, **given)
    return _env_of(recording, {"task": task, "bank": bank, "robot": robot, **given})


def _env_of(recording: Recording | str | Path, given: dict[str, Any]) -> RobotEnv:
    """The environment of a recording. given: the other arguments of `make_robot_env`."""
    from cluttergen_jax.downstream.environments.build import build_env
    from cluttergen_jax.downstream.environments.recordings import Recording, read_recording

    usual = {
        name: each.default for name, each in inspect.signature(make_robot_env).parameters.items()
    }
    changed = {name: value for name, value in given.items() if value is not usual[name]}
    changed = {name: value for name, value in changed.items() if value != usual[name]}
    free = ("bank", "cameras", "image_size", "reward", "render_mode")
    if fixed := [name for name in changed if name not in free]:
        raise ConfigError(
            f"{', '.join(fixed)} together with `recording`, which has its own",
            ", ".join(free),
            "make_env(recording=...)",
        )
    found = recording if isinstance(recording, Recording) else read_recording(recording)
    bank = changed.pop("bank", None)
    settings = {**found.settings, **changed}
    env = build_env(
        bank=found.bank if bank is None else bank,
        recording=found,
        draws_scenes=False,
        **settings,
    )
    found.check(env)
    return env


@with_own_settings
def make_mjx_env(
    bank: BankArrays | str | Path = "bank",
    robot: RobotLike = "panda",
    task: MjxTask = "grasp",
    *,
    impl: MjxImpl = "auto",
    num_envs: int = 1024,
    reward: RobotReward = "dense",
    randomization: RandomizationConfig | None = None,
    control_hz: float = 20.0,
    max_seconds: float | None = None,
) -> MjxRobotEnv:
    """A robot in the scenes of a bank as JAX functions on MJX, for training on a GPU. Extra `robot`.

        env = cg.make_mjx_env("bank", "panda", "grasp")
        state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 1024))
        state = jax.jit(jax.vmap(env.step))(state, actions)     # f32[1024, env.action_size]

    `reset(key)` and `step(state, action)` are of one world and may be compiled, mapped and scanned. Each
    reset draws a scene of the bank, so worlds hold different objects; those that a scene lacks wait far away.
    Brax's trainers take it (`cg.envs.train_brax`), and MuJoCo Playground's with their `wrap_env_fn`; with
    `full_reset=True` that draws another scene for each episode, else each world begins its first one again.

    Physics, actions, observations and judge are those of `make_robot_env(..., physics="learning",
    action="joint_delta")`; one vector is observed, `agent_pos`, then `environment_state`. The hand may press
    on nothing but the target by more than 2 N, the others stay within 2 mm and 2 degrees, and an object that
    was let go is watched for two seconds, in which actions move nothing.

    `done` is 1 where an episode ended in success or failure. The time limit is left to wrappers:
    `env.episode_length` steps; `info["is_late"]` says that only a success in time would have counted.
    `env.ending_text(state)` has the reasons in words.

    A dense reward is the change of `metrics["progress"]`, and 1 more at success. Progress, 0 to 1, grows as
    the tool comes near, the hand touches, and the object is lifted ("grasp") or nears the region, lies there
    let go, and is watched ("place"); it shrinks as other objects move.

    Args:
      bank: a folder, OWNER/NAME on a hub, or what `load_bank` gives.
      robot: a name, the path of a YAML file, or a `RobotDescription`.
      task: "grasp", lift the scene's last object; "place", bring it from a stand beside the table into the
        region.
      impl: "warp", for NVIDIA GPUs (extra `gpu`; it runs on a CPU, too); "jax", for scenes of a few simple
        objects, to compare with, whose contacts are softer by some micrometres; "auto", the first on a GPU,
        else the second.
      num_envs: worlds side by side at most; Warp keeps room for so many worlds' contacts.
      reward: "dense", or "sparse", 1 at success.
      randomization: what differs between episodes; masses and friction alone, as nothing is drawn.
      control_hz: steps of control in a second.
      max_seconds: of an episode; 40 for "place", and two more to watch, 15 for "grasp".

    Raises:
      ConfigError: a setting is out of range, no scene of the bank suits the task, or the robot reaches none.
      BankError: the bank cannot be read, or no scene in it is stable.
      MissingExtraError: an extra is not installed.
    """
    from cluttergen_jax.downstream.environments.world import check_reach, stands_of, with_robot
    from cluttergen_jax.downstream.episodes.tasks import TASKS
    from cluttergen_jax.generation import BankArrays, load_bank

    if task not in get_args(MjxTask):
        raise ConfigError(
            f"task = {task!r} in JAX",
            ", ".join(get_args(MjxTask)),
            "cg.robot.make_env('rearrange', bank)" if task == "rearrange" else "task='grasp'",
            closest(task, get_args(MjxTask)),
        )
    check_choice("impl", impl, MjxImpl)
    check_choice("reward", reward, RobotReward)
    check_range("num_envs", num_envs, 1, _MOST_ENVS, 1024)
    _check_number("control_hz", control_hz, 1, 240)
    _check_number("max_seconds", max_seconds, 0.1, 3600)
    if not isinstance(bank, (BankArrays, str, Path)):
        raise ConfigError(
            f"a bank of type {type(bank).__name__}", "a folder, or that of cg.load_bank"
        )
    chosen = _impl_of(impl)
    found = bank if isinstance(bank, BankArrays) else load_bank(bank)
    kind = TASKS[task]
    world = with_robot(
        found,
        robot,
        physics="learning",
        stands=stands_of(kind, found),
        randomization=randomization,
    )
    places = kind.places(found)
    check_reach(world, places)
    from cluttergen_jax.downstream.environments.mjx_env import MjxRobotEnv

    return MjxRobotEnv(
        world,
        task,
        places,
        chosen,
        num_envs,
        reward,
        control_hz,
        max_seconds or kind.seconds,
    )


def _impl_of(impl: MjxImpl) -> str:
    """What "auto" stands for on this machine.

    Raises:
      MissingExtraError: Warp is wanted and not installed.
    """
    import jax

    is_gpu = jax.default_backend() == "gpu"
    chosen = ("warp" if is_gpu else "jax") if impl == "auto" else str(impl)
    if chosen == "warp" and find_spec("warp") is None:
        raise MissingExtraError("gpu", "make_mjx_env(impl='warp')")
    return chosen


def _check_number(name: str, value: Any, least: float, most: float) -> None:
    """Refuses what is no number from `least` to `most`; None is let through (ConfigError)."""
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if value is not None and not (is_number and least <= value <= most):
        raise ConfigError(f"{name} = {value!r}", f"{least:g} to {most:g}")


def scripted_actions(env: RobotEnv, seed: int = 0) -> Iterator[np.ndarray]:
    """The actions of a planner that knows the state, for the episode that `env` has just begun.

        env.reset(seed=0)
        for action in cg.robot.scripted_actions(env):
            observation, reward, terminated, truncated, info = env.step(action)

    It plans and runs the motion of `robot place`, or of `rearrange`, in a copy of the simulation, and then
    yields what that did, step by step. The first call tests grasps of the object, which takes some seconds
    and is kept.

    Args:
      env: whose actions are of joints, just reset.
      seed: of the planner.

    Raises:
      ConfigError: with actions of the tool, or before a reset.
    """
    from cluttergen_jax.downstream.environments.scripted import plan_actions

    return plan_actions(env, seed)


def evaluate_policy(
    env: RobotEnv,
    policy: Policy | Bound,
    *,
    scenes: Sequence[int] | None = None,
    seed: int = 0,
) -> PolicyEvaluation:
    """Runs a policy once in each scene; successes by neighbours, gap and hidden share of the target.

        print(cg.robot.evaluate_policy(env, lambda seen: np.zeros(8)))

    Args:
      env: from `make_env`; of a bank that was not trained on. Equal seeds give equal starts.
      policy: a function from what is observed to an action (`RobotEnv`); if it has a method `reset`, that is
        called before each episode. Or "scripted" (`scripted_actions`), or "random".
      scenes: their numbers in the bank; all that the task can be done in if not given.
      seed: of what the episodes draw.

    Returns:
      The episodes; printed, shares of success with their 95 % intervals.

    Raises:
      ConfigError: the policy is none, its actions are none, or there is no such scene.
    """
    from cluttergen_jax.downstream.environments.evaluation import evaluate

    return evaluate(env, policy, scenes, seed)


@with_own_settings
def robot_record(
    bank: str | Path,
    out: str | Path = "demos",
    *,
    task: RobotEnvTask = "place",
    robot: str | Path | RobotDescription = "panda",
    num_episodes: int = 50,
    action: Literal["joint", "joint_delta"] = "joint",
    cameras: Sequence[str] = CAMERAS,
    image_size: tuple[int, int] = (240, 320),
    physics: RobotPhysics = "accurate",
    record_format: RecordFormat = "lerobot",
    seed: int = 0,
) -> Recording:
    """Records demonstrations: a planner that knows the state, in `make_env` (`cluttergen robot record`).

    Every step holds what the environment observes and the action from -1 to 1 that it is given
    (docs/contract.md). Failures are kept and marked. The same call continues an interrupted one.

    Args:
      bank: the bank's folder, or OWNER/NAME on a hub; each episode draws a scene of it.
      out: the folder.
      task: place an object from a stand, grasp one, or rearrange all, as of `make_env`.
      robot: which: a name of `cluttergen list`, or the YAML file of one of your own.
      num_episodes: number of episodes.
      action: joint (set-points), or joint_delta (their changes).
      cameras: whose pictures are kept: overhead, front, side and wrist, which stand still, and hand; none if
        empty.
      image_size: height and width, pixels.
      physics: accurate or learning (`with_robot`).
      record_format: "lerobot", a LeRobot dataset of version 3.0 (with cameras extra `video`); or "robomimic",
        HDF5 (extra `record`).
      seed: of scenes and motions.

    Returns:
      The recording; printed, it tells what there is. `make_env(recording=...)` makes its environment.

    Raises:
      ConfigError: a setting is out of range, no scene suits the task, or the robot is none.
      BankError: the bank cannot be read, or the folder holds something else or recordings of other settings.
      MissingExtraError: an extra is not installed.
      RendererError: pictures are asked for, and nothing here can draw.
    """
    from cluttergen_jax.downstream.environments.demonstrations import capture, open_folder
    from cluttergen_jax.downstream.environments.recordings import read_recording
    from cluttergen_jax.downstream.robot import episode_seed
    from cluttergen_jax.kept_folder import hold_folder
    from cluttergen_jax.progress import Progress

    check_folder(out)
    check_range("num_episodes", num_episodes, 1, _MOST_EPISODES, 50)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    check_choice("action", action, Literal["joint", "joint_delta"])
    check_choice("record_format", record_format, RecordFormat)
    with hold_folder(Path(out)):
        env = make_robot_env(
            task,
            bank,
            robot,
            action=action,
            cameras=cameras,
            image_size=image_size,
            physics=physics,
        )
        _check_drawing(cameras)
        folder = open_folder(env, Path(out), record_format, {"seed": seed})
        try:
            known = folder.numbers()
            good = 0
            with Progress("recording", num_episodes, "episode", kept=len(known)) as progress:
                for number in range(num_episodes):
                    if number in known:
                        continue
                    drawn = episode_seed(seed, number)
                    seen, _ = env.reset(seed=drawn)
                    episode = capture(env, number, seen, scripted_actions(env, drawn))
                    assert episode is not None
                    folder.add(episode)
                    good += episode.is_success
                    progress.update(note=f"{good} good, the last: {episode.outcome or 'not over'}")
        finally:
            folder.finish()
            env.close()
    return read_recording(out)


@with_own_settings
def write_rerun(
    recording: Recording | str | Path,
    episode: int,
    out: str | Path,
    *,
    bank: str | Path | None = None,
    cameras: Sequence[str] | None = None,
) -> Path:
    """Writes an episode of a recording as a file for Rerun's viewer (.rrd). Extras `rerun`, `gym`, `robot`.

    The episode is run again: robot and objects move along the timeline `time`, with pictures, actions and
    rewards. If it ends otherwise than it did when it was recorded, stderr says so.

        cg.robot.write_rerun("demos", 3, "demo.rrd")    # then: rerun demo.rrd

    Args:
      recording: its folder, robomimic's file, or what `read_recording` gives.
      episode: its number, from 0.
      out: the file, whose name ends in .rrd; one that is there is replaced.
      bank: where the bank is now, if it has moved.
      cameras: whose pictures are written; those of the recording if not given, none if empty.

    Returns:
      The file.

    Raises:
      ConfigError: there is no such episode or camera, or `out` is no .rrd file.
      BankError: the recording is damaged, or its bank is gone or another one.
      MissingExtraError: an extra is not installed.
      RendererError: there are cameras, and nothing here can draw.
    """
    from cluttergen_jax.downstream.environments.recordings import Recording, read_recording
    from cluttergen_jax.downstream.environments.rerun import write_episode
    from cluttergen_jax.files import check_file
    from cluttergen_jax.kept_folder import hold_file
    from cluttergen_jax.scene import RerunFile

    RerunFile.require()
    place = Path(out)
    if place.suffix != ".rrd":
        raise ConfigError(f"out = {str(out)!r}", "a file whose name ends in .rrd", "out='demo.rrd'")
    check_file(place, "out", "demo.rrd")
    found = recording if isinstance(recording, Recording) else read_recording(recording)
    found.actions(episode)
    with hold_file(place):
        given = {"bank": bank, "cameras": cameras}
        env = make_robot_env(
            recording=found,
            **{name: value for name, value in given.items() if value is not None},  # type: ignore[arg-type]
        )
        # The recording's own cameras are there whatever is asked for.
        env.is_drawing = cameras is None or bool(cameras)
        try:
            write_episode(found, env, episode, place)
        finally:
            env.close()
    return place


def _check_drawing(cameras: Sequence[str]) -> None:
    """Refuses pictures where nothing can draw (RendererError)."""
    from cluttergen_jax.rendering import find_backend

    if cameras:
        find_backend()


def _with_recorder(function: Result) -> Result:
    """The function with a folder as its argument `record`, in place of a recorder.

    Planners know no environments, so a recorder is handed to them.
    """
    signature = inspect.signature(function)

    @wraps(function)
    def run(*args: Any, **given: Any) -> Any:
        bound = signature.bind(*args, **given)
        bound.apply_defaults()
        asked = bound.arguments
        asked["record"] = _recorder(
            asked["record"], asked["record_format"], asked["record_cameras"]
        )
        return function(*bound.args, **bound.kwargs)

    return cast(Result, run)


def _recorder(folder: Any, form: RecordFormat, cameras: Sequence[str | Path]) -> Any:
    """What records into a folder, None where there is none (ConfigError: no such format or camera)."""
    check_choice("record_format", form, RecordFormat)
    known = get_args(RobotCamera)
    if isinstance(cameras, str | Path):
        raise ConfigError(
            f"record_cameras = {cameras!r}", "a sequence of names", f"({str(cameras)!r},)"
        )
    names = tuple(map(str, cameras))
    if unknown := [name for name in names if name not in known]:
        raise ConfigError(
            f"record_cameras {', '.join(unknown)}",
            f"cameras of the environment: {', '.join(known)}",
            "front for third, hand for wrist",
            closest(unknown[0], known),
        )
    if len(set(names)) < len(names):
        raise ConfigError(f"record_cameras = {list(names)}", "each name once")
    if folder is None:
        return None
    from cluttergen_jax.downstream.environments.demonstrations import TraceRecording

    check_folder(folder, "record")
    _check_drawing(names)
    return TraceRecording(Path(folder), form, names)


robot_place = _with_recorder(robot_api.robot_place)
rearrange = _with_recorder(rearrange_api.rearrange)
