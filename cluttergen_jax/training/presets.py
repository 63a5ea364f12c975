"""Settings that belong together, by name; each call returns a fresh config."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from cluttergen_jax.agent.config import PPOConfig
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.networks.actor_critic import NetworkConfig
from cluttergen_jax.placement.config import PlacementConfig


@dataclass(frozen=True)
class Settings:
    """What a preset decides."""

    ppo: PPOConfig = field(default_factory=PPOConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    placement: PlacementConfig = field(default_factory=PlacementConfig)
    stability: StabilityConfig = field(default_factory=StabilityConfig)


def _training_stability(stop_when_decided: bool) -> StabilityConfig:
    """In training the awake stage of 60 steps suffices as the last check (contract.md)."""
    stability = StabilityConfig(stop_when_decided=stop_when_decided)
    return replace(stability, stand_full_steps=stability.stand_steps)


def cpu() -> Settings:
    """For two cores: few environments, a small network, every 12th row of the history."""
    return Settings(
        placement=PlacementConfig(reward="compressed", history_stride=12),
        stability=_training_stability(True),
    )


def gpu() -> Settings:
    """For an accelerator: many environments, larger minibatches."""
    return Settings(
        ppo=PPOConfig(num_envs=1024, num_steps=8, num_minibatches=8, num_attempts=2_500_000),
        placement=PlacementConfig(reward="compressed", history_stride=12),
        stability=_training_stability(True),
    )


def paper() -> Settings:
    """The paper's hyper-parameters (its table of constants)."""
    return Settings(
        ppo=PPOConfig(
            num_envs=100,
            num_steps=10,
            num_minibatches=1,
            num_epochs=5,
            learning_rate=1e-4,
            anneals=False,
            discount=0.99,
            entropy_cost=0.01,
            num_attempts=2_500_000,
        ),
        network=NetworkConfig(object_points=1024),
        placement=PlacementConfig(reward="paper", history_stride=1),
        stability=_training_stability(False),
    )


PRESETS = {"cpu": cpu, "gpu": gpu, "paper": paper}
VARIANTS = ("policy", "open_loop", "short_memory", "normal")


def make_settings(preset: str, variant: str) -> Settings:
    """A preset with a variant of the method (paper, section 4.1).

    Raises:
      ConfigError: there is no such preset or variant.
    """
    if preset not in PRESETS:
        raise ConfigError(f"preset {preset!r}", ", ".join(PRESETS))
    settings = PRESETS[preset]()
    changes: dict[str, dict[str, Any]] = {
        "policy": {},
        "open_loop": {"history_width": 0},
        "short_memory": {"history_length": 1},
        "normal": {"head": "normal"},
    }
    if variant not in changes:
        raise ConfigError(f"variant {variant!r}", ", ".join(VARIANTS))
    return replace(settings, network=replace(settings.network, **changes[variant]))
