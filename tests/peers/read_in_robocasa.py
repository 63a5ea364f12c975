"""Reads exported objects as RoboCasa does; needs robosuite 1.5, and robocasa where it is. Prints JSON.

robocasa is not on the package index. Its `MJCFObject` is robosuite's `MujocoXMLObject`, with a free joint and
a scale, plus regions: boxes called reg_*, whose pos, size and rgba it reads.
"""

import json
import sys
from pathlib import Path

# ruff: noqa: E402
folder = Path(sys.argv[1])
sys.path.insert(0, str(folder))

import cluttergen_robocasa as module
import mujoco
import numpy as np
from robosuite.models.arenas import EmptyArena
from robosuite.models.objects import MujocoXMLObject

try:
    from robocasa.models.objects.kitchen_object_utils import sample_kitchen_object
    from robocasa.models.objects.objects import MJCFObject
except ImportError:
    MJCFObject = None


def body(name, path, scale=1.0):
    """An object as RoboCasa makes it, and its box."""
    if MJCFObject is not None:
        thing = MJCFObject(name, path, scale=scale)
    else:
        joints = [{"type": "free", "damping": "0.0005"}]
        scales = np.array([scale] * 3)
        thing = MujocoXMLObject(
            path, name, joints, "all", duplicate_collision_geoms=False, scale=scales
        )
    boxes = [
        geom for geom in thing.worldbody.iter("geom") if str(geom.get("name")).endswith("reg_bbox")
    ]
    (box,) = (
        {key: np.fromstring(each.get(key), sep=" ") for key in ("pos", "size", "rgba")}
        for each in boxes
    )
    return thing, box


report = {}
for name, path in module.model_paths().items():
    thing, box = body(name, path)
    arena = EmptyArena()
    arena.merge_assets(thing)
    arena.worldbody.append(thing.get_obj())
    model = arena.get_model(mode="mujoco")
    _, twice = body(name, path, 2.0)
    index = model.body(thing.root_body).id
    report[name] = {
        "folder": Path(path).parent.parent.name,
        "size": box["size"].tolist(),
        "pos": box["pos"].tolist(),
        "rgba": box["rgba"].tolist(),
        "twice": twice["size"].tolist(),
        "mass": float(model.body_subtreemass[index]),
        "bottom": thing.bottom_offset.tolist(),
        "num_colliding": int(((model.geom_contype > 0) & (model.geom_bodyid == index)).sum()),
    }
if MJCFObject is not None:
    names = module.register()
    for seed in range(8):
        kwargs, info = sample_kitchen_object(
            "cluttergen", obj_registries=("cluttergen",), rng=np.random.default_rng(seed)
        )
        assert info["cat"] in names
        MJCFObject("drawn", **kwargs)
print(
    json.dumps(
        {"objects": report, "mujoco": mujoco.__version__, "robocasa": MJCFObject is not None}
    )
)
