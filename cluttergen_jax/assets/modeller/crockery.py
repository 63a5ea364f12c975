"""Crockery: bowl and dinner plate."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, hex_rgb, made, shade, vary
from cluttergen_jax.assets.modeller.vessel import Vessel
from cluttergen_jax.assets.shape import Shape

GLAZES = tuple(
    hex_rgb(code) for code in ("4f86a6", "c9713f", "6f8f5a", "a43f4f", "e3ded2", "2f3e55", "d8b64c")
)
PORCELAIN = tuple(hex_rgb(code) for code in ("f1eee6", "e6ecef", "f3e6d6", "dfe7dc"))


def bowl(rng: Rng = None) -> Shape:
    """A cereal bowl on a flat foot, glazed outside, light inside."""
    radius, height = vary(rng, 0.076), vary(rng, 0.064)
    foot = radius * (0.46 if rng is None else rng.uniform(0.40, 0.55))
    wall = vary(rng, 0.0046)
    turns = np.linspace(0.15, 1.0, 7) * np.pi / 2 * 0.78
    shape = np.stack([np.sin(turns) / np.sin(turns[-1]), (1 - np.cos(turns)) / (1 - np.cos(turns[-1]))], -1)
    outer = [(foot + (radius - foot) * r, 0.004 + (height - 0.004) * z) for r, z in shape]
    inner = [(r - wall, z) for r, z in outer[1:-1]] + [(radius - 0.6 * wall, height)]
    floor = inner[0][1] - 0.003
    body = Vessel([(foot, 0.0), (foot, 0.004), *outer], [(inner[0][0] - 0.006, floor), *inner])
    outside, lining = body.layers(0.0012)
    return made(
        name="bowl",
        label="cereal bowl",
        pieces=(cad.piece(outside, shade(rng, GLAZES)), cad.piece(lining, (0.96, 0.94, 0.90))),
        parts=body.parts(8, cuts=(floor + 0.33 * (height - floor),)),
        cavity=body.cavity(),
        mass=vary(rng, 0.38, 0.15),
    )


def dinner_plate(rng: Rng = None) -> Shape:
    """A flat plate with a raised rim and a coloured band near its edge."""
    radius, height = vary(rng, 0.130), vary(rng, 0.022, 0.2)
    well, thick = radius * vary(rng, 0.66, 0.08), 0.005
    outer = [(well - 0.010, 0.0), (well, 0.003), (well + 0.008, 0.40 * height), (radius, height - 0.0015)]
    inner = [(well - 0.012, thick), (well - 0.002, thick + 0.002), (well + 0.007, 0.40 * height + thick)]
    body = Vessel([*outer, (radius - 0.001, height)], [*inner, (radius - 0.004, height)])
    near, far = 0.80 * radius, 0.93 * radius
    low, high = (np.interp(r, [p[0] for p in body.inner], [p[1] for p in body.inner]) for r in (near, far))
    band = cad.revolve(
        [(near, low - 0.0010), (far, high - 0.0010), (far, high + 0.0003), (near, low + 0.0003)]
    )
    return made(
        name="dinner_plate",
        pieces=(
            cad.piece(body.solid() - band, shade(rng, PORCELAIN, 0.02)),
            cad.piece(band, shade(rng, GLAZES)),
        ),
        parts=body.parts(10),
        cavity=body.cavity(),
        mass=vary(rng, 0.55, 0.2),
    )
