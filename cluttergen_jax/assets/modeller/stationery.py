"""Paper and tools of the desk: book, sticky notes, binder, stapler, tape dispenser, hole punch, scissors."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller.draw import (
    BLACK,
    BLUE,
    BRIGHT,
    CHARCOAL,
    CREAM,
    CRIMSON,
    DARK,
    FOREST,
    GOLD,
    GREY,
    MUTED,
    NAVY,
    PAPER,
    PINK,
    RED,
    SKY,
    STEEL,
    TEAL,
    WHITE,
    YELLOW,
    Draw,
    assemble,
)
from cluttergen_jax.assets.modeller.solids import (
    box,
    cylinder,
    difference,
    ellipse,
    extrude,
    facing,
    hull,
    lettering,
    rounded_rect,
    union,
    upright,
)
from cluttergen_jax.assets.shape import Shape

BOARD = 0.003


def hardback_book(vary: Draw) -> Shape:
    """A closed book lying on its back cover, its rounded spine towards -y."""
    width = vary(0.215, 0.12)
    depth = vary(0.150, 0.12)
    height = vary(0.034, 0.35)
    turns = np.linspace(-np.pi / 2, np.pi / 2, 9)
    arc = np.column_stack([-depth / 2 - 0.005 * np.cos(turns), height / 2 * (1 + np.sin(turns))])
    rounded = [(x, y, z) for y, z in arc for x in (-width / 2, width / 2)]
    boards = [box((width, depth, BOARD), z=z) for z in (0.0, height - BOARD)]
    cover = union(*boards, hull([*rounded, *[(x, -depth / 2 + 0.001, z) for x, _, z in rounded]]))
    pages = box((width - 0.010, depth - 0.008, height - 2 * BOARD), (0, 0.002), BOARD)
    corners = [
        (x * width, y * depth, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, height)
    ]
    title = _cover_art(vary.choose("ATLAS", "FABLES", "DUNES", "TALES"), width, depth, height)
    return assemble(
        pieces=(
            (cover, vary.color(NAVY, *MUTED)),
            (pages - cover, vary.color(PAPER, spread=0.03)),
            (title, vary.color(GOLD, CREAM, STEEL)),
        ),
        parts=(part.hull(rounded[::4], rounded[1::4], corners),),
        mass=720.0 * width * depth * height,
    )


def _cover_art(word: str, width: float, depth: float, height: float) -> Manifold:
    """A framed title on the front cover and bands across the spine."""
    size = (width * 0.84, depth * 0.80)
    frame = box((*size, 0.0012), z=-0.0006) - box(
        (size[0] - 0.006, size[1] - 0.006, 0.01), z=-0.005
    )
    front = union(frame, lettering(word, 0.17 * depth).translate((0, 0.10 * depth, 0)))
    front += box((0.3 * width, 0.004, 0.0012), (0, -0.18 * depth), -0.0006)
    spine = [
        box((0.004, 0.0030, 0.8 * height), (x * width, -depth / 2 - 0.0035), 0.1 * height)
        for x in (-0.40, -0.36, 0.36, 0.40)
    ]
    word_height = min(0.42 * height, 0.02)
    words = lettering(word, word_height).rotate((90, 0, 0))
    spine.append(words.translate((0, -depth / 2 - 0.0047, height / 2)))
    return union(front.translate((0, 0, height)), *spine)


def sticky_notes(vary: Draw) -> Shape:
    """A stack of pads in three colours, its top sheet written on and curling up."""
    side = vary(0.076, 0.12)
    height = vary(0.042, 0.25)
    cuts = np.array([0.0, 0.30, 0.62, 1.0]) * height
    colors = [YELLOW, PINK, SKY]
    if vary.rng:
        colors = [BRIGHT[k] for k in vary.rng.permutation(len(BRIGHT))[:3]]
    # The lower pads are bands around one block: surfaces inside a body would be sampled as if they were seen.
    core = (side - 0.002, side - 0.002, 1.0)
    pads = [
        (box((side, side, high - low), z=low) - box(core, z=low - 0.1), color)
        for low, high, color in zip(cuts[:2], cuts[1:3], colors[1:], strict=True)
    ]
    block = union(box((*core[:2], height)), box((side, side, height - cuts[2]), z=cuts[2]))
    note = lettering("TO DO", 0.16 * side).translate((0, 0.24 * side, 0))
    for k, length in enumerate((0.62, 0.52, 0.58)):
        row = (0.06 - 0.15 * k) * side
        note += box((length * side, 0.0022, 0.0012), ((length - 0.74) * side / 2, row), -0.0006)
    return assemble(
        pieces=(
            (block, colors[0]),
            *pads,
            (_curled_sheet(side).translate((0, 0, height)), colors[0]),
            (note.translate((0, 0.02 * side, height)), NAVY),
        ),
        parts=(part.box((side, side, height)), _curl_part(side, height)),
        mass=700.0 * side * side * height,
    )


CURL = 0.052


def _curled_sheet(side: float) -> Manifold:
    """The front edge of a sheet that bends up from z = 0, as wide as the block."""
    share = np.linspace(0.0, 1.0, 7)
    y = -(0.26 + 0.24 * share) * side
    z = CURL * share**2 * side
    strips = []
    for k in range(6):
        edges = [(y[k + j], z[k + j] + up) for j in (0, 1) for up in (-0.0002, 0.0010)]
        strips.append(hull([(x, *edge) for x in (-side / 2, side / 2) for edge in edges]))
    return union(*strips)


def _curl_part(side: float, height: float) -> Mesh:
    """A flat leaf along the curled edge, thick enough to be felt."""
    ends = ((-0.30, 0.0, -0.001), (-0.30, 0.0, 0.001), (-0.5, CURL, -0.001), (-0.5, CURL, 0.001))
    return part.hull(
        [(s * side / 2, y * side, height + z * side + up) for s in (-1, 1) for y, z, up in ends]
    )


def ring_binder(vary: Draw) -> Shape:
    """A lever-arch file standing upright, its labelled spine towards -y."""
    height = vary(0.250, 0.08)
    depth = vary(0.205, 0.08)
    width = vary(0.066, 0.2)
    hole = 0.20 * height
    spine = difference(
        box((width, 0.004, height), (0, -depth / 2 + 0.002)),
        cylinder(0.013, 0.02, -0.01).rotate((90, 0, 0)).translate((0, -depth / 2, hole)),
    )
    sides = [box((BOARD, depth, height), (s * (width - BOARD) / 2, 0)) for s in (-1, 1)]
    pages_size = (width - 2 * BOARD - 0.006, depth - 0.030, height - 0.018)
    pages = box(pages_size, (0, 0.008), 0.006)
    ring = cylinder(0.016, 0.004, segments=32) - cylinder(0.011, 0.02, -0.01, segments=32)
    arch = [
        cylinder(0.002, 0.020, center=(x, 0.055), z=0.006 + pages_size[2] - 0.008, segments=12)
        for x in (-0.25 * width, 0.25 * width)
    ]
    front = -depth / 2 - 0.001
    label = box((0.68 * width, 0.0016, 0.42 * height), (0, front + 0.0008), 0.46 * height)
    words = lettering("FILE", 0.13 * width).rotate((90, 0, 0)).translate((0, front, 0.79 * height))
    lines = [box((0.5 * width, 0.001, 0.003), (0, front), z * height) for z in (0.54, 0.61, 0.68)]
    return assemble(
        pieces=(
            (
                union(spine, *sides),
                vary.color(CRIMSON, NAVY, FOREST, *BRIGHT[:3], CHARCOAL),
            ),
            (pages, PAPER),
            (
                union(ring.rotate((90, 0, 0)).translate((0, -depth / 2 + 0.002, hole)), *arch),
                STEEL,
            ),
            (label, WHITE),
            (union(words, *lines), CHARCOAL),
        ),
        parts=(
            part.box((width, 0.004, height), (0, -depth / 2 + 0.002)),
            *[part.box((BOARD, depth, height), (s * (width - BOARD) / 2, 0)) for s in (-1, 1)],
            part.box(pages_size, (0, 0.008), 0.006),
        ),
        mass=vary(0.9, 0.2),
    )


TAPE = (0.93, 0.86, 0.62)


def stapler(vary: Draw) -> Shape:
    """A desk stapler, its jaws towards -x."""
    length = vary(0.150, 0.12)
    width = vary(0.034, 0.12)
    low = 0.010 + vary(0.012, 0.25)
    high = 0.016
    tail = length / 2
    nose = -length / 2
    heel = length / 2 - 0.034
    base = [
        (nose, 0),
        (tail, 0),
        (tail, 0.006),
        (tail - 0.006, 0.010),
        (nose + 0.010, 0.010),
        (nose, 0.006),
    ]
    pivot = [(heel, 0.009), (tail - 0.006, 0.009), (tail - 0.008, 0.027), (heel, 0.0275)]
    rail = [
        (nose + 0.004, low),
        (heel + 0.002, high),
        (heel + 0.002, high + 0.012),
        (nose + 0.004, low + 0.012),
    ]
    lid = [
        (nose, low + 0.010),
        (tail - 0.004, high + 0.0105),
        (tail, high + 0.016),
        (tail - 0.006, high + 0.025),
    ]
    lid += [(nose + 0.035, low + 0.030), (nose + 0.010, low + 0.026), (nose, low + 0.018)]
    anvil = box((0.022, 0.6 * width, 0.002), (nose + 0.018, 0), 0.0092)
    metal = union(upright(pivot, 0.36 * width), anvil, upright(rail, 0.7 * width))
    return assemble(
        pieces=(
            (upright(base, width + 0.004), vary.color(CHARCOAL, BLACK, GREY)),
            (metal, STEEL),
            (upright(lid, width), vary.color(RED, TEAL, *BRIGHT, CHARCOAL)),
        ),
        parts=(
            part.upright(base, width + 0.004),
            part.upright(pivot, 0.36 * width),
            part.upright(rail, 0.7 * width),
            part.upright(lid, width),
        ),
        mass=vary(0.28, 0.2),
    )


def tape_dispenser(vary: Draw) -> Shape:
    """A weighted tape dispenser, its cutter towards -x."""
    length = vary(0.150, 0.1)
    width = vary(0.058, 0.1)
    roll = vary(0.036, 0.08)
    nose = -length / 2
    tail = length / 2
    base = [
        (nose + 0.004, 0),
        (tail, 0),
        (tail, 0.012),
        (tail - 0.006, 0.018),
        (nose + 0.012, 0.018),
    ]
    base.append((nose, 0.010))
    post = [(nose, 0.010), (nose + 0.036, 0.012), (nose + 0.024, 0.046), (nose + 0.006, 0.050)]
    hub = (tail - roll - 0.016, roll + 0.010)
    turns = np.linspace(0, np.pi, 7)
    cheek = [(hub[0] - 0.040, 0.012), (hub[0] + 0.038, 0.012)]
    cheek += list(zip(hub[0] + 0.022 * np.cos(turns), hub[1] + 0.016 * np.sin(turns), strict=True))
    side = width / 2 - 0.005
    slot = 2 * (side - 0.0048)
    # The roll is solid but for a recess on either side, where its core shows above the cheeks.
    cover = upright(cheek, 1.0)
    recesses = [
        facing(roll - 0.010, 0.004, hub).translate((0, s * slot / 2, 0)) - cover for s in (-1, 1)
    ]
    core = facing(roll - 0.0095, slot - 0.002, hub) - facing(roll - 0.014, 1.0, hub) - cover
    spool = difference(facing(roll, slot, hub), *recesses)
    cheeks = [upright(cheek, 0.010, s * side) for s in (-1, 1)]
    frame = union(upright(base, width), upright(post, slot + 0.006), *cheeks)
    # The tape's free end runs from the roll to the teeth; its part is thicker, below.
    ends = ((nose + 0.015, 0.0495), (hub[0] - 0.2 * roll, hub[1] + 0.97 * roll))
    strip, tongue = (
        [(x, z + t) for x, z in ends for t in (below, 0.0003)] for below in (-0.0003, -0.0025)
    )
    tooth = [(x, s * 0.002, z) for x, z in ((0.003, 0.047), (0.010, 0.050)) for s in (-1, 1)]
    comb = hull([*tooth, (0.001, 0, 0.054)])
    teeth = [comb.translate((nose, float(y), 0)) for y in np.linspace(-0.4, 0.4, 9) * slot]
    ribbon = hull(part.upright(strip, 0.72 * slot).vertices)
    return assemble(
        pieces=(
            (frame, vary.color(CHARCOAL, *DARK, *BRIGHT)),
            (union(spool, ribbon), TAPE),
            (core, WHITE),
            (union(*teeth), STEEL),
        ),
        parts=(
            part.upright(base, width),
            part.upright(post, slot + 0.006),
            part.facing(roll, slot, 14, hub),
            *[part.upright(cheek, 0.010, s * side) for s in (-1, 1)],
            part.upright(tongue, 0.72 * slot),
        ),
        mass=vary(0.75, 0.2),
    )


def hole_punch(vary: Draw) -> Shape:
    """A two-hole punch on a punched sheet, its paper slot towards -y."""
    width = vary(0.118, 0.1)
    depth = vary(0.104, 0.1)
    rise = vary(0.060, 0.1)
    tray = extrude(rounded_rect(width, depth, 0.010), 0.012)
    back = depth / 2 - 0.012
    front = -depth / 2 + 0.034
    bar = ((0.86 * width, 0.030, 0.016), (0, back - 0.019), 0.020)
    wall = ((0.86 * width, 0.014, 0.026), (0, back - 0.008), 0.010)
    # From the hinge forward: half width, y and the two heights of the lever.
    profile: list[tuple[float, ...]] = [(0.92, back + 0.006, 0.030, 0.042)]
    profile += [
        (0.90, front + 0.008, rise, rise + 0.009),
        (0.66, front - 0.008, rise + 0.001, rise + 0.008),
    ]
    lever = [
        (s * w * width / 2, y, z) for s in (-1, 1) for w, y, *levels in profile for z in levels
    ]
    lid = hull(lever)
    places = [s * 0.30 * width for s in (-1, 1)]
    pins = [cylinder(0.0075, 0.026, z=0.018, center=(x, back - 0.030), segments=24) for x in places]
    rests = [box((0.008, 0.034, 0.026), (s * 0.45 * width, back - 0.014), 0.010) for s in (-1, 1)]
    holes = [cylinder(0.0055, 1.0, center=(x, -0.36 * depth), segments=24) for x in places]
    sheet = difference(box((0.80 * width, 0.84 * depth, 0.0015), (0, -0.07 * depth), 0.012), *holes)
    metal = union(box(*bar), box(*wall), *pins, *rests) - lid - tray
    return assemble(
        pieces=(
            (tray, vary.color(CHARCOAL, BLACK, GREY)),
            (metal, STEEL),
            (sheet - metal, WHITE),
            (lid, vary.color(BLUE, *BRIGHT, CHARCOAL)),
        ),
        parts=(part.box((width, depth, 0.012)), part.box(*bar), part.box(*wall), part.hull(lever)),
        mass=vary(0.38, 0.2),
    )


def scissors(vary: Draw) -> Shape:
    """A pair of scissors lying a little open, points towards +y."""
    size = vary(1.0, 0.12)
    opening = vary(8.0, 0.4)
    blade = 0.001 * size * np.array([(-8, -12), (8, -12), (8, 20), (0.5, 100), (-2, 100), (-8, 24)])
    loop = np.array([0.021, 0.029]) * size
    bar = 0.0075
    thick = 0.009
    ring = extrude(ellipse(*loop), thick) - extrude(ellipse(*(loop - bar)), 1.0, -0.5)
    inner = 1 - bar / loop[0]
    section = [(1.10, 0), (1.10, thick), (inner, thick), (inner, 0)]
    stretch = np.diag([*loop, 1.0])
    cells = [cell.transform(stretch) for cell in part.ring_sectors(section, 4, np.pi / 4)]
    grips = []
    blades = []
    parts = []
    for side, z in ((-1, 0.0), (1, 0.003)):
        turn = (0.0, 0.0, side * opening)
        spin = (0.0, 0.0, -side * 14.0)
        outline = blade * (side, 1)
        blades.append(extrude(outline, 0.003, z).rotate(turn))
        # Each blade runs on through the pivot into the loop of the other side.
        center = np.array([side * 0.025, -0.072]) * size
        roots = (
            np.array([(8, -8), (-8, -8), (side * 25 - 10, -42), (side * 25 + 10, -46)])
            * 0.001
            * size
        )
        grips += [
            ring.rotate(spin).translate((*center, 0)),
            hull(part.prism(roots, thick).vertices),
        ]
        parts += [part.rotate_part(part.prism(outline, 0.003, z), turn), part.prism(roots, thick)]
        parts += [part.rotate_part(cell, spin, (*center, 0.0)) for cell in cells]
    handles = union(*grips)
    steel = union(*blades, cylinder(0.0045 * size, 0.0085, segments=24))
    return assemble(
        pieces=(
            (handles, vary.color(RED, *BRIGHT, CHARCOAL)),
            (steel - handles, STEEL),
        ),
        parts=tuple(parts),
        mass=vary(0.075, 0.2),
    )
