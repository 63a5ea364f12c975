"""A scene as a MuJoCo specification, alone or inside a user's own model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import add_object, add_support, new_spec
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene.scene import Scene

KEYFRAME = "scene"
_OPTIONS = ("timestep", "gravity", "cone", "impratio", "iterations", "noslip_iterations")


@dataclass(frozen=True, eq=False)
class Attachment:
    """Where a scene is found in the model that it was attached to.

    Attributes:
      prefix: stands before every name of the scene.
      bodies: names of the N objects in the model; their free joints are called the same.
      poses: f64[N, 7], world frame of the model, metres, wxyz.
      keyframe: the keyframe that holds the scene and, for everything else, the model's own reference.
    """

    prefix: str
    bodies: tuple[str, ...]
    poses: np.ndarray
    keyframe: str

    def qpos(self, model: mujoco.MjModel, base: np.ndarray | None = None) -> np.ndarray:
        """f64[nq]: `base` (the model's qpos0 if None) with the scene's objects where they belong."""
        qpos = np.array(model.qpos0 if base is None else base, np.float64)
        for name, pose in zip(self.bodies, self.poses, strict=True):
            start = int(model.joint(name).qposadr[0])
            qpos[start : start + 7] = pose
        return qpos


def to_mjspec(scene: Scene, prefix: str = "", *, support: bool = True) -> mujoco.MjSpec:
    """The scene as a specification of its own, every name with `prefix` before it.

    Poses stand in each body's pos and quat and in the keyframe `prefix + "scene"`; time step, solver and
    contact parameters are those with which the scene was checked. Surfaces are drawn, parts collide.
    Images are files among `spec.assets`: whoever saves the specification as XML saves these beside it.

    Args:
      support: leave the support away if the user's own model has it.
    """
    spec = new_spec(scene.stability.timestep, scene.contact)
    if support:
        add_support(spec, scene.support, visual=True)
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        body = add_object(spec, asset, name, visual=True)
        body.pos, body.quat = pose[:3], pose[3:]
    for geom in spec.geoms:
        # The attached scene keeps its contact parameters even where the other model has defaults of its own.
        if not geom.priority:
            geom.friction = scene.contact.friction
        geom.condim = scene.contact.condim
        geom.solref, geom.solimp = scene.contact.solref, scene.contact.solimp
    for each in scene.cameras:
        spec.worldbody.add_camera(name=each.name, pos=each.position, quat=each.quaternion, fovy=each.fovy)
    spec.add_key(name=KEYFRAME, qpos=scene.poses.ravel())
    spec.modelname = "cluttergen scene"
    if not prefix:
        return spec
    outer = new_spec(scene.stability.timestep, scene.contact)
    outer.attach(spec, prefix=prefix, frame=outer.worldbody.add_frame())
    return outer


def attach_to(
    spec: mujoco.MjSpec,
    scene: Scene,
    prefix: str = "clutter/",
    *,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    quaternion: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    support: bool = True,
) -> Attachment:
    """Puts a scene into a user's own specification: a robot, another time step, another solver.

    The model's own options stay as they are; the scene's geoms keep their own contact parameters. Keyframes
    that the model has are extended by the scene; `Attachment.keyframe` is added. A time step of more than
    half the contact's time constant (`ContactConfig.solref`) makes contacts softer than they were.

    Args:
      spec: changed in place; compile it afterwards.
      prefix: before every name of the scene.
      position, quaternion: T_world_scene, metres, wxyz: where the scene's origin (the floor below the
        support's centre) comes to be.
      support: whether the support comes along.

    Raises:
      ConfigError: the scene has no objects, the model has something of that name already, the position is not
        finite, or the quaternion is not of unit length.
    """
    if not scene.names:
        raise ConfigError("a scene without objects", "at least one", "a scene that stands")
    turn = np.array(quaternion, np.float64)
    if turn.shape != (4,) or not abs(np.linalg.norm(turn) - 1) <= 1e-6:
        raise ConfigError(f"quaternion {tuple(quaternion)}", "four numbers of unit length, wxyz")
    if np.shape(position) != (3,) or not np.isfinite(position).all():
        raise ConfigError(f"position {tuple(position)}", "three finite numbers, metres")
    taken = {body.name for body in spec.bodies} & {prefix + name for name in (*scene.names, "support")}
    if taken:
        raise ConfigError(
            f"a model that has bodies called {sorted(taken)}", "names that are free", "another prefix"
        )
    poses = np.stack([_moved(pose, np.array(position, np.float64), turn) for pose in scene.poses])
    child = to_mjspec(scene, support=support)
    child.keys[0].qpos = poses.ravel()
    # The model's own options win; saying so here spares the user MuJoCo's warning about it.
    for option in _OPTIONS:
        setattr(child.option, option, getattr(spec.option, option))
    spec.attach(child, prefix=prefix, frame=spec.worldbody.add_frame(pos=position, quat=turn))
    return Attachment(prefix, tuple(prefix + name for name in scene.names), poses, prefix + KEYFRAME)


def _moved(pose: np.ndarray, position: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """f64[7]: a pose in a frame that itself stands at `position`, `turn`."""
    result = np.empty(7)
    mujoco.mju_rotVecQuat(result[:3], pose[:3], turn)
    result[:3] += position
    mujoco.mju_mulQuat(result[3:], turn, pose[3:])
    return result
