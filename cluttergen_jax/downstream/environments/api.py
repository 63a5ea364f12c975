"""A robot in the scenes of a bank, as environments for trainers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cluttergen_jax.errors import ConfigError, MissingExtraError, closest

if TYPE_CHECKING:
    import numpy as np

    from cluttergen_jax.downstream.environments.env import RobotAction, RobotEnv
    from cluttergen_jax.downstream.environments.randomization import RandomizationConfig
    from cluttergen_jax.downstream.environments.world import RobotPhysics
    from cluttergen_jax.downstream.robot.description import RobotLike
    from cluttergen_jax.generation import BankArrays

RobotEnvTask = Literal["place", "rearrange", "grasp"]


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
