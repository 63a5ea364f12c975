"""Episodes run to their end: begin, step until all are over, finish. Ctrl-C ends it between steps.

A `EpisodeRecorder` makes single ones once more, every attempt kept: the same keys make the same scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.config import Together
from cluttergen_jax.numerics import compiler_options, new_key, with_own_settings
from cluttergen_jax.physics.host import HostPhysics
from cluttergen_jax.placement import crowd
from cluttergen_jax.placement.config import seat_of
from cluttergen_jax.placement.region import KeepOut, Region
from cluttergen_jax.placement.replay import Attempt, Replay
from cluttergen_jax.placement.rules import Proposer, Rules
from cluttergen_jax.placement.scenes import BLOCK_SIZE, SceneBatch, scene_of
from cluttergen_jax.placement.types import Episode, Start, Transition, choose
from cluttergen_jax.placement.world import World
from cluttergen_jax.progress import Progress, interruptible, track
from cluttergen_jax.types import Array, Verdict

T = TypeVar("T")


def varying_alike(tree: T) -> T:
    """A pytree whose arrays all vary over the axes of a mesh over which any of them does.

    An episode begins with constants, which are the same on every device, and with a key that is not. Outside
    of `jax.shard_map`, and where that does not ask (`check_vma=False`), it is the tree as it is.
    """
    axes = frozenset[str]().union(*map(_axes_of, jax.tree.leaves(tree)))

    def vary(leaf: Any) -> Any:
        missing = tuple(sorted(axes - _axes_of(leaf)))
        return jax.lax.pcast(leaf, missing, to="varying") if missing else leaf

    return jax.tree.map(vary, tree)


def _axes_of(leaf: Any) -> frozenset[str]:
    """The manual axes over which an array varies."""
    kind: Any = jax.typeof(leaf)
    # JAX 0.10.2 moved it.
    return kind.mat.varying if hasattr(kind, "mat") else kind.vma


class BlockSampler(struct.PyTreeNode, eq=False):
    """Episodes side by side until the last one is over; those that are over cost no physics.

    `sample` is the whole as one function to compile; `begin`, `step` and `finish` are its pieces, for drivers
    that do something between steps (`placement.rollout.Rollout`).

    Attributes:
      rules: the decision process.
      propose: who chooses the poses; a pytree, where `Rollout` runs it. One whose attribute `in_parts` is
        false is asked for all episodes together.
      keep_out, start: how every episode begins; None for nothing.
    """

    rules: Rules
    propose: Proposer
    keep_out: KeepOut | None = None
    start: Start | None = None

    how: ClassVar[Together | None] = None
    """How the engine makes each scene at once; None where it is made object by object."""

    @property
    def in_parts(self) -> bool:
        """`Rollout` asks the proposer for some episodes at a time, and for none that are over."""
        return getattr(self.propose, "in_parts", True)

    def begin(self, key: Array, indices: Array, is_wanted: Array) -> Episode:
        """Episodes for scene indices i32[N]; those not wanted (bool[N]) are over before they start."""
        keys = jax.vmap(lambda index: jax.random.fold_in(key, index))(indices)
        begin = partial(self.rules.begin, keep_out=self.keep_out, start=self.start)
        if num_sets := self.rules.config.sets:
            # Scenes of a set draw their objects with the same key.
            numbers = FIRST_SET + (jnp.asarray(indices) % num_sets).astype(jnp.uint32)
            keys_objects = jax.vmap(lambda number: jax.random.fold_in(key, number))(numbers)
            episodes = jax.vmap(lambda own, drawn: begin(own, key_objects=drawn))(
                keys, keys_objects
            )
        else:
            episodes = jax.vmap(begin)(keys)
        return episodes.replace(is_over=~is_wanted)

    def step(self, episodes: Episode) -> tuple[Episode, Transition]:
        """One attempt in every episode that is not over."""
        return jax.vmap(self.step_one)(episodes)

    def step_one(self, episode: Episode) -> tuple[Episode, Transition]:
        """One attempt, unless the episode is over."""
        return self.rules.attempt(*self.draw_action(episode))

    def draw_action(self, episode: Episode) -> tuple[Episode, Array]:
        """The episode with its next key, and the action that is proposed."""
        key_propose, key_next = jax.random.split(episode.key)
        action = self.propose(key_propose, episode)
        return episode.replace(key=key_next), action

    def finish(self, episodes: Episode) -> SceneBatch:
        """The scenes of finished episodes."""
        return jax.vmap(scene_of)(episodes)

    def sample(self, key: Array, indices: Array, is_wanted: Array) -> SceneBatch:
        """All three: a SceneBatch with leading axis N."""
        episodes = varying_alike(self.begin(key, indices, is_wanted))
        episodes = jax.lax.while_loop(
            lambda e: ~jnp.all(e.is_over), lambda e: varying_alike(self.step(e)[0]), episodes
        )
        return self.finish(episodes)


FIRST_SET = np.uint32(2**31)
"""Folded into a bank's key, with a set's number added, for what draws its objects; no scene has it."""

MAX_PROGRAMS = 16
"""Compiled steps that are kept: a program takes a few hundred of the 65,530 mappings of memory that Linux
grants a process."""

PART = 16
"""Episodes for which poses are sought together: nothing is sought where all of them are over. A divisor of
the block, so that a scene's neighbours are always the same."""

WHOLE_AT_ONCE = 16
"""Scenes of a step where each is made whole, which takes the engine some seconds."""

REFILL = 1 / 8
"""Share of the episodes side by side that have to be over before the next ones take their places."""

Look = Callable[[Episode, Episode, Transition], Any]
"""Of all episodes before and after a step, and its transitions: what is to be seen of it, a pytree."""


def _nothing(before: Episode, after: Episode, transition: Transition) -> None:
    return None


class Rollout:
    """Runs blocks of episodes.

    What a sampler knows (clouds, weights, regions) is an argument of what is compiled, so that samplers of
    equal sizes share programs; such samplers must be pytrees, their proposers included.

    Args:
      look: what `run` shows of each step.
      is_constant: compile each sampler for itself, its arrays as constants. XLA folds sums of constants
        while it compiles, so that the last bits of a network's output differ from those of `False`. Banks
        have always been made in this way: whatever makes or repeats their scenes must keep to it.
    """

    def __init__(self, look: Look = _nothing, is_constant: bool = False) -> None:
        def step(sampler: BlockSampler, episodes: Episode) -> tuple[Episode, Array, Any]:
            after, transition = sampler.step(episodes)
            return after, after.is_over, look(episodes, after, transition)

        # Functions of this rollout alone: JAX counts and clears programs by the function.
        def propose(sampler: BlockSampler, episodes: Episode) -> tuple[Any, ...]:
            return _by_parts(sampler, episodes)

        def judge(sampler: BlockSampler, *settled: Any) -> tuple[Episode, Transition, Array]:
            after, transition, is_filled = jax.vmap(sampler.rules.judge)(*settled)
            # Who reads the transition has what settled, and does not need it back.
            return after, transition.replace(settling=None), is_filled

        def refill(
            sampler: BlockSampler, key: Array, episodes: Episode, indices: Array, is_new: Array
        ) -> Episode:
            return jax.vmap(choose)(is_new, sampler.begin(key, indices, is_new), episodes)

        def ask_crowds(
            sampler: BlockSampler, episodes: Episode, is_filled: Array
        ) -> tuple[Any, ...]:
            return jax.vmap(partial(crowd.ask, sampler.rules))(episodes, is_filled)

        def conclude_crowds(
            sampler: BlockSampler,
            before: Episode,
            after: Episode,
            transition: Transition,
            *made: Any,
        ) -> tuple[Episode, Array, Any]:
            after = jax.vmap(partial(crowd.conclude, sampler.rules))(after, *made)
            return after, after.is_over, look(before, after, transition)

        def conclude(
            sampler: BlockSampler,
            before: Episode,
            after: Episode,
            transition: Transition,
            *checked: Any,
        ) -> tuple[Episode, Array, Any]:
            after = jax.vmap(sampler.rules.conclude)(after, *checked)
            return after, after.is_over, look(before, after, transition)

        def ask(sampler: Any, episodes: Episode, is_due: Array) -> tuple[Any, ...]:
            return jax.vmap(sampler.ask)(episodes, is_due)

        def finish_piles(
            sampler: Any, before: Episode, asking: Episode, piling: Any
        ) -> tuple[Episode, Array, Any]:
            after, transition = jax.vmap(sampler.finish_pile)(before, asking, piling)
            return after, after.is_over, look(before, after, transition)

        self._programs: list[Any] = []

        def program(function: Callable[..., Any], donated: tuple[int, ...] = ()) -> Any:
            made = jax.jit(
                function,
                static_argnums=(0,) if is_constant else (),
                donate_argnums=donated,
                compiler_options=compiler_options(),
            )
            self._programs.append(made)
            return made

        self._ask = program(ask)
        self._finish_piles = program(finish_piles)
        self._begin = program(lambda sampler, *args: sampler.begin(*args))
        self._step = program(step, (1,))
        self._refill = program(refill, (2,))
        self._propose = program(propose)
        self._judge = program(judge)
        self._conclude = program(conclude)
        self._ask_crowds = program(ask_crowds)
        self._conclude_crowds = program(conclude_crowds)
        self._finish = program(lambda sampler, *args: sampler.finish(*args))

    @property
    def num_programs(self) -> int:
        """How many steps are compiled."""
        return sum(each._cache_size() for each in (self._step, self._propose, self._ask))

    def compile(
        self, sampler: BlockSampler, key: Array, indices: np.ndarray, is_refilled: bool = True
    ) -> None:
        """Compiles for `run` and `run_all` with arguments like these, by a step without an attempt.

        Args:
          is_refilled: more scenes than places will be asked for.
        """
        if self.num_programs >= MAX_PROGRAMS:
            for each in self._programs:
                each.clear_cache()
        nothing = np.zeros(len(indices), bool)
        episodes = interruptible(self._begin, sampler, key, indices, nothing)
        episodes, *_ = interruptible(self._step_all, sampler, episodes)
        if is_refilled:
            episodes = interruptible(self._refill, sampler, key, episodes, indices, nothing)
        jax.block_until_ready(interruptible(self._finish, sampler, episodes))

    def _step_all(self, sampler: BlockSampler, episodes: Episode) -> tuple[Episode, Array, Any]:
        """One attempt in every episode; which are over, bool[N]; and what `look` sees.

        An engine on the host is called between compiled pieces. As one program with calls back into Python
        it could not be kept on disk by JAX, and each process would compile it anew.
        """
        physics = sampler.rules.simulator
        if not isinstance(physics, HostPhysics):
            return self._step(sampler, episodes)
        if sampler.how is not None:
            is_left = ~np.asarray(episodes.is_over)
            is_due = is_left & (np.cumsum(is_left) <= WHOLE_AT_ONCE)
            asking, *asked = self._ask(sampler, episodes, is_due)
            piling = physics.make_batch(sampler.how, *map(np.asarray, asked))
            return self._finish_piles(sampler, episodes, asking, piling)
        episodes, action, *asked = self._propose(sampler, episodes)
        settling = physics.settle_batch(*map(np.asarray, asked))
        after, transition, is_filled = self._judge(sampler, episodes, action, settling)
        transition = transition.replace(settling=settling)
        if sampler.rules.is_crowded:
            asked = self._ask_crowds(sampler, after, is_filled)
            piling = physics.make_batch("crowd", *map(np.asarray, asked))
            made = piling, is_filled
            return self._conclude_crowds(sampler, episodes, after, transition, *made)
        standing = physics.stand_batch(*map(np.asarray, (after.poses, after.is_placed, is_filled)))
        return self._conclude(sampler, episodes, after, transition, standing, is_filled)

    def run(
        self,
        sampler: BlockSampler,
        key: Array,
        indices: np.ndarray,
        is_wanted: np.ndarray,
        on_step: Callable[[int, Any], None] = lambda number, seen: None,
    ) -> SceneBatch:
        """The scenes of a block, NumPy arrays with leading axis N.

        Args:
          key, indices, is_wanted: of its `begin`.
          on_step: told after each step how many more episodes are over, and what `look` sees, on the host.
        """
        episodes = interruptible(self._begin, sampler, key, indices, is_wanted)
        left = int(is_wanted.sum())
        while left:
            before = left
            episodes, is_over, seen = interruptible(self._step_to_host, sampler, episodes)
            left = int((~is_over).sum())
            on_step(before - left, seen)
        return interruptible(self._finish_to_host, sampler, episodes)

    def _step_to_host(
        self, sampler: BlockSampler, episodes: Episode
    ) -> tuple[Episode, np.ndarray, Any]:
        """`_step_all`, all but the episodes on the host."""
        episodes, is_over, seen = self._step_all(sampler, episodes)
        return episodes, *jax.device_get((is_over, seen))

    def _finish_to_host(self, sampler: BlockSampler, episodes: Episode) -> SceneBatch:
        return jax.device_get(self._finish(sampler, episodes))

    def propose(self, sampler: BlockSampler, episodes: Episode) -> np.ndarray:
        """f32[N, 4], on the host: the actions that are proposed in the episodes of a block."""
        _, action, *_ = self._propose(sampler, episodes)
        return np.asarray(action)

    def run_all(
        self,
        sampler: BlockSampler,
        key: Array,
        num_scenes: int,
        width: int = BLOCK_SIZE,
        on_step: Callable[[np.ndarray, int, Any], None] = lambda indices, number, seen: None,
    ) -> SceneBatch:
        """Scenes 0 to num_scenes - 1, `width` side by side: NumPy arrays, as those of `run`.

        Where a scene is over the next one takes its place, so that few wait for the slowest.

        Args:
          on_step: as that of `run`, and before it which scenes stand in the places, i64[width].
        """
        indices = np.arange(width)
        following = width
        # Scenes that are not stored yet, by place; those that were never wanted are over from the beginning.
        is_held = indices < num_scenes
        parts: list[SceneBatch] = []
        order: list[np.ndarray] = []
        episodes = interruptible(self._begin, sampler, key, indices, is_held)
        was_over = ~is_held
        while is_held.any():
            episodes, is_over, seen = interruptible(self._step_to_host, sampler, episodes)
            on_step(indices, int((is_over & ~was_over).sum()), seen)
            was_over = is_over
            is_done = is_over & is_held
            is_few = is_done.sum() < REFILL * width and (is_held & ~is_done).any()
            if is_few or not is_done.any():
                continue
            rows = np.flatnonzero(is_done)
            scenes = interruptible(self._finish_to_host, sampler, episodes)
            parts.append(jax.tree.map(lambda leaf, rows=rows: leaf[rows], scenes))
            order.append(indices[rows])
            rows = rows[: max(num_scenes - following, 0)]
            is_new = np.isin(np.arange(width), rows)
            is_held = is_held & ~is_done | is_new
            if len(rows):
                indices = indices.copy()
                indices[rows] = following + np.arange(len(rows))
                following += len(rows)
                episodes = interruptible(self._refill, sampler, key, episodes, indices, is_new)
                was_over = is_over & ~is_new
        by_scene = np.argsort(np.concatenate(order))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[by_scene], *parts)


def _propose_batch(sampler: BlockSampler, episodes: Episode) -> tuple[Any, ...]:
    episodes, action = jax.vmap(sampler.draw_action)(episodes)
    return episodes, action, *jax.vmap(sampler.rules.release)(episodes, action)


def _by_parts(sampler: BlockSampler, episodes: Episode) -> tuple[Any, ...]:
    """What is proposed in all episodes, `PART` by `PART`; zeros where all of a part are over."""
    number = len(episodes.is_over)
    if not sampler.in_parts or number % PART:
        return _propose_batch(sampler, episodes)

    def propose(part: Episode) -> tuple[Any, ...]:
        return _propose_batch(sampler, part)

    def nothing(part: Episode) -> tuple[Any, ...]:
        action = jnp.zeros((PART, _ACTION_SIZE), jnp.float32)
        # What an action leads to has shapes that need no proposer, which takes a second to trace.
        asked = jax.eval_shape(jax.vmap(sampler.rules.release), part, action)
        return part, action, *jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), asked)

    parts = jax.tree.map(lambda leaf: leaf.reshape(number // PART, PART, *leaf.shape[1:]), episodes)
    found = jax.lax.map(
        lambda part: jax.lax.cond(jnp.all(part.is_over), nothing, propose, part), parts
    )
    return jax.tree.map(lambda leaf: leaf.reshape(number, *leaf.shape[2:]), found)


def blocks_of(num_scenes: int) -> list[tuple[int, int]]:
    """(block number, scenes in it) for scenes 0 to num_scenes - 1."""
    firsts = range(0, num_scenes, BLOCK_SIZE)
    return [(first // BLOCK_SIZE, min(BLOCK_SIZE, num_scenes - first)) for first in firsts]


def sample_blocks(
    sampler: BlockSampler, blocks: Sequence[tuple[int, int]], seed: int, title: str = "placing"
) -> Iterator[tuple[int, np.ndarray, SceneBatch]]:
    """Samples blocks, compiling once.

    Every block is computed at full width, so that a scene does not depend on how many were asked for.

    Yields:
      The block's number, its scene indices i32[n], and its scenes as NumPy arrays with leading axis n.
    """
    rollout = Rollout(is_constant=True)

    def count(number: int, _: Any) -> None:
        progress.rename(title)
        progress.update(number)

    with Progress("compiling", sum(rows for _, rows in blocks), "scene") as progress:
        progress.say(sampler.rules.simulator.compiling)
        for block, rows in blocks:
            yield block, *sample_block(rollout, sampler, block, rows, seed, count)


def sample_block(
    rollout: Rollout,
    sampler: BlockSampler,
    block: int,
    rows: int,
    seed: int,
    on_step: Callable[[int, Any], None] = lambda number, seen: None,
) -> tuple[np.ndarray, SceneBatch]:
    """The scene indices i32[n] of one block, and its scenes, as `sample_blocks` yields them."""
    place = np.arange(BLOCK_SIZE)
    indices = block * BLOCK_SIZE + place
    scenes = rollout.run(sampler, new_key(seed), indices, place < rows, on_step)
    return indices[:rows], jax.tree.map(lambda array: array[:rows], scenes)


_ACTION_SIZE = 4
"""Numbers of an action: x, y, z and a turn about z."""
_AT_ONCE = 32
"""Proposals drawn side by side: a method that lowers candidates needs megabytes for each."""


@dataclass(frozen=True, eq=False)
class EpisodeRecorder:
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
    def record(
        self,
        seed: int,
        index: int,
        title: str = "",
        num_proposals: int = 0,
        last_only: bool = False,
    ) -> Replay:
        """Scene number `index` of `seed`, as `placement.rollout.sample_blocks` makes it.

        Args:
          num_proposals: actions that are drawn anew at every attempt, to see how they are distributed.
          last_only: draw them at the first attempt of the last object's last turn alone: each costs seconds.
        """
        row = index % self.width
        places = index - row + np.arange(self.width)
        steps: list[tuple[Any, Any, Any]] = []
        rollout = self._rollout(num_proposals)
        rollout.run(
            self.sampler,
            new_key(seed),
            places,
            np.arange(self.width) == row,
            lambda _, seen: steps.append(jax.tree.map(lambda leaf: leaf[row], seen)),
        )
        after = steps[-1][1]
        attempts = []
        # What is made at once has no attempts that could be shown one after another.
        for before, later, transition in steps if self.sampler.how is None else ():
            attempt = Attempt.of(before, transition, transition.settling)
            attempts.append(replace(attempt, gathered=self._poses_after_crowd(attempt, later)))
        made = Replay(
            title=title or f"seed {seed}, scene {index}",
            objects=self.world.objects,
            names=self.world.names,
            support=self.world.support,
            region=rectangle_of(after.region),
            attempts=tuple(attempts),
            poses=after.poses,
            is_placed=after.is_placed,
            is_success=bool(after.is_success),
            verdict=Verdict(int(after.verdict)).label,
            drift=float(after.drift),
            keep_out=_keep_out_boxes(after),
            timestep=self.sampler.rules.physics.config.timestep,
            seat=seat_of(self.sampler.rules.config),
        )
        if not (num_proposals and attempts):
            return made
        # Hundreds of proposals for each attempt take seconds.
        shown = track(range(len(attempts)), "proposals", len(attempts), "attempt")
        if last_only:
            shown = iter([attempts.index(made.last_turn(attempts[-1].object_index)[0])])
        for place in shown:
            proposals = self._proposals(steps[place][0], seed, num_proposals)
            attempts[place] = replace(attempts[place], proposals=proposals)
        return replace(made, attempts=tuple(attempts))

    def _poses_after_crowd(self, attempt: Attempt, after: Any) -> np.ndarray | None:
        """f32[K, 7]: see `Attempt.gathered`."""
        if not self.sampler.rules.is_crowded or not attempt.is_stable:
            return None
        poses = np.where(np.asarray(after.is_placed)[:, None], after.poses, attempt.settled)
        return None if np.array_equal(poses, attempt.settled) else poses

    def _rollout(self, num_proposals: int) -> Rollout:
        """Who runs the block, and shows of it what is needed."""
        look = _all_parts if num_proposals else _picture_parts
        return self.rollouts.setdefault(look, Rollout(look, self.is_constant))

    def _proposals(self, before: Any, seed: int, number: int) -> np.ndarray:
        """f32[number, 4] drawn for an episode."""
        keys = jax.random.split(new_key(seed), number)
        if self.width < _AT_ONCE:
            return np.asarray(self._draw(keys, before))
        # The block's own program is compiled and traced already.
        rollout = self._rollout(number)
        episodes = jax.tree.map(
            lambda leaf: np.broadcast_to(leaf, (self.width, *leaf.shape)), before
        )
        drawn = []
        for first in range(0, number, self.width):
            chosen = np.arange(first, first + self.width) % number
            drawn.append(rollout.propose(self.sampler, episodes.replace(key=keys[chosen])))
        return np.concatenate(drawn)[:number]

    @cached_property
    def _draw(self) -> Any:
        propose = self.sampler.propose

        def draw(keys: Any, episode: Any) -> Any:
            return jax.lax.map(lambda key: propose(key, episode), keys, batch_size=_AT_ONCE)

        return jax.jit(draw, compiler_options=compiler_options())


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


def rectangle_of(region: Region) -> Rectangle:
    """A queried region as a rectangle on the support's top, on the host."""
    pose = np.asarray(region.T_world_region.wxyz_xyz, np.float64)
    half = np.asarray(region.half_extents, np.float64)
    return _rectangle(pose[4:6], half, 2.0 * float(np.arctan2(pose[3], pose[0])))


def _rectangle(center: np.ndarray, half: np.ndarray, yaw: float) -> Rectangle:
    return Rectangle(
        (float(center[0]), float(center[1])), (float(half[0]), float(half[1])), float(yaw)
    )


def _keep_out_boxes(episode: Any) -> tuple[Rectangle, ...]:
    keep_out = episode.keep_out
    boxes = zip(keep_out.center, keep_out.half_extents, keep_out.yaw, strict=True)
    return tuple(_rectangle(*box) for box in boxes)
