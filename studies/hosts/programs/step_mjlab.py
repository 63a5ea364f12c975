"""10 s of a bank in mjlab on a CPU, one world for each scene: python step_mjlab.py EXPORT SECONDS NUM_SCENES.

Prints JSON; see step_dm_control.py.
"""

import json
import sys

# ruff: noqa: E402
folder = sys.argv[1]
seconds = float(sys.argv[2])
num_scenes = int(sys.argv[3])
sys.path.insert(0, folder)

import torch
from cluttergen_mjlab import Clutter
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.scene import SceneCfg
from mjlab.terrains import TerrainEntityCfg

_DECIMATION = 24

clutter = Clutter()
plane = TerrainEntityCfg(terrain_type="plane")
cfg = ManagerBasedRlEnvCfg(
    decimation=_DECIMATION,
    scene=SceneCfg(num_envs=num_scenes, terrain=plane, entities=clutter.entities()),
    sim=clutter.simulation(),
    events=clutter.events(),
    episode_length_s=10 * seconds,
)
env = ManagerBasedRlEnv(cfg, device="cpu")
slots = [f"clutter_{slot}" for slot in range(len(clutter.names))]


def positions():
    """f32[W, N, 3]."""
    found = [env.scene[slot].data.root_link_pose_w[..., :3] for slot in slots]
    return torch.stack(found, 1).clone()


env.reset()
start = positions()
moves = torch.zeros(num_scenes)
is_finite = True
num_steps = round(seconds / cfg.sim.mujoco.timestep / _DECIMATION)
for number in range(num_steps):
    env.step(torch.zeros(num_scenes, env.action_manager.total_action_dim))
    if number % 10 == 9:
        now = positions()
        is_finite &= bool(torch.isfinite(now).all())
        moves = torch.maximum(moves, (now - start).norm(dim=-1).amax(1))
        print(f"{number + 1} of {num_steps} steps", file=sys.stderr, flush=True)
print(json.dumps({"moves": moves.tolist(), "is_finite": is_finite, "num_worlds": num_scenes}))
