"""Programs for processes of their own, where JAX sees two devices, or two processes are one.

XLA_FLAGS=--xla_force_host_platform_device_count=2 python -m tests.helpers.devices probe|real
python -m tests.helpers.devices host PORT NUMBER OF FOLDER CALLS
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.learning.ppo.ppo import PPO
from cluttergen_jax.learning.ppo.sharding import join, make_mesh
from cluttergen_jax.learning.training.run import Updates, fresh_state
from cluttergen_jax.placement.env import PlacementEnv
from tests.helpers.probes import Bandit, Tiny, learner


def trained(ppo: PPO, params, num: int):
    """The figures and the weights after some updates."""
    state = fresh_state(ppo, jax.random.key(1), params)
    state, rows, is_finite = Updates(ppo, state, num)(state, num)
    assert is_finite
    return rows, jax.device_get(state.params), state


def compare(ppo: PPO, params, num: int, atol: float) -> None:
    """The same run on one device and on two: the same up to rounding."""
    one = trained(replace(ppo, mesh=None), params, num)
    two = trained(replace(ppo, mesh=make_mesh(ppo.config.num_envs)), params, num)
    leaf = jax.tree.leaves(two[2].env.obs)[0]
    assert len(leaf.sharding.device_set) == 2
    assert leaf.addressable_shards[0].data.shape[0] == ppo.config.num_envs // 2
    for row, other in zip(one[0], two[0], strict=True):
        for name, value in row.items():
            np.testing.assert_allclose(other[name], value, atol=atol, rtol=atol, err_msg=name)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, atol=atol, rtol=atol), one[1], two[1]
    )


def probe() -> None:
    """The bandit."""
    ppo = learner(Bandit(), num_envs=8, num_steps=4, num_minibatches=2, num_epochs=2)
    compare(ppo, Tiny().init(jax.random.key(0), jnp.zeros((1, 2))), 3, 1e-4)


def real() -> None:
    """Three objects in MuJoCo's C engine, which is called from both devices."""
    from cluttergen_jax.learning.agents import Agent
    from cluttergen_jax.learning.ppo.ppo import PPOConfig
    from tests.helpers.problems import trio_problem
    from tests.helpers.runs import SMALL

    problem = trio_problem(history_stride=12, reward="compressed")
    geometry = problem.rules.geometry
    net = Agent(SMALL, geometry.cloud, geometry.half_extents, 3)
    env = PlacementEnv(problem.rules)
    ppo = PPO(env, net.apply, PPOConfig(num_envs=8, num_steps=8, num_minibatches=2, num_epochs=2))
    params = net.init(jax.random.key(0), jax.eval_shape(env.reset, jax.random.key(0)).obs)
    compare(ppo, params, 2, 1e-3)


def host(port: str, number: str, count: str, folder: str, calls: str) -> None:
    """One process of several that make a run; after so many calls, the last process asks to stop."""
    if int(count) > 1:
        join(f"127.0.0.1:{port}", int(count), int(number))
    from tests.helpers.runs import Stopping, make_run, weights

    is_last = int(number) == int(count) - 1
    run = make_run(Path(folder), seed=3)
    state = run.train(interrupt=Stopping(int(calls) if is_last and int(calls) else 1 << 30))
    np.save(Path(folder) / f"weights-{number}.npy", weights(state))


if __name__ == "__main__":
    {"probe": probe, "real": real, "host": host}[sys.argv[1]](*sys.argv[2:])
