"""Food in its package: bottle, soup can, jar, cereal box, milk carton."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

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
from cluttergen_jax.assets.shape import Shape

BOTTLE_GLASS = hex_colors("2f5d3a 6b3f1d 1f3b2c 7f9a4a 2b4a6b")
CAPS = hex_colors("8e1f2b c9a13b 20242b 2d5aa0")
LABELS = hex_colors("c8322b d98e1f 2f7d4f 2e5fa3 7d3f8c e0c23c")
PAPER = hex_rgb("f2ead8")
STEEL = hex_rgb("c3c7cb")
LIDS = (*hex_colors("c9a13b 8e1f2b 3f6f4f"), STEEL)
FILLINGS = hex_colors("a3202f d9822b 5b2a4f 8a5a2b 6f8f3a")


def bottle(rng: Rng = None) -> Shape:
    """A closed wine bottle with a label and a foil cap."""
    radius = vary(rng, 0.037, 0.1)
    height = vary(rng, 0.295, 0.12)
    shoulder = height * vary(rng, 0.60, 0.1)
    neck = vary(rng, 0.0142, 0.08)
    top = shoulder + vary(rng, 0.20, 0.2) * height
    bend = [(0.97, 0.16), (0.88, 0.36), (0.68, 0.60), (0.50, 0.80)]
    curve = [
        (neck + (radius - neck) * (r - 0.4) / 0.6, shoulder + (top - shoulder) * z) for r, z in bend
    ]
    body = [
        (radius - 0.003, 0.0),
        (radius, 0.004),
        (radius, shoulder),
        *curve,
        (neck, top),
        (neck, height),
    ]
    foil_foot = top + 0.25 * (height - top)
    foil = _sleeve(neck, foil_foot, height - 0.001, 0.0008)
    low = 0.14 * height
    high = shoulder - 0.05 * height
    return assemble(
        name="bottle",
        label="wine bottle",
        pieces=(
            (cad.revolve([(0.0, 0.0), *body, (0.0, height)]), shade(rng, BOTTLE_GLASS, 0.03)),
            (foil, cap := shade(rng, CAPS, 0.03)),
            (_sleeve(radius, low, high), PAPER),
            (_sleeve(radius, low + 0.25 * (high - low), low + 0.45 * (high - low), 0.0008), cap),
        ),
        parts=(
            part.disc([(radius, 0.0), (radius, shoulder)], 12, is_standing=True),
            part.disc([(radius, shoulder - 0.002), curve[1], (neck, top)], 8),
            part.disc([(neck, top - 0.002), (neck, height)], 8),
        ),
        mass=vary(rng, 1.20, 0.1),
    )


def soup_can(rng: Rng = None) -> Shape:
    """A closed tin can with a two-coloured paper label and a medallion band."""
    radius = vary(rng, 0.034, 0.2)
    height = vary(rng, 0.102, 0.2)
    rim = 0.0014
    lip = 0.0035
    tin = [
        (radius - 0.001, 0.0),
        (radius + rim, 0.0008),
        (radius + rim, lip),
        (radius, lip + 0.001),
    ]
    tin += [
        (radius, height - lip - 0.001),
        (radius + rim, height - lip),
        (radius + rim, height - 0.0008),
    ]
    tin += [(radius - 0.001, height), (radius - 0.002, height - 0.003), (0.0, height - 0.003)]
    low = lip + 0.002
    high = height - lip - 0.002
    middle = low + (0.52 if rng is None else rng.uniform(0.35, 0.65)) * (high - low)
    band = 0.07 * (high - low)
    color = shade(rng, LABELS)
    return assemble(
        name="soup_can",
        pieces=(
            (cad.revolve([(0.0, 0.0), *tin]), STEEL),
            (_sleeve(radius, middle + band, high), color),
            (_sleeve(radius, middle - band, middle + band), hex_rgb("d8b354")),
            (_sleeve(radius, low, middle - band), PAPER),
        ),
        parts=(part.disc([(radius + rim, 0.0), (radius + rim, height)], 12, is_standing=True),),
        mass=vary(rng, 0.35, 0.2) * (radius / 0.034) ** 2,
    )


def jar(rng: Rng = None) -> Shape:
    """A filled glass jar with a screw lid."""
    radius = vary(rng, 0.040, 0.2)
    height = vary(rng, 0.110, 0.25)
    lid = vary(rng, 0.016)
    neck = radius * vary(rng, 0.88, 0.06)
    shoulder = height - lid - 0.014
    outer = [
        (radius - 0.004, 0.0),
        (radius, 0.004),
        (radius, shoulder),
        (neck - 0.002, shoulder + 0.012),
    ]
    body = cad.revolve([(0.0, 0.0), *outer, (neck - 0.002, height - 0.002), (0.0, height - 0.002)])
    level = shoulder * (0.90 if rng is None else rng.uniform(0.82, 0.95))
    # The glass above the jam is a skin: a surface inside the body would count as a part of its outside.
    rising = [(radius, level), (radius, shoulder), (neck - 0.002, shoulder + 0.012)]
    skin = cad.revolve(
        [(0.0, level), *((r + 0.0003, z) for r, z in rising), (0.0, shoulder + 0.012)]
    )
    low = 0.24 * shoulder
    high = 0.78 * shoulder
    ribs = [
        (neck + 0.0005 * (k % 2), height - lid + 0.002 + (lid - 0.005) * k / 8) for k in range(9)
    ]
    cap = cad.revolve(
        [(0.0, height - lid), (neck, height - lid), *ribs, (neck - 0.002, height), (0.0, height)]
    )
    return assemble(
        name="jar",
        label="jar with a lid",
        pieces=(
            (body, color := shade(rng, FILLINGS)),
            (cad.difference(skin, body), hex_rgb("dfeaea"), 0.6),
            (cad.difference(cap, body), choose(rng, LIDS)),
            (_sleeve(radius, low, high), PAPER),
            *((_sleeve(radius, z, z + 0.0024, 0.0008), color) for z in (low + 0.004, high - 0.006)),
        ),
        parts=(
            part.disc([(radius, 0.0), (radius, shoulder)], 12, is_standing=True),
            part.disc([(radius, shoulder - 0.002), (neck, height - lid - 0.001)], 12),
            part.disc([(neck, height - lid - 0.003), (neck, height)], 12),
        ),
        mass=vary(rng, 0.45, 0.15) * (radius / 0.040) ** 2 * (height / 0.110),
    )


def _sleeve(radius: float, low: float, high: float, thickness: float = 0.0005) -> Manifold:
    """A thin ring around a cylinder, such as a label; its foot lies just inside the surface."""
    inner = radius - 0.0003
    outer = radius + thickness
    return cad.revolve([(inner, low), (outer, low), (outer, high), (inner, high)])


PRINTS = hex_colors("e2a21f c8322b 2e7d4f 2e5fa3 7d3f8c d95f8a")
ACCENTS = hex_colors("b3261e 1f3f7a 14532d 4a1d5e")
CREAM = hex_rgb("f6efdf")


def cereal_box(rng: Rng = None) -> Shape:
    """A tall carton with a title and a bowl of flakes printed on its -y face."""
    width = vary(rng, 0.160)
    depth = vary(rng, 0.058)
    height = vary(rng, 0.225)
    accent = shade(rng, ACCENTS)
    flap = cad.box((0.30 * width, 0.30 * depth, 0.0008), z=height - 0.0002)
    return assemble(
        name="cereal_box",
        pieces=(
            (cad.box((width, depth, height)), shade(rng, PRINTS)),
            *_breakfast(rng, width, height, -depth / 2, accent),
            (cad.union(cad.box((0.98 * width, 0.0012, 0.0006), z=height - 0.0002), flap), accent),
        ),
        parts=(part.box((width, depth, height)),),
        mass=vary(rng, 0.38, 0.2),
    )


def _breakfast(
    rng: Rng, width: float, height: float, face: float, accent: cad.Rgb
) -> list[cad.Painted]:
    """The print of a cereal box: a title panel, a bowl, milk and flakes."""
    place = np.array([0.0, 0.34 * height])
    high = np.array([0.0, 0.82 * height])
    title = cad.rounded_rect(0.84 * width, 0.20 * height, 0.05 * height) + high
    letters = [
        cad.rounded_rect(0.075 * width, size * height, 0.01 * height)
        + high
        + np.array([x * width, 0.0])
        for x, size in zip(
            np.linspace(-0.30, 0.30, 6), (0.11, 0.08, 0.08, 0.11, 0.08, 0.08), strict=True
        )
    ]
    reach = 0.36 * width
    turns = np.linspace(np.pi, 2 * np.pi, 24)
    dish = np.stack([reach * np.cos(turns), 0.85 * reach * np.sin(turns)], -1) + place
    lifts = (np.random.default_rng(7) if rng is None else rng).uniform(0.006, 0.054, 7)
    spots = np.stack([np.linspace(-0.75, 0.75, 7) * reach, lifts * height], -1) + place
    flake = cad.ellipse(0.055 * width, 0.038 * width, 12)
    return [
        (cad.upright(title, 0.0006, face), accent),
        *((cad.upright(letter, 0.0012, face), CREAM) for letter in letters),
        (cad.upright(cad.ellipse(reach, 0.16 * reach, 32) + place, 0.0008, face), CREAM),
        (cad.upright(dish, 0.0006, face), hex_rgb("3d6fb5")),
        *((cad.upright(flake + spot, 0.0012, face), hex_rgb("b5651d")) for spot in spots),
    ]


def milk_carton(rng: Rng = None) -> Shape:
    """A gable-top carton with a screw cap; its ridge runs along x."""
    side = vary(rng, 0.070, 0.12)
    height = vary(rng, 0.205)
    eaves = 0.76 * height
    fin = 0.075 * height
    ridge = height - fin
    half = side / 2
    thin = 0.0018
    right = [(half, 0.0), (half, eaves), (thin, ridge)]
    left = [(-y, z) for y, z in reversed(right)]
    carton = cad.upright([*right, (thin, height), (-thin, height), *left], side).rotate((0, 0, 90))
    color = shade(rng, PRINTS[3:] + PRINTS[:3])
    stripe = cad.box((side + 0.0006, side + 0.0006, 0.22 * height), z=0.06 * height)
    slope = np.degrees(np.arctan2(ridge - eaves, half - thin))
    screw = cad.upright(cad.ellipse(0.16 * side, 0.16 * side, 24), 0.012, 0.0)
    screw = screw.rotate((slope - 90, 0, 0)).translate((0, -half / 2, (eaves + ridge) / 2))
    gable = [(x, y, z) for x in (-half, half) for y, z in (*right, *left)]
    return assemble(
        name="milk_carton",
        pieces=(
            (carton, hex_rgb("f3f3ee")),
            (stripe - carton, color),
            (
                cad.upright(_drop(0.15 * side) + np.array([0.0, 0.46 * height]), 0.0006, -half),
                color,
            ),
            (screw - carton, color),
        ),
        parts=(part.hull(gable), part.box((side, 2 * thin, fin + 0.002), z=ridge - 0.002)),
        mass=vary(rng, 1.03, 0.05) * (side / 0.070) ** 2 * (height / 0.205),
    )


def _drop(radius: float) -> np.ndarray:
    """The outline of a falling drop, its round end around the origin, f64[25, 2]."""
    turns = np.linspace(0.85 * np.pi, 2.15 * np.pi, 24)
    return np.concatenate(
        [radius * np.stack([np.cos(turns), np.sin(turns)], -1), [(0.0, 2.4 * radius)]]
    )
