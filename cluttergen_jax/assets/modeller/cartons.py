"""Cartons: cereal box and milk carton."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, hex_rgb, made, shade, vary
from cluttergen_jax.assets.shape import Piece, Shape

PRINTS = tuple(hex_rgb(code) for code in ("e2a21f", "c8322b", "2e7d4f", "2e5fa3", "7d3f8c", "d95f8a"))
ACCENTS = tuple(hex_rgb(code) for code in ("b3261e", "1f3f7a", "14532d", "4a1d5e"))
CREAM = hex_rgb("f6efdf")


def cereal_box(rng: Rng = None) -> Shape:
    """A tall carton with a title and a bowl of flakes printed on its -y face."""
    width, depth, height = vary(rng, 0.160), vary(rng, 0.058), vary(rng, 0.225)
    accent = shade(rng, ACCENTS)
    flap = cad.box((0.30 * width, 0.30 * depth, 0.0008), z=height - 0.0002)
    return made(
        name="cereal_box",
        pieces=(
            cad.piece(cad.box((width, depth, height)), shade(rng, PRINTS)),
            *_breakfast(rng, width, height, -depth / 2, accent),
            cad.piece(cad.union(cad.box((0.98 * width, 0.0012, 0.0006), z=height - 0.0002), flap), accent),
        ),
        parts=(part.box((width, depth, height)),),
        mass=vary(rng, 0.38, 0.2),
    )


def _breakfast(rng: Rng, width: float, height: float, face: float, accent: cad.Rgb) -> list[Piece]:
    """The print of a cereal box: a title panel, a bowl, milk and flakes."""
    place, high = np.array([0.0, 0.34 * height]), np.array([0.0, 0.82 * height])
    title = cad.rounded_rect(0.84 * width, 0.20 * height, 0.05 * height) + high
    letters = [
        cad.rounded_rect(0.075 * width, size * height, 0.01 * height) + high + np.array([x * width, 0.0])
        for x, size in zip(np.linspace(-0.30, 0.30, 6), (0.11, 0.08, 0.08, 0.11, 0.08, 0.08), strict=True)
    ]
    reach = 0.36 * width
    turns = np.linspace(np.pi, 2 * np.pi, 24)
    dish = np.stack([reach * np.cos(turns), 0.85 * reach * np.sin(turns)], -1) + place
    lifts = (np.random.default_rng(7) if rng is None else rng).uniform(0.006, 0.054, 7)
    spots = np.stack([np.linspace(-0.75, 0.75, 7) * reach, lifts * height], -1) + place
    flake = cad.ellipse(0.055 * width, 0.038 * width, 12)
    return [
        cad.piece(cad.on_front(title, face), accent),
        *(cad.piece(cad.on_front(letter, face, 0.0012), CREAM) for letter in letters),
        cad.piece(cad.on_front(cad.ellipse(reach, 0.16 * reach, 32) + place, face, 0.0008), CREAM),
        cad.piece(cad.on_front(dish, face), hex_rgb("3d6fb5")),
        *(cad.piece(cad.on_front(flake + spot, face, 0.0012), hex_rgb("b5651d")) for spot in spots),
    ]


def milk_carton(rng: Rng = None) -> Shape:
    """A gable-top carton with a screw cap; its ridge runs along x."""
    side, height = vary(rng, 0.070, 0.12), vary(rng, 0.205)
    eaves, fin = 0.76 * height, 0.075 * height
    ridge, half, thin = height - fin, side / 2, 0.0018
    right = [(half, 0.0), (half, eaves), (thin, ridge)]
    left = [(-y, z) for y, z in reversed(right)]
    carton = cad.from_side([*right, (thin, height), (-thin, height), *left], side).rotate((0, 0, 90))
    color = shade(rng, PRINTS[3:] + PRINTS[:3])
    stripe = cad.box((side + 0.0006, side + 0.0006, 0.22 * height), z=0.06 * height)
    slope = np.degrees(np.arctan2(ridge - eaves, half - thin))
    screw = cad.on_front(cad.ellipse(0.16 * side, 0.16 * side, 24), 0.0, 0.012)
    screw = screw.rotate((slope - 90, 0, 0)).translate((0, -half / 2, (eaves + ridge) / 2))
    gable = [(x, y, z) for x in (-half, half) for y, z in (*right, *left)]
    return made(
        name="milk_carton",
        pieces=(
            cad.piece(carton, hex_rgb("f3f3ee")),
            cad.piece(stripe - carton, color),
            cad.piece(cad.on_front(_drop(0.15 * side) + np.array([0.0, 0.46 * height]), -half), color),
            cad.piece(screw - carton, color),
        ),
        parts=(part.hull(gable), part.box((side, 2 * thin, fin + 0.002), z=ridge - 0.002)),
        mass=vary(rng, 1.03, 0.05) * (side / 0.070) ** 2 * (height / 0.205),
    )


def _drop(radius: float) -> np.ndarray:
    """The outline of a falling drop, its round end around the origin, f64[25, 2]."""
    turns = np.linspace(0.85 * np.pi, 2.15 * np.pi, 24)
    return np.concatenate([radius * np.stack([np.cos(turns), np.sin(turns)], -1), [(0.0, 2.4 * radius)]])
