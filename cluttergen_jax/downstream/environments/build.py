"""Environments of a robot are built here, from settings or from what a recording says of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.downstream.environments.randomization import RandomizationConfig
from cluttergen_jax.downstream.environments.world import stands_of, with_robot
from cluttergen_jax.downstream.episodes.tasks import TASKS
from cluttergen_jax.downstream.robot.description import RobotLike
from cluttergen_jax.downstream.words import RenderMode, RobotPhysics, RobotReward
from cluttergen_jax.errors import ConfigError, MissingExtraError, closest
from cluttergen_jax.generation import BankArrays, load_bank

if TYPE_CHECKING:
    from cluttergen_jax.downstream.environments.recordings import Recording
    from cluttergen_jax.downstream.episodes.env import RobotAction, RobotEnv


def build_env(
    task: str,
    bank: BankArrays | str | Path,
    robot: RobotLike,
    *,
    action: RobotAction = "joint",
    cameras: Sequence[str] = (),
    image_size: tuple[int, int] = (240, 320),
    physics: RobotPhysics = "accurate",
    randomization: RandomizationConfig | None = None,
    control_hz: float = 20.0,
    max_seconds: float | None = None,
    recording: Recording | None = None,
    draws_scenes: bool = True,
    reward: RobotReward = "sparse",
    render_mode: RenderMode | None = "rgb_array",
) -> RobotEnv:
    """As `make_robot_env`; draws_scenes: whether there has to be a scene that a reset can draw."""
    try:
        from cluttergen_jax.downstream.episodes.env import RobotEnv, check_settings
    except ModuleNotFoundError as error:
        if error.name != "gymnasium":
            raise
        raise MissingExtraError("gym", "make_robot_env") from error
    if task not in TASKS:
        raise ConfigError(
            f"task = {task!r}", ", ".join(TASKS), "task='place'", closest(task, TASKS)
        )
    check_settings(action, cameras, image_size, control_hz, max_seconds, reward, render_mode)
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
        stands=stands_of(kind, found),
        randomization=randomization,
    )
    recipe = partial(
        build_env,
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
        recording=recording,
        draws_scenes=draws_scenes,
        reward=reward,
        render_mode=render_mode,
    )
    settings = (action, tuple(cameras), image_size, control_hz, max_seconds)
    return RobotEnv(world, kind, *settings, recipe, recording, draws_scenes, reward, render_mode)
