"""Pose estimators: what they are given, and what they answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cluttergen_jax.downstream.perception.classes import FIRST_OBJECT
from cluttergen_jax.sensing.camera import Camera


@dataclass(frozen=True, eq=False)
class Look:
    """One picture, segmented. H rows, W columns.

    Attributes:
      depth: f32[H, W], metres along the optical axis, nan where nothing was measured.
      label: u8[H, W], see `classes`.
      camera: of this size, as it is believed to stand.
    """

    depth: np.ndarray
    label: np.ndarray
    camera: Camera

    def mask(self, index: int) -> np.ndarray:
        """bool[H, W]: the pixels of one object."""
        return self.label == FIRST_OBJECT + index


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


class PoseEstimator(Protocol):
    """Finds the pose of one of its objects in looks at one moment."""

    def __call__(
        self, index: int, looks: Sequence[Look], near: np.ndarray | None = None
    ) -> PoseEstimate | None:
        """The pose of the object of that number; None where too little of it is seen.

        Args:
          near: f64[7], T_world_object at which it was, if that is known; tried first.
        """
        ...
