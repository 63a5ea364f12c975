"""Exported scenes in LIBERO. It needs libero with robosuite 1.4 and torch, and lies in the export's folder.

    import cluttergen_libero
    env = cluttergen_libero.make_env(3, has_offscreen_renderer=False, use_camera_obs=False)

Scenes of the same objects are one task of several initial states. python cluttergen_libero.py OUT writes for
each task what LIBERO's own suites are made of, OUT/bddl_files/TASK.bddl and OUT/init_files/TASK.pruned_init.
Without OUT it writes into the export's folder, and there they are a suite by LIBERO's own door:

    suite = libero.libero.benchmark.get_benchmark("ClutterGen")()

A task's goal is never reached: write your own (:goal) and (:language) into its BDDL file. The object mug#2 is
called mug_2 there; a region's :target is main_table, its :ranges are metres from the middle of the region in
which objects were placed.

LIBERO's own meshes are not needed. libero 0.1.1 and robosuite 1.4.0 work with numpy 1.26 and MuJoCo 2.3.7 to
3.5, not with 3.17. They also import bddl 1.0.1, future, easydict, gymnasium, cloudpickle, matplotlib, numba,
scipy, termcolor, pyyaml, pillow and opencv-python. LIBERO asks for a folder when it is first imported.
"""

# ruff: noqa: E402
import argparse
import json
import tempfile
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from unittest.mock import patch

from host_checks import check_path, check_versions, scene_number

ROOT = Path(__file__).resolve().parent
check_path(ROOT)
KNOWN = {"robosuite": ("1.4.",), "mujoco": ("2.3.", "3.0.", "3.1.", "3.2.", "3.3.", "3.4.", "3.5.")}
"""How the versions begin that this was run with."""
check_versions(
    KNOWN,
    "robosuite==1.4.0 mujoco==3.3.7 torch beside libero",
    ("libero", "robosuite", "mujoco", "torch"),
)

import mujoco
import numpy as np
import torch
from libero.libero.benchmark import Benchmark, Task, register_benchmark
from libero.libero.envs import OBJECTS_DICT, TASK_MAPPING, bddl_base_domain
from libero.libero.envs.bddl_base_domain import BDDLBaseDomain, register_problem
from libero.libero.envs.bddl_utils import get_problem_info
from libero.libero.envs.env_wrapper import ControlEnv
from robosuite.models.arenas import EmptyArena
from robosuite.models.objects import MujocoXMLObject
from robosuite.models.tasks import ManipulationTask
from robosuite.utils.mjcf_utils import array_to_string, new_body, string_to_array

# Where LIBERO's robot stands at LIBERO's own table, and how high that is; its cameras are set to both.
_LIBERO_BASE = (-0.66, 0.0, 0.0)
_LIBERO_TOP = 0.9

_GAP = 0.2
"""Metres from the scenes to the middle of the robot's base, whose pedestal reaches 0.16 m."""
_HEADROOM = 0.24
"""Metres from the top of LIBERO's own table to the robot's fingers, less 2 cm."""
_HALF_THICKNESS = 0.025
"""Metres from the top of LIBERO's own table down to its body's frame, in which regions lie."""
_IS_OLD = [int(part) for part in mujoco.__version__.split(".")[:2]] < [3, 3]
"""Whether MuJoCo does not know yet how a mesh's own inertia is to be computed, which bodies do not use."""
_SCENES = {
    int(path.stem): json.loads(path.read_text(encoding="utf-8"))
    for path in sorted((ROOT / "scenes").glob("*.json"))
}
_SUPPORT = next(iter(_SCENES.values()))["support"]


def scene_numbers():
    """The numbers of all scenes in the folder."""
    return list(_SCENES)


def read_scene(number):
    """The record of one scene (ValueError: there is none of that number)."""
    return _SCENES[scene_number(number, scene_numbers(), ROOT)]


def libero_name(entry):
    """What an object of a scene's record is called in LIBERO: mug_1, mug_2."""
    return f"{entry['asset']}_{entry['name'].partition('#')[2] or 1}"


def _names(number):
    return tuple(sorted(libero_name(entry) for entry in read_scene(number)["objects"]))


def tasks():
    """For each task's name the numbers of its scenes, all of which hold the same objects."""
    groups = [list(group) for _, group in groupby(sorted(_SCENES, key=_names), _names)]
    return {f"clutter_{numbers[0]:06d}": numbers for numbers in sorted(groups)}


def _category(asset):
    # LIBERO has a mug, too.
    return f"cluttergen_{asset}"


def _base():
    edge = min(record["bounds"][0][0] for record in _SCENES.values())
    highest = max(record["bounds"][1][2] for record in _SCENES.values())
    top = max(_SUPPORT["top"], highest - _HEADROOM)
    return np.array([edge - _GAP, _SUPPORT["region"]["center"][1], top - _LIBERO_TOP])


_BASE = _base()
"""f64[3]: where the robot stands, clear of all scenes of the folder and high enough for its hand to be so."""


class ExportedObject(MujocoXMLObject):
    """A model of the folder with what LIBERO asks of its objects."""

    def __init__(self, file, category_name, name, joints="default"):
        super().__init__(
            str(ROOT / file), name=name, joints=joints, duplicate_collision_geoms=False
        )
        if _IS_OLD:
            for mesh in self.asset.iter("mesh"):
                mesh.attrib.pop("inertia", None)
        self.category_name = category_name
        self.rotation = (0, 0)
        self.rotation_axis = "z"
        self.object_properties: dict = {"vis_site_names": {}}


_SUPPORT_CATEGORY = "cluttergen-support"
_FILES = {_SUPPORT_CATEGORY: _SUPPORT["file"]}
for _record in _SCENES.values():
    _FILES.update({_category(asset): own["file"] for asset, own in _record["assets"].items()})
for _name, _file in _FILES.items():
    OBJECTS_DICT[_name] = partial(ExportedObject, _file, _name)


class ClutterGenManipulation(TASK_MAPPING["libero_tabletop_manipulation"]):  # type: ignore[name-defined]
    """LIBERO's tabletop with the exported support for its table.

    Args:
      bddl_file_name: a task that `write_tasks` wrote.
      scene: the number of the scene that a reset puts up; None for any of the task's scenes.
      kwargs: of LIBERO's own problems.
    """

    def __init__(self, bddl_file_name, *args, scene=None, **kwargs):
        self.scene = scene
        # LIBERO of the package index would download its own meshes, none of which is used here.
        with patch.object(bddl_base_domain, "get_assets_path", lambda: str(ROOT), create=True):
            super().__init__(bddl_file_name, *args, **kwargs)

    def _load_model(self):
        # LIBERO's own goes by the tables that it knows; this is what it does for each.
        super(BDDLBaseDomain, self)._load_model()
        self.robots[0].robot_model.set_base_xpos(_BASE)
        arena = EmptyArena()
        arena.set_origin([0, 0, 0])
        place = [*_SUPPORT["region"]["center"], _SUPPORT["top"] - _HALF_THICKNESS]
        arena.table_body = new_body("table", array_to_string(place))
        arena.worldbody.append(arena.table_body)
        self._setup_camera(arena)
        self._load_fixtures_in_arena(arena)
        self._load_objects_in_arena(arena)
        self._load_sites_in_arena(arena)
        self._generate_object_state_wrapper()
        self._setup_placement_initializer(arena)
        self.objects = list(self.objects_dict.values())
        self.fixtures = list(self.fixtures_dict.values())
        self.model = ManipulationTask(
            mujoco_arena=arena,
            mujoco_robots=[robot.robot_model for robot in self.robots],
            mujoco_objects=self.objects + self.fixtures,
        )

    def _setup_camera(self, mujoco_arena):
        super()._setup_camera(mujoco_arena)
        for camera in mujoco_arena.worldbody.iter("camera"):
            place = string_to_array(camera.get("pos")) + _BASE - _LIBERO_BASE
            camera.set("pos", array_to_string(place))

    def _reset_internal(self):
        super()._reset_internal()
        # Faces at rest on each other need more than one contact point; MuJoCo makes one unless told.
        self.sim.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_MULTICCD)
        # The detector of convex collisions in which the scenes stand whatever the version: libccd.
        self.sim.model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, "mjDSBL_NATIVECCD", 0))
        if self.deterministic_reset:
            return
        for entry in read_scene(self._draw_number())["objects"]:
            pose = np.concatenate([entry["position"], entry["quaternion_wxyz"]])
            self.sim.data.set_joint_qpos(self.objects_dict[libero_name(entry)].joints[0], pose)

    def _draw_number(self):
        if self.scene is not None:
            return self.scene
        here = tuple(sorted(self.objects_dict))
        numbers = [number for number in scene_numbers() if _names(number) == here]
        if not numbers:
            raise ValueError(f"no scene of this folder holds {', '.join(here)} and nothing else")
        return np.random.choice(numbers)  # noqa: NPY002, LIBERO's seed is numpy's own

    def object_pose(self, name):
        """f64[7]: an object's position and quaternion wxyz, world frame."""
        return np.array(self.sim.data.get_joint_qpos(self.objects_dict[name].joints[0]))


# Used as a decorator it would put None in the name's place.
register_problem(ClutterGenManipulation)


def bddl_text(number):
    """The task of a scene in LIBERO's language."""
    asset_of = itemgetter("asset")
    groups = groupby(sorted(read_scene(number)["objects"], key=asset_of), asset_of)
    names = {asset: sorted(map(libero_name, own)) for asset, own in groups}
    objects = "\n".join(f"    {' '.join(own)} - {_category(asset)}" for asset, own in names.items())
    return f"""(define (problem ClutterGenManipulation)
  (:domain robosuite)
  (:language clutter of {" and ".join(names).replace("_", " ")})
  (:regions
  )
  (:fixtures
    main_table - {_SUPPORT_CATEGORY}
  )
  (:objects
{objects}
  )
  (:obj_of_interest
    {" ".join(_names(number))}
  )
  (:init
  )
  (:goal
    (And (False {_names(number)[0]}))
  )
)
"""


def make_env(number, **kwargs):
    """LIBERO's own environment of a scene; kwargs are those of LIBERO's ControlEnv."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "task.bddl"
        path.write_text(bddl_text(number), encoding="utf-8")
        return ControlEnv(str(path), scene=number, **kwargs)


def write_tasks(folder=ROOT):
    """Writes bddl_files/TASK.bddl and init_files/TASK.pruned_init for every task.

    The latter is LIBERO's own format, f64[num_states, 1 + nq + nv]: the flattened MuJoCo states (time, qpos,
    qvel), the robot's included, of the task's scenes by number. A description that is there already may hold
    a goal of yours and raises FileExistsError.
    """
    for task, numbers in tasks().items():
        bddl, init = (Path(folder) / part for part in _files(task))
        if bddl.exists():
            raise FileExistsError(f"{bddl} is there already: name another folder, or remove it")
        env = make_env(
            numbers[0], has_offscreen_renderer=False, use_camera_obs=False, hard_reset=False
        )
        states = []
        for number in numbers:
            env.env.scene = number
            env.reset()
            states.append(env.get_sim_state())
        env.close()
        for path in (bddl, init):
            path.parent.mkdir(parents=True, exist_ok=True)
        torch.save(np.stack(states), init)
        bddl.write_text(bddl_text(numbers[0]), encoding="utf-8")


def _files(task):
    return f"bddl_files/{task}.bddl", f"init_files/{task}.pruned_init"


class ClutterGen(Benchmark):
    """The tasks that `write_tasks` wrote into a folder, as one of LIBERO's suites."""

    def __init__(self, task_order_index=0, folder=ROOT):
        super().__init__(task_order_index)
        self.name = "cluttergen"
        self.tasks = []
        folder = Path(folder).resolve()
        for task in tasks():
            bddl, init = _files(task)
            language = get_problem_info(str(folder / bddl))["language_instruction"]
            self.tasks.append(Task(task, language, "ClutterGen", str(folder), bddl, init))
        self.n_tasks = len(self.tasks)


register_benchmark(ClutterGen)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=write_tasks.__doc__)
    parser.add_argument("out", nargs="?", default=ROOT, help="a folder; this one if there is none")
    write_tasks(parser.parse_args().out)
