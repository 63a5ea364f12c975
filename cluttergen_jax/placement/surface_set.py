"""Several surfaces of one support in one episode: on which of them the current object goes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.physics.margin import support_margin
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.containers import num_contained
from cluttergen_jax.placement.region import Region
from cluttergen_jax.placement.types import Episode, Geometry
from cluttergen_jax.types import Array

ROOM = 0.003
"""Metres that have to be free above the tallest object under a board."""
_LEAST_FREE = 0.02
# Metres: of a base's points, and of a margin that holds.
_TOUCHING = 1e-4
_STANDS = 0.0005

_TURNS = 16
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


def check_surface(
    objects: Sequence[ObjectAsset],
    support: SupportAsset,
    placement: PlacementConfig,
    contact: ContactConfig,
    has_region: bool,
) -> None:
    """Refuses objects that cannot stand on a slope, or under what hangs over a surface (ConfigError).

    Released upright they tip or slide whichever way they are turned; in other poses they may stand.
    """
    if not support.named:
        return
    surfaces = [surface for surface, _ in support.asked]
    if len(surfaces) > 1 and has_region:
        hint = f"surface={surfaces[0].name!r}, or no region"
        raise ConfigError("a region with several surfaces", "the surfaces' own regions", hint)
    if placement.poses != "upright":
        return
    friction = contact.friction[0]
    slope = min(surface.tilt for surface in surfaces)
    fallen = [each.name for each in objects if not _stands_on_slope(each, slope, friction)]
    if fallen:
        raise ConfigError(
            f"objects that tip, roll or slide on a slope of {math.degrees(slope):.1f} degrees, "
            f"however they are turned: {', '.join(fallen)}",
            "other objects",
            "exclude=" + repr(tuple(fallen)),
        )
    free = max(surface.free_height for surface in surfaces)
    tall = [each.name for each in objects if 2 * each.half_extents[2] + ROOM > free]
    if tall:
        raise ConfigError(
            f"objects that are too tall for {', '.join(surface.name for surface in surfaces)} of support "
            f"{support.name!r}, with {free:.3f} m of room: {', '.join(tall)}",
            "lower ones",
            "exclude=" + repr(tuple(tall)),
        )


def _stands_on_slope(asset: ObjectAsset, slope: float, friction: float) -> bool:
    """Whether a plumb line through its centre of mass meets its base for some turn, and it does not slide."""
    if slope == 0:
        return True
    vertices = np.concatenate([part.vertices for part in asset.parts])
    low = vertices[:, 2].min()
    base = vertices[vertices[:, 2] < low + _TOUCHING][:, :2]
    lean = (asset.center_of_mass[2] - low) * math.tan(slope)
    angles = 2 * np.pi * np.arange(_TURNS) / _TURNS
    centers = asset.center_of_mass[:2] + lean * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    margin = max(support_margin(base - center) for center in centers)
    own = friction if asset.friction is None else asset.friction
    return margin > _STANDS and math.tan(slope) < own
