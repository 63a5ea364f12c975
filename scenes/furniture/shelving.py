"""Supports with several surfaces, walls or a slope: bookcase, rack, drawer, dish rack, boards, steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import bins
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Draw
from cluttergen_jax.assets.shape import Joint
from cluttergen_jax.assets.support import Box, Rectangle, SupportAsset, Surface
from scenes.furniture import joinery

Slab = tuple[tuple[float, float, float], tuple[float, float], float]
"""Size, place and lower height of a board."""


def bookcase(vary: Draw) -> SupportAsset:
    """A bookcase of four boards between two sides, closed at the back; its top carries objects, too."""
    width = vary(0.80, 0.1)
    depth = vary(0.30, 0.08)
    height = vary(1.08, 0.05)
    sheet = 0.018
    back = 0.008
    plinth = 0.06
    wood = vary.color(bins.WOODS[3], *bins.WOODS)
    inner = width - 2 * sheet
    front = depth - back
    shelves: list[Slab] = []
    pitch = (height - plinth - sheet) / 3
    for k in (2, 1, 0):
        shelves.append(((inner, front, sheet), (0, -back / 2), plinth + k * pitch))
    panels: list[Slab] = [
        *(((sheet, depth, height - sheet), (s * (width - sheet) / 2, 0.0), 0.0) for s in (-1, 1)),
        ((inner, back, height - sheet - plinth), (0.0, (depth - back) / 2), plinth),
        ((inner, sheet, plinth), (0.0, -depth / 2 + 0.03), 0.0),
    ]
    lid = ((width, depth, sheet), (0.0, 0.0), height - sheet)
    return furniture(
        "bookcase",
        [
            on_slab("top", lid),
            *(on_slab(f"shelf_{k}", each, pitch - sheet) for k, each in enumerate(shelves, 1)),
        ],
        [bins.slab(*each) for each in (lid, *shelves, *panels)],
        [
            *((joinery.board(*each), wood) for each in (lid, *shelves)),
            *((joinery.board(*each), joinery.darker(wood, 0.93)) for each in panels[:2]),
            *((cad.box(*each), joinery.darker(wood, 0.86)) for each in panels[2:]),
        ],
    )


def rack(vary: Draw) -> SupportAsset:
    """A rack of two boards on four posts, open on all sides."""
    width = vary(0.70, 0.1)
    depth = vary(0.36, 0.08)
    top = vary(0.72, 0.05)
    low = vary(0.34, 0.05)
    sheet = 0.022
    post = 0.03
    wood = vary.color(bins.WOODS[1], *bins.WOODS)
    paint = vary.color(*joinery.METALS, spread=0.02)
    # The lower board lies between the posts, so that none of them stands on it.
    boards: list[Slab] = [
        ((width, depth, sheet), (0.0, 0.0), top - sheet),
        ((width - 2 * post, depth, sheet), (0.0, 0.0), low - sheet),
    ]
    places = joinery.mirror_corners((width - post) / 2, (depth - post) / 2)
    posts: list[Slab] = [((post, post, top - sheet), place, 0.0) for place in places]
    rails: list[Slab] = [
        ((post / 2, depth - 2 * post, 0.03), (s * (width - post) / 2, 0.0), z)
        for s in (-1, 1)
        for z in (0.08, low - sheet)
    ]
    return furniture(
        "rack",
        [on_slab("top", boards[0]), on_slab("shelf_1", boards[1], top - sheet - low)],
        [bins.slab(*each) for each in (*boards, *posts, *rails)],
        [
            *((joinery.board(*each, 0.004), wood) for each in boards),
            (cad.union(*(cad.box(*each) for each in (*posts, *rails))), paint),
        ],
        "two-board rack",
    )


def kitchen_drawer(vary: Draw) -> SupportAsset:
    """A kitchen cabinet whose upper drawer is open; things go into the drawer, and on the worktop."""
    width = vary(0.60, 0.08)
    depth = vary(0.56, 0.05)
    height = vary(0.90, 0.03)
    wall = 0.015
    floor = 0.012
    sheet = 0.035
    reach = 0.44
    wood = vary.color(*bins.WOODS)
    paint = vary.color(*joinery.PAINTS, spread=0.03)
    back = reach / 2
    carcass: Slab = ((width, depth, height - sheet - 0.08), (0.0, back), 0.08)
    face = back - depth / 2
    lid: Slab = ((width + 0.01, depth + 0.02, sheet), (0.0, back), height - sheet)
    low = height - sheet - 0.15
    deep = 0.105
    inner = width - 0.04 - 2 * wall
    length = reach - 0.02
    middle = face - length / 2
    bottom: Slab = ((inner + 2 * wall, length, floor), (0.0, middle), low)
    walls: list[Slab] = [
        *(((wall, length, deep), (s * (inner + wall) / 2, middle), low + floor) for s in (-1, 1)),
        ((inner, wall, deep), (0.0, face - wall / 2), low + floor),
    ]
    front: Slab = ((width - 0.006, 0.02, 0.145), (0.0, face - length - 0.01), low)
    doors: list[Slab] = [
        (
            (width - 0.006, 0.02, (low - 0.09) / 2 - 0.004),
            (0.0, face - 0.01),
            0.085 + k * (low - 0.09) / 2,
        )
        for k in (0, 1)
    ]
    handles = [
        cad.cylinder(0.006, 0.20, -0.10).rotate((0, 90, 0)).translate((0, y - 0.03, z))
        for y, z in (
            (front[1][1], front[2] + 0.09),
            *((d[1][1], d[2] + d[0][2] - 0.06) for d in doors),
        )
    ]
    inside: Slab = ((inner, length - wall, floor), (0.0, middle - wall / 2), low)
    return furniture(
        "kitchen_drawer",
        [on_slab("drawer", inside), on_slab("top", lid)],
        [bins.slab(*each) for each in (carcass, lid, bottom, *walls, front, *doors)],
        [
            (joinery.board(*lid, 0.006), wood),
            (cad.box(*carcass), joinery.darker(paint, 0.95)),
            (cad.box((width - 0.02, depth - 0.06, 0.08), (0.0, back + 0.02)), joinery.DARK_STEEL),
            (cad.union(*(cad.box(*each) for each in (bottom, *walls))), bins.WOODS[3]),
            (cad.union(*(joinery.board(*each, 0.003) for each in (front, *doors))), paint),
            (cad.union(*handles), joinery.METALS[1]),
        ],
        "kitchen cabinet with an open drawer",
    )


def dish_rack(vary: Draw) -> SupportAsset:
    """A dish rack: a tray with a rim of two wires, and a comb of pegs for plates along its back."""
    width = vary(0.46, 0.08)
    depth = vary(0.36, 0.06)
    foot = 0.012
    floor = 0.008
    rim = 0.055
    wire = 0.005
    steel = vary.color(*joinery.METALS[1:], spread=0.02)
    plastic = vary.color(*joinery.PAINTS, spread=0.03)
    top = foot + floor
    tray: Slab = ((width, depth, floor), (0.0, 0.0), foot)
    comb = depth / 2 - 0.075
    side = depth / 2 - wire
    xs = np.linspace(-width / 2 + 0.05, width / 2 - 0.05, max(int(width / 0.042), 4))
    pegs: list[Slab] = [
        ((wire, wire, 0.085), (x, y), top) for x in xs.tolist() for y in (comb, side - 0.02)
    ]
    walls: list[Slab] = []
    for z in (0.5 * rim, rim):
        walls += [
            ((width, wire, wire), (0.0, s * (depth - wire) / 2), top + z - wire) for s in (-1, 1)
        ]
        walls += [
            ((wire, depth - 2 * wire, wire), (s * (width - wire) / 2, 0.0), top + z - wire)
            for s in (-1, 1)
        ]
    places = joinery.mirror_corners((width - wire) / 2, (depth - wire) / 2)
    posts: list[Slab] = [((wire, wire, rim), place, top) for place in places]
    feet: list[Slab] = [
        ((0.03, 0.03, foot), place, 0.0)
        for place in joinery.mirror_corners(width / 2 - 0.03, depth / 2 - 0.03)
    ]
    edge = comb - wire - 0.005
    front = -depth / 2 + wire
    half = ((width - 2 * wire) / 2, (edge - front) / 2)
    region = Rectangle((0.0, (edge + front) / 2), half)
    return furniture(
        "dish_rack",
        [Surface("tray", (0.0, 0.0, top), region, _ring(region))],
        [bins.slab(*each) for each in (tray, *walls, *posts, *pegs, *feet)],
        [
            (joinery.board(*tray), plastic),
            (cad.union(*(cad.box(*each) for each in feet)), joinery.DARK_STEEL),
            (cad.union(*(_rod(*each) for each in (*walls, *posts, *pegs))), steel),
        ],
    )


def tilted_board(vary: Draw, degrees: int) -> SupportAsset:
    """A drawing board on a stand, its front edge lower by so many degrees of slope."""
    width = vary(0.70, 0.1)
    depth = vary(0.55, 0.08)
    height = vary(0.72, 0.04)
    sheet = 0.024
    wood = vary.color(bins.WOODS[3], *bins.WOODS)
    paint = vary.color(*joinery.METALS, spread=0.02)
    slope = math.radians(degrees)
    turn = (math.cos(slope / 2), math.sin(slope / 2), 0.0, 0.0)
    region = Rectangle((0.0, 0.0), (width / 2, depth / 2))
    surface = Surface("top", (0.0, 0.0, height), region, _ring(region), quaternion=turn)
    T = surface.T_world_surface

    def tilt(points: np.ndarray) -> np.ndarray:
        return points @ T[:3, :3].T + T[:3, 3]

    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 0)], np.float64)
    board = Mesh.points(tilt(corners * (width / 2, depth / 2, sheet)))
    drawn = joinery.board((width, depth, sheet), (0.0, 0.0), -sheet, 0.004).rotate((degrees, 0, 0))
    x = 0.40 * width
    y = 0.30 * depth
    legs: list[Slab] = []
    for s in (-1, 1):
        under = height + s * y * math.tan(slope) - sheet / math.cos(slope) - 0.022 * math.tan(slope)
        legs += [((0.045, 0.045, under), (t * x, s * y), 0.0) for t in (-1, 1)]
    rails: list[Slab] = [((0.03, 2 * y, 0.05), (s * x, 0.0), 0.12) for s in (-1, 1)]
    rails.append(((2 * x, 0.03, 0.05), (0.0, 0.0), 0.12))
    support = furniture(
        f"tilted_board_{degrees}",
        [surface],
        [bins.slab(*each) for each in (*legs, *rails)],
        [
            (drawn.translate((0.0, 0.0, height)), wood),
            (cad.union(*(cad.box(*each) for each in (*legs, *rails))), paint),
        ],
        f"board at a slope of {degrees} degrees",
    )
    return replace(support, parts=(board,))


def steps(vary: Draw) -> SupportAsset:
    """Three steps, each as deep as the next."""
    width = vary(0.60, 0.1)
    tread = vary(0.26, 0.08)
    rise = vary(0.17, 0.08)
    wood = vary.color(bins.WOODS[1], *bins.WOODS)
    nosing = 0.022
    treads: list[Slab] = []
    blocks: list[Slab] = []
    for k in (3, 2, 1):
        y = (k - 2) * tread
        treads.append(((width, tread, nosing), (0.0, y), k * rise - nosing))
        blocks.append(((width - 0.03, tread, k * rise - nosing), (0.0, y), 0.0))
    return furniture(
        "steps",
        [
            on_slab("top", treads[0]),
            *(on_slab(f"step_{k}", each) for k, each in enumerate(treads[1:], 1)),
        ],
        [bins.slab(*each) for each in (*treads, *blocks)],
        [
            *((joinery.board(*each, 0.004), wood) for each in treads),
            (cad.union(*(cad.box(*each) for each in blocks)), joinery.darker(wood, 0.82)),
        ],
    )


def on_slab(name: str, slab: Slab, free_height: float = math.inf) -> Surface:
    """The upper face of a board as a surface."""
    size, (x, y), low = slab
    region = Rectangle((float(x), float(y)), (size[0] / 2, size[1] / 2))
    return Surface(name, (0.0, 0.0, low + size[2]), region, _ring(region), free_height=free_height)


def _ring(region: Rectangle) -> tuple[tuple[float, float], ...]:
    return tuple((x, y) for x, y in region.corners.tolist())


def _rod(size: Sequence[float], place: Sequence[float], low: float) -> Manifold:
    """A round wire where a thin box stands in collision."""
    axis = int(np.argmax(size))
    radius = sorted(size)[0] / 2
    rod = cad.cylinder(radius, size[axis], -size[axis] / 2, segments=12)
    turn = ((0, 90, 0), (90, 0, 0), (0, 0, 0))[axis]
    return rod.rotate(turn).translate((place[0], place[1], low + size[2] / 2))


def furniture(
    name: str,
    surfaces: Sequence[Surface],
    boxes: Sequence[Box],
    pieces: Sequence[cad.Painted],
    label: str = "",
    joints: Sequence[Joint] = (),
) -> SupportAsset:
    """Puts furniture with several surfaces together, the first of which is used by default."""
    first = surfaces[0]
    table = bins.table(name, first.position[2], first.region, boxes, pieces, label)
    return replace(table, named=tuple(surfaces), joints=tuple(joints))
