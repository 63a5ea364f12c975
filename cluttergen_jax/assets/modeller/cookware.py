"""Cookware and what cooks by itself: pot, frying pan, colander, toaster."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, hex_rgb, made, shade, vary
from cluttergen_jax.assets.modeller.vessel import Vessel
from cluttergen_jax.assets.shape import Cavity, Shape

ENAMELS = tuple(hex_rgb(code) for code in ("b3262e", "2f6f8f", "d9822b", "3f6f4f", "c4c8cc", "2a2d33"))
METALS = tuple(hex_rgb(code) for code in ("c4c8cc", "b9bdb9", "c98b5a", "9fa4aa"))
DARK = hex_rgb("25282c")
UP = (0.0, 0.0, 1.0)


def pot(rng: Rng = None) -> Shape:
    """An open cooking pot with two loop handles on its x axis."""
    radius, height, wall = vary(rng, 0.100, 0.15), vary(rng, 0.110, 0.25), vary(rng, 0.0038)
    outer = [(radius - 0.006, 0.0), (radius - 0.001, 0.003), (radius, 0.008), (radius, height)]
    inner = [(radius - wall - 0.004, 0.006), (radius - wall, 0.010), (radius - wall, height)]
    body = Vessel(outer, inner)
    outside, lining = body.layers(0.0012)
    loops = [_loop(side, radius, 0.80 * height, 0.036, 0.038) for side in (1, -1)]
    bar = cad.rounded_rect(0.0075, 0.0100, 0.003, 3)
    handles = [cad.difference(cad.sweep(path, bar, UP), body.inside(), body.solid()) for path in loops]
    edge = radius + 0.002
    rim = cad.revolve([(radius - wall, height - 0.004), (edge, height - 0.004), (edge, height)])
    corners = bar[[0, 3, 4, 7, 8, 11, 12, 15]]
    legs = [cell for path in loops for cell in part.sweep(part.thinned(path, 3, 0.05), corners, UP)]
    return made(
        name="pot",
        label="cooking pot",
        pieces=(
            cad.piece(outside, shade(rng, ENAMELS, 0.04)),
            cad.piece(lining, hex_rgb("d4d6d8")),
            cad.piece(cad.difference(rim, body.solid(), body.inside()), hex_rgb("b4b8bc")),
            *(cad.piece(handle, DARK) for handle in handles),
        ),
        parts=(*body.parts(8), *legs),
        cavity=body.cavity(),
        mass=vary(rng, 1.30, 0.15) * (radius / 0.1) ** 2,
    )


def _loop(side: int, radius: float, z: float, half: float, reach: float) -> np.ndarray:
    """The middle line of a horizontal handle on the +x or -x side of a round wall, f64[20, 3]."""
    start = np.sqrt(radius**2 - half**2) - 0.002
    knots = [(start, -half), (radius + 0.55 * reach, -0.98 * half), (radius + 0.92 * reach, -0.6 * half)]
    knots += [(radius + reach, 0.0), *((x, -y) for x, y in reversed(knots))]
    return cad.smooth_path([(side * x, side * y, z) for x, y in knots], 20)


def frying_pan(rng: Rng = None) -> Shape:
    """A low pan with a long handle at +x, balanced so that it stands on its base."""
    radius, height = vary(rng, 0.125, 0.12), vary(rng, 0.046, 0.15)
    base, wall = radius * vary(rng, 0.80, 0.05), 0.0040
    bend = (base + 0.45 * (radius - base), 0.30 * height)
    outer = [(base - 0.003, 0.0), (base, 0.002), bend, (radius, height)]
    inner = [(base - 0.006, 0.006), (bend[0] - wall, bend[1] + 0.002), (radius - wall, height)]
    body = Vessel(outer, inner)
    outside, lining = body.layers(0.0010)
    length, start = vary(rng, 0.175, 0.12), body.outer_radius(0.72 * height) - 0.002
    path = cad.smooth_path([(start + s * length, 0, 0.72 * height + lift) for s, lift in _PAN_HANDLE], 24)
    sizes = np.interp(np.linspace(0, 1, 24), [0.0, 0.2, 0.45, 0.9, 1.0], [0.62, 0.62, 0.95, 1.0, 0.75])
    bar = cad.ellipse(0.0125, 0.0070, 16)
    grip = cad.difference(cad.sweep(path, bar, scales=sizes), body.inside(), body.solid())
    stations = part.thinned(path, 3)
    scales = np.interp(stations[:, 0], path[:, 0], sizes)
    return made(
        name="frying_pan",
        pieces=(
            cad.piece(outside, shade(rng, (*ENAMELS[5:], *ENAMELS[:5]), 0.03)),
            cad.piece(lining, hex_rgb("3a3d42")),
            cad.piece(grip, shade(rng, (hex_rgb("6b4226"), DARK, hex_rgb("9a6a3a")), 0.03)),
        ),
        parts=(*body.parts(8), *part.sweep(stations, cad.ellipse(0.0125, 0.0070, 8), scales=scales)),
        cavity=body.cavity(),
        mass=vary(rng, 0.95, 0.15) * (radius / 0.125) ** 2,
    )


_PAN_HANDLE = [(0.0, 0.0), (0.25, 0.008), (0.55, 0.018), (0.85, 0.022), (1.0, 0.020)]


def colander(rng: Rng = None) -> Shape:
    """A metal sieve bowl with rows of holes, a flat base and two ears."""
    radius, height, wall = vary(rng, 0.115, 0.12), vary(rng, 0.095, 0.15), 0.0030
    foot = 0.50 * radius
    curve = [(0.0, 0.05), (0.29, 0.22), (0.60, 0.47), (0.85, 0.75), (1.0, 1.0)]
    outer = [(foot + (radius - foot) * r, height * z) for r, z in curve]
    inner = [(r - wall, z) for r, z in outer[1:]]
    body = Vessel([(foot, 0.0), *outer], [(foot - 0.004, 0.05 * height + 0.003), *inner])
    rows = [(0.40, 22, 0.0), (0.58, 26, 0.5), (0.76, 30, 0.0)]
    holes = [_hole(body, share * height, (k + shift) / num) for share, num, shift in rows for k in range(num)]
    ears = [_loop(side, radius, height - 0.004, 0.030, 0.030) for side in (1, -1)]
    turns = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    rim_path = np.stack([radius + 0.0035 * np.cos(turns), height - 0.0035 * (1 - np.sin(turns))], -1)
    shell = cad.difference(cad.union(body.solid(), cad.revolve(rim_path)), *holes)
    wires = [cad.difference(cad.tube(path, 0.0034, UP, segments=10), body.inside()) for path in ears]
    legs = [cell for path in ears for cell in part.sweep(part.thinned(path, 3, 0.04), 0.0036, UP)]
    return made(
        name="colander",
        pieces=(cad.piece(cad.union(shell, *wires), shade(rng, METALS, 0.03)),),
        parts=(*body.parts(8), *legs),
        cavity=body.cavity(),
        mass=vary(rng, 0.42, 0.15),
    )


def _hole(body: Vessel, z: float, turn: float) -> Manifold:
    """A drill of 6 mm through the wall at height z, `turn` of the way around."""
    drill = cad.cylinder(0.0030, 0.030, segments=8).rotate((0, 50, 0))
    return drill.translate((body.inner_radius(z) - 0.012, 0, z - 0.010)).rotate((0, 0, 360 * turn))


TOASTER_BODIES = tuple(hex_rgb(code) for code in ("c9ccd0", "b3262e", "8fb7b0", "e6dfcf", "2e3238", "d9a441"))
TOASTER_DARK = hex_rgb("23262a")


def toaster(rng: Rng = None) -> Shape:
    """A two-slot toaster: slots along x, its lever at +x, a dial on the same end."""
    width, depth, height = vary(rng, 0.265, 0.1), vary(rng, 0.165, 0.08), vary(rng, 0.185, 0.08)
    long, wide, deep = 0.56 * width, vary(rng, 0.032, 0.06), 0.55 * height
    middle = 0.21 * depth
    floor = height - deep
    slots = [cad.box((long, wide, deep + 0.01), (0.0, side * middle), floor) for side in (-1, 1)]
    shell = cad.above(cad.rounded_box((width, depth, height + 0.022), 0.020, z=-0.022, segments=32))
    frame = cad.extrude(
        cad.rounded_rect(long + 0.024, 2 * middle + wide + 0.024, 0.010), 0.0012, height - 0.0006
    )
    base = cad.difference(cad.extrude(cad.rounded_rect(width + 0.003, depth + 0.003, 0.022), 0.016), shell)
    end = width / 2
    lever = cad.rounded_box((0.026, 0.036, 0.014), 0.004, (end + 0.010, 0.0), 0.66 * height)
    track = cad.box((0.002, 0.008, 0.50 * height), (end, 0.0), 0.30 * height)
    dial = cad.cylinder(0.015, 0.012, segments=32).rotate((0, 90, 0))
    dial = dial.translate((end - 0.001, 0.28 * depth, 0.32 * height))
    wall = (depth - 2 * middle - wide) / 2
    rib = 2 * middle - wide
    cheek = (width - long) / 2
    # The upper parts are sunk into their neighbours, so that no face of theirs lies bare inside the body.
    rise, low, span = deep + 0.002, floor - 0.002, long + 0.004
    return made(
        name="toaster",
        pieces=(
            cad.piece(cad.difference(shell, *slots), shade(rng, TOASTER_BODIES, 0.04)),
            cad.piece(cad.difference(frame, shell, *slots), TOASTER_DARK),
            cad.piece(base, TOASTER_DARK),
            cad.piece(cad.difference(cad.union(lever, track, dial), shell), TOASTER_DARK),
        ),
        parts=(
            part.box((width, depth, floor)),
            *(part.box((cheek, depth, rise), (side * (end - cheek / 2), 0), low) for side in (-1, 1)),
            *(part.box((span, wall, rise), (0, side * (depth - wall) / 2), low) for side in (-1, 1)),
            part.box((span, rib, rise), z=low),
            part.box((0.026, 0.036, 0.014), (end + 0.010, 0.0), 0.66 * height),
        ),
        cavity=Cavity(
            cad.to_mesh(cad.box((long, wide, deep), (0.0, -middle), floor)), (0.0, -middle, height)
        ),
        mass=vary(rng, 1.70, 0.15),
    )
