"""An episode of a recording as Rerun shows it: it is run again, and what moves is written at each step.

    world/support, world/objects/NAME    as in a scene's file, objects where they are
    world/robot/BODY                     bodies of the robot, and what it stands on
    cameras/NAME                         the pictures that its environment observes
    action/NAME, reward                  numbers, a curve each
    task, outcome                        in words

The timeline is `time`, seconds of simulation from the episode's start. This needs the extra `rerun`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cluttergen_jax.progress import Progress
from cluttergen_jax.scene import RerunFile

if TYPE_CHECKING:
    from cluttergen_jax.downstream.environments.env import RobotEnv
    from cluttergen_jax.downstream.environments.recordings import Recording


def write_episode(recording: Recording, env: RobotEnv, episode: int, out: Path) -> None:
    """Runs an episode again and writes it; if it ends otherwise than it did, stderr is told.

    Args:
      env: that of the recording, with the cameras whose pictures are written.

    Raises:
      ConfigError: there is no such episode. BankError: the recording is damaged.
      MissingExtraError: the extra `rerun` is not installed.
    """
    actions = recording.actions(episode)
    seen, _ = env.reset(options={"episode": episode})
    period = env.substeps * float(env.world.model.opt.timestep)
    outcome = ""
    name = f"{recording.path.resolve().name}-{episode}"
    with RerunFile(out, name) as file, Progress("running", len(actions), "step") as progress:
        shown = _Shown(env, file)
        file.set_time(0.0)
        shown.add_step(seen)
        for number, action in enumerate(actions):
            for word, value in zip(env.action_names, action.tolist(), strict=True):
                file.add_number(["action", word], value)
            seen, reward, is_over, is_late, told = env.step(action)
            file.set_time((number + 1) * period)
            shown.add_step(seen)
            file.add_number(["reward"], reward)
            progress.update(1)
            if is_over or is_late:
                outcome = str(told["outcome"])
                break
        file.add_words(["outcome"], outcome or "not over")
    if outcome != (known := recording.outcomes[episode]):
        told_then = repr(known or "nothing")
        note = f"episode {episode} ended with {outcome or 'nothing'!r} here, and with {told_then}"
        print(f"note: {note} where it was recorded", file=sys.stderr)


class _Shown:
    """An environment as it is written while its episode runs; it begins with what has no time."""

    def __init__(self, env: RobotEnv, file: RerunFile) -> None:
        assert env.execution is not None
        assert env.start is not None
        self._file = file
        # The environment lets go of it with the last step.
        self._run = env.execution
        self._scene = env.start.scene
        file.add_words(["task"], env.task_description)
        file.add_support(env.world.support)
        for name, asset in zip(self._scene.names, self._scene.objects, strict=True):
            file.add_object(name, asset)
        # The support and the objects are drawn as their assets are, with images.
        known = {"support", *env.world.names}
        model = env.world.model
        names = {body: str(model.body(body).name) for body in range(model.nbody)}
        self._bodies = {
            body: name or f"body-{body}"
            for body, name in names.items()
            if name not in known and file.add_body(name or f"body-{body}", model, body)
        }

    def add_step(self, seen: dict[str, Any]) -> None:
        """Where everything is now, and what cameras see."""
        data = self._run.data
        for body, name in self._bodies.items():
            pose = np.concatenate([data.xpos[body], data.xquat[body]])
            self._file.set_pose(self._file.body_place(name), pose)
        for name, pose in zip(self._scene.names, self._run.poses(), strict=True):
            self._file.set_pose(self._file.object_place(name), pose)
        for name, picture in seen.get("pixels", {}).items():
            self._file.add_picture(["cameras", name], picture)
