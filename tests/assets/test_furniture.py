"""Tables: flat where they claim to be, clear over the region, boxes that agree with what is drawn."""

import mujoco
import numpy as np
import pytest
import trimesh
from shapely.geometry import Polygon
from shapely.ops import unary_union

from cluttergen_jax.assets.mjcf import add_support, new_spec
from cluttergen_jax.assets.modeller.furniture import SUPPORTS, make_support
from cluttergen_jax.assets.modeller.joinery import oval_boxes
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError, PoolError

SEEDS = (None, 0, 1, 2, 3, 4)
FURNITURE = [name for name in SUPPORTS if name != "table"]
every_table = pytest.mark.parametrize("name", list(SUPPORTS))
every_seed = pytest.mark.parametrize("seed", SEEDS)


def rectangle(center, half, yaw):
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half[:2]
    return Polygon(corners @ turn.T + np.asarray(center[:2]))


def footprint(box):
    return rectangle(box.center, box.half_extents, box.yaw)


def ends(box):
    return box.center[2] - box.half_extents[2], box.center[2] + box.half_extents[2]


def top_boxes(support):
    return [box for box in support.boxes if abs(ends(box)[1] - support.top) < 1e-9]


def bounds(points):
    return np.stack([points.min(0), points.max(0)])


def box_bounds(support):
    corners = [[*xy, z] for box in support.boxes for xy in footprint(box).exterior.coords for z in ends(box)]
    return bounds(np.array(corners))


def height_above(mesh, spots):
    """f64[P]: the highest crossing of the vertical line through each spot with a mesh, else -inf."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    to_b, to_c, to_p = (b - a)[None, :, :2], (c - a)[None, :, :2], spots[:, None] - a[None, :, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        area = to_b[..., 0] * to_c[..., 1] - to_b[..., 1] * to_c[..., 0]
        u = (to_p[..., 0] * to_c[..., 1] - to_p[..., 1] * to_c[..., 0]) / area
        v = (to_b[..., 0] * to_p[..., 1] - to_b[..., 1] * to_p[..., 0]) / area
        height = a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2]
        is_hit = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1 + 1e-12) & (np.abs(area) > 1e-12)
    return np.where(is_hit, height, -np.inf).max(1)


@every_table
@every_seed
def test_region_lies_on_the_top_and_nothing_stands_over_it(name, seed):
    support = make_support(name, seed)
    region = rectangle(support.region.center, support.region.half_extents, support.region.yaw)
    # A picnic table's planks leave gaps of 8 mm; the outline around them counts.
    top = unary_union([footprint(box).buffer(0.0045, join_style="mitre") for box in top_boxes(support)])
    outline = top.buffer(-0.0045, join_style="mitre")
    assert region.difference(outline.buffer(1e-6)).area < 1e-9
    for box in support.boxes:
        if ends(box)[1] > support.top + 1e-9:
            assert footprint(box).intersection(region).area < 1e-12


@every_table
@every_seed
def test_top_boxes_do_not_overlap(name, seed):
    shapes = [footprint(box) for box in top_boxes(make_support(name, seed))]
    assert unary_union(shapes).area == pytest.approx(sum(shape.area for shape in shapes), rel=1e-9)


@pytest.mark.parametrize("name", FURNITURE)
@every_seed
def test_boxes_and_surfaces_have_the_same_size(name, seed):
    support = make_support(name, seed)
    drawn = bounds(np.concatenate([piece.mesh.vertices for piece in support.pieces]))
    solid = box_bounds(support)
    size = drawn[1] - drawn[0]
    assert np.abs(drawn - solid).max(0) == pytest.approx(np.zeros(3), abs=0.03 * size.min())
    assert drawn[0, 2] == pytest.approx(0, abs=1e-9)
    assert np.abs(drawn.mean(0)[:2]).max() < 0.005


@pytest.mark.parametrize("name", FURNITURE)
@every_seed
def test_surface_is_drawn_at_the_top_all_over_the_region(name, seed):
    support = make_support(name, seed)
    surfaces = [trimesh.Trimesh(p.mesh.vertices, p.mesh.faces, process=False) for p in support.pieces]
    assert all(mesh.is_watertight for mesh in surfaces)
    rng = np.random.default_rng(1)
    spots = rng.uniform(-0.97, 0.97, (40, 2)) * support.region.half_extents + support.region.center
    highest = np.max([height_above(piece.mesh, spots) for piece in support.pieces], axis=0)
    # Planks have broken edges, and a line may pass between two of them; nothing stands above the top.
    assert highest.max() <= support.top + 1e-6
    assert (highest > support.top - 1e-6).mean() > 0.8


@pytest.mark.parametrize("name", list(SUPPORTS))
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


@pytest.mark.parametrize(("rx", "ry"), [(0.45, 0.45), (0.7, 0.4), (0.2, 0.6)])
def test_oval_boxes_keep_the_area_and_stay_near_the_outline(rx, ry):
    shape = unary_union([footprint(box) for box in oval_boxes(rx, ry, 0.0, 0.03)])
    turn = np.linspace(0, 2 * np.pi, 2001)
    ellipse = Polygon(np.column_stack([rx * np.cos(turn), ry * np.sin(turn)]))
    assert shape.area == pytest.approx(ellipse.area, rel=1e-4)
    assert shape.hausdorff_distance(ellipse) < 0.07 * max(rx, ry)


def test_sizes_and_heights_are_those_of_furniture():
    heights = {name: make_support(name).top for name in SUPPORTS}
    assert heights["coffee_table"] < heights["tray_table"] < heights["round_table"] < heights["bar_table"]
    for name in FURNITURE:
        low, high = box_bounds(make_support(name))
        assert (high - low)[:2].min() > 0.4
        assert (high - low)[:2].max() < 2.0


def test_seeds_repeat_and_differ():
    for name in SUPPORTS:
        assert make_support(name, 3).boxes == make_support(name, 3).boxes
        assert make_support(name, 3).boxes != make_support(name, 4).boxes
        assert make_support(name, 3).name == f"{name}-3"


def test_names_and_sizes_that_cannot_be():
    with pytest.raises(PoolError, match="round_table"):
        make_support("sofa")
    with pytest.raises(ConfigError, match="size"):
        make_support("round_table", size=(1.0, 1.0))
    table = make_support("table", size=(0.3, 0.4))
    assert table.region.half_extents == (0.15, 0.2)
    assert table.top == pytest.approx(0.70)
