"""About the house: soap dispenser, tissue box, flower pot, desk lamp, globe, candle, toys."""

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
    DARK_WOOD,
    GOLD,
    GREEN,
    GREY,
    NAVY,
    ORANGE,
    PINK,
    RED,
    SILVER,
    SKY,
    STEEL,
    TEAL,
    TERRACOTTA,
    WHITE,
    WOOD,
    YELLOW,
    Draw,
    assemble,
)
from cluttergen_jax.assets.modeller.solids import (
    above,
    arc,
    box,
    cylinder,
    ellipse,
    extrude,
    facing,
    hull,
    lathe,
    lettering,
    pipe,
    revolve,
    rounded_box,
    rounded_rect,
    sweep,
    tube,
    union,
    upright,
)
from cluttergen_jax.assets.modeller.vessel import Crate, Vessel
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.geometry import at_height


def flask(
    width: float, depth: float, corner: float, shoulder: float, top: float, neck: float
) -> tuple[Manifold, Mesh]:
    """A bottle's body on a rounded rectangle, drawn in from `shoulder` to a neck of radius `neck` at `top`.

    Its part touches the table with four corners only, so that a simulator's choice of contacts is settled.
    """

    def levels(num: int) -> list[np.ndarray]:
        outline = rounded_rect(width, depth, corner, num)
        mouth = rounded_rect(2 * neck, 2 * neck, 0.98 * neck, num)
        heights = ((outline * 0.95, 0.0), (outline, 0.006), (outline, shoulder), (mouth, top))
        return [at_height(ring, z) for ring, z in heights]

    rings = levels(1)
    reach = np.array([0.95 * width / 2 - 0.3 * corner, 0.95 * depth / 2 - 0.3 * corner])
    rings[0] = np.array([(sx * reach[0], sy * reach[1], 0.0) for sx in (-1, 1) for sy in (-1, 1)])
    return hull(*levels(7)), part.hull(*rings)


def spray_bottle(vary: Draw) -> Shape:
    """A trigger spray bottle, its nozzle towards -x."""
    width = vary(0.088, 0.1)
    depth = vary(0.056, 0.1)
    shoulder = vary(0.130, 0.12)
    top = shoulder + 0.036
    body, body_part = flask(width, depth, 0.018, shoulder, top, 0.014)
    head_at = top + 0.018
    shell = [(-46, 10), (-46, 25), (-12, 37), (30, 34), (38, 18), (16, -1), (-14, -1)]
    head = [(0.001 * x, head_at + 0.001 * z) for x, z in shell]
    trigger = [
        (x, head_at + z)
        for x, z in ((-0.015, 0.006), (-0.030, 0.010), (-0.043, -0.030), (-0.037, -0.034))
    ]
    neck = cylinder(0.0125, head_at - top + 0.001, top - 0.001)
    collar = cylinder(0.0175, 0.015, top - 0.002, top=0.0155) - cylinder(0.0124, 1.0)
    label = (0.68 * width, 0.58 * shoulder)
    panel, words = _labels(
        label, depth / 2, 0.5 * shoulder, vary.choose("CLEAN", "CLEAN UP", "PLANTS"), 0.17
    )
    grip = upright(head, 0.024)
    return assemble(
        pieces=(
            (body + neck, vary.color(SKY, TEAL, *BRIGHT)),
            (collar - body, WHITE),
            (grip, vary.color(WHITE, CHARCOAL, BLUE)),
            (box((0.008, 0.018, 0.013), (-0.049, 0), head_at + 0.011) - grip, ORANGE),
            (upright(trigger, 0.012) - grip, vary.color(ORANGE, *BRIGHT)),
            (panel, WHITE),
            (words, vary.color(NAVY, BLUE, TEAL)),
        ),
        parts=(
            body_part,
            part.disc([(0.0175, top - 0.004), (0.0155, head_at)], 10),
            part.upright([*head[2:], (-0.052, head_at + 0.012), (-0.052, head_at + 0.024)], 0.022),
            part.upright(trigger, 0.012),
        ),
        mass=vary(0.55, 0.25),
    )


def _labels(
    size: tuple[float, float], y: float, z: float, word: str, share: float
) -> tuple[Manifold, Manifold]:
    """A panel and its print on the front and on the back of a bottle, at distance `y` and height `z`."""
    panel = box((size[0], size[1], 0.0012), z=-0.0004)
    height = min(share * size[1], 0.86 * size[0] / len(word))
    rows = ((0.94, 0.05, 0.44), (0.94, 0.05, -0.44), (0.70, 0.035, -0.12), (0.50, 0.035, -0.24))
    bars = [
        box((wide * size[0], tall * size[1], 0.0012), (0, row * size[1]))
        for wide, tall, row in rows
    ]
    printed = union(*bars, lettering(word, height).translate((0, 0.16 * size[1], 0.0008)))
    placed = []
    for solid in (panel, printed):
        front = solid.rotate((90, 0, 0)).translate((0, -y, z))
        placed.append(front + front.rotate((0, 0, 180)))
    return placed[0], placed[1]


def soap_dispenser(vary: Draw) -> Shape:
    """A soap dispenser with a pump, its spout towards -y."""
    width = vary(0.072, 0.1)
    depth = vary(0.060, 0.1)
    shoulder = vary(0.112, 0.15)
    top = shoulder + 0.016
    body, body_part = flask(width, depth, 0.020, shoulder, top, 0.015)
    cap = cylinder(0.0155, 0.016, top - 0.002) - cylinder(0.0095, 1.0)
    pump = top + vary(0.036, 0.15)
    neck = cylinder(0.0098, 0.012, top - 0.001)
    stem = cylinder(0.0048, pump - top - 0.010, top + 0.010)
    side = ((0.0075, 0, 0.001), (0.0075, 0, 0.013), (0.005, -0.048, -0.001), (0.005, -0.048, 0.006))
    spout = [(s * w, y, pump + z) for s in (-1, 1) for w, y, z in side]
    tip = [
        (s * 0.005, y, pump + z)
        for s in (-1, 1)
        for y in (-0.0485, -0.040)
        for z in (-0.010, 0.004)
    ]
    press = rounded_box((0.034, 0.034, 0.013), 0.005, (0, 0.002), pump)
    panel, words = _labels((0.66 * width, 0.62 * shoulder), depth / 2, 0.5 * shoulder, "SOAP", 0.26)
    metal = vary.color(WHITE, STEEL, CHARCOAL)
    return assemble(
        pieces=(
            (body + neck, vary.color(TEAL, CREAM, *BRIGHT)),
            (union(cap, stem, hull(spout), hull(tip), press) - (body + neck), metal),
            (panel, WHITE),
            (words, vary.color(TEAL, NAVY, BLUE)),
        ),
        parts=(
            body_part,
            part.disc([(0.0155, top - 0.004), (0.0155, top + 0.014)], 10),
            part.box((0.010, 0.010, pump - top + 0.002), z=top),
            part.box((0.032, 0.032, 0.013), (0, 0.002), pump),
            part.hull(spout, tip[:2], tip[4:6]),
        ),
        mass=vary(0.38, 0.2),
    )


KRAFT = (0.72, 0.55, 0.36)


def tissue_box(vary: Draw) -> Shape:
    """A box of paper tissues, one of them pulled half out."""
    width = vary(0.225, 0.1)
    depth = vary(0.115, 0.1)
    height = vary(0.078, 0.2)
    slot = extrude(ellipse(0.30 * width, 0.24 * depth), 0.0012, height - 0.0006)
    ring = extrude(ellipse(0.33 * width, 0.29 * depth), 0.0010, height - 0.0006)
    ring = ring - extrude(ellipse(0.30 * width, 0.24 * depth), 1.0)
    wave = np.linspace(-0.5, 0.5, 25)
    crest = height * (0.42 + 0.10 * np.cos(wave * 4 * np.pi))
    skin = 0.0007
    band = [(width * x, z) for x, z in zip(wave, crest, strict=True)]
    band = [(-width, 0.0), (width, 0.0), (width, band[-1][1]), *band[::-1], (-width, band[0][1])]
    shell = box((width + 2 * skin, depth + 2 * skin, height), z=0.0) - box(
        (width - skin, depth - skin, 2.0), z=-0.5
    )
    lower = shell ^ extrude(band, 1.0, -0.5).rotate((90, 0, 0))
    knots = _tuft(0.26 * width, height)
    cells = []
    for i, j in np.ndindex(knots.shape[0] - 1, knots.shape[1] - 1):
        cell = knots[i : i + 2, j : j + 2].reshape(-1, 3)
        cells.append(hull(*[np.add(cell, (0, s * 0.0012, 0)) for s in (-1, 1)]))
    coarse = knots[[0, 3, 6, 8, 11, 14]][:, [0, -1]].reshape(-1, 3)
    return assemble(
        pieces=(
            (
                box((width, depth, height)),
                vary.color(SKY, PINK, CREAM, *BRIGHT),
            ),
            (lower, vary.color(BLUE, TEAL, RED, GREEN)),
            (ring, WHITE),
            (slot - ring, GREY),
            (union(*cells), WHITE),
        ),
        parts=(
            part.box((width, depth, height)),
            part.hull(*[np.add(coarse, (0, s * 0.0012, 0)) for s in (-1, 1)]),
        ),
        mass=vary(0.22, 0.25),
    )


def _tuft(reach: float, base: float) -> np.ndarray:
    """A grid of knots on a rippled sheet that widens upwards from height `base`: f64[15, 6, 3]."""
    u, v = np.meshgrid(np.linspace(-1, 1, 15), np.linspace(0, 1, 6), indexing="ij")
    x = reach * u * (0.35 + 0.55 * v**0.8)
    y = (0.003 + 0.005 * v) * np.sin(6.5 * u + 0.8 * v)
    z = base - 0.002 + 0.066 * v * (0.95 + 0.05 * np.cos(4.1 * u + 1.0))
    return np.stack([x, y, z], -1)


def tape_roll(vary: Draw) -> Shape:
    """A roll of parcel tape lying flat, with its core and a loose end."""
    outer = vary(0.054, 0.12)
    width = vary(0.048, 0.1)
    inner = min(vary(0.038, 0.06), outer - 0.010)
    tape = pipe(inner + 0.002, outer, 0.0, width, 64)
    core = pipe(inner, inner + 0.0021, 0.0, width, 64)
    seam = cylinder(outer - 0.004, 0.0008, width - 0.0004) - cylinder(outer - 0.006, 1.0)
    end = np.array(
        [(outer - 0.0006, 0), (outer - 0.0002, 0.008), (outer - 0.0002, 0.014), (outer, 0.019)]
    )
    tab = [
        hull(
            [
                (x + t, y, z)
                for x, y in end[k : k + 2]
                for t in (-0.0006, 0.0006)
                for z in (0.0, width)
            ]
        )
        for k in range(3)
    ]
    section = [(inner, 0.0), (1.03 * outer, 0.0), (1.03 * outer, width), (inner, width)]
    return assemble(
        label="roll of tape",
        pieces=(
            (
                tape + (union(*tab) - cylinder(outer - 0.0005, 1.0)),
                vary.color(KRAFT, SKY, RED, GREEN, GREY),
            ),
            (core, vary.color(CREAM, WHITE)),
            (seam, BLACK),
        ),
        parts=part.ring_sectors(section, 8),
        mass=vary(0.16, 0.25),
    )


def flower_pot(vary: Draw) -> Shape:
    """An empty clay pot with a rolled rim, standing in its saucer."""
    foot = vary(0.046, 0.1)
    height = vary(0.112, 0.12)
    waist = foot + vary(0.016, 0.2)
    floor = 0.013
    rim = waist + 0.006
    band = height - 0.030
    outer = [(foot, 0.003), (waist, band), (rim, band), (rim + 0.003, height)]
    inner = [(foot - 0.005, floor), (waist - 0.006, band), (rim - 0.004, height)]
    pot = Vessel(outer, inner)
    dish = foot + 0.018
    saucer = [(0.0, 0.0), (foot + 0.004, 0.0), (dish, 0.014), (dish - 0.003, 0.014)]
    saucer += [(foot + 0.002, 0.004), (0.0, 0.004)]
    clay = vary.color(TERRACOTTA, TERRACOTTA, (0.86, 0.82, 0.74), TEAL)
    return assemble(
        pieces=(
            (revolve(saucer) + pot.solid(), clay),
            (_trim(pot, band, height), (0.86 * clay[0], 0.86 * clay[1], 0.86 * clay[2])),
        ),
        parts=(
            part.disc([(foot + 0.004, 0.0), (dish, floor)], 14, is_standing=True),
            *pot.parts(8)[1:],
        ),
        cavity=pot.cavity(),
        mass=vary(0.55, 0.2),
    )


def _trim(pot: Vessel, low: float, high: float) -> Manifold:
    """Two painted rings around the rim."""
    rings = []
    for z in (low + 0.25 * (high - low), low + 0.75 * (high - low)):
        radius = pot.outer_radius(z)
        rings.append(pipe(radius - 0.001, radius + 0.0009, z, z + 0.003))
    return union(*rings)


def basket(vary: Draw) -> Shape:
    """A woven basket with an arched handle over its width."""
    width = vary(0.190, 0.1)
    depth = vary(0.135, 0.1)
    height = vary(0.095, 0.15)
    tub = Crate(width, depth, height, 0.005, 0.005, flare=vary(0.014, 0.3))
    reach = tub.width / 2 + tub.flare - 0.003
    rise = vary(0.105, 0.15)
    flat = np.array([(-0.008, -0.0035), (0.008, -0.0035), (0.008, 0.0035), (-0.008, 0.0035)])

    def bow(num: int, grow: float) -> np.ndarray:
        turns = np.linspace(np.pi, 0.0, num)
        return np.add(grow * arc(turns, reach, rise), (0, 0, tub.height - 0.010))

    edge = tub.height - 0.010
    rim = hull(tub.outline(edge, -0.003), tub.outline(tub.height, -0.003))
    rim = rim - hull(tub.outline(edge - 0.001, 0.003), tub.outline(tub.height + 0.001, 0.003))
    handle = sweep(bow(25, 1.0), flat) - hull(
        tub.outline(0.0, 0.001), tub.outline(tub.height, 0.001)
    )
    return assemble(
        pieces=(
            (tub.solid(), vary.color(KRAFT, (0.62, 0.44, 0.27), CREAM)),
            (_weave(tub, edge), vary.color(CREAM, WOOD, TEAL, WHITE)),
            (union(handle, rim), vary.color(WOOD, (0.50, 0.33, 0.20))),
        ),
        parts=(*tub.parts(), *part.sweep(bow(6, 1.03), flat)),
        cavity=tub.cavity(),
        mass=vary(0.40, 0.25),
    )


_WOVEN_ROWS = 7


def _weave(tub: Crate, top: float) -> Manifold:
    """Raised strands in a chequer around the four walls, up to height `top`."""
    strands = []
    levels = np.linspace(0.004, top - 0.001, _WOVEN_ROWS + 1)
    for j in range(_WOVEN_ROWS):
        low = levels[j] + 0.0008
        high = levels[j + 1] - 0.0008
        rings = [tub.outline(z, inset) for z in (low, high) for inset in (0.001, -0.0018)]
        for wall in range(4):
            columns = (12, 8)[wall % 2]
            for i in range(j % 2, columns, 2):
                shares = np.array([i, i + 1])[:, None] / columns
                ends = [(1 - shares) * ring[wall] + shares * ring[(wall + 1) % 4] for ring in rings]
                strands.append(hull(*ends))
    return union(*strands)


WARM = (1.0, 0.93, 0.66)


def desk_lamp(vary: Draw) -> Shape:
    """A jointed lamp on a heavy round foot, its shade looking down to the front (-x)."""
    size = vary(1.0, 0.10)
    radius = 0.088 * size
    lean = vary(0.075, 0.25) * size
    foot = (0.020 * size, 0.0, 0.016 * size)
    elbow = (lean, 0.0, vary(0.225, 0.12) * size)
    head = (elbow[0] - 0.110 * size, 0.0, elbow[2] + vary(0.115, 0.2) * size)
    mouth = 0.058 * size
    depth = 0.085 * size
    pitch = vary(28.0, 0.3)
    # The shade is drawn hanging from the origin, then pitched so that its mouth looks to the front.
    outline = [(0.019 * size, 0.0), (mouth, -depth)]
    shell = [*outline, (mouth - 0.002, -depth), (0.017 * size, -0.003), (0.0, -0.003), (0.0, 0.0)]
    shade_solid = union(
        revolve(shell[::-1]), cylinder(0.019 * size, 0.018 * size, top=0.012 * size)
    )
    glow = cylinder(mouth * 0.97 - 0.004, 0.004, z=-depth + 0.004)
    shroud = (
        cylinder(mouth, depth, z=-depth, top=0.019 * size).rotate((0, pitch, 0)).translate(head)
    )
    arms = union(*[tube([a, b], 0.0065 * size) for a, b in ((foot, elbow), (elbow, head))]) - shroud
    joints = union(*[_hinge(point, 0.013 * size) for point in (foot, elbow, head)]) - shroud
    color = vary.color(CRIMSON, TEAL, CHARCOAL, *BRIGHT)
    base = [(radius, 0.0), (radius, 0.010 * size), (radius * 0.72, 0.020 * size)]
    parts = [
        part.disc([(radius, 0.0), (0.86 * radius, 0.020 * size)], 14, is_standing=True),
        *part.sweep([foot, elbow], 0.008 * size),
        *part.sweep([elbow, head], 0.008 * size),
        part.rotate_part(
            part.disc([(mouth, -depth), (0.019 * size, 0.012 * size)], 14), (0, pitch, 0), head
        ),
    ]
    return assemble(
        pieces=(
            (lathe(base), color),
            (arms, vary.color(SILVER, GOLD, CHARCOAL)),
            (joints, BLACK),
            (shade_solid.rotate((0, pitch, 0)).translate(head), color),
            (glow.rotate((0, pitch, 0)).translate(head), WARM),
        ),
        parts=tuple(parts),
        mass=vary(1.4, 0.2),
    )


def _hinge(center: tuple[float, float, float], radius: float) -> Manifold:
    """A short pin across the arm, along y."""
    pin = cylinder(radius, 1.7 * radius, z=-0.85 * radius, segments=24)
    return pin.rotate((90, 0, 0)).translate(center)


def candle(vary: Draw) -> Shape:
    """A burning candle in a chamberstick: a dish with a socket and a finger ring."""
    radius = vary(0.019, 0.12)
    height = vary(0.115, 0.25)
    dish = vary(0.058, 0.12)
    lip = 0.012
    floor = 0.006
    saucer = [
        (0.72 * dish, 0.0),
        (dish, lip),
        (dish - 0.003, lip + 0.001),
        (0.68 * dish, floor),
    ]
    socket = [(radius + 0.004, 0.0), (radius + 0.005, 0.022)]
    turns = np.linspace(0.0, 2 * np.pi, 25)[:-1]
    reach = dish + 0.010
    ring = 0.014
    bar = 0.0035
    loop = revolve(ellipse(bar, bar, 10) + np.array([ring, 0.0]), 32)
    loop = loop.rotate((90, 0, 0)).translate((reach, 0, lip + 0.007))
    wax = union(cylinder(radius, height, z=floor), *_drips(vary, radius, floor + height))
    wick_top = floor + height + 0.010
    stations = np.array([0.0, 0.12, 0.3, 0.5, 0.75, 1.0])
    flame = sweep(
        [(0.0, 0.0, wick_top - 0.006 + 0.030 * s) for s in stations],
        ellipse(0.008, 0.008, 20),
        scales=[0.35, 0.8, 1.0, 0.85, 0.42, 0.03],
    )
    square = [(ring + bar, -bar), (ring + bar, bar), (ring - bar, bar), (ring - bar, -bar)]
    cells = [
        part.rotate_part(cell, (90, 0, 0), (reach, 0, lip + 0.007))
        for cell in part.ring_sectors([(r * 1.08, z) for r, z in square], 5, phase=turns[6])
    ]
    metal = union(lathe(saucer), lathe(socket), loop)
    return assemble(
        label="candle in a holder",
        pieces=(
            (
                metal - cylinder(radius, 0.1, z=floor),
                vary.color(GOLD, TEAL, SILVER, CRIMSON),
            ),
            (wax, vary.color(CREAM, WHITE, PINK, CRIMSON)),
            (cylinder(0.0012, 0.012, z=floor + height, segments=10), BLACK),
            (flame, vary.color(ORANGE)),
            (
                flame.scale((1.02, 1.02, 1.0)).trim_by_plane((0, 0, -1), -wick_top - 0.002),
                YELLOW,
            ),
        ),
        parts=(
            part.disc([(0.72 * dish, 0.0), (dish, lip)], 14, is_standing=True),
            part.disc([(radius, 0.002), (radius, floor + height)], 12),
            part.disc(
                [(0.007, wick_top), (0.0, wick_top + 0.024), (0.0, floor + height - 0.002)], 8
            ),
            *cells,
        ),
        mass=vary(0.30, 0.2),
    )


def _drips(vary: Draw, radius: float, top: float) -> list[Manifold]:
    """Runs of wax down from the edge of the candle."""
    angles = vary.within((0.3, 1.9, 3.0, 4.6, 5.4), 0, 2 * np.pi)
    lengths = (0.022, 0.034, 0.016, 0.028, 0.018)
    drips = []
    for angle, length in zip(angles, lengths, strict=True):
        x = (radius - 0.0005) * np.cos(angle)
        y = (radius - 0.0005) * np.sin(angle)
        run = [(x, y, top - 0.001), (x, y, top - length / 2), (x, y, top - length)]
        drips.append(tube(run, 0.003, side=(1, 0, 0), scales=[0.7, 0.8, 1.0], segments=10))
    return drips


# Rough outlines of the continents, each a few convex patches of (longitude, latitude) in degrees.
LAND = (
    ((-165, 65), (-140, 70), (-95, 72), (-80, 62), (-58, 51), (-70, 42), (-125, 48), (-150, 60)),
    ((-125, 48), (-70, 45), (-75, 36), (-82, 27), (-97, 24), (-110, 24), (-120, 34)),
    ((-112, 28), (-97, 26), (-88, 17), (-78, 8), (-84, 10), (-104, 19)),
    ((-55, 80), (-25, 82), (-22, 70), (-43, 60), (-53, 68)),
    ((-80, 7), (-62, 11), (-50, 1), (-35, -7), (-40, -21), (-55, -33), (-71, -22), (-81, -5)),
    ((-71, -20), (-52, -30), (-64, -42), (-68, -54), (-74, -50)),
    (
        (-17, 15),
        (-16, 25),
        (-6, 35),
        (10, 37),
        (32, 31),
        (43, 12),
        (51, 11),
        (40, 2),
        (9, 3),
        (-9, 5),
    ),
    ((9, 4), (42, 2), (40, -15), (32, -28), (20, -35), (13, -18)),
    ((-9, 37), (-9, 43), (2, 50), (10, 57), (30, 68), (40, 60), (40, 47), (28, 38)),
    ((5, 59), (12, 56), (30, 62), (40, 67), (26, 71), (14, 66)),
    ((36, 66), (75, 73), (105, 77), (140, 73), (178, 67), (160, 60), (135, 45), (60, 40), (40, 45)),
    ((45, 42), (60, 26), (75, 22), (105, 20), (121, 30), (135, 46), (75, 55)),
    ((66, 25), (88, 23), (80, 10), (76, 9)),
    ((35, 31), (48, 31), (59, 22), (45, 12)),
    ((95, 23), (109, 21), (107, 9), (101, 2)),
    ((114, -22), (130, -12), (142, -11), (153, -27), (147, -38), (130, -32), (115, -34)),
    ((96, 4), (118, 6), (117, -4), (105, -7)),
)

GROUND = (GREEN, (0.83, 0.72, 0.45), (0.62, 0.66, 0.33))


def globe(vary: Draw) -> Shape:
    """A terrestrial globe, its axis tilted in a half ring on a round foot."""
    radius = vary(0.082, 0.15)
    foot = 0.86 * radius
    middle = 2.05 * radius
    sea = vary.color(BLUE, NAVY, SKY)
    spin = (0.0, 0.0, vary.within(-65.0, 0, 360))
    tilt = (0.0, 23.4, 0.0)
    at = (0.0, 0.0, middle)
    skin = Manifold.sphere(radius, 64) - Manifold.sphere(radius - 0.003, 48)
    film = Manifold.sphere(radius + 0.0007, 96) - Manifold.sphere(radius - 0.0012, 48)
    caps = union(*[box((1, 1, 1), z=z) for z in (0.955 * radius, -1 - 0.93 * radius)])
    land = (union(*[_cone(patch, 3 * radius) for patch in LAND]) ^ film).rotate(spin) - caps
    ice = (Manifold.sphere(radius + 0.0012, 96) - Manifold.sphere(radius - 0.0018, 48)) ^ caps
    reach = radius + 0.008
    bar = 0.0045
    turns = np.radians(np.linspace(-90, 90, 25))
    half_ring = tube(arc(turns, reach, reach), bar)
    pins = union(
        *[cylinder(0.003, 0.014, z=z, segments=16) for z in (radius - 0.002, -radius - 0.012)]
    )
    lowest = middle - reach
    base = [(foot, 0.0), (foot, 0.008), (0.35 * foot, 0.020)]
    neck = lowest - bar + 0.003
    stem = [(0.020, 0.014), (0.009, 0.030), (0.007, neck)]
    brass = vary.color(GOLD, SILVER, STEEL)
    bow = arc(np.radians(np.linspace(-90, 90, 6)), 1.03 * reach, 1.03 * reach)
    return assemble(
        pieces=(
            (skin.rotate(tilt).translate(at), sea),
            ((land - ice).rotate(tilt).translate(at), vary.color(*GROUND)),
            (ice.rotate(tilt).translate(at), WHITE),
            (union(half_ring, pins).rotate(tilt).translate(at), brass),
            (
                union(lathe(base), lathe(stem)),
                vary.color(DARK_WOOD, WOOD, CHARCOAL),
            ),
        ),
        parts=(
            part.disc([(foot, 0.0), (0.62 * foot, 0.018)], 14, is_standing=True),
            part.disc([(0.012, 0.010), (0.008, lowest)], 6),
            part.ball(radius, at),
            *[part.rotate_part(cell, tilt, at) for cell in part.sweep(bow, bar)],
        ),
        mass=vary(0.65, 0.2),
    )


def _cone(patch: tuple[tuple[float, float], ...], reach: float) -> Manifold:
    """All that lies behind a patch of the sphere, as seen from its centre."""
    lon, lat = np.radians(np.array(patch, np.float64)).T
    rays = np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    return hull(reach * rays, np.zeros(3))


def eyeglasses(vary: Draw) -> Shape:
    """A pair of glasses with open temples, resting on rims and tips, lenses towards -y."""
    lens = (vary(0.052, 0.08), vary(0.042, 0.12))
    rim = 0.0045
    deep = 0.006
    gap = 0.0085
    reach = vary(0.125, 0.06)
    size = (lens[0] + 2 * rim, lens[1] + 2 * rim)
    middle = (size[0] / 2 + gap, size[1] / 2)
    corner = vary.choose(0.014, 0.006, 0.019)
    outline = rounded_rect(*size, corner + rim)
    coarse = rounded_rect(*size, corner + rim, 2)
    pane = rounded_rect(*lens, corner)
    rims = []
    panes = []
    parts = []
    for side in (-1, 1):
        shift = np.array([side * middle[0], middle[1]])
        rims.append(upright(outline + shift, deep) - upright(pane + shift, 1.0))
        panes.append(upright(pane + shift, 0.002))
        parts.append(part.upright(coarse + shift, deep))
        hinge = middle[0] + size[0] / 2 - 0.004
        tall = 0.0045
        top = 0.78 * size[1]
        # Three stations of a temple: hinge, the bend behind the ear, the tip with its flat foot.
        stations = [
            (hinge, -0.003, top),
            (hinge + 0.004, 0.72 * reach, top),
            (hinge + 0.002, reach, tall),
        ]
        corners = [(w, h) for w in (-0.0025, 0.0025) for h in (-tall, tall)]
        sections = [[(side * (x + w), y, z + h) for w, h in corners] for x, y, z in stations]
        foot = [(x, y + 0.008, z) for x, y, z in sections[2]]
        cells = [sections[0] + sections[1], sections[1] + sections[2] + foot]
        rims += [hull(cell) for cell in cells]
        parts += [part.hull(cell) for cell in cells]
    bridge = ((2 * gap + 0.006, deep - 0.001, 0.006), (0, 0), 0.62 * size[1])
    frame = union(*rims, box(*bridge))
    tint = vary.color(SKY, (0.25, 0.27, 0.30), (0.55, 0.40, 0.25))
    return assemble(
        pieces=(
            (frame, vary.color(BLACK, CRIMSON, DARK_WOOD, NAVY)),
            (union(*panes) - frame, tint, 0.45),
        ),
        parts=(*parts, part.box(*bridge)),
        mass=vary(0.035, 0.2),
    )


def toy_car(vary: Draw) -> Shape:
    """A wooden toy car on wheels with flat treads, its bonnet towards -x."""
    length = vary(0.140, 0.12)
    width = vary(0.062, 0.1)
    waist = vary(0.046, 0.08)
    wheel = min(vary(0.0195, 0.1), 0.43 * waist)
    nose = -length / 2
    tail = length / 2
    low = 0.012
    body = [(nose + 0.004, low), (tail - 0.004, low), (tail, 0.7 * waist), (tail - 0.008, waist)]
    body += [(nose + 0.012, 0.86 * waist), (nose, 0.6 * waist)]
    roof = waist + vary(0.026, 0.15)
    cabin = [(nose + 0.30 * length, 0.78 * waist), (tail - 0.10 * length, 0.78 * waist)]
    cabin += [(tail - 0.20 * length, roof), (nose + 0.44 * length, roof)]
    glazed = np.maximum(cabin, (-1.0, waist - 0.004))
    middle = np.mean(glazed, axis=0)
    panes = middle + (glazed - middle) * (0.74, 0.62)
    post = box((0.006, 1, 1), (middle[0], 0))
    glass = union(
        upright(panes, 0.86 * width + 0.0016) - upright(panes, 0.86 * width - 0.001) - post
    )
    shield = [(0.55, 0.18), (0.55, 0.82)]
    front, rear = (
        (_along(cabin[a], cabin[b], waist), np.array(cabin[b])) for a, b in ((0, 3), (1, 2))
    )
    for bottom, top in (front, rear):
        across = np.array([bottom + (top - bottom) * share for _, share in shield])
        outline = [(x + dx, z) for x, z in across for dx in (-0.0012, 0.0012)]
        glass += hull(part.upright(outline, 0.66 * width).vertices)
    # The wheels are cut flat at the table: a twelve-sided tread with one side down.
    axle = wheel * np.cos(np.pi / 12)
    hubs = [nose + 0.23 * length, tail - 0.23 * length]
    places = [(x, s * (width / 2 - 0.002)) for x in hubs for s in (-1, 1)]
    tread = 0.014
    tyres = [above(facing(wheel, tread).translate((x, y, axle))) for x, y in places]
    caps = [facing(0.5 * wheel, tread + 0.002).translate((x, y, axle)) for x, y in places]
    lamp = facing(0.0055, 0.003).rotate((0, 0, 90))
    lamps = union(
        *[lamp.translate((nose + 0.0015, s * 0.3 * width, 0.62 * waist)) for s in (-1, 1)]
    )
    shell = union(upright(body, width), upright(cabin, 0.86 * width))
    paint = vary.color(RED, *BRIGHT)
    roller = part.rotate_part(
        part.disc([(wheel, -tread / 2), (wheel, tread / 2)], 12, np.pi / 12), (90, 0, 0)
    )
    rollers = [part.rotate_part(roller, (0, 0, 0), (x, y, axle)) for x, y in places]
    return assemble(
        pieces=(
            (shell, paint),
            (glass, SKY),
            (union(*tyres) - shell, BLACK),
            (union(*caps) - union(*tyres) - shell, STEEL),
            (lamps - shell, YELLOW),
        ),
        parts=(
            part.upright(body, width),
            part.upright(cabin, 0.86 * width),
            *rollers,
        ),
        mass=vary(0.20, 0.25),
    )


def photo_frame(vary: Draw) -> Shape:
    """A picture frame leaning back on its strut, the picture towards -y."""
    width = vary(0.150, 0.12)
    height = vary(0.195, 0.12)
    lean = vary(15.0, 0.2)
    thick = 0.014
    border = vary(0.016, 0.2)
    turn = (-lean, 0.0, 0.0)
    sink = -0.006

    def leaning(solid: Manifold) -> Manifold:
        return above(solid.rotate(turn).translate((0, 0, sink)))

    rim = box((width, thick, height), (0, thick / 2))
    inside = (width - 2 * border, height - 2 * border)
    rim_open = rim - box((inside[0], 0.006, inside[1]), (0, 0.0), border)
    mat = box((inside[0] - 0.0005, 0.0015, inside[1] - 0.0005), (0, 0.0026), border + 0.0002)
    view = (inside[0] - 0.024, inside[1] - 0.030)
    low = border + 0.015
    left = -view[0] / 2
    sky = upright(
        [(left, low), (-left, low), (-left, low + view[1]), (left, low + view[1])], 0.001, 0.0014
    )
    share = vary.within(0.30, 0.2, 0.45)
    hills = []
    for y, skyline in ((0.0010, (0.30, share + 0.28, 0.22)), (0.0006, (0.10, share, 0.24))):
        peak = (0.2 if y > 0.0008 else -0.2) * view[0]
        outline = [
            (left, 0),
            (-left, 0),
            *zip((-left, peak, left), view[1] * np.array(skyline), strict=True),
        ]
        hills.append(upright(np.add(outline, (0, low)), 0.001, y))
    sun = cylinder(0.13 * view[0], 0.001).rotate((90, 0, 0))
    sun = sun.translate((-0.24 * view[0], 0.0010, low + 0.76 * view[1]))
    scene = ((sky, SKY), (hills[0], NAVY), (hills[1], GREEN), (sun, YELLOW))
    slope = np.tan(np.radians(lean))
    top = 0.66 * height
    heel = top * slope + thick / np.cos(np.radians(lean))
    far_foot = heel + vary(0.058, 0.15)
    edge = ((heel - 0.004, top), (heel + 0.001, top - 0.002))
    strut = [(s * 0.022, y, z) for s in (-1, 1) for y, z in edge]
    strut += [(s * 0.030, y, 0.0) for s in (-1, 1) for y in (far_foot - 0.008, far_foot)]
    back = leaning(rim)
    return assemble(
        pieces=(
            (
                leaning(rim_open),
                vary.color(DARK_WOOD, WOOD, GOLD, BLACK, WHITE, SILVER),
            ),
            (leaning(mat), WHITE),
            *[(leaning(solid), color) for solid, color in scene],
            (hull(strut) - back, BLACK),
        ),
        parts=(part.corners_of(back), part.hull(strut)),
        mass=vary(0.35, 0.2),
    )


def _along(low: tuple[float, float], high: tuple[float, float], z: float) -> np.ndarray:
    """The point (x, z) at a height on the line between two points."""
    share = (z - low[1]) / (high[1] - low[1])
    return (1 - share) * np.array(low) + share * np.array(high)
