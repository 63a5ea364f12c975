"""A scene as a set of objects: the current object attends to what stands there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import flax.linen as nn
import jax.numpy as jnp

from cluttergen_jax.learning.networks.points import LENGTH_SCALE, rotation_features
from cluttergen_jax.types import Array


class SetEncoder(nn.Module):
    """What stands there, seen from the current object: attention over the placed objects.

    Every placed object (its cloud's features, its size, its pose) is read together with the current object
    and the region by a shared network; each head pools its share of the result by additive attention, and
    the maximum stands beside. The result does not change when the objects are renumbered.

    Attributes:
      width: W, of an object's token; num_heads: of the attention.
      max_tokens: placed objects that can be seen at once.
    """

    width: int = 96
    num_heads: int = 4
    max_tokens: int = 10

    @nn.compact
    def __call__(self, features: Array, half_extents: Array, observation: Mapping[str, Any]) -> Array:
        """Scene features seen from the current object, f32[B, 3 W].

        Args:
          features: f32[K, F], of every object's cloud; half_extents: f32[K, 3], metres.
          observation: of `placement.observation.observe`, with a leading axis B on every leaf.
        """
        is_placed, poses = observation["is_placed"], observation["T_region_object"]
        focus, region = observation["focus"], observation["region"]
        size = jnp.concatenate([features, half_extents * LENGTH_SCALE], axis=-1)
        order = jnp.argsort(~is_placed, axis=1, stable=True)[:, : self.max_tokens]
        mask = jnp.take_along_axis(is_placed, order, axis=1)
        poses = jnp.take_along_axis(poses, order[..., None], axis=1)
        place = jnp.concatenate([poses[..., :3] * LENGTH_SCALE, rotation_features(poses[..., 3:])], axis=-1)
        # A sum of three layers is one layer over the three side by side; the first needs no batch.
        asked = nn.Dense(self.width, name="in_hand")(
            jnp.concatenate([size[focus], region * LENGTH_SCALE], axis=-1)
        )
        tokens = nn.Dense(self.width, name="object")(size)[order] + nn.Dense(self.width, name="place")(place)
        tokens = nn.relu(tokens + asked[:, None])
        tokens = jnp.where(mask[..., None], nn.relu(nn.Dense(self.width)(tokens)), 0.0)
        score = jnp.where(mask[..., None], nn.Dense(self.num_heads)(tokens), -1e9)
        shares = tokens.reshape(*tokens.shape[:2], self.num_heads, -1)
        pooled = jnp.einsum("bmh,bmhw->bhw", nn.softmax(score, axis=1), shares)
        pooled = pooled.reshape(pooled.shape[0], self.width)
        return jnp.concatenate([asked, pooled, jnp.max(tokens, axis=1)], axis=-1)
