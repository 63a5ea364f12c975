"""Desks: L-shaped, with shelf and riser, with drawers."""

from __future__ import annotations

from manifold3d import Manifold

from cluttergen_jax.assets.modeller import bins
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Draw
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from scenes.furniture import joinery


def l_desk(vary: Draw) -> SupportAsset:
    """An L-shaped desk on steel legs. The region is the larger of the L's two limbs."""
    width = vary(1.50, 0.1)
    depth = vary(0.65, 0.1)
    reach = vary(1.25, 0.08)
    limb = vary(0.55, 0.1)
    top = vary(0.735, 0.02)
    thickness = 0.026
    side = 0.045
    low = top - thickness
    x = width / 2
    y = reach / 2
    inner = y - depth
    outline = [(-x, -y), (-x + limb, -y), (-x + limb, inner), (x, inner), (x, y), (-x, y)]
    feet = [
        (-x + 0.06, y - 0.06),
        (x - 0.06, y - 0.06),
        (x - 0.06, inner + 0.06),
        (-x + 0.06, -y + 0.06),
    ]
    feet += [(-x + limb - 0.06, -y + 0.06)]
    rails = [
        cad.box((width - 0.12, 0.03, 0.045), (0, y - 0.06), low - 0.045),
        cad.box((0.03, reach - 0.12, 0.045), (-x + 0.06, 0), low - 0.045),
        cad.box((0.03, depth - 0.12, 0.045), (x - 0.06, y - depth / 2), low - 0.045),
        cad.box((limb - 0.12, 0.03, 0.045), (-x + limb / 2, -y + 0.06), low - 0.045),
    ]
    legs = [cad.box((side, side, low), foot) for foot in feet]
    long_limb = Rectangle((0.0, y - depth / 2), (x, depth / 2))
    short_limb = Rectangle((-x + limb / 2, 0.0), (limb / 2, y))
    is_wide = width * depth >= limb * reach
    return bins.table(
        "l_desk",
        top,
        long_limb if is_wide else short_limb,
        [
            joinery.block((-x, inner, low), (x, y, top)),
            joinery.block((-x, -y, low), (-x + limb, inner, top)),
            *(bins.slab((side, side, low), foot, 0.0) for foot in feet),
        ],
        [
            (
                cad.extrude(outline, thickness - 0.003, low + 0.003),
                vary.color(bins.WOODS[3], *bins.WOODS),
            ),
            (cad.extrude(outline, 0.003, low), joinery.DARK_STEEL),
            (cad.union(*rails, *legs), vary.color(*joinery.METALS, spread=0.02)),
        ],
        "L-shaped desk",
    )


def shelf_desk(vary: Draw) -> SupportAsset:
    """A desk with a shelf below and a riser along its back. The region is the top before the riser."""
    width = vary(1.20, 0.1)
    depth = vary(0.66, 0.08)
    top = vary(0.74, 0.03)
    low = top - 0.025
    side = 0.05
    sheet = 0.018
    wood = vary.color(*bins.WOODS)
    paint = vary.color(*joinery.PAINTS, spread=0.03)
    x = width / 2 - 0.04
    y = depth / 2 - 0.04
    leg_boxes, leg_pieces = joinery.square_legs(x, y, side, low, paint)
    riser_width = 0.86 * width
    riser_depth = 0.22
    riser_height = vary(0.125)
    back = depth / 2 - 0.01
    front = back - riser_depth
    middle = back - riser_depth / 2
    columns = [-riser_width / 2 + sheet / 2, 0.18 * riser_width, riser_width / 2 - sheet / 2]
    under = riser_height - sheet
    panels = [((sheet, riser_depth, under), (column, middle), top) for column in columns]
    shelf = (2 * x - side, 0.55 * depth, sheet)
    shelf_place = (0.0, y - 0.55 * depth / 2)
    shelf_low = 0.20
    rails = [cad.box((2 * x, 0.022, 0.07), (0, sign * y), low - 0.07) for sign in (-1, 1)]
    rails += [cad.box((0.022, 2 * y, 0.07), (sign * x, 0), low - 0.07) for sign in (-1, 1)]
    rails += [cad.box((0.022, 2 * y, 0.04), (sign * x, 0), shelf_low - 0.04) for sign in (-1, 1)]
    return bins.table(
        "shelf_desk",
        top,
        Rectangle(
            (0.0, (front - 0.01 - depth / 2) / 2), (width / 2, (front - 0.01 + depth / 2) / 2)
        ),
        [
            bins.slab((width, depth, top - low), (0, 0), low),
            *leg_boxes,
            *(bins.slab(*panel) for panel in panels),
            bins.slab((riser_width, riser_depth, sheet), (0, middle), top + under),
            bins.slab(shelf, shelf_place, shelf_low),
        ],
        [
            (joinery.board((width, depth, top - low), (0, 0), low, 0.004), wood),
            *leg_pieces,
            (cad.union(*rails), paint),
            (cad.union(*(cad.box(*panel) for panel in panels)), paint),
            (joinery.board((riser_width, riser_depth, sheet), (0, middle), top + under), wood),
            (joinery.board(shelf, shelf_place, shelf_low), joinery.darker(wood, 0.95)),
        ],
        "desk with shelf and riser",
    )


def drawer_desk(vary: Draw) -> SupportAsset:
    """A writing desk with a cabinet of three drawers. Its whole top is the region."""
    width = vary(1.20, 0.1)
    depth = vary(0.60, 0.08)
    top = vary(0.75, 0.03)
    low = top - 0.028
    wood = vary.color(bins.WOODS[1], *bins.WOODS)
    paint = vary.color(*joinery.PAINTS, spread=0.03)
    side = 0.05
    cabinet = (vary(0.40, 0.1), depth - 0.07, low - 0.07)
    place = (width / 2 - 0.02 - cabinet[0] / 2, 0.01)
    face = place[1] - cabinet[1] / 2
    x = -width / 2 + 0.05
    y = depth / 2 - 0.05
    inner = place[0] - cabinet[0] / 2
    apron = ((inner - x, 0.40 * depth, 0.09), ((inner + x) / 2, -0.02), low - 0.09)
    panel = ((inner - x, 0.016, 0.34), ((inner + x) / 2, y), low - 0.34)
    fronts = _drawer_fronts(place[0], face, cabinet, 0.07)
    wide_front = (apron[0][0] - 0.06, 0.014, 0.075)
    wide_y = apron[1][1] - apron[0][1] / 2 - 0.007
    fronts.append((wide_front, (apron[1][0], wide_y), low - 0.083))
    knobs = [
        _handle(front[1][0], front[1][1] - 0.007, front[2] + front[0][2] / 2) for front in fronts
    ]
    feet = [joinery.bar((x, s * y, 0.0), (x, s * y, low), side, side) for s in (-1, 1)]
    plinth = cad.box((cabinet[0] - 0.04, cabinet[1] - 0.04, 0.07), place)
    return bins.table(
        "drawer_desk",
        top,
        Rectangle((0.0, 0.0), (width / 2, depth / 2)),
        [
            bins.slab((width, depth, top - low), (0, 0), low),
            bins.slab(cabinet, place, 0.07),
            bins.slab((cabinet[0] - 0.04, cabinet[1] - 0.04, 0.07), place, 0.0),
            bins.slab(*apron),
            bins.slab(*panel),
            *(bins.slab((side, side, low), (x, s * y), 0.0) for s in (-1, 1)),
        ],
        [
            (joinery.board((width, depth, top - low), (0, 0), low, 0.005), wood),
            (
                cad.union(cad.box(cabinet, place, 0.07), cad.box(*apron), cad.box(*panel), *feet),
                paint,
            ),
            (plinth, joinery.DARK_STEEL),
            (
                cad.union(*(joinery.board(*front, 0.003) for front in fronts)),
                joinery.darker(wood, 0.95),
            ),
            (cad.union(*knobs), joinery.METALS[1]),
        ],
        "desk with drawers",
    )


_Block = tuple[tuple[float, float, float], tuple[float, float], float]


def _drawer_fronts(
    x: float, face: float, cabinet: tuple[float, float, float], low: float
) -> list[_Block]:
    """Size, place and lower height of three fronts on a cabinet's -y face, the lowest the tallest."""
    room = cabinet[2]
    gap = 0.008
    shares = (0.42, 0.32, 0.26)
    fronts: list[_Block] = []
    for share in shares:
        height = share * room
        fronts.append(((cabinet[0] - 0.02, 0.014, height - gap), (x, face - 0.007), low + gap / 2))
        low += height
    return fronts


def _handle(x: float, y: float, z: float) -> Manifold:
    """A bar handle on a face that looks towards -y."""
    return cad.union(
        cad.cylinder(0.005, 0.13, -0.065).rotate((0, 90, 0)).translate((x, y - 0.012, z)),
        *(cad.box((0.008, 0.014, 0.008), (x + s * 0.05, y - 0.006), z - 0.004) for s in (-1, 1)),
    )
