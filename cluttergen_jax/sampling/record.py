"""Episodes made once more with an eye on every attempt: the same keys make the same scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import BankError
from cluttergen_jax.placement.recording import Attempt, Recording
from cluttergen_jax.placement.region import Region, pose_of_action
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.sampling.blocks import BlockSampler
from cluttergen_jax.types import Array, Settling, Verdict
from cluttergen_jax.world import World


@dataclass(frozen=True, eq=False)
class Recorder:
    """Records single episodes of a sampler; compiled at the first, quick from then on.

    Attributes:
      sampler: whose episodes.
      world: what its rules are about.
      width: the block's width. A network's sums differ by width, so scenes of a bank are made again at the
        width that made them; for scenes that nobody made before, 1 is the quickest.
    """

    sampler: BlockSampler
    world: World
    width: int = BLOCK_SIZE

    def record(self, seed: int, index: int, title: str = "") -> Recording:
        """Scene number `index` of `seed`, as `sampling.sample_blocks` makes it.

        Raises:
          BankError: what was recorded and what the rules did differ (physics that is not pure).
        """
        row = index % self.width
        places = index - row + np.arange(self.width)
        episodes = self._begin(jax.random.key(seed), places, np.arange(self.width) == row)
        attempts: list[Attempt] = []
        before = _row(episodes, row)
        while not before.is_over:
            episodes, action, settling = self._step(episodes, row)
            after = _row(episodes, row)
            attempts.append(_attempt(before, after, np.asarray(action), jax.device_get(settling)))
            before = after
        return Recording(
            title=title or f"seed {seed}, scene {index}",
            objects=self.world.objects,
            names=self.world.names,
            support=self.world.support,
            region=rectangle_of(before.region),
            attempts=tuple(attempts),
            poses=before.poses,
            is_placed=before.is_placed,
            is_success=bool(before.is_success),
            verdict=Verdict(int(before.verdict)).label,
            drift=float(before.drift),
            keep_out=_boxes(before),
        )

    @cached_property
    def _begin(self) -> Callable[..., Episode]:
        return jax.jit(self.sampler.begin)

    @cached_property
    def _step(self) -> Callable[..., tuple[Episode, Array, Settling]]:
        return jax.jit(self._recorded_step, donate_argnums=0)

    def _recorded_step(self, episodes: Episode, row: Array) -> tuple[Episode, Array, Settling]:
        """One attempt of all; the action of one row, and that row's attempt settled once more by itself.

        Physics is pure (docs/contract.md), so settling again gives what the rules saw and do not hand out.
        """
        rules = self.sampler.rules
        keys = jax.vmap(jax.random.split)(episodes.key)
        chosen = episodes.replace(key=keys[:, 1])
        actions = jax.vmap(self.sampler.propose)(keys[:, 0], episodes)
        after = jax.vmap(rules.attempt)(chosen, actions)[0]
        episode, action = jax.tree.map(lambda leaf: leaf[row], (chosen, actions))
        focus = rules.focus(episode)
        proposed = pose_of_action(action, episode.region, rules.height_range(episode))
        settling = rules.physics.settle(
            episode.poses.at[focus].set(proposed),
            episode.is_placed.at[focus].set(True),
            focus,
            ~episode.is_over,
        )
        return after, action, settling


def _row(episodes: Episode, row: int) -> Any:
    """One episode as NumPy arrays."""
    return jax.device_get(jax.tree.map(lambda leaf: leaf[row], episodes.replace(key=None)))


def _attempt(before: Any, after: Any, action: np.ndarray, settling: Any) -> Attempt:
    is_stable = bool(after.slot > before.slot)
    focus = int(before.object_index[before.slot])
    if is_stable and not np.array_equal(settling.poses[focus], after.poses[focus]):
        raise BankError(
            f"object {focus} settled elsewhere when its attempt was made again",
            hint="the stored scene, which is unharmed, or scenes made with engine='native'",
        )
    return Attempt(
        object_index=focus,
        ordinal=int(before.attempt) + 1,
        action=action,
        verdict=Verdict.STABLE if is_stable else Verdict(int(after.verdict)),
        trajectory=settling.trajectory[: int(settling.num_steps) + 1],
        poses=before.poses,
        is_placed=before.is_placed,
        settled=settling.poses,
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
        Rectangle((float(center[0]), float(center[1])), (float(half[0]), float(half[1])), float(yaw))
        for center, half, yaw in zip(keep_out.center, keep_out.half_extents, keep_out.yaw, strict=True)
    )
