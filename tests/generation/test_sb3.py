"""Stable-Baselines3's PPO learns for more than a hundred steps."""

import numpy as np
import pytest

import cluttergen_jax as cg

pytest.importorskip("stable_baselines3", reason="needs the extra sb3")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def envs():
    settings = {"pool": "dining", "support": "table-0.30x0.40", "num_objects": 2, "max_attempts": 2}
    return cg.make_sb3_env(4, **settings, action="surface", history_stride=0)


def test_its_checker_finds_nothing():
    from stable_baselines3.common.env_checker import check_env

    check_env(cg.make_gym_env(pool="dining", num_objects=2, history_stride=0))


def test_ends_are_told_as_it_wants_them(envs):
    envs.seed(0)
    first = envs.reset()
    rewards = np.zeros(4)
    ended = 0
    for length in range(1, 5):
        obs, reward, done, infos = envs.step(np.full((4, 3), -1.0))  # a corner: everything falls
        rewards += reward
        assert obs.shape == first.shape
        for index in np.flatnonzero(done):
            assert infos[index]["is_success"] is False
            assert infos[index]["episode"] == {"r": pytest.approx(rewards[index]), "l": length}
            assert infos[index]["terminal_observation"].shape == obs[index].shape
            rewards[index] = 0
            ended += 1
        if done.all():
            break
    assert ended == 4
    envs.seed(0)
    np.testing.assert_array_equal(envs.reset(), first)
