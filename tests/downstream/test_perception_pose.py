"""Poses: registration finds boxes, comparison tells right from wrong, certainty and the whole finder."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("small_gicp", reason="needs the extra perception")

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.symmetry import turn_matrix
from cluttergen_jax.downstream.perception.certainty import (
    FEATURES,
    Certainty,
    read_certainty,
    reliability,
    write_certainty,
)
from cluttergen_jax.downstream.perception.finder import SceneFinder
from cluttergen_jax.downstream.perception.pose import registration
from cluttergen_jax.downstream.perception.pose.compare import Comparer
from cluttergen_jax.downstream.perception.pose.icp import FreeRegistration
from cluttergen_jax.downstream.perception.pose.models import ObjectModel
from cluttergen_jax.downstream.perception.pose.pose_physics_check import PosePhysicsCheck
from cluttergen_jax.downstream.perception.pose.registration import RegistrationEstimator, seen_points
from cluttergen_jax.downstream.perception.scoring import judge_moment, mask_figures
from cluttergen_jax.downstream.perception.types import BACKGROUND, FIRST_OBJECT, Look, intersection_over_union
from cluttergen_jax.downstream.perception.views.stage import FOCAL, SIZE
from cluttergen_jax.downstream.transforms import matrix_of, offset, pose_of
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.noise import REALSENSE
from tests.helpers.perception import OBJECTS, POSES, TABLE, ByColour, overhead, standing, view_of
from tests.helpers.placing import with_surface
from tests.helpers.worlds import box

SIDE = Camera.looking((0.7, 0.1, 1.2), (0.0, 0.0, TABLE.top), *SIZE, FOCAL)


@pytest.fixture(scope="module")
def estimator():
    return RegistrationEstimator(OBJECTS, TABLE)


def look_at(poses, camera):
    view = view_of(poses, camera).view
    return Look(np.where(np.isfinite(view.depth), view.depth, np.nan), view.label, camera)


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


def test_the_same_looks_tell_the_same_pose(estimator):
    look = look_at(POSES, SIDE)
    assert np.array_equal(estimator(1, [look]).pose, estimator(1, [look]).pose)


def test_two_cameras_are_used_together(estimator):
    looks = [look_at(POSES, camera) for camera in (overhead(), SIDE)]
    points, eyes, pixels = seen_points(2, looks)
    assert pixels == sum(look.mask(2).sum() for look in looks)
    assert len({tuple(eye) for eye in eyes.tolist()}) == 2
    assert len(points) == len(eyes)
    shift, turn = errors(estimator, 2, estimator(2, looks), POSES[2])
    assert shift < 0.004
    assert turn < 3


def test_where_an_object_was_is_looked_at_first(estimator, monkeypatch):
    looks = [look_at(POSES, camera) for camera in (overhead(), SIDE)]
    known = POSES[2] + np.array([0.004, -0.003, 0.002, 0, 0, 0, 0])
    # A pose that is not upright says nothing.
    usual = estimator(2, looks)
    assert np.array_equal(estimator(2, looks, np.array([*POSES[2, :3], 0, 1, 0, 0])).pose, usual.pose)
    monkeypatch.setattr(RegistrationEstimator, "_upright", None)
    across = matrix_of(POSES[2]) @ turn_matrix(np.pi / 2)
    for near in (known, pose_of(across)):
        shift, turn = errors(estimator, 2, estimator(2, looks, near), POSES[2])
        assert shift < 0.004
        assert turn < 3


@pytest.mark.parametrize(("yaw", "turned_by"), [(0.5, 180), (4.0, 180), (3.0, 140), (3.0, 180)])
def test_a_small_handle_tells_that_an_object_has_turned(yaw, turned_by):
    """So little of it differs that both turns agree about as well: by score alone it stays as it was."""
    mug = with_handle()
    true, turned = standing((0.0, 0.0, yaw)), standing((0.004, 0.003, yaw + np.radians(turned_by)))
    true[0, 2] = turned[0, 2] = TABLE.top + mug.half_extents[2]
    view = view_of(true, SIDE, objects=(mug,)).view
    look = Look(np.where(np.isfinite(view.depth), view.depth, np.nan), view.label, SIDE)
    estimator = RegistrationEstimator((mug,), TABLE)
    assert errors(estimator, 0, estimator(0, [look], turned[0]), true[0])[1] < 5


@pytest.mark.parametrize(("yaw", "is_told"), [(0.0, True), (1.6, True), (2.5, False), (4.0, False)])
def test_how_surely_a_turn_is_told_depends_on_whether_its_handle_is_seen(yaw, is_told):
    mug, true = with_handle(), standing((0.0, 0.0, yaw))
    true[0, 2] = TABLE.top + mug.half_extents[2]
    view = view_of(true, SIDE, objects=(mug,)).view
    look = Look(np.where(np.isfinite(view.depth), view.depth, np.nan), view.label, SIDE)
    estimator = RegistrationEstimator((mug,), TABLE)
    found = estimator(0, [look])
    assert found.lead == 1 if is_told else found.lead < 0.1
    assert not is_told or errors(estimator, 0, found, true[0])[1] < 5
    # What is known of its turn counts as much as a handle that is seen.
    assert estimator(0, [look], true[0]).lead > 0.9


def test_where_nothing_speaks_for_the_other_turn_an_object_has_not_turned_round(estimator):
    looks = [look_at(POSES, camera) for camera in (overhead(), SIDE)]
    for known in (matrix_of(POSES[0]), matrix_of(POSES[0]) @ turn_matrix(np.pi)):
        found = estimator(0, looks, pose_of(known))
        assert offset(matrix_of(found.pose), known, 1)[1] < np.radians(5)


def with_handle():
    """A box that a small box on its side turns into one that is not symmetric."""
    cup, knob = box("mug", (0.03, 0.03, 0.05)), box("knob", (0.009, 0.006, 0.009))
    handle = with_surface(knob).pieces[0].mesh
    placed = Piece(Mesh(handle.vertices + np.array([0.038, 0, 0]), handle.faces))
    return replace(cup, pieces=(*with_surface(cup).pieces, placed))


def test_half_of_a_long_object_is_enough():
    """What is seen of it slides along it: only what is hidden, and what is empty, tells where it ends."""
    objects = with_surface(box("bar", (0.02, 0.11, 0.015))), with_surface(box("wall", (0.01, 0.12, 0.11)))
    poses = standing((0.0, 0.0, 0.0), (0.06, 0.12, 0.0))
    poses[:, 2] = [TABLE.top + each.half_extents[2] for each in objects]
    view = view_of(poses, SIDE, objects=objects).view
    look = Look(np.where(np.isfinite(view.depth), view.depth, np.nan), view.label, SIDE)
    found = RegistrationEstimator(objects, TABLE)(0, [look])
    assert 0.3 < found.visible < 0.7
    assert np.linalg.norm(found.pose[:3] - poses[0, :3]) < 0.01


def test_an_object_on_another_is_found_at_its_height(estimator):
    poses = standing((0.0, 0.0, 0.3), (0.2, 0.2, 0.0), (0.2, -0.2, 1.0))
    poses[2] = [0.0, 0.0, TABLE.top + 0.08 + OBJECTS[2].half_extents[2], *poses[2, 3:]]
    shift, _ = errors(estimator, 2, estimator(2, [look_at(poses, SIDE)]), poses[2])
    assert shift < 0.006


@pytest.mark.parametrize(
    ("degrees", "height", "stands"), [(2, -0.003, True), (6, 0.0, False), (2, 0.03, False)]
)
def test_what_all_but_stands_on_the_table_is_said_to_stand(estimator, monkeypatch, degrees, height, stands):
    tilt, angle = np.eye(4), np.radians(degrees)
    tilt[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    leaning = matrix_of(POSES[2]) @ tilt
    leaning[2, 3] += height
    monkeypatch.setattr(registration, "_FREE_GAIN", -1.0)
    monkeypatch.setattr(FreeRegistration, "__call__", lambda *_: leaning)
    found = matrix_of(estimator(2, [look_at(POSES, SIDE)]).pose)
    if stands:
        assert np.allclose(found[2], [0, 0, 1, POSES[2, 2]])
        assert np.allclose(found[:2, 3], leaning[:2, 3])
    else:
        assert np.allclose(found, leaning)


def test_what_is_hardly_seen_has_no_pose(estimator):
    look = look_at(POSES, SIDE)
    label = np.where(np.arange(SIZE[0]) < 0, look.label, 0).astype(np.uint8)
    assert estimator(0, [Look(look.depth, label, look.camera)]) is None
    assert estimator(0, []) is None
    blind = Look(np.full_like(look.depth, np.nan), look.label, look.camera)
    assert estimator(0, [blind]) is None
    with pytest.raises(ConfigError, match="object 7"):
        estimator(7, [look])


def test_a_tall_object_on_another_is_found_by_the_height_of_its_top():
    """Its sides let it slide up and down, and from above hardly show: its top tells where it stands."""
    (bottle,) = (each for each in find_pool("household").objects if each.name == "spray_bottle")
    pose = standing((0.05, -0.05, 0.7))
    pose[0, 2] = TABLE.top + 0.07 + bottle.half_extents[2]
    view = view_of(pose, overhead(), objects=(bottle,)).view
    look = Look(np.where(np.isfinite(view.depth), view.depth, np.nan), view.label, overhead())
    found = RegistrationEstimator((bottle,), TABLE)(0, [look])
    assert np.linalg.norm(found.pose[:3] - pose[0, :3]) < 0.004


def test_a_box_has_two_equal_turns(estimator):
    assert estimator.model(0).symmetry == 2


def test_adds_is_measured_on_surfaces(estimator):
    model = estimator.model(0)
    pose = matrix_of(POSES[0])
    assert model.surface_distance(pose, pose) < 0.001
    assert model.surface_distance(pose, pose @ turn_matrix(np.pi)) < 0.001
    lifted = pose.copy()
    lifted[2, 3] += 0.01
    assert 0.002 < model.surface_distance(pose, lifted) < 0.01


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
    true, empty = look_at(POSES[:1], SIDE), look_at(POSES[1:2] * 0 + standing((0.0, 0.3, 0.0)), SIDE)
    mask = true.mask(0)
    half = mask & (np.cumsum(mask, axis=1) > mask.sum(1, keepdims=True) / 2)
    depth = np.where(half, empty.depth, true.depth)
    label = np.where(half, 0, true.label).astype(np.uint8)
    nothing = np.where(half, np.nan, true.depth)
    pose = matrix_of(POSES[0])
    in_air = Comparer(model, 0, [Look(depth, label, SIDE)])(pose).score
    unknown = Comparer(model, 0, [Look(nothing, label, SIDE)])(pose).score
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


def test_what_overlaps_side_by_side_is_moved_apart_and_nothing_else():
    """Half the depth each, along the table; others, what lies on top, and what overlaps by far stay."""
    blocks = tuple(with_surface(box(name, (0.03, 0.03, 0.03))) for name in ("a", "b", "c"))
    check, height = PosePhysicsCheck(blocks, TABLE), TABLE.top + 0.03
    is_there = np.ones(3, bool)

    def at(*places):
        poses = standing(*[(0.0, 0.0, 0.0)] * 3)
        poses[:, :3] = places
        return poses

    beside = at((0.0, 0.0, height), (0.056, 0.0, height), (0.0, 0.2, height))
    found = check.apart(beside, is_there)
    assert found[0, 0] == pytest.approx(-0.002, abs=5e-4)
    assert found[1, 0] - found[0, 0] == pytest.approx(0.06, abs=1e-3)
    assert found[1, 0] - found[0, 0] > 0.06
    np.testing.assert_array_equal(found[2], beside[2])
    np.testing.assert_allclose(found[:, 1:], beside[:, 1:], atol=1e-6)
    np.testing.assert_array_equal(check.apart(beside, np.array([True, False, True])), beside)
    stacked = at((0.0, 0.0, height), (0.01, 0.0, height + 0.058), (0.0, 0.2, height))
    np.testing.assert_array_equal(check.apart(stacked, is_there), stacked)
    inside = at((0.0, 0.0, height), (0.03, 0.0, height), (0.0, 0.2, height))
    np.testing.assert_array_equal(check.apart(inside, is_there), inside)


def test_certainty_is_fitted_to_what_was_right(tmp_path):
    rng = np.random.default_rng(0)
    features = np.column_stack([np.ones(4000), *(rng.uniform(0, 1, (len(FEATURES) - 1, 4000)))])
    true = np.array([-3.0, 4.0, 2.0, 1.0, 0.0, 0.0, 1.0])
    right = rng.uniform(size=4000) < 1 / (1 + np.exp(-features @ true))
    fitted = Certainty().fit_to(features, right)
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


@pytest.mark.parametrize(
    ("where", "one", "other"),
    [(1, 1, 0), (0, 1, 2), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((1, 1, 2), (1, 2, 1)))],
)
def test_a_look_that_takes_one_object_for_another_does_not_mislead(where, one, other):
    looks = [look_at(POSES, camera) for camera in (overhead(), SIDE)]
    label = looks[where].label.copy()
    label[looks[where].mask(one)] = BACKGROUND
    label[looks[where].mask(other)] = FIRST_OBJECT + one
    looks[where] = replace(looks[where], label=label)
    found = SceneFinder(OBJECTS, TABLE, ByColour())(looks)
    assert found.seen.all()
    assert np.linalg.norm(found.pose[:, :3] - POSES[:, :3], axis=1).max() < 0.005


@pytest.mark.parametrize(
    "wrong", [FIRST_OBJECT, FIRST_OBJECT + 1, pytest.param(BACKGROUND, marks=pytest.mark.slow)]
)
def test_what_the_segmenter_took_for_another_is_found_in_what_nothing_explains(estimator, wrong):
    """Blue lies on green, and the segmenter takes it for red, for green too, or for the table."""
    poses = POSES.copy()
    poses[2] = [POSES[1, 0] + 0.03, POSES[1, 1], TABLE.top + 2 * 0.07 + 0.02, *POSES[2, 3:]]
    looks = [look_at(poses, camera) for camera in (overhead(), SIDE)]
    looks = [
        replace(each, label=np.where(each.mask(2), wrong, each.label).astype(np.uint8)) for each in looks
    ]
    found = SceneFinder(OBJECTS, TABLE, ByColour(), estimator)(looks)
    assert found.seen.all()
    np.testing.assert_allclose(found.pose[:, :3], poses[:, :3], atol=0.006)
    # Where it was found the pixels are its own again, whatever the segmenter said.
    right = [look_at(poses, camera).label for camera in (overhead(), SIDE)]
    before, after = (
        np.array([intersection_over_union(one, true, 3) for one, true in zip(labels, right, strict=True)])
        for labels in ([look.label for look in looks], found.labels)
    )
    assert before[:, FIRST_OBJECT + 2].max() == 0
    assert after[:, FIRST_OBJECT:].min() > 0.8


def test_a_thing_that_fits_no_object_is_taken_for_none(estimator):
    objects = (*OBJECTS[:2], with_surface(box("stranger", (0.09, 0.09, 0.09))))
    view = view_of(
        standing((-0.1, 0.05, 0.4), (0.08, -0.1, 1.2), (0.0, 0.2, 0.3)), SIDE, objects=objects
    ).view
    label = np.where(view.label == FIRST_OBJECT + 2, BACKGROUND, view.label).astype(np.uint8)
    depth = np.where(np.isfinite(view.depth), view.depth, np.nan)
    found = SceneFinder(OBJECTS, TABLE, ByColour(), estimator)([Look(depth, label, SIDE)])
    assert found.seen.tolist() == [True, True, False]


def test_what_is_not_in_the_pictures_is_not_seen(finder):
    view = view_of(POSES[:2], overhead()).view
    found = finder([finder.look(view.rgb, view.depth, overhead())])
    assert found.seen.tolist() == [True, True, False]
    assert found.certainty[2] == 0
    assert np.isfinite(found.pose).all()


def test_bad_input_is_refused(finder, estimator):
    view = view_of(POSES, overhead()).view
    with pytest.raises(ConfigError, match="nothing was measured"):
        finder.look(view.rgb, np.full_like(view.depth, np.nan), overhead())
    with pytest.raises(ConfigError, match="picture of type"):
        finder.look(view.rgb[::2], view.depth, overhead())
    with pytest.raises(ConfigError, match="objects mug"):
        finder([], ["mug"])
    with pytest.raises(ConfigError, match="a segmenter of"):
        SceneFinder(OBJECTS[::-1], TABLE, ByColour(), estimator)


def test_a_moment_is_judged_against_the_truth(finder, estimator):
    models = [estimator.model(k) for k in range(3)]
    row = judge_moment([view_of(POSES, overhead())], finder, models, REALSENSE.scaled(0.0), 0, False)
    assert mask_figures(row.confused, 3)[1:] == mask_figures(row.corrected, 3)[1:] == (3, 3, 3, 0)
    assert row.is_right == [True, True, True]
    assert max(row.adds) < 0.003
    assert min(row.share) > 0.9
    wrong = POSES.copy()
    wrong[:, 0] += 0.02
    told = view_of(POSES, overhead())
    row = judge_moment(
        [type(told)(0, told.view, told.objects, wrong, "", False)],
        finder,
        models,
        REALSENSE.scaled(0.0),
        0,
        True,
    )
    assert not any(row.is_right)
    assert min(row.shift) > 0.015


def test_noise_costs_millimetres_not_objects(finder, estimator):
    models = [estimator.model(k) for k in range(3)]
    views = [view_of(POSES, overhead(), 0), view_of(POSES, SIDE, 1)]
    row = judge_moment(views, finder, models, REALSENSE, 0, True)
    assert row.objects == list(ByColour.names)
    assert max(row.adds) < 0.006
    again = judge_moment(views, finder, models, REALSENSE, 0, True)
    assert (row.adds, row.certainty) == (again.adds, again.certainty)
