"""Tables: with a curved outline (round, oval, bar, coffee), and of boards (tray, trestle, picnic)."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.modeller import bins
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Draw
from cluttergen_jax.assets.support import Box, Rectangle, SupportAsset
from scenes.furniture import joinery

_ROUND_CORNER = 1 - np.sqrt(0.5).item()


def round_table(vary: Draw) -> SupportAsset:
    """A round dining table on four splayed legs. The region is the square in the circle."""
    radius = vary(0.45, 0.12)
    top = vary(0.74, 0.03)
    thickness = vary(0.028)
    low = top - thickness
    wood = vary.color(*bins.WOODS)
    head = 0.46 * radius
    foot = 0.62 * radius
    feet = joinery.mirror_corners(foot, foot)
    heads = joinery.mirror_corners(head, head)
    legs = [
        joinery.round_leg((*f, 0.0), (*h, low), 0.014, 0.024)
        for f, h in zip(feet, heads, strict=True)
    ]
    apron = _ring(0.70 * radius, 0.66 * radius, low - 0.05, low)
    middle = 0.5 * (head + foot)
    return bins.table(
        "round_table",
        top,
        joinery.oval_region(radius, radius),
        [
            *joinery.oval_boxes(radius, radius, low, top),
            *(
                bins.slab((0.04, 0.04, low), place, 0.0)
                for place in joinery.mirror_corners(middle, middle)
            ),
        ],
        [
            (joinery.plate(cad.ellipse(radius, radius, 96), low, top, 0.005), wood),
            (cad.union(*legs, apron), joinery.darker(wood, 0.82)),
        ],
    )


def oval_table(vary: Draw) -> SupportAsset:
    """An oval dining table on two columns with long feet. The region is the largest rectangle inside."""
    rx = vary(0.72, 0.12)
    ry = vary(0.43, 0.1)
    top = vary(0.745, 0.03)
    thickness = vary(0.030)
    low = top - thickness
    wood = vary.color(*bins.WOODS[1:])
    x = 0.48 * rx
    reach = 0.66 * ry
    solids = []
    boxes = []
    for sign in (-1, 1):
        spine = [
            (-reach, 0.0),
            (reach, 0.0),
            (reach, 0.028),
            (0.06, 0.075),
            (-0.06, 0.075),
            (-reach, 0.028),
        ]
        sole = (
            cad.extrude(spine, 0.07)
            .rotate((90, 0, 0))
            .rotate((0, 0, 90))
            .translate((sign * x - 0.035, 0, 0))
        )
        column = cad.box((0.075, 0.16, low - 0.10), (sign * x, 0), 0.05)
        yoke = joinery.board((0.06, 1.25 * ry, 0.05), (sign * x, 0), low - 0.05, 0.008)
        solids += [sole, column, yoke]
        boxes += [
            bins.slab((0.07, 2 * reach, 0.05), (sign * x, 0), 0.0),
            bins.slab((0.075, 0.16, low - 0.10), (sign * x, 0), 0.05),
            bins.slab((0.06, 1.25 * ry, 0.05), (sign * x, 0), low - 0.05),
        ]
    solids.append(cad.box((2 * x, 0.03, 0.09), z=0.22))
    boxes.append(bins.slab((2 * x - 0.075, 0.03, 0.09), (0, 0), 0.22))
    return bins.table(
        "oval_table",
        top,
        joinery.oval_region(rx, ry),
        [*joinery.oval_boxes(rx, ry, low, top), *boxes],
        [
            (joinery.plate(cad.ellipse(rx, ry, 96), low, top, 0.006), wood),
            (cad.union(*solids), joinery.darker(wood, 0.80)),
        ],
        "oval dining table",
    )


def bar_table(vary: Draw) -> SupportAsset:
    """A small, high, round table on a steel column. The region is the square in the circle."""
    radius = vary(0.33, 0.1)
    top = vary(1.06, 0.04)
    thickness = 0.030
    low = top - thickness
    base = 0.74 * radius
    steel = vary.color(*joinery.METALS, spread=0.02)
    foot = cad.revolve(
        [(0, 0), (base, 0), (base, 0.006), (0.93 * base, 0.014), (0.05, 0.045), (0, 0.045)]
    )
    column = cad.cylinder(0.033, low - 0.06, 0.03)
    collar = cad.cylinder(0.05, 0.07, low - 0.075, top=0.13)
    rail = _ring(0.62 * base, 0.62 * base - 0.012, 0.30, 0.312)
    spokes = [
        cad.box((1.2 * base, 0.012, 0.010), z=0.301),
        cad.box((0.012, 1.2 * base, 0.010), z=0.301),
    ]
    core = 0.8 * base
    return bins.table(
        "bar_table",
        top,
        joinery.oval_region(radius, radius),
        [
            *joinery.oval_boxes(radius, radius, low, top),
            bins.slab((2 * core, 2 * core, 0.03), (0, 0), 0.0),
            bins.slab((0.066, 0.066, low - 0.03), (0, 0), 0.03),
        ],
        [
            (
                joinery.plate(cad.ellipse(0.992 * radius, 0.992 * radius, 96), low, top, 0.002),
                vary.color(*bins.WOODS[2:]),
            ),
            (_ring(radius, 0.988 * radius, low + 0.002, top - 0.003), joinery.DARK_STEEL),
            (cad.union(foot, column, collar, rail, *spokes), steel),
        ],
    )


def coffee_table(vary: Draw) -> SupportAsset:
    """A low table with round corners over a slatted shelf. The region stays within the round corners."""
    width = vary(1.10, 0.12)
    depth = vary(0.60, 0.12)
    top = vary(0.42, 0.08)
    radius = 0.05
    low = top - 0.034
    side = 0.05
    wood = vary.color(*bins.WOODS[1:])
    paint = vary.color(*joinery.PAINTS, spread=0.03)
    x = width / 2 - 0.075
    y = depth / 2 - 0.075
    shelf_low = 0.13
    shelf_high = 0.148
    frame = [cad.box((side, side, low), place) for place in joinery.mirror_corners(x, y)]
    frame += [cad.box((2 * x, 0.022, 0.06), (0, sign * y), low - 0.06) for sign in (-1, 1)]
    frame += [cad.box((0.022, 2 * y, 0.06), (sign * x, 0), low - 0.06) for sign in (-1, 1)]
    frame += [cad.box((0.03, 2 * y, 0.03), (sign * x, 0), shelf_low - 0.03) for sign in (-1, 1)]
    count = 5
    pitch = (2 * y - side) / count
    rows = [(k - (count - 1) / 2) * pitch for k in range(count)]
    slats = [
        joinery.board((2 * x + 0.02, 0.78 * pitch, 0.018), (0, row), shelf_low) for row in rows
    ]
    cut = radius * _ROUND_CORNER
    return bins.table(
        "coffee_table",
        top,
        Rectangle((0.0, 0.0), (width / 2 - cut, depth / 2 - cut)),
        [
            *joinery.rounded_boxes(width, depth, radius, low, top),
            *(bins.slab((side, side, low), place, 0.0) for place in joinery.mirror_corners(x, y)),
            bins.slab((2 * x - side, 2 * y - side, shelf_high - shelf_low), (0, 0), shelf_low),
        ],
        [
            (joinery.plate(cad.rounded_rect(width, depth, radius, 10), low, top, 0.006), wood),
            (cad.union(*frame), paint),
            (cad.union(*slats), joinery.darker(wood, 0.92)),
        ],
    )


def _ring(outer: float, inner: float, low: float, high: float) -> Manifold:
    """A flat ring around the z axis."""
    return cad.difference(
        cad.cylinder(outer, high - low, low, segments=96),
        cad.cylinder(inner, 1.0, low - 0.1, segments=96),
    )


def tray_table(vary: Draw) -> SupportAsset:
    """A butler's tray on legs: a rim all around, with a grip at each short side. The region is its floor."""
    width = vary(0.66, 0.12)
    depth = vary(0.46, 0.1)
    top = vary(0.52, 0.06)
    floor = 0.016
    wall = 0.014
    rim = vary(0.060, 0.1)
    side = 0.032
    low = top - floor
    wood = vary.color(bins.WOODS[2], *bins.WOODS)
    paint = vary.color(joinery.METALS[0], *joinery.PAINTS, spread=0.02)
    inner_x = width / 2 - wall
    inner_y = depth / 2 - wall
    grip = 0.13
    sill = 0.40 * rim
    bar_height = 0.25 * rim
    hole = cad.upright(cad.rounded_rect(grip, rim - sill - bar_height, 0.010), 2 * width)
    hole = hole.rotate((0, 0, 90)).translate((0, 0, top + (sill + rim - bar_height) / 2))
    walls = cad.difference(
        cad.box((width, depth, floor + rim), z=low), cad.box((2 * inner_x, 2 * inner_y, 1.0), z=top)
    )
    x = inner_x - 0.03
    y = inner_y - 0.03
    leg_boxes, leg_pieces = joinery.square_legs(x, y, side, low, paint)
    rails = [
        cad.box((2 * x, 0.02, 0.03), (0, s * y), h) for s in (-1, 1) for h in (low - 0.03, 0.14)
    ]
    rails += [
        cad.box((0.02, 2 * y, 0.03), (s * x, 0), h) for s in (-1, 1) for h in (low - 0.03, 0.14)
    ]
    ends: list[Box] = []
    cheek = inner_y - grip / 2
    for s in (-1, 1):
        end = s * (inner_x + wall / 2)
        ends.append(bins.slab((wall, 2 * inner_y, sill), (end, 0), top))
        ends.append(bins.slab((wall, 2 * inner_y, bar_height), (end, 0), top + rim - bar_height))
        ends += [
            bins.slab(
                (wall, cheek, rim - sill - bar_height), (end, t * (inner_y - cheek / 2)), top + sill
            )
            for t in (-1, 1)
        ]
    return bins.table(
        "tray_table",
        top,
        Rectangle((0.0, 0.0), (inner_x, inner_y)),
        [
            bins.slab((width, depth, floor), (0, 0), low),
            *(bins.slab((width, wall, rim), (0, s * (inner_y + wall / 2)), top) for s in (-1, 1)),
            *ends,
            *leg_boxes,
        ],
        [(cad.difference(walls, hole), wood), *leg_pieces, (cad.union(*rails), paint)],
    )


def trestle_table(vary: Draw) -> SupportAsset:
    """A long board on two trestles. Its whole top is the region."""
    width = vary(1.60, 0.1)
    depth = vary(0.76, 0.08)
    top = vary(0.74, 0.02)
    low = top - 0.032
    wood = vary.color(bins.WOODS[3], *bins.WOODS)
    _, boards = joinery.planks(vary, width, [depth / 4] * 4, 0.0, -depth / 2, low, top, wood)
    x = 0.34 * width
    foot = 0.42 * depth
    head = 0.10 * depth
    beam = low - 0.07
    solids = []
    boxes = []
    for sx in (-1, 1):
        solids.append(joinery.board((0.06, 0.86 * depth, 0.07), (sx * x, 0), beam, 0.004))
        boxes.append(bins.slab((0.06, 0.86 * depth, 0.07), (sx * x, 0), beam))
        solids.append(cad.box((0.03, 1.5 * foot, 0.05), (sx * x, 0), 0.19))
        boxes.append(bins.slab((0.03, foot + head - 0.05, 0.05), (sx * x, 0), 0.19))
        for sy in (-1, 1):
            for sz in (-1, 1):
                spread = sx * x + sz * 0.10
                solids.append(
                    joinery.bar(
                        (spread, sy * foot, 0.0),
                        (sx * x + sz * 0.035, sy * head, beam + 0.04),
                        0.035,
                        0.05,
                    )
                )
                boxes.append(
                    bins.slab(
                        (0.035, 0.05, beam), (sx * x + sz * 0.07, sy * (foot + head) / 2), 0.0
                    )
                )
    return bins.table(
        "trestle_table",
        top,
        Rectangle((0.0, 0.0), (width / 2, depth / 2)),
        [bins.slab((width, depth, top - low), (0, 0), low), *boxes],
        [*boards, (cad.union(*solids), vary.color(bins.WOODS[1], *joinery.PAINTS))],
    )


def picnic_table(vary: Draw) -> SupportAsset:
    """A garden table of five planks with gaps, and its two benches. The region is the table's whole top."""
    width = vary(1.60, 0.1)
    top = vary(0.74, 0.03)
    thickness = 0.038
    plank = vary(0.140, 0.05)
    gap = 0.008
    depth = 5 * plank + 4 * gap
    low = top - thickness
    wood = vary.color(bins.WOODS[1], *bins.WOODS)
    boxes, pieces = joinery.planks(vary, width, [plank] * 5, gap, -depth / 2, low, top, wood)
    seat = 0.60 * top
    seat_depth = 2 * 0.130 + gap
    near = depth / 2 + 0.11
    for start in (near, -near - seat_depth):
        bench = joinery.planks(vary, width, [0.130] * 2, gap, start, seat - thickness, seat, wood)
        boxes = boxes + bench[0]
        pieces = pieces + bench[1]
    x = 0.36 * width
    reach = near + 0.8 * seat_depth
    under = seat - thickness
    solids = []
    frame = []
    for sx in (-1, 1):
        beams = (
            ((0.04, 2 * reach, 0.09), (sx * x, 0.0), under - 0.09),
            ((0.04, 0.92 * depth, 0.07), (sx * x, 0.0), low - 0.07),
        )
        solids += [joinery.board(*beam, 0.004) for beam in beams]
        frame += [bins.slab(*beam) for beam in beams]
        for sy in (-1, 1):
            foot = sy * (near + 0.02)
            head = sy * 0.30 * depth
            place = sx * (x - 0.04)
            solids.append(joinery.bar((place, foot, 0.0), (place, head, low), 0.04, 0.10))
            frame.append(
                bins.slab(
                    (0.04, 0.10, under - 0.09),
                    (place, (foot + head) / 2 + 0.2 * (foot - head)),
                    0.0,
                )
            )
    return bins.table(
        "picnic_table",
        top,
        Rectangle((0.0, 0.0), (width / 2, depth / 2)),
        [*boxes, *frame],
        [*pieces, (cad.union(*solids), joinery.darker(wood, 0.85))],
    )
