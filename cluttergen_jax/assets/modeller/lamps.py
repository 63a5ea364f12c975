"""Things that give light: a desk lamp, a candle in its holder."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.modeller import palette as rgb
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, made, shade, vary
from cluttergen_jax.assets.shape import Shape

WARM = (1.0, 0.93, 0.66)


def desk_lamp(rng: Rng = None) -> Shape:
    """A jointed lamp on a heavy round foot, its shade looking down to the front (-x)."""
    size = vary(rng, 1.0, 0.10)
    radius, lean = 0.088 * size, vary(rng, 0.075, 0.25) * size
    foot = (0.020 * size, 0.0, 0.016 * size)
    elbow = (lean, 0.0, vary(rng, 0.225, 0.12) * size)
    head = (elbow[0] - 0.110 * size, 0.0, elbow[2] + vary(rng, 0.115, 0.2) * size)
    mouth, depth, pitch = 0.058 * size, 0.085 * size, vary(rng, 28.0, 0.3)
    # The shade is drawn hanging from the origin, then pitched so that its mouth looks to the front.
    outline = [(0.019 * size, 0.0), (mouth, -depth)]
    shell = [*outline, (mouth - 0.002, -depth), (0.017 * size, -0.003), (0.0, -0.003), (0.0, 0.0)]
    shade_solid = cad.union(
        cad.revolve(shell[::-1]), cad.cylinder(0.019 * size, 0.018 * size, top=0.012 * size)
    )
    glow = cad.cylinder(mouth * 0.97 - 0.004, 0.004, z=-depth + 0.004)
    shroud = cad.cylinder(mouth, depth, z=-depth, top=0.019 * size).rotate((0, pitch, 0)).translate(head)
    arms = cad.union(*[cad.tube([a, b], 0.0065 * size) for a, b in ((foot, elbow), (elbow, head))]) - shroud
    joints = cad.union(*[_hinge(point, 0.013 * size) for point in (foot, elbow, head)]) - shroud
    color = shade(rng, (rgb.CRIMSON, rgb.TEAL, rgb.CHARCOAL, *rgb.BRIGHT))
    base = [(radius, 0.0), (radius, 0.010 * size), (radius * 0.72, 0.020 * size)]
    parts = [
        part.disc([(radius, 0.0), (0.86 * radius, 0.020 * size)], 14, is_standing=True),
        *part.sweep([foot, elbow], 0.008 * size),
        *part.sweep([elbow, head], 0.008 * size),
        part.turned(part.disc([(mouth, -depth), (0.019 * size, 0.012 * size)], 14), (0, pitch, 0), head),
    ]
    return made(
        name="desk_lamp",
        pieces=(
            cad.piece(cad.revolve([(0, 0), *base, (0, 0.020 * size)]), color),
            cad.piece(arms, shade(rng, (rgb.SILVER, rgb.GOLD, rgb.CHARCOAL))),
            cad.piece(joints, rgb.BLACK),
            cad.piece(shade_solid.rotate((0, pitch, 0)).translate(head), color),
            cad.piece(glow.rotate((0, pitch, 0)).translate(head), WARM),
        ),
        parts=tuple(parts),
        mass=vary(rng, 1.4, 0.2),
    )


def _hinge(center: tuple[float, float, float], radius: float) -> Manifold:
    """A short pin across the arm, along y."""
    pin = cad.cylinder(radius, 1.7 * radius, z=-0.85 * radius, segments=24)
    return pin.rotate((90, 0, 0)).translate(center)


def candle(rng: Rng = None) -> Shape:
    """A burning candle in a chamberstick: a dish with a socket and a finger ring."""
    radius, height = vary(rng, 0.019, 0.12), vary(rng, 0.115, 0.25)
    dish, lip = vary(rng, 0.058, 0.12), 0.012
    floor = 0.006
    saucer = [(0.0, 0.0), (0.72 * dish, 0.0), (dish, lip), (dish - 0.003, lip + 0.001), (0.68 * dish, floor)]
    socket = [(0.0, 0.0), (radius + 0.004, 0.0), (radius + 0.005, 0.022), (0.0, 0.022)]
    turns = np.linspace(0.0, 2 * np.pi, 25)[:-1]
    reach, ring, bar = dish + 0.010, 0.014, 0.0035
    loop = cad.revolve(cad.ellipse(bar, bar, 10) + np.array([ring, 0.0]), 32)
    loop = loop.rotate((90, 0, 0)).translate((reach, 0, lip + 0.007))
    wax = cad.union(cad.cylinder(radius, height, z=floor), *_drips(rng, radius, floor + height))
    wick_top = floor + height + 0.010
    stations = np.array([0.0, 0.12, 0.3, 0.5, 0.75, 1.0])
    flame = cad.sweep(
        [(0.0, 0.0, wick_top - 0.006 + 0.030 * s) for s in stations],
        cad.ellipse(0.008, 0.008, 20),
        scales=[0.35, 0.8, 1.0, 0.85, 0.42, 0.03],
    )
    square = [(ring + bar, -bar), (ring + bar, bar), (ring - bar, bar), (ring - bar, -bar)]
    cells = [
        part.turned(cell, (90, 0, 0), (reach, 0, lip + 0.007))
        for cell in part.ring_sectors([(r * 1.08, z) for r, z in square], 5, phase=turns[6])
    ]
    metal = cad.union(cad.revolve([*saucer, (0.0, floor)]), cad.revolve(socket), loop)
    return made(
        name="candle",
        label="candle in a holder",
        pieces=(
            cad.piece(
                metal - cad.cylinder(radius, 0.1, z=floor),
                shade(rng, (rgb.GOLD, rgb.TEAL, rgb.SILVER, rgb.CRIMSON)),
            ),
            cad.piece(wax, shade(rng, (rgb.CREAM, rgb.WHITE, rgb.PINK, rgb.CRIMSON))),
            cad.piece(cad.cylinder(0.0012, 0.012, z=floor + height, segments=10), rgb.BLACK),
            cad.piece(flame, shade(rng, (rgb.ORANGE,))),
            cad.piece(
                flame.scale((1.02, 1.02, 1.0)).trim_by_plane((0, 0, -1), -wick_top - 0.002), rgb.YELLOW
            ),
        ),
        parts=(
            part.disc([(0.72 * dish, 0.0), (dish, lip)], 14, is_standing=True),
            part.disc([(radius, 0.002), (radius, floor + height)], 12),
            part.disc([(0.007, wick_top), (0.0, wick_top + 0.024), (0.0, floor + height - 0.002)], 8),
            *cells,
        ),
        mass=vary(rng, 0.30, 0.2),
    )


def _drips(rng: Rng, radius: float, top: float) -> list[Manifold]:
    """Runs of wax down from the edge of the candle."""
    angles = (0.3, 1.9, 3.0, 4.6, 5.4) if rng is None else rng.uniform(0, 2 * np.pi, 5)
    lengths = (0.022, 0.034, 0.016, 0.028, 0.018)
    drips = []
    for angle, length in zip(angles, lengths, strict=True):
        x, y = (radius - 0.0005) * np.cos(angle), (radius - 0.0005) * np.sin(angle)
        run = [(x, y, top - 0.001), (x, y, top - length / 2), (x, y, top - length)]
        drips.append(cad.tube(run, 0.003, side=(1, 0, 0), scales=[0.7, 0.8, 1.0], segments=10))
    return drips
