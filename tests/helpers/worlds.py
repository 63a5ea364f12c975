"""Tiny worlds for tests: a few hand-made convex objects on the paper's table."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.mjcf import add_object, add_support, new_spec
from cluttergen_jax.assets.object import ObjectAsset, RestingPose
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.physics.layout import Layout

TOP = 0.7
"""Height of the table's top in metres."""


def convex(name: str, vertices: np.ndarray, inertia: np.ndarray, mass: float) -> ObjectAsset:
    """A solid object of one convex part that stands on its lowest face, its frame at its centre of mass."""
    return ObjectAsset(
        name=name,
        label=name,
        pieces=(),
        parts=(Mesh.points(vertices),),
        mass=mass,
        center_of_mass=np.zeros(3),
        inertia=inertia,
        cloud=np.zeros((1024, 3), np.float32),
        resting=(RestingPose((1.0, 0.0, 0.0, 0.0), float(-vertices[:, 2].min()), 1.0),),
        provenance=Provenance("tests", "Apache-2.0"),
    )


def box(name: str, half_extents: Sequence[float], mass: float = 0.2) -> ObjectAsset:
    """A solid box."""
    half = np.asarray(half_extents, np.float64)
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(-1, 3) * half
    return convex(name, corners, np.diag((half**2).sum() - half**2) * mass / 3, mass)


def prism(
    name: str, radius: float, half_height: float, mass: float = 0.2, sides: int = 8
) -> ObjectAsset:
    """A regular prism that stands on one of its `sides`-gons; its inertia is that of a cylinder."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)
    vertices = np.concatenate([np.c_[ring, np.full(sides, z)] for z in (-half_height, half_height)])
    across = mass * (3 * radius**2 + 4 * half_height**2) / 12
    return convex(name, vertices, np.diag([across, across, mass * radius**2 / 2]), mass)


def trio() -> list[ObjectAsset]:
    """A box, an octagonal prism and a thin tall box: the world of most tests."""
    return [
        box("box", (0.03, 0.04, 0.05)),
        prism("prism", 0.04, 0.03),
        box("tall", (0.01, 0.01, 0.1)),
    ]


def layout_of(
    objects: Sequence[ObjectAsset],
    contact: ContactConfig | None = None,
    edit: Callable[[mujoco.MjSpec], None] | None = None,
) -> Layout:
    """Compiles `objects` on the paper's table, each parked a metre from the next and far from the table.

    Args:
      edit: a last change to the specification before it is compiled.
    """
    spec = new_spec(StabilityConfig().timestep, contact or ContactConfig())
    add_support(spec, cuboid_table())
    for index, asset in enumerate(objects):
        add_object(spec, asset, asset.name).pos = (100.0 + index, 0.0, 50.0)
    if edit is not None:
        edit(spec)
    return Layout.of(spec.compile(), TOP)


def tilted(axis: Sequence[float], degrees: float) -> np.ndarray:
    """f64[4]: the quaternion wxyz of a turn about a unit `axis`."""
    half = np.radians(degrees) / 2
    return np.r_[np.cos(half), np.sin(half) * np.asarray(axis, np.float64)]


def scene(
    layout: Layout, placed: dict[int, Sequence[float]], turned: dict[int, np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Poses and mask of a scene: positions of the `placed` objects, quaternions of those `turned`.

    Returns:
      f32[K, 7] and bool[K]; objects that are not placed are given a pose that must never be read.
    """
    poses = np.full((layout.num_objects, 7), 0.123, np.float32)
    is_placed = np.zeros(layout.num_objects, bool)
    for index, position in placed.items():
        poses[index] = (*position, 1.0, 0.0, 0.0, 0.0)
        is_placed[index] = True
    for index, quaternion in (turned or {}).items():
        poses[index, 3:] = quaternion
    return poses, is_placed
