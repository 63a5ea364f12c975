"""Episodes made once more, every attempt kept: the same keys make the same scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.numerics import new_key, with_own_settings
from cluttergen_jax.placement.region import Region
from cluttergen_jax.placement.rollout.replay import Attempt, Replay
from cluttergen_jax.placement.rollout.run import BlockSampler, Look, Rollout
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.types import Episode, Transition
from cluttergen_jax.placement.world import World
from cluttergen_jax.progress import track
from cluttergen_jax.types import Verdict

_AT_ONCE = 32
"""Proposals drawn side by side: a method that lowers candidates needs megabytes for each."""


@dataclass(frozen=True, eq=False)
class Recorder:
    """Records single episodes of a sampler; compiled at the first, quick from then on.

    Attributes:
      sampler: whose episodes.
      world: what its rules are about.
      width: the block's width. A network's sums differ by width, so scenes of a bank are made again at the
        width that made them; for scenes that nobody made before, 1 is the quickest.
      is_constant: see `Rollout`; as the scenes were made.
      rollouts: what is compiled, to be shared by recorders of samplers of equal sizes that are not constant.
    """

    sampler: BlockSampler
    world: World
    width: int = BLOCK_SIZE
    is_constant: bool = True
    rollouts: dict[Look, Rollout] = field(default_factory=dict)

    @with_own_settings
    def record(self, seed: int, index: int, title: str = "", num_proposals: int = 0) -> Replay:
        """Scene number `index` of `seed`, as `placement.rollout.sample_blocks` makes it.

        Args:
          num_proposals: actions that are drawn anew at every attempt, to see how they are distributed.
        """
        row = index % self.width
        places = index - row + np.arange(self.width)
        steps: list[tuple[Any, Any, Any]] = []
        look = _all_parts if num_proposals else _picture_parts
        self.rollouts.setdefault(look, Rollout(look, self.is_constant)).run(
            self.sampler,
            new_key(seed),
            places,
            np.arange(self.width) == row,
            lambda _, seen: steps.append(jax.tree.map(lambda leaf: leaf[row], seen)),
        )
        after = steps[-1][1]
        # Hundreds of proposals for each attempt take seconds.
        shown = track(steps, "proposals", len(steps), "attempt") if num_proposals else steps
        return Replay(
            title=title or f"seed {seed}, scene {index}",
            objects=self.world.objects,
            names=self.world.names,
            support=self.world.support,
            region=rectangle_of(after.region),
            # A pile has no attempts that could be shown one after another.
            attempts=()
            if self.sampler.is_whole
            else tuple(
                _attempt(before, transition, self._proposals(before, seed, num_proposals))
                for before, _, transition in shown
            ),
            poses=after.poses,
            is_placed=after.is_placed,
            is_success=bool(after.is_success),
            verdict=Verdict(int(after.verdict)).label,
            drift=float(after.drift),
            keep_out=_boxes(after),
            timestep=self.sampler.rules.physics.config.timestep,
        )

    def _proposals(self, before: Any, seed: int, number: int) -> np.ndarray | None:
        """f32[number, 4] drawn for an episode; None for none."""
        if not number:
            return None
        keys = jax.random.split(new_key(seed), number)
        return np.asarray(self._draw(keys, before))

    @cached_property
    def _draw(self) -> Any:
        propose = self.sampler.propose

        def draw(keys: Any, episode: Any) -> Any:
            return jax.lax.map(lambda key: propose(key, episode), keys, batch_size=_AT_ONCE)

        return jax.jit(draw)


def _all_parts(
    before: Episode, after: Episode, transition: Transition
) -> tuple[Any, Any, Transition]:
    """Whole steps, but for keys."""
    return before.replace(key=None), after.replace(key=None, history=None), transition


def _picture_parts(
    before: Episode, after: Episode, transition: Transition
) -> tuple[Any, Any, Transition]:
    """Whole steps, but for what pictures do not show."""
    return before.replace(key=None, history=None), after.replace(key=None, history=None), transition


def _attempt(before: Any, transition: Any, proposals: np.ndarray | None) -> Attempt:
    settling = transition.settling
    return Attempt(
        object_index=int(transition.object_index),
        ordinal=int(transition.ordinal),
        action=transition.action,
        verdict=Verdict(int(transition.verdict)),
        trajectory=settling.trajectory[: int(settling.num_steps) + 1],
        poses=before.poses,
        is_placed=before.is_placed,
        settled=settling.poses,
        proposals=proposals,
    )


def rectangle_of(region: Region) -> Rectangle:
    """A queried region as a rectangle on the support's top, on the host."""
    pose = np.asarray(region.T_world_region.wxyz_xyz, np.float64)
    half = np.asarray(region.half_extents, np.float64)
    yaw = 2.0 * float(np.arctan2(pose[3], pose[0]))
    return Rectangle((float(pose[4]), float(pose[5])), (float(half[0]), float(half[1])), yaw)


def _boxes(episode: Any) -> tuple[Rectangle, ...]:
    keep_out = episode.keep_out
    return tuple(
        Rectangle(
            (float(center[0]), float(center[1])), (float(half[0]), float(half[1])), float(yaw)
        )
        for center, half, yaw in zip(
            keep_out.center, keep_out.half_extents, keep_out.yaw, strict=True
        )
    )
