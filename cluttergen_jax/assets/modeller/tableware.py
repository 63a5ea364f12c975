"""Tableware: bowl, dinner plate, mug, water glass, wine glass, teapot, pepper mill."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import (
    Rng,
    assemble,
    choose,
    hex_colors,
    hex_rgb,
    shade,
    vary,
)
from cluttergen_jax.assets.modeller.vessel import Vessel
from cluttergen_jax.assets.shape import Cavity, Shape

PLATE_GLAZES = hex_colors("4f86a6 c9713f 6f8f5a a43f4f e3ded2 2f3e55 d8b64c")
PORCELAIN = hex_colors("f1eee6 e6ecef f3e6d6 dfe7dc")


def bowl(rng: Rng = None) -> Shape:
    """A cereal bowl on a flat foot, glazed outside, light inside."""
    radius = vary(rng, 0.076)
    height = vary(rng, 0.064)
    foot = radius * (0.46 if rng is None else rng.uniform(0.40, 0.55))
    wall = vary(rng, 0.0046)
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
        name="bowl",
        label="cereal bowl",
        pieces=((outside, shade(rng, PLATE_GLAZES)), (lining, (0.96, 0.94, 0.90))),
        parts=body.parts(8, cuts=(floor + 0.33 * (height - floor),)),
        cavity=body.cavity(),
        mass=vary(rng, 0.38, 0.15),
    )


def dinner_plate(rng: Rng = None) -> Shape:
    """A flat plate with a raised rim and a coloured band near its edge."""
    radius = vary(rng, 0.130)
    height = vary(rng, 0.022, 0.2)
    well = radius * vary(rng, 0.66, 0.08)
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
    band = cad.revolve(
        [(near, low - 0.0010), (far, high - 0.0010), (far, high + 0.0003), (near, low + 0.0003)]
    )
    return assemble(
        name="dinner_plate",
        pieces=(
            (body.solid() - band, shade(rng, PORCELAIN, 0.02)),
            (band, shade(rng, PLATE_GLAZES)),
        ),
        parts=body.parts(10),
        cavity=body.cavity(),
        mass=vary(rng, 0.55, 0.2),
    )


MUG_GLAZES = hex_colors("2f6f9f b8452f 3f7f5f e0a63a 7a4b8c 37424e d9d3c7")
GLASS = hex_colors("a9d3e6 b9dfd0 c9c4e4 d7e0e4")


def mug(rng: Rng = None) -> Shape:
    """A coffee mug with a light lining and one handle on its +x side."""
    radius = vary(rng, 0.041)
    height = vary(rng, 0.096, 0.2)
    foot = radius * (0.95 if rng is None else rng.uniform(0.78, 1.0))
    wall = vary(rng, 0.0042)
    outer = [(foot - 0.004, 0.0), (foot - 0.001, 0.002), (foot, 0.005), (radius, height - 0.0015)]
    inner = [(foot - wall - 0.004, 0.006), (foot - wall, 0.010), (radius - wall, height - 0.0015)]
    body = Vessel([*outer, (radius - 0.0012, height)], [*inner, (radius - wall + 0.0012, height)])
    path = _handle_path(rng, body, height)
    section = cad.ellipse(vary(rng, 0.0068), vary(rng, 0.0038), 20)
    outside, lining = body.layers(0.0012)
    outside = cad.union(outside, cad.sweep(path, section) - body.inside() - lining)
    return assemble(
        name="mug",
        label="coffee mug",
        pieces=((outside, shade(rng, MUG_GLAZES)), (lining, (0.95, 0.93, 0.89))),
        parts=(
            *body.parts(8),
            *part.sweep(
                part.thin_path(path, 4, 0.04), section[[1, 4, 6, 9, 11, 14, 16, 19]] * 1.04
            ),
        ),
        cavity=body.cavity(),
        mass=vary(rng, 0.33, 0.1),
    )


def _handle_path(rng: Rng, body: Vessel, height: float) -> np.ndarray:
    """The middle line of a mug's handle in the xz plane, both ends inside the wall, f64[24, 3]."""
    high = height * vary(rng, 0.82, 0.05)
    low = height * vary(rng, 0.24, 0.25)
    reach = vary(rng, 0.031)
    drop = high - low
    knots = [
        (body.outer_radius(high) - 0.003, 0.0, high),
        (body.outer_radius(high) + 0.62 * reach, 0.0, high + 0.02 * drop),
        (body.outer_radius(high) + reach, 0.0, high - 0.35 * drop),
        (body.outer_radius(low) + 0.75 * reach, 0.0, low + 0.15 * drop),
        (body.outer_radius(low) - 0.003, 0.0, low - 0.02 * drop),
    ]
    return cad.smooth_path(knots, 24)


def water_glass(rng: Rng = None) -> Shape:
    """A tumbler of clear glass with a heavy base."""
    radius = vary(rng, 0.037)
    height = vary(rng, 0.120, 0.2)
    foot = radius * (0.82 if rng is None else rng.uniform(0.72, 0.98))
    wall = vary(rng, 0.0026)
    base = vary(rng, 0.011, 0.3)
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
        name="water_glass",
        pieces=((body.solid(), shade(rng, GLASS), 0.5),),
        parts=body.parts(8),
        cavity=body.cavity(),
        mass=vary(rng, 0.25, 0.15),
    )


def wine_glass(rng: Rng = None) -> Shape:
    """A stemmed glass: a foot, a thin stem and a tulip-shaped bowl."""
    belly = vary(rng, 0.041, 0.12)
    mouth = choose(rng, (0.80, 0.74, 0.86, 0.92))
    foot = vary(rng, 0.036, 0.08)
    stem = vary(rng, 0.085, 0.2)
    radius = vary(rng, 0.0046, 0.1)
    depth = vary(rng, 0.100, 0.15)
    wall = 0.0024
    base = stem + 0.010
    wide = stem + 0.010 + 0.42 * depth
    rim = stem + 0.010 + depth
    curve = [(0.45, 0.06), (0.72, 0.16), (0.90, 0.27), (1.0, 0.42), (0.97, 0.62)]
    outside = [(belly * r, base + depth * z) for r, z in curve] + [(belly * mouth, rim)]
    inside = [(r - wall, z) for r, z in outside]
    lower = [(foot, 0.0), (foot, 0.0022), (0.3 * foot, 0.0055), (radius, 0.014), (radius, stem)]
    body = Vessel([(0.35 * belly, base), *outside], [(0.3 * belly, base + 0.0035), *inside])
    profile = [(0.0, 0.0), *lower, *body.outer, *reversed(body.inner), (0.0, body.floor)]
    cavity = cad.revolve([(0.0, body.floor), *body.inner, (0.0, rim)])
    return assemble(
        name="wine_glass",
        pieces=((cad.revolve(profile), shade(rng, GLASS), 0.5),),
        parts=(
            part.disc([(foot, 0.0), (foot, 0.0022), (0.25 * foot, 0.0060)], 8, is_standing=True),
            part.disc([(1.1 * radius, 0.004), (1.1 * radius, base + 0.001)], 6),
            *body.parts(8, cuts=(wide,)),
        ),
        cavity=Cavity(cad.to_mesh(cavity), (0.0, 0.0, rim)),
        mass=vary(rng, 0.16, 0.15),
    )


TEAPOT_GLAZES = hex_colors("e8e2d4 b3262e 2f6f8f d9822b 3f6f4f 7a5a8c")
TRIMS = hex_colors("2f5f9f 8a5a2b 25282c")


def teapot(rng: Rng = None) -> Shape:
    """A round teapot with its lid on, a spout at +x and a handle at -x."""
    radius = vary(rng, 0.072, 0.1)
    height = vary(rng, 0.105, 0.12)
    base = 0.62 * radius
    neck = 0.48 * radius
    reach = vary(rng, 0.058, 0.1)
    belly = [(base, 0.004), (0.93 * radius, 0.26 * height), (radius, 0.48 * height)]
    belly += [(0.85 * radius, 0.77 * height), (neck, height)]
    body = cad.revolve(
        [(0.0, 0.0), (base - 0.003, 0.0), *cad.smooth_path(belly, 30), (0.0, height)]
    )
    rising = [(0.80, 0.0, 0.34), (1.0, 0.38, 0.46), (1.0, 0.66, 0.74), (1.0, 1.0, 0.97)]
    spout = cad.smooth_path([(r * radius + s * reach, 0, z * height) for r, s, z in rising], 20)
    falling = [
        (0.80, 0.0, 0.80),
        (1.0, 0.026, 0.90),
        (1.0, 0.046, 0.62),
        (1.0, 0.028, 0.32),
        (0.9, 0.0, 0.24),
    ]
    arm = cad.smooth_path([(-r * radius - x, 0, z * height) for r, x, z in falling], 24)
    bar = cad.ellipse(0.0070, 0.0052, 16)
    sizes = np.linspace(1.35, 0.62, 20)
    bore = cad.tube(spout[-4:] + np.array([0.0004, 0, 0.0008]), 0.0042)
    vessel = cad.difference(
        cad.union(body, cad.tube(spout, 0.0115, scales=sizes), cad.sweep(arm, bar)), bore
    )
    trim = shade(rng, TRIMS, 0.03)
    cells = part.thin_path(spout, 2)
    return assemble(
        name="teapot",
        pieces=(
            (vessel, shade(rng, TEAPOT_GLAZES, 0.04)),
            (_lid(neck, height), trim),
            (cad.difference(_band(body, height), vessel), trim),
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
        mass=vary(rng, 0.85, 0.15),
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
    return cad.revolve([*below, *dome, *knob]).translate((0, 0, height))


def _band(body: Manifold, height: float) -> Manifold:
    """A painted ring around the belly of a body of revolution."""
    grown = body.scale((1.006, 1.006, 1.0)).trim_by_plane((0, 0, 1), 0.60 * height)
    return cad.difference(grown.trim_by_plane((0, 0, -1), -0.66 * height), body)


MILL_WOODS = hex_colors("8a4b25 b9793f 3b2417 c8322b 26282c ddb57a")


def pepper_mill(rng: Rng = None) -> Shape:
    """A turned pepper mill: a waisted body, a metal ring, a round head with a knob."""
    radius = vary(rng, 0.0275, 0.1)
    height = vary(rng, 0.185, 0.25)
    waist = vary(rng, 0.60, 0.12) * radius
    chest = vary(rng, 0.80, 0.06) * radius
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
    body = [(0.0, 0.0), (radius - 0.0015, 0.0), (radius, 0.0015), *cad.smooth_path(knots, 24)]
    ring = [
        (0.70 * chest, neck),
        (0.76 * chest, neck),
        (0.76 * chest, crown),
        (0.70 * chest, crown),
    ]
    low = (waist, 0.27 * height)
    high = (waist, 0.34 * height)
    steel = hex_rgb("c9ccd0")
    return assemble(
        name="pepper_mill",
        pieces=(
            (
                cad.revolve([*body, *cad.smooth_path(ball, 20), (0.0, head)]),
                shade(rng, MILL_WOODS, 0.04),
            ),
            (cad.revolve(ring), steel),
            (cad.revolve([(0.0, head), *cad.smooth_path(knob, 14), (0.0, height)]), steel),
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
        mass=vary(rng, 0.24, 0.15) * (radius / 0.0275) ** 2 * (height / 0.185),
    )
