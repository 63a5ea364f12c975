"""The MJX engines: MuJoCo in JAX, on Warp kernels or in pure XLA.

One `while_loop` steps the whole batch until every scene is decided; a decided scene is carried along unmoved.
With Warp, large batches are compacted: once few scenes are left to be decided, those alone are stepped on.
Overlaps at release and at rest, support margins and who bears whom are read in one pass over the contacts of
both moments, once the loop has ended.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from mujoco import mjx

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics import stability
from cluttergen_jax.physics.host import (
    OneScenePhysics,
    below_top,
    empty_settling,
    empty_standing,
    mask_scenes,
    one_scene,
    where,
)
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.margin import MIN_SHIFT
from cluttergen_jax.physics.mjx_scenes import (
    WARP_DEFAULTS,
    ContactRows,
    MjxScenes,
    WarpOptions,
    bearers,
    margins,
    overlaps,
    start_poses,
)
from cluttergen_jax.physics.standing import displacement, verdict_of_scene
from cluttergen_jax.types import Array, Settling, Standing, Verdict


class _Batch(struct.PyTreeNode):
    """The scenes of a batch, as they began.

    Attributes:
      start: f32[N, K, 7], world frame; is_placed, is_focus: bool[N, K].
      is_judged: bool[N], there is something to simulate.
    """

    start: Array
    is_placed: Array
    is_focus: Array
    is_judged: Array


class _Attempts(struct.PyTreeNode):
    """A batch of attempts while it runs.

    Attributes:
      data: the simulations.
      track: the rule's memory; trajectory: f32[N, T + 1, 13] (`types.Settling`).
      overflowed, is_finite: bool[N].
    """

    batch: _Batch
    data: mjx.Data
    track: stability.Track
    trajectory: Array
    overflowed: Array
    is_finite: Array

    @property
    def is_running(self) -> Array:
        """bool[N]: not decided yet."""
        return self.batch.is_judged & ~self.track.is_over & self.is_finite & ~self.overflowed


class _Checks(struct.PyTreeNode):
    """A batch of last checks while it runs."""

    batch: _Batch
    data: mjx.Data
    standing: Standing

    @property
    def is_running(self) -> Array:
        """bool[N]: not decided yet."""
        return self.batch.is_judged & (self.standing.verdict == int(Verdict.NONE))


_Run = TypeVar("_Run", _Attempts, _Checks)


_REFERENCE = (
    "compiling engine 'jax', which is a reference and none for many scenes, for {number} convex parts: half a"
    " minute for four, minutes for ninety; on a CPU it then runs tens to hundreds of times slower than engine"
    " 'native', which compiles in seconds"
)


class MjxPhysics(OneScenePhysics):
    """`host.Physics` on MJX.

    Args:
      layout: the compiled world.
      config: when an object stands still.
      impl: "warp" (an NVIDIA GPU; slowly, a CPU) or "jax" (a reference, wherever XLA runs; slow).
      options: of Warp.

    Raises:
      ConfigError: unknown `impl`.
      MissingExtraError: Warp is not installed.
    """

    def __init__(
        self,
        layout: Layout,
        config: StabilityConfig,
        impl: str = "warp",
        options: WarpOptions = WARP_DEFAULTS,
    ) -> None:
        super().__init__(config, one_scene(self.settle_batch), one_scene(self.stand_batch))
        self.layout = layout
        self.scenes = MjxScenes(layout, impl, options)
        if impl == "jax":
            self.compiling = _REFERENCE.format(number=layout.model.ngeom)

    def settle_batch(
        self, poses: Array, is_placed: Array, focus: Array, is_active: Array
    ) -> Settling:
        """`settle` for scenes with one leading axis."""
        start, is_sound = start_poses(self.layout, poses, is_placed, is_active)
        is_focus = jnp.arange(self.layout.num_objects) == focus[:, None]
        batch = _Batch(start, is_placed, is_focus, is_active & is_sound)
        run = self._run_to_end(self._release(batch), self._attempt_step, is_attempt=True)
        return self._report(run, poses, is_active)

    def _release(self, batch: _Batch) -> _Attempts:
        num_scenes, num_objects = batch.is_placed.shape
        rows = jnp.arange(num_scenes)
        focus = jnp.argmax(batch.is_focus, axis=1)
        trajectory = jnp.zeros((num_scenes, self.config.last_step + 1, 13), jnp.float32)
        return _Attempts(
            batch=batch,
            data=self.scenes.release(
                batch.start, batch.is_focus & batch.is_judged[:, None], is_attempt=True
            ),
            track=stability.new_track(jnp, (num_scenes,), num_objects, jnp.float32),
            trajectory=trajectory.at[:, 0, :7].set(batch.start[rows, focus]),
            overflowed=jnp.zeros(num_scenes, bool),
            is_finite=jnp.ones(num_scenes, bool),
        )

    def _attempt_step(self, run: _Attempts) -> _Attempts:
        scenes = self.scenes
        config = self.config
        batch = run.batch
        running = run.is_running
        rows = jnp.arange(len(running))
        focus = jnp.argmax(batch.is_focus, axis=1)
        data = scenes.step(run.data, running[:, None] & batch.is_placed, batch.is_focus)
        is_finite = scenes.is_finite(data)
        data = scenes.halt_diverged(data, is_finite, batch.start)
        velocity = scenes.velocity(data, focus)
        is_neighbour = batch.is_placed & ~batch.is_focus
        shift, turn = (
            each * is_neighbour for each in displacement(jnp, scenes.poses(data), batch.start)
        )
        motion = stability.step_motion(jnp, velocity, run.track.velocity, config)
        after = stability.advance(jnp, run.track, motion, shift, turn, config)
        row = jnp.concatenate([scenes.poses(data)[rows, focus], velocity], axis=-1)
        index = jnp.where(running, after.step, config.last_step + 1)
        return _Attempts(
            batch=batch,
            data=data,
            track=jax.tree.map(lambda new, old: where(jnp, running, new, old), after, run.track),
            trajectory=run.trajectory.at[rows, index].set(row, mode="drop"),
            overflowed=run.overflowed | (running & scenes.has_overflowed(data)),
            is_finite=run.is_finite & (is_finite | ~running),
        )

    def _run_to_end(self, run: _Run, step: Callable[[_Run], _Run], is_attempt: bool) -> _Run:
        """Steps until every scene is decided; once few are left, those alone, as a batch of their own."""
        num_scenes = len(run.batch.start)
        few = self.scenes.few_of(num_scenes)
        run = jax.lax.while_loop(lambda run: jnp.sum(run.is_running) > few, step, run)
        if not few:
            return run
        index = jnp.nonzero(run.is_running, size=few, fill_value=num_scenes)[0]
        whole = run.replace(data=None)
        part = jax.tree.map(lambda leaf: leaf.at[index].get(mode="clip"), whole)
        # What fills up the places of a smaller number is no scene.
        part = part.replace(
            batch=part.batch.replace(is_judged=part.batch.is_judged & (index < num_scenes)),
            data=self.scenes.take_scenes(run.data, index, is_attempt),
        )
        part = self._run_to_end(part, step, is_attempt)
        data = run.data.replace(qpos=run.data.qpos.at[index].set(part.data.qpos, mode="drop"))
        merged = jax.tree.map(
            lambda leaf, new: leaf.at[index].set(new, mode="drop"), whole, part.replace(data=None)
        )
        return merged.replace(batch=run.batch, data=data)

    def _report(
        self,
        run: _Attempts,
        poses: Array,
        is_active: Array,
    ) -> Settling:
        start = run.batch.start
        is_placed = run.batch.is_placed
        is_focus = run.batch.is_focus
        num_scenes, num_objects = is_placed.shape
        track = run.track
        is_finite = run.is_finite & run.batch.is_judged
        config = self.config
        final = jnp.where(
            (is_placed & is_finite[:, None])[..., None], self.scenes.poses(run.data), poses
        )
        is_at_rest = track.is_quiet & is_finite & ~run.overflowed
        focus = jnp.argmax(is_focus, axis=1)
        contacts, lost = self._contacts(self.scenes.poses(run.data), start, is_focus, is_at_rest)
        both = overlaps(contacts, self.layout, 2 * num_scenes).reshape(2, num_scenes, -1)
        # What was lost may be anybody's.
        overflowed = run.overflowed | (is_at_rest & lost)
        verdict, is_quiet = stability.verdict_of_attempt(
            jnp,
            track,
            is_focus=is_focus,
            is_neighbour=is_placed & ~is_focus,
            is_below=below_top(
                jnp, final, self.layout.center_of_mass.astype(np.float32), self.layout.top
            ),
            penetrates=stability.penetrates(jnp, both[0], both[1], config),
            overflowed=overflowed,
            is_finite=is_finite,
            config=config,
        )
        report = empty_settling(jnp, (num_scenes,), num_objects, config)
        depths = both[0].reshape(num_scenes, num_objects + 1, num_objects + 1)
        is_moved = is_placed & (is_focus | (track.shift >= MIN_SHIFT))
        margin = jnp.where(is_moved, margins(contacts, self.layout, final), jnp.inf)
        return report.replace(
            verdict=jnp.where(is_active, verdict, report.verdict),
            num_steps=track.step,
            poses=final,
            trajectory=mask_scenes(jnp, run.trajectory, is_finite),
            motion_sum=mask_scenes(jnp, track.motion_sum, is_finite),
            speed_sum=mask_scenes(jnp, track.speed_sum, is_finite),
            shift=mask_scenes(jnp, track.shift, is_finite),
            turn=mask_scenes(jnp, track.turn, is_finite),
            penetration=mask_scenes(jnp, depths.max(axis=(1, 2)), ~overflowed & is_at_rest),
            is_quiet=is_quiet,
            margin=mask_scenes(jnp, margin, is_at_rest),
            touches=mask_scenes(
                jnp, (depths[jnp.arange(num_scenes), focus] > 0)[:, :-1], is_at_rest
            ),
            bears=mask_scenes(jnp, bearers(contacts, self.layout, focus), is_at_rest),
        )

    def _contacts(
        self, final: Array, start: Array, is_focus: Array, is_at_rest: Array
    ) -> tuple[ContactRows, Array]:
        """Contacts of 2 N scenes: as they came to rest, then as they were before without the focus object.

        Objects of the others are parked: they touch nothing. See `MjxScenes.contacts`.
        """
        parked = jnp.asarray(self.layout.parked, jnp.float32)
        after = jnp.where(is_at_rest[:, None, None], final, parked)
        before = jnp.where((is_at_rest[:, None] & ~is_focus)[..., None], start, parked)
        return self.scenes.contacts(jnp.concatenate([after, before]))

    def stand_batch(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """`stand` for scenes with one leading axis."""
        start, is_sound = start_poses(self.layout, poses, is_placed, is_active)
        batch = _Batch(start, is_placed, jnp.zeros_like(is_placed), is_active & is_sound)
        blank = empty_standing(jnp, (len(poses),), self.layout.num_objects)
        data = self.scenes.release(start, is_placed & batch.is_judged[:, None], is_attempt=False)
        run = self._run_to_end(_Checks(batch, data, blank), self._check_step, is_attempt=False)
        standing = run.standing
        diverged = jnp.where(is_active & ~is_sound, int(Verdict.NON_FINITE), standing.verdict)
        return standing.replace(
            verdict=diverged,
            shift=standing.shift * is_placed,
            turn=standing.turn * is_placed,
        )

    def _check_step(self, run: _Checks) -> _Checks:
        scenes = self.scenes
        batch = run.batch
        running = run.is_running
        before = run.standing
        may_move = running[:, None] & batch.is_placed
        data = scenes.step(run.data, may_move, is_awake=may_move)
        is_finite = scenes.is_finite(data)
        data = scenes.halt_diverged(data, is_finite, batch.start)
        shift, turn = displacement(jnp, scenes.poses(data), batch.start)
        num_steps = before.num_steps + 1
        shift = jnp.maximum(before.shift, shift)
        turn = jnp.maximum(before.turn, turn)
        verdict = verdict_of_scene(jnp, num_steps, shift, turn, batch.is_placed, self.config)
        verdict = jnp.where(scenes.has_overflowed(data), int(Verdict.OVERFLOW), verdict)
        verdict = jnp.where(is_finite, verdict, int(Verdict.NON_FINITE))
        after = Standing(verdict=verdict, num_steps=num_steps, shift=shift, turn=turn)
        return _Checks(
            batch, data, jax.tree.map(lambda new, old: where(jnp, running, new, old), after, before)
        )
