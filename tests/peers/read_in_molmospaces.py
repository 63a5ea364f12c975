"""Reads an export in MolmoSpaces by its own scripts and loaders. Prints JSON: see test_export_hosts."""

import json
import os
import sys
import tempfile
from pathlib import Path

# ruff: noqa: E402
folder = Path(sys.argv[1])
seconds = float(sys.argv[2])
# Nothing is to be fetched: its own libraries are set aside below.
for variable in ("MLSPACES_CACHE_DIR", "MLSPACES_ASSETS_DIR"):
    os.environ[variable] = tempfile.mkdtemp()

import mujoco
import numpy as np
from molmo_spaces import molmo_spaces_constants as constants

for sources in constants.DATA_TYPE_TO_SOURCE_TO_VERSION.values():
    sources.clear()
from molmo_spaces.env.data_views import create_mlspaces_body
from molmo_spaces.resources import generate_user_asset_library_index as assets
from molmo_spaces.resources import generate_user_grasp_library_index as grasps
from molmo_spaces.utils.grasps import load_pickup_grasps
from molmo_spaces.utils.lazy_loading_utils import get_user_library_index, locate_uid_package
from molmo_spaces.utils.mj_model_and_data_utils import body_aabb
from molmo_spaces.utils.object_metadata import UserLibraryMetadata
from molmo_spaces.utils.scene_metadata_utils import get_scene_metadata

library = folder / "assets" / "objects"
for module in (assets, grasps):
    sys.argv = ["index", str(library), "--overwrite"]
    module.main()
constants.register_user_asset_library("cluttergen", library)
constants.register_user_grasp_library("cluttergen", library, "cluttergen")

annotations = UserLibraryMetadata(library, get_user_library_index(library))
report = {"mujoco": mujoco.__version__, "objects": {}, "grasps": {}, "bodies": {}}
for path in sorted(library.glob("*/*.xml")):
    name = path.stem
    package, _, found = locate_uid_package(name)
    model = mujoco.MjModel.from_xml_path(str(found))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    center, size = body_aabb(model, data, 1, visible_only=False)
    annotation = annotations[name]
    report["objects"][name] = {
        "package": package,
        "nbody": model.nbody,
        "mass": model.body(1).mass.item(),
        "size": size.tolist(),
        "box": [annotation["boundingBox"][axis] for axis in "xyz"],
        "category": annotation["category"],
    }
    if (path.parent / "franka").is_dir():
        report["grasps"][name] = load_pickup_grasps(name, ["cluttergen/franka"]).tolist()
scene = min((folder / "scenes").glob("*.xml"))
model = mujoco.MjModel.from_xml_path(str(scene))
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
for name, about in get_scene_metadata(scene)["objects"].items():
    report["bodies"][name] = {
        "asset": about["asset_id"],
        "pose": create_mlspaces_body(data, name).pose.tolist(),
    }
for _ in range(round(seconds / model.opt.timestep)):
    mujoco.mj_step(model, data)
for name, told in report["bodies"].items():
    after = create_mlspaces_body(data, name).pose
    told["shift"] = float(np.linalg.norm(after[:3, 3] - np.array(told["pose"])[:3, 3]))
print(json.dumps(report))
