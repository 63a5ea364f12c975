"""Things to drink from: mug, water glass, wine glass."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, choose, hex_rgb, made, shade, vary
from cluttergen_jax.assets.modeller.vessel import Vessel
from cluttergen_jax.assets.shape import Cavity, Shape

GLAZES = tuple(
    hex_rgb(code) for code in ("2f6f9f", "b8452f", "3f7f5f", "e0a63a", "7a4b8c", "37424e", "d9d3c7")
)
GLASS = tuple(hex_rgb(code) for code in ("a9d3e6", "b9dfd0", "c9c4e4", "d7e0e4"))


def mug(rng: Rng = None) -> Shape:
    """A coffee mug with a light lining and one handle on its +x side."""
    radius, height = vary(rng, 0.041), vary(rng, 0.096, 0.2)
    foot = radius * (0.95 if rng is None else rng.uniform(0.78, 1.0))
    wall = vary(rng, 0.0042)
    outer = [(foot - 0.004, 0.0), (foot - 0.001, 0.002), (foot, 0.005), (radius, height - 0.0015)]
    inner = [(foot - wall - 0.004, 0.006), (foot - wall, 0.010), (radius - wall, height - 0.0015)]
    body = Vessel([*outer, (radius - 0.0012, height)], [*inner, (radius - wall + 0.0012, height)])
    path = _handle_path(rng, body, height)
    section = cad.ellipse(vary(rng, 0.0068), vary(rng, 0.0038), 20)
    outside, lining = body.layers(0.0012)
    outside = cad.union(outside, cad.sweep(path, section) - body.inside() - lining)
    return made(
        name="mug",
        label="coffee mug",
        pieces=(cad.piece(outside, shade(rng, GLAZES)), cad.piece(lining, (0.95, 0.93, 0.89))),
        parts=(
            *body.parts(8),
            *part.sweep(part.thinned(path, 4, 0.04), section[[1, 4, 6, 9, 11, 14, 16, 19]] * 1.04),
        ),
        cavity=body.cavity(),
        mass=vary(rng, 0.33, 0.1),
    )


def _handle_path(rng: Rng, body: Vessel, height: float) -> np.ndarray:
    """The middle line of a mug's handle in the xz plane, both ends inside the wall, f64[24, 3]."""
    high, low = height * vary(rng, 0.82, 0.05), height * vary(rng, 0.24, 0.25)
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
    radius, height = vary(rng, 0.037), vary(rng, 0.120, 0.2)
    foot = radius * (0.82 if rng is None else rng.uniform(0.72, 0.98))
    wall, base = vary(rng, 0.0026), vary(rng, 0.011, 0.3)
    outer = [(foot - 0.002, 0.0), (foot, 0.002), (radius, height - 0.001), (radius - 0.0008, height)]
    at_base = foot + (radius - foot) * base / height
    inner = [(at_base - wall - 0.002, base), (at_base - wall, base + 0.003), (radius - wall + 0.0004, height)]
    body = Vessel(outer, inner)
    return made(
        name="water_glass",
        pieces=(cad.piece(body.solid(), shade(rng, GLASS), 0.5),),
        parts=body.parts(8),
        cavity=body.cavity(),
        mass=vary(rng, 0.25, 0.15),
    )


def wine_glass(rng: Rng = None) -> Shape:
    """A stemmed glass: a foot, a thin stem and a tulip-shaped bowl."""
    belly, mouth = vary(rng, 0.041, 0.12), choose(rng, (0.80, 0.74, 0.86, 0.92))
    foot, stem, radius = vary(rng, 0.036, 0.08), vary(rng, 0.085, 0.2), vary(rng, 0.0046, 0.1)
    depth, wall = vary(rng, 0.100, 0.15), 0.0024
    base, wide, rim = stem + 0.010, stem + 0.010 + 0.42 * depth, stem + 0.010 + depth
    curve = [(0.45, 0.06), (0.72, 0.16), (0.90, 0.27), (1.0, 0.42), (0.97, 0.62)]
    outside = [(belly * r, base + depth * z) for r, z in curve] + [(belly * mouth, rim)]
    inside = [(r - wall, z) for r, z in outside]
    lower = [(foot, 0.0), (foot, 0.0022), (0.3 * foot, 0.0055), (radius, 0.014), (radius, stem)]
    body = Vessel([(0.35 * belly, base), *outside], [(0.3 * belly, base + 0.0035), *inside])
    profile = [(0.0, 0.0), *lower, *body.outer, *reversed(body.inner), (0.0, body.floor)]
    cavity = cad.revolve([(0.0, body.floor), *body.inner, (0.0, rim)])
    return made(
        name="wine_glass",
        pieces=(cad.piece(cad.revolve(profile), shade(rng, GLASS), 0.5),),
        parts=(
            part.disc([(foot, 0.0), (foot, 0.0022), (0.25 * foot, 0.0060)], 8, is_standing=True),
            part.disc([(1.1 * radius, 0.004), (1.1 * radius, base + 0.001)], 6),
            *body.parts(8, cuts=(wide,)),
        ),
        cavity=Cavity(cad.to_mesh(cavity), (0.0, 0.0, rim)),
        mass=vary(rng, 0.16, 0.15),
    )
