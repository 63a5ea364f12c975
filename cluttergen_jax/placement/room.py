"""Which objects find no room between the walls or sides of a region, however they are turned."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.assets.support_map import rim_height
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.config import PlacementConfig

_TURNS = 360
"""Headings that are tried, half a degree apart."""
_SLACK = 0.002
"""Metres by which an object may be too large: contacts give way, and headings lie between those tried."""
_MOST_NAMED = 8


def check_room(
    objects: Sequence[ObjectAsset],
    support: SupportAsset,
    region: Rectangle,
    placement: PlacementConfig,
    is_piled: bool = False,
) -> None:
    """Refuses objects that cannot lie within a region that walls or the request bound on all sides.

    An object fits if its outline, seen from above, fits into the region for some heading: upright, or, where
    objects come in other poses, in any of its resting poses, or on any side of its box where its middle is
    below the rim then.

    Args:
      is_piled: objects are let fall in any orientation.

    Raises:
      ConfigError: it names the objects with their sizes, and the region's.
    """
    rim = rim_height(region, support)
    if not (rim > 0 or placement.containment == "footprint"):
        return
    room = 2 * np.array(region.half_extents)
    is_upright = placement.poses == "upright" and not is_piled
    large = [each for each in objects if not _fits(each, room, rim, is_upright)]
    if not large:
        return
    names = [each.name for each in large]
    sizes = [f"{each.name} ({_size_text(2 * np.asarray(each.half_extents))})" for each in large]
    more = f" and {len(sizes) - _MOST_NAMED} more" if len(sizes) > _MOST_NAMED else ""
    where = f"a region of {_size_text(room)}"
    if rim > 0:
        where = f"support {support.name!r}, {_size_text(np.append(room, rim))} inside its walls"
    how = "as they stand" if is_upright else "whichever way they lie"
    raise ConfigError(
        f"objects that are too large for {where}, {how}: {', '.join(sizes[:_MOST_NAMED])}{more}",
        "smaller ones, or a larger support or region",
        "exclude=" + repr(tuple(names)),
    )


def _size_text(size: np.ndarray) -> str:
    return " x ".join(f"{side:.2f}" for side in size) + " m"


def _fits(asset: ObjectAsset, room: np.ndarray, rim: float, is_upright: bool) -> bool:
    vertices = np.concatenate([part.vertices for part in asset.parts])
    if np.linalg.norm(np.ptp(vertices, axis=0)) <= room.min():
        return True
    angles = np.pi * np.arange(_TURNS) / _TURNS
    along = np.stack([np.cos(angles), np.sin(angles)])
    across = np.stack([-np.sin(angles), np.cos(angles)])
    for turn, is_resting in _orientations(asset, is_upright):
        turned = vertices @ turn.T
        if not is_resting and np.ptp(turned[:, 2]) > 2 * rim:
            continue
        outline = turned[:, :2]
        outline = outline[ConvexHull(outline).vertices]
        sides = np.stack([np.ptp(outline @ along, axis=0), np.ptp(outline @ across, axis=0)])
        if (sides <= room[:, None] + _SLACK).all(0).any():
            return True
    return False


def _orientations(asset: ObjectAsset, is_upright: bool) -> Iterator[tuple[np.ndarray, bool]]:
    """Rotations in which an object may come to lie, f64[3, 3], and whether it rests so by itself."""
    yield np.eye(3), True
    if is_upright:
        return
    for pose in asset.resting:
        yield Rotation.from_quat(np.roll(pose.quaternion, -1)).as_matrix(), True
    for axis in ((np.pi / 2, 0, 0), (0, np.pi / 2, 0)):
        yield Rotation.from_rotvec(axis).as_matrix(), False
