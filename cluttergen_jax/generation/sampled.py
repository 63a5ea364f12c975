"""One finished scene as a pytree: what the sampler returns."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import jaxlie
from flax import struct

from cluttergen_jax.placement.observation import ObservationConfig, observe
from cluttergen_jax.placement.region import Region, from_pose, to_pose
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.scenes import scenes_of
from cluttergen_jax.placement.types import Counts, Episode
from cluttergen_jax.types import Array


class SampledScene(struct.PyTreeNode):
    """A finished scene, or a failed one: look at `is_success`. S slots, N points, any leading axes.

    Attributes:
      is_success: bool, every slot is filled and the finished scene stands.
      is_filled: bool, every slot is filled.
      verdict: i32, a `types.Verdict`: the last check's, or that of the attempt with which the scene failed.
      object_index: i32[S], the compiled world's object in each slot, -1 where there is none.
      is_placed: bool[S], the slot holds an object that stands; those of failed scenes may be fewer.
      T_world_object: SE3[S], metres; the identity where not placed.
      region: the queried region.
      T_world_support: SE3, where the support's frame is. The world has its origin on the floor below the
        support's centre, so it is the identity; it is here so that nobody has to know that.
      counts: figures of this draw (attempts, steps, verdicts).
      drift: f32, metres, the largest movement in the last check.
      num_draws: i32, how often the scene was drawn until it passed, at most `max_retries` + 1.
      cloud: f32[N, 3], world frame, metres: points of the region and of the placed objects; None unless asked
        for. cloud_mask: bool[N], the points that count; the others are the region's origin.
    """

    is_success: Array
    is_filled: Array
    verdict: Array
    object_index: Array
    is_placed: Array
    T_world_object: jaxlie.SE3
    region: Region
    T_world_support: jaxlie.SE3
    counts: Counts
    drift: Array
    num_draws: Array
    cloud: Array | None = None
    cloud_mask: Array | None = None

    @property
    def poses(self) -> Array:
        """f32[S, 7]: `T_world_object` as position, then quaternion wxyz."""
        return to_pose(self.T_world_object)


def sampled_scene(rules: Rules, episode: Episode, num_draws: Array, num_points: int = 0) -> SampledScene:
    """The scene of one finished episode.

    Args:
      num_points: N; 0 leaves the cloud out.
    """
    product = scenes_of(episode)
    cloud, mask = _cloud(rules, episode, num_points) if num_points else (None, None)
    return SampledScene(
        is_success=product.is_success,
        is_filled=product.is_filled,
        verdict=product.verdict,
        object_index=product.object_index,
        is_placed=product.is_placed,
        T_world_object=from_pose(product.T_world_object),
        region=episode.region,
        T_world_support=jaxlie.SE3.identity(),
        counts=product.counts,
        drift=product.drift,
        num_draws=num_draws,
        cloud=cloud,
        cloud_mask=mask,
    )


def _cloud(rules: Rules, episode: Episode, num_points: int) -> tuple[Array, Array]:
    """f32[N, 3], world frame, and bool[N]."""
    seen = observe(rules, episode, ObservationConfig(num_scene_points=num_points))
    cloud = jax.vmap(episode.region.T_world_region.apply)(jnp.asarray(seen["scene_cloud"]))
    return cloud, jnp.asarray(seen["scene_mask"])
