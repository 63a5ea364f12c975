"""The scene's point cloud, made from poses: every object's cloud is known."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np

from cluttergen_jax.types import Array

MAX_POINTS = 200_000
"""Of a scene's cloud."""

BARE = 0.003
"""Metres above the top from which on a place counts as taken."""

_NOT_TURNED = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class CloudLayout:
    """Who owns which points of a scene's cloud: the support's top first, then each placed object.

    Each owner's points are a prefix of a farthest-point order (the objects), or of an evenly spread sequence
    (the top); so a shorter prefix is a good sample of that owner.

    Attributes:
      num_ground: points of the top.
      share: points of each object.
      num_objects: the most that can be placed at once.
    """

    num_ground: int
    share: int
    num_objects: int

    @staticmethod
    def of(num_points: int, num_objects: int, object_points: int) -> CloudLayout:
        """Equal shares of `num_points`, none above `object_points`; the top takes what is left over."""
        share = min(num_points // (num_objects + 1), object_points)
        return CloudLayout(num_points - num_objects * share, share, num_objects)

    def prefixes(self, number: int) -> np.ndarray:
        """i32[<= number]: points of the cloud, again in equal shares: the first of each owner."""
        inner = CloudLayout.of(number, self.num_objects, self.share)
        starts = self.num_ground + self.share * np.arange(self.num_objects)
        of_objects = starts[:, None] + np.arange(inner.share)
        ground = np.arange(min(inner.num_ground, self.num_ground))
        return np.concatenate([ground, of_objects.ravel()]).astype(np.int32)


def scene_cloud(
    clouds: Array,
    T_region_object: Array,
    is_placed: Array,
    half_extents: Array,
    num_points: int,
    max_objects: int,
) -> tuple[Array, Array]:
    """The scene's point cloud in the region frame, of the layout `CloudLayout.of`.

    Args:
      clouds: f32[K, P, 3], every object's, object frame, metres, farthest-point ordered.
      T_region_object: f32[K, 7], position and quaternion wxyz; is_placed: bool[K].
      half_extents: f32[2] of the region, metres.
      num_points: N; max_objects: the most that can be placed at once (both static).

    Returns:
      f32[N, 3] metres, and bool[N], which of them count.
    """
    layout = CloudLayout.of(num_points, max_objects, clouds.shape[1])
    chosen = jnp.nonzero(is_placed, size=max_objects, fill_value=-1)[0]
    counts = chosen >= 0
    turn = jnp.where(counts[:, None], T_region_object[chosen, 3:], jnp.array(_NOT_TURNED))
    poses = jaxlie.SE3.from_rotation_and_translation(jaxlie.SO3(turn), T_region_object[chosen, :3])
    points = jax.vmap(lambda pose, cloud: jax.vmap(pose.apply)(cloud))(
        poses, clouds[chosen, : layout.share]
    )
    is_point = jnp.repeat(counts, layout.share)
    top = jnp.asarray(even_points(layout.num_ground)) * half_extents
    top = jnp.concatenate([top, jnp.zeros((layout.num_ground, 1))], axis=1)
    cloud = jnp.concatenate([top, jnp.where(is_point[:, None], points.reshape(-1, 3), 0.0)])
    return cloud, jnp.concatenate([jnp.ones(layout.num_ground, bool), is_point])


def placed_points(clouds: Array, T_region_object: Array, is_placed: Array) -> Array:
    """f32[K, P, 3], metres: every object's points in the region frame; of those not placed, the object's own.

    Args:
      clouds: f32[K, P, 3], object frames, metres; T_region_object: f32[K, 7]; is_placed: bool[K].
    """
    poses = jnp.where(is_placed[:, None], T_region_object, jnp.array((0.0, 0.0, 0.0, *_NOT_TURNED)))
    turn = jaxlie.SO3(poses[:, 3:]).as_matrix()
    return jnp.einsum("kij,kpj->kpi", turn, clouds) + poses[:, None, :3]


def even_points(number: int) -> np.ndarray:
    """Evenly spread points in [-1, 1]^2, f32[number, 2]: an additive recurrence of the plastic number.

    Each is shifted by up to a quarter of their spacing, always in the same way. By itself the recurrence is
    a lattice with countless equal distances, and rounding would decide which of two points is the nearer.
    """
    plastic = 1.32471795724474602596
    steps = np.arange(1, number + 1)[:, None] * np.array([1 / plastic, 1 / plastic**2])
    shift = np.random.default_rng(0).uniform(-0.5, 0.5, (number, 2)) / np.sqrt(max(number, 1))
    return np.clip((0.5 + steps) % 1.0 * 2 - 1 + shift, -1, 1).astype(np.float32)
