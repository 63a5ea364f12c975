"""Reads an export in ManiSkill; needs mani_skill. Prints JSON: see test_export_peers."""

import json
import sys
import tempfile
from pathlib import Path

# ruff: noqa: E402
folder = Path(sys.argv[1])
seconds = float(sys.argv[2])
sys.path.insert(0, str(folder))

import cluttergen_maniskill as module
import gymnasium
import h5py
import torch
from mani_skill.trajectory import utils

OPTIONS = {
    "robot_uids": "panda",
    "obs_mode": "none",
    "render_backend": "none",
    "sim_backend": "physx_cpu",
}
number = module.scene_numbers()[0]
env = gymnasium.make(module.ENV_ID, scene=number, **OPTIONS)
env.reset(seed=0)
scene = env.unwrapped


def poses():
    """Position and quaternion wxyz of every object."""
    return {n: [*a.pose.p[0].tolist(), *a.pose.q[0].tolist()] for n, a in scene.objects.items()}


report = {
    "mass": {name: actor._bodies[0].mass for name, actor in scene.objects.items()},
    "before": poses(),
}
for _ in range(round(seconds * scene.control_freq)):
    env.step(torch.zeros(env.action_space.shape))
report["after"] = poses()
# The states that it writes are put back in ManiSkill's own way, after the objects were thrown about.
with tempfile.TemporaryDirectory() as out:
    module.write_states(Path(out) / "states.h5", **OPTIONS)
    with h5py.File(Path(out) / "states.h5") as file:
        (state,) = utils.dict_to_list_of_dicts(file["traj_0/env_states"])
for actor in scene.objects.values():
    actor.set_pose(module.Pose.create_from_pq(torch.rand(1, 3)))
scene.set_state_dict({k: {n: torch.tensor(row) for n, row in v.items()} for k, v in state.items()})
print(json.dumps(report | {"restored": poses()}))
