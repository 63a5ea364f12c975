"""Containers: bottle, can, jar, boxes and cartons of food; pencil cup, pen holder, letter tray."""

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
    DARK,
    DARK_WOOD,
    GREY,
    PAPER,
    RED,
    TEAL,
    WHITE,
    WOOD,
    YELLOW,
    Draw,
    assemble,
    hex_colors,
    hex_rgb,
)
from cluttergen_jax.assets.modeller.solids import (
    Painted,
    Rgb,
    box,
    difference,
    ellipse,
    hull,
    lathe,
    pipe,
    revolve,
    rounded_rect,
    sweep,
    to_mesh,
    union,
    upright,
)
from cluttergen_jax.assets.modeller.vessel import Crate, Vessel
from cluttergen_jax.assets.shape import Cavity, Shape

BOTTLE_GLASS = hex_colors("2f5d3a 6b3f1d 1f3b2c 7f9a4a 2b4a6b")
CAPS = hex_colors("8e1f2b c9a13b 20242b 2d5aa0")
LABELS = hex_colors("c8322b d98e1f 2f7d4f 2e5fa3 7d3f8c e0c23c")
LABEL_PAPER = hex_rgb("f2ead8")
TIN = hex_rgb("c3c7cb")
LIDS = (*hex_colors("c9a13b 8e1f2b 3f6f4f"), TIN)
FILLINGS = hex_colors("a3202f d9822b 5b2a4f 8a5a2b 6f8f3a")


def bottle(vary: Draw) -> Shape:
    """A closed wine bottle with a label and a foil cap."""
    radius = vary(0.037, 0.1)
    height = vary(0.295, 0.12)
    shoulder = height * vary(0.60, 0.1)
    neck = vary(0.0142, 0.08)
    top = shoulder + vary(0.20, 0.2) * height
    bend = [(0.97, 0.16), (0.88, 0.36), (0.68, 0.60), (0.50, 0.80)]
    curve = [
        (neck + (radius - neck) * (r - 0.4) / 0.6, shoulder + (top - shoulder) * z) for r, z in bend
    ]
    body = [
        (radius - 0.003, 0.0),
        (radius, 0.004),
        (radius, shoulder),
        *curve,
        (neck, top),
        (neck, height),
    ]
    foil_foot = top + 0.25 * (height - top)
    foil = _sleeve(neck, foil_foot, height - 0.001, 0.0008)
    low = 0.14 * height
    high = shoulder - 0.05 * height
    return assemble(
        label="wine bottle",
        pieces=(
            (lathe(body), vary.color(*BOTTLE_GLASS, spread=0.03)),
            (foil, cap := vary.color(*CAPS, spread=0.03)),
            (_sleeve(radius, low, high), LABEL_PAPER),
            (_sleeve(radius, low + 0.25 * (high - low), low + 0.45 * (high - low), 0.0008), cap),
        ),
        parts=(
            part.disc([(radius, 0.0), (radius, shoulder)], 12, is_standing=True),
            part.disc([(radius, shoulder - 0.002), curve[1], (neck, top)], 8),
            part.disc([(neck, top - 0.002), (neck, height)], 8),
        ),
        mass=vary(1.20, 0.1),
    )


def soup_can(vary: Draw) -> Shape:
    """A closed tin can with a two-coloured paper label and a medallion band."""
    radius = vary(0.034, 0.2)
    height = vary(0.102, 0.2)
    rim = 0.0014
    lip = 0.0035
    tin = [
        (radius - 0.001, 0.0),
        (radius + rim, 0.0008),
        (radius + rim, lip),
        (radius, lip + 0.001),
    ]
    tin += [
        (radius, height - lip - 0.001),
        (radius + rim, height - lip),
        (radius + rim, height - 0.0008),
    ]
    tin += [(radius - 0.001, height), (radius - 0.002, height - 0.003)]
    low = lip + 0.002
    high = height - lip - 0.002
    middle = low + vary.within(0.52, 0.35, 0.65) * (high - low)
    band = 0.07 * (high - low)
    color = vary.color(*LABELS)
    return assemble(
        pieces=(
            (lathe(tin), TIN),
            (_sleeve(radius, middle + band, high), color),
            (_sleeve(radius, middle - band, middle + band), hex_rgb("d8b354")),
            (_sleeve(radius, low, middle - band), LABEL_PAPER),
        ),
        parts=(part.disc([(radius + rim, 0.0), (radius + rim, height)], 12, is_standing=True),),
        mass=vary(0.35, 0.2) * (radius / 0.034) ** 2,
    )


def jar(vary: Draw) -> Shape:
    """A filled glass jar with a screw lid."""
    radius = vary(0.040, 0.2)
    height = vary(0.110, 0.25)
    lid = vary(0.016)
    neck = radius * vary(0.88, 0.06)
    shoulder = height - lid - 0.014
    outer = [
        (radius - 0.004, 0.0),
        (radius, 0.004),
        (radius, shoulder),
        (neck - 0.002, shoulder + 0.012),
    ]
    body = lathe([*outer, (neck - 0.002, height - 0.002)])
    level = shoulder * vary.within(0.90, 0.82, 0.95)
    # The glass above the jam is a skin: a surface inside the body would count as a part of its outside.
    rising = [(radius, level), (radius, shoulder), (neck - 0.002, shoulder + 0.012)]
    skin = lathe([(r + 0.0003, z) for r, z in rising])
    low = 0.24 * shoulder
    high = 0.78 * shoulder
    ribs = [
        (neck + 0.0005 * (k % 2), height - lid + 0.002 + (lid - 0.005) * k / 8) for k in range(9)
    ]
    cap = lathe([(neck, height - lid), *ribs, (neck - 0.002, height)])
    return assemble(
        label="jar with a lid",
        pieces=(
            (body, color := vary.color(*FILLINGS)),
            (difference(skin, body), hex_rgb("dfeaea"), 0.6),
            (difference(cap, body), vary.choose(*LIDS)),
            (_sleeve(radius, low, high), LABEL_PAPER),
            *((_sleeve(radius, z, z + 0.0024, 0.0008), color) for z in (low + 0.004, high - 0.006)),
        ),
        parts=(
            part.disc([(radius, 0.0), (radius, shoulder)], 12, is_standing=True),
            part.disc([(radius, shoulder - 0.002), (neck, height - lid - 0.001)], 12),
            part.disc([(neck, height - lid - 0.003), (neck, height)], 12),
        ),
        mass=vary(0.45, 0.15) * (radius / 0.040) ** 2 * (height / 0.110),
    )


def _sleeve(radius: float, low: float, high: float, thickness: float = 0.0005) -> Manifold:
    """A thin ring around a cylinder, such as a label; its foot lies just inside the surface."""
    return pipe(radius - 0.0003, radius + thickness, low, high)


PRINTS = hex_colors("e2a21f c8322b 2e7d4f 2e5fa3 7d3f8c d95f8a")
ACCENTS = hex_colors("b3261e 1f3f7a 14532d 4a1d5e")
PRINT_CREAM = hex_rgb("f6efdf")


def cereal_box(vary: Draw) -> Shape:
    """A tall carton with a title and a bowl of flakes printed on its -y face."""
    width = vary(0.160)
    depth = vary(0.058)
    height = vary(0.225)
    accent = vary.color(*ACCENTS)
    flap = box((0.30 * width, 0.30 * depth, 0.0008), z=height - 0.0002)
    return assemble(
        pieces=(
            (box((width, depth, height)), vary.color(*PRINTS)),
            *_breakfast(vary, width, height, -depth / 2, accent),
            (union(box((0.98 * width, 0.0012, 0.0006), z=height - 0.0002), flap), accent),
        ),
        parts=(part.box((width, depth, height)),),
        mass=vary(0.38, 0.2),
    )


def _breakfast(vary: Draw, width: float, height: float, face: float, accent: Rgb) -> list[Painted]:
    """The print of a cereal box: a title panel, a bowl, milk and flakes."""
    place = np.array([0.0, 0.34 * height])
    high = np.array([0.0, 0.82 * height])
    title = rounded_rect(0.84 * width, 0.20 * height, 0.05 * height) + high
    letters = [
        rounded_rect(0.075 * width, size * height, 0.01 * height)
        + high
        + np.array([x * width, 0.0])
        for x, size in zip(
            np.linspace(-0.30, 0.30, 6), (0.11, 0.08, 0.08, 0.11, 0.08, 0.08), strict=True
        )
    ]
    reach = 0.36 * width
    turns = np.linspace(np.pi, 2 * np.pi, 24)
    dish = np.stack([reach * np.cos(turns), 0.85 * reach * np.sin(turns)], -1) + place
    lifts = (vary.rng or np.random.default_rng(7)).uniform(0.006, 0.054, 7)
    spots = np.stack([np.linspace(-0.75, 0.75, 7) * reach, lifts * height], -1) + place
    flake = ellipse(0.055 * width, 0.038 * width, 12)
    return [
        (upright(title, 0.0006, face), accent),
        *((upright(letter, 0.0012, face), PRINT_CREAM) for letter in letters),
        (upright(ellipse(reach, 0.16 * reach, 32) + place, 0.0008, face), PRINT_CREAM),
        (upright(dish, 0.0006, face), hex_rgb("3d6fb5")),
        *((upright(flake + spot, 0.0012, face), hex_rgb("b5651d")) for spot in spots),
    ]


def milk_carton(vary: Draw) -> Shape:
    """A gable-top carton with a screw cap; its ridge runs along x."""
    side = vary(0.070, 0.12)
    height = vary(0.205)
    eaves = 0.76 * height
    fin = 0.075 * height
    ridge = height - fin
    half = side / 2
    thin = 0.0018
    right = [(half, 0.0), (half, eaves), (thin, ridge)]
    left = [(-y, z) for y, z in reversed(right)]
    carton = upright([*right, (thin, height), (-thin, height), *left], side).rotate((0, 0, 90))
    color = vary.color(*PRINTS[3:] + PRINTS[:3])
    stripe = box((side + 0.0006, side + 0.0006, 0.22 * height), z=0.06 * height)
    slope = np.degrees(np.arctan2(ridge - eaves, half - thin))
    screw = upright(ellipse(0.16 * side, 0.16 * side, 24), 0.012, 0.0)
    screw = screw.rotate((slope - 90, 0, 0)).translate((0, -half / 2, (eaves + ridge) / 2))
    gable = [(x, y, z) for x in (-half, half) for y, z in (*right, *left)]
    return assemble(
        pieces=(
            (carton, hex_rgb("f3f3ee")),
            (stripe - carton, color),
            (
                upright(_drop(0.15 * side) + np.array([0.0, 0.46 * height]), 0.0006, -half),
                color,
            ),
            (screw - carton, color),
        ),
        parts=(part.hull(gable), part.box((side, 2 * thin, fin + 0.002), z=ridge - 0.002)),
        mass=vary(1.03, 0.05) * (side / 0.070) ** 2 * (height / 0.205),
    )


def _drop(radius: float) -> np.ndarray:
    """The outline of a falling drop, its round end around the origin, f64[25, 2]."""
    turns = np.linspace(0.85 * np.pi, 2.15 * np.pi, 24)
    return np.concatenate(
        [radius * np.stack([np.cos(turns), np.sin(turns)], -1), [(0.0, 2.4 * radius)]]
    )


RAW_WOOD = (0.90, 0.76, 0.55)

# A box's size, its centre in the plane and the height it stands on.
Block = tuple[tuple[float, float, float], tuple[float, float], float]


def pencil_cup(vary: Draw) -> Shape:
    """A round cup with two pencils that lean on its rim."""
    foot = vary(0.036, 0.1)
    rim = vary(0.041, 0.1)
    height = vary(0.100, 0.12)
    cup = Vessel([(foot, 0.0), (rim, height)], [(foot - 0.003, 0.005), (rim - 0.003, height)])
    levels = [
        (0.62 * height, 0.0007),
        (0.78 * height, 0.0007),
        (0.78 * height, -0.001),
        (0.62 * height, -0.001),
    ]
    band = revolve([(cup.outer_radius(z) + out, z) for z, out in levels])
    pieces = [
        (cup.solid(), vary.color(TEAL, *BRIGHT, CHARCOAL)),
        (band, WHITE),
    ]
    parts = list(cup.parts(8))
    for angle, length, color in ((5.0, 0.165, YELLOW), (1.9, 0.150, RED)):
        start = _around(angle + vary(0.5, 0.5), foot - 0.010, 0.0068)
        along = _around(angle, rim - 0.0085, height) - start
        solids, core = _pencil(
            start,
            along / np.linalg.norm(along),
            vary(length, 0.1),
            vary.color(color, *BRIGHT),
        )
        pieces += solids
        parts.append(core)
    return assemble(
        pieces=tuple(pieces),
        parts=tuple(parts),
        cavity=cup.cavity(),
        mass=vary(0.22, 0.2),
    )


def _around(angle: float, radius: float, z: float) -> np.ndarray:
    return np.array([radius * np.cos(angle), radius * np.sin(angle), z])


def _pencil(
    start: np.ndarray, end: np.ndarray, length: float, color: Rgb
) -> tuple[list[tuple[Manifold, Rgb]], Mesh]:
    """A sharpened pencil of a given length from `start` towards `end`, and its part."""
    along = (end - start) / np.linalg.norm(end - start)
    stations = [start + along * s for s in (0.0, length - 0.022, length - 0.006, length)]
    outline = ellipse(0.004, 0.004, 6)
    pieces = [
        (sweep(stations[:2], outline), color),
        (sweep(stations[1:3], outline, scales=[1.0, 0.35]), RAW_WOOD),
        (sweep(stations[2:], outline, scales=[0.35, 0.1]), BLACK),
    ]
    cells = part.sweep([stations[0], stations[1], stations[3]], outline, scales=[1.0, 1.0, 0.1])
    return pieces, part.hull(*[cell.vertices for cell in cells])


def pen_holder(vary: Draw) -> Shape:
    """A box in two compartments; two pens and a ruler stand in the smaller one."""
    crate = Crate(vary(0.108, 0.12), vary(0.076, 0.1), vary(0.098, 0.12), 0.004, 0.005)
    shelf = 0.16 * crate.width
    wall = ((0.003, crate.depth - 0.006, 0.86 * crate.height), (shelf, 0), 0.002)
    left = shelf + 0.0035
    right = crate.width / 2 - 0.006
    stripe = [box((crate.width + 0.001, crate.depth + 0.001, 0.010), z=0.80 * crate.height)]
    stripe.append(stripe[0] - box((crate.width - 0.001, crate.depth - 0.001, 1.0)))
    pieces = [
        (
            crate.solid() + box(*wall),
            vary.color(CHARCOAL, *DARK, *BRIGHT, WOOD),
        ),
        (stripe[1], vary.color(GREY, WHITE, YELLOW)),
    ]
    parts = [*crate.parts(), part.box(*wall)]
    top = crate.height + vary(0.048, 0.2)
    for y, drift, color in ((-0.30, -0.10, BLUE), (-0.08, 0.04, RED)):
        start = np.array([right - 0.004, y * crate.depth, crate.floor + 0.001])
        end = np.array([left + 0.004, (y + drift) * crate.depth, top - 0.01 * (y < -0.2)])
        solids, core = _pen(start, end, vary.color(color, *BRIGHT))
        pieces += solids
        parts.append(core)
    edge = [(left + 0.0015, crate.floor - 0.001), (left + 0.0045, crate.floor - 0.001)]
    outline = [*edge, (right - 0.001, top + 0.012), (right - 0.004, top + 0.012)]
    flat = {"depth": 0.026, "y": 0.5 * crate.depth - 0.020}
    ruler = hull(part.upright(outline, **flat).vertices)
    return assemble(
        pieces=(*pieces, (ruler - box(*wall), YELLOW)),
        parts=(*parts, part.upright(outline, **flat)),
        cavity=Cavity(
            to_mesh(hull(crate.cavity().solid.vertices) - box(*wall)),
            ((shelf - crate.width / 2) / 2, 0.0, crate.height),
        ),
        mass=vary(0.30, 0.2),
    )


def _pen(start: np.ndarray, end: np.ndarray, color: Rgb) -> tuple[list[tuple[Manifold, Rgb]], Mesh]:
    """A pen with its cap up, and its part."""
    neck = start + 0.62 * (end - start)
    outline = ellipse(0.0042, 0.0042, 12)
    barrel = sweep(np.stack([start, neck]), 0.9 * outline)
    cap = sweep(np.stack([neck, end]), outline)
    return [(barrel, WHITE), (cap, color)], part.sweep(np.stack([start, end]), 0.0042)[0]


def letter_tray(vary: Draw) -> Shape:
    """Two trays one above the other, open to the front (-y), with paper in both."""
    width = vary(0.245, 0.08)
    depth = vary(0.190, 0.08)
    height = vary(0.115, 0.1)
    wall = 0.0045
    step = 0.52 * height
    sheets = vary(0.010, 0.5)
    side = [(-0.5, 0.0), (0.5, 0.0), (0.5, 1.0), (0.1, 1.0), (-0.5, 0.78)]
    panels = [
        np.array([(x + s, y * depth, z * height) for s in (-wall / 2, wall / 2) for y, z in side])
        for x in (-(width - wall) / 2, (width - wall) / 2)
    ]
    inner = width - 2 * wall
    back: Block = ((inner, wall, height), (0, (depth - wall) / 2), 0.0)
    shelves: list[Block] = [((inner, depth - wall, wall), (0, -wall / 2), z) for z in (0.0, step)]
    lips: list[Block] = [
        ((inner, wall, 0.014), (0, (wall - depth) / 2), z + wall) for z in (0.0, step)
    ]
    papers: list[Block] = [
        ((0.86 * inner, depth - 3.5 * wall, thick), (0.03 * inner, 0), z + wall)
        for z, thick in ((0.0, 1.6 * sheets), (step, sheets))
    ]
    frame = union(
        *[hull(panel) for panel in panels],
        *[box(*cell) for cell in (back, *shelves, *lips)],
    )
    floor = step + wall
    inside = box((inner, depth - 2 * wall, height - floor), z=floor) - box(*papers[1])
    return assemble(
        pieces=(
            (frame, vary.color(WOOD, *DARK, DARK_WOOD, TEAL)),
            (box(*papers[0]), WHITE),
            (box(*papers[1]), vary.color(PAPER, WHITE, spread=0.02)),
        ),
        parts=(
            *[part.hull(panel) for panel in panels],
            *[part.box(*cell) for cell in (back, *shelves, *lips, *papers)],
        ),
        cavity=Cavity(to_mesh(inside), (0.0, 0.0, height)),
        mass=vary(1.1, 0.2),
    )
