"""A scene that a person fills: by the same rules as any episode, undone to the bit, and timed."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from cluttergen_jax.placement.hand import HandScene
from cluttergen_jax.placement.problem import Setup
from cluttergen_jax.placement.region import no_keep_out
from cluttergen_jax.placement.types import Start
from cluttergen_jax.types import Verdict
from tests.helpers.problems import trio_problem

BOX = 0
PRISM = 1
TALL = 2
HALF_HEIGHT = (0.05, 0.03, 0.1)


def setup_of(**placement):
    problem = trio_problem(history_stride=0, **placement)
    return Setup(problem, no_keep_out(), Start.empty(3))


@pytest.fixture(scope="module")
def setup():
    return setup_of()


def begun(setup, first=None, key=0, **kinds):
    scene = HandScene(setup, jax.random.key(key), **kinds)
    if first is not None:
        scene.choose(first)
    return scene


def place(scene, which, x, y, yaw=0.0):
    scene.choose(which)
    scene.hold(x, y, yaw)
    scene.lower()
    return scene.drop()


def test_whatever_a_person_does_the_books_are_right(setup):
    """Random moves: objects are neither lost nor doubled, failures leave no trace, undoing restores bits."""
    rng = np.random.default_rng(1)
    scene = begun(setup)
    everything = set(scene.all)
    before = []
    attempts = dict.fromkeys(everything, 0)
    verdicts = []
    for _ in range(120):
        was = scene.poses.copy(), scene.is_placed.copy()
        move = rng.choice(["drop", "drop", "skip", "undo", "choose"])
        if move == "drop" and scene.left:
            scene.hold(*rng.uniform(-0.12, 0.12, 2), rng.uniform(-3, 3))
            if rng.random() < 0.8:
                scene.lower()
            current = scene.current
            verdict = scene.drop().attempt.verdict
            attempts[current] += 1
            verdicts.append(verdict)
            if verdict == Verdict.STABLE:
                before.append((current, *was))
                moved = np.linalg.norm(scene.poses[was[1], :3] - was[0][was[1], :3], axis=-1)
                assert moved.max(initial=0) < 0.002
                assert scene.is_placed[current]
            else:
                np.testing.assert_array_equal(scene.poses, was[0])
                assert scene.current == current
        elif move == "skip" and scene.left:
            following = [*scene.left[1:], scene.left[0]]
            scene.skip()
            assert scene.left == following
        elif move == "choose" and scene.left:
            chosen = int(rng.choice(scene.left))
            scene.choose(chosen)
            assert scene.current == chosen
        elif move == "undo" and before:
            index, poses, is_placed = before.pop()
            assert scene.undo() == index == scene.current
            np.testing.assert_array_equal(scene.poses, poses)
            np.testing.assert_array_equal(scene.is_placed, is_placed)
        assert set(scene.all) == everything
        assert set(np.flatnonzero(scene.is_placed)) == everything - set(scene.left)
        assert scene.can_undo == bool(before)
    counts = scene.result().counts
    result = scene.result()
    assert {
        k: int(n) for k, n in zip(result.object_index, counts.attempts, strict=True)
    } == attempts
    assert [int(n) for n in counts.verdicts] == [
        verdicts.count(v) for v in range(len(counts.verdicts))
    ]
    assert (counts.rest_steps > 0).tolist() == result.is_placed.tolist()
    assert len(set(verdicts)) > 2
    assert len(verdicts) > 25


def test_a_neighbour_that_is_pushed_is_named_and_put_back(setup):
    scene = begun(setup)
    place(scene, TALL, 0.0, 0.0)
    stood = scene.poses.copy()
    scene.choose(BOX)
    scene.hold(0.02, 0.0, 0.0)
    scene.lower()
    # Let go inside the other, not above it.
    scene.held = replace(scene.held, z=HALF_HEIGHT[BOX] + 0.001)
    drop = scene.drop()
    assert drop.attempt.verdict in (Verdict.DISPLACED, Verdict.PENETRATING, Verdict.FELL)
    assert drop.mover == TALL
    np.testing.assert_array_equal(scene.poses, stood)
    assert int(scene.result().verdict) == drop.attempt.verdict
