"""Gradient steps of a network: how it is fitted, what a run changes, and a step."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral
from typing import Any, Literal, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.config import check_positive
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.numerics import new_key
from cluttergen_jax.types import Array

_WARM_UP = 0.02
_MOST = 1_000_000
"""Of epochs, and of examples in a batch."""


class Learner(Protocol):
    """A network and what it learns from an example; a frozen value."""

    @property
    def config(self) -> Any:
        """Sizes of the network, a frozen dataclass of JSON values."""
        ...

    def init(self, key: Array) -> Any:
        """Fresh weights."""
        ...

    def loss(self, params: Any, examples: Any, key: Array) -> tuple[Array, dict[str, Array]]:
        """What to keep low over a batch of examples, f32, and its parts by name."""
        ...


def blank_params(learner: Learner) -> Any:
    """Weights of a network's shapes, all zero."""
    shapes = jax.eval_shape(learner.init, new_key(0))
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)


@dataclass(frozen=True)
class FitConfig:
    """How a network is fitted.

    Attributes:
      num_epochs: times that all examples are seen; batch_size: examples a step.
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
        check_positive(self, "num_epochs", "batch_size", "learning_rate")
        for name in ("num_epochs", "batch_size"):
            if not isinstance(value := getattr(self, name), Integral) or int(value) > _MOST:
                raise ConfigError(f"FitConfig.{name} = {value!r}", f"1 to {_MOST}, a whole number")

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
    """Gradient steps of one network; pure, whoever drives them compiles.

    Attributes:
      learner: what is fitted; config: how; num_steps: of the whole run.
    """

    learner: Learner
    config: FitConfig
    num_steps: int

    def start(self) -> FitState:
        """Fresh weights."""
        params = self.learner.init(new_key(self.config.seed))
        moments = self.config.optimizer(self.num_steps).init(params)
        return FitState(params, moments, jnp.int32(0), params, jnp.float32(jnp.inf))

    def step(self, state: FitState, examples: Any) -> tuple[FitState, dict[str, Array]]:
        """One step on a batch of prepared examples: the new state, and the loss with its parts."""
        key = jax.random.fold_in(new_key(self.config.seed + 1), state.step)
        gradient = jax.value_and_grad(self.learner.loss, has_aux=True)
        (loss, parts), slope = gradient(state.params, examples, key)
        optimizer = self.config.optimizer(self.num_steps)
        change, moments = optimizer.update(slope, state.optimizer, state.params)
        params = optax.apply_updates(state.params, change)
        return state.replace(params=params, optimizer=moments, step=state.step + 1), {"loss": loss, **parts}

    def loss(self, params: Any, examples: Any) -> Array:
        """f32: the loss on examples that nothing is learned from."""
        return self.learner.loss(params, examples, new_key(0))[0]


def num_examples(examples: Any) -> int:
    """How many there are: the leading axis of all arrays."""
    return len(jax.tree.leaves(examples)[0])


def taken(examples: Any, which: np.ndarray) -> Any:
    """Some of the examples: i[M] or bool[N]; None if there are none."""
    index = np.flatnonzero(which) if which.dtype == bool else which
    return jax.tree.map(lambda leaf: leaf[index], examples) if len(index) else None
