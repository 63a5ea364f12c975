"""Several surfaces of one support in one episode: on which of them the current object goes."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.placement.containers import num_contained
from cluttergen_jax.placement.region import Region
from cluttergen_jax.placement.room import ROOM
from cluttergen_jax.placement.types import Episode, Geometry
from cluttergen_jax.types import Array

_LEAST_FREE = 0.02
_FAR = 100.0
"""Metres, more than any support measures."""


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
        support: SupportAsset,
        objects: Sequence[ObjectAsset],
        regions: Sequence[Region],
        is_upright: bool,
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
            index = jnp.where(episode.object_index < 0, len(footprint), episode.object_index)
            waits = jnp.zeros(len(footprint), bool).at[index].max(ranks > episode.slot, mode="drop")
            is_only = (self.fits.sum(1) == 1) & waits & (jnp.arange(len(footprint)) != focus)
            kept = jnp.maximum(left - (self.fits & is_only[:, None]).sum(0), 0)
            is_possible = jnp.any((kept > 0) & self.fits[focus])
            weight = jnp.where(is_possible, kept, jnp.maximum(left, 0))
        weight = jnp.where(self.fits[focus], weight, 0.0)
        return jax.random.categorical(key, jnp.log(weight)).astype(jnp.int32)

    def below(self, position: Array) -> Array:
        """i32: the surface next below a world position f32[3], metres; the nearest where it is over none."""

        def height(region: Region) -> tuple[Array, Array]:
            local = region.T_world_region.inverse().apply(position)
            beyond = jnp.linalg.norm(jnp.maximum(jnp.abs(local[:2]) - region.half_extents, 0.0))
            return local[2], beyond

        above, beyond = jax.vmap(height)(self.regions)
        is_over = (above >= 0) & (beyond <= 0)
        return jnp.argmin(jnp.where(is_over, above, _FAR + jnp.abs(above) + beyond)).astype(
            jnp.int32
        )

    def beside_container(
        self,
        key: Array,
        episode: Episode,
        focus: Array,
        geometry: Geometry,
        asked: float,
        drawn: Array,
    ) -> Array:
        """i32: a surface with something into which the current object fits, while more is to be inside.

        Args:
          focus: i32, the current object; asked: how many objects are to be inside of others.
          drawn: i32, the surface where there is none, or enough are inside.
        """
        hollows = geometry.hollows
        assert hollows is not None
        assert episode.surface is not None
        inside = num_contained(geometry.half_extents, hollows, episode.poses, episode.is_placed)
        surface = jnp.maximum(episode.surface, 0)
        holds = hollows.fits[focus] & episode.is_placed & self.fits[focus][surface]
        noise = jax.random.gumbel(jax.random.fold_in(key, 1), holds.shape)
        chosen = surface[jnp.argmax(jnp.where(holds, noise, -jnp.inf))]
        return jnp.where(jnp.any(holds) & (inside < asked), chosen, drawn)

    def has_room(self, episode: Episode, focus: Array) -> Array:
        """bool: whether the current object's surface has fewer objects than it is to have."""
        if self.number is None or episode.surface is None:
            return jnp.bool_(True)
        own = episode.surface[focus]
        return jnp.sum((episode.surface == own) & episode.is_placed) < self.number[own]
