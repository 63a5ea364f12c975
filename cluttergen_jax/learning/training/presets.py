"""Settings of a training run: presets by name, variants of the method, the choice of an encoder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from cluttergen_jax.config import StabilityConfig, no_such
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.ppo.ppo import PPOConfig
from cluttergen_jax.placement import PlacementConfig


@dataclass(frozen=True)
class Settings:
    """What a preset decides."""

    ppo: PPOConfig = field(default_factory=PPOConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    placement: PlacementConfig = field(default_factory=PlacementConfig)
    stability: StabilityConfig = field(default_factory=StabilityConfig)


_TUNED = NetworkConfig(head="mixture", height_precision=20_000.0)
"""What `python -m studies.benchmarks.ablation` found best (reports/benchmarks.md)."""


def _training_stability(stop_when_decided: bool) -> StabilityConfig:
    """In training the awake stage of 60 steps suffices as the last check (docs/contract.md)."""
    stability = StabilityConfig(stop_when_decided=stop_when_decided)
    return replace(stability, stand_full_steps=stability.stand_steps)


def cpu() -> Settings:
    """For two cores: few environments, a small network, every 12th row of the history."""
    return Settings(
        network=_TUNED,
        placement=PlacementConfig(reward="compressed", history_stride=12),
        stability=_training_stability(True),
    )


def gpu() -> Settings:
    """For an accelerator: many environments, larger minibatches."""
    ppo = PPOConfig(num_envs=1024, num_steps=8, num_minibatches=8, num_attempts=2_500_000)
    return replace(cpu(), ppo=ppo)


def paper() -> Settings:
    """The paper as printed, with the rollout of its code, which it does not state (docs/concepts/paper.md).

    The printed weight of the value loss, 0.5, is of the whole mean square: 1.0 of half of it. Of five layers
    of actor and critic the last one is the output.
    Rewards are learned from in thousands, and penalties of more than ten successes are cut off: of an object
    that is let go inside another the printed sum of accelerations knows no bound, and nothing is learned
    beside it.
    """
    return Settings(
        ppo=PPOConfig(
            num_envs=16,
            num_steps=200,
            minibatch_size=1000,
            num_epochs=5,
            learning_rate=1e-4,
            anneals=False,
            discount=0.99,
            gae_lambda=0.95,
            entropy_cost=0.01,
            value_cost=1.0,
            reward_scale=1e-3,
            reward_limit=1.0,
            num_attempts=2_500_000,
        ),
        network=NetworkConfig(
            head="beta_free",
            scene_encoder="pointnet2",
            encoder_frozen=True,
            object_points=1024,
            object_features=1024,
            scene_points=20_480,
            scene_features=1024,
            num_centroids=512,
            group_size=32,
            history_width=256,
            num_layers=4,
        ),
        placement=PlacementConfig(reward="paper", history_stride=1),
        stability=_training_stability(False),
    )


def paper_code() -> Settings:
    """What the paper's published code does in place of that, as far as this project can.

    Its verdict, its reward in its own unit, half the weight of the value loss, clipped values, ten epochs, a
    falling learning rate; its encoder groups all points at every level, which makes it a PointNet.
    """
    printed = paper()
    return replace(
        printed,
        ppo=replace(
            printed.ppo,
            num_epochs=10,
            anneals=True,
            value_cost=0.5,
            value_clip=0.2,
            reward_scale=1.0,
            reward_limit=None,
        ),
        network=replace(printed.network, scene_encoder="pointnet"),
        placement=replace(printed.placement, reward="code"),
        stability=replace(printed.stability, per_axis=True, judge_neighbours=False),
    )


def paper_cpu() -> Settings:
    """`paper` as two cores can bear it; what each change does is in reports/benchmarks.md.

    A PointNet on clouds of 512 points, every 12th row of the history, many environments, attempts that end as
    soon as they cannot succeed any more; no entropy bonus, and a learning rate that falls from 1e-3 to 0. The
    weight of the value loss and the layers stay as the shipped policies were trained with them.
    """
    printed = paper()
    return replace(
        printed,
        ppo=replace(
            printed.ppo,
            num_envs=128,
            num_steps=25,
            learning_rate=1e-3,
            anneals=True,
            entropy_cost=0.0,
            value_cost=0.5,
        ),
        network=replace(
            printed.network,
            scene_encoder="pointnet",
            object_points=256,
            object_features=256,
            scene_points=512,
            scene_features=256,
            history_width=128,
            num_layers=5,
        ),
        placement=replace(printed.placement, history_stride=12),
        stability=_training_stability(True),
    )


PRESETS = {"cpu": cpu, "gpu": gpu, "paper": paper, "paper_code": paper_code, "paper_cpu": paper_cpu}

_CHANGES: dict[str, Callable[[NetworkConfig], NetworkConfig]] = {
    "policy": lambda network: network,
    "beta_free": lambda network: replace(network, head="beta_free", height_precision=0.0),
    "normal": lambda network: replace(network, head="normal"),
    "open_loop": lambda network: replace(network, history_width=0),
    "short_memory": lambda network: replace(network, history_length=1),
}


def make_settings(preset: str, variant: str) -> Settings:
    """A preset with a variant of the method (paper, section 4.1).

    Raises:
      ConfigError: there is no such preset or variant.
    """
    if preset not in PRESETS:
        raise no_such("preset", preset, PRESETS)
    if variant not in _CHANGES:
        raise no_such("variant", variant, _CHANGES)
    settings = PRESETS[preset]()
    return replace(settings, network=_CHANGES[variant](settings.network))


def fit_to_weights(network: NetworkConfig, folder: Path) -> NetworkConfig:
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
    network: NetworkConfig, encoder: str | None, weights: str | None, is_frozen: bool
) -> NetworkConfig:
    """The config with what the command line says of encoders.

    Args:
      encoder: None stays as it is; one that is named without weights is trained along, unless `is_frozen`.

    Raises:
      ConfigError: a frozen encoder has no weights.
      PoolError: there are no weights where they should be.
    """
    is_frozen = is_frozen or (network.encoder_frozen and (encoder is None or weights is not None))
    network = replace(
        network, scene_encoder=encoder or network.scene_encoder, encoder_frozen=is_frozen
    )
    if weights is not None:
        return fit_to_weights(network, Path(weights))
    if is_frozen:
        kind = network.scene_encoder
        raise ConfigError(
            f"an encoder {kind!r} that keeps its weights, and no `encoder_weights`",
            "the folder of a pretrained one",
            f"`cluttergen pretrain --encoder {kind} --features {network.object_features} --object-points "
            f"{network.object_points} --out encoder` and `--encoder-weights encoder`; or `--encoder {kind}`, "
            "which is trained along",
        )
    return network
