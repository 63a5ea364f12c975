"""10 s of a bank beside a Panda in MuJoCo Playground: python step_playground.py EXPORT SECONDS NUM_SCENES.

Worlds draw their scenes, so that one may come twice. Prints JSON; see step_dm_control.py.
"""

import json
import sys
from pathlib import Path

# ruff: noqa: E402
folder = sys.argv[1]
seconds = float(sys.argv[2])
num_scenes = int(sys.argv[3])
sys.path.insert(0, folder)

from mujoco_playground import registry
from mujoco_playground._src import mjx_env

# Playground would clone MuJoCo Menagerie, of which nothing is used here.
Path(mjx_env.MENAGERIE_PATH).mkdir(parents=True, exist_ok=True)

import cluttergen_playground
import jax
import jax.numpy as jnp
import numpy as np

cluttergen_playground.register("ClutterPick")
env = registry.load("ClutterPick", config_overrides={"num_envs": num_scenes})
state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), num_scenes))
step = jax.jit(jax.vmap(env.step))
is_there = np.asarray(state.info["start"].is_present)


def positions(state):
    """f32[W, K, 3]."""
    return np.asarray(state.data.qpos)[:, env.world.object_qpos][..., :3]


start = positions(state)
moves = np.zeros(num_scenes)
is_finite = True
rest = jnp.zeros((num_scenes, env.action_size))
num_steps = round(seconds / env.dt)
for number in range(num_steps):
    state = step(state, rest)
    if number % 10 == 9:
        shift = np.linalg.norm(positions(state) - start, axis=-1)
        is_finite &= bool(np.isfinite(np.asarray(state.data.qpos)).all())
        moves = np.maximum(moves, np.where(is_there, shift, 0.0).max(1))
        print(f"{number + 1} of {num_steps} steps", file=sys.stderr, flush=True)
print(json.dumps({"moves": moves.tolist(), "is_finite": is_finite, "num_worlds": num_scenes}))
