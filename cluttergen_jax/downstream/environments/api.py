"""A robot in the scenes of a bank, as environments for trainers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from cluttergen_jax.config import check_range
from cluttergen_jax.errors import ConfigError, MissingExtraError, closest
from cluttergen_jax.numerics import with_own_settings

if TYPE_CHECKING:
    import numpy as np

    from cluttergen_jax.downstream.environments.env import RobotAction, RobotEnv
    from cluttergen_jax.downstream.environments.mjx_env import MjxRobotEnv
    from cluttergen_jax.downstream.environments.randomization import RandomizationConfig
    from cluttergen_jax.downstream.environments.world import RobotPhysics
    from cluttergen_jax.downstream.robot.description import RobotLike
    from cluttergen_jax.generation import BankArrays

RobotEnvTask = Literal["place", "rearrange", "grasp"]
MjxTask = Literal["grasp", "place"]
MjxImpl = Literal["auto", "warp", "jax"]
MjxReward = Literal["dense", "sparse"]
_MOST_ENVS = 1_000_000


def make_robot_env(
    task: RobotEnvTask = "place",
    bank: BankArrays | str | Path = "bank",
    robot: RobotLike = "panda",
    *,
    action: RobotAction = "joint",
    cameras: Sequence[str] = (),
    image_size: tuple[int, int] = (240, 320),
    physics: RobotPhysics = "accurate",
    randomization: RandomizationConfig | None = None,
    control_hz: float = 20.0,
    max_seconds: float | None = None,
) -> RobotEnv:
    """A `gymnasium.Env`: a robot in the scenes of a bank. Extras `gym` and `robot`.

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
      action: "joint" (set-points), "joint_delta" (their changes) or "tool" (changes of the tool's pose).
      cameras: whose pictures are observed: overhead, front, side and wrist, which stand still, and hand.
      image_size: height and width, pixels.
      physics: "accurate" or "learning" (`with_robot`).
      randomization: what differs between episodes.
      control_hz: steps of control in a second.
      max_seconds: of an episode; 40 for "place", 15 for "grasp", 25 for each object for "rearrange".

    Raises:
      ConfigError: a setting is out of range, or no scene of the bank suits the task.
      BankError: the bank cannot be read, or no scene in it is stable.
      MissingExtraError: an extra is not installed.
    """
    from cluttergen_jax.downstream.environments.tasks import TASKS
    from cluttergen_jax.downstream.environments.world import support_of, with_robot
    from cluttergen_jax.generation import BankArrays, load_bank

    try:
        from cluttergen_jax.downstream.environments.env import RobotEnv, check_settings
    except ModuleNotFoundError as error:
        if error.name != "gymnasium":
            raise
        raise MissingExtraError("gym", "make_robot_env") from error
    if task not in TASKS:
        raise ConfigError(
            f"task = {task!r}", ", ".join(TASKS), "task='place'", closest(task, TASKS)
        )
    check_settings(action, cameras, image_size, control_hz, max_seconds)
    if not isinstance(bank, (BankArrays, str, Path)):
        raise ConfigError(
            f"a bank of type {type(bank).__name__}", "a folder, or that of cg.load_bank"
        )
    kind = TASKS[task]
    found = bank if isinstance(bank, BankArrays) else load_bank(bank)
    world = with_robot(
        found,
        robot,
        physics=physics,
        stands=kind.stands(support_of(found)),
        randomization=randomization,
    )
    recipe = partial(
        make_robot_env,
        task,
        bank,
        robot,
        action=action,
        cameras=tuple(cameras),
        image_size=image_size,
        physics=physics,
        randomization=randomization,
        control_hz=control_hz,
        max_seconds=max_seconds,
    )
    return RobotEnv(
        world, kind, action, tuple(cameras), image_size, control_hz, max_seconds, recipe
    )


@with_own_settings
def make_mjx_env(
    bank: BankArrays | str | Path = "bank",
    robot: RobotLike = "panda",
    task: MjxTask = "grasp",
    *,
    impl: MjxImpl = "auto",
    num_envs: int = 1024,
    reward: MjxReward = "dense",
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
    let go, and is watched ("place"); it shrinks as other objects move, and is 0 after a failure.

    Args:
      bank: a folder, OWNER/NAME on a hub, or what `load_bank` gives.
      robot: a name, the path of a YAML file, or a `RobotDescription`.
      task: "grasp", lift the scene's last object; "place", bring it from a stand beside the table into the
        region.
      impl: "warp", for NVIDIA GPUs (extra `gpu`; it runs on a CPU, too); "jax", for scenes of a few simple
        objects, to compare with; "auto", the first on a GPU, else the second.
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
    from cluttergen_jax.downstream.environments.tasks import TASKS
    from cluttergen_jax.downstream.environments.world import check_reach, support_of, with_robot
    from cluttergen_jax.downstream.words import check_choice
    from cluttergen_jax.generation import BankArrays, load_bank

    if task not in get_args(MjxTask):
        raise ConfigError(
            f"task = {task!r} in JAX",
            ", ".join(get_args(MjxTask)),
            "cg.robot.make_env('rearrange', bank)" if task == "rearrange" else "task='grasp'",
            closest(task, get_args(MjxTask)),
        )
    check_choice("impl", impl, MjxImpl)
    check_choice("reward", reward, MjxReward)
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
        stands=kind.stands(support_of(found)),
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


def _check_number(name: str, value: object, least: float, most: float) -> None:
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
