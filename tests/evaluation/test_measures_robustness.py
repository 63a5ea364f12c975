"""Creep, shake, changed physics and the certificate, against hand arithmetic."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.judging.certify import certificates
from cluttergen_jax.judging.scene_models import (
    RobustConfig,
    SceneModels,
    ShakeConfig,
    movement,
    robust,
    shake,
)
from cluttergen_jax.placement.world import make_world
from studies.measures.changed_physics import PHYSICS_CHANGES, survives
from tests.helpers.worlds import TOP, box

GRAVITY = 9.81
FRICTION = ContactConfig().friction[0]
CUBE, TALL, WALL, PLANK = range(4)
OBJECTS = [
    box("cube", (0.03, 0.03, 0.03)),
    box("tall", (0.02, 0.04, 0.1)),
    box("wall", (0.06, 0.06, 0.07), mass=3.0),
    box("plank", (0.003, 0.03, 0.06), mass=0.1),
]
PLANK_ANGLE = np.radians(50)


@pytest.fixture(scope="module")
def models():
    return SceneModels(make_world(OBJECTS, cuboid_table(), StabilityConfig(), ContactConfig()))


def scenes(*placed):
    """Scenes from dicts of object to position above the top, or to a whole pose."""
    poses = np.tile(np.eye(7)[3], (len(placed), len(OBJECTS), 1))
    is_placed = np.zeros(poses.shape[:2], bool)
    for n, scene in enumerate(placed):
        for k, pose in scene.items():
            poses[n, k, : len(pose)] = pose
            poses[n, k, 2] += TOP
            is_placed[n, k] = True
    return poses, is_placed


def ladder(angle):
    """The plank at an angle to the table, leaning with its upper edge against the wall."""
    half = np.array([0.003, 0.06])
    turn = Rotation.from_euler("y", np.pi / 2 - angle)
    reach = turn.apply([half[0], 0, half[1]])[0] + 1e-4
    low = -turn.apply([half[0], 0, -half[1]])[2] + 1e-4
    return {WALL: (0.06, 0, 0.07), PLANK: (-reach, 0, low, *turn.as_quat()[[3, 0, 1, 2]])}


STANDING = ({CUBE: (0, 0, 0.03)}, {TALL: (0, 0, 0.1)}, {CUBE: (0, 0, 0.03), TALL: (0.2, 0.1, 0.1)})


def test_what_stands_does_not_creep_and_what_hangs_in_the_air_falls(models):
    poses, is_placed = scenes(*STANDING, {CUBE: (0, 0, 0.04)})
    result = movement(models, poses, is_placed, (0.5, 1.0, 3.0), num_threads=1)
    assert result.shift.shape == (4, 3, 4)
    assert (result.largest_shift[:3] < 1e-4).all()
    # It falls 10 mm, and sinks in for a step when it lands.
    assert (result.largest_shift[3] >= 0.00999).all()
    assert (result.largest_shift[3] < 0.012).all()
    assert (np.diff(result.shift, axis=1) >= 0).all()
    assert (result.shift[~is_placed[:, None].repeat(3, 1)] == 0).all()
    assert result.survives()[:, -1].tolist() == [True, True, True, False]


def test_threads_and_neighbours_in_the_batch_change_nothing(models):
    poses, is_placed = scenes(*STANDING, {CUBE: (0.29, 0, 0.05)})
    alone = [
        movement(models, poses[n : n + 1], is_placed[n : n + 1], (0.5,), 1).shift[0]
        for n in range(4)
    ]
    np.testing.assert_array_equal(movement(models, poses, is_placed, (0.5,), 3).shift, alone)
    np.testing.assert_array_equal(
        shake(models, poses[::-1], is_placed[::-1], num_threads=2)[::-1],
        shake(models, poses, is_placed, num_threads=1),
    )


def overshoot(config):
    """m/s^2 by which the acceleration grows while what slides freely covers the first 5 mm."""
    return (6 * config.max_shift * config.rate**2) ** (1 / 3)


def test_a_cube_slides_at_its_friction_and_a_tall_box_tips_over_its_edge(models):
    config = ShakeConfig()
    score = shake(models, *scenes(*STANDING), config, num_threads=1)
    slides = FRICTION * GRAVITY
    assert (score[0] > 0.97 * slides).all()
    assert (score[0] < slides + overshoot(config) + 0.05).all()
    tips = GRAVITY * np.array([0.02, 0.04]) / 0.1
    assert (score[1] > 0.97 * tips).all()
    assert (score[1] < tips + 0.45).all()
    # A scene gives way with its first object.
    np.testing.assert_allclose(score[2], np.minimum(score[0], score[1]), atol=0.02)


def test_a_ladder_stands_as_friction_lets_it(models):
    # Friction mu at both ends holds it from the angle whose tangent is (1 - mu^2) / (2 mu) upwards.
    for mu in (FRICTION, FRICTION / 2):
        critical = np.arctan((1 - mu**2) / (2 * mu))
        assert (critical < PLANK_ANGLE) == (mu == FRICTION)
    poses, is_placed = scenes(ladder(PLANK_ANGLE), STANDING[0])
    result = survives(models, poses, is_placed, PHYSICS_CHANGES, seconds=1.5, num_threads=1)
    assert {name: stands.tolist() for name, stands in result.items()} == {
        change.name: [change.friction >= 1, True] for change in PHYSICS_CHANGES
    }


def test_certificate_of_a_stack(models):
    poses, is_placed = scenes(
        {WALL: (0, 0, 0.07), CUBE: (0.01, 0, 0.17), TALL: (0.2, 0, 0.1)}, STANDING[0]
    )
    # As deep as things at rest sink in, so that they touch.
    poses[..., 2] -= 5e-6
    stack, cube = certificates(models, poses, is_placed, seconds=1.0, num_threads=1)
    assert stack["rests_on"] == [(CUBE, WALL), (TALL, -1), (WALL, -1)]
    assert cube["rests_on"] == [(CUBE, -1)]
    assert stack["shake"] == min(stack["shake_x"], stack["shake_y"]) < cube["shake"]
    assert stack["drift"] < 1e-4 > stack["penetration"]
    assert stack["residual_speed"] < 1e-4
    # Nothing stands on less than two points, not even where hulls and boxes make few of them.
    assert stack["num_contacts"] > cube["num_contacts"] >= 2
    assert stack["drift_seconds"] == 1.0
    assert json.loads(json.dumps(stack))["shake"] == stack["shake"]


def test_certificate_sees_what_is_amiss(models):
    falling, sunk = certificates(
        models, *scenes({CUBE: (0, 0, 0.53)}, {CUBE: (0, 0, 0.029)}), seconds=0.25, num_threads=1
    )
    assert falling["residual_speed"] == pytest.approx(GRAVITY * 0.25, rel=0.02)
    assert falling["drift"] == pytest.approx(GRAVITY * 0.25**2 / 2, rel=0.03)
    assert falling["rests_on"] == []
    assert falling["num_contacts"] == 0
    assert sunk["penetration"] == pytest.approx(0.001, abs=1e-5)


def test_what_stands_every_way_is_robust_and_what_sinks_a_little_is_too(models):
    # The tall box tips over the table's edge under a tilt of 3 degrees if less than 5.2 mm of it hold it.
    brink = [{TALL: (0.3 - margin, 0, 0.1)} for margin in (0.004, 0.015)]
    pile = {CUBE: (0, 0, 0.03), TALL: (0, 0, 0.16)}
    poses, is_placed = scenes(*STANDING, pile, *brink)
    found = robust(models, poses, is_placed, num_threads=1)
    assert found.tolist() == [True, True, True, True, False, True]
    # Where friction is too little it slides.
    icy = RobustConfig(friction=0.05)
    assert not robust(models, poses[:1], is_placed[:1], icy, num_threads=2).any()
