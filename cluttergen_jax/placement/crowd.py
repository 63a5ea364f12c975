"""Crowds: what stands apart, once all of it is placed, drawn together until it touches.

The engine draws the objects together, brings them to rest and makes the last check (`physics.crowds`). Here
is what it is asked, and what the rules of places say of what came of it: few objects end where they were
put, so that regions, boxes to keep out of, edges and relations are looked at again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.heightmap import map_below, on_map
from cluttergen_jax.placement.region import is_inside, is_kept_out, safe_poses, to_pose
from cluttergen_jax.placement.related import ON, holds_among
from cluttergen_jax.placement.types import Episode, choose
from cluttergen_jax.types import Array, Piling, Verdict

if TYPE_CHECKING:
    from cluttergen_jax.placement.rules import Rules

TRIES = 3
"""How often the engine begins anew, in other groups and more slowly, before it gives a scene up."""


def ask(rules: Rules, episode: Episode, is_due: Array) -> tuple[Array, ...]:
    """What `HostPhysics.crowd` is asked of a scene whose slots are all filled.

    Args:
      is_due: bool, whether it is to be drawn together now.
    """
    targets = rules.config.crowd_targets
    assert targets is not None
    side, lean = targets
    num_objects = rules.geometry.num_objects
    key = rules.new_key(episode, 7)
    keep_out = episode.keep_out
    boxes = (keep_out.center, keep_out.half_extents, keep_out.yaw[:, None])
    return (
        episode.poses,
        episode.is_placed,
        jax.random.uniform(key, (TRIES, num_objects)),
        jnp.append(to_pose(episode.region.T_world_region), episode.region.half_extents),
        rules.geometry.half_extents,
        jnp.float32(rules.config.containment == "footprint"),
        jnp.concatenate(boxes, axis=1),
        rules.asked_margins(episode.poses),
        jnp.float32(side),
        jnp.float32(lean),
        jnp.bool_(lean > 0 or rules.config.poses != "upright"),
        jnp.bool_(lean == 0 and rules.config.natural),
        is_due,
    )


def conclude(rules: Rules, episode: Episode, piling: Piling, is_due: Array) -> Episode:
    """The episode after it was drawn together, where that was due; else as it is.

    What tipped over or lies where it may not is taken away, and comes again, while attempts are left.
    """
    stays = episode.is_placed & ~piling.is_left_out
    is_well = _lies_well(rules, episode, piling) | ~stays
    is_related = _is_related(rules, episode, piling)
    verdict = piling.verdict
    has_margin = ~(stays & rules.lacks_margin(piling))
    complaints = (
        (jnp.all(has_margin), Verdict.UNSUPPORTED),
        (jnp.all(is_well) & ~jnp.any(piling.is_left_out), Verdict.OUTSIDE),
        (is_related, Verdict.UNRELATED),
    )
    for holds, other in complaints:
        verdict = jnp.where((verdict == Verdict.STABLE) & ~holds, int(other), verdict)
    stands = piling.verdict == Verdict.STABLE
    is_success = verdict == Verdict.STABLE
    graph = episode.support_graph
    level = piling.level
    # What touches from the side does not lean.
    crowded = graph.replace(leans_on=piling.touches & (level[:, None] > level), level=level)
    counts = episode.counts
    num_steps = piling.num_steps + piling.check_steps
    after = episode.replace(
        poses=jnp.where((stands & stays)[:, None], piling.poses, episode.poses),
        is_over=jnp.bool_(True),
        is_success=is_success,
        verdict=verdict.astype(jnp.int32),
        drift=piling.drift,
        num_beside=jnp.where(is_success, piling.num_beside, 0),
        num_leaning=jnp.where(is_success, piling.num_leaning, 0),
        support_graph=choose(stands, crowded, graph),
        counts=counts.replace(simulated_steps=counts.simulated_steps + num_steps),
    )
    misplaced = ~is_well | ~has_margin | piling.is_left_out
    misplaced |= (verdict == Verdict.UNRELATED) & _has_role(episode)
    again = rules.place_again(after, misplaced, 8)
    is_again = stands & ~is_success & ~rules.is_spent(again)
    return choose(is_due, choose(is_again, again, after), episode)


def _lies_well(rules: Rules, episode: Episode, piling: Piling) -> Array:
    """bool[K]: what is not placed, or lies where it may."""
    half = rules.geometry.half_extents

    def lies_well(index: Array) -> Array:
        pose = piling.poses[index]
        placed = on_map(map_below(rules.geometry, episode.surface, index), pose)
        is_well = is_inside(pose, half[index], episode.region, rules.config.containment)
        is_well &= ~is_kept_out(placed, half[index], episode.keep_out)
        return is_well & rules.is_in_polygon(placed, half[index])

    is_well = jax.vmap(lies_well)(jnp.arange(rules.geometry.num_objects))
    if rules.config.overhang != "any":
        is_well &= ~rules.reaches_beyond(episode, piling.poses)
    return is_well | ~episode.is_placed


def _is_related(rules: Rules, episode: Episode, piling: Piling) -> Array:
    """bool: whether all relations hold."""
    if rules.related is None:
        return jnp.bool_(True)
    assert episode.roles is not None
    poses = safe_poses(piling.poses, episode.is_placed)
    subject, reference, is_table = rules.related.ends(episode.roles)
    is_carried = piling.touches[subject, reference]
    is_carried &= piling.level[subject] > piling.level[reference]
    is_on = is_carried | is_table | (rules.related.kind != ON)
    return jnp.all(is_on) & holds_among(
        rules.related, episode.roles, rules.geometry, poses, episode.is_placed, episode.region
    )


def _has_role(episode: Episode) -> Array:
    """bool[K]: the objects of relations; all that are placed where there are none."""
    if episode.roles is None:
        return episode.is_placed
    return jnp.zeros_like(episode.is_placed).at[episode.roles].set(True)
