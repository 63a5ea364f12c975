"""Steps a bank in MuJoCo Playground; needs playground and cluttergen_jax[robot].

python read_in_playground.py EXPORT NUM_STEPS; prints JSON: see test_export_hosts.
"""

import json
import sys
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

cluttergen_playground.register("ClutterPick")
overrides = {"num_envs": 2, "episode_length": num_steps}
bare = registry.load("ClutterPick", config_overrides=overrides)
env = wrapper.wrap_for_brax_training(bare, bare.episode_length, full_reset=True)
state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), 2))
names = bare.world.names
step = jax.jit(env.step)


def poses_of(state):
    return np.asarray(state.data.qpos)[:, bare.world.object_qpos]


begun = state
for _ in range(num_steps - 1):
    state = step(state, jax.numpy.zeros((2, env.action_size)))
shift = np.linalg.norm((poses_of(state) - poses_of(begun))[..., :3], axis=-1)
after = step(state, jax.numpy.zeros((2, env.action_size)))
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
        "late": [float(each.done[world]) for each in (state, after)],
        "again": float(
            np.abs(poses_of(after)[world] - np.asarray(after.info["start"].poses)[world]).max()
        ),
    }
    for world in range(2)
]
sizes = [env.action_size, env.observation_size, list(begun.obs.shape)]
print(json.dumps({"worlds": report, "sizes": sizes, "dt": env.dt}))
