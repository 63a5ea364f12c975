"""Exported scenes in robosuite 1.5. It needs robosuite and lies in the export's folder.

    import robosuite, cluttergen_robosuite
    env = robosuite.make("ClutterGenScene", robots="Panda", scene=3, has_offscreen_renderer=False,
                         use_camera_obs=False)

python cluttergen_robosuite.py states writes states/NUMBER/demo.hdf5 for each scene in robosuite's own format
for demonstrations (it needs h5py, too). robosuite 1.5.2 works with MuJoCo 3.3, not with 3.17 or 4.
"""

# ruff: noqa: E402
import argparse
import datetime
import json
from pathlib import Path

from host_checks import check_path, check_versions, scene_number

ROOT = Path(__file__).resolve().parent
check_path(ROOT)
KNOWN = {"robosuite": ("1.5.",), "mujoco": ("3.2.", "3.3.")}
"""How the versions begin that this was run with."""
check_versions(KNOWN, "robosuite==1.5.2 mujoco==3.3.7", ("robosuite", "mujoco"))

import mujoco
import numpy as np
import robosuite
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import EmptyArena
from robosuite.models.objects import MujocoXMLObject
from robosuite.models.tasks import ManipulationTask

_TABLE_HEIGHT = 0.8
"""Height of robosuite's own tables, beside which its robots stand."""
_GAP = 0.2
"""Metres from the support and what overhangs it to the middle of the robot's base."""
_HEADROOM = 0.17
"""Metres from the top of such a table to the Panda's fingers in its first posture, less 3 cm."""


def scene_numbers():
    """The numbers of all scenes in the folder."""
    return sorted(int(path.stem) for path in (ROOT / "scenes").glob("*.json"))


def read_scene(number):
    """The record of one scene (ValueError: there is none of that number)."""
    number = scene_number(number, scene_numbers(), ROOT)
    return json.loads((ROOT / "scenes" / f"{number:06d}.json").read_text(encoding="utf-8"))


def _thing(file, name, joints):
    return MujocoXMLObject(
        str(ROOT / file), name=name, joints=joints, duplicate_collision_geoms=False
    )


class ClutterGenScene(ManipulationEnv):
    """One exported scene with a robot beside it, to be extended by a task: no reward.

    Args:
      robots: one robot, which stands at the support's side.
      scene: its number.
      kwargs: of robosuite's ManipulationEnv.
    """

    def __init__(self, robots, scene=None, **kwargs):
        if not isinstance(robots, str) and len(robots) != 1:
            raise ValueError(
                f"robots = {robots!r}. Allowed: one robot, which has its place beside the support. "
                "Try: robots='Panda'"
            )
        self.record = read_scene(scene_numbers()[0] if scene is None else scene)
        super().__init__(robots=robots, **kwargs)

    def reward(self, action=None):
        """No task: nothing is ever achieved."""
        return 0.0

    def _check_success(self):
        return False

    def _load_model(self):
        super()._load_model()
        support = self.record["support"]
        x = self.record["bounds"][0][0] - _GAP
        y = support["region"]["center"][1]
        # Higher where something would reach up to the hand.
        top = max(support["top"], self.record["bounds"][1][2] - _HEADROOM)
        for robot in self.robots:
            robot.robot_model.set_base_xpos([x, y, top - _TABLE_HEIGHT])
        arena = EmptyArena()
        arena.set_origin([0, 0, 0])
        self.support = _thing(support["file"], "support", None)
        assets = self.record["assets"]
        self.objects = [
            _thing(assets[entry["asset"]]["file"], entry["name"], "default")
            for entry in self.record["objects"]
        ]
        self.model = ManipulationTask(
            mujoco_arena=arena,
            mujoco_robots=[robot.robot_model for robot in self.robots],
            mujoco_objects=[self.support, *self.objects],
        )

    def _reset_internal(self):
        super()._reset_internal()
        # Faces at rest on each other need more than one contact point; MuJoCo 3.3 makes one unless told.
        self.sim.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_MULTICCD)
        # The detector of convex collisions in which the scenes stand whatever the version: libccd.
        self.sim.model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, "mjDSBL_NATIVECCD", 0))
        if self.deterministic_reset:
            return
        for entry, thing in zip(self.record["objects"], self.objects, strict=True):
            pose = np.concatenate([entry["position"], entry["quaternion_wxyz"]])
            self.sim.data.set_joint_qpos(thing.joints[0], pose)

    def object_pose(self, name):
        """f64[7]: an object's position and quaternion wxyz, world frame."""
        thing = next(each for each in self.objects if each.name == name)
        return np.array(self.sim.data.get_joint_qpos(thing.joints[0]))


def write_states(folder, robot="Panda", **kwargs):
    """Writes each scene's model and initial state, the robot's included, as NUMBER/demo.hdf5.

    A file is a demonstration of one state as robosuite's own scripts read it: `model_file` is the XML of the
    whole model, `states` the flattened MuJoCo state (time, qpos, qvel), `env_info` what makes the env.
    """
    import h5py

    headless = {
        "has_renderer": False,
        "has_offscreen_renderer": False,
        "use_camera_obs": False,
        **kwargs,
    }
    today = datetime.date.today()
    for number in scene_numbers():
        env = robosuite.make("ClutterGenScene", robots=robot, scene=number, **headless)
        env.reset()
        path = Path(folder) / f"{number:06d}" / "demo.hdf5"
        path.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(path, "w") as file:
            data = file.create_group("data")
            data.attrs["env"] = "ClutterGenScene"
            info = {"env_name": "ClutterGenScene", "robots": robot, "scene": number}
            data.attrs["env_info"] = json.dumps(info)
            data.attrs["repository_version"] = robosuite.__version__
            data.attrs["date"] = f"{today.month}-{today.day}-{today.year}"
            demo = data.create_group("demo_1")
            demo.attrs["model_file"] = env.sim.model.get_xml()
            demo.create_dataset("states", data=env.sim.get_state().flatten()[None])
            demo.create_dataset("actions", data=np.zeros((0, env.action_dim)))
        env.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=write_states.__doc__)
    parser.add_argument("out", help="a folder")
    parser.add_argument("--robot", default="Panda")
    parsed = parser.parse_args()
    write_states(parsed.out, parsed.robot)
