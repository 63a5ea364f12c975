"""Instance masks: which pixels each object covers, and on which of them it is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.geometry import transform_points
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import FIRST_OBJECT, DepthImage, RaySensor, sensed_model


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


class InstanceSensor:
    """Casts rays at a scene and at each of its objects alone.

    Args:
      objects: K of them; the same one may come twice.
      surfaces: as for `RaySensor`.
    """

    def __init__(self, objects: Sequence[ObjectAsset], support: SupportAsset, surfaces: bool = True) -> None:
        self._scene = RaySensor(sensed_model(objects, support), surfaces)
        self._alone = RaySensor(sensed_model(objects, None), surfaces)
        self._scene_data, self._alone_data = self._scene.make_data(), self._alone.make_data()
        # Surfaces may reach a little beyond the collision parts.
        meshes = [[*(piece.mesh for piece in asset.pieces), *asset.parts] for asset in objects]
        self._points = [np.concatenate([mesh.vertices for mesh in each]) for each in meshes]

    def sense(self, poses: np.ndarray, camera: Camera) -> tuple[DepthImage, tuple[Instance, ...]]:
        """What a camera sees of the objects at poses f[K, 7], and each of them by itself."""
        self._scene.pose(self._scene_data, poses)
        image = self._scene.sense(self._scene_data, camera)
        instances = [
            self._instance(index, poses, camera, image.label == FIRST_OBJECT + index)
            for index in range(len(self._points))
        ]
        return image, tuple(instances)

    def _instance(self, index: int, poses: np.ndarray, camera: Camera, visible: np.ndarray) -> Instance:
        """Rays are cast where the object can be seen at most."""
        width, height = camera.width, camera.height
        canvas = np.zeros((3 * height, 3 * width), bool)
        left, right, upper, lower = self._window(transform_points(poses[index], self._points[index]), camera)
        if left < right and upper < lower:
            shifted = camera.K - np.array([[0, 0, left], [0, 0, upper], [0, 0, 0]])
            window = replace(camera, width=right - left, height=lower - upper, K=shifted)
            self._alone.pose(self._alone_data, poses, np.arange(len(self._points)) == index)
            silhouette = self._alone.sense(self._alone_data, window).geom >= 0
            canvas[height + upper : height + lower, width + left : width + right] = silhouette
        mask = canvas[height : 2 * height, width : 2 * width]
        # At an edge, rays of the window and of the picture may round to different sides.
        mask |= visible
        rows, columns = np.nonzero(canvas)
        if not len(rows):
            return Instance(mask, visible, 0, None)
        rows, columns = rows - height, columns - width
        box = int(columns.min()), int(columns.max()), int(rows.min()), int(rows.max())
        return Instance(mask.copy(), visible, len(rows), box)

    def _window(self, points: np.ndarray, camera: Camera) -> tuple[int, int, int, int]:
        """First and last column and row, the latter excluded, that points f64[P, 3] can reach.

        As in bop_toolkit, silhouettes are followed by a picture's size beyond each edge.
        """
        width, height = camera.width, camera.height
        limits = np.array([[-width, 2 * width], [-height, 2 * height]])
        pixels, depth = camera.project(points)
        if (depth <= 0).all():
            return 0, 0, 0, 0
        if (depth > 0).all():
            reach = np.stack([np.floor(pixels.min(0)) - 1, np.ceil(pixels.max(0)) + 1], axis=1)
            limits = np.clip(reach, limits[:, :1], limits[:, 1:]).astype(int)
        (left, right), (upper, lower) = limits.tolist()
        return left, right, upper, lower
