"""Places in depth images of a user's own: frames, units and what is refused, by numbers of NumPy alone."""

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.downstream.noise import REALSENSE, noisy
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes, ProposalJudge
from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.generation import body_of
from cluttergen_jax.sensing import RaySensor, free, sensed_model
from cluttergen_jax.types import Verdict

WIDTH, HEIGHT, FOCAL = 200, 150, 190.0
K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
LEVEL = 0.42
MIDDLE = np.array([0.6, -0.3])
YAW = np.radians(30)
# A tall box on one end of the region, world axes turned as the region: its middle and half its sides.
BLOCK = np.array([0.09, 0.0, 0.06])
BLOCK_HALF = np.array([0.07, 0.12, 0.06])
REGION = cg.Rectangle((0.6, -0.3), (0.2, 0.12), YAW)
TURN = Rotation.from_euler("z", YAW).as_matrix()


def looking(eye, target):
    """T_world_camera in OpenCV's axes."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = eye
    return T


def depth_of(T, table=(0.35, 0.3)):
    """f64[H, W]: a table of these half sides about the region, the block on it, and a floor at z = 0."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    way = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], -1)
    way = way @ T[:3, :3].T
    eye = TURN.T @ (T[:3, 3] - [*MIDDLE, LEVEL])
    way = way @ TURN
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = (-LEVEL - eye[2]) / way[..., 2]
        top = -eye[2] / way[..., 2]
        at = eye[:2] + top[..., None] * way[..., :2]
        top = np.where((np.abs(at) < table).all(-1) & (top > 0), top, np.inf)
        near, far = np.sort([(BLOCK + sign * BLOCK_HALF - eye) / way for sign in (-1, 1)], axis=0)
    enter = near.max(-1)
    block = np.where((enter < far.min(-1)) & (enter > 0), enter, np.inf)
    floor = np.where(floor > 0, floor, np.inf)
    return np.minimum(np.minimum(floor, top), block)


VIEW = looking(np.array([0.35, -0.75, 1.0]), np.array([*MIDDLE, LEVEL]))


def farthest_from_all(rng, query):
    """A placer that knows where nothing can be: the middle of the largest free place, a turn of 0.3."""
    from scipy.ndimage import distance_transform_edt

    maps = query.ceilings
    is_free = np.abs(np.asarray(maps.height)) < 0.003
    x, y = (
        np.asarray(maps.corner)[k] + maps.cell[k] * (np.arange(is_free.shape[k]) + 0.5)
        for k in (0, 1)
    )
    inside = (np.abs(x) < query.region_half_extents[0])[:, None] & (
        np.abs(y) < query.region_half_extents[1]
    )
    room = np.where(inside, distance_transform_edt(is_free), 0)
    i, j = np.unravel_index(room.argmax(), room.shape)
    return np.array([[x[i], y[j], query.half_extents[2] + 0.001, 0.3]])


def tall_box():
    """6 x 3 x 10 cm, its frame at a lower corner."""
    return trimesh.creation.box(
        (0.06, 0.03, 0.1),
        np.array([[1, 0, 0, 0.03], [0, 1, 0, 0.015], [0, 0, 1, 0.05], [0, 0, 0, 1]]),
    )


def corners_of(pose, mesh):
    turn = Rotation.from_quat(pose[[4, 5, 6, 3]]).as_matrix()
    return mesh.vertices @ turn.T + pose[:3]


def test_a_pose_stands_on_the_level_inside_the_region_and_clear_of_what_was_seen():
    mesh = tall_box()
    found = cg.propose_places(
        depth_of(VIEW), K, VIEW, REGION, mesh, height=LEVEL, placer=farthest_from_all
    )
    assert found.poses.shape == (1, 7)
    assert np.isnan(found.chances).all()
    corners = corners_of(found.poses[0], mesh)
    assert corners[:, 2].min() == pytest.approx(LEVEL + 0.001, abs=1e-4)
    assert np.ptp(corners[:, 2]) == pytest.approx(0.1, abs=1e-4)
    local = (corners - [*MIDDLE, LEVEL]) @ TURN
    assert (np.abs(local[:, :2].mean(0)) < REGION.half_extents).all()
    # On the side of the block that is free, by more than a cell.
    assert local[:, 0].max() < BLOCK[0] - BLOCK_HALF[0] - 0.01
    # Turned by 0.3 against the region.
    edge = local[np.argsort(mesh.vertices @ [1.0, 0.1, 0.01])[[0, -1]]]
    assert np.isfinite(edge).all()
    turn = Rotation.from_quat(found.poses[0][[4, 5, 6, 3]]).as_euler("xyz")
    np.testing.assert_allclose(turn, [0, 0, YAW + 0.3], atol=1e-5)


def test_larger_images_several_images_and_missing_pixels_change_little():
    def ask(depth, K=K, T=VIEW, **options):
        return cg.propose_places(
            depth, K, T, REGION, tall_box(), height=LEVEL, placer=farthest_from_all, **options
        ).poses[0]

    plain = ask(depth_of(VIEW))
    other = looking(np.array([0.95, -0.7, 1.1]), np.array([*MIDDLE, LEVEL]))
    two = ask([depth_of(VIEW), depth_of(other)], T=[VIEW, other])
    rng = np.random.default_rng(0)
    holes = depth_of(VIEW)
    for value in (np.nan, 0.0, np.inf):
        holes[rng.uniform(size=holes.shape) < 0.01] = value
    # Each pixel four times: K of twice the size.
    double = ask(np.kron(depth_of(VIEW), np.ones((2, 2))), np.diag([2.0, 2, 1]) @ K)
    for each in (two, ask(holes), double):
        assert np.abs(each[:3] - plain[:3]).max() < 0.03
        np.testing.assert_allclose(each[3:], plain[3:], atol=1e-6)


def test_beyond_a_tables_edge_there_is_nothing_to_stand_on():
    seen = []

    def look(rng, query):
        seen.append(query)
        return np.array([[0.0, 0.0, 0.05, 0.0]])

    for table in ((0.35, 0.3), (0.35, 0.05)):
        depth = depth_of(VIEW, table)
        cg.propose_places(depth, K, VIEW, REGION, tall_box(), height=LEVEL, placer=look)
    whole, narrow = (np.asarray(each.heights.height) for each in seen)
    ground = seen[0].heights
    y = np.asarray(ground.corner)[1] + ground.cell[1] * (np.arange(whole.shape[1]) + 0.5)
    is_beyond = (np.abs(y) > 0.07) & (np.abs(y) < 0.1)
    column = whole.shape[0] // 4
    assert (np.abs(whole[column, is_beyond]) < 1e-6).all()
    assert (narrow[column, is_beyond] < -0.5).all()


def test_the_body_knows_where_its_mesh_was(tmp_path):
    mesh = tall_box()
    asset, T = body_of(mesh)
    np.testing.assert_allclose(2 * asset.half_extents, [0.06, 0.03, 0.1], atol=1e-6)
    np.testing.assert_allclose(T[:3, 3], [-0.03, -0.015, -0.05], atol=1e-5)
    np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=1e-5)
    assert body_of(trimesh.Trimesh(mesh.vertices, mesh.faces))[0] is asset
    # A GLB file has y up; its frame is the file's.
    upright = mesh.copy()
    upright.apply_transform(np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]]))
    upright.export(tmp_path / "box.glb")
    asset, T = body_of(tmp_path / "box.glb")
    np.testing.assert_allclose(2 * asset.half_extents, [0.06, 0.03, 0.1], atol=1e-6)
    points = upright.vertices @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(np.abs(points).max(0), asset.half_extents, atol=1e-5)
    mug = find_pool("dining")["mug"]
    assert body_of(mug)[0] is mug


def test_what_is_no_image_no_camera_and_no_body_is_refused():
    depth = depth_of(VIEW)
    flip = np.diag([1.0, -1, -1, 1])
    flat = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]])
    usual = {
        "depth": depth,
        "K": K,
        "T": VIEW,
        "region": REGION,
        "mesh": tall_box(),
        "height": LEVEL,
    }
    wrong = [
        ({"depth": 1000 * depth}, ConfigError, "millimetres"),
        ({"depth": (1000 * depth).astype(np.uint16)}, ConfigError, "millimetres"),
        ({"depth": depth[..., None]}, ConfigError, "images"),
        ({"depth": -depth}, ConfigError, "in front of the camera"),
        ({"depth": np.full_like(depth, np.nan)}, ConfigError, "without a measured pixel"),
        ({"depth": []}, ConfigError, "no depth image"),
        ({"depth": "image.png"}, ConfigError, "depth of shape"),
        ({"K": 4 * K}, ConfigError, "principal point"),
        ({"K": np.eye(4)}, ConfigError, "K: shape"),
        ({"K": None}, ConfigError, "K: "),
        ({"K": -K}, ConfigError, "intrinsics"),
        ({"T": np.diag([2.0, 1, 1, 1])}, ConfigError, "rigid"),
        (
            {"T": VIEW @ flip},
            ConfigError,
            r"np.diag\(\[1, -1, -1, 1\]\), for what is given in OpenGL",
        ),
        ({"T": np.linalg.inv(VIEW)}, ConfigError, "T_camera_world"),
        ({"T": [VIEW, VIEW]}, ConfigError, "1 depth images|for each"),
        ({"region": cg.Rectangle((5, 5), (0.1, 0.1))}, ConfigError, "see nothing of the region"),
        ({"region": "a table"}, ConfigError, "X,Y,W,D"),
        ({"region": 3}, ConfigError, "Rectangle"),
        ({"height": LEVEL + 0.25}, ConfigError, "height=0.4"),
        ({"height": "low"}, ConfigError, "finite number"),
        ({"region": "table"}, ConfigError, "beside a support"),
        ({"mesh": flat}, AssetError, "thickness"),
        ({"mesh": trimesh.creation.box((60, 30, 100))}, AssetError, "millimetres"),
        ({"mesh": "nowhere.obj"}, AssetError, "does not exist"),
        ({"mesh": 3}, AssetError, "trimesh"),
    ]
    for change, kind, text in wrong:
        asked = usual | change
        with pytest.raises(kind, match=text):
            cg.propose_places(
                asked["depth"],
                asked["K"],
                asked["T"],
                asked["region"],
                asked["mesh"],
                height=asked["height"],
                placer=farthest_from_all,
            )
    with pytest.raises(ConfigError, match="knows the whole scene"):
        cg.propose_places(depth, K, VIEW, REGION, tall_box(), height=LEVEL, placer="drop")


def stands(pose, mesh):
    """Whether the box stays where it is let go beside the block, in a model made of MuJoCo's own boxes."""
    spec = mujoco.MjSpec()
    turn = Rotation.from_euler("z", YAW).as_quat(scalar_first=True)
    box = mujoco.mjtGeom.mjGEOM_BOX
    place = TURN @ BLOCK + [*MIDDLE, LEVEL]
    spec.worldbody.add_geom(type=box, pos=place, quat=turn, size=BLOCK_HALF)
    table = [*MIDDLE, LEVEL - 0.02]
    spec.worldbody.add_geom(type=box, pos=table, quat=turn, size=(0.35, 0.3, 0.02))
    body = spec.worldbody.add_body(pos=pose[:3], quat=pose[3:])
    body.add_freejoint()
    body.add_geom(type=box, pos=mesh.bounds.mean(0), size=np.ptp(mesh.bounds, axis=0) / 2)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    moved = np.linalg.norm(data.qpos[:3] - pose[:3])
    return moved < 0.01 and abs(data.qvel).max() < 0.02


@pytest.mark.slow
def test_what_the_trained_placer_proposes_stands_in_a_model_of_its_own():
    mesh = tall_box()
    rng = np.random.default_rng(0)
    num_good = 0
    for _ in range(8):
        eye = [*(MIDDLE + rng.uniform(-0.4, 0.4, 2)), LEVEL + rng.uniform(0.5, 0.8)]
        T = looking(np.array(eye), np.array([*MIDDLE, LEVEL]))
        depth = depth_of(T) + 0.001 * rng.standard_normal((HEIGHT, WIDTH))
        believed = T.copy()
        believed[:3, 3] += [0.001, -0.001, 0.004]
        found = cg.propose_places(depth, K, believed, REGION, mesh, height=LEVEL)
        assert len(found.poses) == len(found.chances) > 0
        assert (np.diff(found.chances) <= 0).all()
        num_good += stands(found.poses[0], mesh)
    assert num_good >= 7


@pytest.mark.slow
def test_proposals_in_noisy_images_of_cluttered_tables_stand(tmp_path):
    bank = cg.generate(
        tmp_path / "bank", pool="household", num_scenes=12, num_objects=8, max_files=0, render=False
    )
    scenes = PartialScenes(bank)
    world = scenes.problem.world
    places = np.array([[row, 7] for row in range(len(scenes.number))])
    episodes = scenes.episodes(places)
    sensor = RaySensor(sensed_model(world.objects, world.support))
    data = sensor.make_data()
    rng = np.random.default_rng(0)
    poses = []
    for row in range(len(places)):
        sensor.pose(data, episodes.poses[row], episodes.is_placed[row])
        exact = free(world.support, rng)
        depth, camera = noisy(sensor.sense(data, exact).depth, exact, REALSENSE, rng)
        asset = world.objects[scenes.object_index[row, 7]]
        region = scenes.problem.region
        found = cg.propose_places(
            depth, camera.K, camera.T_world_camera, region, asset, height=world.support.top
        )
        x, y, z = found.poses[0][:3]
        turn = Rotation.from_quat(found.poses[0][[4, 5, 6, 3]]).as_euler("xyz")
        np.testing.assert_allclose(turn[:2], 0, atol=1e-5)
        local = np.array([x, y]) - region.center
        cos, sin = np.cos(region.yaw), np.sin(region.yaw)
        poses.append(
            [
                cos * local[0] + sin * local[1],
                cos * local[1] - sin * local[0],
                z - world.support.top,
                turn[2] - region.yaw,
            ]
        )
    judged = ProposalJudge(scenes.rules).settle(
        episodes, np.arange(len(places)), np.array(poses, np.float32)
    )
    share = (judged.verdict == int(Verdict.STABLE)).mean()
    assert share >= 0.8


@pytest.mark.slow
def test_the_example_of_the_docstring_runs():
    text = cg.propose_places.__doc__
    lines = [line[8:] for line in text.splitlines() if line.startswith(" " * 8)]
    code = "\n".join(
        lines[: next(k for k, line in enumerate(lines) if "poses, chances" in line) + 1]
    )
    names: dict = {}
    exec(code, names)
    poses = names["poses"]
    assert poses.shape == (5, 7)
    assert names["chances"].min() > 0.9
    assert (np.abs(poses[:, 2] - 0.031) < 0.002).all()
