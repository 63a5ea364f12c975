"""Reads an export in LIBERO; needs libero, robosuite 1.4 and torch. Prints JSON: see test_export_peers."""

import json
import os
import re
import sys
import tempfile
from pathlib import Path

# ruff: noqa: E402
folder = Path(sys.argv[1])
seconds = float(sys.argv[2])
sys.path.insert(0, str(folder))
# LIBERO asks for its folders when it finds no answers.
answers = tempfile.TemporaryDirectory()
paths = dict.fromkeys(
    ("benchmark_root", "bddl_files", "init_states", "datasets", "assets"), answers.name
)
Path(answers.name, "config.yaml").write_text(json.dumps(paths))
os.environ["LIBERO_CONFIG_PATH"] = answers.name

import cluttergen_libero as module
import mujoco
import numpy as np
from libero.libero.benchmark import get_benchmark
from libero.libero.envs.env_wrapper import ControlEnv

OPTIONS = {"has_offscreen_renderer": False, "use_camera_obs": False}
number = module.scene_numbers()[0]
names = {entry["name"]: module.libero_name(entry) for entry in module.read_scene(number)["objects"]}


def refuse():
    """In the place of LIBERO's search for meshes of its own, which would download them."""
    raise AssertionError("LIBERO's own meshes are wanted")


module.bddl_base_domain.get_assets_path = refuse


def poses(env):
    """Position and quaternion wxyz of every object."""
    return {name: env.env.object_pose(own).tolist() for name, own in names.items()}


def inertia(env, body):
    """The tensor about the centre of mass, object axes."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, env.sim.model.body_iquat[body])
    turn = turn.reshape(3, 3)
    return (turn @ np.diag(env.sim.model.body_inertia[body]) @ turn.T).tolist()


def touched(env):
    """The objects that the robot touches."""
    robot = env.robots[0].robot_model
    models = [robot, robot.mount, env.robots[0].gripper]
    return [
        name
        for name, own in names.items()
        if any(env.env.check_contact(model, env.env.get_object(own)) for model in models)
    ]


env = module.make_env(number, **OPTIONS)
env.reset()
bodies = {name: env.env.obj_body_id[own] for name, own in names.items()}
report = {
    "mass": {name: float(env.sim.model.body_mass[body]) for name, body in bodies.items()},
    "inertia": {name: inertia(env, body) for name, body in bodies.items()},
    "before": poses(env),
    "touched": touched(env),
    "hand": float(env.env._eef_xpos[2]),
}
for _ in range(round(seconds * env.env.control_freq)):
    _, _, done, _ = env.step([0.0] * 7)
report |= {"after": poses(env), "done": bool(done)}
# What it writes is taken up by LIBERO's own door, with a goal of the user's own: the first object stays where
# the first scene has it, on a region of the table.
module.write_tasks()
suite = get_benchmark("ClutterGen")()
task = suite.get_task(0)
states = suite.get_task_init_states(0)
path = Path(task.problem_folder, task.bddl_file)
name = next(iter(names))
x, y = report["before"][name][:2]
spot = f"(spot (:target main_table) (:ranges (({x - 0.01} {y - 0.01} {x + 0.01} {y + 0.01}))))"
text = re.sub(r"\(False .*?\)", f"(On {names[name]} main_table_spot)", path.read_text())
path.write_text(text.replace("(:regions", f"(:regions {spot}"))
env = ControlEnv(str(path), **OPTIONS)
env.reset()
for key, state in zip(("restored", "other"), states, strict=True):
    env.step([1.0] * 7)
    env.set_init_state(state)
    report |= {key: poses(env), f"{key}_success": bool(env.check_success())}
print(json.dumps(report))
