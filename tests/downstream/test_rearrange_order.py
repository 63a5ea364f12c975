"""Order of picks against a search over all that can be done, meetings against geometry by hand."""

from collections import deque
from itertools import product

import numpy as np

from cluttergen_jax.downstream.rearrange.order import (
    Relations,
    is_possible,
    smallest_waiting,
)

START, AWAY, HOME = range(3)


def relations_of(number, blocks=(), lies_on=(), goal_on=()):
    found = np.zeros((3, number, number), bool)
    for table, pairs in zip(found, (blocks, lies_on, goal_on), strict=True):
        for pair in pairs:
            table[pair] = True
    return Relations(*found)


def fewest_waits(relations):
    """The fewest objects put down elsewhere, by a search over all states; None where nothing helps."""
    number = len(relations.blocks)
    first = (START,) * number
    best = {first: 0}
    queue = deque([first])
    while queue:
        state = queue.popleft()
        for k, place in product(range(number), (AWAY, HOME)):
            at_start = [i for i in range(number) if state[i] == START and i != k]
            if state[k] == HOME or (state[k] == AWAY and place == AWAY):
                continue
            if state[k] == START and any(relations.lies_on[i, k] for i in at_start):
                continue
            if place == HOME and any(relations.blocks[i, k] for i in at_start):
                continue
            if place == HOME and any(
                relations.goal_on[k, j] and state[j] != HOME for j in range(number)
            ):
                continue
            after = (*state[:k], place, *state[k + 1 :])
            cost = best[state] + (place == AWAY)
            if cost < best.get(after, 99):
                best[after] = cost
                queue.append(after)
    return best.get((HOME,) * number)


def drawn_relations(rng, number):
    """Random ones in which nothing lies on itself, in stacks that can be."""
    blocks = rng.random((number, number)) < 0.35
    above = np.triu(rng.random((number, number)) < 0.2, 1)
    order = rng.permutation(number)
    goal_on = np.triu(rng.random((number, number)) < 0.15, 1)[np.ix_(order, order)]
    np.fill_diagonal(blocks, False)
    return Relations(blocks, above, goal_on)


def test_the_fewest_waits_are_those_of_a_search_over_everything():
    rng = np.random.default_rng(0)
    sizes = []
    for _ in range(150):
        number = int(rng.integers(2, 5))
        relations = drawn_relations(rng, number)
        found = smallest_waiting(relations, range(number))
        assert (None if found is None else len(found)) == fewest_waits(relations)
        sizes.append(-1 if found is None else len(found))
    assert {0, 1, 2} <= set(sizes)


def test_what_swaps_needs_one_to_wait_and_a_ring_too():
    swap = relations_of(2, blocks=[(0, 1), (1, 0)])
    assert smallest_waiting(swap, [0, 1]) == (0,)
    assert not is_possible(swap, [0, 1], ())
    ring = relations_of(3, blocks=[(0, 1), (1, 2), (2, 0)])
    assert len(smallest_waiting(ring, range(3))) == 1
    two_rings = relations_of(4, blocks=[(0, 1), (1, 0), (2, 3), (3, 2)])
    assert len(smallest_waiting(two_rings, range(4))) == 2
    assert smallest_waiting(relations_of(3, blocks=[(0, 1), (1, 2)]), range(3)) == ()
