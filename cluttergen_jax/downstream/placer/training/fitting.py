"""Gradient steps of a placer's head, and the temperature of its chances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.downstream.placer.heads.head import Head
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.types import Array

_WARM_UP = 0.02
_TEMPERATURES = np.exp(np.linspace(np.log(0.25), np.log(4.0), 129))


@dataclass(frozen=True)
class FitConfig:
    """How a head is fitted.

    Attributes:
      num_epochs: times that all pairs are seen; batch_size: pairs a step.
      learning_rate: of AdamW, at its highest.
      schedule: "cosine" (after a short warm-up) or "linear", either down to zero.
      weight_decay: of AdamW.
      seed: of weights and order.
    """

    num_epochs: int = 12
    batch_size: int = 32
    learning_rate: float = 2e-3
    schedule: Literal["cosine", "linear"] = "cosine"
    weight_decay: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("num_epochs", "batch_size", "learning_rate"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} = {getattr(self, name)}", "a positive number")

    def optimizer(self, num_steps: int) -> optax.GradientTransformation:
        """For a run of so many steps."""
        rate = optax.linear_schedule(self.learning_rate, 0.0, num_steps)
        if self.schedule == "cosine":
            warm_up = max(int(_WARM_UP * num_steps), 1)
            rate = optax.join_schedules(
                [
                    optax.linear_schedule(0.0, self.learning_rate, warm_up),
                    optax.cosine_decay_schedule(self.learning_rate, max(num_steps - warm_up, 1)),
                ],
                [warm_up],
            )
        decay = optax.adamw(rate, weight_decay=self.weight_decay)
        return optax.chain(optax.clip_by_global_norm(1.0), decay)


class FitState(struct.PyTreeNode):
    """What a run changes.

    Attributes:
      params: weights; optimizer: Adam's moments; step: i32, steps done.
      best: the weights of the least loss on the validation split so far; best_loss: f32, that loss.
    """

    params: Any
    optimizer: optax.OptState
    step: Array
    best: Any
    best_loss: Array


@dataclass(frozen=True)
class Fit:
    """Gradient steps of one head; pure, whoever drives them compiles.

    Attributes:
      head: what is fitted; config: how; num_steps: of the whole run.
    """

    head: Head
    config: FitConfig
    num_steps: int

    def start(self) -> FitState:
        """Fresh weights."""
        params = self.head.init(jax.random.key(self.config.seed))
        moments = self.config.optimizer(self.num_steps).init(params)
        return FitState(params, moments, jnp.int32(0), params, jnp.float32(jnp.inf))

    def step(self, state: FitState, examples: Any) -> tuple[FitState, dict[str, Array]]:
        """One step on a batch of prepared examples: the new state, and the loss with its parts."""
        key = jax.random.fold_in(jax.random.key(self.config.seed + 1), state.step)
        gradient = jax.value_and_grad(self.head.loss, has_aux=True)
        (loss, parts), slope = gradient(state.params, examples, key)
        optimizer = self.config.optimizer(self.num_steps)
        change, moments = optimizer.update(slope, state.optimizer, state.params)
        params = optax.apply_updates(state.params, change)
        return state.replace(params=params, optimizer=moments, step=state.step + 1), {"loss": loss, **parts}

    def loss(self, params: Any, examples: Any) -> Array:
        """f32: the loss on examples that nothing is learned from."""
        return self.head.loss(params, examples, jax.random.key(0))[0]


def best_temperature(logits: np.ndarray, label: np.ndarray) -> float:
    """By which logits f32[N] are divided so that their chances fit labels bool[N] best (least surprise)."""
    signed = np.where(label, 1.0, -1.0) * logits.astype(np.float64)
    surprise = [np.logaddexp(0.0, -signed / each).mean() for each in _TEMPERATURES]
    return float(_TEMPERATURES[int(np.argmin(surprise))])
