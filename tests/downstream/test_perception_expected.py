"""Masks by expectation: wrong labels of what depth confirms are put right, and nothing else is touched."""

import numpy as np
import pytest

from cluttergen_jax.downstream.perception.corrections import correct_masks, find_unexplained
from cluttergen_jax.downstream.perception.object_model import ObjectModel, render_alone
from cluttergen_jax.downstream.perception.types import ARM, BACKGROUND, FIRST_OBJECT
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.sensing import View
from tests.helpers.perception import OBJECTS, POSES, TABLE, overhead, view_of

RED, GREEN, BLUE = (FIRST_OBJECT + k for k in range(3))
MODELS = [ObjectModel.of(each) for each in OBJECTS]


@pytest.fixture
def look():
    view = view_of(POSES, overhead()).view
    return View(np.where(np.isfinite(view.depth), view.depth, np.nan), view.label, view.camera)


def expected(poses=POSES):
    return {k: (MODELS[k], matrix_of(pose)) for k, pose in enumerate(poses)}


def mistaken(look, **labels):
    """The look with other labels in place of the true ones."""
    label = look.label.copy()
    for name, wrong in labels.items():
        label[look.label == {"red": RED, "green": GREEN, "blue": BLUE}[name]] = wrong
    return View(look.depth, label, look.camera)


def test_an_object_alone_is_drawn_where_the_camera_sees_it(look):
    for k, pose in enumerate(POSES):
        drawn = render_alone(MODELS[k], look.camera, matrix_of(pose))
        is_drawn = np.isfinite(drawn)
        assert (is_drawn == look.mask(k)).mean() > 0.9995
        both = is_drawn & look.mask(k)
        assert np.abs(drawn - look.depth)[both].max() < 1e-3
    away = matrix_of(POSES[0])
    away[:2, 3] += 3
    assert np.isinf(render_alone(MODELS[0], look.camera, away)).all()
    behind = matrix_of(POSES[0])
    behind[2, 3] += 5
    assert np.isinf(render_alone(MODELS[0], look.camera, behind)).all()


def test_what_is_where_it_is_expected_gets_its_mask_whatever_was_said(look):
    wrong = mistaken(look, red=GREEN, green=BACKGROUND, blue=RED)
    (found,) = correct_masks([wrong], expected())
    assert (found.label == look.label).mean() > 0.999
    assert np.array_equal(found.depth, look.depth, equal_nan=True)


def test_what_is_not_where_it_is_expected_keeps_what_was_said(look):
    moved = POSES.copy()
    moved[:, :2] += 0.12
    (found,) = correct_masks([look], expected(moved))
    assert np.array_equal(found.label, look.label)
    (found,) = correct_masks([look], {})
    assert np.array_equal(found.label, look.label)


def test_what_no_object_explains_is_told_apart_thing_by_thing(look):
    assert find_unexplained([look], expected(), TABLE.top, 40) == []
    assert find_unexplained([], {}, TABLE.top, 40) == []
    green, red, blue = (look.mask(k) for k in (1, 0, 2))
    found = {2: expected()[2]}
    things = find_unexplained([look, look], found, TABLE.top, 40)
    assert len(things) == 2
    for masks, own in zip(things, sorted((green, red), key=lambda mask: -mask.sum()), strict=True):
        assert len(masks) == 2
        for mask in masks:
            assert (mask & own).sum() > 0.9 * own.sum()
            assert not (mask & blue).any()
            assert mask.sum() < 1.1 * own.sum()
    assert find_unexplained([look], found, TABLE.top, 10 * int(green.sum())) == []
    assert len(find_unexplained([mistaken(look, red=ARM)], found, TABLE.top, 40)) == 1
