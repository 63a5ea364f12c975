"""PPO's numbers."""

from __future__ import annotations

from dataclasses import dataclass, fields

from cluttergen_jax.errors import ConfigError


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation (Schulman et al., 2017), clipped.

    Attributes:
      num_envs: N, environments side by side; num_steps: T, steps of each per update.
      num_minibatches, num_epochs: of each update's N T steps.
      learning_rate: of Adam; it falls linearly to zero over the run if `anneals`.
      discount, gae_lambda: of returns and advantages.
      clip: of the probability ratio.
      value_cost, entropy_cost: weights in the loss: L = value_cost L_VF - entropy_cost H - L_CLIP.
      max_gradient_norm: gradients are scaled down to it.
      num_attempts: environment steps of the whole run.
    """

    num_envs: int = 128
    num_steps: int = 16
    num_minibatches: int = 8
    num_epochs: int = 3
    learning_rate: float = 1e-3
    anneals: bool = True
    discount: float = 0.9
    gae_lambda: float = 0.9
    clip: float = 0.2
    value_cost: float = 0.1
    entropy_cost: float = 0.01
    max_gradient_norm: float = 0.5
    num_attempts: int = 100_000

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least = 0 if field.name in ("entropy_cost", "value_cost", "discount", "gae_lambda") else 1e-12
            if not value >= least and field.name != "anneals":
                raise ConfigError(f"ppo.{field.name} = {value}", "a positive number")
        if self.num_envs * self.num_steps % self.num_minibatches:
            raise ConfigError(
                f"{self.num_envs} x {self.num_steps} steps in {self.num_minibatches} minibatches",
                "minibatches of equal size",
            )

    @property
    def batch_size(self) -> int:
        """Environment steps per update."""
        return self.num_envs * self.num_steps

    @property
    def num_updates(self) -> int:
        """Updates of the whole run."""
        return -(-self.num_attempts // self.batch_size)
