"""Poses: registration finds boxes, comparison tells right from wrong, certainty and the whole finder."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("small_gicp", reason="needs the extra perception")


from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.downstream.perception.corrections import PosePhysicsCheck
from cluttergen_jax.downstream.perception.finder import (
    FEATURES,
    Certainty,
    SceneFinder,
    read_certainty,
)
from cluttergen_jax.downstream.perception.object_model import Comparer, ObjectModel
from cluttergen_jax.downstream.perception.registration import RegistrationEstimator
from cluttergen_jax.downstream.robot.cameras import FOCAL, SIZE
from cluttergen_jax.downstream.transforms import matrix_of, offset, turn_matrix
from cluttergen_jax.errors import PoolError
from cluttergen_jax.sensing import View
from cluttergen_jax.sensing.camera import Camera
from studies.perception.evaluate import fit_certainty, reliability, write_certainty
from tests.helpers.perception import OBJECTS, POSES, TABLE, ByColour, overhead, standing, view_of
from tests.helpers.placing import with_surface
from tests.helpers.worlds import box

SIDE = Camera.looking((0.7, 0.1, 1.2), (0.0, 0.0, TABLE.top), *SIZE, FOCAL)


@pytest.fixture(scope="module")
def estimator():
    return RegistrationEstimator(OBJECTS, TABLE)


def look_at(poses, camera):
    view = view_of(poses, camera).view
    return View(np.where(np.isfinite(view.depth), view.depth, np.nan), view.label, camera)


def errors(estimator, index, estimate, true):
    shift, turn = offset(matrix_of(estimate.pose), matrix_of(true), estimator.model(index).symmetry)
    return shift, np.degrees(turn)


# Poses


def test_one_object_in_one_view_is_found(estimator):
    """The miniature: pixels, points, registration, comparison."""
    pose = standing((-0.1, 0.05, 0.4))
    found = estimator(0, [look_at(pose, SIDE)])
    shift, turn = errors(estimator, 0, found, pose[0])
    assert shift < 0.004
    assert turn < 3
    assert found.score > 0.8
    assert found.visible > 0.9


@pytest.mark.parametrize(("yaw", "turned_by"), [(0.5, 180), (4.0, 180), (3.0, 140), (3.0, 180)])
def test_a_small_handle_tells_that_an_object_has_turned(yaw, turned_by):
    """So little of it differs that both turns agree about as well: by score alone it stays as it was."""
    mug = with_handle()
    true = standing((0.0, 0.0, yaw))
    turned = standing((0.004, 0.003, yaw + np.radians(turned_by)))
    true[0, 2] = turned[0, 2] = TABLE.top + mug.half_extents[2]
    view = view_of(true, SIDE, objects=(mug,)).view
    look = View(np.where(np.isfinite(view.depth), view.depth, np.nan), view.label, SIDE)
    estimator = RegistrationEstimator((mug,), TABLE)
    assert errors(estimator, 0, estimator(0, [look], turned[0]), true[0])[1] < 5


def with_handle():
    """A box that a small box on its side turns into one that is not symmetric."""
    cup = box("mug", (0.03, 0.03, 0.05))
    knob = box("knob", (0.009, 0.006, 0.009))
    handle = with_surface(knob).pieces[0].mesh
    placed = Piece(Mesh(handle.vertices + np.array([0.038, 0, 0]), handle.faces))
    return replace(cup, pieces=(*with_surface(cup).pieces, placed))


# Comparison


@pytest.mark.parametrize(
    "change",
    [(0.02, 0, 0, 0), (0, -0.02, 0, 0), (0, 0, 0.03, 0), (0, 0, 0, 0.6)],
    ids=["x", "y", "z", "turn"],
)
def test_the_true_pose_agrees_better_than_others(estimator, change):
    compare = Comparer(estimator.model(0), 0, [look_at(POSES, SIDE)])
    true = matrix_of(POSES[0])
    wrong = true @ turn_matrix(change[3])
    wrong[:3, 3] += change[:3]
    assert compare(true).score > 0.9
    assert compare(wrong).score < compare(true).score - 0.15


def test_filling_air_that_was_seen_to_be_empty_speaks_against_a_pose():
    """Half of the box's pixels are taken away from its mask: where they are, the table is seen behind it."""
    model = ObjectModel.of(OBJECTS[0])
    true = look_at(POSES[:1], SIDE)
    empty = look_at(POSES[1:2] * 0 + standing((0.0, 0.3, 0.0)), SIDE)
    mask = true.mask(0)
    half = mask & (np.cumsum(mask, axis=1) > mask.sum(1, keepdims=True) / 2)
    depth = np.where(half, empty.depth, true.depth)
    label = np.where(half, 0, true.label).astype(np.uint8)
    nothing = np.where(half, np.nan, true.depth)
    pose = matrix_of(POSES[0])
    in_air = Comparer(model, 0, [View(depth, label, SIDE)])(pose).score
    unknown = Comparer(model, 0, [View(nothing, label, SIDE)])(pose).score
    assert unknown > 0.9
    assert in_air < 0.65


# Physics, certainty


def test_what_floats_or_overlaps_is_not_steady():
    check = PosePhysicsCheck(OBJECTS, TABLE)
    assert check(POSES, np.ones(3, bool)).tolist() == [True, True, True]
    poses = POSES.copy()
    poses[0, 2] += 0.05
    assert check(poses, np.ones(3, bool)).tolist() == [False, True, True]
    poses = POSES.copy()
    poses[1, :2] = poses[0, :2]
    assert not check(poses, np.ones(3, bool))[:2].all()
    assert check(POSES, np.array([True, False, True])).tolist() == [True, False, True]


def test_certainty_is_fitted_to_what_was_right(tmp_path):
    rng = np.random.default_rng(0)
    features = np.column_stack([np.ones(4000), *(rng.uniform(0, 1, (len(FEATURES) - 1, 4000)))])
    true = np.array([-3.0, 4.0, 2.0, 1.0, 0.0, 0.0, 1.0])
    right = rng.uniform(size=4000) < 1 / (1 + np.exp(-features @ true))
    fitted = fit_certainty(features, right)
    np.testing.assert_allclose(fitted.weights, true, atol=0.5)
    for mean, share, count in reliability(fitted(features), right):
        assert count < 200 or abs(mean - share) < 0.06
    assert read_certainty(tmp_path) == Certainty()
    write_certainty(tmp_path, fitted)
    assert read_certainty(tmp_path) == fitted
    assert len(fitted.weights) == len(FEATURES)
    (tmp_path / "certainty.json").write_text('{"weights": {}}')
    with pytest.raises(PoolError, match="damaged"):
        read_certainty(tmp_path)


# The whole


@pytest.fixture(scope="module")
def finder(estimator):
    return SceneFinder(OBJECTS, TABLE, ByColour(), estimator)


def test_all_objects_of_a_scene_are_found_in_pictures(finder):
    looks = [finder.look(*_picture(camera)) for camera in (overhead(), SIDE)]
    found = finder(looks)
    assert found.names == ByColour.names
    assert found.seen.all()
    assert (found.certainty > 0.5).all()
    np.testing.assert_allclose(found.pose[:, :3], POSES[:, :3], atol=0.005)
    one = finder(looks, ["blue"])
    assert one.names == ("blue",)
    np.testing.assert_array_equal(one.pose[0], found.pose[2])


def _picture(camera):
    view = view_of(POSES, camera).view
    return view.rgb, view.depth, camera
