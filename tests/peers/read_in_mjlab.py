"""Steps a bank in mjlab on a CPU; needs mjlab and pyarrow. Prints JSON: see test_export_mjlab.

python read_in_mjlab.py EXPORT NUM_WORLDS SECONDS [NUM_RESETS]
"""

import inspect
import json
import sys

# ruff: noqa: E402
folder = sys.argv[1]
num_worlds = int(sys.argv[2])
seconds = float(sys.argv[3])
num_resets = int((*sys.argv, "1")[4])
sys.path.insert(0, folder)

import mujoco
import mujoco_warp
import numpy as np
import torch
from cluttergen_mjlab import Clutter
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.scene import SceneCfg
from mjlab.terrains import TerrainEntityCfg

CLAMP = "wp.max(t * t * t, types.MJ_MINVAL)"
"""The line of mujoco_warp's solver that mujoco_warp#1660 takes out."""

clutter = Clutter()
plane = TerrainEntityCfg(terrain_type="plane")
scene = SceneCfg(num_envs=num_worlds, terrain=plane, entities=clutter.entities())
cfg = ManagerBasedRlEnvCfg(
    decimation=8,
    scene=scene,
    sim=clutter.simulation(),
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


starts = []
for _ in range(num_resets):
    env.reset()
    starts.append(poses())
start = starts[-1]
shift = np.zeros((num_worlds, len(slots)))
for _ in range(round(seconds / (cfg.decimation * cfg.sim.mujoco.timestep))):
    env.step(torch.zeros(num_worlds, env.action_manager.total_action_dim))
    moved = np.linalg.norm((poses() - start)[..., :3], axis=-1)
    shift = np.fmax(shift, np.where(np.isfinite(moved), moved, 1e6))

model = env.sim.mj_model


def rows(values):
    """A row for each world; what is the same in all has one row there."""
    found = values.numpy()
    return np.broadcast_to(found, (num_worlds, *found.shape[1:]))


masses = rows(env.sim.model.body_mass)
friction = rows(env.sim.model.geom_friction)
meshes = rows(env.sim.wp_model.geom_dataid)
materials = rows(env.sim.wp_model.geom_matid)
bodies = [model.body(index).name for index in range(model.nbody)]
sets = clutter.sets[clutter.sets_of_worlds(num_worlds)]
touching = (model.geom_contype > 0) & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)


def seen_colour(world, body):
    """The colour of the first piece of a body that is seen."""
    shown = (model.geom_bodyid == body) & (model.geom_contype == 0) & (meshes[world] >= 0)
    if not shown.any():
        return []
    geom = np.flatnonzero(shown)[0]
    return model.mat_rgba[materials[world, geom]].tolist()


report = []
for world in range(num_worlds):
    own = [bodies.index(f"{slot}/object") for slot in slots]
    first = [int(np.flatnonzero(touching & (model.geom_bodyid == body))[0]) for body in own]
    report.append(
        {
            "objects": [clutter.bank.names[each] for each in sets[world]],
            "poses": start[world].tolist(),
            "starts": [each[world].tolist() for each in starts],
            "mass": [float(masses[world, body]) for body in own],
            "friction": [float(friction[world, geom, 0]) for geom in first],
            "priority": [int(model.geom_priority[geom]) for geom in first],
            "colour": [seen_colour(world, body) for body in own],
            "shift": shift[world].tolist(),
            "is_finite": bool((shift[world] < 1e6).all()),
        }
    )
used = meshes[:, touching]
print(
    json.dumps(
        {
            "worlds": report,
            "num_empty": int((used < 0).sum()),
            "num_without_hull": int((model.mesh_graphadr[np.unique(used[used >= 0])] < 0).sum()),
            "cone": cfg.sim.mujoco.cone,
            "has_clamp": CLAMP in inspect.getsource(mujoco_warp._src.solver),
            "robot": clutter.robot_pose(),
        }
    )
)
