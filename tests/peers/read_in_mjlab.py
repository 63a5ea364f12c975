"""Steps a bank in mjlab on a CPU; needs mjlab and pyarrow. Prints JSON: see test_export_hosts.

python read_in_mjlab.py EXPORT NUM_WORLDS NUM_STEPS
"""

import json
import sys

# ruff: noqa: E402
folder = sys.argv[1]
num_worlds = int(sys.argv[2])
num_steps = int(sys.argv[3])
sys.path.insert(0, folder)

import numpy as np
import torch
from cluttergen_mjlab import Clutter
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.scene import SceneCfg
from mjlab.terrains import TerrainEntityCfg

clutter = Clutter()
plane = TerrainEntityCfg(terrain_type="plane")
scene = SceneCfg(num_envs=num_worlds, terrain=plane, entities=clutter.entities())
cfg = ManagerBasedRlEnvCfg(
    decimation=4,
    scene=scene,
    sim=clutter.simulation(nconmax=256, njmax=1500),
    events=clutter.events(),
    episode_length_s=100.0,
)
env = ManagerBasedRlEnv(cfg, device="cpu")
slots = [f"clutter_{slot}" for slot in range(len(clutter.names))]


def poses():
    """f64[W, N, 7], seen from each world's origin."""
    found = torch.stack([env.scene[slot].data.root_link_pose_w for slot in slots], 1).clone()
    found[..., :3] -= env.scene.env_origins[:, None]
    return found.double().numpy()


env.reset()
start = poses()
for _ in range(num_steps):
    env.step(torch.zeros(num_worlds, env.action_manager.total_action_dim))
shift = np.linalg.norm((poses() - start)[..., :3], axis=-1)
masses = env.sim.model.body_mass.numpy()
names = [env.sim.mj_model.body(index).name for index in range(env.sim.mj_model.nbody)]
sets = clutter.sets[clutter.sets_of_worlds(num_worlds)]
report = [
    {
        "objects": [clutter.bank.names[each] for each in sets[world]],
        "poses": start[world].tolist(),
        "mass": [float(masses[world, names.index(f"{slot}/object")]) for slot in slots],
        "shift": shift[world].tolist(),
    }
    for world in range(num_worlds)
]
print(json.dumps({"worlds": report, "seconds": num_steps * 4 * cfg.sim.mujoco.timestep}))
