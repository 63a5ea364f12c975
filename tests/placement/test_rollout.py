"""Rollouts: what is compiled for one world serves all of its sizes."""

import dataclasses
import itertools

import jax
import jax.monitoring
import numpy as np
import pytest

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.learning.agents import make_agent
from cluttergen_jax.learning.policies.policy import make_policy
from cluttergen_jax.placement.baselines import make_proposer
from cluttergen_jax.placement.changes import ChangedRegion, find_change
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.rollout import BlockSampler, Rollout
from cluttergen_jax.placement.rollout import run as run_module
from tests.helpers.problems import HalfTable, made_up_rules
from tests.helpers.runs import SMALL

NETWORKS = {
    "policy": SMALL,
    "mixture": dataclasses.replace(SMALL, head="mixture"),
}
PHYSICS = HalfTable()
PLACE, ALL = np.arange(8), np.ones(8, bool)


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


SLOW = {"mixture"}


@pytest.mark.parametrize(
    "method",
    [pytest.param(each, marks=[pytest.mark.slow] * (each in SLOW)) for each in ("random", "drop", *NETWORKS)],
)
def test_a_world_of_equal_sizes_compiles_nothing(method, compiled):
    rollout, (first, second) = Rollout(), (sampler_of(method, scale) for scale in (1.0, 0.5))
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


def test_worlds_of_other_sizes_or_settings_share_nothing():
    rollout, key = Rollout(), jax.random.key(0)
    one = sampler_of("random", 1.0)
    for changed in (
        one.rules,
        made_up_rules(world_size=7, physics=PHYSICS),
        made_up_rules(physics=PHYSICS, containment="footprint"),
    ):
        rollout.compile(BlockSampler(changed, make_proposer("random", changed)), key, PLACE)
    assert rollout.num_programs == 3


def test_programs_are_kept_up_to_a_number(monkeypatch):
    monkeypatch.setattr(run_module, "MAX_PROGRAMS", 2)
    rollout, key = Rollout(), jax.random.key(0)
    for attempts in (1, 2, 3, 4):
        rules = made_up_rules(physics=PHYSICS, max_attempts=attempts)
        rollout.compile(BlockSampler(rules, make_proposer("random", rules)), key, PLACE)
        assert rollout.num_programs <= 2


def test_steps_show_what_was_asked_for():
    sampler, key = sampler_of("random", 1.0), jax.random.key(1)
    steps = []
    rollout = Rollout(lambda before, after, transition: (before.slot, after.slot, transition.reward))
    is_wanted = ALL & (PLACE != 2)
    scenes = rollout.run(sampler, key, PLACE, is_wanted, lambda number, seen: steps.append((number, seen)))
    assert sum(number for number, _ in steps) == 7
    np.testing.assert_allclose(sum(seen[2] for _, seen in steps), scenes.counts.reward, rtol=1e-6)
    assert not scenes.counts.attempts[2].any()
    for (_, (_, after, _)), (_, (before, _, _)) in itertools.pairwise(steps):
        np.testing.assert_array_equal(after, before)


def test_region_draws_compare_by_value():
    one, same, other = (
        ChangedRegion(find_change(name), Rectangle(), Rectangle(), 0.7) for name in ("all", "all", "rotation")
    )
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
