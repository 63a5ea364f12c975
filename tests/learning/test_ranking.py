"""Ranking candidates: begins as the search does, reads menus as promised, and learns from its choices."""

from dataclasses import asdict, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.agents import make_agent
from cluttergen_jax.learning.methods import make_filtered
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.networks.ranking import RankerConfig
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.learning.policies.policy import TrainedPolicy, load_policy
from cluttergen_jax.learning.ppo.checkpoint import save_policy
from cluttergen_jax.learning.ppo.ppo import PPO, PPOConfig
from cluttergen_jax.learning.ranking_env import PATCH_SIDE, RankingEnv
from cluttergen_jax.placement.baselines import LowestFit
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.region import action_scale
from cluttergen_jax.placement.search import SearchConfig
from tests.helpers.problems import trio_problem

SEARCH = SearchConfig(num_candidates=64, num_finalists=8)
CONFIG = RankerConfig(object_points=16, object_features=8, token_width=16, width=16, value_width=16)


@pytest.fixture(scope="module")
def rules():
    return trio_problem(history_stride=60).rules


@pytest.fixture(scope="module")
def search(rules):
    return LowestFit(rules, SEARCH)


def look(search, episode):
    """What a ranker sees."""
    return jax.jit(RankingEnv(search.rules, search=search).observe)(episode)


def zeros(shapes):
    """Arrays of these shapes."""
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)


def with_one_placed(rules, search, key):
    """An episode in which the search has placed the first object."""
    episode = rules.begin(key)
    return rules.attempt(episode, search(key, episode))[0]


def test_menu_holds_what_the_search_found(rules, search):
    episode = jax.jit(lambda key: with_one_placed(rules, search, key))(jax.random.key(1))
    menu = look(search, episode)["menu"]
    assert menu["features"].shape == (8, 16 + PATCH_SIDE**2)
    assert menu["action"].shape == (8, 4)
    assert bool(menu["is_allowed"].all())
    assert np.isfinite(menu["features"]).all()
    # The poses in the menu are those of its actions.
    lower, size = action_scale(episode.region, rules.height_range(episode))
    xy = lower[:2] + menu["action"][:, :2] * size[:2]
    np.testing.assert_allclose(menu["features"][:, 12:14], xy / episode.region.half_extents, atol=1e-5)


def test_failed_attempts_are_seen(rules, search):
    episode = rules.begin(jax.random.key(2))
    too_high = jnp.array([0.5, 0.5, 0.99, 0.5])
    failed = jax.jit(rules.attempt)(episode, too_high)[0]
    assert int(failed.attempt) == 1
    seen = look(search, failed)
    menu = seen["menu"]
    xy = menu["features"][:, 12:14] * episode.region.half_extents
    np.testing.assert_allclose(
        menu["features"][:, 10], 10 * np.minimum(np.linalg.norm(xy, axis=1), 0.2), atol=1e-4
    )
    assert "history" not in seen


def test_untrained_ranking_is_the_searchs_own(rules, search):
    _, agent = make_agent(rules, CONFIG)
    params = jax.jit(agent.init)(jax.random.key(3), look(search, rules.begin(jax.random.key(0))))

    policy = TrainedPolicy(RankingEnv(rules, search=search), agent, params, False, 5)

    def both(key):
        episode = with_one_placed(rules, search, key)
        menu = look(search, episode)["menu"]
        mine = policy(key, episode)
        return mine, menu["action"][jnp.argmin(menu["cost"])]

    mine, theirs = jax.jit(jax.vmap(both))(jax.random.split(jax.random.key(4), 16))
    np.testing.assert_array_equal(mine, theirs)


def test_env_takes_the_chosen_candidate(rules, search):
    env = RankingEnv(rules, search=search)
    state = jax.jit(env.reset)(jax.random.key(5))
    chosen = 3
    after = jax.jit(env.step)(state, jnp.int32(chosen))
    plain = jax.jit(PlacementEnv(rules).step)(state, state.obs["menu"]["action"][chosen])
    np.testing.assert_array_equal(after.pipeline_state.episode.poses, plain.pipeline_state.episode.poses)
    assert not np.array_equal(after.obs["menu"]["action"], state.obs["menu"]["action"])
    assert env.observation_size == jax.tree.map(lambda leaf: leaf.shape, state.obs)


@pytest.mark.slow
def test_learning_changes_the_order(rules, search):
    _, agent = make_agent(rules, CONFIG)
    env = RankingEnv(rules, search=search)
    config = PPOConfig(num_envs=4, num_steps=4, num_minibatches=2, num_epochs=2, num_attempts=16)
    ppo = PPO(env, agent.apply, config)
    params = agent.init(jax.random.key(0), jax.eval_shape(env.reset, jax.random.key(0)).obs)
    state = jax.jit(ppo.start)(jax.random.key(1), params)
    after, figures = jax.jit(ppo.update)(state)
    assert all(np.isfinite(value) for value in jax.device_get(jax.tree.leaves(figures)))
    before, after = agent.apply(params, state.env.obs)[0], agent.apply(after.params, state.env.obs)[0]
    assert float(jnp.abs(jnp.exp(before.logits) - jnp.exp(after.logits)).max()) > 1e-5


def test_filtered_proposals_are_those_of_the_policy_on_free_ground(rules, search):
    network = NetworkConfig(head="mixture", num_cells=6, history_width=0, width=16, num_layers=2)
    env, agent = make_agent(rules, network)
    observation = jax.eval_shape(env.reset, jax.random.key(0)).obs
    policy = TrainedPolicy(env, agent, jax.jit(agent.init)(jax.random.key(0), zeros(observation)), True, 5)
    filtered = make_filtered(policy, rules)
    half = rules.geometry.half_extents

    def verdicts(key):
        key_place, key_draw = jax.random.split(key)
        episode = with_one_placed(rules, search, key_place)
        action = filtered(key_draw, episode)
        drawn = policy.draw(key_draw, episode, filtered.num_draws)
        is_drawn = jnp.any(jnp.all(jnp.abs(drawn[:, :2] - action[:2]) < 1e-5, axis=1))
        height = action[2] * rules.height_range(episode) - half[rules.focus(episode), 2]
        return is_drawn, height, rules.attempt(episode, action)[0].slot

    is_drawn, height, slot = jax.jit(jax.vmap(verdicts))(jax.random.split(jax.random.key(6), 16))
    assert bool(is_drawn.all())
    np.testing.assert_allclose(height, 0.001, atol=1e-4)
    assert int((slot == 2).sum()) >= 15


@pytest.fixture
def stored(rules, tmp_path):
    """Folders of a fresh ranker and a fresh policy of poses, trained with up to five attempts."""
    for name, network in (("ranked", CONFIG), ("policy", NetworkConfig(width=16, num_layers=2))):
        env, agent = make_agent(rules, network)
        seen = jax.eval_shape(env.reset, jax.random.key(0)).obs
        params = jax.jit(agent.init)(jax.random.key(0), zeros(seen))
        record = {"network": asdict(network), "placement": {"max_attempts": 5, "history_stride": 60}}
        save_policy(tmp_path / name, params, record)
    return tmp_path


def with_attempts(rules, number):
    """The rules with another number of attempts."""
    return replace(rules, config=replace(rules.config, max_attempts=number))


def test_policies_act_with_fewer_attempts_than_they_were_trained_with(rules, stored):
    few = with_attempts(rules, 2)
    too_high = jnp.array([0.5, 0.5, 0.99, 0.5])
    for name, kind in (("ranked", "ranking"), ("policy", "pose")):
        checkpoint = read_checkpoint(stored / name)
        assert checkpoint.kind == checkpoint.network.kind == kind
        acting = {n: load_policy(checkpoint, r, is_sampled=False) for n, r in ((2, few), (5, rules))}
        actions = []
        for number, its_rules in ((2, few), (5, rules)):
            begun = its_rules.begin(jax.random.key(9))
            failed = jax.jit(its_rules.attempt)(begun, too_high)[0]
            actions.append(jax.jit(acting[number])(jax.random.key(1), failed))
        assert actions[0].shape == (4,)
        if kind == "pose":
            # What it is not allowed to try is as empty as what it has not tried yet.
            np.testing.assert_array_equal(*actions)


def test_policies_of_poses_refuse_more_attempts(rules, stored):
    many = with_attempts(rules, 7)
    load_policy(read_checkpoint(stored / "ranked"), many)
    with pytest.raises(ConfigError, match="max_attempts = 7"):
        load_policy(read_checkpoint(stored / "policy"), many)
