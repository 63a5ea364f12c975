"""Gymnasium's environments: checked by its own checker, and against its own vector environment."""

import warnings
from functools import partial

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from cluttergen_jax.generation.gymnasium_envs import GymnasiumEnv, GymnasiumVectorEnv
from cluttergen_jax.generation.wrappers import ActionRange, FlatObservation
from cluttergen_jax.placement.env import PlacementEnv
from tests.helpers.problems import made_up_rules

NUM = 3


def of_one(flat=True):
    """Two objects in their order, two attempts each: equal actions give equal episodes, whatever the key."""
    rules = made_up_rules(num_objects=2, max_attempts=2, order="fixed", history_stride=12)
    env = PlacementEnv(rules, auto_reset=False)
    return ActionRange(FlatObservation(env) if flat else env, -1.0, 1.0)


@pytest.fixture(scope="module")
def single():
    return GymnasiumEnv(of_one())


@pytest.fixture(scope="module")
def envs():
    return GymnasiumVectorEnv(of_one(), NUM)


def made_vector_env(mode):
    """As `make_vector_env` makes it, with the call that does."""
    return GymnasiumVectorEnv(of_one(), NUM, mode, partial(made_vector_env, mode))


def actions(count):
    """About half of them to the side of the table on which objects stay."""
    return np.random.default_rng(0).uniform(-1, 1, (count, NUM, 4)).astype(np.float32)


def assert_equal(one, other):
    """Nested dictionaries, arrays and numbers; arrays of objects hold arrays or None."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            assert_equal(one[name], other[name])
    elif np.asarray(one).dtype.kind == "O":
        for mine, theirs in zip(one, other, strict=True):
            assert (mine is None) == (theirs is None)
            if mine is not None:
                assert_equal(mine, theirs)
    else:
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_gymnasium_checks_the_single_environment(single):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Metres have no bounds; and no picture is drawn.
        warnings.filterwarnings("ignore", message=".*infinity.*|.*render modes.*")
        check_env(single)


@pytest.mark.slow
@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_steps_are_those_of_gymnasium_s_own_vector_environment(mode):
    envs = made_vector_env(mode)
    separate = [GymnasiumEnv(of_one()) for _ in range(NUM)]
    theirs = SyncVectorEnv([lambda env=env: env for env in separate], autoreset_mode=mode)
    assert_equal(envs.reset(seed=0)[0], theirs.reset(seed=0)[0])
    num_ended = num_filled = 0
    for action in actions(40):
        mine = envs.step(action)
        other = theirs.step(action)
        for one, two in zip(mine, other, strict=True):
            assert_equal(one, two)
        num_ended += mine[2].sum()
        last = mine[4].get("final_info", {}) if mode == AutoresetMode.SAME_STEP else mine[4]
        num_filled += last.get("is_success", np.zeros(1)).sum()
    assert num_ended > num_filled > 0


def test_the_step_that_ends_an_episode_begins_the_next(envs):
    first, _ = envs.reset(seed=0)
    stays = np.array([0.8, 0, 0, 0])
    falls = np.array([-0.8, 0, 0, 0])
    envs.step(np.array([stays, falls, stays]))
    obs, reward, terminated, truncated, infos = envs.step(np.array([stays, falls, falls]))
    np.testing.assert_array_equal(terminated, [True, True, False])
    assert not truncated.any()
    assert reward[0] > reward[1]
    np.testing.assert_array_equal(obs[:2], first[:2])
    np.testing.assert_array_equal(infos["_final_obs"], terminated)
    assert infos["final_obs"][2] is None
    assert not np.array_equal(infos["final_obs"][0], infos["final_obs"][1])
    np.testing.assert_array_equal(infos["final_info"]["is_success"], [True, False, False])
    np.testing.assert_array_equal(infos["final_info"]["num_placed"], [2, 0, 0])
    np.testing.assert_array_equal(infos["num_placed"], [0, 0, 1])
    np.testing.assert_array_equal(infos["_num_placed"], [False, False, True])
    scenes = envs.scenes
    np.testing.assert_array_equal(scenes.is_placed.sum(-1), [2, 0, 0])
    np.testing.assert_allclose(scenes.poses[0, :, 0], 0.24, atol=1e-6)
    # Torch takes arrays as its own only where it may write.
    assert obs.flags.writeable
    assert obs.dtype == np.float32
