"""Tables with a curved outline: round, oval, bar, coffee."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.modeller import joinery
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Rng, shade, vary
from cluttergen_jax.assets.support import Rectangle, SupportAsset

_ROUND_CORNER = 1 - np.sqrt(0.5).item()


def round_table(rng: Rng = None) -> SupportAsset:
    """A round dining table on four splayed legs. The region is the square in the circle."""
    radius, top, thickness = vary(rng, 0.45, 0.12), vary(rng, 0.74, 0.03), vary(rng, 0.028)
    low = top - thickness
    wood = shade(rng, joinery.WOODS)
    head, foot = 0.46 * radius, 0.62 * radius
    feet, heads = joinery.mirrored(foot, foot), joinery.mirrored(head, head)
    legs = [joinery.round_leg((*f, 0.0), (*h, low), 0.014, 0.024) for f, h in zip(feet, heads, strict=True)]
    apron = _ring(0.70 * radius, 0.66 * radius, low - 0.05, low)
    middle = 0.5 * (head + foot)
    return joinery.table(
        "round_table",
        top,
        joinery.oval_region(radius, radius),
        [
            *joinery.oval_boxes(radius, radius, low, top),
            *(joinery.slab((0.04, 0.04, low), place, 0.0) for place in joinery.mirrored(middle, middle)),
        ],
        [
            cad.piece(joinery.plate(cad.ellipse(radius, radius, 96), low, top, 0.005), wood),
            cad.piece(cad.union(*legs, apron), joinery.darker(wood, 0.82)),
        ],
    )


def oval_table(rng: Rng = None) -> SupportAsset:
    """An oval dining table on two columns with long feet. The region is the largest rectangle inside."""
    rx, ry = vary(rng, 0.72, 0.12), vary(rng, 0.43, 0.1)
    top, thickness = vary(rng, 0.745, 0.03), vary(rng, 0.030)
    low = top - thickness
    wood = shade(rng, joinery.WOODS[1:])
    x, reach = 0.48 * rx, 0.66 * ry
    solids, boxes = [], []
    for sign in (-1, 1):
        spine = [(-reach, 0.0), (reach, 0.0), (reach, 0.028), (0.06, 0.075), (-0.06, 0.075), (-reach, 0.028)]
        sole = (
            cad.extrude(spine, 0.07).rotate((90, 0, 0)).rotate((0, 0, 90)).translate((sign * x - 0.035, 0, 0))
        )
        column = cad.box((0.075, 0.16, low - 0.10), (sign * x, 0), 0.05)
        yoke = joinery.board((0.06, 1.25 * ry, 0.05), (sign * x, 0), low - 0.05, 0.008)
        solids += [sole, column, yoke]
        boxes += [
            joinery.slab((0.07, 2 * reach, 0.05), (sign * x, 0), 0.0),
            joinery.slab((0.075, 0.16, low - 0.10), (sign * x, 0), 0.05),
            joinery.slab((0.06, 1.25 * ry, 0.05), (sign * x, 0), low - 0.05),
        ]
    solids.append(cad.box((2 * x, 0.03, 0.09), z=0.22))
    boxes.append(joinery.slab((2 * x - 0.075, 0.03, 0.09), (0, 0), 0.22))
    return joinery.table(
        "oval_table",
        top,
        joinery.oval_region(rx, ry),
        [*joinery.oval_boxes(rx, ry, low, top), *boxes],
        [
            cad.piece(joinery.plate(cad.ellipse(rx, ry, 96), low, top, 0.006), wood),
            cad.piece(cad.union(*solids), joinery.darker(wood, 0.80)),
        ],
        "oval dining table",
    )


def bar_table(rng: Rng = None) -> SupportAsset:
    """A small, high, round table on a steel column. The region is the square in the circle."""
    radius, top, thickness = vary(rng, 0.33, 0.1), vary(rng, 1.06, 0.04), 0.030
    low = top - thickness
    base = 0.74 * radius
    steel = shade(rng, joinery.METALS, 0.02)
    foot = cad.revolve([(0, 0), (base, 0), (base, 0.006), (0.93 * base, 0.014), (0.05, 0.045), (0, 0.045)])
    column = cad.cylinder(0.033, low - 0.06, 0.03)
    collar = cad.cylinder(0.05, 0.07, low - 0.075, top=0.13)
    rail = _ring(0.62 * base, 0.62 * base - 0.012, 0.30, 0.312)
    spokes = [cad.box((1.2 * base, 0.012, 0.010), z=0.301), cad.box((0.012, 1.2 * base, 0.010), z=0.301)]
    core = 0.8 * base
    return joinery.table(
        "bar_table",
        top,
        joinery.oval_region(radius, radius),
        [
            *joinery.oval_boxes(radius, radius, low, top),
            joinery.slab((2 * core, 2 * core, 0.03), (0, 0), 0.0),
            joinery.slab((0.066, 0.066, low - 0.03), (0, 0), 0.03),
        ],
        [
            cad.piece(
                joinery.plate(cad.ellipse(0.992 * radius, 0.992 * radius, 96), low, top, 0.002),
                shade(rng, joinery.WOODS[2:]),
            ),
            cad.piece(_ring(radius, 0.988 * radius, low + 0.002, top - 0.003), joinery.DARK_STEEL),
            cad.piece(cad.union(foot, column, collar, rail, *spokes), steel),
        ],
    )


def coffee_table(rng: Rng = None) -> SupportAsset:
    """A low table with round corners over a slatted shelf. The region stays within the round corners."""
    width, depth, top = vary(rng, 1.10, 0.12), vary(rng, 0.60, 0.12), vary(rng, 0.42, 0.08)
    radius, low, side = 0.05, top - 0.034, 0.05
    wood, paint = shade(rng, joinery.WOODS[1:]), shade(rng, joinery.PAINTS, 0.03)
    x, y = width / 2 - 0.075, depth / 2 - 0.075
    shelf_low, shelf_high = 0.13, 0.148
    frame = [cad.box((side, side, low), place) for place in joinery.mirrored(x, y)]
    frame += [cad.box((2 * x, 0.022, 0.06), (0, sign * y), low - 0.06) for sign in (-1, 1)]
    frame += [cad.box((0.022, 2 * y, 0.06), (sign * x, 0), low - 0.06) for sign in (-1, 1)]
    frame += [cad.box((0.03, 2 * y, 0.03), (sign * x, 0), shelf_low - 0.03) for sign in (-1, 1)]
    count = 5
    pitch = (2 * y - side) / count
    rows = [(k - (count - 1) / 2) * pitch for k in range(count)]
    slats = [joinery.board((2 * x + 0.02, 0.78 * pitch, 0.018), (0, row), shelf_low) for row in rows]
    cut = radius * _ROUND_CORNER
    return joinery.table(
        "coffee_table",
        top,
        Rectangle((0.0, 0.0), (width / 2 - cut, depth / 2 - cut)),
        [
            *joinery.rounded_boxes(width, depth, radius, low, top),
            *(joinery.slab((side, side, low), place, 0.0) for place in joinery.mirrored(x, y)),
            joinery.slab((2 * x - side, 2 * y - side, shelf_high - shelf_low), (0, 0), shelf_low),
        ],
        [
            cad.piece(joinery.plate(cad.rounded_rect(width, depth, radius, 10), low, top, 0.006), wood),
            cad.piece(cad.union(*frame), paint),
            cad.piece(cad.union(*slats), joinery.darker(wood, 0.92)),
        ],
    )


def _ring(outer: float, inner: float, low: float, high: float) -> Manifold:
    """A flat ring around the z axis."""
    return cad.difference(
        cad.cylinder(outer, high - low, low, segments=96), cad.cylinder(inner, 1.0, low - 0.1, segments=96)
    )
