"""Outlines of objects in plan, and objects moved together in plan until their outlines nearly touch.

An outline is the convex one of everything an object is made of, seen from above: what has no gap there may
still be apart, one under the rim of the other.
"""

from __future__ import annotations

import mujoco
import numpy as np

from cluttergen_jax.geometry import rotate
from cluttergen_jax.physics.layout import Layout

_CLEARANCE = 0.0003
"""Metres that outlines stay apart."""

_FAN = 2 * np.pi * np.arange(32) / 32
_DIRECTIONS = np.stack([np.cos(_FAN), np.sin(_FAN)], axis=1)
_BACK = np.roll(np.arange(len(_FAN)), len(_FAN) // 2)
"""The direction opposite to each."""


class ConvexOutlines:
    """Convex outlines of the K objects of a world.

    Args:
      layout: of the compiled world.
    """

    def __init__(self, layout: Layout) -> None:
        self._corners = [_corners(layout, index) for index in range(layout.num_objects)]

    def reaches(self, poses: np.ndarray) -> np.ndarray:
        """How far each object reaches in each of D directions from where it is: f64[n, K, D], metres.

        Args:
          poses: f64[n, K, 7].
        """
        along = np.concatenate([_DIRECTIONS, np.zeros_like(_DIRECTIONS[:, :1])], axis=1)
        reaches = []
        for index, corners in enumerate(self._corners):
            inverse = poses[:, None, index, 3:] * [1, -1, -1, -1]
            reaches.append((rotate(np, inverse, along) @ corners.T).max(-1))
        return np.stack(reaches, axis=1)


def corners_of_geom(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """f64[V, 3]: vertices of a mesh, corners of a box around everything else, in the geom's own frame."""
    mesh = model.geom_dataid[geom]
    if mesh >= 0:
        first = model.mesh_vertadr[mesh]
        return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return model.geom_aabb[geom, :3] + signs * model.geom_aabb[geom, 3:]


def corners_of_parts(layout: Layout, index: int) -> list[np.ndarray]:
    """f64[V, 3] of each of an object's geoms: its corners, in the object's frame."""
    model = layout.model
    parts = []
    for geom in np.flatnonzero(layout.geom_object == index).tolist():
        local = corners_of_geom(model, geom)
        parts.append(rotate(np, model.geom_quat[geom], local) + model.geom_pos[geom])
    return parts


def _corners(layout: Layout, index: int) -> np.ndarray:
    """f64[V, 3]: corners of the convex hull of an object's geoms, in its own frame."""
    from scipy.spatial import ConvexHull

    everything = np.concatenate(corners_of_parts(layout, index))
    # Joggled, it works for what is flat, too.
    return everything[ConvexHull(everything, qhull_options="QJ").vertices]


def reaches_of_boxes(half_extents: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """`ConvexOutlines.reaches` of upright boxes: f64[n, B, D].

    Args:
      half_extents: f[n, B, 2], metres; yaw: f[n, B], radians.
    """
    angle = _FAN - yaw[..., None]
    along = np.abs(np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    return (along * half_extents[:, :, None]).sum(-1)


def gaps_in_plan(
    places: np.ndarray, reaches: np.ndarray, others: np.ndarray, their_reaches: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gaps between the outlines of K objects and of J others, each along the direction of the widest.

    Args:
      places: f64[n, K, 2], metres; reaches: f64[n, K, D], of `ConvexOutlines.reaches`.
      others, their_reaches: likewise, f64[n, J, 2] and f64[n, J, D].

    Returns:
      f64[n, K, J], metres, negative where outlines overlap; f64[n, K, J, 2], from the objects to the others.
    """
    ahead = places @ _DIRECTIONS.T + reaches
    behind = others @ _DIRECTIONS.T - their_reaches[..., _BACK]
    gaps = behind[:, None, :] - ahead[:, :, None]
    widest = gaps.argmax(-1)
    return np.take_along_axis(gaps, widest[..., None], -1)[..., 0], _DIRECTIONS[widest]


def move_together(
    places: np.ndarray,
    reaches: np.ndarray,
    is_same: np.ndarray,
    is_member: np.ndarray,
    middles: np.ndarray,
    boxes: tuple[np.ndarray, np.ndarray],
    num_moves: int,
) -> np.ndarray:
    """Where objects come to that move towards the middles of their groups, until others are in the way.

    Each move keeps every gap open, so that nothing passes through anything.

    Args:
      places: f64[n, K, 2], where they begin; reaches: f64[n, K, D].
      is_same: bool[n, K, K], pairs that move as one; is_member: bool[n, K], what moves or is in the way.
      middles: f64[n, K, 2].
      boxes: places f64[n, B, 2] and reaches f64[n, B, D] of what is in the way, too.

    Returns:
      f64[n, K, 2], metres.
    """
    together = is_same & is_member[:, None]
    number = np.maximum(together.sum(-1, keepdims=True), 1)
    num_boxes = boxes[0].shape[1]
    is_other = ~is_same & is_member[:, None] & is_member[..., None]
    is_other = np.pad(is_other, ((0, 0), (0, 0), (0, num_boxes)), constant_values=True)
    all_reaches = np.concatenate([reaches, boxes[1]], axis=1)
    for _ in range(num_moves):
        everything = np.concatenate([places, boxes[0]], axis=1)
        gap, towards = gaps_in_plan(places, reaches, everything, all_reaches)
        away = together @ (middles - places) / number
        closing = np.einsum("nijk,nik->nij", towards, away)
        room = np.maximum(gap - _CLEARANCE, 0.0) / 2
        share = np.where(is_other & (closing > 0), room / np.maximum(closing, 1e-9), 1.0)
        share = np.where(is_same, share.min(-1)[:, None], 1.0).min(-1)
        share = np.where(is_member, np.minimum(share, 1.0), 0.0)
        places = places + share[..., None] * away
    return places
