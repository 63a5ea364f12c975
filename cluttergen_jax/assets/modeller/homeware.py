"""About the house: spray bottle, soap dispenser, tissue box, roll of tape, flower pot, basket."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import palette as rgb
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, assemble, choose, shade, vary
from cluttergen_jax.assets.modeller.lettering import lettering
from cluttergen_jax.assets.modeller.vessel import Crate, Vessel
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
    width = vary(rng, 0.088, 0.1)
    depth = vary(rng, 0.056, 0.1)
    shoulder = vary(rng, 0.130, 0.12)
    top = shoulder + 0.036
    body, body_part = flask(width, depth, 0.018, shoulder, top, 0.014)
    head_at = top + 0.018
    shell = [(-46, 10), (-46, 25), (-12, 37), (30, 34), (38, 18), (16, -1), (-14, -1)]
    head = [(0.001 * x, head_at + 0.001 * z) for x, z in shell]
    trigger = [
        (x, head_at + z)
        for x, z in ((-0.015, 0.006), (-0.030, 0.010), (-0.043, -0.030), (-0.037, -0.034))
    ]
    neck = cad.cylinder(0.0125, head_at - top + 0.001, top - 0.001)
    collar = cad.cylinder(0.0175, 0.015, top - 0.002, top=0.0155) - cad.cylinder(0.0124, 1.0)
    label = (0.68 * width, 0.58 * shoulder)
    panel, words = _labels(
        label, depth / 2, 0.5 * shoulder, choose(rng, ("CLEAN", "CLEAN UP", "PLANTS")), 0.17
    )
    grip = cad.upright(head, 0.024)
    return assemble(
        name="spray_bottle",
        pieces=(
            (body + neck, shade(rng, (rgb.SKY, rgb.TEAL, *rgb.BRIGHT))),
            (collar - body, rgb.WHITE),
            (grip, shade(rng, (rgb.WHITE, rgb.CHARCOAL, rgb.BLUE))),
            (cad.box((0.008, 0.018, 0.013), (-0.049, 0), head_at + 0.011) - grip, rgb.ORANGE),
            (cad.upright(trigger, 0.012) - grip, shade(rng, (rgb.ORANGE, *rgb.BRIGHT))),
            (panel, rgb.WHITE),
            (words, shade(rng, (rgb.NAVY, rgb.BLUE, rgb.TEAL))),
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
    bars = [
        cad.box((wide * size[0], tall * size[1], 0.0012), (0, row * size[1]))
        for wide, tall, row in rows
    ]
    printed = cad.union(*bars, lettering(word, height).translate((0, 0.16 * size[1], 0.0008)))
    placed = []
    for solid in (panel, printed):
        front = solid.rotate((90, 0, 0)).translate((0, -y, z))
        placed.append(front + front.rotate((0, 0, 180)))
    return placed[0], placed[1]


def soap_dispenser(rng: Rng = None) -> Shape:
    """A soap dispenser with a pump, its spout towards -y."""
    width = vary(rng, 0.072, 0.1)
    depth = vary(rng, 0.060, 0.1)
    shoulder = vary(rng, 0.112, 0.15)
    top = shoulder + 0.016
    body, body_part = flask(width, depth, 0.020, shoulder, top, 0.015)
    cap = cad.cylinder(0.0155, 0.016, top - 0.002) - cad.cylinder(0.0095, 1.0)
    pump = top + vary(rng, 0.036, 0.15)
    neck = cad.cylinder(0.0098, 0.012, top - 0.001)
    stem = cad.cylinder(0.0048, pump - top - 0.010, top + 0.010)
    side = ((0.0075, 0, 0.001), (0.0075, 0, 0.013), (0.005, -0.048, -0.001), (0.005, -0.048, 0.006))
    spout = [(s * w, y, pump + z) for s in (-1, 1) for w, y, z in side]
    tip = [
        (s * 0.005, y, pump + z)
        for s in (-1, 1)
        for y in (-0.0485, -0.040)
        for z in (-0.010, 0.004)
    ]
    press = cad.rounded_box((0.034, 0.034, 0.013), 0.005, (0, 0.002), pump)
    panel, words = _labels((0.66 * width, 0.62 * shoulder), depth / 2, 0.5 * shoulder, "SOAP", 0.26)
    metal = shade(rng, (rgb.WHITE, rgb.STEEL, rgb.CHARCOAL))
    return assemble(
        name="soap_dispenser",
        pieces=(
            (body + neck, shade(rng, (rgb.TEAL, rgb.CREAM, *rgb.BRIGHT))),
            (cad.union(cap, stem, cad.hull(spout), cad.hull(tip), press) - (body + neck), metal),
            (panel, rgb.WHITE),
            (words, shade(rng, (rgb.TEAL, rgb.NAVY, rgb.BLUE))),
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


KRAFT = (0.72, 0.55, 0.36)


def tissue_box(rng: Rng = None) -> Shape:
    """A box of paper tissues, one of them pulled half out."""
    width = vary(rng, 0.225, 0.1)
    depth = vary(rng, 0.115, 0.1)
    height = vary(rng, 0.078, 0.2)
    slot = cad.extrude(cad.ellipse(0.30 * width, 0.24 * depth), 0.0012, height - 0.0006)
    ring = cad.extrude(cad.ellipse(0.33 * width, 0.29 * depth), 0.0010, height - 0.0006)
    ring = ring - cad.extrude(cad.ellipse(0.30 * width, 0.24 * depth), 1.0)
    wave = np.linspace(-0.5, 0.5, 25)
    crest = height * (0.42 + 0.10 * np.cos(wave * 4 * np.pi))
    skin = 0.0007
    band = [(width * x, z) for x, z in zip(wave, crest, strict=True)]
    band = [(-width, 0.0), (width, 0.0), (width, band[-1][1]), *band[::-1], (-width, band[0][1])]
    shell = cad.box((width + 2 * skin, depth + 2 * skin, height), z=0.0) - cad.box(
        (width - skin, depth - skin, 2.0), z=-0.5
    )
    lower = shell ^ cad.extrude(band, 1.0, -0.5).rotate((90, 0, 0))
    knots = _tuft(0.26 * width, height)
    cells = []
    for i, j in np.ndindex(knots.shape[0] - 1, knots.shape[1] - 1):
        cell = knots[i : i + 2, j : j + 2].reshape(-1, 3)
        cells.append(cad.hull(np.concatenate([np.add(cell, (0, s * 0.0012, 0)) for s in (-1, 1)])))
    coarse = knots[[0, 3, 6, 8, 11, 14]][:, [0, -1]].reshape(-1, 3)
    return assemble(
        name="tissue_box",
        pieces=(
            (
                cad.box((width, depth, height)),
                shade(rng, (rgb.SKY, rgb.PINK, rgb.CREAM, *rgb.BRIGHT)),
            ),
            (lower, shade(rng, (rgb.BLUE, rgb.TEAL, rgb.RED, rgb.GREEN))),
            (ring, rgb.WHITE),
            (slot - ring, rgb.GREY),
            (cad.union(*cells), rgb.WHITE),
        ),
        parts=(
            part.box((width, depth, height)),
            part.hull(np.concatenate([np.add(coarse, (0, s * 0.0012, 0)) for s in (-1, 1)])),
        ),
        mass=vary(rng, 0.22, 0.25),
    )


def _tuft(reach: float, base: float) -> np.ndarray:
    """A grid of knots on a rippled sheet that widens upwards from height `base`: f64[15, 6, 3]."""
    u, v = np.meshgrid(np.linspace(-1, 1, 15), np.linspace(0, 1, 6), indexing="ij")
    x = reach * u * (0.35 + 0.55 * v**0.8)
    y = (0.003 + 0.005 * v) * np.sin(6.5 * u + 0.8 * v)
    z = base - 0.002 + 0.066 * v * (0.95 + 0.05 * np.cos(4.1 * u + 1.0))
    return np.stack([x, y, z], -1)


def tape_roll(rng: Rng = None) -> Shape:
    """A roll of parcel tape lying flat, with its core and a loose end."""
    outer = vary(rng, 0.054, 0.12)
    width = vary(rng, 0.048, 0.1)
    inner = min(vary(rng, 0.038, 0.06), outer - 0.010)
    tape = cad.revolve(
        [(inner + 0.002, 0.0), (outer, 0.0), (outer, width), (inner + 0.002, width)], 64
    )
    core = cad.revolve(
        [(inner, 0.0), (inner + 0.0021, 0.0), (inner + 0.0021, width), (inner, width)], 64
    )
    seam = cad.cylinder(outer - 0.004, 0.0008, width - 0.0004) - cad.cylinder(outer - 0.006, 1.0)
    end = np.array(
        [(outer - 0.0006, 0), (outer - 0.0002, 0.008), (outer - 0.0002, 0.014), (outer, 0.019)]
    )
    tab = [
        cad.hull(
            [
                (x + t, y, z)
                for x, y in end[k : k + 2]
                for t in (-0.0006, 0.0006)
                for z in (0.0, width)
            ]
        )
        for k in range(3)
    ]
    section = [(inner, 0.0), (1.03 * outer, 0.0), (1.03 * outer, width), (inner, width)]
    return assemble(
        name="tape_roll",
        label="roll of tape",
        pieces=(
            (
                tape + (cad.union(*tab) - cad.cylinder(outer - 0.0005, 1.0)),
                shade(rng, (KRAFT, rgb.SKY, rgb.RED, rgb.GREEN, rgb.GREY)),
            ),
            (core, rgb.CREAM if rng is None else shade(rng, (rgb.CREAM, rgb.WHITE))),
            (seam, rgb.BLACK),
        ),
        parts=part.ring_sectors(section, 8),
        mass=vary(rng, 0.16, 0.25),
    )


def flower_pot(rng: Rng = None) -> Shape:
    """An empty clay pot with a rolled rim, standing in its saucer."""
    foot = vary(rng, 0.046, 0.1)
    height = vary(rng, 0.112, 0.12)
    waist = foot + vary(rng, 0.016, 0.2)
    floor = 0.013
    rim = waist + 0.006
    band = height - 0.030
    outer = [(foot, 0.003), (waist, band), (rim, band), (rim + 0.003, height)]
    inner = [(foot - 0.005, floor), (waist - 0.006, band), (rim - 0.004, height)]
    pot = Vessel(outer, inner)
    dish = foot + 0.018
    saucer = [(0.0, 0.0), (foot + 0.004, 0.0), (dish, 0.014), (dish - 0.003, 0.014)]
    saucer += [(foot + 0.002, 0.004), (0.0, 0.004)]
    clay = shade(rng, (rgb.TERRACOTTA, rgb.TERRACOTTA, (0.86, 0.82, 0.74), rgb.TEAL))
    return assemble(
        name="flower_pot",
        pieces=(
            (cad.revolve(saucer) + pot.solid(), clay),
            (_trim(pot, band, height), (0.86 * clay[0], 0.86 * clay[1], 0.86 * clay[2])),
        ),
        parts=(
            part.disc([(foot + 0.004, 0.0), (dish, floor)], 14, is_standing=True),
            *pot.parts(8)[1:],
        ),
        cavity=pot.cavity(),
        mass=vary(rng, 0.55, 0.2),
    )


def _trim(pot: Vessel, low: float, high: float) -> Manifold:
    """Two painted rings around the rim."""
    rings = []
    for z in (low + 0.25 * (high - low), low + 0.75 * (high - low)):
        radius = pot.outer_radius(z)
        section = 0.001 * np.array([(-1.0, 0.0), (0.9, 0.0), (0.9, 3.0), (-1.0, 3.0)])
        rings.append(cad.revolve(np.add(section, (radius, z))))
    return cad.union(*rings)


def basket(rng: Rng = None) -> Shape:
    """A woven basket with an arched handle over its width."""
    width = vary(rng, 0.190, 0.1)
    depth = vary(rng, 0.135, 0.1)
    height = vary(rng, 0.095, 0.15)
    tub = Crate(width, depth, height, 0.005, 0.005, flare=vary(rng, 0.014, 0.3))
    reach = tub.width / 2 + tub.flare - 0.003
    rise = vary(rng, 0.105, 0.15)
    flat = np.array([(-0.008, -0.0035), (0.008, -0.0035), (0.008, 0.0035), (-0.008, 0.0035)])

    def bow(num: int, grow: float) -> np.ndarray:
        turns = np.linspace(np.pi, 0.0, num)
        arch = np.column_stack([reach * np.cos(turns), 0 * turns, rise * np.sin(turns)])
        return np.add(grow * arch, (0, 0, tub.height - 0.010))

    edge = tub.height - 0.010
    rim = cad.hull(np.concatenate([tub.outline(z, -0.003) for z in (edge, tub.height)]))
    rim = rim - cad.hull(
        np.concatenate([tub.outline(z, 0.003) for z in (edge - 0.001, tub.height + 0.001)])
    )
    handle = cad.sweep(bow(25, 1.0), flat) - cad.hull(
        np.concatenate([tub.outline(z, 0.001) for z in (0.0, tub.height)])
    )
    return assemble(
        name="basket",
        pieces=(
            (tub.solid(), shade(rng, (KRAFT, (0.62, 0.44, 0.27), rgb.CREAM))),
            (_weave(tub, edge), shade(rng, (rgb.CREAM, rgb.WOOD, rgb.TEAL, rgb.WHITE))),
            (cad.union(handle, rim), shade(rng, (rgb.WOOD, (0.50, 0.33, 0.20)))),
        ),
        parts=(*tub.parts(), *part.sweep(bow(6, 1.03), flat)),
        cavity=tub.cavity(),
        mass=vary(rng, 0.40, 0.25),
    )


def _weave(tub: Crate, top: float, rows: int = 7) -> Manifold:
    """Raised strands in a chequer around the four walls, up to height `top`."""
    strands = []
    levels = np.linspace(0.004, top - 0.001, rows + 1)
    for j in range(rows):
        low = levels[j] + 0.0008
        high = levels[j + 1] - 0.0008
        rings = [tub.outline(z, inset) for z in (low, high) for inset in (0.001, -0.0018)]
        for wall in range(4):
            columns = (12, 8)[wall % 2]
            for i in range(j % 2, columns, 2):
                shares = np.array([i, i + 1])[:, None] / columns
                ends = [(1 - shares) * ring[wall] + shares * ring[(wall + 1) % 4] for ring in rings]
                strands.append(cad.hull(np.concatenate(ends)))
    return cad.union(*strands)
