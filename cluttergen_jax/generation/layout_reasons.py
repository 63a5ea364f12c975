"""Why objects of a layout find no place, in words: by where they are, against the support's surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import Ring, SupportAsset, Surface
from cluttergen_jax.generation.layout_json import UNITS
from cluttergen_jax.geometry import conjugate, transform_points

_NEAR = 0.15
"""Metres above or below a surface within which an object counts as meant to be on it."""


def reason_without_place(
    asset: ObjectAsset, pose: np.ndarray, support: SupportAsset, max_shift: float
) -> str:
    """Why an object at a pose, f64[7], finds no place on a support within `max_shift` metres."""
    surface, beyond, gap = _nearest(asset, pose, support)
    where = (
        f"{support.name!r}"
        if len(support.surfaces) == 1
        else f"{surface.name!r} of {support.name!r}"
    )
    said = [f"{beyond:.2f} m beyond the edge of {where}"] if beyond > 0 else []
    top = f"the top of {where}"
    if gap < -max_shift:
        said.append(f"{-gap:.2f} m under {top}")
    elif gap > max_shift:
        said.append(f"{gap:.2f} m above {top}")
    return (
        " and ".join(said) or f"too little room within {max_shift:g} m, or it does not stay there"
    )


def hint_for_positions(
    objects: Sequence[ObjectAsset], poses: np.ndarray, support: SupportAsset, is_in_metres: bool
) -> str:
    """What the positions f64[N, 7] of a layout may have been meant as; "" where that is not plain.

    Args:
      is_in_metres: they are taken for metres although no unit is stated.
    """
    if _fit(objects, poses, support):
        return ""
    for unit, factor in UNITS.items() if is_in_metres else ():
        scaled = poses.copy()
        scaled[:, :3] *= factor
        if factor != 1.0 and _fit(objects, scaled, support):
            return f'in {unit} all positions would be on it: is "unit": "{unit}" missing?'
    lifted = poses.copy()
    lifted[:, 2] += support.top
    if _fit(objects, lifted, support):
        height = f"{support.top:g} m"
        return f"is z measured from its top? It counts from the floor: {height} higher all would be on it"
    return ""


def _fit(objects: Sequence[ObjectAsset], poses: np.ndarray, support: SupportAsset) -> bool:
    """Whether all objects are over a surface, and near it."""
    found = [_nearest(asset, pose, support) for asset, pose in zip(objects, poses, strict=True)]
    return all(beyond == 0 and abs(gap) <= _NEAR for _, beyond, gap in found)


def _nearest(
    asset: ObjectAsset, pose: np.ndarray, support: SupportAsset
) -> tuple[Surface, float, float]:
    """The surface that an object is nearest to; metres beyond its edge, and above it, negative below."""
    points = transform_points(pose, np.concatenate([part.vertices for part in asset.parts]))
    center = transform_points(pose, np.asarray(asset.center_of_mass)[None])
    found = []
    for surface in support.surfaces:
        back = conjugate(np.array(surface.quaternion))
        home = np.array(
            [
                *transform_points(np.array([0, 0, 0, *back]), -np.array(surface.position)[None])[0],
                *back,
            ]
        )
        gap = float(transform_points(home, points)[:, 2].min())
        found.append(
            (surface, _beyond(surface.outline, transform_points(home, center)[0, :2]), gap)
        )
    return min(found, key=lambda each: np.hypot(each[1], each[2]))


def _beyond(outline: Ring, point: np.ndarray) -> float:
    """Metres from f64[2] to a ring around it; 0 within."""
    start = np.array(outline, np.float64)
    end = np.roll(start, -1, axis=0)
    along = end - start
    share = ((point - start) * along).sum(1) / np.maximum((along**2).sum(1), 1e-12)
    nearest = start + share.clip(0, 1)[:, None] * along
    crosses = (start[:, 1] > point[1]) != (end[:, 1] > point[1])
    height = np.where(crosses, along[:, 1], 1.0)
    x = start[:, 0] + (point[1] - start[:, 1]) / height * along[:, 0]
    is_inside = bool((crosses & (x > point[0])).sum() % 2)
    return 0.0 if is_inside else float(np.linalg.norm(nearest - point, axis=1).min())
