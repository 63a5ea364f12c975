"""Reads an export in robosuite; needs robosuite and h5py. Prints JSON: see test_export_peers."""

import json
import sys
import tempfile
from pathlib import Path

# ruff: noqa: E402
folder = Path(sys.argv[1])
seconds = float(sys.argv[2])
sys.path.insert(0, str(folder))

import cluttergen_robosuite as module
import h5py
import numpy as np
import robosuite

OPTIONS = {"has_renderer": False, "has_offscreen_renderer": False, "use_camera_obs": False}
number = module.scene_numbers()[0]
env = robosuite.make("ClutterGenScene", robots="Panda", scene=number, **OPTIONS)
env.reset()
names = [entry["name"] for entry in env.record["objects"]]


def poses():
    """Position and quaternion wxyz of every object."""
    return {name: env.object_pose(name).tolist() for name in names}


model = env.sim.model
bodies = {thing.name: model.body_name2id(thing.root_body) for thing in env.objects}
report = {
    "mass": {name: float(model.body_mass[body]) for name, body in bodies.items()},
    "before": poses(),
    "hand": float(env.sim.data.site_xpos[env.robots[0].eef_site_id["right"]][2]),
    "highest": env.record["bounds"][1][2],
}
for _ in range(round(seconds * env.control_freq)):
    env.step(np.zeros(env.action_dim))
report["after"] = poses()
# The states that it writes are put back as robosuite's own playback of demonstrations does.
with tempfile.TemporaryDirectory() as out:
    module.write_states(out)
    with h5py.File(Path(out) / f"{number:06d}" / "demo.hdf5") as file:
        info = json.loads(file["data"].attrs["env_info"])
        xml = file["data/demo_1"].attrs["model_file"]
        states = file["data/demo_1/states"][()]
env = robosuite.make(info.pop("env_name"), **info, **OPTIONS)
env.reset()
env.reset_from_xml_string(env.edit_model_xml(xml))
env.sim.reset()
env.sim.set_state_from_flattened(states[0])
env.sim.forward()
print(json.dumps(report | {"restored": poses()}))
