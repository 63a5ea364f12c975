"""What perception is given and answers: classes of pixels, pictures, segmenters, poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.sensing import Camera

# The table, the floor and all else; the robot; then object k of a pool as 2 + k.
BACKGROUND = 0
ARM = 1
FIRST_OBJECT = 2


def num_classes(num_objects: int) -> int:
    """Classes where a pool has so many objects."""
    return FIRST_OBJECT + num_objects


_FARTHEST = 20.0


@dataclass(frozen=True, eq=False)
class Segmentation:
    """What each pixel shows. H rows, W columns.

    Attributes:
      names: of the objects.
      label: u8[H, W], see `types`.
    """

    names: tuple[str, ...]
    label: np.ndarray


class Segmenter(Protocol):
    """Tells for each pixel which of some known objects it shows."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the objects that it knows."""
        ...

    def __call__(
        self, rgb: np.ndarray, depth: np.ndarray, camera: Camera, among: Sequence[str] | None = None
    ) -> Segmentation:
        """What each pixel shows.

        Args:
          rgb: u8[H, W, 3]. depth: f32[H, W], metres along the optical axis, nan or inf where none.
          camera: of this size.
          among: the objects that may be there, by name; no other is told of. All if None.

        Raises:
          ConfigError: the images are not the camera's (`check_images`).
        """
        ...


def check_images(
    rgb: np.ndarray, depth: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """The images as all here take them: u8[H, W, 3]; f32[H, W], nan where nothing was measured.

    Raises:
      ConfigError: sizes or types are wrong, or no pixel has a depth between 0 and 20 m.
    """
    rgb = np.asarray(rgb)
    depth = np.asarray(depth)
    shape = (camera.height, camera.width)
    if rgb.shape != (*shape, 3) or rgb.dtype != np.uint8:
        raise ConfigError(
            f"a picture of type {rgb.dtype} and shape {rgb.shape}", f"uint8, {(*shape, 3)}"
        )
    if depth.shape != shape or not np.issubdtype(depth.dtype, np.floating):
        raise ConfigError(
            f"a depth image of type {depth.dtype} and shape {depth.shape}",
            f"floating point, {shape}, the camera's",
            "metres along the optical axis, not millimetres",
        )
    with np.errstate(invalid="ignore"):
        is_there = np.isfinite(depth) & (depth > 0) & (depth < _FARTHEST)
    if not is_there.any():
        raise ConfigError(
            "a depth image in which nothing was measured",
            f"metres from 0 to {_FARTHEST:g} somewhere",
            "depth in metres; nan where nothing was measured",
        )
    return rgb, np.where(is_there, depth, np.nan).astype(np.float32)


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """Where an object is, as far as looks tell.

    Attributes:
      pose: f64[7], T_world_object, metres, wxyz.
      score: in [0, 1], how well its picture agrees with what was seen (`compare`).
      gap: by how much that is better than the best pose that is another; below zero where pixels on which
        the two differ speak for this one.
      lead: in [0, 1], how surely its turn is told from others that agree about as well, by the pixels on
        which they differ; 1 where there are none.
      visible: share of its whole silhouette that is seen, in the look that shows the most.
      num_pixels: of its masks.
    """

    pose: np.ndarray
    score: float
    gap: float
    lead: float
    visible: float
    num_pixels: int
