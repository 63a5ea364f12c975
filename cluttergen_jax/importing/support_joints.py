"""What of a piece of furniture moves with which of its joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from cluttergen_jax.assets.cloud import sample_surface
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.shading import box_mesh
from cluttergen_jax.assets.shape import Joint
from cluttergen_jax.assets.support import SupportAsset

_SAMPLES = 4096
"""Points on all surfaces of a link."""
_NO_LIMIT = 100.0
"""Radians or metres: files state such limits where they mean none."""


def moved_together(joints: Sequence[Joint], meshes: Sequence[Mesh]) -> list[list[Mesh]]:
    """Surfaces in groups: those that stand still first, then those of each joint; no group is empty."""
    moved = [set(joint.pieces) for joint in joints]
    still = set(range(len(meshes))).difference(*moved)
    groups = [[meshes[number] for number in sorted(group)] for group in (still, *moved)]
    return [group for group in groups if group]


def with_joints(support: SupportAsset, joints: Sequence[Joint]) -> SupportAsset:
    """A support with joints, each with what of the collision it moves: what lies nearest to its surfaces.

    Args:
      joints: world frame; they know the surfaces that they move.
    """
    moved = [joint.pieces for joint in joints]
    still = sorted(set(range(len(support.pieces))).difference(*moved))
    trees = []
    for group in (still, *moved):
        mesh = join_meshes([support.pieces[number].mesh for number in group]) if group else None
        trees.append(None if mesh is None else cKDTree(sample_surface(mesh, _SAMPLES, 0)))

    def nearest(points: np.ndarray) -> int:
        """The joint that moves f64[V, 3]; -1 for none."""
        far = [np.inf if tree is None else float(tree.query(points)[0].mean()) for tree in trees]
        return int(np.argmin(far)) - 1

    boxes = [nearest(box_mesh(box).vertices) for box in support.boxes]
    parts = [nearest(part.vertices) for part in support.parts]
    made = [
        replace(
            joint,
            range=_limits_of(joint),
            boxes=tuple(place for place, by in enumerate(boxes) if by == number),
            parts=tuple(place for place, by in enumerate(parts) if by == number),
        )
        for number, joint in enumerate(joints)
    ]
    return replace(support, joints=tuple(made))


def estimates_of(joints: Sequence[Joint]) -> list[str]:
    """What files do not state of joints that move in exports, in words."""
    missing: dict[tuple[str, ...], list[str]] = {}
    for what in ("mass", "damping", "friction", "armature"):
        names = tuple(joint.name for joint in joints if getattr(joint, what) is None)
        missing.setdefault(names, []).append(what)
    said = [
        f"{', '.join(what)} of {', '.join(map(repr, names))}"
        for names, what in missing.items()
        if names
    ]
    return (
        [f"its file states none, so exports as mjcf-joints estimate: {'; '.join(said)}"]
        if said
        else []
    )


def _limits_of(joint: Joint) -> tuple[float, float] | None:
    """Its limits with where it stands, which files may put beyond them; None where they limit nothing."""
    if joint.range is None or max(map(abs, joint.range)) > _NO_LIMIT:
        return None
    return min(joint.range[0], joint.value), max(joint.range[1], joint.value)
