"""Demonstrations: episodes run in an environment step by step, and what was observed and done, recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from cluttergen_jax.downstream.environments.build import build_env
from cluttergen_jax.downstream.environments.recordings import SavedStart, environment_of
from cluttergen_jax.downstream.environments.scripted import WAIT
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.motion.execute import Trace
from cluttergen_jax.downstream.robot.recorder import FORMATS, DemonstrationRecorder, RecordFolder
from cluttergen_jax.downstream.robot.recording import EpisodeRecording
from cluttergen_jax.downstream.words import RecordFormat

if TYPE_CHECKING:
    from cluttergen_jax.downstream.episodes.env import RobotEnv


def capture(
    env: RobotEnv, number: int, seen: Mapping[str, Any], actions: Iterable[np.ndarray]
) -> EpisodeRecording | None:
    """Runs the episode that `env` has just begun, until it is over or no action is left.

    Args:
      number: of the episode. seen: what `reset` observed.

    Returns:
      What is recorded of it, None if there was no action. Its pictures are drawn as they are asked for,
      before the next reset.
    """
    start = env.saved_start
    steps = []
    rewards = []
    info: dict[str, Any] = {}
    for action in actions:
        assert env.execution is not None
        before = (seen["agent_pos"], seen["environment_state"], action, env.simulation_state)
        steps.append((*before, env.execution.data.qpos.copy()))
        seen, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        if terminated or truncated:
            break
    if not steps:
        return None
    state, objects, done, simulation, qpos = (np.array(each) for each in zip(*steps, strict=True))
    names = {"state": env.state_names, "objects": env.object_names, "action": env.action_names}
    return EpisodeRecording(
        number,
        env.task_description,
        info["outcome"],
        start.text(),
        env.world.description.name,
        names,
        state,
        objects,
        done,
        np.array(rewards, np.float32),
        simulation,
        {name: partial(_pictures, env, qpos, name) for name in env.cameras},
    )


def _pictures(env: RobotEnv, qpos: np.ndarray, name: str) -> Iterator[np.ndarray]:
    """u8[H, W, 3] of each configuration f64[T, nq]."""
    model = env.world.model
    data = mujoco.MjData(model)
    for each in qpos:
        data.qpos[:] = each
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        yield env.draw(data, name)


def open_folder(
    env: RobotEnv, folder: Path, form: RecordFormat, told: Mapping[str, Any]
) -> RecordFolder:
    """A folder for recordings of an environment, which draws no more while it is stepped.

    Raises:
      BankError: it holds something else, or recordings of other settings.
      MissingExtraError: the format or videos need an extra that is not installed.
    """
    env.is_drawing = False
    return FORMATS[form](folder, environment_of(env), {"format": form, **told})


@dataclass(frozen=True)
class TraceRecording:
    """Records what a planner did (`RecordAsked`): its set-points are actions, run in the environment.

    What is recorded, the outcome too, is what the environment shows: so it can be begun again there.

    Args: as `robot_place` is given them.
    """

    folder: Path
    form: RecordFormat
    cameras: tuple[str, ...]

    def open(
        self, task: str, bank: str, robot: RobotDescription, recipe: Mapping[str, Any]
    ) -> DemonstrationRecorder:
        """A recorder into the folder."""
        env = build_env(task, bank, robot, cameras=self.cameras, draws_scenes=False)
        folder = open_folder(env, self.folder, self.form, {"episodes": dict(recipe)})
        return DemonstrationRecorder(folder, partial(_play, env))


def _play(env: RobotEnv, number: int, trace: Trace) -> EpisodeRecording | None:
    """An episode of a planner, done again in the environment."""
    scene = trace.scene
    # Scenes of no bank are in one of starting scenes, by episode.
    is_of_bank = scene.origin is not None and scene.origin.bank
    index = scene.origin.index if is_of_bank else number
    found = env.world.scene(env.world.reset(0, index=index))
    goals = trace.goals
    if goals is None:
        goals = found.poses[[found.names.index(name) for name in scene.names]]
    poses = np.array(scene.poses, np.float64)
    seen, _ = env.begin(
        SavedStart(index, 0, scene.names[trace.target], scene.names, poses, goals, trace.words)
    )
    arm = trace.arm
    controls = [*trace.controls, *[trace.controls[-1]] * WAIT]
    action_to: Callable[..., np.ndarray] = env.action_to
    return capture(
        env, number, seen, (action_to(each[arm.ctrl], float(each[arm.grip])) for each in controls)
    )
