"""What is asked of a place where an object has come to rest, beyond standing still."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.boxes import Boxes
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.containers import openings_of
from cluttergen_jax.placement.region import (
    box_corners,
    from_pose,
    is_in_polygon,
    is_inside,
    is_kept_out,
)
from cluttergen_jax.placement.related import RelatedObjects, carriers_of, holds_among
from cluttergen_jax.placement.support_map import map_below, most_beyond, on_map, shares_beyond
from cluttergen_jax.placement.surface_set import SurfaceSet
from cluttergen_jax.placement.types import Episode, Geometry, Start, SupportMap
from cluttergen_jax.types import Array, Settling, Verdict

_OWN_SHARE = 1 / 3
"""Of what a narrow object has on a flat table: so much support margin is asked of it at most. Of a round face
engines name four points or so, which can leave less than half of it."""


@dataclass(frozen=True, eq=False)
class Acceptance:
    """Judges places by support margin, queried region, keep-out boxes, overhang, surface and relations.

    Attributes:
      config, geometry, related, surfaces, polygon, support_map: those of `Rules`.
    """

    config: PlacementConfig
    geometry: Geometry
    related: RelatedObjects | None
    surfaces: SurfaceSet | None
    polygon: Array | None
    support_map: SupportMap | None

    def verdict(self, episode: Episode, focus: Array, settling: Settling) -> Array:
        """The attempt's verdict, i32: the simulator's, where nothing graver is found."""
        verdict = settling.verdict
        if self.config.min_margin:
            is_poor = (verdict == Verdict.STABLE) & ~self.is_supported(episode, focus, settling)
            verdict = jnp.where(is_poor, int(Verdict.UNSUPPORTED), verdict)
        pose = settling.poses[focus]
        half_extents = self.geometry.half_extents[focus]
        inside = is_inside(pose, half_extents, episode.region, self.config.containment)
        support_map = map_below(self.geometry, episode.surface, focus)
        inside &= ~is_kept_out(on_map(support_map, pose), half_extents, episode.keep_out)
        inside &= self.is_in_polygon(on_map(support_map, pose), half_extents)
        if self.surfaces is not None:
            inside &= self.surfaces.has_room(episode, focus)
        if support_map is not None:
            center = from_pose(pose).apply(self.geometry.center_of_mass[focus])
            height = episode.region.T_world_region.inverse().apply(center)[2]
            # Physics knows the lowest point of a surface alone.
            is_graver = (verdict == Verdict.OVERFLOW) | (verdict == Verdict.NON_FINITE)
            has_fallen = (height < 0) & ~is_graver & (verdict != Verdict.NONE)
            verdict = jnp.where(has_fallen, int(Verdict.FELL), verdict)
            if support_map.ceiling is not None:
                xy = on_map(support_map, pose)[:2]
                ceiling = support_map.ceiling.reshape(-1)[support_map.index_of(xy[0], xy[1])]
                inside &= height < ceiling
        if self.config.overhang != "any":
            inside &= ~self._is_beyond(episode, focus, settling)
        verdict = jnp.where((verdict == Verdict.STABLE) & ~inside, int(Verdict.OUTSIDE), verdict)
        if self.config.most_stacked is not None:
            is_stacked = jnp.any(settling.bears & episode.is_placed)
            num_stacked = jnp.sum(episode.is_placed & (episode.support_graph.level > 0))
            is_one_more = is_stacked & (num_stacked >= self.config.most_stacked)
            verdict = jnp.where(
                (verdict == Verdict.STABLE) & is_one_more, int(Verdict.UNRELATED), verdict
            )
        if self.related is None:
            return verdict
        is_related = self._is_related(self.related, episode, focus, settling)
        return jnp.where((verdict == Verdict.STABLE) & ~is_related, int(Verdict.UNRELATED), verdict)

    def _is_related(
        self, related: RelatedObjects, episode: Episode, focus: Array, settling: Settling
    ) -> Array:
        """Whether all relations hold of which both objects are placed, the focus object included; bool."""
        assert episode.roles is not None
        is_placed = episode.is_placed.at[focus].set(True)
        poses = jnp.where(is_placed[:, None], settling.poses, Start.empty(len(is_placed)).poses)
        boxes = Boxes.of(self.geometry.half_extents, poses)
        carriers = carriers_of(related, episode.roles, focus, episode.is_placed)
        is_carried = jnp.all(settling.bears | ~carriers)
        openings = openings_of(self.geometry, poses)
        return is_carried & holds_among(
            related, episode.roles, boxes, openings, is_placed, episode.region
        )

    def is_in_polygon(self, pose: Array, half_extents: Array) -> Array:
        """bool: whether an object, its pose f32[7] in the polygon's frame, is in it as far as is asked."""
        if self.polygon is None:
            return jnp.bool_(True)
        is_center = self.config.containment == "center"
        points = pose[None, :2] if is_center else box_corners(pose, half_extents)[:, :2]
        return jnp.all(is_in_polygon(points, self.polygon))

    def _is_beyond(self, episode: Episode, focus: Array, settling: Settling) -> Array:
        """Whether anything that this episode placed reaches too far beyond the support's edge; bool."""
        assert self.support_map is not None
        is_focus = jnp.arange(self.geometry.num_objects) == focus
        is_judged = (episode.is_placed | is_focus) & ~episode.is_started
        if episode.surface is None:
            shares = shares_beyond(self.support_map, self.geometry, settling.poses)
        else:
            each = jax.vmap(lambda one: shares_beyond(one, self.geometry, settling.poses))(
                self.support_map
            )
            shares = each[jnp.maximum(episode.surface, 0), jnp.arange(each.shape[1])]
        return jnp.any(is_judged & (shares > most_beyond(self.config.overhang)))

    def is_supported(self, episode: Episode, focus: Array, settling: Settling) -> Array:
        """Whether all that this episode placed, the focus object included, has the margin asked for; bool."""
        is_focus = jnp.arange(self.geometry.num_objects) == focus
        is_judged = (episode.is_placed | is_focus) & ~episode.is_started
        own = self.geometry.own_margins_at(settling.poses)
        asked = jnp.minimum(self.config.min_margin, _OWN_SHARE * own)
        return ~jnp.any(is_judged & (settling.margin < asked))
