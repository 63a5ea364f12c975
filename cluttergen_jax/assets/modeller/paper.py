"""Paper goods: a hardback book, a block of sticky notes, a ring binder."""

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

BOARD = 0.003


def hardback_book(rng: Rng = None) -> Shape:
    """A closed book lying on its back cover, its rounded spine towards -y."""
    width, depth = vary(rng, 0.215, 0.12), vary(rng, 0.150, 0.12)
    height = vary(rng, 0.034, 0.35)
    turns = np.linspace(-np.pi / 2, np.pi / 2, 9)
    arc = np.column_stack([-depth / 2 - 0.005 * np.cos(turns), height / 2 * (1 + np.sin(turns))])
    rounded = [(x, y, z) for y, z in arc for x in (-width / 2, width / 2)]
    boards = [cad.box((width, depth, BOARD), z=z) for z in (0.0, height - BOARD)]
    cover = cad.union(*boards, cad.hull([*rounded, *[(x, -depth / 2 + 0.001, z) for x, _, z in rounded]]))
    pages = cad.box((width - 0.010, depth - 0.008, height - 2 * BOARD), (0, 0.002), BOARD)
    title = _cover_art(choose(rng, ("ATLAS", "FABLES", "DUNES", "TALES")), width, depth, height)
    return made(
        name="hardback_book",
        pieces=(
            cad.piece(cover, shade(rng, (rgb.NAVY, *rgb.MUTED))),
            cad.piece(pages - cover, shade(rng, (rgb.PAPER,), 0.03)),
            cad.piece(title, shade(rng, (rgb.GOLD, rgb.CREAM, rgb.STEEL))),
        ),
        parts=(part.hull([*rounded[::4], *rounded[1::4], *_box_corners(width, depth, height)]),),
        mass=720.0 * width * depth * height,
    )


def _box_corners(width: float, depth: float, height: float) -> list[tuple[float, float, float]]:
    return [(x * width, y * depth, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, height)]


def _cover_art(word: str, width: float, depth: float, height: float) -> Manifold:
    """A framed title on the front cover and bands across the spine."""
    size = (width * 0.84, depth * 0.80)
    frame = cad.box((*size, 0.0012), z=-0.0006) - cad.box((size[0] - 0.006, size[1] - 0.006, 0.01), z=-0.005)
    front = cad.union(frame, lettering(word, 0.17 * depth).translate((0, 0.10 * depth, 0)))
    front += cad.box((0.3 * width, 0.004, 0.0012), (0, -0.18 * depth), -0.0006)
    spine = [
        cad.box((0.004, 0.0030, 0.8 * height), (x * width, -depth / 2 - 0.0035), 0.1 * height)
        for x in (-0.40, -0.36, 0.36, 0.40)
    ]
    word_height = min(0.42 * height, 0.02)
    words = lettering(word, word_height).rotate((90, 0, 0))
    spine.append(words.translate((0, -depth / 2 - 0.0047, height / 2)))
    return cad.union(front.translate((0, 0, height)), *spine)


def sticky_notes(rng: Rng = None) -> Shape:
    """A stack of pads in three colours, its top sheet written on and curling up."""
    side = vary(rng, 0.076, 0.12)
    height = vary(rng, 0.042, 0.25)
    cuts = np.array([0.0, 0.30, 0.62, 1.0]) * height
    colors = (
        [rgb.YELLOW, rgb.PINK, rgb.SKY]
        if rng is None
        else [rgb.BRIGHT[k] for k in rng.permutation(len(rgb.BRIGHT))[:3]]
    )
    # The lower pads are bands around one block: surfaces inside a body would be sampled as if they were seen.
    core = (side - 0.002, side - 0.002, 1.0)
    pads = [
        cad.piece(cad.box((side, side, high - low), z=low) - cad.box(core, z=low - 0.1), color)
        for low, high, color in zip(cuts[:2], cuts[1:3], colors[1:], strict=True)
    ]
    block = cad.union(cad.box((*core[:2], height)), cad.box((side, side, height - cuts[2]), z=cuts[2]))
    note = lettering("TO DO", 0.16 * side).translate((0, 0.24 * side, 0))
    for k, length in enumerate((0.62, 0.52, 0.58)):
        row = (0.06 - 0.15 * k) * side
        note += cad.box((length * side, 0.0022, 0.0012), ((length - 0.74) * side / 2, row), -0.0006)
    return made(
        name="sticky_notes",
        pieces=(
            cad.piece(block, colors[0]),
            *pads,
            cad.piece(_curled_sheet(side).translate((0, 0, height)), colors[0]),
            cad.piece(note.translate((0, 0.02 * side, height)), rgb.NAVY),
        ),
        parts=(part.box((side, side, height)), _curl_part(side, height)),
        mass=700.0 * side * side * height,
    )


CURL = 0.052


def _curled_sheet(side: float) -> Manifold:
    """The front edge of a sheet that bends up from z = 0, as wide as the block."""
    share = np.linspace(0.0, 1.0, 7)
    y, z = -(0.26 + 0.24 * share) * side, CURL * share**2 * side
    strips = []
    for k in range(6):
        edges = [(y[k + j], z[k + j] + up) for j in (0, 1) for up in (-0.0002, 0.0010)]
        strips.append(cad.hull([(x, *edge) for x in (-side / 2, side / 2) for edge in edges]))
    return cad.union(*strips)


def _curl_part(side: float, height: float) -> Mesh:
    """A flat leaf along the curled edge, thick enough to be felt."""
    ends = ((-0.30, 0.0, -0.001), (-0.30, 0.0, 0.001), (-0.5, CURL, -0.001), (-0.5, CURL, 0.001))
    return part.hull([(s * side / 2, y * side, height + z * side + up) for s in (-1, 1) for y, z, up in ends])


def ring_binder(rng: Rng = None) -> Shape:
    """A lever-arch file standing upright, its labelled spine towards -y."""
    height, depth = vary(rng, 0.250, 0.08), vary(rng, 0.205, 0.08)
    width = vary(rng, 0.066, 0.2)
    hole = 0.20 * height
    spine = cad.difference(
        cad.box((width, 0.004, height), (0, -depth / 2 + 0.002)),
        cad.cylinder(0.013, 0.02, -0.01).rotate((90, 0, 0)).translate((0, -depth / 2, hole)),
    )
    sides = [cad.box((BOARD, depth, height), (s * (width - BOARD) / 2, 0)) for s in (-1, 1)]
    pages_size = (width - 2 * BOARD - 0.006, depth - 0.030, height - 0.018)
    pages = cad.box(pages_size, (0, 0.008), 0.006)
    ring = cad.cylinder(0.016, 0.004, segments=32) - cad.cylinder(0.011, 0.02, -0.01, segments=32)
    arch = [
        cad.cylinder(0.002, 0.020, center=(x, 0.055), z=0.006 + pages_size[2] - 0.008, segments=12)
        for x in (-0.25 * width, 0.25 * width)
    ]
    front = -depth / 2 - 0.001
    label = cad.box((0.68 * width, 0.0016, 0.42 * height), (0, front + 0.0008), 0.46 * height)
    words = lettering("FILE", 0.13 * width).rotate((90, 0, 0)).translate((0, front, 0.79 * height))
    lines = [cad.box((0.5 * width, 0.001, 0.003), (0, front), z * height) for z in (0.54, 0.61, 0.68)]
    return made(
        name="ring_binder",
        pieces=(
            cad.piece(
                cad.union(spine, *sides),
                shade(rng, (rgb.CRIMSON, rgb.NAVY, rgb.FOREST, *rgb.BRIGHT[:3], rgb.CHARCOAL)),
            ),
            cad.piece(pages, rgb.PAPER),
            cad.piece(
                cad.union(ring.rotate((90, 0, 0)).translate((0, -depth / 2 + 0.002, hole)), *arch), rgb.STEEL
            ),
            cad.piece(label, rgb.WHITE),
            cad.piece(cad.union(words, *lines), rgb.CHARCOAL),
        ),
        parts=(
            part.box((width, 0.004, height), (0, -depth / 2 + 0.002)),
            *[part.box((BOARD, depth, height), (s * (width - BOARD) / 2, 0)) for s in (-1, 1)],
            part.box(pages_size, (0, 0.008), 0.006),
        ),
        mass=vary(rng, 0.9, 0.2),
    )
