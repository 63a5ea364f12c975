"""Tables: flat where they claim to be, clear over the region, boxes that agree with what is drawn."""

import mujoco
import numpy as np
import pytest
import trimesh
from shapely.geometry import Polygon
from shapely.ops import unary_union

from cluttergen_jax.assets.mjcf import add_support, new_spec
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError, PoolError
from scenes.furniture import SUPPORTS, make_support

every_table = pytest.mark.parametrize(
    "name", [name for name in SUPPORTS if not make_support(name).named]
)


def rectangle(center, half, yaw):
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half[:2]
    return Polygon(corners @ turn.T + np.asarray(center[:2]))


def footprint(box):
    return rectangle(box.center, box.half_extents, box.yaw)


def ends(box):
    return box.center[2] - box.half_extents[2], box.center[2] + box.half_extents[2]


def height_above(mesh, spots):
    """f64[P]: the highest crossing of the vertical line through each spot with a mesh, else -inf."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    to_b = (b - a)[None, :, :2]
    to_c = (c - a)[None, :, :2]
    to_p = spots[:, None] - a[None, :, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        area = to_b[..., 0] * to_c[..., 1] - to_b[..., 1] * to_c[..., 0]
        u = (to_p[..., 0] * to_c[..., 1] - to_p[..., 1] * to_c[..., 0]) / area
        v = (to_b[..., 0] * to_p[..., 1] - to_b[..., 1] * to_p[..., 0]) / area
        height = a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2]
        is_hit = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1 + 1e-12) & (np.abs(area) > 1e-12)
    return np.where(is_hit, height, -np.inf).max(1)


def check_top(support):
    boxes = [footprint(box) for box in support.boxes if abs(ends(box)[1] - support.top) < 1e-9]
    assert unary_union(boxes).area == pytest.approx(sum(shape.area for shape in boxes), rel=1e-9)
    region = rectangle(support.region.center, support.region.half_extents, support.region.yaw)
    # A picnic table's planks leave gaps of 8 mm; the outline around them counts.
    top = unary_union([box.buffer(0.0045, join_style="mitre") for box in boxes])
    outline = top.buffer(-0.0045, join_style="mitre")
    assert region.difference(outline.buffer(1e-6)).area < 1e-9
    for box in support.boxes:
        if ends(box)[1] > support.top + 1e-9:
            assert footprint(box).intersection(region).area < 1e-12


def check_drawing(support):
    vertices = np.concatenate([piece.mesh.vertices for piece in support.pieces])
    drawn = np.stack([vertices.min(0), vertices.max(0)])
    corners = np.array(
        [
            [*xy, z]
            for box in support.boxes
            for xy in footprint(box).exterior.coords
            for z in ends(box)
        ]
    )
    solid = np.stack([corners.min(0), corners.max(0)])
    size = drawn[1] - drawn[0]
    assert np.abs(drawn - solid).max(0) == pytest.approx(np.zeros(3), abs=0.03 * size.min())
    assert drawn[0, 2] == pytest.approx(0, abs=1e-9)
    assert np.abs(drawn.mean(0)[:2]).max() < 0.005
    surfaces = [
        trimesh.Trimesh(p.mesh.vertices, p.mesh.faces, process=False) for p in support.pieces
    ]
    assert all(mesh.is_watertight for mesh in surfaces)
    spots = np.random.default_rng(1).uniform(-0.97, 0.97, (40, 2)) * support.region.half_extents
    spots = spots + support.region.center
    highest = np.max([height_above(piece.mesh, spots) for piece in support.pieces], axis=0)
    # Planks have broken edges, and a line may pass between two of them; nothing stands above the top.
    assert highest.max() <= support.top + 1e-6
    assert (highest > support.top - 1e-6).mean() > 0.8


@every_table
def test_a_table_keeps_its_promises_whatever_the_seed(name):
    for seed in (None, *np.random.default_rng(len(name)).integers(0, 2**31, 2).tolist()):
        support = make_support(name, seed)
        check_top(support)
        if name != "table":
            check_drawing(support)
    assert support.boxes == make_support(name, seed).boxes
    assert support.boxes != make_support(name, seed - 1).boxes
    assert support.name == f"{name}-{seed}"


@every_table
def test_region_carries_a_cube_at_each_corner(name):
    support = make_support(name)
    spec = new_spec(StabilityConfig().timestep, ContactConfig())
    add_support(spec, support)
    half = 0.02
    reach = np.asarray(support.region.half_extents) - half - 0.002
    for index, sign in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1), (0, 0)]):
        xy = np.asarray(support.region.center) + np.asarray(sign) * reach
        body = spec.worldbody.add_body(name=f"cube-{index}", pos=(*xy, support.top + half))
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(half, half, half), density=500)
    model = spec.compile()
    data = mujoco.MjData(model)
    start = data.qpos.reshape(-1, 7).copy()
    mujoco.mj_step(model, data, 240)
    shift = data.qpos.reshape(-1, 7) - start
    assert np.abs(shift).max() < 1e-3


def test_names_and_sizes_that_cannot_be():
    with pytest.raises(PoolError, match="round_table"):
        make_support("sofa")
    with pytest.raises(ConfigError, match="size"):
        make_support("round_table", size=(1.0, 1.0))
    table = make_support("table", size=(0.3, 0.4))
    assert table.region.half_extents == (0.15, 0.2)
    assert table.top == pytest.approx(0.70)
