"""Turned woodwork: pepper mill."""

from __future__ import annotations

from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, hex_rgb, made, shade, vary
from cluttergen_jax.assets.shape import Shape

WOODS = tuple(hex_rgb(code) for code in ("8a4b25", "b9793f", "3b2417", "c8322b", "26282c", "ddb57a"))


def pepper_mill(rng: Rng = None) -> Shape:
    """A turned pepper mill: a waisted body, a metal ring, a round head with a knob."""
    radius, height = vary(rng, 0.0275, 0.1), vary(rng, 0.185, 0.25)
    waist, chest = vary(rng, 0.60, 0.12) * radius, vary(rng, 0.80, 0.06) * radius
    neck, head = 0.60 * height, 0.86 * height
    crown = neck + 0.012 * height
    depth = head - crown
    knots = [(radius, 0.055 * height), (waist, 0.30 * height), (chest, 0.52 * height), (0.72 * chest, neck)]
    ball = [(0.72 * chest, crown), (0.95 * chest, crown + 0.10 * depth), (1.05 * chest, crown + 0.5 * depth)]
    ball += [(0.75 * chest, head - 0.06 * depth), (0.30 * chest, head)]
    knob = [(0.30, 0.86), (0.36, 0.91), (0.42, 0.955), (0.24, 1.0)]
    knob = [(r * radius, z * height) for r, z in knob]
    body = [(0.0, 0.0), (radius - 0.0015, 0.0), (radius, 0.0015), *cad.smooth_path(knots, 24)]
    ring = [(0.70 * chest, neck), (0.76 * chest, neck), (0.76 * chest, crown), (0.70 * chest, crown)]
    low, high = (waist, 0.27 * height), (waist, 0.34 * height)
    steel = hex_rgb("c9ccd0")
    return made(
        name="pepper_mill",
        pieces=(
            cad.piece(cad.revolve([*body, *cad.smooth_path(ball, 20), (0.0, head)]), shade(rng, WOODS, 0.04)),
            cad.piece(cad.revolve(ring), steel),
            cad.piece(cad.revolve([(0.0, head), *cad.smooth_path(knob, 14), (0.0, height)]), steel),
        ),
        parts=(
            part.disc([(radius, 0.0), (radius, 0.055 * height), (waist, 0.28 * height)], 8, is_standing=True),
            part.disc([low, high, (chest, 0.52 * height), (0.72 * chest, neck)], 8),
            part.disc([(0.72 * chest, neck - 0.002), ball[2], (0.30 * chest, head)], 8),
            part.disc([(0.30 * radius, head - 0.002), knob[2], knob[3]], 8),
        ),
        mass=vary(rng, 0.24, 0.15) * (radius / 0.0275) ** 2 * (height / 0.185),
    )
