"""Reads an exported scene in dm_control; needs that alone. Prints JSON: see test_export_hosts."""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
from dm_control import mjcf
from dm_control.mujoco import Physics

file = Path(sys.argv[1])
seconds = float(sys.argv[2])
own = json.loads((file.parents[1] / "MANIFEST.json").read_text())["scenes"][0]
names = [entry["name"] for entry in own["objects"]]
report = {"mujoco": mujoco.__version__}
# As a file of MuJoCo, and as a tree of elements, on which dm_control's composers work.
root = mjcf.from_path(str(file))
for kind, physics in (
    ("file", Physics.from_xml_path(str(file))),
    ("tree", mjcf.Physics.from_mjcf_model(root)),
):
    before = {name: physics.named.data.xpos[name].copy() for name in names}
    with physics.reset_context():
        physics.data.qpos[:] = physics.model.key_qpos[0]
    keyed = {name: physics.named.data.xpos[name].copy() for name in names}
    while physics.time() < seconds:
        physics.step()
    report[kind] = {
        "before": {name: [*before[name], *keyed[name]] for name in names},
        "mass": {name: float(physics.named.model.body_mass[name]) for name in names},
        "shift": {
            name: float(np.linalg.norm(physics.named.data.xpos[name] - keyed[name]))
            for name in names
        },
    }
print(json.dumps(report))
