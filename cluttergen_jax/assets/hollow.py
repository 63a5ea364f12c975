"""Hollow things: finding the cavity, and asking whether the parts leave it open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from cluttergen_jax.assets.deviation import is_within_parts
from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.assets.mjcf import add_part, new_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Cavity
from cluttergen_jax.assets.solid import Solid, Voxels
from cluttergen_jax.config import ContactConfig, StabilityConfig

BALL_RADIUS = 0.005
MAX_FILL = 0.2
_MIN_DEPTH = 0.015
# A dish whose hollow is shallower than this share of its width is flat ware, not a vessel.
_MIN_DEPTH_SHARE = 0.2
_BALL_SECONDS = 3.0


@dataclass(frozen=True, eq=False)
class HollowSpace:
    """A cavity as points of the space inside."""

    points: np.ndarray  # f64[N, 3], a cubic grid of points inside, metres.
    pitch: float  # The grid's step, metres.
    mouth: np.ndarray  # f64[3], in the opening's plane, where a ball can be dropped in.

    def rotate(self, rotation: np.ndarray) -> HollowSpace:
        """The same cavity with every point p at rotation @ p."""
        return HollowSpace(self.points @ rotation.T, self.pitch, rotation @ self.mouth)

    def fill(self, parts: Sequence[np.ndarray]) -> float:
        """The share of the cavity that convex parts cover."""
        return float(is_within_parts(self.points, parts).mean())


def known_hollow(cavity: Cavity) -> HollowSpace:
    """The cavity that a shape's author has given."""
    voxels = Voxels.of(cavity.solid, 40)
    return HollowSpace(
        voxels.centers(voxels.solid & ~voxels.surface), voxels.pitch, np.array(cavity.mouth)
    )


def find_hollow(solid: Solid) -> HollowSpace | None:
    """The largest hollow of an upright solid that would hold water, if a ball of 10 mm can enter it.

    It has to be 15 mm deep, and a fifth as deep as it is wide: plates and lids of cans are not hollow.
    """
    from scipy import ndimage

    voxels = Voxels.of(solid.mesh)
    regions, count = ndimage.label(voxels.water())
    if count == 0:
        return None
    cells = regions == 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    levels = np.flatnonzero(cells.any((0, 1)))
    top = cells[:, :, levels[-1]]
    width = np.sqrt(cells.any(2).sum()) * voxels.pitch
    depth = len(levels) * voxels.pitch
    room = ndimage.distance_transform_edt(top)
    middle = np.unravel_index(int(room.argmax()), room.shape)
    if (
        depth < max(_MIN_DEPTH, _MIN_DEPTH_SHARE * width)
        or room.max() * voxels.pitch < BALL_RADIUS + 0.001
    ):
        return None
    mouth = voxels.origin + np.array([*middle, levels[-1]]) * voxels.pitch
    return HollowSpace(voxels.centers(cells), voxels.pitch, mouth)


@lru_cache(maxsize=256)
def hollow_of(asset: ObjectAsset) -> HollowSpace | None:
    """The hollow that an object's parts leave open (`find_hollow`), or None if it has none."""
    if len(asset.parts) < 2:
        return None
    mesh = join_meshes([part.hull() for part in asset.parts])
    return find_hollow(Solid(mesh, True, mesh))


def holds_ball(parts: Sequence[np.ndarray], hollow: HollowSpace) -> bool:
    """Whether a 10 mm ball let go just above the mouth comes to rest in the cavity of the fixed parts."""
    from scipy.spatial import cKDTree

    spec = new_spec(StabilityConfig().timestep / 2, ContactConfig())
    for index, points in enumerate(parts):
        add_part(spec, spec.worldbody, f"part-{index}", points)
    above = hollow.mouth + np.array([0, 0, 1.2 * BALL_RADIUS])
    ball = spec.worldbody.add_body(name="ball", pos=above)
    ball.add_freejoint()
    # Rolling friction lets the ball come to rest in a round bowl; the parts alone decide where.
    ball.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[BALL_RADIUS, 0, 0],
        mass=0.004,
        condim=6,
        friction=(0.5, 0.005, 0.002),
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    while data.time < _BALL_SECONDS and np.isfinite(data.qpos).all():
        mujoco.mj_step(model, data)
    away = cKDTree(hollow.points).query(data.qpos[:3])[0]
    return bool(away < 1.5 * hollow.pitch and np.linalg.norm(data.qvel[:3]) < 0.02)
