"""Depth and labels by casting a ray through every pixel's middle: no display, no GL, safe on many threads."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

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
_ALONE = 1
_ALL = slice(None)
_TURNS = np.pi / 2 * np.array([0.0, 1.0, 0.25, 0.5, 0.75, 1.25, 1.5, 1.75])
_OUTLINE = np.stack([np.cos(_TURNS), np.sin(_TURNS)])
"""Directions across a picture, along which outlines of objects are measured; x and y first."""


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
    rays = _Rays.of(camera)
    depth, geom = rays.to_image(*rays.meet(model, data, groups))
    shape = (camera.height, camera.width)
    return depth.reshape(shape), geom.reshape(shape)


@dataclass(frozen=True, eq=False)
class _Rays:
    """The rays of a camera, R of them, row by row.

    Attributes:
      eye: f64[3], where they begin.
      directions: f64[R, 3], of length 1, world frame.
      lengths: f64[R], metres along a ray for one along the optical axis.
    """

    eye: np.ndarray
    directions: np.ndarray
    lengths: np.ndarray

    @staticmethod
    def of(camera: Camera) -> _Rays:
        # A direction is 1 m long along the optical axis, so that its multiples are depths.
        directions = camera.directions.reshape(-1, 3)
        x, y, z = directions.T
        lengths = np.sqrt(x * x + y * y + z * z)
        return _Rays(camera.eye, directions / lengths[:, None], lengths)

    def meet(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        groups: np.ndarray,
        which: np.ndarray | slice = _ALL,
    ) -> tuple[np.ndarray, np.ndarray]:
        """f64[N], metres along the rays `which`, i[N]; i32[N], the geom that is met there, -1 for none."""
        directions = self.directions[which]
        geom = np.empty(len(directions), np.int32)
        distance = np.empty(len(directions))
        mujoco.mj_multiRay(
            model,
            data,
            self.eye,
            directions.ravel(),
            groups,
            True,
            -1,
            geom,
            distance,
            None,
            len(directions),
            FARTHEST * self.lengths.max(),
        )
        return distance, geom

    def is_within(
        self, distance: np.ndarray, geom: np.ndarray, which: np.ndarray | slice = _ALL
    ) -> np.ndarray:
        """bool[N]: where something is met that is not too far away, of what `meet` tells."""
        return (geom >= 0) & (distance / self.lengths[which] <= FARTHEST)

    def to_image(self, distance: np.ndarray, geom: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """f32[R], i32[R]: depth and geom as `cast_rays` has them, of what all rays meet."""
        is_hit = self.is_within(distance, geom)
        depth = np.where(is_hit, distance / self.lengths, np.inf).astype(np.float32)
        return depth, np.where(is_hit, geom, -1)


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
    """Casts rays at a scene and at each of its objects alone; for one thread.

    Args:
      objects: K of them; the same one may come twice.
      surfaces: as for `RaySensor`.
    """

    def __init__(
        self, objects: Sequence[ObjectAsset], support: SupportAsset, surfaces: bool = True
    ) -> None:
        self._scene = RaySensor(sensed_model(objects, support), surfaces)
        self._data = self._scene.make_data()
        model = self._scene.model
        is_sensed = model.geom_group == _SENSED
        label = labels_of(model)
        self._geoms = [
            np.flatnonzero(is_sensed & (label == FIRST_OBJECT + index))
            for index in range(len(objects))
        ]
        # Rays are cast at what is fixed, and then at one object at a time.
        model.geom_group[is_sensed & (label >= FIRST_OBJECT)] = _UNSEEN
        self._label = label
        # Surfaces may reach a little beyond the collision parts.
        meshes = [[*(piece.mesh for piece in asset.pieces), *asset.parts] for asset in objects]
        self._points = [np.concatenate([mesh.vertices for mesh in each]) for each in meshes]

    def sense_scene(self, poses: np.ndarray, camera: Camera) -> DepthImage:
        """What a camera sees of the objects at poses f[K, 7]."""
        return self._sense(self._place(poses), camera)[0]

    def sense(self, poses: np.ndarray, camera: Camera) -> tuple[DepthImage, tuple[Instance, ...]]:
        """What a camera sees of the objects at poses f[K, 7], and each of them by itself."""
        points = self._place(poses)
        image, masks = self._sense(points, camera)
        instances = [
            self._instance(index, points[index], camera, mask, image.label == FIRST_OBJECT + index)
            for index, mask in enumerate(masks)
        ]
        return image, tuple(instances)

    def _place(self, poses: np.ndarray) -> list[np.ndarray]:
        """Of each object f64[P, 3], whose hull it is within, world frame."""
        self._scene.pose(self._data, poses)
        return [transform_points(*each) for each in zip(poses, self._points, strict=True)]

    def _sense(
        self, points: Sequence[np.ndarray], camera: Camera
    ) -> tuple[DepthImage, list[np.ndarray]]:
        """What a camera sees, and of each object bool[H, W], its silhouette.

        Each ray meets the nearest of what it meets of each. Most of the time goes into meshes: they are asked
        for no more rays than can meet their object.
        """
        shape = (camera.height, camera.width)
        rays = _Rays.of(camera)
        distance, geom = rays.meet(self._scene.model, self._data, _group(_SENSED))
        masks = []
        for index, each in enumerate(points):
            mask = np.zeros(shape, bool)
            which = np.flatnonzero(_may_show(each, camera))
            if len(which):
                own, own_geom = self._meet_object(index, rays, which)
                mask.ravel()[which] = rays.is_within(own, own_geom, which)
                is_nearest = (own_geom >= 0) & ((geom[which] < 0) | (own < distance[which]))
                distance[which[is_nearest]] = own[is_nearest]
                geom[which[is_nearest]] = own_geom[is_nearest]
            masks.append(mask)
        depth, geom = (each.reshape(shape) for each in rays.to_image(distance, geom))
        label = np.where(geom >= 0, self._label[geom], FLOOR).astype(np.int32)
        return DepthImage(depth, geom, label), masks

    def _meet_object(
        self, index: int, rays: _Rays, which: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """`_Rays.meet`, of one object alone."""
        model = self._scene.model
        model.geom_group[self._geoms[index]] = _ALONE
        found = rays.meet(model, self._data, _group(_ALONE), which)
        model.geom_group[self._geoms[index]] = _UNSEEN
        return found

    def _instance(
        self,
        index: int,
        points: np.ndarray,
        camera: Camera,
        mask: np.ndarray,
        visible: np.ndarray,
    ) -> Instance:
        """An object by its silhouette in the picture, and by what of it lies beyond the picture's edge."""
        left, right, upper, lower = self._window(points, camera)
        beyond = np.zeros((max(lower - upper, 0), max(right - left, 0)), bool)
        rows = np.arange(upper, lower)
        columns = np.arange(left, right)
        is_in_picture = np.ix_(
            (rows >= 0) & (rows < camera.height), (columns >= 0) & (columns < camera.width)
        )
        is_beyond = np.ones(beyond.shape, bool)
        is_beyond[is_in_picture] = False
        if is_beyond.any():
            shifted = camera.K - np.array([[0, 0, left], [0, 0, upper], [0, 0, 0]])
            window = replace(camera, width=right - left, height=lower - upper, K=shifted)
            which = np.flatnonzero(is_beyond & _may_show(points, window))
            rays = _Rays.of(window)
            beyond.ravel()[which] = rays.is_within(*self._meet_object(index, rays, which), which)
        num_pixels = int(mask.sum()) + int(beyond.sum())
        if not num_pixels:
            return Instance(mask, visible, 0, None)
        rows = np.append(np.flatnonzero(mask.any(1)), rows[beyond.any(1)])
        columns = np.append(np.flatnonzero(mask.any(0)), columns[beyond.any(0)])
        box = int(columns.min()), int(columns.max()), int(rows.min()), int(rows.max())
        return Instance(mask, visible, num_pixels, box)

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


def _group(number: int) -> np.ndarray:
    """u8[mjNGROUP]: one group of geoms alone is seen."""
    groups = np.zeros(mujoco.mjNGROUP, np.uint8)
    groups[number] = 1
    return groups


def _may_show(points: np.ndarray, camera: Camera) -> np.ndarray:
    """bool[H, W]: the pixels that may show something of the hull of f64[P, 3]; not many more.

    All between the outermost of the points along each of some directions of the picture, and a pixel more.
    """
    shape = (camera.height, camera.width)
    pixels, depth = camera.project(points)
    if (depth <= 0).all():
        return np.zeros(shape, bool)
    if (depth <= 0).any():
        return np.ones(shape, bool)
    reach = pixels @ _OUTLINE
    low = reach.min(0) - 1
    high = reach.max(0) + 1
    x = np.arange(camera.width) + 0.5
    y = np.arange(camera.height) + 0.5
    is_open = ((y >= low[1]) & (y <= high[1]))[:, None] & ((x >= low[0]) & (x <= high[0]))
    rows = np.flatnonzero(is_open.any(1))
    columns = np.flatnonzero(is_open.any(0))
    if not len(rows):
        return is_open
    window = np.ix_(rows, columns)
    along = x[columns][:, None] * _OUTLINE[0] + y[rows][:, None, None] * _OUTLINE[1]
    is_open[window] = ((along >= low) & (along <= high)).all(-1)
    return is_open
