"""Exported scenes in Isaac Lab: worlds of a `RigidObjectCollection`, and a reset that puts them as in scenes.

    from cluttergen_isaaclab import Clutter      # in the export's folder; the application has started

    clutter = Clutter()
    for name, cfg in clutter.assets().items():   # "support", "clutter"
        setattr(scene_cfg, name, cfg)            # an `InteractiveSceneCfg`
    scene_cfg.replicate_physics = clutter.num_sets == 1
    events_cfg.reset_clutter = clutter.event()

A world keeps its objects: those of set (its number modulo the number of sets). A reset draws among all
scenes of the same objects, which are cached as states; `Clutter(num_sets=1)` takes the set with the most
scenes alone.

Neither Isaac Sim nor Isaac Lab has run this. What it stands on, in Isaac Lab's repository and documentation:

  RigidObjectCollectionCfg.rigid_objects, a dictionary of RigidObjectCfg, whose files have a rigid body as
    root: isaaclab/assets/rigid_object_collection/rigid_object_collection_cfg.py.
  RigidObjectCfg, AssetBaseCfg: prim_path with {ENV_REGEX_NS}, spawn, init_state.pos:
    isaaclab/assets/asset_base_cfg.py.
  UsdFileCfg.usd_path, and MultiUsdFileCfg with random_choice=False, by which worlds take files in order:
    isaaclab/sim/spawners/wrappers; documentation, "Spawning Multiple Assets", with replicate_physics=False.
  EventTermCfg(func, mode="reset"), called as func(env, env_ids): isaaclab/managers/manager_term_cfg.py.
  env.scene.env_origins, f32[W, 3], and env.scene["clutter"]: isaaclab/scene/interactive_scene.py.
  Isaac Lab 2.1 to 2.3: write_object_link_pose_to_sim(object_pose, env_ids) and
    write_object_com_velocity_to_sim(object_velocity, env_ids); quaternions wxyz; read back as
    data.object_link_pose_w: rigid_object_collection.py, rigid_object_collection_data.py.
  Isaac Lab 3.0: write_body_link_pose_to_sim_index(body_poses=, env_ids=) and
    write_body_com_velocity_to_sim_index(body_velocities=, env_ids=); quaternions xyzw; read back as
    data.body_link_pose_w: base_rigid_object_collection.py.
"""

import json
from collections import Counter
from pathlib import Path

import isaaclab.sim as sim_utils
import torch
from isaaclab.assets import (
    AssetBaseCfg,
    RigidObjectCfg,
    RigidObjectCollection,
    RigidObjectCollectionCfg,
)
from isaaclab.managers import EventTermCfg

ROOT = Path(__file__).resolve().parent
_ABOVE = 3.0
_AWAY = 1.0
"""Metres: where objects are spawned, which is where they are before the first reset."""
_WRITERS = {
    "3.0": ("write_body_link_pose_to_sim_index", "write_body_com_velocity_to_sim_index"),
    "2.1 to 2.3": ("write_object_link_pose_to_sim", "write_object_com_velocity_to_sim"),
}
"""What a collection of each version has; its package's own number says nothing of these."""


def _check_interface():
    known = _WRITERS.items()
    if not any(all(hasattr(RigidObjectCollection, each) for each in names) for _, names in known):
        raise RuntimeError(
            "this Isaac Lab is outside the known versions: its RigidObjectCollection has none of "
            + "; ".join(f"{', '.join(names)} ({release})" for release, names in known)
        )


_check_interface()


class Clutter:
    """The exported scenes, all of N objects.

    Args:
      num_sets: the sets of objects with the most scenes, so many; all if not given.

    Attributes:
      sets: for each set, the names of its N objects in slots 0 to N - 1.
      scenes: for each set, the numbers of its scenes.
      states: for each set, f32[its scenes, N, 7]: positions relative to a world's origin, metres, and
        quaternions wxyz.
    """

    def __init__(self, num_sets=None):
        manifest = json.loads((ROOT / "MANIFEST.json").read_text(encoding="utf-8"))
        self._folders = {each["name"]: each["folder"] for each in manifest["assets"]}
        found = {}
        for scene in manifest["scenes"]:
            objects = sorted(scene["objects"], key=lambda each: (each["asset"], each["name"]))
            poses = [[*each["position"], *each["quaternion_wxyz"]] for each in objects]
            names = tuple(each["asset"] for each in objects)
            found.setdefault(names, []).append((int(Path(scene["file"]).stem), poses))
        counts = Counter(len(names) for names in found)
        if len(counts) > 1:
            raise ValueError(
                f"scenes of {sorted(counts)} objects: worlds of a collection have the same number; "
                "export those of one number with --scenes"
            )
        most = sorted(found.items(), key=lambda item: -len(item[1]))
        if num_sets is not None and not 1 <= num_sets <= len(most):
            raise ValueError(f"num_sets = {num_sets}; there are {len(most)} sets of objects")
        most = most[:num_sets]
        self.sets = [names for names, _ in most]
        self.scenes = [[number for number, _ in scenes] for _, scenes in most]
        self.states = [torch.tensor([poses for _, poses in scenes]) for _, scenes in most]

    def __deepcopy__(self, memo):
        # Configurations are copied whole; this never changes.
        return self

    @property
    def num_sets(self):
        """How many sets of objects there are."""
        return len(self.sets)

    def assets(self):
        """The support, and the collection "clutter" with an object for each slot."""
        support = AssetBaseCfg(
            prim_path="{ENV_REGEX_NS}/Support",
            spawn=sim_utils.UsdFileCfg(usd_path=str(ROOT / "assets/support/support.usda")),
        )
        slots = {}
        for slot, names in enumerate(zip(*self.sets, strict=True)):
            place = RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, _ABOVE + _AWAY * slot))
            slots[f"slot_{slot}"] = RigidObjectCfg(
                prim_path=f"{{ENV_REGEX_NS}}/Clutter_{slot}",
                spawn=self._spawner([self._usd(name) for name in names]),
                init_state=place,
            )
        return {"support": support, "clutter": RigidObjectCollectionCfg(rigid_objects=slots)}

    def event(self):
        """The reset, for a configuration of events."""
        return EventTermCfg(func=self.reset, mode="reset")

    def sets_of_worlds(self, num_envs):
        """The number of the set that each world has."""
        return [world % self.num_sets for world in range(num_envs)]

    def reset(self, env, env_ids):
        """Puts these worlds' objects as in scenes of their sets, all equally likely; at rest.

        Args:
          env: its `scene` has a collection called "clutter". env_ids: i64[R], the worlds.
        """
        device = env.scene.env_origins.device
        worlds = env_ids.tolist()
        drawn = []
        for world in worlds:
            states = self.states[world % self.num_sets]
            drawn.append(states[torch.randint(len(states), ()).item()])
        poses = torch.stack(drawn).to(device)
        poses[..., :3] += env.scene.env_origins[env_ids][:, None]
        rest = torch.zeros((len(worlds), poses.shape[1], 6), device=device)
        write_states(env.scene["clutter"], poses, rest, env_ids)

    def _usd(self, name):
        return str(next((ROOT / self._folders[name]).glob("*.usda")))

    def _spawner(self, paths):
        if len(set(paths)) == 1:
            return sim_utils.UsdFileCfg(usd_path=paths[0])
        return sim_utils.MultiUsdFileCfg(usd_path=paths, random_choice=False)


def write_states(collection, poses, velocities, env_ids):
    """Writes states into a `RigidObjectCollection` of Isaac Lab 2 or 3.

    Args:
      poses: f32[R, N, 7], world frame, metres, wxyz. velocities: f32[R, N, 6]. env_ids: i64[R].
    """
    if hasattr(collection, "write_body_link_pose_to_sim_index"):
        xyzw = torch.cat([poses[..., :3], poses[..., 4:], poses[..., 3:4]], dim=-1)
        collection.write_body_link_pose_to_sim_index(body_poses=xyzw, env_ids=env_ids)
        collection.write_body_com_velocity_to_sim_index(body_velocities=velocities, env_ids=env_ids)
        return
    # Isaac Lab 2: quaternions wxyz, as ours.
    collection.write_object_link_pose_to_sim(poses, env_ids=env_ids)
    collection.write_object_com_velocity_to_sim(velocities, env_ids=env_ids)
