"""Teapot."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, hex_rgb, made, shade, vary
from cluttergen_jax.assets.shape import Shape

GLAZES = tuple(hex_rgb(code) for code in ("e8e2d4", "b3262e", "2f6f8f", "d9822b", "3f6f4f", "7a5a8c"))
TRIMS = tuple(hex_rgb(code) for code in ("2f5f9f", "8a5a2b", "25282c"))


def teapot(rng: Rng = None) -> Shape:
    """A round teapot with its lid on, a spout at +x and a handle at -x."""
    radius, height = vary(rng, 0.072, 0.1), vary(rng, 0.105, 0.12)
    base, neck, reach = 0.62 * radius, 0.48 * radius, vary(rng, 0.058, 0.1)
    belly = [(base, 0.004), (0.93 * radius, 0.26 * height), (radius, 0.48 * height)]
    belly += [(0.85 * radius, 0.77 * height), (neck, height)]
    body = cad.revolve([(0.0, 0.0), (base - 0.003, 0.0), *cad.smooth_path(belly, 30), (0.0, height)])
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
    bar, sizes = cad.ellipse(0.0070, 0.0052, 16), np.linspace(1.35, 0.62, 20)
    bore = cad.tube(spout[-4:] + np.array([0.0004, 0, 0.0008]), 0.0042)
    vessel = cad.difference(cad.union(body, cad.tube(spout, 0.0115, scales=sizes), cad.sweep(arm, bar)), bore)
    trim = shade(rng, TRIMS, 0.03)
    cells = part.thinned(spout, 2)
    return made(
        name="teapot",
        pieces=(
            cad.piece(vessel, shade(rng, GLAZES, 0.04)),
            cad.piece(_lid(neck, height), trim),
            cad.piece(cad.difference(_band(body, height), vessel), trim),
        ),
        parts=(
            *_belly([(base, 0.0), *belly[1:]]),
            part.disc([(neck + 0.003, height - 0.001), (0.6 * neck, height + 0.010)], 10),
            part.disc([(0.008, height + 0.008), (0.012, height + 0.022), (0.006, height + 0.032)], 8),
            *part.sweep(cells, 0.0115, scales=np.interp(cells[:, 2], spout[:, 2], sizes)),
            *part.sweep(part.thinned(arm, 4, 0.03), bar[::2]),
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
