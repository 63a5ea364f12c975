"""Small devices: alarm clock, camera, remote control."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import palette as rgb
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, assemble, shade, vary
from cluttergen_jax.assets.shape import Shape

GLASS = (0.12, 0.16, 0.30)


def alarm_clock(rng: Rng = None) -> Shape:
    """A twin-bell alarm clock on two feet, its face towards -y."""
    radius = vary(rng, 0.048, 0.12)
    depth = vary(rng, 0.046, 0.12)
    middle = radius + 0.012
    front = -depth / 2
    case = cad.facing(radius, depth, (0, middle), front)
    body = case - cad.facing(radius - 0.005, 0.004, (0, middle), front)
    bells, bell_parts = _bells(radius, middle, vary(rng, 33.0, 0.1))
    foot = [(0.004, 0), (0.020, 0), (0.014, 0.006), (-0.002, 0.030), (-0.010, 0.026)]
    feet = [
        part.upright([(s * (0.48 * radius + x), z) for x, z in foot], 0.9 * depth) for s in (-1, 1)
    ]
    top = middle + radius
    bell = 0.5 * radius
    arch = [
        (x * bell, 0, top + 0.006 + z * bell)
        for x, z in ((-0.9, 0.55), (-0.6, 1.1), (0.6, 1.1), (0.9, 0.55))
    ]
    hammer = cad.box((0.008, 0.006, 0.020), z=top - 0.002) + cad.box(
        (0.022, 0.008, 0.008), z=top + 0.014
    )
    metal = shade(rng, (rgb.GOLD, rgb.SILVER, rgb.STEEL))
    stand = cad.union(hammer, *[cad.hull(foot.vertices) for foot in feet]) - case
    return assemble(
        name="alarm_clock",
        pieces=(
            (body, shade(rng, (rgb.RED, rgb.TEAL, *rgb.BRIGHT, rgb.CHARCOAL))),
            (cad.facing(radius - 0.006, 0.001, (0, middle), front + 0.0035), rgb.WHITE),
            (_dial(rng, radius).translate((0, front + 0.003, middle)), rgb.BLACK),
            (cad.union(*bells, cad.tube(arch, 0.003)), metal),
            (stand, rgb.GREY if rng is None else metal),
        ),
        parts=(
            part.rotate_part(
                part.disc([(radius, -depth / 2), (radius, depth / 2)], 16),
                (90, 0, 0),
                (0, 0, middle),
            ),
            *bell_parts,
            *feet,
            *part.sweep(arch[1:3], 0.004),
            part.box((0.020, 0.008, 0.022), z=top),
        ),
        mass=vary(rng, 0.30, 0.2),
    )


def _bells(radius: float, middle: float, degrees: float) -> tuple[list[Manifold], list[Mesh]]:
    """Two bells on stalks, leaning out to either side of a round case, and their parts."""
    bell = 0.50 * radius
    away = radius + 0.010
    cap = cad.above(Manifold.sphere(bell, 48)).scale((1, 1, 0.85)) + cad.cylinder(
        0.003, 0.014, z=-0.013, segments=12
    )
    dome = part.disc([(bell, 0), (0.72 * bell, 0.6 * bell), (0, 0.88 * bell)], 10)
    solids = []
    parts = []
    for side in (-1, 1):
        turn = np.radians(side * degrees)
        at = (away * np.sin(turn), 0.0, middle + away * np.cos(turn))
        solids.append(cap.rotate((0, side * degrees, 0)).translate(at))
        parts.append(part.rotate_part(dome, (0, side * degrees, 0), at))
    return solids, parts


def _dial(rng: Rng, radius: float) -> Manifold:
    """Twelve marks and two hands, around the origin, facing -y."""
    marks = [
        cad.box((0.0022, 0.001, 0.007), z=radius - 0.016).rotate((0, 30 * k, 0)) for k in range(12)
    ]
    turns = (-58.0, 60.0) if rng is None else rng.uniform(0, 360, 2)
    hands = [
        cad.box((0.0032, 0.001, reach * radius), z=-0.004).rotate((0, float(turn), 0))
        for reach, turn in zip((0.48, 0.70), turns, strict=True)
    ]
    return cad.union(*marks, *hands, cad.facing(0.004, 0.002, (0, 0), -0.001))


def camera(rng: Rng = None) -> Shape:
    """A camera with a lens towards -y, a viewfinder hump and a grip."""
    width = vary(rng, 0.132, 0.08)
    depth = vary(rng, 0.048, 0.1)
    height = vary(rng, 0.082, 0.08)
    lens = vary(rng, 0.031, 0.08)
    reach = vary(rng, 0.040, 0.25)
    x = 0.10 * width
    front = -depth / 2
    middle = 0.49 * height
    at = (x, middle)
    nose = front - reach
    band = cad.box((1.0, 1.0, 0.54 * height), z=0.20 * height)

    def block(inset: float) -> Manifold:
        outline = cad.rounded_rect(width - 2 * inset, depth - 2 * inset, 0.010 - inset)
        return cad.extrude(outline, height - 2 * inset, inset)

    barrel = cad.union(
        cad.facing(lens, reach, at, nose + 0.006), cad.facing(lens - 0.003, reach, at, nose)
    )
    grip = cad.rounded_box(
        (0.030, 0.026, 0.92 * height), 0.008, (0.017 - width / 2, front - 0.004), 0.02 * height
    )
    hump = [(x - 0.026, height - 0.0015), (x + 0.026, height - 0.0015)]
    hump += [(x + 0.016, height + 0.020), (x - 0.016, height + 0.020)]
    prism = cad.upright(hump, 0.68 * depth)
    inner = block(0.001) + prism.translate((0, 0, -0.001)).scale((1, 0.94, 1))
    # All of the dark body is one solid and the trim is a thin shell over it: nothing lies hidden inside.
    dark = cad.union(inner, block(-0.001) ^ band, barrel, grip) - cad.facing(
        lens - 0.007, 0.006, at, nose
    )
    shell = block(0.0) + prism - inner - band - cad.facing(lens, 1.0, at, -1.0) - grip
    rings = [
        cad.facing(lens + 0.0012, 0.004, at, front - share * reach)
        - cad.facing(lens - 0.001, 1.0, at, -0.5)
        for share in (0.35, 0.62)
    ]
    knobs = [
        cad.cylinder(radius, rise, z=height - 0.001, center=(share * width, 0), segments=24)
        for radius, rise, share in ((0.010, 0.008, 0.40), (0.007, 0.006, -0.40))
    ]
    trim = shade(rng, (rgb.SILVER, rgb.STEEL, rgb.CHARCOAL, rgb.GOLD))
    return assemble(
        name="camera",
        pieces=(
            (dark, shade(rng, (rgb.BLACK, *rgb.DARK, (0.42, 0.24, 0.15)), 0.02)),
            (cad.union(shell, *rings), trim),
            (cad.facing(lens - 0.0075, 0.003, at, nose + 0.004), GLASS),
            (
                cad.union(*knobs),
                rgb.RED if rng is None else shade(rng, (rgb.RED, rgb.BLACK, rgb.ORANGE)),
            ),
            (
                cad.box((0.020, 0.002, 0.010), (x, -0.34 * depth - 0.0005), height + 0.005),
                rgb.WHITE,
            ),
        ),
        parts=(
            part.box((width, depth, height)),
            part.upright(hump, 0.68 * depth),
            part.rotate_part(
                part.disc([(lens, 0), (lens, reach)], 14), (90, 0, 0), (x, front, middle)
            ),
            part.box(
                (0.028, 0.022, 0.90 * height), (0.017 - width / 2, front - 0.005), 0.03 * height
            ),
        ),
        mass=vary(rng, 0.55, 0.2),
    )


def remote_control(rng: Rng = None) -> Shape:
    """A television remote lying on its back, its far end towards +y."""
    width = vary(rng, 0.048, 0.12)
    length = vary(rng, 0.175, 0.12)
    height = vary(rng, 0.020, 0.15)
    foot = cad.rounded_rect(0.9 * width, 0.96 * length, 0.010)
    waist = cad.rounded_rect(width, length, 0.012)
    levels = ((foot, 0.0), (waist, 0.5 * height), (foot, height))
    body = cad.hull(np.concatenate([np.insert(outline, 2, z, axis=1) for outline, z in levels]))
    step = 0.27 * width

    def button(column: float, row: float, radius: float = 0.0043) -> Manifold:
        """A round button: columns count from the middle, rows from the far end."""
        at = (column * step, (0.5 - row) * length)
        return cad.cylinder(
            radius, 0.003, z=height - 0.0006, top=0.88 * radius, center=at, segments=20
        )

    numbers = [button(c, 0.17 + 0.065 * r) for r in range(4) for c in (-1, 0, 1)]
    inner = cad.cylinder(0.17 * width, 1.0, center=(0, -0.03 * length))
    ring = button(0, 0.53, 0.30 * width) - inner
    keys = [button(c, row) for row in (0.82, 0.885) for c in (-1, 0, 1)]
    tinted = [
        (button(-1, 0.075, 0.005), rgb.RED),
        (cad.union(*numbers, button(0, 0.53, 0.10 * width)), rgb.WHITE),
        (cad.union(ring, *keys, button(1, 0.075)), rgb.GREY),
        *[
            (button(0.72 * (k - 1.5), 0.735, 0.0036), color)
            for k, color in enumerate((rgb.RED, rgb.GREEN, rgb.YELLOW, rgb.BLUE))
        ],
    ]
    footing = [(sx * 0.42 * width, sy * 0.45 * length, 0.0) for sx in (-1, 1) for sy in (-1, 1)]
    sides = [
        (sx * width * a, sy * length * b, z)
        for sx in (-0.5, 0.5)
        for sy in (-0.5, 0.5)
        for a, b, z in (
            (1, 0.95, 0.5 * height),
            (0.8, 1, 0.5 * height),
            (0.87, 0.94, height + 0.001),
        )
    ]
    return assemble(
        name="remote_control",
        pieces=(
            (body, shade(rng, (rgb.CHARCOAL, *rgb.DARK, rgb.NAVY, rgb.STEEL))),
            *[(s, c) for s, c in tinted],
        ),
        parts=(part.hull(footing + sides),),
        mass=vary(rng, 0.14, 0.2),
    )
