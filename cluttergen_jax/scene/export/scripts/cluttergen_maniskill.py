"""Exported scenes in ManiSkill 3. It needs mani_skill and lies in the export's folder.

    import gymnasium, cluttergen_maniskill
    env = gymnasium.make("ClutterGenScene-v1", scene=3, robot_uids="panda")

python cluttergen_maniskill.py states.h5 writes one trajectory per scene in ManiSkill's own format, each with
the scene's initial state as its only environment state (and states.json beside it).
"""

# ruff: noqa: E402
import argparse
import json
from pathlib import Path

from host_checks import check_versions, scene_number

ROOT = Path(__file__).resolve().parent
KNOWN = {"mani_skill": ("3.",)}
"""How the versions begin that this was run with."""
check_versions(KNOWN, "mani_skill==3.0.1 torch", ("mani_skill", "sapien", "torch", "h5py"))

import h5py
import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils import sapien_utils
from mani_skill.utils.building.ground import build_ground
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs.pose import Pose

ENV_ID = "ClutterGenScene-v1"
_GAP = 0.15
"""Metres from the support and what overhangs it to the middle of the robot's base."""


def scene_numbers():
    """The numbers of all scenes in the folder."""
    return sorted(int(path.stem) for path in (ROOT / "scenes").glob("*.json"))


def read_scene(number):
    """The record of one scene (ValueError: there is none of that number)."""
    number = scene_number(number, scene_numbers(), ROOT)
    return json.loads((ROOT / "scenes" / f"{number:06d}.json").read_text(encoding="utf-8"))


def _pose(position, quaternion):
    return sapien.Pose(p=position, q=quaternion)


@register_env(ENV_ID, max_episode_steps=200)
class ClutterGenSceneEnv(BaseEnv):
    """One exported scene, to be extended by a task: no reward, never successful.

    Args:
      scene: its number.
      robot_uids: any of ManiSkill's robots, or "none". Its base stands at the height of the table's top.
    """

    SUPPORTED_REWARD_MODES = ("none",)

    def __init__(self, *args, scene=None, robot_uids="none", **kwargs):
        self.record = read_scene(scene_numbers()[0] if scene is None else scene)
        self.objects = {}
        super().__init__(*args, robot_uids=robot_uids, **kwargs)

    def _base(self):
        support = self.record["support"]
        x = self.record["bounds"][0][0] - _GAP
        y = support["region"]["center"][1]
        return sapien.Pose(p=[x, y, support["top"]])

    @property
    def _default_sensor_configs(self):
        x, y = self.record["support"]["region"]["center"]
        top = self.record["support"]["top"]
        look = sapien_utils.look_at(eye=[x + 0.7, y - 0.5, top + 0.7], target=[x, y, top])
        return [CameraConfig("base_camera", look, 128, 128, np.pi / 3, 0.01, 100)]

    @property
    def _default_human_render_camera_configs(self):
        config = self._default_sensor_configs[0]
        return CameraConfig("render_camera", config.pose, 512, 512, np.pi / 3, 0.01, 100)

    def _load_agent(self, options):
        super()._load_agent(options, self._base())

    def _load_scene(self, options):
        friction = self.record["friction"]["sliding"]
        self._contact = sapien.physx.PhysxMaterial(friction, friction, 0.0)
        build_ground(self.scene)
        self._build_support()
        self.objects = {
            entry["name"]: self._build_object(entry) for entry in self.record["objects"]
        }

    def _build_support(self):
        support = self.record["support"]
        builder = self.scene.create_actor_builder()
        for box in support["boxes"]:
            place = _pose(box["center"], box["quaternion_wxyz"])
            builder.add_box_collision(place, box["half_extents"], self._contact)
            paint = None if support["visuals"] else self._paint(box["rgba"])
            # Without one, SAPIEN would make a material, which wants a renderer.
            if paint is not None:
                builder.add_box_visual(place, box["half_extents"], paint)
        for part in support["parts"]:
            path = str(ROOT / support["folder"] / part)
            builder.add_convex_collision_from_file(path, material=self._contact)
            if not support["visuals"]:
                builder.add_visual_from_file(path, material=self._paint(support["part_rgba"]))
        self._add_visuals(builder, support)
        builder.initial_pose = sapien.Pose()
        builder.build_static("support")

    def _build_object(self, entry):
        asset = self.record["assets"][entry["asset"]]
        builder = self.scene.create_actor_builder()
        friction = asset.get("friction", self.record["friction"]["sliding"])
        contact = sapien.physx.PhysxMaterial(friction, friction, 0.0)
        for part in asset["parts"]:
            path = str(ROOT / asset["folder"] / part)
            builder.add_convex_collision_from_file(path, material=contact)
        self._add_visuals(builder, asset)
        inertial = _pose(asset["center_of_mass"], asset["principal_quaternion_wxyz"])
        builder.set_mass_and_inertia(asset["mass"], inertial, asset["principal_moments"])
        builder.initial_pose = _pose(entry["position"], entry["quaternion_wxyz"])
        return builder.build_dynamic(entry["name"])

    def _add_visuals(self, builder, thing):
        for visual in thing["visuals"]:
            path = str(ROOT / thing["folder"] / visual["file"])
            image = visual["image"] and str(ROOT / thing["folder"] / visual["image"])
            finish = visual.get("finish", {})
            normal = finish.get("normal") and str(ROOT / thing["folder"] / finish["normal"])
            material = self._paint(visual["rgba"], image, finish, normal)
            builder.add_visual_from_file(path, material=material)

    def _paint(self, rgba, image=None, finish=None, normal=None):
        # A material wants a renderer; without one the scene is simulated all the same.
        try:
            material = sapien.render.RenderMaterial(base_color=rgba, roughness=0.65)
            if image:
                material.base_color_texture = sapien.render.RenderTexture2D(image)
            if normal:
                material.normal_texture = sapien.render.RenderTexture2D(normal, srgb=False)
            for name in ("roughness", "metallic", "transmission"):
                if finish and name in finish:
                    setattr(material, name, finish[name])
            return material
        except RuntimeError:
            return None

    def _initialize_episode(self, env_idx, options):
        with torch.device(self.device):
            for entry in self.record["objects"]:
                place = Pose.create_from_pq(
                    torch.tensor([entry["position"]]), torch.tensor([entry["quaternion_wxyz"]])
                )
                actor = self.objects[entry["name"]]
                actor.set_pose(place)
                actor.set_linear_velocity(torch.zeros(3))
                actor.set_angular_velocity(torch.zeros(3))

    def get_state_dict(self):
        """The state of all actors and of the robot; ManiSkill's own fails where there is no robot."""
        return self.scene.get_sim_state() if self.agent is None else super().get_state_dict()

    def evaluate(self):
        """No task: nothing is ever achieved."""
        return {"success": torch.zeros(self.num_envs, dtype=bool, device=self.device)}

    def _get_obs_extra(self, info):
        return {}


def initial_state(number):
    """The state dictionary of a scene, f32[1, 13] for each actor, for `env.set_state_dict`."""
    actors = read_scene(number)["env_state"]["actors"]
    return {"actors": {name: torch.tensor([row]) for name, row in actors.items()}}


def write_states(path, **kwargs):
    """Writes every scene's initial state, the robot's included, as a trajectory of one state."""
    import gymnasium

    episodes = []
    with h5py.File(path, "w") as file:
        for place, number in enumerate(scene_numbers()):
            env = gymnasium.make(ENV_ID, scene=number, **kwargs)
            env.reset(seed=0)
            group = file.create_group(f"traj_{place}")
            for kind, members in env.unwrapped.get_state_dict().items():
                for name, state in members.items():
                    group[f"env_states/{kind}/{name}"] = state.cpu().numpy().astype(np.float32)
            env.close()
            episodes.append(
                {"episode_id": place, "episode_seed": 0, "env_kwargs": {"scene": number}}
            )
    info = {"env_info": {"env_id": ENV_ID, "env_kwargs": kwargs}, "episodes": episodes}
    Path(path).with_suffix(".json").write_text(json.dumps(info, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=write_states.__doc__)
    parser.add_argument("out", help="an HDF5 file")
    parser.add_argument("--robot", default="none")
    parsed = parser.parse_args()
    write_states(parsed.out, robot_uids=parsed.robot)
