"""Flat-lying tools: fork, chef's knife, wooden spoon, cutting board. They lie along x."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, choose, hex_rgb, made, shade, vary
from cluttergen_jax.assets.shape import Shape

STEELS = tuple(hex_rgb(code) for code in ("c4c8cc", "b9bdb9", "d3b878", "8d9297"))
GRIPS = tuple(hex_rgb(code) for code in ("25282d", "6b3f23", "8e1f2b", "2f4f6f"))
WOODS = tuple(hex_rgb(code) for code in ("c08a4f", "a56b35", "d8b27c", "7a4a26"))

# By how much parts beside the ones that carry the body keep clear of the table.
RAISE = 0.0004


def fork(rng: Rng = None) -> Shape:
    """A table fork that lies on the end of its handle and on the root of its four tines."""
    length, width = vary(rng, 0.192, 0.1), vary(rng, 0.0250, 0.1)
    thick, arch = vary(rng, 0.0026, 0.12), vary(rng, 0.0080, 0.2)
    ends = np.array([0.0, 0.03, 0.20, 0.45, 0.60, 0.70, 0.76, 0.83, 1.0]) * length
    lifts = np.array([0.0, 0.0, 0.0, 0.75, 1.0, 0.35, 0.0, 0.0, 0.9]) * arch
    grip = vary(rng, 0.0085, 0.12)
    handle, head = [0.55 * grip, grip, 0.95 * grip, 0.0042, 0.0036], [0.3, 0.5, 0.5, 0.44]
    halves = np.array([*handle, *(share * width for share in head)])
    slot = 0.125 * width
    prong = (width - 3 * slot) / 4
    places = (np.arange(4) - 1.5) * (prong + slot)
    gaps = [cad.box((length, slot, 0.1), (1.30 * length, y), z=-0.01) for y in (places[:-1] + places[1:]) / 2]
    solid = cad.difference(_ribbon(ends, halves, lifts, thick), *gaps)
    # Only the two flat legs, the handle's end and the head, reach down to the table.
    raised = [RAISE * (k not in (0, 1, 6)) for k in range(7)]
    legs = [_slab(ends[k : k + 2], halves[k : k + 2], lifts[k : k + 2] + raised[k], thick) for k in range(7)]
    end = part.hull(np.concatenate([legs[0].vertices, legs[1].vertices]))
    tines = [_slab(ends[-2:], np.full(2, prong / 2), lifts[-2:] + RAISE, thick, y, 0.88 * y) for y in places]
    shift = np.array([-length / 2, 0.0, 0.0])
    parts = [piece.transformed(np.eye(3), shift) for piece in (end, *legs[2:], *tines)]
    return made(
        name="fork",
        label="table fork",
        pieces=(cad.piece(solid.translate((-length / 2, 0, 0)), shade(rng, STEELS, 0.03)),),
        parts=tuple(parts),
        mass=vary(rng, 0.050, 0.15),
    )


def _ribbon(ends: np.ndarray, halves: np.ndarray, lifts: np.ndarray, thick: float) -> Manifold:
    """A bent strip along x: half widths and heights of the underside at the stations `ends`."""
    x = np.linspace(ends[0], ends[-1], 65)
    low, half = _eased(x, ends, lifts), _eased(x, ends, halves)
    side = cad.from_side(np.column_stack([np.append(x, x[::-1]), np.append(low, low[::-1] + thick)]), 1.0)
    plan = cad.extrude(np.column_stack([np.append(x, x[::-1]), np.append(-half, half[::-1])]), 0.2, -0.1)
    return side ^ plan


def _eased(x: np.ndarray, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values between knots, joined by half cosines so that what is flat stays flat and nothing overshoots."""
    cell = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    share = (x - knots[cell]) / (knots[cell + 1] - knots[cell])
    # Halfway between the straight line and the half cosine: rounded bends, and yet close to the parts.
    share = 0.5 * share + 0.25 * (1 - np.cos(np.pi * share))
    return values[cell] + (values[cell + 1] - values[cell]) * share


def _slab(
    ends: np.ndarray,
    halves: np.ndarray,
    lifts: np.ndarray,
    thick: float,
    start: float = 0.0,
    stop: float = 0.0,
) -> Mesh:
    """One straight leg of a bent strip, its middle going from y = `start` to y = `stop`."""
    corners = [
        (x, middle + sign * half, low + up)
        for x, half, low, middle in zip(ends, halves, lifts, (start, stop), strict=True)
        for sign in (-1, 1)
        for up in (0.0, thick)
    ]
    return part.hull(corners)


def knife(rng: Rng = None) -> Shape:
    """A chef's knife lying on its side, blade and handle flat on the table."""
    blade, grip = vary(rng, 0.195, 0.15), vary(rng, 0.125, 0.08)
    heel, height = vary(rng, 0.046, 0.15), vary(rng, 0.017, 0.1)
    spine = 0.012
    belly = [(blade, spine - 0.004), (0.86 * blade, spine - 0.42 * heel), (0.62 * blade, spine - 0.80 * heel)]
    belly += [(0.35 * blade, spine - 0.96 * heel), (0.0, spine - heel)]
    edge = cad.smooth_path(belly, 24)
    outline = np.concatenate([[(-0.012, spine), (0.70 * blade, spine)], edge, [(-0.012, -0.012)]])
    flat = cad.extrude(outline, 0.0024)
    handle = cad.above(cad.rounded_box((grip, 0.026, height), 0.005, (-grip / 2 - 0.004, 0.0), z=-0.0016))
    handle = handle ^ cad.box((1.0, 1.0, 1.0))
    spots = [(-0.2 * grip, 0.0), (-0.5 * grip, 0.0), (-0.8 * grip, 0.0)]
    rivets = cad.union(
        *(cad.cylinder(0.0036, height - 0.003, 0.0018, center=spot, segments=20) for spot in spots)
    )
    steel = shade(rng, STEELS[:2], 0.03)
    top = height - 0.0016
    return made(
        name="knife",
        label="chef's knife",
        pieces=(
            cad.piece(cad.difference(flat, handle), steel),
            cad.piece(handle, shade(rng, GRIPS, 0.03)),
            cad.piece(cad.difference(rivets, handle), steel),
        ),
        parts=(
            part.prism([(-0.004, spine), (0.70 * blade, spine), *belly[1:], (-0.004, -0.012)], 0.0024),
            part.prism([(0.70 * blade, spine), *belly[:2]], 0.0024),
            part.box((grip, 0.026, top), (-grip / 2 - 0.004, 0.0)),
        ),
        mass=vary(rng, 0.23, 0.15),
    )


def wooden_spoon(rng: Rng = None) -> Shape:
    """A cooking spoon with a flat underside, its bowl at +x."""
    length, reach, half = vary(rng, 0.290, 0.12), vary(rng, 0.040, 0.12), vary(rng, 0.028, 0.12)
    radius = vary(rng, 0.0062, 0.12)
    center = length / 2 - reach
    bowl = cad.above(Manifold.sphere(1.0, 48).scale((reach, half, 0.017)).translate((center, 0, 0.009)))
    bowl = bowl.trim_by_plane((0, 0, -1), -0.016)
    scoop = Manifold.sphere(1.0, 40).scale((0.86 * reach, 0.84 * half, 0.0135)).translate((center, 0, 0.0188))
    ends = ((-length / 2, 1.15 * radius), (center - 0.5 * reach, radius))
    stick = Manifold.hull(cad.union(*(_rod_end(x, size) for x, size in ends)))
    rings = [(0.82, 0.0, 4), (0.86, part.LIFT, 8), (1.0, 0.009, 8), (0.91, 0.016, 8)]
    corners = [np.column_stack([cad.ellipse(s * reach, s * half, n), np.full(n, z)]) for s, z, n in rings]
    grip = [(x, y, z) for x, size in ends for y, z in _rod_corners(size)]
    return made(
        name="wooden_spoon",
        pieces=(cad.piece(cad.difference(cad.union(bowl, stick), scoop), shade(rng, WOODS)),),
        parts=(part.hull(np.concatenate(corners) + np.array([center, 0, 0])), part.hull(grip)),
        mass=vary(rng, 0.045, 0.2),
    )


def _rod_end(x: float, radius: float) -> Manifold:
    """A short round piece of a rod along x, cut flat at z = 0."""
    disc = cad.cylinder(radius, 0.002, segments=24).rotate((0, 90, 0)).translate((x - 0.001, 0, 0.7 * radius))
    return cad.above(disc)


def _rod_corners(radius: float) -> cad.Points2:
    """The section of such a rod as a polygon in (y, z)."""
    right = [(0.71 * radius, 0.0), (radius, 0.7 * radius), (0.5 * radius, 1.62 * radius)]
    return [*right, *((-y, z) for y, z in reversed(right))]


def cutting_board(rng: Rng = None) -> Shape:
    """A wooden board with a juice groove and a handle with a hole at its +x end."""
    width, depth, thick = vary(rng, 0.270, 0.15), vary(rng, 0.190, 0.15), vary(rng, 0.018, 0.2)
    handle, span = vary(rng, 0.085, 0.15), vary(rng, 0.062, 0.12)
    reach = width / 2 + handle
    tongue, tip = (
        cad.rounded_rect(handle + more, span, 0.45 * span, num) + np.array([reach - (handle + more) / 2, 0.0])
        for more, num in ((0.06, 10), (0.01, 2))
    )
    board = cad.union(cad.extrude(cad.rounded_rect(width, depth, 0.018), thick), cad.extrude(tongue, thick))
    inner, outer = (cad.rounded_rect(width - gap, depth - gap, 0.014) for gap in (0.040, 0.028))
    groove = cad.difference(cad.extrude(outer, 0.01, thick - 0.003), cad.extrude(inner, 0.01, thick - 0.003))
    hole = cad.cylinder(0.22 * span, 0.1, -0.01, center=(reach - 0.45 * span, 0.0))
    wood = shade(rng, WOODS)
    stripe = choose(rng, (0.28, -0.28, 0.0)) * depth
    band = cad.difference(cad.box((width, 0.10 * depth, thick), (0.0, stripe)) ^ board, groove)
    dark = tuple(0.62 * channel for channel in wood)
    return made(
        name="cutting_board",
        pieces=(
            cad.piece(cad.difference(board, groove, hole, band), wood),
            cad.piece(band, (dark[0], dark[1], dark[2])),
        ),
        parts=(part.box((width, depth, thick)), part.prism(tip, thick - RAISE, RAISE)),
        mass=thick * (width * depth + handle * span) * vary(rng, 650.0, 0.1),
    )
