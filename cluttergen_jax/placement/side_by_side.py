"""Which pairs of objects find no room side by side in a region: checked before anything is placed."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.boxes import ASKEW
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.outlines import NUM_DIRECTIONS, Outlines, directions
from cluttergen_jax.placement.room import MOST_PACKED, outline_areas
from cluttergen_jax.placement.types import Geometry

_TURNS = 72
_STEPS = (0.022, 0.006)
"""Radians by which the best turns of two objects are changed again, to either side."""
_EDGE = 5
"""Places of one object beside another that are tried along each side of all there are."""
_DRAWS = 2000
_MOST_PAIRS = 300
"""That are looked at: of more, which is many large objects, the first."""
_MOST_NAMED = 8
_ROUNDING = 1e-5


def check_pairs(
    geometry: Geometry,
    objects: Sequence[ObjectAsset],
    region: Rectangle,
    placement: PlacementConfig,
) -> tuple[str, ...]:
    """What is to be known of objects that find no room side by side, two by two; often nothing.

    Args:
      geometry: of a world; objects: its first ones, of which scenes are drawn.

    Raises:
      ConfigError: every draw has such a pair, or covers more than finds room.
    """
    half = np.array(region.half_extents)
    outlines = np.asarray(Outlines.of(geometry).corners)[: len(objects)]
    is_apart = pairs_without_room(outlines, half, placement.clearance)
    if not is_apart.any():
        return ()
    number = placement.num_objects
    areas = outline_areas(objects, placement.clearance) / (4 * float(half.prod()))
    share = _share_that_fit(is_apart, areas, number)
    x, y = 2 * half
    where = f"{1000 * placement.clearance:g} mm apart, in a region of {x:.2f} x {y:.2f} m"
    pairs = _pairs_text(is_apart, [each.name for each in objects])
    out = _to_leave_out(is_apart, number)
    if share == 0:
        hint = f"exclude={tuple(objects[k].name for k in out)!r}" if out else "a larger region"
        raise ConfigError(
            f"{number} objects of which some do not fit side by side, {where}: {pairs}",
            "objects that do, two by two",
            f"{hint}, fewer objects, or clutter='stack=1', by which one may lie on another",
        )
    without = f"; without {', '.join(objects[k].name for k in out)} every two do" if out else ""
    return (
        f"of 100 draws of {number} objects {100 * share:.0f} at most fit side by side, {where}, as these "
        f"do not: {pairs}{without}",
    )


def pairs_without_room(
    outlines: np.ndarray, half_extents: np.ndarray, clearance: float
) -> np.ndarray:
    """bool[K, K]: pairs of which no place and no turn keeps both in a region, and a clearance apart.

    Args:
      outlines: f[K, P, D, 2], corners (`Outlines`).
      half_extents: f64[2], the region's, metres; clearance: metres, to the region's sides as well.
    """
    corners = [_distinct(each) for each in outlines.astype(np.float64)]
    room = half_extents - clearance
    turns = _off_square(np.linspace(0, 2 * np.pi, _TURNS, endpoint=False))
    # Two that lie within stripes one beside the other need no closer look.
    sizes = np.array([_sizes(each, turns, room) for each in corners])
    fits = sizes[:, None] + sizes + clearance <= 2 * room
    is_unclear = np.triu(~fits.any(-1), 1)
    found = np.zeros(is_unclear.shape, bool)
    for one, other in list(zip(*np.nonzero(is_unclear), strict=True))[:_MOST_PAIRS]:
        found[one, other] = _best_gap(corners[one], corners[other], turns, room) < clearance
    return found | found.T


def _distinct(corners: np.ndarray) -> np.ndarray:
    """f64[P, V, 2]: one piece where an outline is convex."""
    return corners[:1] if (corners == corners[0]).all() else corners


def _off_square(turns: np.ndarray) -> np.ndarray:
    """f64[Y]: turns none of which is exactly along the region's sides, nor is one there (`boxes.askew`)."""
    quarter = np.pi / 2
    nearest = np.round(turns / quarter) * quarter
    off = turns - nearest
    side = np.where(off < 0, -1.0, 1.0)
    least = np.maximum(np.abs(off), ASKEW[0]) * side
    return np.unique(np.concatenate([nearest + least, nearest - least]))


def _reach(corners: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """f64[Y, P, D]: how far the pieces f64[P, V, 2] reach along each direction, by turns f64[Y]."""
    cos = np.cos(turns)
    sin = np.sin(turns)
    rotation = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=1)
    return (corners @ (rotation @ directions().T)[:, None]).max(2)


def _limits(reach: np.ndarray, room: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[Y, 2] each: between which an object is in the region."""
    quarter = NUM_DIRECTIONS // 4
    whole = reach.max(1)
    return whole[:, [2 * quarter, 3 * quarter]] - room, room - whole[:, [0, quarter]]


def _sizes(corners: np.ndarray, turns: np.ndarray, room: np.ndarray) -> np.ndarray:
    """f64[2], metres: how wide an object is at least, along each side, where the region is wide enough."""
    low, high = _limits(_reach(corners, turns), room)
    size = 2 * room - (high - low)
    fits = size <= 2 * room + _ROUNDING
    return np.where(fits[:, ::-1], size, np.inf).min(0)


def _best_gap(one: np.ndarray, other: np.ndarray, turns: np.ndarray, room: np.ndarray) -> float:
    """Metres between two objects that a region keeps apart as far as it can; less than 0 where they overlap.

    Args:
      one, other: f64[P, V, 2], corners; turns: f64[Y], those that are tried; room: f64[2], half extents.
    """
    # Half a turn of everything changes nothing.
    best = _gap(one, other, (turns[turns < np.pi], turns), room)
    for step in _STEPS:
        near = np.linspace(-step, step, 5)
        closer = tuple(_off_square(at + near) for at in best[1:])
        best = max(best, _gap(one, other, closer, room))
    return best[0]


def _gap(
    one: np.ndarray, other: np.ndarray, turns: Sequence[np.ndarray], room: np.ndarray
) -> tuple[float, float, float]:
    """The widest gap of two objects, metres, and the turn of each there, of those that are tried for it."""
    best = (-np.inf, 0.0, 0.0)
    reach, far = (_reach(each, tried) for each, tried in zip((one, other), turns, strict=True))
    low, high = _limits(reach, room)
    their_low, their_high = _limits(far, room)
    fits = np.flatnonzero((their_low <= their_high + _ROUNDING).all(1))
    back = np.roll(far[fits], NUM_DIRECTIONS // 2, -1)[:, None]
    for index in np.flatnonzero((low <= high + _ROUNDING).all(1)):
        # From one to the other: from the farthest to one side to the farthest to the other.
        first = their_low[fits] - high[index]
        last = their_high[fits] - low[index]
        away = first[:, None] + _around() * (last - first)[:, None]
        beyond = (away @ directions().T)[:, :, None, None] - (reach[index][:, None] + back)[:, None]
        gap = beyond.max(-1).min((-1, -2))
        if gap.size and gap.max() > best[0]:
            at = fits[np.argmax(gap) // gap.shape[1]]
            best = (float(gap.max()), float(turns[0][index]), float(turns[1][at]))
    return best


def _around() -> np.ndarray:
    """f64[G, 2]: places along the sides of a square, from 0 to 1: two are farthest apart there."""
    share = np.linspace(0, 1, _EDGE)
    places = np.array(list(itertools.product(share, share)))
    return places[(np.abs(places - 0.5) == 0.5).any(1)]


def _share_that_fit(is_apart: np.ndarray, areas: np.ndarray, number: int) -> float:
    """The share of draws without such a pair, whose outlines f64[K], over the region, leave enough room."""
    order = np.random.default_rng(0).random((_DRAWS, len(areas))).argsort(1)[:, :number]
    has_pair = is_apart[order[:, :, None], order[:, None]].any((1, 2))
    return float((~has_pair & (areas[order].sum(1) <= MOST_PACKED)).mean())


def _in_most_pairs_first(is_apart: np.ndarray) -> Iterator[tuple[int, list[int]]]:
    """Objects, of most pairs first, each with the others of its pairs that were not named before."""
    left = is_apart.copy()
    while left.any():
        one = int(left.sum(1).argmax())
        yield one, np.flatnonzero(left[one]).tolist()
        left[one] = False
        left[:, one] = False


def _to_leave_out(is_apart: np.ndarray, number: int) -> list[int]:
    """Those without which no pair is left; nothing where too few would be left."""
    out = sorted(one for one, _ in _in_most_pairs_first(is_apart))
    return out if len(is_apart) - len(out) >= number else []


def _pairs_text(is_apart: np.ndarray, names: Sequence[str]) -> str:
    """Each object with those beside which it finds no room, of most pairs first."""
    texts = [
        f"{names[one]} with {' or '.join(names[k] for k in others)}"
        for one, others in _in_most_pairs_first(is_apart)
    ]
    more = f", and {len(texts) - _MOST_NAMED} more" if len(texts) > _MOST_NAMED else ""
    return ", ".join(texts[:_MOST_NAMED]) + more
