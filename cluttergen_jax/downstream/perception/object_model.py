"""What pose estimation knows of an object, and how well the picture of a pose agrees with what was seen.

The object alone is seen by rays where it was found and where the pose has it. Rays that meet it where its
mask is agree if their depths do. Rays that meet it where something farther away was seen go through air that
was seen to be empty, and speak against the pose; so does a mask that no ray explains. What is behind
something nearer, or where nothing was measured, says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from cluttergen_jax.assets import ObjectAsset, turn_symmetry
from cluttergen_jax.downstream.perception.types import BACKGROUND
from cluttergen_jax.downstream.transforms import pose_of
from cluttergen_jax.sensing import Camera, RaySensor, View, sensed_model

NUM_POINTS = 3000
NUM_DENSE = 60_000
NUM_JUDGED = 1000


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """An object as pose estimation knows it.

    Attributes:
      asset: the object. symmetry: of its turns about z (`assets.symmetry.turn_symmetry`).
      points, normals: f64[3000, 3], of its surface, object frame, metres.
    """

    asset: ObjectAsset
    symmetry: int
    points: np.ndarray
    normals: np.ndarray
    _surface: trimesh.Trimesh = field(repr=False)

    @staticmethod
    @lru_cache(maxsize=64)
    def of(asset: ObjectAsset) -> ObjectModel:
        """The model of an object, made once: what is drawn of it, or its collision parts where nothing is."""
        meshes = [piece.mesh for piece in asset.drawn_pieces]
        surface: Any = trimesh.util.concatenate(
            [trimesh.Trimesh(mesh.vertices, mesh.faces, process=False) for mesh in meshes]
        )
        points, faces = trimesh.sample.sample_surface(surface, NUM_POINTS, seed=0)
        normals = np.asarray(surface.face_normals)[faces]
        return ObjectModel(asset, turn_symmetry(asset), np.asarray(points), normals, surface)

    @cached_property
    def tree(self) -> cKDTree:
        """Of `points`."""
        return cKDTree(self.points)

    @cached_property
    def sensor(self) -> RaySensor:
        """Casts rays at the object alone."""
        return RaySensor(sensed_model([self.asset], None), bool(self.asset.pieces))

    @cached_property
    def _dense(self) -> cKDTree:
        return cKDTree(trimesh.sample.sample_surface(self._surface, NUM_DENSE, seed=1)[0])

    def surface_distance(self, pose: np.ndarray, other: np.ndarray) -> float:
        """ADD-S: mean metres from points of the surface at one pose f64[4, 4] to the surface at another.

        The other surface is so densely sampled that what this adds is below a millimetre.
        """
        points = self.points[:NUM_JUDGED]
        moved = np.linalg.inv(other) @ pose
        return float(self._dense.query(points @ moved[:3, :3].T + moved[:3, 3])[0].mean())


AGREES = 0.006
"""Metres by which depths may differ and agree by half."""
IN_FRONT = 0.012
"""Metres by which a pose may be before what was seen and not be said to fill empty air."""
_MOST_RAYS = 900
_CLOSEST = 0.05
"""Metres from the eye, nearer than which a point is not projected."""
_MOST = 6.0
"""What a pixel says at most for one of two poses."""
_OTHERS_WEIGHT = 0.5
"""Of rays that agree in depth where the mask says otherwise."""


@dataclass(frozen=True)
class Agreement:
    """What rays said of a pose: sums over all looks.

    Attributes:
      agree: rays that agree, by how much each. weight: of all that say something.
      drawn: rays that meet the object; seen: of these, those in the mask.
    """

    agree: float
    weight: float
    drawn: float
    seen: float

    @property
    def score(self) -> float:
        """In [0, 1]."""
        return self.agree / self.weight if self.weight else 0.0


class Comparer:
    """Compares poses of one object with looks; model: the object. index: its number. looks: at one moment."""

    def __init__(self, model: ObjectModel, index: int, looks: Sequence[View]) -> None:
        self._model = model
        self._sensor = model.sensor
        self._data = self._sensor.make_data()
        self._points = model.points[::10]
        self._looks = [each for each in looks if each.mask(index).any()]
        self._masks = [each.mask(index) for each in self._looks]
        self._boxes = [_box(mask) for mask in self._masks]

    def __call__(self, pose: np.ndarray) -> Agreement:
        """How well a pose f64[4, 4] agrees with all looks that show the object."""
        found = [self._compare(k, pose) for k in range(len(self._looks))]
        return Agreement(*np.sum(found, axis=0)) if found else Agreement(0.0, 0.0, 0.0, 0.0)

    def visible(self, pose: np.ndarray) -> float:
        """The share of the silhouette that is seen, in the look that shows the most."""
        found = [Agreement(*self._compare(k, pose)) for k in range(len(self._looks))]
        return max(
            (min(each.seen / each.drawn, 1.0) if each.drawn else 0.0 for each in found), default=0.0
        )

    def evidence(self, pose: np.ndarray, top: float) -> float:
        """The log-likelihood ratio of a pose f64[4, 4] to an empty table, summed over pixels of depth.

        The difference of two poses is that of the pixels in which they differ: those of a handle, say.
        Pixels that show another known object are left out, and each counts up to `_MOST`.

        Args:
          top: the height of the table, metres.
        """
        total = 0.0
        for look, mask in zip(self._looks, self._masks, strict=True):
            drawn = render_alone(self._model, look.camera, pose)
            speaks = (
                np.isfinite(drawn) & np.isfinite(look.depth) & ((look.label == BACKGROUND) | mask)
            )
            table = _table_depth(look.camera, top)[speaks]
            seen = look.depth[speaks]
            drawn = np.minimum(drawn[speaks], table)
            errors = [np.minimum(((seen - each) / AGREES) ** 2, _MOST) for each in (table, drawn)]
            total += float((errors[0] - errors[1]).sum())
        return total

    def _compare(self, number: int, pose: np.ndarray) -> tuple[float, float, float, float]:
        look = self._looks[number]
        mask = self._masks[number]
        window, rows, columns = self._window(number, pose)
        self._sensor.pose(self._data, pose_of(pose)[None])
        drawn = self._sensor.sense(self._data, window).depth
        # Beyond the picture's edge nothing was seen, for or against.
        inside = (rows >= 0)[:, None] & (rows < look.camera.height)[:, None]
        inside = inside & (columns >= 0) & (columns < look.camera.width)
        at = np.ix_(
            np.clip(rows, 0, look.camera.height - 1), np.clip(columns, 0, look.camera.width - 1)
        )
        seen = look.depth[at]
        in_mask = mask[at] & inside
        is_hit = np.isfinite(drawn)
        is_known = np.isfinite(seen) & inside
        with np.errstate(invalid="ignore"):
            behind = np.where(is_known & is_hit, seen - drawn, 0.0)
        agree = np.exp2(-((behind / AGREES) ** 2)) * (is_hit & is_known)
        in_air = is_hit & is_known & ~in_mask & (behind > IN_FRONT)
        others = is_hit & is_known & ~in_mask & (np.abs(behind) <= IN_FRONT)
        weight = (in_mask & is_known).sum() + in_air.sum() + _OTHERS_WEIGHT * others.sum()
        both = float(agree[in_mask].sum())
        return both, float(weight), float(is_hit.sum()), float((is_hit & in_mask).sum())

    def _window(self, number: int, pose: np.ndarray) -> tuple[Camera, np.ndarray, np.ndarray]:
        """A camera that sees a look's mask and the pose alone, and the pixels i[h], i[w] that it sees."""
        camera = self._looks[number].camera
        (low, high) = self._boxes[number]
        pixels, depth = camera.project(_points_at(self._points, pose))
        if (depth > _CLOSEST).all():
            size = np.array([camera.width, camera.height])
            low = np.minimum(low, np.clip(pixels.min(0), -0.5 * size, 1.5 * size))
            high = np.maximum(high, np.clip(pixels.max(0), -0.5 * size, 1.5 * size))
        left, upper = np.floor(low).astype(int) - 2
        width, height = np.ceil(high - low).astype(int) + 5
        stride = max(1, int(np.ceil(np.sqrt(width * height / _MOST_RAYS))))
        columns = np.arange(left, left + width, stride)
        rows = np.arange(upper, upper + height, stride)
        return _part_of(camera, rows, columns), rows, columns


def _box(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[2], f64[2]: the least and the greatest column and row of a mask bool[H, W]."""
    pixels = np.argwhere(mask)[:, ::-1].astype(np.float64)
    return pixels.min(0), pixels.max(0)


def _points_at(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """f64[n, 3]: points of an object that stands at a pose f64[4, 4]."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def _table_depth(camera: Camera, top: float) -> np.ndarray:
    """f64[H, W]: the depth of an empty table at a height, metres; inf where it is not seen."""
    ones = np.ones((camera.height, camera.width), np.float32)
    with np.errstate(divide="ignore"):
        depth = (top - camera.eye[2]) / (camera.points(ones)[..., 2] - camera.eye[2])
    return np.where(depth > 0, depth, np.inf)


def render_alone(model: ObjectModel, camera: Camera, pose: np.ndarray) -> np.ndarray:
    """f32[H, W]: the depth of an object alone at a pose f64[4, 4], metres; inf where it is not seen."""
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    pixels, away = camera.project(_points_at(model.points[::10], pose))
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(pixels.min(0)).astype(int) - 2, 0, size)
    high = np.clip(np.ceil(pixels.max(0)).astype(int) + 3, 0, size)
    if (away > _CLOSEST).all() and (low < high).all():
        columns = np.arange(low[0], high[0])
        rows = np.arange(low[1], high[1])
        data = model.sensor.make_data()
        model.sensor.pose(data, pose_of(pose)[None])
        depth[np.ix_(rows, columns)] = model.sensor.sense(
            data, _part_of(camera, rows, columns)
        ).depth
    return depth


def _part_of(camera: Camera, rows: np.ndarray, columns: np.ndarray) -> Camera:
    """A camera that sees these pixels alone, evenly spaced i[h], i[w]."""
    stride = rows[1] - rows[0] if len(rows) > 1 else 1
    K = camera.K.copy()
    # The middle of the part's first pixel is that of the picture's.
    K[:2, 2] -= [columns[0] + 0.5, rows[0] + 0.5]
    K[:2] /= stride
    K[:2, 2] += 0.5
    return replace(camera, width=len(columns), height=len(rows), K=K)
