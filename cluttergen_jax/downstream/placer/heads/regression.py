"""The head `regression`: the paper's network, which names one pose (section 5; MSE of position and turn)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.config import PlacerLoss
from cluttergen_jax.downstream.placer.query import (
    NUM_PROPOSALS,
    Example,
    PlacementQuery,
    Proposals,
    without_scores,
)
from cluttergen_jax.learning.networks.cloud_encoder import CloudNet
from cluttergen_jax.learning.ppo import checkpoint
from cluttergen_jax.types import Array


@dataclass(frozen=True)
class RegressionConfig:
    """Sizes of the network and what it keeps low.

    Attributes:
      encoder: of either cloud, "pointnet" (one group of all points) or "pointnet2"; features: of each.
      scene_points, object_points: that are read.
      num_centroids, group_size: of PointNet++.
      widths: of the layers above the encoders.
      loss: "printed" (mean squared errors of position and quaternion, each weighted by the other's share of
        their sum) or "symmetric" (1 - cos of the turn's error in place of the quaternion's).
    """

    encoder: str = "pointnet"
    features: int = 256
    scene_points: int = 512
    object_points: int = 512
    num_centroids: int = 128
    group_size: int = 16
    widths: tuple[int, ...] = (256, 128, 64)
    loss: PlacerLoss = "printed"


class Clouds(struct.PyTreeNode):
    """What the network sees: of the scene f32[P, 3] with its mask, of the object f32[Q, 3], metres.

    Attributes:
      region: f32[2], its half extents; half_extents: f32[3], the object's.
    """

    scene: Array
    mask: Array
    object: Array
    region: Array
    half_extents: Array


class RegressionNet(nn.Module):
    """Two encoders of clouds and a perceptron."""

    config: RegressionConfig = RegressionConfig()

    @nn.compact
    def __call__(self, clouds: Clouds) -> Array:
        """f32[4], x, y, z and yaw in metres and radians, of one query."""
        config = self.config
        scene = self._encode("scene", clouds.scene, clouds.mask, jnp.linalg.norm(clouds.region))
        everything = jnp.ones(len(clouds.object), bool)
        size = jnp.linalg.norm(clouds.half_extents)
        own = self._encode("object", clouds.object, everything, size)
        # Clouds are divided by their radius, which says how large they were.
        hidden = jnp.concatenate([scene, own, 10 * clouds.half_extents, 3 * clouds.region])
        for width in config.widths:
            hidden = nn.relu(nn.LayerNorm()(nn.Dense(width)(hidden)))
        return nn.Dense(4)(hidden)

    def _encode(self, name: str, cloud: Array, mask: Array, radius: Array) -> Array:
        config = self.config
        net = CloudNet(config.encoder, config.features, config.group_size, name=name)
        centroids = jnp.arange(max(min(config.num_centroids, len(cloud) // 2), 1))
        return net(cloud / jnp.maximum(radius, 1e-6), mask, centroids)


class RegressionPlacer(struct.PyTreeNode, eq=False):
    """Proposes the one pose that the network names, as often as proposals are asked for.

    Attributes:
      params: the network's weights; config: its sizes.
    """

    params: Any
    config: RegressionConfig = struct.field(pytree_node=False, default=RegressionConfig())

    def __call__(self, key: Array, query: PlacementQuery) -> Proposals:
        """See `query.Placer`; nothing is drawn."""
        del key
        pose: Any = RegressionNet(self.config).apply(self.params, clouds_of(query, self.config))
        return without_scores(jnp.broadcast_to(pose, (NUM_PROPOSALS, 4)))


def clouds_of(query: PlacementQuery, config: RegressionConfig) -> Clouds:
    """What the network sees of a query."""
    number = config.scene_points
    return Clouds(
        scene=query.cloud[:number],
        mask=query.cloud_mask[:number],
        object=query.object_cloud[: config.object_points],
        region=query.region_half_extents,
        half_extents=query.half_extents,
    )


class RegressionExample(struct.PyTreeNode):
    """What the network learns from one pair: clouds, and f32[4], where the object stands."""

    clouds: Clouds
    target: Array


@dataclass(frozen=True)
class RegressionHead:
    """Learns to name the pose at which the object stands in the scene.

    Attributes:
      encoder_weights: folder of `pretrain` whose weights both encoders begin with; drawn if None.
    """

    config: RegressionConfig = field(default_factory=RegressionConfig)
    encoder_weights: Path | None = None
    kind = "regression"

    def prepare(self, example: Example) -> RegressionExample:
        return RegressionExample(clouds_of(example.query, self.config), example.target)

    def init(self, key: Array) -> Any:
        """See `checkpoint.Head`. Raises PoolError: `encoder_weights` has none, or of other sizes."""
        scene = self.config.scene_points
        own = self.config.object_points
        blank = Clouds(
            jnp.zeros((scene, 3)),
            jnp.ones(scene, bool),
            jnp.zeros((own, 3)),
            jnp.ones(2),
            jnp.ones(3),
        )
        params: Any = RegressionNet(self.config).init(key, blank)
        if self.encoder_weights is None:
            return params
        inner = params["params"]
        read = {
            name: checkpoint.read_policy(self.encoder_weights, inner[name])
            for name in ("scene", "object")
        }
        return {"params": inner | read}

    def loss(
        self, params: Any, examples: RegressionExample, key: Array
    ) -> tuple[Array, dict[str, Array]]:
        del key
        found: Any = jax.vmap(lambda clouds: RegressionNet(self.config).apply(params, clouds))(
            examples.clouds
        )
        position = jnp.mean((found[:, :3] - examples.target[:, :3]) ** 2)
        if self.config.loss == "symmetric":
            turn = jnp.mean(1 - jnp.cos(found[:, 3] - examples.target[:, 3]))
        else:
            turn = jnp.mean((_quaternion(found[:, 3]) - _quaternion(examples.target[:, 3])) ** 2)
        # Constants as far as the gradient is concerned, as in the published code.
        share = jax.lax.stop_gradient(turn / jnp.maximum(position + turn, 1e-12))
        return share * position + (1 - share) * turn, {"position": position, "turn": turn}

    def placer(self, params: Any, temperature: float = 1.0) -> RegressionPlacer:
        return RegressionPlacer(params, self.config)


def _quaternion(yaw: Array) -> Array:
    """f32[..., 4], wxyz, of turns about z: two signs mean the same turn, and are far apart all the same."""
    zero = jnp.zeros_like(yaw)
    return jnp.stack([jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)], axis=-1)
