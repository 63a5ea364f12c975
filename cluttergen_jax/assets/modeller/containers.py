"""Round containers with a lid: bottle, soup can, jar."""

from __future__ import annotations

from manifold3d import Manifold

from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, choose, hex_rgb, made, shade, vary
from cluttergen_jax.assets.shape import Shape

BOTTLE_GLASS = tuple(hex_rgb(code) for code in ("2f5d3a", "6b3f1d", "1f3b2c", "7f9a4a", "2b4a6b"))
CAPS = tuple(hex_rgb(code) for code in ("8e1f2b", "c9a13b", "20242b", "2d5aa0"))
LABELS = tuple(hex_rgb(code) for code in ("c8322b", "d98e1f", "2f7d4f", "2e5fa3", "7d3f8c", "e0c23c"))
PAPER = hex_rgb("f2ead8")
STEEL = hex_rgb("c3c7cb")
LIDS = (*(hex_rgb(code) for code in ("c9a13b", "8e1f2b", "3f6f4f")), STEEL)
FILLINGS = tuple(hex_rgb(code) for code in ("a3202f", "d9822b", "5b2a4f", "8a5a2b", "6f8f3a"))


def bottle(rng: Rng = None) -> Shape:
    """A closed wine bottle with a label and a foil cap."""
    radius, height = vary(rng, 0.037, 0.1), vary(rng, 0.295, 0.12)
    shoulder, neck = height * vary(rng, 0.60, 0.1), vary(rng, 0.0142, 0.08)
    top = shoulder + vary(rng, 0.20, 0.2) * height
    bend = [(0.97, 0.16), (0.88, 0.36), (0.68, 0.60), (0.50, 0.80)]
    curve = [(neck + (radius - neck) * (r - 0.4) / 0.6, shoulder + (top - shoulder) * z) for r, z in bend]
    body = [(radius - 0.003, 0.0), (radius, 0.004), (radius, shoulder), *curve, (neck, top), (neck, height)]
    foil_foot = top + 0.25 * (height - top)
    foil = _sleeve(neck, foil_foot, height - 0.001, 0.0008)
    low, high = 0.14 * height, shoulder - 0.05 * height
    return made(
        name="bottle",
        label="wine bottle",
        pieces=(
            cad.piece(cad.revolve([(0.0, 0.0), *body, (0.0, height)]), shade(rng, BOTTLE_GLASS, 0.03)),
            cad.piece(foil, cap := shade(rng, CAPS, 0.03)),
            cad.piece(_sleeve(radius, low, high), PAPER),
            cad.piece(_sleeve(radius, low + 0.25 * (high - low), low + 0.45 * (high - low), 0.0008), cap),
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
    radius, height = vary(rng, 0.034, 0.2), vary(rng, 0.102, 0.2)
    rim, lip = 0.0014, 0.0035
    tin = [(radius - 0.001, 0.0), (radius + rim, 0.0008), (radius + rim, lip), (radius, lip + 0.001)]
    tin += [(radius, height - lip - 0.001), (radius + rim, height - lip), (radius + rim, height - 0.0008)]
    tin += [(radius - 0.001, height), (radius - 0.002, height - 0.003), (0.0, height - 0.003)]
    low, high = lip + 0.002, height - lip - 0.002
    middle = low + (0.52 if rng is None else rng.uniform(0.35, 0.65)) * (high - low)
    band = 0.07 * (high - low)
    color = shade(rng, LABELS)
    return made(
        name="soup_can",
        pieces=(
            cad.piece(cad.revolve([(0.0, 0.0), *tin]), STEEL),
            cad.piece(_sleeve(radius, middle + band, high), color),
            cad.piece(_sleeve(radius, middle - band, middle + band), hex_rgb("d8b354")),
            cad.piece(_sleeve(radius, low, middle - band), PAPER),
        ),
        parts=(part.disc([(radius + rim, 0.0), (radius + rim, height)], 12, is_standing=True),),
        mass=vary(rng, 0.35, 0.2) * (radius / 0.034) ** 2,
    )


def jar(rng: Rng = None) -> Shape:
    """A filled glass jar with a screw lid."""
    radius, height = vary(rng, 0.040, 0.2), vary(rng, 0.110, 0.25)
    lid, neck = vary(rng, 0.016), radius * vary(rng, 0.88, 0.06)
    shoulder = height - lid - 0.014
    outer = [(radius - 0.004, 0.0), (radius, 0.004), (radius, shoulder), (neck - 0.002, shoulder + 0.012)]
    body = cad.revolve([(0.0, 0.0), *outer, (neck - 0.002, height - 0.002), (0.0, height - 0.002)])
    level = shoulder * (0.90 if rng is None else rng.uniform(0.82, 0.95))
    # The glass above the jam is a skin: a surface inside the body would count as a part of its outside.
    rising = [(radius, level), (radius, shoulder), (neck - 0.002, shoulder + 0.012)]
    skin = cad.revolve([(0.0, level), *((r + 0.0003, z) for r, z in rising), (0.0, shoulder + 0.012)])
    low, high = 0.24 * shoulder, 0.78 * shoulder
    ribs = [(neck + 0.0005 * (k % 2), height - lid + 0.002 + (lid - 0.005) * k / 8) for k in range(9)]
    cap = cad.revolve(
        [(0.0, height - lid), (neck, height - lid), *ribs, (neck - 0.002, height), (0.0, height)]
    )
    return made(
        name="jar",
        label="jar with a lid",
        pieces=(
            cad.piece(body, color := shade(rng, FILLINGS)),
            cad.piece(cad.difference(skin, body), hex_rgb("dfeaea"), 0.6),
            cad.piece(cad.difference(cap, body), choose(rng, LIDS)),
            cad.piece(_sleeve(radius, low, high), PAPER),
            *(cad.piece(_sleeve(radius, z, z + 0.0024, 0.0008), color) for z in (low + 0.004, high - 0.006)),
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
    inner, outer = radius - 0.0003, radius + thickness
    return cad.revolve([(inner, low), (outer, low), (outer, high), (inner, high)])
