"""What is let go alone on a level top is told without a simulation, as one would have told it."""

from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.geometry import turn_between
from cluttergen_jax.physics.alone import RELEASE_GAP, ROOM, Alone, level_tops
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.types import Verdict
from tests.helpers.worlds import TOP, box, layout_of, prism, tilted, trio

SIMULATED = StabilityConfig(both_detectors=True)
KNOWN = replace(SIMULATED, decide_alone=True)
HALF = (0.05, 0.03, 0.1)
"""Half the height of each object of the trio."""


@pytest.fixture(scope="module")
def layout():
    return layout_of(trio())


@pytest.fixture(scope="module")
def known(layout):
    return NativePhysics(layout, KNOWN)


@pytest.fixture(scope="module")
def simulated(layout):
    return NativePhysics(layout, SIMULATED)


def counted(monkeypatch):
    """The attempts that are simulated from here on: their number, in a list."""
    numbers = []
    simulate = NativePhysics.settle_block

    def count(engine, poses, *others):
        numbers.append(len(poses))
        simulate(engine, poses, *others)

    monkeypatch.setattr(NativePhysics, "settle_block", count)
    return numbers


def scenes_of(num_scenes, seed):
    """Three objects upright all over the table and its edges, near one another or not, and a focus each."""
    rng = np.random.default_rng(seed)
    poses = np.zeros((num_scenes, 3, 7), np.float32)
    poses[..., :2] = rng.uniform((-0.32, -0.37), (0.32, 0.37), (num_scenes, 3, 2))
    poses[..., 2] = TOP + np.array(HALF)
    near = rng.uniform(size=num_scenes) < 0.5
    poses[near, 1, :2] = poses[near, 0, :2] + rng.uniform(-0.12, 0.12, (near.sum(), 2))
    yaw = rng.uniform(0, 2 * np.pi, (num_scenes, 3))
    poses[..., 3] = np.cos(yaw / 2)
    poses[..., 6] = np.sin(yaw / 2)
    focus = rng.integers(3, size=num_scenes)
    rows = np.arange(num_scenes)
    poses[rows, focus, 2] += RELEASE_GAP
    is_placed = rng.uniform(size=(num_scenes, 3)) < 0.7
    is_placed[rows, focus] = True
    return poses, is_placed, focus


def test_attempts_end_as_those_that_are_simulated(known, simulated, monkeypatch):
    scenes = (*scenes_of(300, seed=0), np.ones(300, bool))
    expected = simulated.settle_batch(*scenes)
    numbers = counted(monkeypatch)
    found = known.settle_batch(*scenes)
    # The trials of three objects, six each, and the attempts that geometry does not decide.
    assert numbers[0] == 18
    assert 60 < sum(numbers[1:]) < 240
    np.testing.assert_array_equal(found.verdict, expected.verdict)
    assert len(set(found.verdict.tolist())) >= 3
    stable = found.verdict == int(Verdict.STABLE)
    shift = np.linalg.norm(found.poses[..., :3] - expected.poses[..., :3], axis=-1)
    assert shift[stable].max() < 5e-5
    turn = turn_between(
        np, *(each.poses[stable, :, 3:].astype(float) for each in (found, expected))
    )
    assert turn.max() < 1e-3
    np.testing.assert_allclose(found.margin[stable], expected.margin[stable], atol=2e-4)
    np.testing.assert_array_equal(found.touches, expected.touches)
    assert np.abs(found.num_steps - expected.num_steps)[stable].max() <= 6
    path = np.abs(found.trajectory - expected.trajectory)[stable][..., :7]
    assert path.max() < 2e-3
    np.testing.assert_allclose(found.trajectory[:, 0], expected.trajectory[:, 0], atol=1e-6)


def test_nothing_else_is_taken_for_granted(known, simulated):
    alone = np.array([[0.1, 0.1, TOP + HALF[2] + 0.001, 1, 0, 0, 0]], np.float32)
    cases = {
        "tilted": (*alone[0, :3], *tilted((1.0, 0.0, 0.0), 2.0)),
        "high": (0.1, 0.1, TOP + HALF[2] + 0.002, 1, 0, 0, 0),
        "sunk": (0.1, 0.1, TOP + HALF[2] - 0.001, 1, 0, 0, 0),
        "over the edge": (0.295, 0.1, TOP + HALF[2] + 0.001, 1, 0, 0, 0),
        "beside the table": (0.5, 0.1, TOP + HALF[2] + 0.001, 1, 0, 0, 0),
        "touching": (0.1, 0.1, TOP + HALF[2] + 0.001, 1, 0, 0, 0),
    }
    poses = np.tile(np.array([0.0, 0.0, 5.0, 1.0, 0, 0, 0], np.float32), (len(cases), 3, 1))
    poses[:, 2] = list(cases.values())
    poses[:, 0] = (-0.2, -0.2, TOP + HALF[0], 1, 0, 0, 0)
    poses[-1, 0, :2] = (0.1 + 0.04 + ROOM / 2, 0.1)
    is_placed = np.tile([True, False, True], (len(cases), 1))
    scenes = (poses, is_placed, np.full(len(cases), 2), np.ones(len(cases), bool))
    found = known.settle_batch(*scenes)
    expected = simulated.settle_batch(*scenes)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_topples_in_some_turns_is_always_simulated(monkeypatch):
    # Its centre of mass is a hair within its base.
    leaning = box("leaning", (0.02, 0.02, 0.1))
    leaning = replace(leaning, center_of_mass=np.array([0.01999, 0.0, 0.0]))
    layout = layout_of([leaning])
    scene = np.array([[[0, 0, TOP + 0.101, 1, 0, 0, 0]]], np.float32)
    asked = (scene, np.ones((1, 1), bool), np.zeros(1, int), np.ones(1, bool))
    expected = NativePhysics(layout, SIMULATED).settle_batch(*asked)
    numbers = counted(monkeypatch)
    found = NativePhysics(layout, KNOWN).settle_batch(*asked)
    assert found.verdict == expected.verdict
    if expected.verdict != int(Verdict.STABLE):
        assert numbers == [6, 1]


def test_scenes_of_what_rests_alone_are_asked_of_one_detector(known, simulated):
    poses, is_placed, _ = scenes_of(200, seed=3)
    apart = poses.copy()
    apart[..., :2] = [(-0.2, -0.2), (0.0, 0.2), (0.2, 0.0)]
    scenes = np.concatenate([poses, apart])
    there = np.concatenate([is_placed, is_placed])
    # Where they have come to rest.
    for index, half in enumerate(HALF):
        scenes[:, index, 2] = TOP + half
        settled = known.settle_batch(
            scenes, there, np.full(len(scenes), index), there[:, index].copy()
        )
        good = settled.verdict == int(Verdict.STABLE)
        scenes[good] = settled.poses[good]
    everything = np.ones(len(scenes), bool)
    found = known.stand_batch(scenes, there, everything)
    expected = simulated.stand_batch(scenes, there, everything)
    np.testing.assert_array_equal(found.verdict, expected.verdict)
    assert len(set(found.verdict.tolist())) >= 2
    fewer = found.num_steps < expected.num_steps
    assert fewer[200:].mean() > 0.9
    assert (found.num_steps <= expected.num_steps).all()
    # All of it is awake for the whole of the first detector's stage.
    assert found.num_steps.min() >= SIMULATED.stand_steps


def test_order_and_company_change_no_bit(layout):
    scenes = (*scenes_of(40, seed=5), np.ones(40, bool))
    together = NativePhysics(layout, KNOWN).settle_batch(*scenes)
    engine = NativePhysics(layout, KNOWN, num_threads=2, max_simulations=9)
    for row in np.random.default_rng(0).permutation(40):
        alone = engine.settle_batch(*(each[row : row + 1] for each in scenes))
        for one, other in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
            np.testing.assert_array_equal(one[0], other[row])


def test_levels_are_the_flat_tops_of_boxes_and_meshes():
    def edit(spec):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, pos=(0, 0, 0.75), size=(0.05, 0.05, 0.05)
        )
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=(0.2, 0, 0.72), size=(0.05, 0, 0)
        )

    layout = layout_of([prism("prism", 0.04, 0.03)], edit=edit)
    tops = {round(top.height, 6): top for top in level_tops(layout)}
    assert sorted(tops) == [0.7, 0.8]
    # Above the table are the box and the sphere, above the box nothing.
    assert len(tops[0.7].lower) == 2
    assert len(tops[0.8].lower) == 0
    engine = NativePhysics(layout, KNOWN)
    alone = Alone(engine)
    over = np.array([(0, 0, 0.831), (0.2, 0, 0.731), (-0.2, 0.2, 0.731), (0.085, 0.0, 0.731)])
    poses = np.zeros((4, 1, 7), np.float32)
    poses[:, 0, :3] = over
    poses[:, 0, 3] = 1
    result = engine.settle_batch(poses, np.ones((4, 1), bool), np.zeros(4, int), np.ones(4, bool))
    decided = alone.settle(poses, np.ones((4, 1), bool), np.zeros(4, int), result, np.arange(4))
    # On the box, and on the bare table; not over the sphere, nor right beside the box.
    assert decided.tolist() == [True, False, True, False]
