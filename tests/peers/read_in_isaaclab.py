"""What the script for Isaac Lab asks of it: each call, by stand-ins of the documented interface; needs torch.

python read_in_isaaclab.py EXPORT VERSION NUM_WORLDS; prints JSON: see test_export_isaaclab. Isaac Lab itself
is not imported: it starts Isaac Sim, which wants an NVIDIA GPU. VERSION, 2 or 3, says which writers the
stand-in of a collection has (isaaclab/assets/rigid_object_collection in Isaac Lab's repository), or 0: none.
"""

import json
import sys
from dataclasses import dataclass, field
from types import ModuleType, SimpleNamespace
from typing import Any

# ruff: noqa: E402
folder = sys.argv[1]
lab_version = int(sys.argv[2])
num_worlds = int(sys.argv[3])
sys.path.insert(0, folder)

import torch

written = {}


class Collection:
    """Of no version."""


class Collection2:
    """Isaac Lab 2.1 to 2.3."""

    def write_object_link_pose_to_sim(self, object_pose, env_ids=None, object_ids=None):
        """Quaternions wxyz."""
        written.update(poses=object_pose, env_ids=env_ids, order="wxyz")

    def write_object_com_velocity_to_sim(self, object_velocity, env_ids=None, object_ids=None):
        """Linear, then angular."""
        written.update(velocities=object_velocity)


class Collection3:
    """Isaac Lab 3.0."""

    def write_body_link_pose_to_sim_index(self, *, body_poses, body_ids=None, env_ids=None):
        """Quaternions xyzw."""
        written.update(poses=body_poses, env_ids=env_ids, order="xyzw")

    def write_body_com_velocity_to_sim_index(self, *, body_velocities, body_ids=None, env_ids=None):
        """Linear, then angular."""
        written.update(velocities=body_velocities)


@dataclass
class UsdFileCfg:
    """isaaclab/sim/spawners/from_files."""

    usd_path: str


@dataclass
class MultiUsdFileCfg:
    """isaaclab/sim/spawners/wrappers."""

    usd_path: list
    random_choice: bool = True


@dataclass
class AssetBaseCfg:
    """isaaclab/assets/asset_base_cfg.py."""

    @dataclass
    class InitialStateCfg:
        """Where it is spawned."""

        pos: tuple = (0.0, 0.0, 0.0)

    prim_path: str
    spawn: Any = None
    init_state: InitialStateCfg = field(default_factory=InitialStateCfg)


@dataclass
class RigidObjectCfg(AssetBaseCfg):
    """isaaclab/assets/rigid_object."""


@dataclass
class RigidObjectCollectionCfg:
    """isaaclab/assets/rigid_object_collection."""

    rigid_objects: dict


@dataclass
class EventTermCfg:
    """isaaclab/managers."""

    func: Any
    mode: str


kind = {0: Collection, 2: Collection2, 3: Collection3}[lab_version]
modules = {
    "isaaclab": {},
    "isaaclab.sim": {"UsdFileCfg": UsdFileCfg, "MultiUsdFileCfg": MultiUsdFileCfg},
    "isaaclab.assets": {
        "AssetBaseCfg": AssetBaseCfg,
        "RigidObjectCfg": RigidObjectCfg,
        "RigidObjectCollection": kind,
        "RigidObjectCollectionCfg": RigidObjectCollectionCfg,
    },
    "isaaclab.managers": {"EventTermCfg": EventTermCfg},
}
for name, content in modules.items():
    module = ModuleType(name)
    module.__dict__.update(content)
    sys.modules[name] = module
sys.modules["isaaclab"].sim = sys.modules["isaaclab.sim"]

try:
    from cluttergen_isaaclab import Clutter
except RuntimeError as error:
    print(json.dumps({"error": str(error)}))
    raise SystemExit from None

clutter = Clutter()
assets = clutter.assets()
event = clutter.event()


class Scene(dict):
    """isaaclab/scene/interactive_scene.py: entities by name, and where each world is."""

    env_origins = torch.arange(3.0 * num_worlds).reshape(num_worlds, 3)


env = SimpleNamespace(scene=Scene(clutter=kind()))
worlds = torch.arange(num_worlds)[1:]
event.func(env, worlds)
slots = assets["clutter"].rigid_objects
print(
    json.dumps(
        {
            "mode": event.mode,
            "support": [assets["support"].prim_path, assets["support"].spawn.usd_path],
            "slots": {
                name: [cfg.prim_path, cfg.spawn.usd_path, getattr(cfg.spawn, "random_choice", None)]
                for name, cfg in slots.items()
            },
            "spawned": [cfg.init_state.pos for cfg in slots.values()],
            "sets": clutter.sets,
            "sets_of_worlds": clutter.sets_of_worlds(num_worlds),
            "order": written["order"],
            "env_ids": written["env_ids"].tolist(),
            "poses": written["poses"].tolist(),
            "velocities": written["velocities"].tolist(),
            "origins": Scene.env_origins.tolist(),
        }
    )
)
