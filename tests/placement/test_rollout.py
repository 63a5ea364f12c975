"""Rollouts: what is compiled for one world serves all of its sizes."""

import dataclasses

import jax
import jax.monitoring
import numpy as np
import pytest

from cluttergen_jax.generation import make_sampler
from cluttergen_jax.learning.agents import make_agent
from cluttergen_jax.learning.policies.policy import make_policy
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.rollout import BlockSampler, Rollout
from tests.helpers.problems import HalfTable, made_up_rules
from tests.helpers.runs import SMALL

NETWORKS = {
    "policy": SMALL,
    "mixture": dataclasses.replace(SMALL, head="mixture"),
}
PHYSICS = HalfTable()
PLACE = np.arange(8)
ALL = np.ones(8, bool)


def rules_of(scale):
    """Worlds of equal sizes, of objects of other proportions."""
    rules = made_up_rules(physics=PHYSICS, history_stride=60, max_attempts=2)
    cloud = jax.random.normal(jax.random.key(int(10 * scale)), (6, 1024, 3)) * 0.03
    geometry = rules.geometry.replace(half_extents=rules.geometry.half_extents * scale, cloud=cloud)
    return dataclasses.replace(rules, geometry=geometry)


def sampler_of(method, scale):
    rules = rules_of(scale)
    if method in ("random", "drop"):
        return BlockSampler(rules, make_proposer(method, rules))
    network = NETWORKS[method]
    agent = make_agent(rules, network)
    env = PlacementEnv(rules, agent.observation)
    seen = jax.eval_shape(env.reset, jax.random.key(0)).obs
    params = agent.init(jax.random.key(int(10 * scale)), seen)
    return BlockSampler(rules, make_policy(rules, network, params, is_sampled=True))


@pytest.fixture
def compiled():
    """The names of what has been compiled since the list was cleared."""
    found = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, seconds, **_: found.append(name) if "backend_compile" in name else None
    )
    yield found
    jax.monitoring.clear_event_listeners()


SLOW = {"drop", "mixture", "policy"}


@pytest.mark.parametrize(
    "method",
    [
        pytest.param(each, marks=[pytest.mark.slow] * (each in SLOW))
        for each in ("random", "drop", *NETWORKS)
    ],
)
def test_a_world_of_equal_sizes_compiles_nothing(method, compiled):
    rollout = Rollout()
    (first, second) = (sampler_of(method, scale) for scale in (1.0, 0.5))
    key = jax.random.key(3)
    rollout.compile(first, key, PLACE)
    assert compiled
    ours = rollout.run(first, key, PLACE, ALL)
    compiled.clear()
    theirs = rollout.run(second, key, PLACE, ALL)
    assert not compiled
    assert rollout.num_programs == 1
    # Each has its own world all the same: made by itself it is equal to what constants would make.
    assert not np.array_equal(ours.poses, theirs.poses)
    alone = Rollout(is_constant=True).run(second, key, PLACE, ALL)
    np.testing.assert_allclose(alone.poses, theirs.poses, atol=1e-4)


@pytest.mark.parametrize("method", ["random", pytest.param("policy", marks=pytest.mark.slow)])
def test_scenes_that_take_the_places_of_others_are_those_of_blocks(method):
    sampler = sampler_of(method, 1.0)
    key = jax.random.key(5)
    rollout = Rollout(lambda before, after, transition: (transition.is_made, transition.reward))
    blocks = [rollout.run(sampler, key, first + PLACE, ALL) for first in (0, 8, 16)]
    theirs = jax.tree.map(lambda *leaves: np.concatenate(leaves), *blocks)
    assert theirs.is_success.any()
    assert not theirs.is_success.all()
    for num_scenes in (3, 8, 21):
        logged: list = []
        ours = rollout.run_all(
            sampler, key, num_scenes, 8, lambda *step, logged=logged: logged.append(step)
        )
        jax.tree.map(
            lambda a, b, n=num_scenes: np.testing.assert_array_equal(a, b[:n]), ours, theirs
        )
        # Each attempt is told with the scene that it was made in, and each end once.
        assert sum(number for _, number, _ in logged) == num_scenes
        reward = np.zeros(num_scenes, np.float32)
        for indices, _, (is_made, paid) in logged:
            np.add.at(reward, indices[is_made], paid[is_made])
        np.testing.assert_allclose(reward, theirs.counts.reward[:num_scenes], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["guided", "policy"])
def test_native_scenes_are_the_same_to_the_bit_in_any_place(method):
    """What banks and evaluations are made of; ten objects, some of whose scenes take longer than others."""
    steps = make_sampler("dining", support="table-0.40x0.50", method=method, engine="native").steps
    rollout = Rollout()
    key = jax.random.key(0)
    place = np.arange(16)
    blocks = [rollout.run(steps, key, first + place, place < 16) for first in (0, 16, 32)]
    theirs = jax.tree.map(lambda *leaves: np.concatenate(leaves), *blocks)
    ours = rollout.run_all(steps, key, 48, 16)
    jax.tree.map(np.testing.assert_array_equal, ours, theirs)
    assert np.ptp(ours.counts.attempts.sum(1)) > 0
