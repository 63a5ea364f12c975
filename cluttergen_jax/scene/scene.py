"""A finished scene as a value: which objects stand where on which support; also as a MuJoCo specification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from cluttergen_jax.assets.doors import with_doors_open
from cluttergen_jax.assets.mjcf import new_spec, populated_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.display import display
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import product, transform_points
from cluttergen_jax.placement.doors import poses_on
from cluttergen_jax.scene.cameras import FixedCamera

if TYPE_CHECKING:
    from PIL import Image

_UNIT = 1e-3
_NAMED = 10
"""Objects that a scene's text names."""
KEYFRAME = "scene"
_OPTIONS = (
    "timestep",
    "gravity",
    "cone",
    "impratio",
    "iterations",
    "noslip_iterations",
    "disableflags",
)


@dataclass(frozen=True)
class Origin:
    """How a scene came about; empty or None where it is not known.

    Attributes:
      bank: the name of the bank's folder.
      index: the scene's number in it.
      pool, method, checkpoint, seed: what it was made of and how.
      verdict: the last word on it, in the words of `types.Verdict`.
      is_success: every slot is filled and the finished scene stands.
      drift: metres that its objects moved at most in the last check.
      versions: of the programs that made it, by name.
    """

    bank: str = ""
    index: int = 0
    pool: str = ""
    method: str = ""
    checkpoint: str | None = None
    seed: int | None = None
    verdict: str = ""
    is_success: bool | None = None
    drift: float | None = None
    versions: Mapping[str, str] = field(default_factory=dict)


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


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects on a support. In a notebook it is shown as a picture.

    Attributes:
      names: N unique names, in the order of placement.
      objects: their assets; the same one may stand there more than once.
      poses: f64[N, 7], T_world_object, metres, wxyz.
      support: what carries them.
      stability: the time step with which the scene was checked, among others.
      contact: friction, softness and solver.
      origin: how it came about.
      cameras: around the support; see `scene.cameras.scene_cameras`.
      region: in which its objects were asked to be; None for the support's own.
      seat: at which side of the region someone sits (`SceneSpec.seat`); "" where nobody does.
      has_sides: relations asked for left, right, front or back, so that pictures are taken from the region's
        -y side, which these words are meant from.

    Raises:
      ConfigError: the numbers of names, objects and poses differ, a name comes twice, or a pose is none.
    """

    names: tuple[str, ...]
    objects: tuple[ObjectAsset, ...]
    poses: np.ndarray
    support: SupportAsset
    stability: StabilityConfig = field(default_factory=StabilityConfig)
    contact: ContactConfig = field(default_factory=ContactConfig)
    origin: Origin = field(default_factory=Origin)
    cameras: tuple[FixedCamera, ...] = ()
    region: Rectangle | None = None
    seat: str = ""
    has_sides: bool = False

    def __repr__(self) -> str:
        names = ", ".join(self.names[:_NAMED])
        verdict = self.origin.verdict or "unknown"
        rest = f" and {len(self.names) - _NAMED} more" if len(self.names) > _NAMED else ""
        return f"Scene({names}{rest} on {self.support.name!r}; {verdict})"

    def __post_init__(self) -> None:
        poses = np.array(self.poses, np.float64)
        if not len(self.names) == len(set(self.names)) == len(self.objects) or poses.shape != (
            len(self.names),
            7,
        ):
            raise ConfigError(
                f"a scene of {len(self.names)} names, {len(self.objects)} objects and poses {poses.shape}",
                "as many unique names as objects, and a pose f[7] for each",
            )
        length = np.linalg.norm(poses[:, 3:], axis=1)
        if not (np.isfinite(poses).all() and (np.abs(length - 1) < _UNIT).all()):
            raise ConfigError(
                "a scene with a pose that is not finite or whose quaternion is not of unit length"
            )
        poses[:, 3:] /= length[:, None]
        object.__setattr__(self, "poses", poses)

    @property
    def assets(self) -> dict[str, ObjectAsset]:
        """Each asset of the scene once, by its own name."""
        return {asset.name: asset for asset in self.objects}

    def open_doors(self) -> Scene:
        """The scene with those doors open that were closed behind its objects; drawers carry what is in them.

        Raises:
          ConfigError: there are none.
        """
        support = with_doors_open(self.support)
        poses = poses_on(self.support, support, self.objects, self.poses)
        return replace(self, support=support, poses=poses)

    def picture(self, **options: Any) -> Image.Image:
        """Draws the scene, as `cluttergen_jax.render` does.

            scene.picture(size="640x480", quality="draft").save("scene.png")

        Args:
          options: what `render` takes of one picture: size, view, whole, hulls, doors, quality, samples and
            others; and `camera` in place of its `cameras`.

        Raises:
          ConfigError: a setting is out of range, or `render` takes it for something else than one picture.
          RendererError: nothing can be drawn on this machine.
        """
        return display().picture_of(self, options)

    def show(self, **options: Any) -> Any:
        """Shows the scene in the viewer: in a notebook below the cell, else in a browser until Ctrl-C.

        Args:
          options: what `cluttergen_jax.view` takes beside its source; `port` is any free one if not given.

        Returns:
          What `view` returns.

        Raises:
          ConfigError: the port is taken.
          MissingExtraError: the extra `viewer` is not installed.
        """
        return display().show(self, options)

    def _repr_png_(self) -> bytes | None:
        return display().png_of(self)

    def to_mjspec(self, prefix: str = "", *, support: bool = True) -> mujoco.MjSpec:
        """The scene as a specification of its own, every name with `prefix` before it.

        Poses stand in each body's pos and quat and in the keyframe `prefix + "scene"`; time step, solver and
        contact parameters are those with which the scene was checked. Surfaces are drawn, parts collide.
        Images are files among `spec.assets`: save these beside it if you save the specification as XML.

        Args:
          support: leave the support away if the user's own model has it.
        """
        spec = populated_spec(
            self.names,
            self.objects,
            self.support if support else None,
            self.stability.file_timestep,
            self.contact,
            poses=self.poses,
            visual=True,
        )
        for geom in spec.geoms:
            # An attached scene keeps its contact parameters even where the other model has defaults.
            if not geom.priority:
                geom.friction = self.contact.friction
            geom.condim = self.contact.condim
            geom.solref = self.contact.solref
            geom.solimp = self.contact.solimp
            geom.margin = self.stability.file_margin
        for each in self.cameras:
            spec.worldbody.add_camera(
                name=each.name, pos=each.position, quat=each.quaternion, fovy=each.fovy
            )
        spec.add_key(name=KEYFRAME, qpos=self.poses.ravel())
        spec.modelname = "cluttergen scene"
        if self.stability.both_detectors:
            spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
        if not prefix:
            return spec
        outer = new_spec(self.stability.file_timestep, self.contact)
        outer.option.disableflags = spec.option.disableflags
        outer.attach(spec, prefix=prefix, frame=outer.worldbody.add_frame())
        return outer

    def attach_to(
        self,
        spec: mujoco.MjSpec,
        prefix: str = "clutter/",
        *,
        position: Sequence[float] = (0.0, 0.0, 0.0),
        quaternion: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
        support: bool = True,
    ) -> Attachment:
        """Puts a scene into a user's own specification: a robot, another time step, another solver.

        The model's own options stay as they are; the scene's geoms keep their own contact parameters.
        Keyframes that the model has are extended by the scene; `Attachment.keyframe` is added. A time step of
        more than half the contact's time constant (`ContactConfig.solref`) makes contacts softer.

        Args:
          spec: changed in place; compile it afterwards.
          prefix: before every name of the scene.
          position, quaternion: T_world_scene, metres, wxyz: where the scene's origin (the floor below the
            support's centre) comes to be.
          support: whether the support comes along.

        Raises:
          ConfigError: the scene has no objects, `spec` is none, the model has something of that name already,
            the position is not finite, or the quaternion is not of unit length.
        """
        if not self.names:
            raise ConfigError("a scene without objects", "at least one", "a scene that stands")
        if not isinstance(spec, mujoco.MjSpec):
            raise ConfigError(
                f"attach_to a {type(spec).__name__}", "a mujoco.MjSpec", "MjSpec.from_file(file)"
            )
        turn = np.array(quaternion, np.float64)
        if turn.shape != (4,) or not abs(np.linalg.norm(turn) - 1) <= 1e-6:
            raise ConfigError(
                f"quaternion {tuple(quaternion)}", "four numbers of unit length, wxyz"
            )
        if np.shape(position) != (3,) or not np.isfinite(position).all():
            raise ConfigError(f"position {tuple(position)}", "three finite numbers, metres")
        taken = {body.name for body in spec.bodies} & {
            prefix + name for name in (*self.names, "support")
        }
        if taken:
            raise ConfigError(
                f"a model that has bodies called {sorted(taken)}",
                "names that are free",
                "another prefix",
            )
        places = transform_points(np.concatenate([position, turn]), self.poses[:, :3])
        poses = np.concatenate([places, product(turn, self.poses[:, 3:])], axis=1)
        child = self.to_mjspec(support=support)
        child.keys[0].qpos = poses.ravel()
        # The model's own options win; saying so here spares the user MuJoCo's warning about it.
        for option in _OPTIONS:
            setattr(child.option, option, getattr(spec.option, option))
        spec.attach(child, prefix=prefix, frame=spec.worldbody.add_frame(pos=position, quat=turn))
        return Attachment(
            prefix, tuple(prefix + name for name in self.names), poses, prefix + KEYFRAME
        )
