"""PPO as one compiled update: roll out, estimate advantages, take clipped gradient steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.sharding import Mesh

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.ppo.sharding import each, spread
from cluttergen_jax.placement.brax_env import Env, State
from cluttergen_jax.types import Array

_MOST = 10**10
_MAY_BE_ZERO = ("entropy_cost", "value_cost", "discount", "gae_lambda", "value_clip")


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation (Schulman et al., 2017), clipped.

    Attributes:
      num_envs: N, environments side by side; num_steps: T, steps of each per update.
      num_minibatches, num_epochs: of each update's N T steps.
      minibatch_size: steps of a minibatch; where given it decides instead of `num_minibatches`, and the last
        one holds what is left over.
      learning_rate: of Adam; it falls linearly to zero over the run if `anneals`.
      discount, gae_lambda: of returns and advantages.
      clip: of the probability ratio.
      value_cost, entropy_cost: weights in the loss: L = value_cost L_VF - entropy_cost H - L_CLIP, where L_VF
        is half the mean square of the values' errors.
      value_clip: how far a value may move from what it was in the rollout before its gradient stops; 0 lets
        it move freely.
      reward_scale: of rewards before anything else. Advantages are normalised, so that only the critic sees
        it: with rewards in the hundreds its gradient would leave the actor's nothing of the common norm.
      reward_limit: scaled rewards are cut off at plus and minus this, if given: one that is far out would
        leave the others of its minibatch no advantage.
      max_gradient_norm: gradients are scaled down to it.
      num_attempts: environment steps of the whole run.
    """

    num_envs: int = 128
    num_steps: int = 16
    num_minibatches: int = 8
    num_epochs: int = 3
    minibatch_size: int | None = None
    learning_rate: float = 1e-3
    anneals: bool = True
    discount: float = 0.9
    gae_lambda: float = 0.9
    clip: float = 0.2
    value_cost: float = 0.1
    entropy_cost: float = 0.01
    value_clip: float = 0.0
    reward_scale: float = 1.0
    reward_limit: float | None = None
    max_gradient_norm: float = 0.5
    num_attempts: int = 100_000

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least = 0 if field.name in _MAY_BE_ZERO else 1e-12
            if value is not None and not least <= value <= _MOST and field.name != "anneals":
                raise ConfigError(
                    f"ppo.{field.name} = {value}", f"a positive number, {_MOST:,} at most"
                )
        if self.minibatch_size is None and self.batch_size % self.num_minibatches:
            raise ConfigError(
                f"{self.num_envs} x {self.num_steps} steps in {self.num_minibatches} minibatches",
                "minibatches of equal size, or a `minibatch_size`",
            )

    @property
    def batch_size(self) -> int:
        """Environment steps per update."""
        return self.num_envs * self.num_steps

    @property
    def steps_of_minibatch(self) -> int:
        """But for the last one, which may hold fewer."""
        return min(self.minibatch_size or self.batch_size // self.num_minibatches, self.batch_size)

    @property
    def num_gradient_steps(self) -> int:
        """Of the whole run."""
        return self.num_updates * self.num_epochs * -(-self.batch_size // self.steps_of_minibatch)

    @property
    def num_updates(self) -> int:
        """Updates of the whole run."""
        return -(-self.num_attempts // self.batch_size)


Params = Any
Apply = Callable[[Params, Any], tuple[Any, Array]]
"""(params, observations with a leading axis) -> (action distribution, values)."""
Encode = Callable[[Params], Callable[[Any], Any]]
"""params -> a function of observations with a leading axis, called once for each attempt."""


def as_seen(params: Params) -> Callable[[Any], Any]:
    """An `Encode` that leaves observations as they are."""
    return lambda observation: observation


class EnvStep(struct.PyTreeNode):
    """One environment step, or many with leading axes."""

    observation: Any
    action: Array
    log_prob: Array
    value: Array
    reward: Array
    done: Array


class TrainState(struct.PyTreeNode):
    """Everything that an update changes.

    Attributes:
      params, optimizer: the network's and Adam's.
      env: the environments' state, leading axis N.
      key: for the next update.
      num_updates: i32, done so far.
    """

    params: Params
    optimizer: optax.OptState
    env: State
    key: Array
    num_updates: Array


@dataclass(frozen=True, eq=False)
class PPO:
    """The learner. `start` and `update` are pure; their caller compiles them.

    Attributes:
      env: one environment, known only by Brax's protocol.
      apply: the network.
      config: the numbers.
      mesh: the devices that share the environments (`sharding.make_mesh`); None for one device.
      encode: adds to observations, when they are made, what no later update will change.
    """

    env: Env
    apply: Apply
    config: PPOConfig
    mesh: Mesh | None = None
    encode: Encode = as_seen

    def optimizer(self) -> optax.GradientTransformation:
        """Adam after clipping, with the config's schedule."""
        config = self.config
        rate = (
            optax.linear_schedule(config.learning_rate, 0.0, config.num_gradient_steps)
            if config.anneals
            else config.learning_rate
        )
        return optax.chain(
            optax.clip_by_global_norm(config.max_gradient_norm), optax.adam(rate, eps=1e-5)
        )

    def start(self, key: Array, params: Params) -> TrainState:
        """The state before the first update."""
        key_env, key = jax.random.split(key)
        env = jax.vmap(self.env.reset)(jax.random.split(key_env, self.config.num_envs))
        return TrainState(params, self.optimizer().init(params), env, key, jnp.int32(0))

    def update(self, state: TrainState) -> tuple[TrainState, dict[str, Array]]:
        """One rollout and its gradient steps; the new state and figures to show."""
        return self.checked_update(state)[:2]

    def checked_update(self, state: TrainState) -> tuple[TrainState, dict[str, Array], Array]:
        """`update`, and bool: whether all numbers of it were finite."""
        key_rollout, key_learn, key = jax.random.split(state.key, 3)
        env, batch = self._roll_out(state.params, state.env, key_rollout)
        last_seen = self.encode(state.params)(env.obs)
        _, last_value = self.apply(state.params, last_seen)
        advantage, target = generalised_advantages(
            batch.reward,
            batch.value,
            batch.done,
            last_value,
            self.config.discount,
            self.config.gae_lambda,
        )
        flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), (batch, advantage, target))
        (params, optimizer), losses = self._learn(state.params, state.optimizer, flat, key_learn)
        figures = {name: jnp.mean(values.reshape(-1)) for name, values in losses.items()}
        variance = jnp.maximum(jnp.var(target), 1e-8)
        figures["explained_variance"] = 1 - jnp.var(target - batch.value) / variance
        figures |= {"reward": jnp.mean(batch.reward), "episodes": jnp.sum(batch.done)}
        figures |= {f"env/{name}": jnp.mean(value) for name, value in env.metrics.items()}
        is_finite = all_finite((batch, last_seen, last_value, losses, params))
        return TrainState(params, optimizer, env, key, state.num_updates + 1), figures, is_finite

    def _roll_out(self, params: Params, env: State, key: Array) -> tuple[State, EnvStep]:
        encode = self.encode(params)

        def step(env: State, key: Array) -> tuple[State, EnvStep]:
            seen = encode(env.obs)
            dist, value = self.apply(params, seen)
            action = dist.sample(key)
            after = each(self.env.step, self.mesh)(env, action)
            reward = self.config.reward_scale * after.reward
            limit = self.config.reward_limit
            reward = reward if limit is None else jnp.clip(reward, -limit, limit)
            return after, EnvStep(seen, action, dist.log_prob(action), value, reward, after.done)

        return jax.lax.scan(step, env, jax.random.split(key, self.config.num_steps))

    def _learn(
        self, params: Params, optimizer: optax.OptState, flat: Any, key: Array
    ) -> tuple[tuple[Params, optax.OptState], dict[str, Array]]:
        config = self.config
        transform = self.optimizer()

        def minibatch(carry: Any, index: Array) -> tuple[Any, dict[str, Array]]:
            params, optimizer = carry
            chosen = spread(jax.tree.map(lambda x: x[index], flat), self.mesh)
            gradient, losses = jax.grad(self._loss, has_aux=True)(params, *chosen)
            change, optimizer = transform.update(gradient, optimizer, params)
            losses["gradient_norm"] = optax.global_norm(gradient)
            return (optax.apply_updates(params, change), optimizer), losses

        def epoch(carry: Any, key: Array) -> tuple[Any, dict[str, Array]]:
            order = jax.random.permutation(key, config.batch_size)
            size = config.steps_of_minibatch
            whole = config.batch_size // size * size
            carry, losses = jax.lax.scan(minibatch, carry, order[:whole].reshape(-1, size))
            if whole == config.batch_size:
                return carry, losses
            carry, rest = minibatch(carry, order[whole:])
            return carry, jax.tree.map(lambda all, last: jnp.append(all, last), losses, rest)

        return jax.lax.scan(epoch, (params, optimizer), jax.random.split(key, config.num_epochs))

    def _loss(
        self, params: Params, batch: EnvStep, advantage: Array, target: Array
    ) -> tuple[Array, dict[str, Array]]:
        """The paper's loss, c1 L_VF - c2 H - L_CLIP, on one minibatch."""
        config = self.config
        dist, value = self.apply(params, batch.observation)
        log_ratio = dist.log_prob(batch.action) - batch.log_prob
        ratio = jnp.exp(log_ratio)
        advantage = (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)
        clipped = jnp.clip(ratio, 1 - config.clip, 1 + config.clip)
        gain = jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage))
        error = (value - target) ** 2
        if config.value_clip:
            change = jnp.clip(value - batch.value, -config.value_clip, config.value_clip)
            error = jnp.maximum(error, (batch.value + change - target) ** 2)
        value_loss = 0.5 * jnp.mean(error)
        entropy = jnp.mean(dist.entropy())
        loss = config.value_cost * value_loss - config.entropy_cost * entropy - gain
        return loss, {
            "loss": loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "kl": jnp.mean(ratio - 1 - log_ratio),
            "clipped": jnp.mean(jnp.abs(ratio - 1) > config.clip),
        }


def all_finite(tree: Any) -> Array:
    """bool: whether every number of a tree of arrays is finite."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))


def generalised_advantages(
    reward: Array, value: Array, done: Array, last_value: Array, discount: float, gae_lambda: float
) -> tuple[Array, Array]:
    """Advantages and value targets.

    Args:
      reward, value, done: f32[T, N]; done is 1 where the step ended an episode.
      last_value: f32[N], of the observation after the last step.

    Returns:
      f32[T, N] each: sum over l of (discount lambda)^l delta_{t + l}, and that plus the value.
    """
    following = jnp.concatenate([value[1:], last_value[None]])
    delta = reward + discount * (1 - done) * following - value

    def back(after: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        delta, done = now
        advantage = delta + discount * gae_lambda * (1 - done) * after
        return advantage, advantage

    _, advantage = jax.lax.scan(back, jnp.zeros_like(last_value), (delta, done), reverse=True)
    return advantage, advantage + value
