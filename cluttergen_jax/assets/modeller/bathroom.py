"""Bottles with a head: a spray bottle, a soap dispenser."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import palette as rgb
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, choose, made, shade, vary
from cluttergen_jax.assets.modeller.lettering import lettering
from cluttergen_jax.assets.shape import Shape


def flask(
    width: float, depth: float, corner: float, shoulder: float, top: float, neck: float
) -> tuple[Manifold, Mesh]:
    """A bottle's body on a rounded rectangle, drawn in from `shoulder` to a neck of radius `neck` at `top`.

    Its part touches the table with four corners only, so that a simulator's choice of contacts is settled.
    """

    def levels(num: int) -> list[np.ndarray]:
        outline = cad.rounded_rect(width, depth, corner, num)
        mouth = cad.rounded_rect(2 * neck, 2 * neck, 0.98 * neck, num)
        heights = ((outline * 0.95, 0.0), (outline, 0.006), (outline, shoulder), (mouth, top))
        return [np.insert(ring, 2, z, axis=1) for ring, z in heights]

    rings = levels(1)
    reach = np.array([0.95 * width / 2 - 0.3 * corner, 0.95 * depth / 2 - 0.3 * corner])
    rings[0] = np.array([(sx * reach[0], sy * reach[1], 0.0) for sx in (-1, 1) for sy in (-1, 1)])
    return cad.hull(np.concatenate(levels(7))), part.hull(np.concatenate(rings))


def spray_bottle(rng: Rng = None) -> Shape:
    """A trigger spray bottle, its nozzle towards -x."""
    width, depth = vary(rng, 0.088, 0.1), vary(rng, 0.056, 0.1)
    shoulder = vary(rng, 0.130, 0.12)
    top = shoulder + 0.036
    body, body_part = flask(width, depth, 0.018, shoulder, top, 0.014)
    head_at = top + 0.018
    shell = [(-46, 10), (-46, 25), (-12, 37), (30, 34), (38, 18), (16, -1), (-14, -1)]
    head = [(0.001 * x, head_at + 0.001 * z) for x, z in shell]
    trigger = [
        (x, head_at + z) for x, z in ((-0.015, 0.006), (-0.030, 0.010), (-0.043, -0.030), (-0.037, -0.034))
    ]
    neck = cad.cylinder(0.0125, head_at - top + 0.001, top - 0.001)
    collar = cad.cylinder(0.0175, 0.015, top - 0.002, top=0.0155) - cad.cylinder(0.0124, 1.0)
    label = (0.68 * width, 0.58 * shoulder)
    panel, words = _labels(
        label, depth / 2, 0.5 * shoulder, choose(rng, ("CLEAN", "CLEAN UP", "PLANTS")), 0.17
    )
    grip = cad.upright(head, 0.024)
    return made(
        name="spray_bottle",
        pieces=(
            cad.piece(body + neck, shade(rng, (rgb.SKY, rgb.TEAL, *rgb.BRIGHT))),
            cad.piece(collar - body, rgb.WHITE),
            cad.piece(grip, shade(rng, (rgb.WHITE, rgb.CHARCOAL, rgb.BLUE))),
            cad.piece(cad.box((0.008, 0.018, 0.013), (-0.049, 0), head_at + 0.011) - grip, rgb.ORANGE),
            cad.piece(cad.upright(trigger, 0.012) - grip, shade(rng, (rgb.ORANGE, *rgb.BRIGHT))),
            cad.piece(panel, rgb.WHITE),
            cad.piece(words, shade(rng, (rgb.NAVY, rgb.BLUE, rgb.TEAL))),
        ),
        parts=(
            body_part,
            part.disc([(0.0175, top - 0.004), (0.0155, head_at)], 10),
            part.upright([*head[2:], (-0.052, head_at + 0.012), (-0.052, head_at + 0.024)], 0.022),
            part.upright(trigger, 0.012),
        ),
        mass=vary(rng, 0.55, 0.25),
    )


def _labels(
    size: tuple[float, float], y: float, z: float, word: str, share: float
) -> tuple[Manifold, Manifold]:
    """A panel and its print on the front and on the back of a bottle, at distance `y` and height `z`."""
    panel = cad.box((size[0], size[1], 0.0012), z=-0.0004)
    height = min(share * size[1], 0.86 * size[0] / len(word))
    rows = ((0.94, 0.05, 0.44), (0.94, 0.05, -0.44), (0.70, 0.035, -0.12), (0.50, 0.035, -0.24))
    bars = [cad.box((wide * size[0], tall * size[1], 0.0012), (0, row * size[1])) for wide, tall, row in rows]
    printed = cad.union(*bars, lettering(word, height).translate((0, 0.16 * size[1], 0.0008)))
    placed = []
    for solid in (panel, printed):
        front = solid.rotate((90, 0, 0)).translate((0, -y, z))
        placed.append(front + front.rotate((0, 0, 180)))
    return placed[0], placed[1]


def soap_dispenser(rng: Rng = None) -> Shape:
    """A soap dispenser with a pump, its spout towards -y."""
    width, depth = vary(rng, 0.072, 0.1), vary(rng, 0.060, 0.1)
    shoulder = vary(rng, 0.112, 0.15)
    top = shoulder + 0.016
    body, body_part = flask(width, depth, 0.020, shoulder, top, 0.015)
    cap = cad.cylinder(0.0155, 0.016, top - 0.002) - cad.cylinder(0.0095, 1.0)
    pump = top + vary(rng, 0.036, 0.15)
    neck = cad.cylinder(0.0098, 0.012, top - 0.001)
    stem = cad.cylinder(0.0048, pump - top - 0.010, top + 0.010)
    side = ((0.0075, 0, 0.001), (0.0075, 0, 0.013), (0.005, -0.048, -0.001), (0.005, -0.048, 0.006))
    spout = [(s * w, y, pump + z) for s in (-1, 1) for w, y, z in side]
    tip = [(s * 0.005, y, pump + z) for s in (-1, 1) for y in (-0.0485, -0.040) for z in (-0.010, 0.004)]
    press = cad.rounded_box((0.034, 0.034, 0.013), 0.005, (0, 0.002), pump)
    panel, words = _labels((0.66 * width, 0.62 * shoulder), depth / 2, 0.5 * shoulder, "SOAP", 0.26)
    metal = shade(rng, (rgb.WHITE, rgb.STEEL, rgb.CHARCOAL))
    return made(
        name="soap_dispenser",
        pieces=(
            cad.piece(body + neck, shade(rng, (rgb.TEAL, rgb.CREAM, *rgb.BRIGHT))),
            cad.piece(cad.union(cap, stem, cad.hull(spout), cad.hull(tip), press) - (body + neck), metal),
            cad.piece(panel, rgb.WHITE),
            cad.piece(words, shade(rng, (rgb.TEAL, rgb.NAVY, rgb.BLUE))),
        ),
        parts=(
            body_part,
            part.disc([(0.0155, top - 0.004), (0.0155, top + 0.014)], 10),
            part.box((0.010, 0.010, pump - top + 0.002), z=top),
            part.box((0.032, 0.032, 0.013), (0, 0.002), pump),
            part.hull([*spout, *tip[:2], *tip[4:6]]),
        ),
        mass=vary(rng, 0.38, 0.2),
    )
