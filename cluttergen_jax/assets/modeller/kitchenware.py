"""Tableware and cookware: bowl, plates, mug, glasses, teapot, cutlery, pot, pan, toaster."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller.draw import Draw, assemble, hex_colors, hex_rgb
from cluttergen_jax.assets.modeller.solids import (
    Points2,
    above,
    box,
    cylinder,
    difference,
    ellipse,
    extrude,
    lathe,
    pipe,
    revolve,
    rounded_box,
    rounded_rect,
    smooth_path,
    sweep,
    to_mesh,
    tube,
    union,
    upright,
)
from cluttergen_jax.assets.modeller.vessel import Vessel
from cluttergen_jax.assets.shape import Cavity, Shape
from cluttergen_jax.geometry import at_height

PLATE_GLAZES = hex_colors("4f86a6 c9713f 6f8f5a a43f4f e3ded2 2f3e55 d8b64c")
PORCELAIN = hex_colors("f1eee6 e6ecef f3e6d6 dfe7dc")


def bowl(vary: Draw) -> Shape:
    """A cereal bowl on a flat foot, glazed outside, light inside."""
    radius = vary(0.076)
    height = vary(0.064)
    foot = radius * vary.within(0.46, 0.40, 0.55)
    wall = vary(0.0046)
    turns = np.linspace(0.15, 1.0, 7) * np.pi / 2 * 0.78
    shape = np.stack(
        [np.sin(turns) / np.sin(turns[-1]), (1 - np.cos(turns)) / (1 - np.cos(turns[-1]))], -1
    )
    outer = [(foot + (radius - foot) * r, 0.004 + (height - 0.004) * z) for r, z in shape]
    inner = [(r - wall, z) for r, z in outer[1:-1]] + [(radius - 0.6 * wall, height)]
    floor = inner[0][1] - 0.003
    body = Vessel([(foot, 0.0), (foot, 0.004), *outer], [(inner[0][0] - 0.006, floor), *inner])
    outside, lining = body.layers(0.0012)
    return assemble(
        label="cereal bowl",
        pieces=((outside, vary.color(*PLATE_GLAZES)), (lining, (0.96, 0.94, 0.90))),
        parts=body.parts(8, cuts=(floor + 0.33 * (height - floor),)),
        cavity=body.cavity(),
        mass=vary(0.38, 0.15),
    )


def dinner_plate(vary: Draw) -> Shape:
    """A flat plate with a raised rim and a coloured band near its edge."""
    radius = vary(0.130)
    height = vary(0.022, 0.2)
    well = radius * vary(0.66, 0.08)
    thick = 0.005
    outer = [
        (well - 0.010, 0.0),
        (well, 0.003),
        (well + 0.008, 0.40 * height),
        (radius, height - 0.0015),
    ]
    inner = [
        (well - 0.012, thick),
        (well - 0.002, thick + 0.002),
        (well + 0.007, 0.40 * height + thick),
    ]
    body = Vessel([*outer, (radius - 0.001, height)], [*inner, (radius - 0.004, height)])
    near = 0.80 * radius
    far = 0.93 * radius
    low, high = (
        np.interp(r, [p[0] for p in body.inner], [p[1] for p in body.inner]) for r in (near, far)
    )
    band = revolve(
        [(near, low - 0.0010), (far, high - 0.0010), (far, high + 0.0003), (near, low + 0.0003)]
    )
    return assemble(
        pieces=(
            (body.solid() - band, vary.color(*PORCELAIN, spread=0.02)),
            (band, vary.color(*PLATE_GLAZES)),
        ),
        parts=body.parts(10),
        cavity=body.cavity(),
        mass=vary(0.55, 0.2),
    )


MUG_GLAZES = hex_colors("2f6f9f b8452f 3f7f5f e0a63a 7a4b8c 37424e d9d3c7")
GLASS = hex_colors("a9d3e6 b9dfd0 c9c4e4 d7e0e4")


def mug(vary: Draw) -> Shape:
    """A coffee mug with a light lining and one handle on its +x side."""
    radius = vary(0.041)
    height = vary(0.096, 0.2)
    foot = radius * vary.within(0.95, 0.78, 1.0)
    wall = vary(0.0042)
    outer = [(foot - 0.004, 0.0), (foot - 0.001, 0.002), (foot, 0.005), (radius, height - 0.0015)]
    inner = [(foot - wall - 0.004, 0.006), (foot - wall, 0.010), (radius - wall, height - 0.0015)]
    body = Vessel([*outer, (radius - 0.0012, height)], [*inner, (radius - wall + 0.0012, height)])
    path = _handle_path(vary, body, height)
    section = ellipse(vary(0.0068), vary(0.0038), 20)
    outside, lining = body.layers(0.0012)
    outside = union(outside, sweep(path, section) - body.inside() - lining)
    return assemble(
        label="coffee mug",
        pieces=((outside, vary.color(*MUG_GLAZES)), (lining, (0.95, 0.93, 0.89))),
        parts=(
            *body.parts(8),
            *part.sweep(
                part.thin_path(path, 4, 0.04), section[[1, 4, 6, 9, 11, 14, 16, 19]] * 1.04
            ),
        ),
        cavity=body.cavity(),
        mass=vary(0.33, 0.1),
    )


def _handle_path(vary: Draw, body: Vessel, height: float) -> np.ndarray:
    """The middle line of a mug's handle in the xz plane, both ends inside the wall, f64[24, 3]."""
    high = height * vary(0.82, 0.05)
    low = height * vary(0.24, 0.25)
    reach = vary(0.031)
    drop = high - low
    knots = [
        (body.outer_radius(high) - 0.003, 0.0, high),
        (body.outer_radius(high) + 0.62 * reach, 0.0, high + 0.02 * drop),
        (body.outer_radius(high) + reach, 0.0, high - 0.35 * drop),
        (body.outer_radius(low) + 0.75 * reach, 0.0, low + 0.15 * drop),
        (body.outer_radius(low) - 0.003, 0.0, low - 0.02 * drop),
    ]
    return smooth_path(knots, 24)


def water_glass(vary: Draw) -> Shape:
    """A tumbler of clear glass with a heavy base."""
    radius = vary(0.037)
    height = vary(0.120, 0.2)
    foot = radius * vary.within(0.82, 0.72, 0.98)
    wall = vary(0.0026)
    base = vary(0.011, 0.3)
    outer = [
        (foot - 0.002, 0.0),
        (foot, 0.002),
        (radius, height - 0.001),
        (radius - 0.0008, height),
    ]
    at_base = foot + (radius - foot) * base / height
    inner = [
        (at_base - wall - 0.002, base),
        (at_base - wall, base + 0.003),
        (radius - wall + 0.0004, height),
    ]
    body = Vessel(outer, inner)
    return assemble(
        pieces=((body.solid(), vary.color(*GLASS), 0.5),),
        parts=body.parts(8),
        cavity=body.cavity(),
        mass=vary(0.25, 0.15),
    )


def wine_glass(vary: Draw) -> Shape:
    """A stemmed glass: a foot, a thin stem and a tulip-shaped bowl."""
    belly = vary(0.041, 0.12)
    mouth = vary.choose(0.80, 0.74, 0.86, 0.92)
    foot = vary(0.036, 0.08)
    stem = vary(0.085, 0.2)
    radius = vary(0.0046, 0.1)
    depth = vary(0.100, 0.15)
    wall = 0.0024
    base = stem + 0.010
    wide = stem + 0.010 + 0.42 * depth
    rim = stem + 0.010 + depth
    curve = [(0.45, 0.06), (0.72, 0.16), (0.90, 0.27), (1.0, 0.42), (0.97, 0.62)]
    outside = [(belly * r, base + depth * z) for r, z in curve] + [(belly * mouth, rim)]
    inside = [(r - wall, z) for r, z in outside]
    lower = [(foot, 0.0), (foot, 0.0022), (0.3 * foot, 0.0055), (radius, 0.014), (radius, stem)]
    body = Vessel([(0.35 * belly, base), *outside], [(0.3 * belly, base + 0.0035), *inside])
    profile = [*lower, *body.outer, *reversed(body.inner)]
    return assemble(
        pieces=((lathe(profile), vary.color(*GLASS), 0.5),),
        parts=(
            part.disc([(foot, 0.0), (foot, 0.0022), (0.25 * foot, 0.0060)], 8, is_standing=True),
            part.disc([(1.1 * radius, 0.004), (1.1 * radius, base + 0.001)], 6),
            *body.parts(8, cuts=(wide,)),
        ),
        cavity=body.cavity(),
        mass=vary(0.16, 0.15),
    )


TEAPOT_GLAZES = hex_colors("e8e2d4 b3262e 2f6f8f d9822b 3f6f4f 7a5a8c")
TRIMS = hex_colors("2f5f9f 8a5a2b 25282c")


def teapot(vary: Draw) -> Shape:
    """A round teapot with its lid on, a spout at +x and a handle at -x."""
    radius = vary(0.072, 0.1)
    height = vary(0.105, 0.12)
    base = 0.62 * radius
    neck = 0.48 * radius
    reach = vary(0.058, 0.1)
    belly = [(base, 0.004), (0.93 * radius, 0.26 * height), (radius, 0.48 * height)]
    belly += [(0.85 * radius, 0.77 * height), (neck, height)]
    body = lathe([(base - 0.003, 0.0), *smooth_path(belly, 30)])
    rising = [(0.80, 0.0, 0.34), (1.0, 0.38, 0.46), (1.0, 0.66, 0.74), (1.0, 1.0, 0.97)]
    spout = smooth_path([(r * radius + s * reach, 0, z * height) for r, s, z in rising], 20)
    falling = [
        (0.80, 0.0, 0.80),
        (1.0, 0.026, 0.90),
        (1.0, 0.046, 0.62),
        (1.0, 0.028, 0.32),
        (0.9, 0.0, 0.24),
    ]
    arm = smooth_path([(-r * radius - x, 0, z * height) for r, x, z in falling], 24)
    bar = ellipse(0.0070, 0.0052, 16)
    sizes = np.linspace(1.35, 0.62, 20)
    bore = tube(spout[-4:] + np.array([0.0004, 0, 0.0008]), 0.0042)
    vessel = difference(union(body, tube(spout, 0.0115, scales=sizes), sweep(arm, bar)), bore)
    trim = vary.color(*TRIMS, spread=0.03)
    cells = part.thin_path(spout, 2)
    return assemble(
        pieces=(
            (vessel, vary.color(*TEAPOT_GLAZES, spread=0.04)),
            (_lid(neck, height), trim),
            (difference(_band(body, height), vessel), trim),
        ),
        parts=(
            *_belly([(base, 0.0), *belly[1:]]),
            part.disc([(neck + 0.003, height - 0.001), (0.6 * neck, height + 0.010)], 10),
            part.disc(
                [(0.008, height + 0.008), (0.012, height + 0.022), (0.006, height + 0.032)], 8
            ),
            *part.sweep(cells, 0.0115, scales=np.interp(cells[:, 2], spout[:, 2], sizes)),
            *part.sweep(part.thin_path(arm, 4, 0.03), bar[::2]),
        ),
        mass=vary(0.85, 0.15),
    )


def _belly(rings: list[tuple[float, float]]) -> tuple[Mesh, ...]:
    """A round body in two overlapping parts, parted at its widest ring."""
    widest = int(np.argmax([radius for radius, _ in rings]))
    radius, z = rings[widest]
    upper = [(0.97 * radius, z - 0.004), *rings[widest + 1 :]]
    return (part.disc(rings[: widest + 1], 9, is_standing=True), part.disc(upper, 10))


def _lid(neck: float, height: float) -> Manifold:
    """The lid with its knob, hollow below so that it covers the neck as a skin."""
    dome = [(neck + 0.003, -0.001), (neck + 0.003, 0.003), (0.6 * neck, 0.010), (0.008, 0.013)]
    knob = [(0.007, 0.016), (0.012, 0.022), (0.011, 0.029), (0.005, 0.032), (0.0, 0.032)]
    below = [(0.0, 0.008), (0.5 * neck, 0.006), (neck, 0.0005), (neck, -0.001)]
    return revolve([*below, *dome, *knob]).translate((0, 0, height))


def _band(body: Manifold, height: float) -> Manifold:
    """A painted ring around the belly of a body of revolution."""
    grown = body.scale((1.006, 1.006, 1.0)).trim_by_plane((0, 0, 1), 0.60 * height)
    return difference(grown.trim_by_plane((0, 0, -1), -0.66 * height), body)


MILL_WOODS = hex_colors("8a4b25 b9793f 3b2417 c8322b 26282c ddb57a")


def pepper_mill(vary: Draw) -> Shape:
    """A turned pepper mill: a waisted body, a metal ring, a round head with a knob."""
    radius = vary(0.0275, 0.1)
    height = vary(0.185, 0.25)
    waist = vary(0.60, 0.12) * radius
    chest = vary(0.80, 0.06) * radius
    neck = 0.60 * height
    head = 0.86 * height
    crown = neck + 0.012 * height
    depth = head - crown
    knots = [
        (radius, 0.055 * height),
        (waist, 0.30 * height),
        (chest, 0.52 * height),
        (0.72 * chest, neck),
    ]
    ball = [
        (0.72 * chest, crown),
        (0.95 * chest, crown + 0.10 * depth),
        (1.05 * chest, crown + 0.5 * depth),
    ]
    ball += [(0.75 * chest, head - 0.06 * depth), (0.30 * chest, head)]
    knob = [(0.30, 0.86), (0.36, 0.91), (0.42, 0.955), (0.24, 1.0)]
    knob = [(r * radius, z * height) for r, z in knob]
    body = [(radius - 0.0015, 0.0), (radius, 0.0015), *smooth_path(knots, 24)]
    low = (waist, 0.27 * height)
    high = (waist, 0.34 * height)
    steel = hex_rgb("c9ccd0")
    return assemble(
        pieces=(
            (
                lathe([*body, *smooth_path(ball, 20)]),
                vary.color(*MILL_WOODS, spread=0.04),
            ),
            (pipe(0.70 * chest, 0.76 * chest, neck, crown), steel),
            (lathe(smooth_path(knob, 14)), steel),
        ),
        parts=(
            part.disc(
                [(radius, 0.0), (radius, 0.055 * height), (waist, 0.28 * height)],
                8,
                is_standing=True,
            ),
            part.disc([low, high, (chest, 0.52 * height), (0.72 * chest, neck)], 8),
            part.disc([(0.72 * chest, neck - 0.002), ball[2], (0.30 * chest, head)], 8),
            part.disc([(0.30 * radius, head - 0.002), knob[2], knob[3]], 8),
        ),
        mass=vary(0.24, 0.15) * (radius / 0.0275) ** 2 * (height / 0.185),
    )


ENAMELS = hex_colors("b3262e 2f6f8f d9822b 3f6f4f c4c8cc 2a2d33")
METALS = hex_colors("c4c8cc b9bdb9 c98b5a 9fa4aa")
DARK = hex_rgb("25282c")
UP = (0.0, 0.0, 1.0)


def pot(vary: Draw) -> Shape:
    """An open cooking pot with two loop handles on its x axis."""
    radius = vary(0.100, 0.15)
    height = vary(0.110, 0.25)
    wall = vary(0.0038)
    outer = [(radius - 0.006, 0.0), (radius - 0.001, 0.003), (radius, 0.008), (radius, height)]
    inner = [(radius - wall - 0.004, 0.006), (radius - wall, 0.010), (radius - wall, height)]
    body = Vessel(outer, inner)
    outside, lining = body.layers(0.0012)
    loops = [_loop(side, radius, 0.80 * height, 0.036, 0.038) for side in (1, -1)]
    bar = rounded_rect(0.0075, 0.0100, 0.003, 3)
    handles = [difference(sweep(path, bar, UP), body.inside(), body.solid()) for path in loops]
    edge = radius + 0.002
    rim = revolve([(radius - wall, height - 0.004), (edge, height - 0.004), (edge, height)])
    corners = bar[[0, 3, 4, 7, 8, 11, 12, 15]]
    legs = [
        cell for path in loops for cell in part.sweep(part.thin_path(path, 3, 0.05), corners, UP)
    ]
    return assemble(
        label="cooking pot",
        pieces=(
            (outside, vary.color(*ENAMELS, spread=0.04)),
            (lining, hex_rgb("d4d6d8")),
            (difference(rim, body.solid(), body.inside()), hex_rgb("b4b8bc")),
            *((handle, DARK) for handle in handles),
        ),
        parts=(*body.parts(8), *legs),
        cavity=body.cavity(),
        mass=vary(1.30, 0.15) * (radius / 0.1) ** 2,
    )


def _loop(side: int, radius: float, z: float, half: float, reach: float) -> np.ndarray:
    """The middle line of a horizontal handle on the +x or -x side of a round wall, f64[20, 3]."""
    start = np.sqrt(radius**2 - half**2) - 0.002
    knots = [
        (start, -half),
        (radius + 0.55 * reach, -0.98 * half),
        (radius + 0.92 * reach, -0.6 * half),
    ]
    knots += [(radius + reach, 0.0), *((x, -y) for x, y in reversed(knots))]
    return smooth_path([(side * x, side * y, z) for x, y in knots], 20)


def frying_pan(vary: Draw) -> Shape:
    """A low pan with a long handle at +x, balanced so that it stands on its base."""
    radius = vary(0.125, 0.12)
    height = vary(0.046, 0.15)
    base = radius * vary(0.80, 0.05)
    wall = 0.0040
    bend = (base + 0.45 * (radius - base), 0.30 * height)
    outer = [(base - 0.003, 0.0), (base, 0.002), bend, (radius, height)]
    inner = [(base - 0.006, 0.006), (bend[0] - wall, bend[1] + 0.002), (radius - wall, height)]
    body = Vessel(outer, inner)
    outside, lining = body.layers(0.0010)
    length = vary(0.175, 0.12)
    start = body.outer_radius(0.72 * height) - 0.002
    path = smooth_path(
        [(start + s * length, 0, 0.72 * height + lift) for s, lift in _PAN_HANDLE], 24
    )
    sizes = np.interp(
        np.linspace(0, 1, 24), [0.0, 0.2, 0.45, 0.9, 1.0], [0.62, 0.62, 0.95, 1.0, 0.75]
    )
    bar = ellipse(0.0125, 0.0070, 16)
    grip = difference(sweep(path, bar, scales=sizes), body.inside(), body.solid())
    stations = part.thin_path(path, 3)
    scales = np.interp(stations[:, 0], path[:, 0], sizes)
    return assemble(
        pieces=(
            (outside, vary.color(*ENAMELS[5:], *ENAMELS[:5], spread=0.03)),
            (lining, hex_rgb("3a3d42")),
            (grip, vary.color(hex_rgb("6b4226"), DARK, hex_rgb("9a6a3a"), spread=0.03)),
        ),
        parts=(
            *body.parts(8),
            *part.sweep(stations, ellipse(0.0125, 0.0070, 8), scales=scales),
        ),
        cavity=body.cavity(),
        mass=vary(0.95, 0.15) * (radius / 0.125) ** 2,
    )


_PAN_HANDLE = [(0.0, 0.0), (0.25, 0.008), (0.55, 0.018), (0.85, 0.022), (1.0, 0.020)]


def colander(vary: Draw) -> Shape:
    """A metal sieve bowl with rows of holes, a flat base and two ears."""
    radius = vary(0.115, 0.12)
    height = vary(0.095, 0.15)
    wall = 0.0030
    foot = 0.50 * radius
    curve = [(0.0, 0.05), (0.29, 0.22), (0.60, 0.47), (0.85, 0.75), (1.0, 1.0)]
    outer = [(foot + (radius - foot) * r, height * z) for r, z in curve]
    inner = [(r - wall, z) for r, z in outer[1:]]
    body = Vessel([(foot, 0.0), *outer], [(foot - 0.004, 0.05 * height + 0.003), *inner])
    rows = [(0.40, 22, 0.0), (0.58, 26, 0.5), (0.76, 30, 0.0)]
    holes = [
        _hole(body, share * height, (k + shift) / num)
        for share, num, shift in rows
        for k in range(num)
    ]
    ears = [_loop(side, radius, height - 0.004, 0.030, 0.030) for side in (1, -1)]
    turns = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    rim_path = np.stack(
        [radius + 0.0035 * np.cos(turns), height - 0.0035 * (1 - np.sin(turns))], -1
    )
    shell = difference(union(body.solid(), revolve(rim_path)), *holes)
    wires = [difference(tube(path, 0.0034, UP, segments=10), body.inside()) for path in ears]
    legs = [cell for path in ears for cell in part.sweep(part.thin_path(path, 3, 0.04), 0.0036, UP)]
    return assemble(
        pieces=((union(shell, *wires), vary.color(*METALS, spread=0.03)),),
        parts=(*body.parts(8), *legs),
        cavity=body.cavity(),
        mass=vary(0.42, 0.15),
    )


def _hole(body: Vessel, z: float, turn: float) -> Manifold:
    """A drill of 6 mm through the wall at height z, `turn` of the way around."""
    drill = cylinder(0.0030, 0.030, segments=8).rotate((0, 50, 0))
    return drill.translate((body.inner_radius(z) - 0.012, 0, z - 0.010)).rotate((0, 0, 360 * turn))


TOASTER_BODIES = hex_colors("c9ccd0 b3262e 8fb7b0 e6dfcf 2e3238 d9a441")
TOASTER_DARK = hex_rgb("23262a")


def toaster(vary: Draw) -> Shape:
    """A two-slot toaster: slots along x, its lever at +x, a dial on the same end."""
    width = vary(0.265, 0.1)
    depth = vary(0.165, 0.08)
    height = vary(0.185, 0.08)
    long = 0.56 * width
    wide = vary(0.032, 0.06)
    deep = 0.55 * height
    middle = 0.21 * depth
    floor = height - deep
    slots = [box((long, wide, deep + 0.01), (0.0, side * middle), floor) for side in (-1, 1)]
    shell = above(rounded_box((width, depth, height + 0.022), 0.020, z=-0.022, segments=32))
    frame = extrude(
        rounded_rect(long + 0.024, 2 * middle + wide + 0.024, 0.010), 0.0012, height - 0.0006
    )
    base = difference(extrude(rounded_rect(width + 0.003, depth + 0.003, 0.022), 0.016), shell)
    end = width / 2
    lever = rounded_box((0.026, 0.036, 0.014), 0.004, (end + 0.010, 0.0), 0.66 * height)
    track = box((0.002, 0.008, 0.50 * height), (end, 0.0), 0.30 * height)
    dial = cylinder(0.015, 0.012, segments=32).rotate((0, 90, 0))
    dial = dial.translate((end - 0.001, 0.28 * depth, 0.32 * height))
    wall = (depth - 2 * middle - wide) / 2
    rib = 2 * middle - wide
    cheek = (width - long) / 2
    # The upper parts are sunk into their neighbours, so that no face of theirs lies bare inside the body.
    rise = deep + 0.002
    low = floor - 0.002
    span = long + 0.004
    return assemble(
        pieces=(
            (difference(shell, *slots), vary.color(*TOASTER_BODIES, spread=0.04)),
            (difference(frame, shell, *slots), TOASTER_DARK),
            (base, TOASTER_DARK),
            (difference(union(lever, track, dial), shell), TOASTER_DARK),
        ),
        parts=(
            part.box((width, depth, floor)),
            *(
                part.box((cheek, depth, rise), (side * (end - cheek / 2), 0), low)
                for side in (-1, 1)
            ),
            *(
                part.box((span, wall, rise), (0, side * (depth - wall) / 2), low)
                for side in (-1, 1)
            ),
            part.box((span, rib, rise), z=low),
            part.box((0.026, 0.036, 0.014), (end + 0.010, 0.0), 0.66 * height),
        ),
        cavity=Cavity(
            to_mesh(box((long, wide, deep), (0.0, -middle), floor)), (0.0, -middle, height)
        ),
        mass=vary(1.70, 0.15),
    )


STEELS = hex_colors("c4c8cc b9bdb9 d3b878 8d9297")
GRIPS = hex_colors("25282d 6b3f23 8e1f2b 2f4f6f")
WOODS = hex_colors("c08a4f a56b35 d8b27c 7a4a26")

# By how much parts beside the ones that carry the body keep clear of the table.
RAISE = 0.0004


def fork(vary: Draw) -> Shape:
    """A table fork that lies on the end of its handle and on the root of its four tines."""
    length = vary(0.192, 0.1)
    width = vary(0.0250, 0.1)
    thick = vary(0.0026, 0.12)
    arch = vary(0.0080, 0.2)
    ends = np.array([0.0, 0.03, 0.20, 0.45, 0.60, 0.70, 0.76, 0.83, 1.0]) * length
    lifts = np.array([0.0, 0.0, 0.0, 0.75, 1.0, 0.35, 0.0, 0.0, 0.9]) * arch
    grip = vary(0.0085, 0.12)
    handle = [0.55 * grip, grip, 0.95 * grip, 0.0042, 0.0036]
    head = [0.3, 0.5, 0.5, 0.44]
    halves = np.array([*handle, *(share * width for share in head)])
    slot = 0.125 * width
    prong = (width - 3 * slot) / 4
    places = (np.arange(4) - 1.5) * (prong + slot)
    gaps = [
        box((length, slot, 0.1), (1.30 * length, y), z=-0.01)
        for y in (places[:-1] + places[1:]) / 2
    ]
    solid = difference(_ribbon(ends, halves, lifts, thick), *gaps)
    # Only the two flat legs, the handle's end and the head, reach down to the table.
    raised = [RAISE * (k not in (0, 1, 6)) for k in range(7)]
    legs = [
        _slab(ends[k : k + 2], halves[k : k + 2], lifts[k : k + 2] + raised[k], thick)
        for k in range(7)
    ]
    end = part.hull(legs[0].vertices, legs[1].vertices)
    tines = [
        _slab(ends[-2:], np.full(2, prong / 2), lifts[-2:] + RAISE, thick, y, 0.88 * y)
        for y in places
    ]
    shift = np.array([-length / 2, 0.0, 0.0])
    parts = [piece.transform(np.eye(3), shift) for piece in (end, *legs[2:], *tines)]
    return assemble(
        label="table fork",
        pieces=((solid.translate((-length / 2, 0, 0)), vary.color(*STEELS, spread=0.03)),),
        parts=tuple(parts),
        mass=vary(0.050, 0.15),
    )


def _ribbon(ends: np.ndarray, halves: np.ndarray, lifts: np.ndarray, thick: float) -> Manifold:
    """A bent strip along x: half widths and heights of the underside at the stations `ends`."""
    x = np.linspace(ends[0], ends[-1], 65)
    low = _ease(x, ends, lifts)
    half = _ease(x, ends, halves)
    side = upright(np.column_stack([np.append(x, x[::-1]), np.append(low, low[::-1] + thick)]), 1.0)
    plan = extrude(
        np.column_stack([np.append(x, x[::-1]), np.append(-half, half[::-1])]), 0.2, -0.1
    )
    return side ^ plan


def _ease(x: np.ndarray, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values between knots, joined by half cosines so that what is flat stays flat and nothing overshoots."""
    cell = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    share = (x - knots[cell]) / (knots[cell + 1] - knots[cell])
    # Halfway between the straight line and the half cosine: rounded bends, and yet close to the parts.
    share = 0.5 * share + 0.25 * (1 - np.cos(np.pi * share))
    return values[cell] + (values[cell + 1] - values[cell]) * share


def _slab(
    ends: np.ndarray,
    halves: np.ndarray,
    lifts: np.ndarray,
    thick: float,
    start: float = 0.0,
    stop: float = 0.0,
) -> Mesh:
    """One straight leg of a bent strip, its middle going from y = `start` to y = `stop`."""
    corners = [
        (x, middle + sign * half, low + up)
        for x, half, low, middle in zip(ends, halves, lifts, (start, stop), strict=True)
        for sign in (-1, 1)
        for up in (0.0, thick)
    ]
    return part.hull(corners)


def knife(vary: Draw) -> Shape:
    """A chef's knife lying on its side, blade and handle flat on the table."""
    blade = vary(0.195, 0.15)
    grip = vary(0.125, 0.08)
    heel = vary(0.046, 0.15)
    height = vary(0.017, 0.1)
    spine = 0.012
    belly = [
        (blade, spine - 0.004),
        (0.86 * blade, spine - 0.42 * heel),
        (0.62 * blade, spine - 0.80 * heel),
    ]
    belly += [(0.35 * blade, spine - 0.96 * heel), (0.0, spine - heel)]
    edge = smooth_path(belly, 24)
    outline = np.concatenate([[(-0.012, spine), (0.70 * blade, spine)], edge, [(-0.012, -0.012)]])
    flat = extrude(outline, 0.0024)
    handle = above(rounded_box((grip, 0.026, height), 0.005, (-grip / 2 - 0.004, 0.0), z=-0.0016))
    handle = handle ^ box((1.0, 1.0, 1.0))
    spots = [(-0.2 * grip, 0.0), (-0.5 * grip, 0.0), (-0.8 * grip, 0.0)]
    rivets = union(
        *(cylinder(0.0036, height - 0.003, 0.0018, center=spot, segments=20) for spot in spots)
    )
    steel = vary.color(*STEELS[:2], spread=0.03)
    top = height - 0.0016
    return assemble(
        label="chef's knife",
        pieces=(
            (difference(flat, handle), steel),
            (handle, vary.color(*GRIPS, spread=0.03)),
            (difference(rivets, handle), steel),
        ),
        parts=(
            part.prism(
                [(-0.004, spine), (0.70 * blade, spine), *belly[1:], (-0.004, -0.012)], 0.0024
            ),
            part.prism([(0.70 * blade, spine), *belly[:2]], 0.0024),
            part.box((grip, 0.026, top), (-grip / 2 - 0.004, 0.0)),
        ),
        mass=vary(0.23, 0.15),
    )


def wooden_spoon(vary: Draw) -> Shape:
    """A cooking spoon with a flat underside, its bowl at +x."""
    length = vary(0.290, 0.12)
    reach = vary(0.040, 0.12)
    half = vary(0.028, 0.12)
    radius = vary(0.0062, 0.12)
    center = length / 2 - reach
    bowl = above(Manifold.sphere(1.0, 48).scale((reach, half, 0.017)).translate((center, 0, 0.009)))
    bowl = bowl.trim_by_plane((0, 0, -1), -0.016)
    scoop = (
        Manifold.sphere(1.0, 40)
        .scale((0.86 * reach, 0.84 * half, 0.0135))
        .translate((center, 0, 0.0188))
    )
    ends = ((-length / 2, 1.15 * radius), (center - 0.5 * reach, radius))
    stick = Manifold.hull(union(*(_rod_end(x, size) for x, size in ends)))
    rings = [(0.82, 0.0, 4), (0.86, part.LIFT, 8), (1.0, 0.009, 8), (0.91, 0.016, 8)]
    corners = [at_height(ellipse(s * reach, s * half, n), z) for s, z, n in rings]
    grip = [(x, y, z) for x, size in ends for y, z in _rod_corners(size)]
    return assemble(
        pieces=((difference(union(bowl, stick), scoop), vary.color(*WOODS)),),
        parts=(part.hull(np.concatenate(corners) + np.array([center, 0, 0])), part.hull(grip)),
        mass=vary(0.045, 0.2),
    )


def _rod_end(x: float, radius: float) -> Manifold:
    """A short round piece of a rod along x, cut flat at z = 0."""
    disc = (
        cylinder(radius, 0.002, segments=24)
        .rotate((0, 90, 0))
        .translate((x - 0.001, 0, 0.7 * radius))
    )
    return above(disc)


def _rod_corners(radius: float) -> Points2:
    """The section of such a rod as a polygon in (y, z)."""
    right = [(0.71 * radius, 0.0), (radius, 0.7 * radius), (0.5 * radius, 1.62 * radius)]
    return [*right, *((-y, z) for y, z in reversed(right))]


def cutting_board(vary: Draw) -> Shape:
    """A wooden board with a juice groove and a handle with a hole at its +x end."""
    width = vary(0.270, 0.15)
    depth = vary(0.190, 0.15)
    thick = vary(0.018, 0.2)
    handle = vary(0.085, 0.15)
    span = vary(0.062, 0.12)
    reach = width / 2 + handle
    tongue, tip = (
        rounded_rect(handle + more, span, 0.45 * span, num)
        + np.array([reach - (handle + more) / 2, 0.0])
        for more, num in ((0.06, 10), (0.01, 2))
    )
    board = union(extrude(rounded_rect(width, depth, 0.018), thick), extrude(tongue, thick))
    inner, outer = (rounded_rect(width - gap, depth - gap, 0.014) for gap in (0.040, 0.028))
    groove = difference(extrude(outer, 0.01, thick - 0.003), extrude(inner, 0.01, thick - 0.003))
    hole = cylinder(0.22 * span, 0.1, -0.01, center=(reach - 0.45 * span, 0.0))
    wood = vary.color(*WOODS)
    stripe = vary.choose(0.28, -0.28, 0.0) * depth
    band = difference(box((width, 0.10 * depth, thick), (0.0, stripe)) ^ board, groove)
    dark = tuple(0.62 * channel for channel in wood)
    return assemble(
        pieces=(
            (difference(board, groove, hole, band), wood),
            (band, (dark[0], dark[1], dark[2])),
        ),
        parts=(part.box((width, depth, thick)), part.prism(tip, thick - RAISE, RAISE)),
        mass=thick * (width * depth + handle * span) * vary(650.0, 0.1),
    )
