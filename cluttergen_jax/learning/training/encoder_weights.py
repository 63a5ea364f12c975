"""Weights of pretrained point encoders: reading them, and putting them into a policy's network."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.networks.config import AgentConfig, NetworkConfig
from cluttergen_jax.learning.ppo.checkpoint import read_policy, read_record
from cluttergen_jax.learning.ppo.pose_agent import ENCODER

_SET_ENCODER = "PointNet_0"


def fitted(network: NetworkConfig, folder: Path) -> NetworkConfig:
    """The config with as many features as the weights in `folder` give.

    Raises:
      PoolError: there are no weights.
      ConfigError: they are of another kind of encoder.
    """
    record = read_record(folder)
    if record.get("encoder") != network.scene_encoder:
        raise ConfigError(
            f"weights of the encoder {record.get('encoder')!r} for {network.scene_encoder!r}",
            "weights of the same kind",
            f"cluttergen pretrain --encoder {network.scene_encoder}",
        )
    features = int(record["features"])
    scene = features if network.reads_clouds else network.scene_features
    return replace(network, object_features=features, scene_features=scene)


def choose_encoder(
    network: AgentConfig, encoder: str | None, weights: str | None, is_frozen: bool
) -> AgentConfig:
    """The config with what the command line says of encoders.

    Raises:
      ConfigError: a ranker has no encoder of clouds, or a frozen one has no weights.
      PoolError: there are no weights where they should be.
    """
    if encoder is None and weights is None and not is_frozen:
        return network
    if not isinstance(network, NetworkConfig):
        raise ConfigError("an encoder for a ranker, which reads no clouds", hint="another `variant`")
    if is_frozen and weights is None:
        raise ConfigError("`encoder_frozen` without weights", hint="`encoder_weights` of cluttergen pretrain")
    network = replace(network, scene_encoder=encoder or network.scene_encoder, encoder_frozen=is_frozen)
    return network if weights is None else fitted(network, Path(weights))


def with_encoder(params: Any, folder: Path) -> Any:
    """A policy's parameters with the point encoders' weights from `folder`: of objects and of scenes alike.

    Raises:
      PoolError: the weights are missing, damaged, or of other sizes.
    """
    inner = dict(params["params"])
    if ENCODER in inner:
        inner[ENCODER] = {name: read_policy(folder, net) for name, net in inner[ENCODER].items()}
    else:
        inner[_SET_ENCODER] = read_policy(folder, inner[_SET_ENCODER])
    return params | {"params": inner}
