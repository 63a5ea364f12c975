"""What holds pens and papers: a pencil cup, a pen holder, a letter tray."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import palette as rgb
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, assemble, shade, vary
from cluttergen_jax.assets.modeller.vessel import Crate, Vessel
from cluttergen_jax.assets.shape import Cavity, Shape

RAW_WOOD = (0.90, 0.76, 0.55)

# A box's size, its centre in the plane and the height it stands on.
Block = tuple[tuple[float, float, float], tuple[float, float], float]


def pencil_cup(rng: Rng = None) -> Shape:
    """A round cup with two pencils that lean on its rim."""
    foot = vary(rng, 0.036, 0.1)
    rim = vary(rng, 0.041, 0.1)
    height = vary(rng, 0.100, 0.12)
    cup = Vessel([(foot, 0.0), (rim, height)], [(foot - 0.003, 0.005), (rim - 0.003, height)])
    levels = [
        (0.62 * height, 0.0007),
        (0.78 * height, 0.0007),
        (0.78 * height, -0.001),
        (0.62 * height, -0.001),
    ]
    band = cad.revolve([(cup.outer_radius(z) + out, z) for z, out in levels])
    pieces = [
        (cup.solid(), shade(rng, (rgb.TEAL, *rgb.BRIGHT, rgb.CHARCOAL))),
        (band, rgb.WHITE),
    ]
    parts = list(cup.parts(8))
    for angle, length, color in ((5.0, 0.165, rgb.YELLOW), (1.9, 0.150, rgb.RED)):
        start = _around(angle + vary(rng, 0.5, 0.5), foot - 0.010, 0.0068)
        along = _around(angle, rim - 0.0085, height) - start
        solids, core = _pencil(
            start,
            along / np.linalg.norm(along),
            vary(rng, length, 0.1),
            shade(rng, (color, *rgb.BRIGHT)),
        )
        pieces += solids
        parts.append(core)
    return assemble(
        name="pencil_cup",
        pieces=tuple(pieces),
        parts=tuple(parts),
        cavity=cup.cavity(),
        mass=vary(rng, 0.22, 0.2),
    )


def _around(angle: float, radius: float, z: float) -> np.ndarray:
    return np.array([radius * np.cos(angle), radius * np.sin(angle), z])


def _pencil(
    start: np.ndarray, end: np.ndarray, length: float, color: cad.Rgb
) -> tuple[list[tuple[Manifold, cad.Rgb]], Mesh]:
    """A sharpened pencil of a given length from `start` towards `end`, and its part."""
    along = (end - start) / np.linalg.norm(end - start)
    stations = [start + along * s for s in (0.0, length - 0.022, length - 0.006, length)]
    outline = cad.ellipse(0.004, 0.004, 6)
    pieces = [
        (cad.sweep(stations[:2], outline), color),
        (cad.sweep(stations[1:3], outline, scales=[1.0, 0.35]), RAW_WOOD),
        (cad.sweep(stations[2:], outline, scales=[0.35, 0.1]), rgb.BLACK),
    ]
    cells = part.sweep([stations[0], stations[1], stations[3]], outline, scales=[1.0, 1.0, 0.1])
    return pieces, part.hull(np.concatenate([cell.vertices for cell in cells]))


def pen_holder(rng: Rng = None) -> Shape:
    """A box in two compartments; two pens and a ruler stand in the smaller one."""
    crate = Crate(
        vary(rng, 0.108, 0.12), vary(rng, 0.076, 0.1), vary(rng, 0.098, 0.12), 0.004, 0.005
    )
    shelf = 0.16 * crate.width
    wall = ((0.003, crate.depth - 0.006, 0.86 * crate.height), (shelf, 0), 0.002)
    left = shelf + 0.0035
    right = crate.width / 2 - 0.006
    stripe = [cad.box((crate.width + 0.001, crate.depth + 0.001, 0.010), z=0.80 * crate.height)]
    stripe.append(stripe[0] - cad.box((crate.width - 0.001, crate.depth - 0.001, 1.0)))
    pieces = [
        (
            crate.solid() + cad.box(*wall),
            shade(rng, (rgb.CHARCOAL, *rgb.DARK, *rgb.BRIGHT, rgb.WOOD)),
        ),
        (stripe[1], shade(rng, (rgb.GREY, rgb.WHITE, rgb.YELLOW))),
    ]
    parts = [*crate.parts(), part.box(*wall)]
    top = crate.height + vary(rng, 0.048, 0.2)
    for y, drift, color in ((-0.30, -0.10, rgb.BLUE), (-0.08, 0.04, rgb.RED)):
        start = np.array([right - 0.004, y * crate.depth, crate.floor + 0.001])
        end = np.array([left + 0.004, (y + drift) * crate.depth, top - 0.01 * (y < -0.2)])
        solids, core = _pen(start, end, shade(rng, (color, *rgb.BRIGHT)))
        pieces += solids
        parts.append(core)
    edge = [(left + 0.0015, crate.floor - 0.001), (left + 0.0045, crate.floor - 0.001)]
    outline = [*edge, (right - 0.001, top + 0.012), (right - 0.004, top + 0.012)]
    flat = {"depth": 0.026, "y": 0.5 * crate.depth - 0.020}
    ruler = cad.hull(part.upright(outline, **flat).vertices)
    return assemble(
        name="pen_holder",
        pieces=(*pieces, (ruler - cad.box(*wall), rgb.YELLOW)),
        parts=(*parts, part.upright(outline, **flat)),
        cavity=Cavity(
            cad.to_mesh(cad.hull(crate.cavity().solid.vertices) - cad.box(*wall)),
            ((shelf - crate.width / 2) / 2, 0.0, crate.height),
        ),
        mass=vary(rng, 0.30, 0.2),
    )


def _pen(
    start: np.ndarray, end: np.ndarray, color: cad.Rgb
) -> tuple[list[tuple[Manifold, cad.Rgb]], Mesh]:
    """A pen with its cap up, and its part."""
    neck = start + 0.62 * (end - start)
    outline = cad.ellipse(0.0042, 0.0042, 12)
    barrel = cad.sweep(np.stack([start, neck]), 0.9 * outline)
    cap = cad.sweep(np.stack([neck, end]), outline)
    return [(barrel, rgb.WHITE), (cap, color)], part.sweep(np.stack([start, end]), 0.0042)[0]


def letter_tray(rng: Rng = None) -> Shape:
    """Two trays one above the other, open to the front (-y), with paper in both."""
    width = vary(rng, 0.245, 0.08)
    depth = vary(rng, 0.190, 0.08)
    height = vary(rng, 0.115, 0.1)
    wall = 0.0045
    step = 0.52 * height
    sheets = vary(rng, 0.010, 0.5)
    side = [(-0.5, 0.0), (0.5, 0.0), (0.5, 1.0), (0.1, 1.0), (-0.5, 0.78)]
    panels = [
        np.array([(x + s, y * depth, z * height) for s in (-wall / 2, wall / 2) for y, z in side])
        for x in (-(width - wall) / 2, (width - wall) / 2)
    ]
    inner = width - 2 * wall
    back: Block = ((inner, wall, height), (0, (depth - wall) / 2), 0.0)
    shelves: list[Block] = [((inner, depth - wall, wall), (0, -wall / 2), z) for z in (0.0, step)]
    lips: list[Block] = [
        ((inner, wall, 0.014), (0, (wall - depth) / 2), z + wall) for z in (0.0, step)
    ]
    papers: list[Block] = [
        ((0.86 * inner, depth - 3.5 * wall, thick), (0.03 * inner, 0), z + wall)
        for z, thick in ((0.0, 1.6 * sheets), (step, sheets))
    ]
    frame = cad.union(
        *[cad.hull(panel) for panel in panels],
        *[cad.box(*cell) for cell in (back, *shelves, *lips)],
    )
    floor = step + wall
    inside = cad.box((inner, depth - 2 * wall, height - floor), z=floor) - cad.box(*papers[1])
    return assemble(
        name="letter_tray",
        pieces=(
            (frame, shade(rng, (rgb.WOOD, *rgb.DARK, rgb.DARK_WOOD, rgb.TEAL))),
            (cad.box(*papers[0]), rgb.WHITE),
            (cad.box(*papers[1]), shade(rng, (rgb.PAPER, rgb.WHITE), 0.02)),
        ),
        parts=(
            *[part.hull(panel) for panel in panels],
            *[part.box(*cell) for cell in (back, *shelves, *lips, *papers)],
        ),
        cavity=Cavity(cad.to_mesh(inside), (0.0, 0.0, height)),
        mass=vary(rng, 1.1, 0.2),
    )
