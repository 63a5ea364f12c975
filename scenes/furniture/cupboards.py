"""A kitchen cupboard with two doors and a drawer, which scenes open to place objects, and close."""

from __future__ import annotations

import math
from dataclasses import replace

from manifold3d import Manifold

from cluttergen_jax.assets.doors import with_joints_at
from cluttergen_jax.assets.modeller import bins
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.modeller.draw import Draw
from cluttergen_jax.assets.shape import Joint
from cluttergen_jax.assets.support import Box, SupportAsset
from scenes.furniture import joinery
from scenes.furniture.shelving import Slab, furniture, on_slab

_WIDEST = math.radians(100)
"""Radians: how far a door opens."""


def cupboard(vary: Draw) -> SupportAsset:
    """A base cupboard: a drawer below the worktop, and below it two shelves behind two doors, all open."""
    width = vary(0.80, 0.08)
    depth = vary(0.40, 0.05)
    height = vary(0.90, 0.03)
    sheet = 0.018
    top_sheet = 0.035
    plinth = 0.08
    front_sheet = 0.02
    gap = 0.002
    wood = vary.color(*bins.WOODS)
    paint = vary.color(*joinery.PAINTS, spread=0.03)
    inner = width - 2 * sheet
    # The carcass reaches from its back to y = face; doors and the drawer's front lie before it.
    face = -depth / 2
    lid: Slab = ((width + 0.01, depth + 0.03, top_sheet), (0.0, -0.01), height - top_sheet)
    rail = height - top_sheet - 0.15
    pitch = (rail - plinth) / 2
    deep = depth - sheet
    boards: list[Slab] = [
        ((inner, deep, sheet), (0.0, -sheet / 2), plinth + k * pitch) for k in (1, 0)
    ]
    divider: Slab = ((inner, deep, sheet), (0.0, -sheet / 2), rail - sheet)
    side_height = height - top_sheet
    panels: list[Slab] = [
        ((sheet, depth, side_height), (s * (width - sheet) / 2, 0.0), 0.0) for s in (-1, 1)
    ]
    panels.append(((inner, sheet, side_height - plinth), (0.0, (depth - sheet) / 2), plinth))
    panels.append(((inner, sheet, plinth), (0.0, face + 0.04), 0.0))
    still = [lid, *boards, divider, *panels]
    # The drawer, closed.
    wall = 0.012
    floor = 0.012
    low = rail + 0.008
    length = deep - 0.02
    span = inner - 0.02
    middle = face + length / 2
    tall = 0.09
    bottom: Slab = ((span, length, floor), (0.0, middle), low)
    drawer: list[Slab] = [
        bottom,
        *(((wall, length, tall), (s * (span - wall) / 2, middle), low + floor) for s in (-1, 1)),
        *(
            ((span - 2 * wall, wall, tall), (0.0, middle + s * (length - wall) / 2), low + floor)
            for s in (-1, 1)
        ),
    ]
    before = face - gap - front_sheet / 2
    drawer.append(((width - 2 * gap, front_sheet, 0.15 - 2 * gap), (0.0, before), rail + gap))
    leaf = width / 2 - 2 * gap
    doors: list[Slab] = [
        ((leaf, front_sheet, rail - plinth - gap), (s * (leaf / 2 + gap), before), plinth)
        for s in (-1, 1)
    ]
    moving = [drawer, *([door] for door in doors)]
    boxes: list[Box] = [bins.slab(*each) for each in still]
    pieces: list[cad.Painted] = [
        (joinery.board(*lid, 0.006), wood),
        (cad.union(*(cad.box(*each) for each in (*boards, divider))), bins.WOODS[3]),
        (cad.union(*(cad.box(*each) for each in panels)), joinery.darker(paint, 0.93)),
    ]
    handles = [
        _handle((0.0, before), rail + 0.075, 0.2),
        *(_handle((s * 0.05, before), rail - 0.16, 0.2, upright=True) for s in (-1, 1)),
    ]
    joints: list[Joint] = []
    fronts = (
        Joint("drawer", "slide", (0.0, 0.0, low), (0.0, -1.0, 0.0), 0.0, (0.0, length - 0.04)),
        Joint("door_left", "hinge", (-width / 2, face, 0.0), (0.0, 0.0, -1.0), 0.0, (0.0, _WIDEST)),
        Joint("door_right", "hinge", (width / 2, face, 0.0), (0.0, 0.0, 1.0), 0.0, (0.0, _WIDEST)),
    )
    for joint, slabs, handle in zip(fronts, moving, handles, strict=True):
        own_boxes = tuple(range(len(boxes), len(boxes) + len(slabs)))
        boxes += [bins.slab(*each) for each in slabs]
        own_pieces = [len(pieces)]
        if len(slabs) > 1:
            pieces.append((cad.union(*(cad.box(*each) for each in slabs[:-1])), bins.WOODS[3]))
            own_pieces.append(len(pieces))
        pieces.append((joinery.board(*slabs[-1], 0.003), paint))
        own_pieces.append(len(pieces))
        pieces.append((handle, joinery.METALS[1]))
        own = {"boxes": own_boxes, "pieces": tuple(own_pieces)}
        joints.append(replace(joint, closed=0.0, **own))
    closed = furniture(
        "cupboard",
        [
            *(on_slab(f"shelf_{k}", each, pitch - sheet) for k, each in enumerate(boards, 1)),
            on_slab(
                "drawer", ((span - 2 * wall, length - 2 * wall, floor), (0.0, middle), low), tall
            ),
            on_slab("top", lid),
        ],
        boxes,
        pieces,
        "kitchen cupboard with two doors and a drawer",
        joints,
    )
    opened = {number: joint.range[1] for number, joint in enumerate(joints) if joint.range}
    return with_joints_at(closed, opened)


def _handle(
    place: tuple[float, float], middle: float, length: float, upright: bool = False
) -> Manifold:
    """A bar of a handle before a front at `place`, its middle at a height."""
    bar = cad.cylinder(0.006, length, -length / 2)
    turned = bar if upright else bar.rotate((0, 90, 0))
    return turned.translate((place[0], place[1] - 0.035, middle))
