"""A user's table becomes boxes: our own tables, seen as bare meshes, are the oracle."""

import numpy as np
import pytest
import trimesh
from shapely.geometry import Polygon
from shapely.ops import unary_union

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller.bins import SIZES
from cluttergen_jax.assets.shape import Piece, Provenance, Shape
from cluttergen_jax.assets.support_map import cover, largest_rectangle
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.supports import support_with_notes
from scenes.furniture import SUPPORTS, make_support

# Of a container on a table the table is found.
FURNITURE = [
    name
    for name in SUPPORTS
    if name != "table" and name not in SIZES and not make_support(name).named
]
SOURCE = Provenance("test", "Apache-2.0")


def turned(angle):
    return np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )


def shape_of(support, angle=0.0, shift=(0.0, 0.0, 0.0)):
    pieces = [
        Piece(piece.mesh.transform(turned(angle), shift), piece.rgba) for piece in support.pieces
    ]
    return Shape(support.name, support.label, tuple(pieces), SOURCE)


def polygon(center, half, yaw):
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half[:2], 0]
    return Polygon((corners @ turned(yaw).T)[:, :2] + np.asarray(center[:2]))


def top_outline(support):
    tops = [b for b in support.boxes if abs(b.center[2] + b.half_extents[2] - support.top) < 1e-9]
    return unary_union([polygon(b.center, b.half_extents, b.yaw) for b in tops]), tops


def region_of(support):
    return polygon(support.region.center, support.region.half_extents, support.region.yaw)


@pytest.mark.parametrize("name", FURNITURE)
@pytest.mark.parametrize("angle", [0.0, pytest.param(0.4, marks=pytest.mark.slow)])
def test_our_tables_are_found_again(name, angle):
    own = make_support(name)
    found, _ = support_with_notes(shape_of(own, angle, (3.0, -2.0, 0.7)))
    assert found.top == pytest.approx(own.top, abs=1e-6)
    outline, tops = top_outline(found)
    assert outline.area == pytest.approx(
        sum(4 * b.half_extents[0] * b.half_extents[1] for b in tops)
    )
    # Turned by 0.4 a round table has no sides to go by, so its region may be turned differently.
    region = region_of(found)
    wanted = region_of(own)
    assert region.area == pytest.approx(wanted.area, rel=0.05)
    assert region.difference(outline.buffer(1e-6)).area < 1e-9
    for box in found.boxes:
        if box.center[2] > found.top:
            assert polygon(box.center, box.half_extents, box.yaw).intersection(region).area < 1e-12
    if angle == 0.0:
        drawn = np.concatenate([piece.mesh.vertices for piece in found.pieces])
        np.testing.assert_allclose(drawn.min(0)[:2] + drawn.max(0)[:2], 0, atol=1e-9)
        assert drawn[:, 2].min() == pytest.approx(0, abs=1e-9)
        # What hangs over a top is an obstacle; where it is a surface itself, there is room below it.
        over = [b for b in own.boxes if b.center[2] > own.top and not found.named]
        covered = unary_union([polygon(b.center, b.half_extents, b.yaw) for b in over])
        own_outline = top_outline(own)[0].difference(covered)
        shared = outline.intersection(own_outline).area
        assert shared / outline.union(own_outline).area > 0.94


def test_rims_and_risers_become_obstacles():
    for name in ("tray_table", "shelf_desk"):
        own = make_support(name)
        found, _ = support_with_notes(shape_of(own))
        highest = max(box.center[2] + box.half_extents[2] for box in own.boxes)
        assert max(b.center[2] + b.half_extents[2] for b in found.boxes) == pytest.approx(
            highest, abs=1e-6
        )


def test_what_has_no_level_top_is_refused():
    ball = trimesh.creation.icosphere(3, 0.3)
    with pytest.raises(AssetError, match="level area"):
        support_with_notes(Shape("ball", "ball", (Piece(Mesh(ball.vertices, ball.faces)),), SOURCE))


@pytest.mark.parametrize("seed", range(30))
def test_largest_rectangle_against_all_rectangles(seed):
    rng = np.random.default_rng(seed)
    mask = rng.random((rng.integers(1, 9), rng.integers(1, 9))) < rng.uniform(0.3, 1.0)
    rows, columns = mask.shape
    areas = [
        (x1 - x0) * (y1 - y0)
        for x0 in range(rows)
        for x1 in range(x0 + 1, rows + 1)
        for y0 in range(columns)
        for y1 in range(y0 + 1, columns + 1)
        if mask[x0:x1, y0:y1].all()
    ]
    x0, x1, y0, y1 = largest_rectangle(mask)
    assert (x1 - x0) * (y1 - y0) == max(areas, default=0)
    assert mask[x0:x1, y0:y1].all()
    count = np.zeros(mask.shape, int)
    for a0, a1, b0, b1 in cover(mask, missing=0.0, limit=1000):
        count[a0:a1, b0:b1] += 1
    np.testing.assert_array_equal(count, mask.astype(int))
