"""The MJX engines: MuJoCo in JAX, on Warp kernels or in pure XLA.

One `while_loop` steps the whole batch until every scene is decided; a decided scene is carried along unmoved.
ContactRows are those of the poses from which a step starts, so the loop makes one step more at its end: all
scenes stand still then, and the contacts are those of the final poses.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from mujoco import mjx

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics import stability
from cluttergen_jax.physics.batching import one_scene
from cluttergen_jax.physics.host import OneScenePhysics
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.margin import MIN_SHIFT
from cluttergen_jax.physics.mjx_scenes import MjxScenes, start_poses
from cluttergen_jax.physics.report import below_top, empty_settling, empty_standing, kept
from cluttergen_jax.types import Array, Settling, Standing, Verdict


class _Attempts(struct.PyTreeNode):
    """A batch of attempts while it runs.

    Attributes:
      data: the simulations.
      track: the rule's memory; trajectory: f32[N, T + 1, 13].
      overflowed, is_finite: bool[N].
      depth_before: f32[N, K + 1, K + 1], overlap of every pair at release.
      is_first, goes_on: bool, no step was made yet; another one is wanted.
    """

    data: mjx.Data
    track: stability.Track
    trajectory: Array
    overflowed: Array
    is_finite: Array
    depth_before: Array
    is_first: Array
    goes_on: Array


class _Checks(struct.PyTreeNode):
    """A batch of last checks while it runs."""

    data: mjx.Data
    standing: Standing


class MjxPhysics(OneScenePhysics):
    """`protocol.Physics` on MJX.

    Args:
      layout: the compiled world.
      config: when an object stands still.
      impl: "warp" (an NVIDIA GPU; slowly, a CPU) or "jax" (wherever XLA runs, for few simple objects: it
        compiles a collision function for every pair of distinct meshes).
      num_contacts, num_rows: room for contacts and constraint rows of a scene; None measures what is needed.

    Raises:
      ConfigError: unknown `impl`.
      MissingExtraError: Warp is not installed.
    """

    def __init__(
        self,
        layout: Layout,
        config: StabilityConfig,
        impl: str = "warp",
        num_contacts: int | None = None,
        num_rows: int | None = None,
    ) -> None:
        super().__init__(config, one_scene(self.settle_batch), one_scene(self.stand_batch))
        self.layout = layout
        self.scenes = MjxScenes(layout, impl, num_contacts, num_rows)

    def settle_batch(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        """`settle` for scenes with one leading axis."""
        scenes, config = self.scenes, self.config
        start, is_sound = start_poses(self.layout, poses, is_placed, is_active)
        is_focus = jnp.arange(self.layout.num_objects) == focus[:, None]
        is_neighbour = is_placed & ~is_focus
        is_judged = is_active & is_sound
        rows = jnp.arange(len(poses))

        def is_running(run: _Attempts) -> Array:
            return is_judged & ~run.track.is_over & run.is_finite & ~run.overflowed

        def step(run: _Attempts) -> _Attempts:
            running = is_running(run)
            data = scenes.step(run.data, running[:, None] & is_placed)
            is_finite = scenes.is_finite(data)
            data = scenes.halted(data, is_finite, start)
            velocity = scenes.velocity(data, focus)
            shift, turn = stability.moved(jnp, scenes.poses(data), start)
            after = stability.advance(
                jnp, run.track, velocity, shift * is_neighbour, turn * is_neighbour, config
            )
            row = jnp.concatenate([scenes.poses(data)[rows, focus], velocity], axis=-1)
            index = jnp.where(running, after.step, config.max_steps + 1)
            # The overlap of a scene at rest is read in the extra step, so that must have lost nothing either.
            counts = running | (run.track.is_quiet & ~jnp.any(running))
            return _Attempts(
                data=data,
                track=jax.tree.map(lambda new, old: _where(running, new, old), after, run.track),
                trajectory=run.trajectory.at[rows, index].set(row, mode="drop"),
                overflowed=run.overflowed | (counts & scenes.overflowed(data)),
                is_finite=run.is_finite & (is_finite | ~running),
                depth_before=jax.lax.cond(
                    run.is_first, lambda: scenes.depths(data), lambda: run.depth_before
                ),
                is_first=jnp.asarray(False),
                goes_on=jnp.any(running),
            )

        run = jax.lax.while_loop(lambda run: run.goes_on, step, self._released(start, focus, is_judged))
        return self._report(run, poses, is_placed, is_focus, is_judged, is_active)

    def _released(self, start: Array, focus: Array, is_judged: Array) -> _Attempts:
        num_scenes, num_objects = start.shape[:2]
        rows = jnp.arange(num_scenes)
        trajectory = jnp.zeros((num_scenes, self.config.max_steps + 1, 13), jnp.float32)
        return _Attempts(
            data=self.scenes.release(start),
            track=stability.new_track(jnp, (num_scenes,), num_objects, jnp.float32),
            trajectory=trajectory.at[:, 0, :7].set(start[rows, focus]),
            overflowed=jnp.zeros(num_scenes, bool),
            is_finite=jnp.ones(num_scenes, bool),
            depth_before=jnp.zeros((num_scenes, num_objects + 1, num_objects + 1)),
            is_first=jnp.asarray(True),
            goes_on=jnp.any(is_judged),
        )

    def _report(
        self,
        run: _Attempts,
        poses: Array,
        is_placed: Array,
        is_focus: Array,
        is_judged: Array,
        is_active: Array,
    ) -> Settling:
        num_scenes, num_objects = is_placed.shape
        track, is_finite, config = run.track, run.is_finite & is_judged, self.config
        depths = self.scenes.depths(run.data) * track.is_quiet[:, None, None]
        # A pair of the focus object had no resting overlap before the attempt.
        has_focus = jnp.pad(is_focus, ((0, 0), (0, 1)))
        before = jnp.where(has_focus[:, :, None] | has_focus[:, None, :], 0.0, run.depth_before)
        final = jnp.where((is_placed & is_finite[:, None])[..., None], self.scenes.poses(run.data), poses)
        verdict, is_quiet = stability.verdict_of_attempt(
            jnp,
            track,
            is_focus=is_focus,
            is_neighbour=is_placed & ~is_focus,
            is_below=below_top(jnp, final, self.layout.center_of_mass.astype(np.float32), self.layout.top),
            penetrates=stability.penetrates(
                jnp, depths.reshape(num_scenes, -1), before.reshape(num_scenes, -1), config
            ),
            overflowed=run.overflowed,
            is_finite=is_finite,
            config=config,
        )
        report = empty_settling(jnp, (num_scenes,), num_objects, config)
        deepest = jnp.where(run.overflowed, 0.0, depths.max(axis=(1, 2)))
        is_at_rest, focus = track.is_quiet & is_finite, jnp.argmax(is_focus, axis=1)
        return report.replace(
            verdict=jnp.where(is_active, verdict, report.verdict),
            num_steps=track.step,
            poses=final,
            trajectory=kept(jnp, run.trajectory, is_finite),
            motion_sum=kept(jnp, track.motion_sum, is_finite),
            speed_sum=kept(jnp, track.speed_sum, is_finite),
            shift=kept(jnp, track.shift, is_finite),
            turn=kept(jnp, track.turn, is_finite),
            penetration=kept(jnp, deepest, is_finite),
            is_quiet=is_quiet,
            margin=kept(jnp, self._margins(run, final, is_placed, is_focus), is_at_rest),
            touches=kept(jnp, (depths[jnp.arange(num_scenes), focus] > 0)[:, :-1], is_at_rest),
            bears=kept(jnp, self.scenes.bearers(run.data, focus), is_at_rest),
        )

    def _margins(self, run: _Attempts, final: Array, is_placed: Array, is_focus: Array) -> Array:
        """f32[N, K]: see `Settling.margin`."""
        is_moved = is_placed & (is_focus | (run.track.shift >= MIN_SHIFT))
        return jnp.where(is_moved, self.scenes.margins(run.data, final), jnp.inf)

    def stand_batch(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """`stand` for scenes with one leading axis."""
        scenes, config = self.scenes, self.config
        start, is_sound = start_poses(self.layout, poses, is_placed, is_active)
        is_judged = is_active & is_sound

        def is_running(run: _Checks) -> Array:
            return is_judged & (run.standing.verdict == int(Verdict.NONE))

        def step(run: _Checks) -> _Checks:
            running, before = is_running(run), run.standing
            data = scenes.step(run.data, running[:, None] & is_placed)
            is_finite = scenes.is_finite(data)
            data = scenes.halted(data, is_finite, start)
            shift, turn = stability.moved(jnp, scenes.poses(data), start)
            num_steps = before.num_steps + 1
            shift, turn = jnp.maximum(before.shift, shift), jnp.maximum(before.turn, turn)
            verdict = stability.verdict_of_scene(jnp, num_steps, shift, turn, is_placed, config)
            verdict = jnp.where(scenes.overflowed(data), int(Verdict.OVERFLOW), verdict)
            verdict = jnp.where(is_finite, verdict, int(Verdict.NON_FINITE))
            after = Standing(verdict=verdict, num_steps=num_steps, shift=shift, turn=turn)
            return _Checks(data, jax.tree.map(lambda new, old: _where(running, new, old), after, before))

        blank = empty_standing(jnp, (len(poses),), self.layout.num_objects)
        run = jax.lax.while_loop(
            lambda run: jnp.any(is_running(run)), step, _Checks(scenes.release(start), blank)
        )
        standing = run.standing
        diverged = jnp.where(is_active & ~is_sound, int(Verdict.NON_FINITE), standing.verdict)
        return standing.replace(
            verdict=diverged,
            shift=standing.shift * is_placed,
            turn=standing.turn * is_placed,
        )


def _where(is_new: Array, new: Array, old: Array) -> Array:
    """Scene by scene, `new` or `old`, f[N, ...]."""
    return jnp.where(is_new.reshape(is_new.shape + (1,) * (new.ndim - 1)), new, old)
