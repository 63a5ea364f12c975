"""Placers that draw uniformly among trusted candidates: what is looked at, and who is drawn."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.placement.candidate_sampler import CandidateConfig, CandidateSampler
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.methods.baselines import LowestFit
from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.types import Verdict

BOX = "calculator"


@cache
def rules_of(pool="office+study", objects=(BOX, "ring_binder"), support="table-0.40x0.50"):
    placement = PlacementConfig(num_objects=len(objects), order="fixed", history_stride=0)
    return make_problem(
        ProblemConfig(pool=pool, objects=objects, support=support, placement=placement)
    ).rules


class ByNumber(CandidateSampler, eq=False):
    """Trusts the candidates whose numbers are even; of the others number 1 the most."""

    def trust(self, episode, candidates):
        number = jnp.arange(len(candidates.is_allowed))
        return jnp.where(number % 2 == 0, 0.95, 0.5 / number.clip(1))


def chosen_numbers(kind, attempt=0, number=200):
    """Which candidates are drawn with so many keys for the choice, and the same candidates each time."""
    rules = rules_of()
    placer = kind(LowestFit(rules), CandidateConfig(num_uniform=10, num_finalists=0))
    episode = rules.begin(jax.random.key(0)).replace(attempt=jnp.int32(attempt))

    def draw(key):
        candidates = placer.candidates(jax.random.split(key)[0], episode)
        return jnp.argmin(jnp.abs(candidates.found.action - placer(key, episode)).sum(1))

    return np.asarray(jax.jit(jax.vmap(draw))(jax.random.split(jax.random.key(1), number)))


def test_only_the_trusted_are_drawn_and_all_of_them_alike():
    counts = np.bincount(chosen_numbers(ByNumber, number=1000), minlength=10)
    assert not counts[1::2].any()
    # Five equal chances in a thousand draws: 200 each, give or take five standard deviations.
    assert np.all(np.abs(counts[::2] - 200) < 5 * np.sqrt(1000 * 0.2 * 0.8))


@pytest.mark.slow
def test_the_threshold_falls_with_failures_and_then_stays():
    class Half(ByNumber, eq=False):
        def trust(self, episode, candidates):
            return jnp.full(len(candidates.is_allowed), 0.7).at[0].set(0.85)

    first, second, third, tenth = (set(chosen_numbers(Half, attempt)) for attempt in (0, 1, 2, 9))
    assert first == {0}
    assert second == {0}
    assert len(third) == 10
    assert len(tenth) == 10


def placed_first(rules):
    """An episode whose first object stands, and its pose."""
    episode = rules.begin(jax.random.key(0))
    clear = make_proposer("clear", rules)
    propose = jax.jit(lambda key, episode: rules.attempt(episode, clear(key, episode)))
    for seed in range(20):
        episode, transition = propose(jax.random.key(seed), episode)
        if int(transition.verdict) == Verdict.STABLE:
            return episode, np.asarray(episode.poses[0])
    raise AssertionError("the first object never stood")


def test_a_map_with_owners_is_the_map_to_a_micrometre():
    rules = rules_of()
    episode, _ = placed_first(rules)
    search = LowestFit(rules)
    see = jax.jit(
        lambda episode, with_owner: search.scene(episode, with_owner).heights, static_argnums=1
    )
    plain, owned = (see(episode, each) for each in (False, True))
    np.testing.assert_allclose(plain.height, owned.height, atol=1e-6)
    is_object = np.asarray(owned.owner) == 0
    assert is_object.any()
    assert set(np.unique(owned.owner)) == {0, rules.geometry.num_objects}
    assert np.asarray(owned.height)[is_object].min() > 0.003
