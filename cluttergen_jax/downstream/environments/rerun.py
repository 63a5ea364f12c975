"""An episode of a recording as Rerun shows it: it is run again, and what moves is written at each step.

    world/support, world/objects/NAME    as in a scene's file (`scene.export.rerun`), objects where they are
    world/robot/BODY                     bodies of the robot, and what it stands on
    cameras/NAME                         the pictures that its environment observes
    action/NAME, reward                  numbers, a curve each
    task, outcome                        in words

The timeline is `time`, seconds of simulation from the episode's start. This needs the extra `rerun`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.importing.readers import primitives
from cluttergen_jax.progress import track
from cluttergen_jax.scene.export.rerun import WORLD, RerunFile

if TYPE_CHECKING:
    from cluttergen_jax.downstream.environments.env import RobotEnv
    from cluttergen_jax.downstream.environments.recordings import Recording

_TIMELINE = "time"
_DRAWN_GROUPS = 3
"""MuJoCo's viewer draws geoms of the groups below this one."""
_SHAPES = mujoco.mjtGeom


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
    run = env.execution
    assert run is not None
    outcome = ""
    with RerunFile(out, f"{recording.path.resolve().name}-{episode}") as file:
        shown = _Shown(env, file)
        shown.add_still()
        shown.add_step(0.0, seen)
        for number, action in enumerate(track(actions, "running", len(actions), "step"), 1):
            shown.add_action(action_time(env, number - 1), action)
            seen, reward, is_over, is_late, told = env.step(action)
            shown.add_step(action_time(env, number), seen, reward)
            if is_over or is_late:
                outcome = str(told["outcome"])
                break
        shown.add_outcome(outcome)
    known = recording.outcomes[episode]
    if outcome != known:
        print(
            f"note: episode {episode} ended with {outcome or 'nothing'!r} here, and with "
            f"{known or 'nothing'!r} where it was recorded",
            file=sys.stderr,
        )


def action_time(env: RobotEnv, number: int) -> float:
    """Seconds of simulation after so many steps of control."""
    return number * env.substeps * float(env.world.model.opt.timestep)


class _Shown:
    """An environment as it is written while its episode runs."""

    def __init__(self, env: RobotEnv, file: RerunFile) -> None:
        assert env.execution is not None
        assert env.start is not None
        self._env = env
        self._file = file
        self._run = env.execution
        self._scene = env.start.scene
        self._model = env.world.model
        # The support and the objects are drawn as their assets are, with images.
        known = {"support", *env.world.names}
        bodies = {int(self._model.geom_bodyid[geom]) for geom in self._drawn_geoms()}
        self._bodies = [each for each in sorted(bodies) if self._name(each) not in known]

    def add_still(self) -> None:
        """What has no time: shapes, and the task."""
        rr = self._file.rr
        support = self._env.world.support
        drawn = support.pieces or support.collision_pieces
        self._file.add_pieces([WORLD, "support"], drawn)
        for name, asset in zip(self._scene.names, self._scene.objects, strict=True):
            self._file.add_pieces([WORLD, "objects", name], asset.drawn_pieces)
        for geom in self._drawn_geoms():
            body = int(self._model.geom_bodyid[geom])
            if body in self._bodies and (mesh := _mesh_of(self._model, geom)) is not None:
                place = [*self._place(body), f"geom-{geom}"]
                pose = np.concatenate([self._model.geom_pos[geom], self._model.geom_quat[geom]])
                self._file.add_pose(place, pose)
                self._file.add_pieces(place, [Piece(mesh, _rgba_of(self._model, geom))])
        task = rr.TextDocument(self._env.task_description)
        self._file.stream.log("task", task, static=True)

    def add_step(self, seconds: float, seen: dict[str, Any], reward: float | None = None) -> None:
        """Where everything is, what cameras see, and the reward of the step that ended now."""
        rr = self._file.rr
        stream = self._file.stream
        stream.set_time(_TIMELINE, duration=seconds)
        data = self._run.data
        for body in self._bodies:
            pose = np.concatenate([data.xpos[body], data.xquat[body]])
            self._file.add_pose(self._place(body), pose, is_static=False)
        for name, pose in zip(self._scene.names, self._run.poses(), strict=True):
            self._file.add_pose([WORLD, "objects", name], pose, is_static=False)
        for name, picture in seen.get("pixels", {}).items():
            stream.log(["cameras", name], rr.Image(picture))
        if reward is not None:
            stream.log("reward", rr.Scalars(reward))

    def add_action(self, seconds: float, action: np.ndarray) -> None:
        """What is done from now on."""
        stream = self._file.stream
        stream.set_time(_TIMELINE, duration=seconds)
        for name, value in zip(self._env.action_names, action.tolist(), strict=True):
            stream.log(["action", name], self._file.rr.Scalars(value))

    def add_outcome(self, outcome: str) -> None:
        """How it ended."""
        self._file.stream.log("outcome", self._file.rr.TextLog(outcome or "not over"))

    def _drawn_geoms(self) -> Iterator[int]:
        for geom in range(self._model.ngeom):
            is_shown = self._model.geom_group[geom] < _DRAWN_GROUPS
            if is_shown and _rgba_of(self._model, geom)[3] > 0:
                yield geom

    def _name(self, body: int) -> str:
        return str(self._model.body(body).name)

    def _place(self, body: int) -> list[str]:
        return [WORLD, "robot", self._name(body) or f"body-{body}"]


def _rgba_of(model: mujoco.MjModel, geom: int) -> tuple[float, float, float, float]:
    material = model.geom_matid[geom]
    r, g, b, a = (model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]).tolist()
    return r, g, b, a


def _mesh_of(model: mujoco.MjModel, geom: int) -> Mesh | None:
    """A geom's surface in its own frame; None of one without end, such as a floor."""
    kind = model.geom_type[geom]
    size = model.geom_size[geom]
    if kind == _SHAPES.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        first = int(mesh.vertadr[0])
        start = int(mesh.faceadr[0])
        vertices = model.mesh_vert[first : first + int(mesh.vertnum[0])]
        faces = model.mesh_face[start : start + int(mesh.facenum[0])]
        return Mesh(vertices, faces)
    if kind == _SHAPES.mjGEOM_BOX:
        return primitives.box(size)
    if kind == _SHAPES.mjGEOM_SPHERE:
        return primitives.ellipsoid(size[[0, 0, 0]])
    if kind == _SHAPES.mjGEOM_ELLIPSOID:
        return primitives.ellipsoid(size)
    if kind == _SHAPES.mjGEOM_CYLINDER:
        return primitives.cylinder(size[0], size[1])
    if kind == _SHAPES.mjGEOM_CAPSULE:
        return primitives.capsule(size[0], size[1])
    return None
