"""Steps a bank in MuJoCo Playground; needs playground and cluttergen_jax[robot].

python read_in_playground.py EXPORT NUM_STEPS; prints JSON: see test_export_hosts.
"""

import json
import sys
from functools import partial
from pathlib import Path

# ruff: noqa: E402
folder = sys.argv[1]
num_steps = int(sys.argv[2])
sys.path.insert(0, folder)

from mujoco_playground import registry, wrapper
from mujoco_playground._src import mjx_env

# Playground would clone MuJoCo Menagerie, of which nothing is used here.
Path(mjx_env.MENAGERIE_PATH).mkdir(parents=True, exist_ok=True)

import cluttergen_playground
import jax
import numpy as np


class Costly(cluttergen_playground.ClutterEnv):
    """Somebody's own: actions cost, and the time is observed, too."""

    def observe(self, state):
        """One number more."""
        return jax.numpy.append(state.obs, state.data.time)

    def reward(self, before, after, action):
        """Less one for an action of length one."""
        return after.reward - jax.numpy.square(action).sum()


cluttergen_playground.register("ClutterPick", env_class=Costly)
overrides = {"num_envs": 2, "episode_length": num_steps}
bare = registry.load("ClutterPick", config_overrides=overrides)
keys = jax.random.split(jax.random.PRNGKey(0), 2)
randomizer = partial(registry.get_domain_randomizer("ClutterPick"), rng=keys)
env = wrapper.wrap_for_brax_training(
    bare, bare.episode_length, randomization_fn=randomizer, full_reset=True
)
state = jax.jit(env.reset)(keys)
names = bare.world.names
step = jax.jit(env.step)


def poses_of(state):
    return np.asarray(state.data.qpos)[:, bare.world.object_qpos]


begun = state
first = step(state, jax.numpy.zeros((2, env.action_size)))
state = first
for _ in range(num_steps - 2):
    state = step(state, jax.numpy.zeros((2, env.action_size)))
shift = np.linalg.norm((poses_of(state) - poses_of(begun))[..., :3], axis=-1)
after = step(state, jax.numpy.zeros((2, env.action_size)))
costly = step(first, jax.numpy.zeros((2, env.action_size)).at[:, 0].set(1.0))
own, _ = randomizer(bare.mjx_model)
start = begun.info["start"]
report = [
    {
        "scene": int(begun.info["scene"][world]),
        "target": names[int(start.target[world])],
        "there": [
            name for name, there in zip(names, start.is_present[world], strict=True) if there
        ],
        "poses": dict(zip(names, poses_of(begun)[world].tolist(), strict=True)),
        "shift": dict(zip(names, shift[world].tolist(), strict=True)),
        "progress": float(state.metrics["progress"][world]),
        "done": float(state.done[world]),
        "reward": float(costly.reward[world]),
        "gained": float((costly.metrics["progress"] - first.metrics["progress"])[world]),
        "masses": np.asarray(own.body_mass)[world, bare.world.bodies].tolist(),
        "friction": float(np.asarray(own.geom_friction)[world, 0, 0]),
        "late": [float(each.done[world]) for each in (state, after)],
        "again": float(
            np.abs(poses_of(after)[world] - np.asarray(after.info["start"].poses)[world]).max()
        ),
    }
    for world in range(2)
]
sizes = [env.action_size, env.observation_size, list(begun.obs.shape)]
ppo = cluttergen_playground.brax_ppo_config().to_dict()
is_known = "ClutterPick" in registry.ALL_ENVS
print(
    json.dumps(
        {
            "worlds": report,
            "sizes": sizes,
            "dt": env.dt,
            "is_known": is_known,
            "ppo": ppo,
            "usual": [float(bare.mj_model.body_mass[each]) for each in bare.world.bodies],
        }
    )
)
