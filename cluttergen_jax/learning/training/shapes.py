"""Clouds of the modeller's families, many of each: what the point encoders are pretrained on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.cloud import farthest_first, sample_surface
from cluttergen_jax.assets.mesh import joined
from cluttergen_jax.assets.modeller.catalog import make_shape
from cluttergen_jax.progress import tracked


@dataclass(frozen=True, eq=False)
class ShapeClouds:
    """Labelled clouds.

    Attributes:
      cloud: f32[N, P, 3], metres, the bounding box's centre at the origin, farthest-point ordered.
      label: i32[N], of the family.
    """

    cloud: np.ndarray
    label: np.ndarray


def shape_cloud(family: str, seed: int, num_points: int) -> np.ndarray:
    """f32[P, 3]: one object of a family with drawn proportions; equal arguments give equal points.

    The points lie on the surfaces of its pieces, also where one piece hides another.
    """
    mesh = joined([piece.mesh for piece in make_shape(family, seed).pieces])
    points = sample_surface(mesh, num_points, seed)
    lower, upper = mesh.bounds
    return (points[farthest_first(points)] - (lower + upper) / 2).astype(np.float32)


def make_clouds(families: Sequence[str], seeds: Sequence[int], num_points: int, title: str) -> ShapeClouds:
    """One cloud of each family for each seed, with a progress bar."""
    wanted = [(label, seed) for label in range(len(families)) for seed in seeds]
    bar = tracked(wanted, title, len(wanted), "shape")
    cloud = np.stack([shape_cloud(families[label], seed, num_points) for label, seed in bar])
    return ShapeClouds(cloud, np.array([label for label, _ in wanted], np.int32))
