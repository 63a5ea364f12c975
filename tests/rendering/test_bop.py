"""A BOP dataset, read as bop_toolkit's documentation says (it is on no package index)."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.ndimage import maximum_filter
from scipy.spatial import ConvexHull, cKDTree

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.sensing.camera import Camera, free
from cluttergen_jax.views.bop import SPLIT, BopDataset, add_models, model_ply
from cluttergen_jax.views.maker import SeenScene, ViewMaker
from tests.helpers.drawing import RED, needs_gl
from tests.helpers.worlds import box

TABLE = cuboid_table()
SIZE = (160, 120)
PICTURE = PictureConfig(width=160, height=120, samples=1)


def load(path):
    """As bop_toolkit does: keys are whole numbers, poses matrices."""
    record = json.loads(path.read_bytes())
    return {int(key): value for key, value in record.items()}


def pixels(path):
    return np.asarray(Image.open(path))


@pytest.fixture(scope="module")
def scene():
    """A plate, a mug and two forks."""
    dining = find_pool("dining")
    objects = [dining[name] for name in ("dinner_plate", "mug", "fork", "fork")]
    half = [each.half_extents[2] for each in objects]
    turn = [0.8, 0.0, 0.0, 0.6]
    xy = [(0.0, 0.15), (0.1, -0.1), (-0.1, -0.1), (-0.15, 0.0)]
    return objects, np.array([[*at, 0.7 + z, *turn] for at, z in zip(xy, half, strict=True)])


def add(dataset, number, objects, poses, cameras, is_drawn=True):
    """What some cameras see of objects on the table, as a scene of a dataset; its folder."""
    names = [str(place) for place in range(len(objects))]
    scene = SeenScene(number, names, objects, poses, TABLE, TABLE.region)
    with ViewMaker(PICTURE, is_drawn=is_drawn) as maker:
        maker.place(objects, poses, TABLE)
        views = [maker.see(camera, has_instances=True) for camera in cameras]
    return dataset.add(number, scene, views)


@pytest.fixture(scope="module")
def dataset(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bop")
    rng = np.random.default_rng(1)
    cameras = [free(TABLE, rng, *SIZE) for _ in range(2)]
    add(BopDataset(folder), 3, *scene, cameras)
    return folder, cameras


@needs_gl
def test_files_and_their_entries_are_those_of_the_format(dataset, scene):
    folder, _ = dataset
    images = folder / SPLIT / "000003"
    assert {each.name for each in images.iterdir()} == {
        "rgb", "depth", "mask", "mask_visib", "scene_camera.json", "scene_gt.json", "scene_gt_info.json"
    }  # fmt: skip
    names = [f"{view:06d}.png" for view in range(2)]
    masks = [f"{view:06d}_{index:06d}.png" for view in range(2) for index in range(4)]
    for kind, expected in (
        ("rgb", names),
        ("depth", names),
        ("mask", masks),
        ("mask_visib", masks),
    ):
        assert sorted(each.name for each in (images / kind).iterdir()) == expected
    cameras, poses, infos = (
        load(images / f"scene_{name}.json") for name in ("camera", "gt", "gt_info")
    )
    assert list(cameras) == list(poses) == list(infos) == [0, 1]
    for view in range(2):
        sizes = {name: len(cameras[view][name]) for name in ("cam_K", "cam_R_w2c", "cam_t_w2c")}
        assert sizes == {"cam_K": 9, "cam_R_w2c": 9, "cam_t_w2c": 3}
        assert len(poses[view]) == len(infos[view]) == 4
        for pose in poses[view]:
            assert {name: np.size(value) for name, value in pose.items()} == {
                "obj_id": 1, "cam_R_m2c": 9, "cam_t_m2c": 3
            }  # fmt: skip
    assert pixels(images / "rgb" / "000000.png").shape == (120, 160, 3)
    assert pixels(images / "depth" / "000000.png").dtype == np.uint16
    sensor = json.loads((folder / "camera.json").read_bytes())
    assert {"cx", "cy", "depth_scale", "fx", "fy", "height", "width"} == set(sensor)
    info = load(folder / "models" / "models_info.json")
    assert {each["name"] for each in info.values()} == {"dinner_plate", "fork", "mug"}
    assert sorted(info) == [1, 2, 3]
    ids = [pose["obj_id"] for pose in poses[0]]
    assert [info[number]["name"] for number in ids] == [each.name for each in scene[0]]
    assert all(each["licence"] for each in info.values())


@needs_gl
def test_projected_models_cover_their_masks_and_lie_where_depth_says(dataset):
    folder, _ = dataset
    images = folder / SPLIT / "000003"
    cameras, poses, infos = (
        load(images / f"scene_{name}.json") for name in ("camera", "gt", "gt_info")
    )
    for view in range(2):
        K = np.reshape(cameras[view]["cam_K"], (3, 3))
        depth = pixels(images / "depth" / f"{view:06d}.png") * cameras[view]["depth_scale"]
        claimed = np.zeros(depth.shape, int)
        for index, (pose, info) in enumerate(zip(poses[view], infos[view], strict=True)):
            model = trimesh.load(folder / "models" / f"obj_{pose['obj_id']:06d}.ply", process=False)
            points = trimesh.sample.sample_surface(model, 30_000, seed=0)[0]
            seen = points @ np.reshape(pose["cam_R_m2c"], (3, 3)).T + pose["cam_t_m2c"]
            at = (seen @ K.T / seen[:, 2:])[:, :2]
            # A pixel's middle is at whole numbers.
            column, row = np.round(at).astype(int).T
            inside = (column >= 0) & (column < 160) & (row >= 0) & (row < 120)
            mask = pixels(images / "mask" / f"{view:06d}_{index:06d}.png") > 0
            visible = pixels(images / "mask_visib" / f"{view:06d}_{index:06d}.png") > 0
            assert mask[visible].all()
            # Some round across the silhouette's edge.
            assert maximum_filter(mask, 3)[row[inside], column[inside]].all()
            filled = np.zeros_like(mask)
            filled[row[inside], column[inside]] = True
            assert maximum_filter(filled, 3)[mask].all()
            if mask.sum() > 300:
                assert mask[row[inside], column[inside]].mean() > 0.85
            # What depth shows lies on the model.
            rows, columns = np.nonzero(visible)
            sight = np.column_stack([columns, rows, np.ones(len(rows))]) @ np.linalg.inv(K).T
            shown = sight * depth[visible][:, None] - pose["cam_t_m2c"]
            shown = shown @ np.reshape(pose["cam_R_m2c"], (3, 3))
            assert len(shown) > 20
            assert cKDTree(points).query(shown)[0].max() < 4
            claimed += visible
            assert info["px_count_visib"] == visible.sum()
            assert info["px_count_valid"] == mask.sum()
            assert info["px_count_all"] >= mask.sum()
            assert info["visib_fract"] == pytest.approx(visible.sum() / info["px_count_all"])
            low = np.array(info["bbox_visib"][:2])
            size = np.array(info["bbox_visib"][2:])
            assert [columns.min(), rows.min()] == low.tolist()
            assert [columns.max(), rows.max()] == (low + size).tolist()
        assert claimed.max() == 1


# Where (0, 0) is in the first pixel, told apart by a rasteriser that shares nothing with the rays.


def rasterised(corners, K, to_middle):
    """bool[120, 160]: pixels whose middle lies in the outline of convex corners f[V, 3], camera frame."""
    at = (corners @ K.T / corners[:, 2:])[:, :2]
    edges = ConvexHull(at).equations
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    middles = np.stack([columns, rows], -1) + to_middle
    return (middles @ edges[:, :2].T + edges[:, 2] <= 0).all(-1)


def overlap(one, other):
    """Intersection over union."""
    return (one & other).sum() / (one | other).sum()


@pytest.mark.parametrize(
    ("pixel_origin", "to_middle", "wrong"), [("center", 0.0, 0.5), ("corner", 0.5, 0.0)]
)
def test_masks_are_where_a_rasteriser_of_that_origin_has_them(
    tmp_path, pixel_origin, to_middle, wrong
):
    rng = np.random.default_rng(4)
    poses = np.array([[0.0, 0, 0.75, 0.8, 0, 0, 0.6]])
    cameras = [free(TABLE, rng, *SIZE) for _ in range(4)]
    dataset = BopDataset(tmp_path, pixel_origin=pixel_origin)
    images = add(dataset, 0, [RED], poses, cameras, is_drawn=False)
    seen, gts = (load(images / f"scene_{name}.json") for name in ("camera", "gt"))
    model = trimesh.load(tmp_path / "models" / "obj_000001.ply", process=False)
    for view, camera in enumerate(cameras):
        K = np.reshape(seen[view]["cam_K"], (3, 3))
        pose = gts[view][0]
        corners = model.vertices @ np.reshape(pose["cam_R_m2c"], (3, 3)).T + pose["cam_t_m2c"]
        mask = pixels(images / "mask" / f"{view:06d}_000000.png") > 0
        assert 300 < mask.sum() < 3000
        assert overlap(mask, rasterised(corners, K, to_middle)) > 0.995
        assert overlap(mask, rasterised(corners, K, wrong)) < 0.98
        # The package's own camera reads it once its origin is the first pixel's corner.
        shift = (0.5 - to_middle) * np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        ours = Camera(*SIZE, K + shift, camera.T_world_camera)
        np.testing.assert_allclose(ours.K, camera.K, atol=1e-9)
    sensor = json.loads((tmp_path / "camera.json").read_bytes())
    assert (sensor["cx"], sensor["cy"]) == (80 - 0.5 + to_middle, 60 - 0.5 + to_middle)
    told = (tmp_path / "dataset_info.md").read_text()
    assert ("add 0.5" in told, "subtract 0.5" in told) == (to_middle == 0.0, to_middle == 0.5)


def motions_of(info, num_steps=12):
    """As bop_toolkit combines them: each discrete motion, then each turn about an axis; f64[4, 4] each."""
    discrete = [
        np.eye(4),
        *(np.reshape(each, (4, 4)) for each in info.get("symmetries_discrete", [])),
    ]
    turns = [
        trimesh.transformations.rotation_matrix(angle, each["axis"], each["offset"])
        for each in info.get("symmetries_continuous", [])
        for angle in 2 * np.pi * np.arange(num_steps) / num_steps
    ]
    return [turn @ motion for motion in discrete for turn in turns or [np.eye(4)]]


def test_symmetries_are_told_as_the_format_has_them(tmp_path):
    dining = find_pool("dining")
    add_models(tmp_path, [RED, dining["bowl"], dining["mug"], dining["soup_can"]])
    infos = {
        each["name"]: (key, each)
        for key, each in load(tmp_path / "models" / "models_info.json").items()
    }
    assert not {"symmetries_discrete", "symmetries_continuous"} & set(infos["mug"][1])
    (axis,) = infos["bowl"][1]["symmetries_continuous"]
    np.testing.assert_allclose(axis["axis"], [0, 0, 1], atol=1e-6)
    assert np.shape(infos["red"][1]["symmetries_discrete"]) == (23, 16)
    for name, count in (("red", 24), ("bowl", 12), ("soup_can", 12), ("mug", 1)):
        number, info = infos[name]
        model = trimesh.load(tmp_path / "models" / f"obj_{number:06d}.ply", process=False)
        points = trimesh.sample.sample_surface(model, 20_000, seed=0)[0]
        tree = cKDTree(points)
        motions = motions_of(info)
        assert len(motions) == count
        for motion in motions:
            # Points of the same surface lie 3 mm apart or so.
            assert tree.query(trimesh.transform_points(points[:500], motion))[0].max() < 6


def test_another_model_of_a_name_is_refused_and_leaves_nothing_behind(tmp_path):
    add_models(tmp_path, [RED])
    before = sorted(tmp_path.rglob("*"))
    larger = replace(RED, pieces=(Piece(box("red", (0.1, 0.1, 0.1)).parts[0].hull()),))
    # By name, what is new comes first.
    with pytest.raises(ConfigError, match="another model of the name 'red'"):
        add_models(tmp_path, [find_pool("dining")["mug"], larger])
    assert sorted(tmp_path.rglob("*")) == before


def test_models_are_in_millimetres_with_normals_and_colours():
    mug = find_pool("dining")["mug"]
    model = trimesh.load(
        trimesh.util.wrap_as_stream(model_ply(mug)), file_type="ply", process=False
    )
    vertices = np.concatenate([piece.mesh.vertices for piece in mug.pieces]) * 1000
    np.testing.assert_allclose(model.bounds, [vertices.min(0), vertices.max(0)], atol=1e-3)
    area = sum(trimesh.Trimesh(piece.mesh.vertices, piece.mesh.faces).area for piece in mug.pieces)
    assert model.area == pytest.approx(area * 1e6, rel=1e-3)
    np.testing.assert_allclose(np.linalg.norm(model.vertex_normals, axis=1), 1.0, atol=1e-4)
    colours = {tuple(row[:3]) for row in model.visual.vertex_colors}
    assert {
        tuple(np.round(255 * np.array(piece.rgba[:3])).astype(int)) for piece in mug.pieces
    } == colours
