"""Orders, budgets and removal: by hand on a made-up physics, and end to end on the real one."""

from __future__ import annotations

import dataclasses
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise, permutations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.placement import rules as placement_rules
from cluttergen_jax.placement.config import MAX_MARGIN, ORDER_POWER, PlacementConfig
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.problem import ProblemConfig, compose
from cluttergen_jax.placement.rollout import BlockSampler, EpisodeRecorder
from cluttergen_jax.placement.rules import supported_by
from cluttergen_jax.placement.scenes import scene_of
from cluttergen_jax.placement.types import Start
from cluttergen_jax.types import Verdict
from tests.helpers.problems import HalfTable, made_up_rules, try_action
from tests.helpers.trees import same_bits
from tests.helpers.worlds import trio

GOOD = jnp.array([0.9, 0.5, 0.5, 0.2])
BAD = jnp.array([0.1, 0.5, 0.5, 0.2])
EMPTY_POSE = np.eye(7, dtype=np.float32)[3]
remove = jax.jit(placement_rules.remove)
choose_removal = jax.jit(placement_rules.choose_removal)


def sized_rules(side, **placement):
    """Made-up rules whose objects have square footprints of these half sides, in cm."""
    rules = made_up_rules(world_size=len(side), **placement)
    half = rules.geometry.half_extents.at[:, :2].set(0.01 * jnp.array(side, jnp.float32)[:, None])
    return dataclasses.replace(rules, geometry=rules.geometry.replace(half_extents=half))


def orders(rules, number=2000, seed=0):
    keys = jax.random.split(jax.random.key(seed), number)
    return np.asarray(jax.jit(jax.vmap(lambda key: rules.begin(key).object_index))(keys))


def play(rules, actions, episode=None, seed=0):
    """The episodes before the first action and after each."""
    episodes = [episode or rules.begin(jax.random.key(seed))]
    for action in actions:
        episodes.append(try_action(rules, episodes[-1], action)[0])
    return episodes


# Orders.


def test_largest_is_sorted_by_footprint():
    side = [2.0, 5.0, 1.0, 4.0, 3.0, 6.0]
    drawn = np.array(side)[orders(sized_rules(side, order="largest"))]
    assert (np.diff(drawn, axis=1) < 0).all()


@pytest.mark.parametrize("order", ["largest", "weighted"])
def test_the_subset_is_uniform_whatever_the_order(order):
    drawn = orders(sized_rules([2.0, 5.0, 1.0, 4.0, 3.0, 6.0], order=order), 4000)
    assert all(len(set(row)) == 4 for row in drawn.tolist())
    # Each object is in a scene with probability 2/3: standard deviation 29.8 of 4000.
    assert np.abs(np.bincount(drawn.ravel(), minlength=6) - 4000 * 2 / 3).max() < 5 * 29.8


def test_weighted_orders_are_those_of_plackett_and_luce():
    side = np.array([1.0, 1.1, 1.25])
    drawn = orders(sized_rules(side, order="weighted", num_objects=3), 8000)
    found = Counter(map(tuple, drawn.tolist()))
    weight = (side**2) ** ORDER_POWER
    for order in permutations(range(3)):
        left = weight.sum()
        chance = 1.0
        for index in order:
            chance = chance * weight[index] / left
            left = left - weight[index]
        assert abs(found[order] / 8000 - chance) < 5 * np.sqrt(chance * (1 - chance) / 8000)


def test_weighted_orders_follow_from_the_key_and_mostly_begin_with_the_largest():
    side = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    rules = sized_rules(side, order="weighted", num_objects=6)
    drawn = orders(rules)
    np.testing.assert_array_equal(drawn, orders(rules))
    assert 0.6 < (drawn[:, 0] == 5).mean() < 1
    place = np.argsort(drawn, axis=1).mean(0)
    assert (np.diff(place) < 0).all()


@pytest.mark.parametrize("order", ["largest", "weighted"])
def test_padding_comes_last_and_what_stands_first(order):
    rules = sized_rules([1.0, 3.0, 2.0], order=order, num_objects=4)
    drawn = orders(rules, 64)
    assert (drawn[:, 3] == -1).all()
    assert (np.sort(drawn[:, :3]) == [0, 1, 2]).all()
    rules = dataclasses.replace(rules, num_started=1)
    start = Start(jnp.tile(EMPTY_POSE, (3, 1)), jnp.arange(3) == 0)
    index = rules.begin(jax.random.key(0), start=start).object_index
    assert (int(index[0]), sorted(np.asarray(index[1:3])), set(np.asarray(index[3:]))) == (
        0,
        [1, 2],
        {-1},
    )


# Budgets.


def test_a_budget_ends_a_scene_that_cannot_be_filled_any_more():
    rules = made_up_rules(budget=6)
    episodes = play(rules, [BAD, GOOD, BAD, GOOD, BAD, GOOD, GOOD])
    # Four slots and six attempts: the third failure is one too many.
    assert [bool(each.is_over) for each in episodes] == [False] * 5 + [True] * 3
    last = episodes[-1]
    assert int(last.counts.attempts.sum()) == 5
    assert int(last.verdict) == Verdict.UNSETTLED
    scene = scene_of(last)
    assert not bool(scene.is_success)
    assert not bool(scene.is_filled)
    assert int(scene.is_placed.sum()) == 2


def test_a_scene_that_uses_its_whole_budget_succeeds():
    last = play(made_up_rules(budget=6), [BAD, GOOD, BAD, GOOD, GOOD, GOOD])[-1]
    assert bool(last.is_over)
    assert bool(last.is_success)
    assert int(last.counts.attempts.sum()) == 6


# Removal.


@dataclass(frozen=True)
class Leaning(HalfTable):
    """What comes to rest touches these objects, and is borne by those; pairs (object, other)."""

    touching: tuple[tuple[int, int], ...] = ()
    bearing: tuple[tuple[int, int], ...] = ()
    moved: tuple[int, ...] = ()

    def settle(self, poses, is_placed, focus, is_active):
        number = len(is_placed)

        def row(pairs):
            table = np.zeros((number, number), bool)
            for one, other in pairs:
                table[one, other] = True
            return jnp.asarray(table)[focus] & is_placed

        index = jnp.arange(number)
        is_moved = (index == focus) | jnp.isin(index, jnp.array([*self.moved, -1]))
        return (
            super()
            .settle(poses, is_placed, focus, is_active)
            .replace(
                touches=row(self.touching),
                bears=row(self.bearing),
                margin=jnp.where(is_moved, 0.001 * (1 + index), jnp.inf),
            )
        )


def leaning(pairs, moved=(), **placement):
    """Rules in which objects come in their order and lean on, and rest on, the given others."""
    physics = Leaning(touching=pairs, bearing=pairs, moved=moved)
    settings = {"order": "fixed", "num_objects": 6, "ruin_after": 5}
    return made_up_rules(physics=physics, **settings | placement)


def some(*indices):
    return jnp.isin(jnp.arange(6), jnp.array(indices))


# 1 on 0, 2 on 1, 3 on the table, 4 beside 3.
PILE = ((1, 0), (2, 1), (4, 3))


def test_what_leans_on_the_removed_goes_too_and_comes_again_after_the_current_object():
    rules = leaning(PILE)
    before = play(rules, [GOOD, BAD, GOOD, GOOD, GOOD, BAD])[-1]
    assert before.object_index.tolist() == [0, 1, 2, 3, 4, 5]
    after = remove(before, some(1), rules.geometry)
    # 1 and, as it lies on it, 2; the current object, 4, comes first.
    assert after.object_index.tolist() == [0, 3, 4, 1, 2, 5]
    assert (int(after.slot), int(after.attempt)) == (2, 0)
    np.testing.assert_array_equal(after.is_placed, some(0, 3))
    np.testing.assert_array_equal(after.poses[jnp.array([1, 2])], [EMPTY_POSE] * 2)
    np.testing.assert_array_equal(after.poses[jnp.array([0, 3])], before.poses[jnp.array([0, 3])])
    assert int(rules.focus(after)) == 4
    # What was spent goes along; what no longer stands did not come to rest.
    assert before.counts.attempts.tolist() == [1, 2, 1, 1, 1, 0]
    assert after.counts.attempts.tolist() == [1, 1, 1, 2, 1, 0]
    assert after.counts.steps.tolist() == [23, 23, 60, 83, 23, 0]
    assert after.counts.rest_steps.tolist() == [23, 23, 0, 0, 0, 0]
    assert same_bits(after.counts.verdicts, before.counts.verdicts)
    assert int(after.counts.steps.sum()) == int(before.counts.steps.sum())


def test_by_way_of_others_and_through_rings():
    leans_on = (
        jnp.zeros((6, 6), bool).at[jnp.array([1, 2, 3, 4]), jnp.array([0, 1, 2, 3])].set(True)
    )
    assert np.flatnonzero(supported_by(some(0), leans_on)).tolist() == [0, 1, 2, 3, 4]
    assert np.flatnonzero(supported_by(some(3), leans_on)).tolist() == [3, 4]
    assert np.flatnonzero(supported_by(some(5), leans_on)).tolist() == [5]
    assert not supported_by(some(), leans_on).any()
    ring = leans_on.at[1, 4].set(True)
    assert np.flatnonzero(supported_by(some(2), ring)).tolist() == [1, 2, 3, 4]


def test_what_carries_what_is_known_from_contacts():
    rules = leaning(PILE)
    bearing = play(rules, [GOOD] * 5)[-1].support_graph
    assert bearing.level.tolist() == [0, 1, 2, 0, 1, 0]
    assert sorted(map(tuple, np.argwhere(bearing.leans_on).tolist())) == sorted(PILE)
    np.testing.assert_allclose(bearing.margin, [0.001, 0.002, 0.003, 0.004, 0.005, 0.02])
    after = remove(play(rules, [GOOD] * 5)[-1], some(0), rules.geometry).support_graph
    assert np.argwhere(after.leans_on).tolist() == [[4, 3]]
    assert after.level.tolist() == [0, 0, 0, 0, 1, 0]
    np.testing.assert_allclose(after.margin, [0.02, 0.02, 0.02, 0.004, 0.005, 0.02])


def test_a_neighbour_that_is_moved_comes_to_lean_on_what_moved_it():
    rules = leaning(((2, 0), (2, 1)), moved=(1,))
    episode = play(rules, [GOOD] * 3)[-1]
    assert np.argwhere(episode.support_graph.leans_on).tolist() == [[1, 2], [2, 0], [2, 1]]
    # 0 did not move and stays, 1 did.
    assert np.flatnonzero(remove(episode, some(2), rules.geometry).is_placed).tolist() == [0]


def test_what_nothing_carries_has_the_least_margin():
    @dataclass(frozen=True)
    class Wedged(HalfTable):
        def settle(self, poses, is_placed, focus, is_active):
            margin = jnp.where(jnp.arange(len(is_placed)) == focus, -jnp.inf, jnp.inf)
            return super().settle(poses, is_placed, focus, is_active).replace(margin=margin)

    rules = made_up_rules(physics=Wedged(), order="fixed", ruin_after=3)
    np.testing.assert_allclose(play(rules, [GOOD])[-1].support_graph.margin[0], -MAX_MARGIN)


def test_what_stood_there_from_the_beginning_stays_with_all_that_leans_on_it():
    rules = dataclasses.replace(leaning(((1, 0), (2, 1)), num_objects=4), num_started=1)
    start = Start(jnp.tile(EMPTY_POSE, (6, 1)).at[0, 2].set(0.73), some(0))
    episode = play(rules, [GOOD, GOOD], rules.begin(jax.random.key(0), start=start))[-1]
    assert episode.object_index.tolist() == [0, 1, 2, 3, 4]
    assert same_bits(remove(episode, some(0), rules.geometry).poses, episode.poses)
    after = remove(episode, some(0, 1), rules.geometry)
    assert after.object_index.tolist() == [0, 3, 1, 2, 4]
    np.testing.assert_array_equal(after.is_placed, some(0))
    assert int(after.slot) == 1 == int(after.first_slot)
    for seed in range(20):
        chosen = choose_removal(episode.replace(key=jax.random.key(seed)), rules.geometry, some(0))
        assert chosen.any()
        assert not (chosen & ~some(1, 2)).any()


@pytest.mark.parametrize(("is_crowded", "low", "high"), [(False, 0.3, 1.0), (True, 0.0, 0.1)])
def test_in_a_crowded_scene_hardly_anything_that_carries_another_is_taken(is_crowded, low, high):
    rules = leaning(((1, 0), (2, 1)), num_objects=5)
    episode = play(rules, [GOOD] * 4)[-1]

    @jax.jit
    @jax.vmap
    def chosen(key):
        at = episode.replace(key=key)
        return placement_rules.choose_removal(at, rules.geometry, some(), is_crowded=is_crowded)

    found = np.asarray(chosen(jax.random.split(jax.random.key(0), 400)))
    assert found.any(1).all()
    assert low <= found[:, :2].any(1).mean() <= high


def test_ruin_comes_after_so_many_failures_and_only_where_it_can_be_made_good():
    rules = leaning((), ruin_after=2, budget=9, num_objects=4, max_attempts=5)
    episodes = play(rules, [GOOD, GOOD, GOOD, BAD, BAD])
    before, after = episodes[-2:]
    assert (int(before.slot), int(before.attempt)) == (3, 1)
    removed = int((before.is_placed & ~after.is_placed).sum())
    assert removed >= 1
    assert (int(after.slot), int(after.attempt)) == (3 - removed, 0)
    assert int(rules.focus(after)) == 3
    assert int(after.counts.attempts.sum()) == 5
    # With four attempts left for the one slot, an object that is stuck goes on alone until the budget ends.
    alone = play(
        dataclasses.replace(rules, config=dataclasses.replace(rules.config, budget=5)),
        [GOOD, GOOD, GOOD, BAD, BAD],
    )[-1]
    assert bool(alone.is_over)
    assert int(alone.is_placed.sum()) == 3


def test_every_failure_draws_another_ruin_even_where_nobody_changes_the_key():
    rules = leaning((), ruin_after=1, budget=200)
    chosen = set()
    episode = play(rules, [GOOD] * 5)[-1]
    for extra in range(20):
        counts = episode.counts.replace(attempts=episode.counts.attempts.at[0].add(extra))
        found = choose_removal(episode.replace(counts=counts), rules.geometry, some())
        chosen.add(tuple(np.flatnonzero(found).tolist()))
    assert len(chosen) > 3


def test_histories_are_the_turns_own():
    rules = leaning((), ruin_after=2, history_stride=12)
    episodes = play(rules, [GOOD, GOOD, BAD, BAD, BAD])
    assert [int(each.history.is_tried.sum()) for each in episodes[2:]] == [0, 1, 0, 1]


def test_more_failures_than_a_history_has_rows_leave_the_first_ones():
    # The first object has nothing to take away but itself: its turns begin anew.
    rules = leaning((), ruin_after=2, max_attempts=2, history_stride=12, num_objects=4)
    last = play(rules, [BAD] * 5)[-1]
    assert bool(last.is_over)
    assert int(last.counts.attempts.sum()) == 5
    assert last.history.is_tried.shape == (2,)


# Everything together, at random, under jit and vmap.


@pytest.fixture(scope="module")
def wild():
    """Every episode before each of 60 random attempts, and the transitions; the rules."""
    rules = leaning(PILE, order="weighted", ruin_after=2, budget=30, num_objects=5, max_attempts=4)

    def one(key):
        key_begin, key_steps = jax.random.split(key)

        def step(episode, key):
            bad = jax.random.uniform(key) < 0.45
            after, transition = rules.attempt(episode, jnp.where(bad, BAD, GOOD))
            return after, (episode, after, transition)

        return jax.lax.scan(step, rules.begin(key_begin), jax.random.split(key_steps, 60))[1]

    return rules, jax.device_get(jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), 64)))


@pytest.mark.slow
def test_a_scene_never_makes_more_attempts_than_its_budget(wild):
    rules, (before, after, made) = wild
    used = after.counts.attempts.sum(-1)
    assert used.max() <= rules.config.max_scene_attempts
    assert after.is_over[:, -1].all()
    left = rules.config.max_scene_attempts - before.counts.attempts.sum(-1)
    assert (left >= 5 - before.slot)[~before.is_over].all()
    np.testing.assert_array_equal(made.is_made.cumsum(1), used)
    # It ends as a failure only where fewer attempts are left than slots to fill.
    failed = after.is_over & (after.slot < 5)
    assert 0 < failed[:, -1].sum() < 64
    assert (rules.config.max_scene_attempts - used < 5 - after.slot)[failed].all()


def test_sums_stay_and_slots_hold_what_is_placed(wild):
    _, (before, after, made) = wild
    np.testing.assert_array_equal(after.counts.attempts.sum(-1), after.counts.verdicts.sum(-1))
    np.testing.assert_array_equal(
        np.sort(after.object_index[..., :5]), np.sort(before.object_index[..., :5])
    )
    slots = np.arange(5) < after.slot[..., None]
    placed = np.zeros((*after.slot.shape, 6), bool)
    np.put_along_axis(placed, after.object_index, slots, axis=-1)
    np.testing.assert_array_equal(after.is_placed, placed)
    assert (after.counts.rest_steps[slots] > 0).all()
    assert not after.counts.rest_steps[~slots].any()
    assert (after.poses[~after.is_placed] == EMPTY_POSE).all()
    is_ruined = (after.slot < before.slot) & made.is_made
    assert is_ruined.any()
    assert (after.attempt[is_ruined] == 0).all()
    assert not (
        after.support_graph.leans_on & ~(after.is_placed[..., None] & after.is_placed[..., None, :])
    ).any()


def test_attempts_of_a_slot_may_exceed_those_of_an_object(wild):
    rules, (_, after, _) = wild
    assert after.counts.attempts.max() > rules.config.max_attempts


@pytest.mark.slow
def test_vmap_changes_nothing():
    rules = leaning(PILE, ruin_after=2)
    before = play(rules, [GOOD, GOOD, GOOD, BAD])[-1]
    plain = jax.jit(rules.attempt)(before, BAD)
    mapped = jax.jit(jax.vmap(rules.attempt))(*jax.tree.map(lambda leaf: leaf[None], (before, BAD)))
    assert same_bits(plain, jax.tree.map(lambda leaf: leaf[0], mapped))


def test_a_brax_environment_takes_objects_away():
    env = PlacementEnv(leaning(PILE, ruin_after=2, budget=12, num_objects=4))
    assert env.episode_length == 12
    state = jax.jit(env.reset)(jax.random.key(0))
    step = jax.jit(env.step)
    slots = []
    done = []
    for action in [GOOD, GOOD, GOOD, BAD, BAD, *[GOOD] * 4]:
        state = step(state, action)
        slots.append(int(state.pipeline_state.episode.slot))
        done.append(bool(state.done))
    assert slots[:4] == [1, 2, 3, 3]
    assert slots[4] < 3
    assert done.index(True) == 4 + 4 - slots[4]
    assert float(state.metrics["success"]) == 1
    assert float(state.metrics["attempts_used"]) == done.index(True) + 1


# On the real physics.


NUM = 24


def tight(**placement):
    """Four of the trio, copies included, on a table of 9 x 12 cm, on which much goes wrong."""
    settings = {"num_objects": 4, "max_attempts": 4, "history_stride": 0}
    config = ProblemConfig(repeat=True, placement=PlacementConfig(**settings | placement))
    problem = compose(trio(), cuboid_table(0.09, 0.12), config)
    return problem, BlockSampler(problem.rules, make_proposer("drop", problem.rules))


def sampled(**placement):
    problem, sampler = tight(**placement)
    return (
        problem,
        sampler,
        jax.device_get(
            jax.jit(sampler.sample)(jax.random.key(7), np.arange(NUM), np.ones(NUM, bool))
        ),
    )


@pytest.fixture(scope="module")
def ruined():
    return sampled(ruin_after=2)


@pytest.mark.slow
def test_what_fails_without_is_filled_with_ruin(ruined):
    plain = sampled()[-1]
    scenes = ruined[-1]
    assert plain.is_success.mean() < 0.8 < scenes.is_success.mean()
    # Scenes that needed nothing of it are the same to the bit.
    is_easy = plain.counts.attempts.max(1) <= 2
    assert is_easy.any()
    np.testing.assert_array_equal(plain.poses[is_easy], scenes.poses[is_easy])
    assert scenes.counts.attempts.max() > 4
    assert scenes.counts.attempts.sum(1).max() <= 16


def test_every_finished_scene_stands(ruined):
    problem, _, scenes = ruined
    done = np.flatnonzero(scenes.is_success)
    assert len(done) > 10
    poses = np.tile(EMPTY_POSE, (len(done), problem.world.num_objects, 1))
    is_placed = np.zeros(poses.shape[:2], bool)
    index = scenes.object_index[done]
    np.put_along_axis(poses, index[..., None], scenes.poses[done], axis=1)
    np.put_along_axis(is_placed, index, True, axis=1)
    standing = jax.vmap(problem.rules.physics.stand)(poses, is_placed, np.ones(len(done), bool))
    assert (np.asarray(standing.verdict) == Verdict.STABLE).all()


@pytest.mark.slow
def test_a_recording_lets_what_is_taken_away_vanish(ruined):
    problem, sampler, scenes = ruined
    row = int(np.argmax(scenes.is_success * scenes.counts.attempts.max(1)))
    recording = EpisodeRecorder(sampler, problem.world, NUM).record(7, row)
    placed = scenes.object_index[row][scenes.is_placed[row]]
    np.testing.assert_array_equal(recording.poses[placed], scenes.poses[row][scenes.is_placed[row]])
    taken = [recording.taken_away(number).tolist() for number in range(len(recording.attempts))]
    assert any(taken)
    stood: set[int] = set()
    for gone, attempt in zip(taken, recording.attempts, strict=True):
        assert set(gone) <= stood
        stood -= set(gone)
        assert set(np.flatnonzero(attempt.is_placed)) == stood
        stood |= {attempt.object_index} if attempt.is_stable else set()
    assert stood == set(recording.placed)
    for slot, index in enumerate(scenes.object_index[row]):
        mine = recording.attempts_at(int(index))
        turn = recording.last_turn(int(index))
        assert len(mine) == scenes.counts.attempts[row, slot]
        assert [each.ordinal for each in turn] == list(range(1, len(turn) + 1))
        assert turn[-1].is_stable
        assert turn == mine[-len(turn) :]
    # An object's turn goes on until it stands, or until something is taken away.
    for one, two in pairwise(range(len(taken))):
        first = recording.attempts[one]
        second = recording.attempts[two]
        assert second.ordinal == (1 if first.is_stable or taken[two] else first.ordinal + 1)


@dataclass(frozen=True)
class Creeping(HalfTable):
    """In the last check whatever stands at x < 0.1 has moved by a centimetre."""

    def stand(self, poses, is_placed, is_active):
        moves = is_placed & (poses[:, 0] < 0.1)
        result = super().stand(poses, is_placed, is_active)
        verdict = jnp.where(moves.any(), int(Verdict.CREPT), int(Verdict.STABLE))
        return result.replace(verdict=verdict, shift=jnp.where(moves, 0.01, 0.0))


NEAR = jnp.array([0.6, 0.5, 0.5, 0.2])


def test_what_creeps_in_the_last_check_comes_again_while_attempts_are_left():
    settings = {"physics": Creeping(), "order": "fixed", "num_objects": 3, "ruin_after": 3}
    lost = play(made_up_rules(**settings), [GOOD, NEAR, GOOD])[-1]
    assert (bool(lost.is_over), bool(lost.is_success)) == (True, False)
    rules = made_up_rules(**settings, retry_last=True, budget=5)
    again = play(rules, [GOOD, NEAR, GOOD])[-1]
    assert (bool(again.is_over), int(again.slot), int(again.attempt)) == (False, 2, 0)
    assert again.object_index[:3].tolist() == [0, 2, 1]
    np.testing.assert_array_equal(again.is_placed, some(0, 2))
    # Once more where it creeps, and then the attempts are used up.
    spent = play(rules, [NEAR, NEAR], again)
    assert (bool(spent[1].is_over), int(spent[1].slot)) == (False, 2)
    assert (bool(spent[2].is_over), bool(spent[2].is_success)) == (True, False)
    assert int(spent[2].verdict) == Verdict.CREPT
    good = play(rules, [GOOD], again)[-1]
    assert (bool(good.is_over), bool(good.is_success)) == (True, True)
    assert good.counts.attempts.sum() == 4
