"""The decision process against its invariants, on a made-up physics with known answers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.placement.region import KeepOut, make_region, pose_of_action
from cluttergen_jax.placement.scenes import scene_of
from cluttergen_jax.placement.types import Start
from cluttergen_jax.types import Verdict
from tests.helpers.problems import SINK, HalfTable, made_up_rules, try_action
from tests.helpers.trees import same_bits

GOOD = jnp.array([0.9, 0.5, 0.5, 0.2])
BAD = jnp.array([0.1, 0.5, 0.5, 0.2])


def run(rules, actions, key=0):
    """The episodes before the first action and after each, and the rewards."""
    episodes = [rules.begin(jax.random.key(key))]
    rewards = []
    for action in actions:
        episode, transition = try_action(rules, episodes[-1], action)
        episodes.append(episode)
        rewards.append(float(transition.reward))
    return episodes, rewards


def test_commits_settled_poses():
    rules = made_up_rules()
    (before, after), _ = run(rules, [GOOD])
    focus = int(rules.focus(before))
    proposed = pose_of_action(GOOD, before.region, rules.height_range(before))
    np.testing.assert_allclose(after.poses[focus], proposed.at[2].add(-SINK), atol=1e-6)
    assert int(after.slot) == 1
    np.testing.assert_array_equal(after.is_placed, before.is_placed.at[focus].set(True))


def test_failed_attempt_leaves_the_scene_exactly_as_it_was():
    episodes, _ = run(made_up_rules(), [GOOD, BAD])
    before, after = episodes[1:]
    np.testing.assert_array_equal(after.poses, before.poses)
    np.testing.assert_array_equal(after.is_placed, before.is_placed)
    assert int(after.slot) == int(before.slot)


def test_history_is_the_objects_own():
    episodes, _ = run(made_up_rules(), [BAD, BAD, GOOD, BAD])
    assert [int(e.history.is_tried.sum()) for e in episodes] == [0, 1, 2, 0, 1]
    np.testing.assert_allclose(episodes[2].history.action[:2], jnp.stack([BAD, BAD]))
    assert not any(np.any(np.asarray(leaf)) for leaf in jax.tree.leaves(episodes[3].history))
    assert int(episodes[2].history.num_steps[1]) == 60


def test_attempts_run_out():
    rules = made_up_rules(max_attempts=3)
    episodes, _ = run(rules, [GOOD, BAD, BAD, BAD, GOOD])
    assert [bool(e.is_over) for e in episodes] == [False, False, False, False, True, True]
    assert not bool(episodes[-1].is_success)
    # A finished episode is left as it is.
    assert same_bits(episodes[4], episodes[5])
    assert not same_bits(episodes[3], episodes[4])


@pytest.mark.parametrize("stands", [True, False])
def test_success_asks_for_the_last_check(stands):
    episodes, _ = run(made_up_rules(physics=HalfTable(stands=stands)), [GOOD] * 4)
    last = episodes[-1]
    assert bool(last.is_over)
    assert bool(last.is_success) is stands
    assert int(last.verdict) == (Verdict.STABLE if stands else Verdict.CREPT)
    assert bool(scene_of(last).is_filled)


def test_counts_add_up():
    actions = [GOOD, BAD, GOOD, BAD, BAD, GOOD, GOOD]
    episodes, rewards = run(made_up_rules(), actions)
    counts = episodes[-1].counts
    np.testing.assert_array_equal(counts.attempts, [1, 2, 3, 1])
    np.testing.assert_array_equal(counts.steps, [23, 60 + 23, 60 * 2 + 23, 23])
    np.testing.assert_array_equal(counts.rest_steps, 23)
    assert int(counts.verdicts.sum()) == len(actions)
    assert int(counts.verdicts[Verdict.STABLE]) == 4
    assert int(counts.simulated_steps) == int(counts.steps.sum()) + 60
    np.testing.assert_allclose(counts.reward, sum(rewards), rtol=1e-5)


@pytest.mark.parametrize(
    ("kind", "first", "failed", "last"),
    [
        ("paper", -0.005 * 40 + 100, -0.005 * 40, -0.005 * 40 + 400),
        ("code", -0.005 * 10 + 100, -0.005 * 10, -0.005 * 10 + 1100),
        ("compressed", 1 - np.log1p(0.2) / 10, -np.log1p(0.2) / 10, 1 - np.log1p(0.2) / 10),
    ],
)
def test_rewards_by_hand(kind, first, failed, last):
    _, rewards = run(made_up_rules(reward=kind), [GOOD, BAD, GOOD, GOOD, GOOD])
    np.testing.assert_allclose(
        [rewards[0], rewards[1], rewards[-1]], [first, failed, last], rtol=1e-5
    )


@pytest.mark.slow
def test_height_range_is_the_tallest_and_the_new_one():
    rules = made_up_rules()
    episode = rules.begin(jax.random.key(3))
    heights = 0.02 * (1 + np.arange(6))
    for _ in range(3):
        tallest = max(
            [h for h, placed in zip(heights, episode.is_placed, strict=True) if placed], default=0
        )
        expected = tallest + heights[int(rules.focus(episode))]
        np.testing.assert_allclose(rules.height_range(episode), expected, rtol=1e-6)
        episode, _ = rules.attempt(episode, GOOD)


def test_order_is_a_uniform_permutation_of_a_uniform_subset():
    rules = made_up_rules(num_objects=4)
    keys = jax.random.split(jax.random.key(0), 4000)
    order = np.asarray(jax.vmap(lambda key: rules.begin(key).object_index)(keys))
    assert all(len(set(row)) == 4 for row in order)
    counts = np.stack([np.bincount(order[:, slot], minlength=6) for slot in range(4)])
    # Each count is binomial(4000, 1/6): standard deviation 23.6.
    assert np.abs(counts - 4000 / 6).max() < 5 * 23.6


def test_fixed_order_and_padding():
    rules = made_up_rules(world_size=3, order="fixed")
    np.testing.assert_array_equal(rules.begin(jax.random.key(0)).object_index, [0, 1, 2, -1])


def test_start_scene_counts_as_neighbours_and_is_not_drawn_again():
    rules = made_up_rules()
    poses = jnp.zeros((6, 7)).at[:, 3].set(1.0).at[2, :3].set(jnp.array([0.1, 0.1, 0.73]))
    start = Start(poses, jnp.arange(6) == 2)

    @jax.jit
    @jax.vmap
    def first_attempt(key):
        episode = rules.begin(key, start=start)
        return episode.object_index, rules.attempt(episode, GOOD)[0]

    drawn, after = first_attempt(jax.random.split(jax.random.key(0), 20))
    assert 2 not in np.asarray(drawn)
    np.testing.assert_array_equal(after.poses[:, 2], np.tile(poses[2], (20, 1)))
    assert after.is_placed[:, 2].all()


def test_outside_and_kept_out_are_not_stable():
    rules = made_up_rules()
    narrow = make_region(jnp.zeros(2), jnp.array([0.3, 0.2]), 0.0, 0.7)
    keep_out = KeepOut(jnp.array([[0.24, 0.0]]), jnp.array([[0.02, 0.02]]), jnp.zeros(1))
    episode = rules.begin(jax.random.key(0), region=narrow, keep_out=keep_out)
    after, _ = try_action(rules, episode, GOOD)
    assert int(after.verdict) == Verdict.OUTSIDE
    assert int(after.slot) == 0
    strict = made_up_rules(containment="footprint")
    after, _ = try_action(strict, strict.begin(jax.random.key(0)), GOOD.at[0].set(0.999))
    assert int(after.verdict) == Verdict.OUTSIDE


def test_looser_count_puts_neighbours_back():
    from cluttergen_jax.config import StabilityConfig

    class Pushes(HalfTable):
        def settle(self, poses, is_placed, focus, is_active):
            result = super().settle(poses, is_placed, focus, is_active)
            return result.replace(poses=result.poses.at[:, 0].add(0.001))

    strict = made_up_rules(physics=Pushes())
    loose = made_up_rules(physics=Pushes(StabilityConfig(judge_neighbours=False)))
    for rules, moves in ((strict, True), (loose, False)):
        episodes, _ = run(rules, [GOOD, GOOD])
        first = int(rules.focus(episodes[0]))
        assert bool(jnp.any(episodes[1].poses[first] != episodes[2].poses[first])) is moves
