"""Tables of boards: tray, trestle, picnic."""

from __future__ import annotations

from cluttergen_jax.assets.modeller import joinery
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, shade, vary
from cluttergen_jax.assets.support import Box, Rectangle, SupportAsset


def tray_table(rng: Rng = None) -> SupportAsset:
    """A butler's tray on legs: a rim all around, with a grip at each short side. The region is its floor."""
    width, depth, top = vary(rng, 0.66, 0.12), vary(rng, 0.46, 0.1), vary(rng, 0.52, 0.06)
    floor, wall, rim, side = 0.016, 0.014, vary(rng, 0.060, 0.1), 0.032
    low = top - floor
    wood, paint = (
        shade(rng, (joinery.WOODS[2], *joinery.WOODS)),
        shade(rng, (joinery.METALS[0], *joinery.PAINTS), 0.02),
    )
    inner_x, inner_y = width / 2 - wall, depth / 2 - wall
    grip, sill, bar_height = 0.13, 0.40 * rim, 0.25 * rim
    hole = cad.upright(cad.rounded_rect(grip, rim - sill - bar_height, 0.010), 2 * width)
    hole = hole.rotate((0, 0, 90)).translate((0, 0, top + (sill + rim - bar_height) / 2))
    walls = cad.difference(
        cad.box((width, depth, floor + rim), z=low), cad.box((2 * inner_x, 2 * inner_y, 1.0), z=top)
    )
    x, y = inner_x - 0.03, inner_y - 0.03
    leg_boxes, leg_pieces = joinery.square_legs(x, y, side, low, paint)
    rails = [cad.box((2 * x, 0.02, 0.03), (0, s * y), h) for s in (-1, 1) for h in (low - 0.03, 0.14)]
    rails += [cad.box((0.02, 2 * y, 0.03), (s * x, 0), h) for s in (-1, 1) for h in (low - 0.03, 0.14)]
    ends: list[Box] = []
    cheek = inner_y - grip / 2
    for s in (-1, 1):
        end = s * (inner_x + wall / 2)
        ends.append(joinery.slab((wall, 2 * inner_y, sill), (end, 0), top))
        ends.append(joinery.slab((wall, 2 * inner_y, bar_height), (end, 0), top + rim - bar_height))
        ends += [
            joinery.slab((wall, cheek, rim - sill - bar_height), (end, t * (inner_y - cheek / 2)), top + sill)
            for t in (-1, 1)
        ]
    return joinery.table(
        "tray_table",
        top,
        Rectangle((0.0, 0.0), (inner_x, inner_y)),
        [
            joinery.slab((width, depth, floor), (0, 0), low),
            *(joinery.slab((width, wall, rim), (0, s * (inner_y + wall / 2)), top) for s in (-1, 1)),
            *ends,
            *leg_boxes,
        ],
        [cad.piece(cad.difference(walls, hole), wood), *leg_pieces, cad.piece(cad.union(*rails), paint)],
    )


def trestle_table(rng: Rng = None) -> SupportAsset:
    """A long board on two trestles. Its whole top is the region."""
    width, depth, top = vary(rng, 1.60, 0.1), vary(rng, 0.76, 0.08), vary(rng, 0.74, 0.02)
    low, wood = top - 0.032, shade(rng, (joinery.WOODS[3], *joinery.WOODS))
    _, boards = joinery.planks(rng, width, [depth / 4] * 4, 0.0, -depth / 2, low, top, wood)
    x, foot, head = 0.34 * width, 0.42 * depth, 0.10 * depth
    beam = low - 0.07
    solids, boxes = [], []
    for sx in (-1, 1):
        solids.append(joinery.board((0.06, 0.86 * depth, 0.07), (sx * x, 0), beam, 0.004))
        boxes.append(joinery.slab((0.06, 0.86 * depth, 0.07), (sx * x, 0), beam))
        solids.append(cad.box((0.03, 1.5 * foot, 0.05), (sx * x, 0), 0.19))
        boxes.append(joinery.slab((0.03, foot + head - 0.05, 0.05), (sx * x, 0), 0.19))
        for sy in (-1, 1):
            for sz in (-1, 1):
                spread = sx * x + sz * 0.10
                solids.append(
                    joinery.bar(
                        (spread, sy * foot, 0.0), (sx * x + sz * 0.035, sy * head, beam + 0.04), 0.035, 0.05
                    )
                )
                boxes.append(
                    joinery.slab((0.035, 0.05, beam), (sx * x + sz * 0.07, sy * (foot + head) / 2), 0.0)
                )
    return joinery.table(
        "trestle_table",
        top,
        Rectangle((0.0, 0.0), (width / 2, depth / 2)),
        [joinery.slab((width, depth, top - low), (0, 0), low), *boxes],
        [*boards, cad.piece(cad.union(*solids), shade(rng, (joinery.WOODS[1], *joinery.PAINTS)))],
    )


def picnic_table(rng: Rng = None) -> SupportAsset:
    """A garden table of five planks with gaps, and its two benches. The region is the table's whole top."""
    width, top, thickness = vary(rng, 1.60, 0.1), vary(rng, 0.74, 0.03), 0.038
    plank, gap = vary(rng, 0.140, 0.05), 0.008
    depth = 5 * plank + 4 * gap
    low, wood = top - thickness, shade(rng, (joinery.WOODS[1], *joinery.WOODS))
    boxes, pieces = joinery.planks(rng, width, [plank] * 5, gap, -depth / 2, low, top, wood)
    seat, seat_depth = 0.60 * top, 2 * 0.130 + gap
    near = depth / 2 + 0.11
    for start in (near, -near - seat_depth):
        bench = joinery.planks(rng, width, [0.130] * 2, gap, start, seat - thickness, seat, wood)
        boxes, pieces = boxes + bench[0], pieces + bench[1]
    x, reach = 0.36 * width, near + 0.8 * seat_depth
    under = seat - thickness
    solids, frame = [], []
    for sx in (-1, 1):
        beams = (
            ((0.04, 2 * reach, 0.09), (sx * x, 0.0), under - 0.09),
            ((0.04, 0.92 * depth, 0.07), (sx * x, 0.0), low - 0.07),
        )
        solids += [joinery.board(*beam, 0.004) for beam in beams]
        frame += [joinery.slab(*beam) for beam in beams]
        for sy in (-1, 1):
            foot, head = sy * (near + 0.02), sy * 0.30 * depth
            place = sx * (x - 0.04)
            solids.append(joinery.bar((place, foot, 0.0), (place, head, low), 0.04, 0.10))
            frame.append(
                joinery.slab(
                    (0.04, 0.10, under - 0.09), (place, (foot + head) / 2 + 0.2 * (foot - head)), 0.0
                )
            )
    return joinery.table(
        "picnic_table",
        top,
        Rectangle((0.0, 0.0), (width / 2, depth / 2)),
        [*boxes, *frame],
        [*pieces, cad.piece(cad.union(*solids), joinery.darker(wood, 0.85))],
    )
