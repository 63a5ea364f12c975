"""Grasps drawn about their objects: a fork for each, two fingers and the palm, coloured by its margin."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from cluttergen_jax.assets import ObjectAsset
from cluttergen_jax.downstream.robot.grasping.grasp_check import MAX_LOAD
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.rendering import Trail, contact_sheet, render_object

_MOST = 24
"""Of an object: more hide it."""
# Metres from the tips to the palm, and of the line behind it.
_FINGER = 0.045
_STEM = 0.035

_RADIUS = 0.0012
_WEAK = np.array([0.85, 0.35, 0.1])
_STRONG = np.array([0.1, 0.55, 0.25])


def grasp_trails(grasps: Grasps, most: int = _MOST) -> list[Trail]:
    """Lines in the object's frame: of `most` grasps at most, evenly through their list.

    Green ones held `MAX_LOAD` times the object's weight, red ones hardly more than once.
    """
    number = min(most, len(grasps))
    trails = []
    for k in np.linspace(0, len(grasps) - 1, number).round().astype(int):
        T_object_tool = matrix_of(grasps.pose[k])
        half = grasps.width[k] / 2
        fork = np.array([[0, -half, 0], [0, -half, -_FINGER], [0, half, -_FINGER], [0, half, 0]])
        stem = np.array([[0, 0, -_FINGER], [0, 0, -_FINGER - _STEM]])
        share = float(np.clip((grasps.margin[k] - 1) / (MAX_LOAD - 1), 0, 1))
        red, green, blue = (_WEAK + share * (_STRONG - _WEAK)).tolist()
        for line in (fork, stem):
            points = line @ T_object_tool[:3, :3].T + T_object_tool[:3, 3]
            trails.append(Trail(points, (red, green, blue), radius=_RADIUS))
    return trails


def grasp_sheet(
    objects: Sequence[ObjectAsset], sets: Iterable[Grasps], columns: int = 4, samples: int = 16
) -> np.ndarray:
    """u8[H, W, 3]: a contact sheet of objects with grasps about each, and how many there are.

    Args:
      sets: of each object, in their order.
    """
    images = []
    captions = []
    for asset, grasps in zip(objects, sets, strict=True):
        trails = grasp_trails(grasps)
        images.append(render_object(asset, width=320, height=320, samples=samples, trails=trails))
        captions.append(f"{asset.name} (grasps: {len(grasps)}, low: {int(grasps.is_low.sum())})")
    return contact_sheet(images, captions, columns)
