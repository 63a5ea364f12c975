# %% [markdown]
# # Your own trainer
# Placing objects is a decision process: an attempt a step, a scene an episode. `make_env` makes it a Brax
# environment, `make_vector_env` one of Gymnasium (extra `gym`), `make_sb3_env` one of Stable-Baselines3
# (extra `sb3`). All take the same settings.

# %%
import functools

import jax
import numpy as np
from brax.training.agents.ppo import networks

import cluttergen_jax as cg

task = {
    "pool": "dining",
    "objects": ("mug", "bowl", "wine_glass"),
    "history_stride": 0,
    "num_cells": 0,
}

# %% [markdown]
# Brax's PPO. It brings its own resets.

# %%
env = cg.make_env(**task, auto_reset=False)
make_policy, params, _ = cg.envs.train_brax(
    env,
    num_timesteps=20_000,
    num_envs=64,
    batch_size=16,
    unroll_length=16,
    num_minibatches=4,
    num_updates_per_batch=8,
    learning_rate=1e-3,
    entropy_cost=1e-3,
    discounting=0.9,
    run_evals=False,
    network_factory=functools.partial(
        networks.make_ppo_networks, value_hidden_layer_sizes=(64, 64)
    ),
)

# %% [markdown]
# What it has learned, in an environment that resets itself.

# %%
env = cg.make_env(**task)
policy = make_policy(params)


def step(state, key):
    action, _ = policy(state.obs, key)
    state = jax.vmap(env.step)(state, action)
    return state, state.reward


state = jax.vmap(env.reset)(jax.random.split(jax.random.key(1), 32))
state, rewards = jax.jit(lambda *given: jax.lax.scan(step, *given))(
    state, jax.random.split(jax.random.key(2), 16)
)
print(
    f"Brax: reward {rewards.mean():.3f} an attempt, {state.metrics['num_finished'].sum():.0f} episodes"
)

# %% [markdown]
# Gymnasium, for torch: here with actions drawn at random. With Stable-Baselines3 it is
# `PPO("MlpPolicy", cg.envs.make_sb3_env(64, **task)).learn(50_000)`.

# %%
envs = cg.envs.make_vector_env(32, **task)
observation, _ = envs.reset(seed=0)
envs.action_space.seed(0)
rewards = []
for _ in range(16):
    observation, reward, terminated, truncated, infos = envs.step(envs.action_space.sample())
    rewards.append(reward)
print(f"Gymnasium: reward {np.mean(rewards):.3f} an attempt, observations {observation.shape}")
envs.close()

# %% [markdown]
# It prints:
#
#     Brax: reward 0.846 an attempt, 151 episodes
#     Gymnasium: reward 0.206 an attempt, observations (32, 30)
