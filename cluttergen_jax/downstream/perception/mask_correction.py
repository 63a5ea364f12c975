"""Corrects masks: a pixel whose depth is that of an object at its expected pose shows that object.

A segmenter errs where light is strange. What has not been touched, or was put down with care, is mostly where
it is expected, and depth confirms that without any colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation, binary_opening
from scipy.ndimage import label as connected

from cluttergen_jax.downstream.perception.pose.compare import AGREES, IN_FRONT, render_alone
from cluttergen_jax.downstream.perception.pose.models import ObjectModel
from cluttergen_jax.downstream.perception.types import ARM, BACKGROUND, FIRST_OBJECT
from cluttergen_jax.views import View

LEAST_SHARE = 0.6
"""Of the pixels of an object that should be seen: so many have to have its depth for it to count as there."""
_FEWEST = 40
"""Pixels that should be seen, below which nothing is concluded."""
_MARGIN = 6
"""Pixels about an object that is there, outside of which nothing else of its kind is."""
_VOXEL = 0.012
"""Metres between points of one thing, at most."""


def correct_masks(
    looks: Sequence[View], expected: dict[int, tuple[ObjectModel, np.ndarray]]
) -> list[View]:
    """The looks, with corrected masks of those objects that depth shows where they are expected.

    Args:
      expected: by number, the object and its pose f64[4, 4], T_world_object.
    """
    return [_correct_mask(look, expected) for look in looks]


def find_unexplained(
    looks: Sequence[View], found: dict[int, tuple[ObjectModel, np.ndarray]], top: float, fewest: int
) -> list[list[np.ndarray]]:
    """What stands on the table, shown by depth, that is none of the objects where they were found.

    Args:
      found: by number, the object and its pose f64[4, 4], T_world_object.
      top: height of the table, metres. fewest: pixels of a thing; with fewer it is left out.

    Returns:
      Of each thing, the one with the most pixels first, its mask bool[H, W] in each look. Things are apart if
      their points are.
    """
    masks = [_unexplained_pixels(look, found, top) for look in looks]
    points = [look.camera.points(look.depth)[mask] for look, mask in zip(looks, masks, strict=True)]
    if not sum(map(len, points)):
        return []
    cells = np.floor(np.concatenate(points) / _VOXEL).astype(int)
    cells -= cells.min(0)
    is_full = np.zeros(cells.max(0) + 1, bool)
    is_full[tuple(cells.T)] = True
    things = connected(is_full, np.ones((3, 3, 3)))[0][tuple(cells.T)]
    counts = np.bincount(things)
    kept = [thing for thing in np.argsort(-counts, kind="stable") if counts[thing] >= fewest]
    of_looks = np.split(things, np.cumsum([len(each) for each in points])[:-1])
    result = []
    for thing in kept:
        own = [mask.copy() for mask in masks]
        for mask, each in zip(own, of_looks, strict=True):
            mask[mask] = each == thing
        result.append(own)
    return result


def _unexplained_pixels(
    look: View, found: dict[int, tuple[ObjectModel, np.ndarray]], top: float
) -> np.ndarray:
    """bool[H, W]: the pixels of one look, those at the edges of things left out."""
    height = look.camera.points(look.depth)[..., 2]
    with np.errstate(invalid="ignore"):
        stands = (height > top + IN_FRONT) & (look.label != ARM)
    for model, pose in found.values():
        behind = look.depth - render_alone(model, look.camera, pose)
        stands &= ~(np.abs(behind) < IN_FRONT)
    return np.asarray(binary_opening(stands, np.ones((3, 3))))


def _correct_mask(look: View, expected: dict[int, tuple[ObjectModel, np.ndarray]]) -> View:
    label = look.label.copy()
    nearest = np.full(look.depth.shape, np.inf)
    for number, (model, pose) in expected.items():
        drawn = render_alone(model, look.camera, pose)
        is_drawn = np.isfinite(drawn)
        behind = np.where(is_drawn & np.isfinite(look.depth), look.depth, np.nan) - drawn
        near = np.abs(behind) < IN_FRONT
        shown = behind > -IN_FRONT
        if shown.sum() < _FEWEST or near.sum() < LEAST_SHARE * shown.sum():
            continue
        stray = (label == FIRST_OBJECT + number) & ~binary_dilation(is_drawn, iterations=_MARGIN)
        label[stray] = BACKGROUND
        # Whatever is near to it in depth is no other object; what is said to be the table may be.
        own = near & ((np.abs(behind) < AGREES) | (label != BACKGROUND)) & (drawn < nearest)
        label[own] = FIRST_OBJECT + number
        nearest[own] = drawn[own]
    return replace(look, label=label)
