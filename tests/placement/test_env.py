"""The Brax environment: resets by itself, keeps figures, and everything stays in the region."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.placement.clouds import scene_cloud
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.placement.region import from_pose
from cluttergen_jax.types import Verdict
from tests.helpers.problems import made_up_rules, trio_problem

GOOD = jnp.array([0.9, 0.5, 0.5, 0.2])
BAD = jnp.array([0.1, 0.5, 0.5, 0.2])


def test_resets_itself_with_fresh_keys_and_keeps_figures():
    env = PlacementEnv(made_up_rules(max_attempts=2))
    state = jax.jit(env.reset)(jax.random.key(0))
    step = jax.jit(env.step)
    orders = []
    for _ in range(5):
        orders.append(np.asarray(state.pipeline_state.episode.object_index))
        for action in (GOOD, BAD):
            state = step(state, action)
            assert float(state.done) == 0
        state = step(state, BAD)
        assert float(state.done) == 1
        assert int(state.metrics["num_placed"]) == 1
        assert int(state.metrics["attempts_used"]) == 3
        assert int(state.pipeline_state.episode.slot) == 0
    assert int(state.metrics["num_finished"]) == 5
    assert len({tuple(order) for order in orders}) > 1
    assert float(state.info["truncation"]) == 0


@pytest.mark.slow
def test_an_action_that_is_no_number_is_a_failed_attempt():
    env = PlacementEnv(
        trio_problem(max_attempts=3, history_stride=12).rules, ObservationConfig(num_cells=4)
    )
    actions = (
        jnp.tile(GOOD, (4, 1))
        .at[jnp.arange(4), jnp.arange(4)]
        .set(jnp.array([jnp.nan] * 3 + [jnp.inf]))
    )
    step = jax.jit(jax.vmap(env.step))
    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 4))
    for number in (1, 2):
        state = step(state, actions)
        episode = state.pipeline_state.episode
        np.testing.assert_array_equal(episode.verdict, int(Verdict.NON_FINITE))
        np.testing.assert_array_equal(episode.attempt, number)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((state.obs, state.reward)))
    assert not episode.is_placed.any()


def test_scene_cloud_follows_the_poses():
    problem = trio_problem()
    geometry = problem.rules.geometry
    geometry = geometry.replace(
        cloud=jax.random.normal(jax.random.key(1), geometry.cloud.shape) * 0.02
    )
    pose = jnp.array([0.1, 0.05, 0.04, 0.6, 0.0, 0.0, 0.8])
    poses = jnp.zeros((3, 7)).at[1].set(pose)
    cloud, mask = scene_cloud(
        geometry.cloud, poses, jnp.arange(3) == 1, jnp.array([0.3, 0.35]), 400, 3
    )
    points = jax.vmap(from_pose(pose).apply)(geometry.cloud[1, :100])
    np.testing.assert_allclose(cloud[100:200], points, atol=1e-6)
    np.testing.assert_array_equal(mask, np.arange(400) < 200)
    assert bool(jnp.all(cloud[:100, 2] == 0))


def test_invariants_on_the_real_physics():
    problem = trio_problem()
    rules = problem.rules
    env = PlacementEnv(problem.rules)
    propose = make_proposer("random", rules)
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 32))

    def attempt(key, state):
        action = propose(key, state.pipeline_state.episode)
        return env.step(state, action)

    step = jax.jit(jax.vmap(attempt))
    stable = 0
    for index in range(12):
        before = state.pipeline_state.episode
        state = step(jax.random.split(jax.random.key(index), 32), state)
        after = state.pipeline_state.episode
        done = np.asarray(state.done) > 0
        kept = ~done & (np.asarray(after.slot) == np.asarray(before.slot))
        np.testing.assert_array_equal(np.asarray(after.poses)[kept], np.asarray(before.poses)[kept])
        moved_on = ~done & (np.asarray(after.slot) == np.asarray(before.slot) + 1)
        assert (np.asarray(after.verdict)[moved_on] == Verdict.STABLE).all()
        stable += moved_on.sum()
        placed = np.asarray(after.poses)[np.asarray(after.is_placed)]
        assert (np.abs(placed[:, :2]) <= [0.3 + 1e-4, 0.35 + 1e-4]).all()
    assert stable > 50
    assert float(state.metrics["num_finished"].min()) >= 1
