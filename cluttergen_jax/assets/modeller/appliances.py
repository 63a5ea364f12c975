"""Appliances: toaster."""

from __future__ import annotations

from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, hex_rgb, made, shade, vary
from cluttergen_jax.assets.shape import Cavity, Shape

BODIES = tuple(hex_rgb(code) for code in ("c9ccd0", "b3262e", "8fb7b0", "e6dfcf", "2e3238", "d9a441"))
DARK = hex_rgb("23262a")


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
            cad.piece(cad.difference(shell, *slots), shade(rng, BODIES, 0.04)),
            cad.piece(cad.difference(frame, shell, *slots), DARK),
            cad.piece(base, DARK),
            cad.piece(cad.difference(cad.union(lever, track, dial), shell), DARK),
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
