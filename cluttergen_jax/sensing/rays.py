"""Depth and labels by casting a ray through every pixel's middle: no display, no GL, safe on many threads."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import VISUAL_GROUP, populated_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import transform_points
from cluttergen_jax.sensing.camera import Camera

# Labels: the floor or nothing, the support, then object k as 2 + k.
FLOOR = 0
SUPPORT = 1
FIRST_OBJECT = 2

FARTHEST = 20.0
"""Metres along the optical axis; what is farther away is not seen."""

_SENSED = 0
_UNSEEN = 5


@dataclass(frozen=True, eq=False)
class DepthImage:
    """What each pixel's middle shows. H rows, W columns.

    Attributes:
      depth: f32[H, W], metres along the optical axis; inf where nothing is.
      geom: i32[H, W], the model's geom there, -1 where nothing is.
      label: i32[H, W], FLOOR, SUPPORT, or FIRST_OBJECT + k for the object of the k-th free joint.
    """

    depth: np.ndarray
    geom: np.ndarray
    label: np.ndarray


class RaySensor:
    """Casts rays at the bodies of a compiled model; serves many threads, each with its own data.

    Args:
      model: all its joints are free ones (`sensed_model`, `assets.mjcf.populated_spec`); it stays as it is.
      surfaces: see the coloured surfaces (geoms of `VISUAL_GROUP`); False: the collision parts.

    Raises:
      ConfigError: a joint is not free.
    """

    def __init__(self, model: mujoco.MjModel, surfaces: bool = True) -> None:
        if np.any(model.jnt_type != mujoco.mjtJoint.mjJNT_FREE):
            raise ConfigError("a model with joints that are not free", "free bodies and fixed ones")
        # Only a copy can be told which geoms rays see: a support without pieces shows its boxes.
        self.model = copy.copy(model)
        collides = (model.geom_contype | model.geom_conaffinity) != 0
        is_floor = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0)
        is_sensed = (model.geom_group == VISUAL_GROUP) if surfaces else collides
        self.model.geom_group[:] = np.where(is_sensed | is_floor, _SENSED, _UNSEEN)
        self._groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        self._groups[_SENSED] = 1
        self._label = labels_of(model)
        self._home = model.qpos0.reshape(-1, 7).copy()

    @property
    def num_objects(self) -> int:
        """The number of free bodies."""
        return self.model.njnt

    def make_data(self) -> mujoco.MjData:
        """Room for the state of one scene at a time; one for each thread."""
        return mujoco.MjData(self.model)

    def pose(
        self, data: mujoco.MjData, poses: np.ndarray, is_placed: np.ndarray | None = None
    ) -> None:
        """Puts a scene into `data`.

        Args:
          poses: f[K, 7], T_world_object, metres, wxyz, in the order of the joints.
          is_placed: bool[K]; the others go where the model has them parked. None: all.
        """
        here = np.asarray(poses, np.float64).reshape(-1, 7)
        if here.shape != self._home.shape:
            raise ConfigError(
                f"{len(here)} poses for {len(self._home)} objects", f"{len(self._home)}"
            )
        if is_placed is not None:
            here = np.where(np.asarray(is_placed, bool)[:, None], here, self._home)
        data.qpos[:] = here.ravel()
        mujoco.mj_kinematics(self.model, data)

    def sense(self, data: mujoco.MjData, camera: Camera) -> DepthImage:
        """What a camera sees of the scene in `data`, whose kinematics are up to date (`pose`)."""
        depth, geom = cast_rays(self.model, data, camera, self._groups)
        label = np.where(geom >= 0, self._label[geom], FLOOR)
        return DepthImage(depth, geom, label.astype(np.int32))


def cast_rays(
    model: mujoco.MjModel, data: mujoco.MjData, camera: Camera, groups: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a camera sees of any model, whose kinematics are up to date.

    Args:
      groups: u8[mjNGROUP], 1 for groups of geoms that are seen.

    Returns:
      f32[H, W], metres along the optical axis, inf where nothing is; i32[H, W], the geom, -1 for none.
    """
    shape = (camera.height, camera.width)
    # A direction is 1 m long along the optical axis, so that its multiples are depths.
    directions = camera.directions.reshape(-1, 3)
    lengths = np.linalg.norm(directions, axis=1)
    geom = np.empty(len(directions), np.int32)
    distance = np.empty(len(directions))
    mujoco.mj_multiRay(
        model,
        data,
        camera.eye,
        (directions / lengths[:, None]).ravel(),
        groups,
        True,
        -1,
        geom,
        distance,
        None,
        len(directions),
        FARTHEST * lengths.max(),
    )
    depth = distance / lengths
    is_hit = (geom >= 0) & (depth <= FARTHEST)
    depth = np.where(is_hit, depth, np.inf).astype(np.float32)
    return depth.reshape(shape), np.where(is_hit, geom, -1).reshape(shape)


def labels_of(model: mujoco.MjModel) -> np.ndarray:
    """i32[ngeom]: each geom's label, by its body: that of a free joint, the world's or another one."""
    label_of_body = np.full(model.nbody, SUPPORT, np.int32)
    label_of_body[0] = FLOOR
    free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    label_of_body[free] = FIRST_OBJECT + np.arange(len(free))
    return label_of_body[model.geom_bodyid]


def sensed_model(objects: Sequence[ObjectAsset], support: SupportAsset | None) -> mujoco.MjModel:
    """A model to cast rays at: surfaces and collision parts of objects and support, and a floor at z = 0.

    Without poses every object is parked far away; joint k is object k.

    Args:
      support: None leaves it and the floor out, so that rays meet nothing but objects.
    """
    names = [f"{index:02d}-{asset.name}" for index, asset in enumerate(objects)]
    spec = populated_spec(
        names, objects, support, StabilityConfig().timestep, ContactConfig(), visual=True
    )
    if support is not None:
        spec.worldbody.add_geom(
            name="floor",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=(0, 0, 1),
            contype=0,
            conaffinity=0,
            group=VISUAL_GROUP,
        )
    return spec.compile()


@dataclass(frozen=True, eq=False)
class Instance:
    """One object in one picture. H rows, W columns.

    Attributes:
      mask: bool[H, W], its silhouette, as if nothing else were there.
      visible: bool[H, W], where it is seen.
      num_pixels: of its whole silhouette, what lies beyond the picture's edge (by up to a picture) included.
      box: the first and last column and the first and last row of that silhouette; None if it has no pixel.
    """

    mask: np.ndarray
    visible: np.ndarray
    num_pixels: int
    box: tuple[int, int, int, int] | None

    @property
    def visible_share(self) -> float:
        """Of the whole silhouette; 0 where there is none."""
        return float(self.visible.sum() / self.num_pixels) if self.num_pixels else 0.0


@dataclass(frozen=True, eq=False)
class View:
    """What one camera sees of a scene. H rows, W columns, N objects.

    Attributes:
      depth: f32[H, W], metres along the optical axis, not along the ray; inf where nothing is, nan where a
        noisy camera measured nothing. Files encode it in their own ways, and are read back as this.
      label: i[H, W], 0 floor or nothing, 1 support, 2 + k object k; perception has 0 for the support, too,
        1 for the robot's arm, and numbers objects as its pool does.
      camera: of this size, where the view was seen from, or is believed to have been.
      rgb: u8[H, W, 3]; None where no colours were drawn.
      instances: of each object, masks and boxes; () where they were not asked for.
    """

    depth: np.ndarray
    label: np.ndarray
    camera: Camera
    rgb: np.ndarray | None = None
    instances: tuple[Instance, ...] = ()

    @property
    def colours(self) -> np.ndarray:
        """u8[H, W, 3], of a view that was drawn."""
        assert self.rgb is not None, "no colours were drawn"
        return self.rgb

    def mask(self, index: int) -> np.ndarray:
        """bool[H, W]: the pixels of one object."""
        return self.label == FIRST_OBJECT + index


class InstanceSensor:
    """Casts rays at a scene and at each of its objects alone.

    Args:
      objects: K of them; the same one may come twice.
      surfaces: as for `RaySensor`.
    """

    def __init__(
        self, objects: Sequence[ObjectAsset], support: SupportAsset, surfaces: bool = True
    ) -> None:
        self._objects = tuple(objects)
        self._surfaces = surfaces
        self._scene = RaySensor(sensed_model(objects, support), surfaces)
        self._scene_data = self._scene.make_data()
        # Surfaces may reach a little beyond the collision parts.
        meshes = [[*(piece.mesh for piece in asset.pieces), *asset.parts] for asset in objects]
        self._points = [np.concatenate([mesh.vertices for mesh in each]) for each in meshes]

    @cached_property
    def _alone(self) -> tuple[RaySensor, mujoco.MjData]:
        sensor = RaySensor(sensed_model(self._objects, None), self._surfaces)
        return sensor, sensor.make_data()

    def sense_scene(self, poses: np.ndarray, camera: Camera) -> DepthImage:
        """What a camera sees of the objects at poses f[K, 7]."""
        self._scene.pose(self._scene_data, poses)
        return self._scene.sense(self._scene_data, camera)

    def sense(self, poses: np.ndarray, camera: Camera) -> tuple[DepthImage, tuple[Instance, ...]]:
        """What a camera sees of the objects at poses f[K, 7], and each of them by itself."""
        image = self.sense_scene(poses, camera)
        instances = [
            self._instance(index, poses, camera, image.label == FIRST_OBJECT + index)
            for index in range(len(self._points))
        ]
        return image, tuple(instances)

    def _instance(
        self, index: int, poses: np.ndarray, camera: Camera, visible: np.ndarray
    ) -> Instance:
        """Rays are cast where the object can be seen at most."""
        width = camera.width
        height = camera.height
        canvas = np.zeros((3 * height, 3 * width), bool)
        left, right, upper, lower = self._window(
            transform_points(poses[index], self._points[index]), camera
        )
        if left < right and upper < lower:
            shifted = camera.K - np.array([[0, 0, left], [0, 0, upper], [0, 0, 0]])
            window = replace(camera, width=right - left, height=lower - upper, K=shifted)
            alone, data = self._alone
            alone.pose(data, poses, np.arange(len(self._points)) == index)
            silhouette = alone.sense(data, window).geom >= 0
            canvas[height + upper : height + lower, width + left : width + right] = silhouette
        mask = canvas[height : 2 * height, width : 2 * width]
        # At an edge, rays of the window and of the picture may round to different sides.
        mask |= visible
        rows, columns = np.nonzero(canvas)
        if not len(rows):
            return Instance(mask, visible, 0, None)
        rows = rows - height
        columns = columns - width
        box = int(columns.min()), int(columns.max()), int(rows.min()), int(rows.max())
        return Instance(mask.copy(), visible, len(rows), box)

    def _window(self, points: np.ndarray, camera: Camera) -> tuple[int, int, int, int]:
        """First and last column and row, the latter excluded, that points f64[P, 3] can reach.

        As in bop_toolkit, silhouettes are followed by a picture's size beyond each edge.
        """
        width = camera.width
        height = camera.height
        limits = np.array([[-width, 2 * width], [-height, 2 * height]])
        pixels, depth = camera.project(points)
        if (depth <= 0).all():
            return 0, 0, 0, 0
        if (depth > 0).all():
            reach = np.stack([np.floor(pixels.min(0)) - 1, np.ceil(pixels.max(0)) + 1], axis=1)
            limits = np.clip(reach, limits[:, :1], limits[:, 1:]).astype(int)
        (left, right), (upper, lower) = limits.tolist()
        return left, right, upper, lower
