"""Several surfaces of one support in one episode: on which of them the current object goes."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.placement.region import Region
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array

ROOM = 0.003
"""Metres that have to be free above the tallest object under a board."""
_LEAST_FREE = 0.02


class SurfaceSet(struct.PyTreeNode):
    """N surfaces, K objects.

    Attributes:
      regions: the queried region of each, a leading axis of N.
      area: f32[N], of the regions, square metres.
      fits: bool[K, N], whether an object is low enough for what hangs over a surface.
      number: i32[N], how many objects are to be on each; None where area decides.
    """

    regions: Region
    area: Array
    fits: Array
    number: Array | None

    @staticmethod
    def of(
        support: SupportAsset, objects: Sequence[ObjectAsset], regions: Sequence[Region], is_upright: bool
    ) -> SurfaceSet:
        """Those that a support is asked for, and their regions.

        Args:
          is_upright: whether all objects are released so; else they may be lower, as low as their least side.
        """
        asked = support.asked
        sides = 2 * np.array([asset.half_extents for asset in objects])
        height = sides[:, 2] if is_upright else sides.min(1)
        free = np.array([surface.free_height for surface, _ in asked])
        area = [4 * np.prod(surface.region.half_extents) for surface, _ in asked]
        numbers = [number for _, number in asked]
        return SurfaceSet(
            regions=jax.tree.map(lambda *leaves: jnp.stack(leaves), *regions),
            area=jnp.array(area, jnp.float32),
            fits=jnp.array(height[:, None] + ROOM <= free),
            number=jnp.array(numbers, jnp.int32) if all(numbers) else None,
        )

    def region(self, index: Array) -> Region:
        """The region of one surface."""
        return jax.tree.map(lambda leaf: leaf[index], self.regions)

    def draw(self, key: Array, episode: Episode, focus: Array, footprint: Array) -> Array:
        """i32: the surface for the current object: by free area, or by the numbers that are left.

        Args:
          focus: i32, the current object; footprint: f32[K], square metres.
        """
        number = self.area.shape[0]
        is_on = jax.nn.one_hot(episode.surface, number) * episode.is_placed[:, None]
        if self.number is None:
            free = self.area - footprint @ is_on
            weight = jnp.maximum(free, _LEAST_FREE * self.area)
        else:
            left = self.number - is_on.sum(0)
            # What fits nowhere else keeps its place.
            ranks = jnp.arange(len(episode.object_index))
            waits = jnp.zeros(len(footprint), bool).at[episode.object_index].max(ranks > episode.slot)
            is_only = (self.fits.sum(1) == 1) & waits & (jnp.arange(len(footprint)) != focus)
            kept = jnp.maximum(left - (self.fits & is_only[:, None]).sum(0), 0)
            is_possible = jnp.any((kept > 0) & self.fits[focus])
            weight = jnp.where(is_possible, kept, jnp.maximum(left, 0))
        weight = jnp.where(self.fits[focus], weight, 0.0)
        return jax.random.categorical(key, jnp.log(weight)).astype(jnp.int32)
