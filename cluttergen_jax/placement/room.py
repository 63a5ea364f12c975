"""How much room there is: what is refused before a world is compiled, and attempts that crowded scenes get.

Refused are more objects than there are or than a region holds, what is too large for its walls or too tall
for what hangs over it, and what would tip or slide on a slope, however it is turned.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import Rectangle, SupportAsset, ring_area
from cluttergen_jax.assets.support_map import rim_height
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.errors import ConfigError, range_text
from cluttergen_jax.geometry import hull_area
from cluttergen_jax.physics.margin import support_margin
from cluttergen_jax.placement.config import MAX_BUDGET, MAX_SLOTS, PlacementConfig

if TYPE_CHECKING:
    from cluttergen_jax.placement.problem import ProblemConfig

_TURNS = 360
"""Headings that are tried within walls, half a degree apart."""
_SLACK = 0.002
"""Metres by which an object may be too large: contacts give way, and headings lie between those tried."""
_MOST_NAMED = 8
MOST_CROWDED = 8.0
"""Footprints over the region's area from which a request is refused. Objects overhang and stand on others:
`drop` fills 2 of 16 tables with ten of dining at 1.7, none at 4.2; only a stack of plates gets farther."""
MOST_FULL = 1.0
"""Volume of the objects' hulls, in the mean, over that of what holds them, from which a pile is refused."""
MOST_PACKED = 0.9
"""Outlines' area over the region's, in the mean, from which a request is refused that nothing may be stacked
for: no way of packing things of many shapes gets farther."""
USUALLY_PACKED = 0.7
"""Likewise, of nearly every draw: beyond, some draws find no room side by side."""
USUALLY_FULL = 0.8
"""Likewise, of nearly every draw: the largest objects are left out until it is so. Of piles of 15 of all
pools in a bin, 10 of 10 succeeded below 0.95, 8 of 17 from there to 1.3, 3 of 13 above."""
_NEARLY_EVERY = 1.3
"""Standard deviations of a draw's volume above its mean: nine of ten draws are below."""
ROOM = 0.003
"""Metres that have to be free above the tallest object under a board."""
_ROOMY = 1.5
"""Area of the boxes of all objects over the region's up to which the usual number of attempts is enough."""
_CROWDED = 2.0
"""Likewise, from which objects are led onto others, where many have to lie; below, that only costs."""
_TWICE_AS_MANY = 0.35
"""By how much more of it twice as many are needed."""
_MOST_EACH = 20
"""Attempts for each object. Of fifty of all pools, which cover 2.8 tables, `guided` fills 62 of 64 with so
many, and 57 with 12."""
# Metres: of a base's points, and of a margin that holds.
_TOUCHING = 1e-4
_STANDS = 0.0005
_HEADINGS = 16
"""That are tried on a slope."""


def check_number(wanted: int, available: int, pool: str, repeat: bool = False) -> None:
    """Refuses more objects than there are (ConfigError)."""
    if wanted > available and not repeat:
        raise ConfigError(
            f"{wanted} objects asked for, {available} chosen of pool {pool!r}",
            f"{range_text(1, available)}, or more (up to {MAX_SLOTS}) where objects may come more than once",
            f"num_objects={available}, or repeat=True (of generate and evaluate)",
        )


def check_sets(num_sets: int | None, num_objects: int, available: int, repeat: bool) -> None:
    """Refuses more sets of objects than there are different ones (ConfigError)."""
    if num_sets is None:
        return
    most = math.comb(available + num_objects - 1 if repeat else available, num_objects)
    if num_sets > most:
        raise ConfigError(
            f"{num_sets} sets of {num_objects} of {available} objects",
            range_text(1, most),
            "fewer sets, more `objects`, or another `num_objects`",
        )


def check_left(
    wanted: int, left: Sequence[ObjectAsset], notes: Sequence[str], repeat: bool = False
) -> None:
    """Refuses more objects than are left (ConfigError), of which `notes` say what was left out."""
    if len(left) and (wanted <= len(left) or repeat):
        return
    raise ConfigError(
        f"{wanted} objects, of which {len(left)} are left; {'; '.join(notes)}",
        range_text(1, len(left), "objects that find room"),
        f"num_objects={len(left)}" if left else "a larger support or region",
    )


def crowding(
    objects: Sequence[ObjectAsset], num_objects: int, region: Rectangle, area: float = 0.0
) -> float:
    """The area that the smallest `num_objects` objects cover at least, seen from above, over the region's.

    `area` is taken in place of that, where it is more than 0.
    """
    areas = sorted(hull_area(asset.vertices[:, :2]) for asset in objects)
    # Of objects that may stand there more than once, all are there before any comes again.
    rounds, rest = divmod(num_objects, len(areas))
    covered = rounds * sum(areas) + sum(areas[:rest])
    return covered / (area or 4 * float(np.prod(region.half_extents)))


def boxes_over_area(
    sizes: Sequence[tuple[float, float, float]], config: ProblemConfig, support: SupportAsset
) -> float:
    """The area of the boxes of a scene's objects, seen from above and in the mean, over the region's.

    Args:
      sizes: metres, sides of the boxes of all objects that may be drawn.
    """
    if not sizes:
        return 0.0
    area = area_asked(config, support) or _area_of(config.region or support.region)
    each = np.prod([size[:2] for size in sizes], axis=1).mean()
    return config.placement.num_objects * float(each) / area


def with_crowding(placement: PlacementConfig, covered: float) -> PlacementConfig:
    """The rules where objects cover so much (`boxes_over_area`) and some are taken away and placed again.

    `max_attempts` for each object are enough where boxes cover the region once or so. Beyond that most
    attempts place again what was taken away: the usual number grows with how much they cover, up to
    `_MOST_EACH` for each object.
    """
    if covered <= _ROOMY or not placement.ruin_after:
        return placement
    each = min(placement.max_attempts * 2 ** ((covered - _ROOMY) / _TWICE_AS_MANY), _MOST_EACH)
    budget = min(round(max(each, placement.max_attempts) * placement.num_objects), MAX_BUDGET)
    given = placement.budget
    return replace(
        placement, is_crowded=covered > _CROWDED, budget=budget if given is None else given
    )


def area_of(support: SupportAsset) -> float:
    """Square metres: the regions of several surfaces together; 0 where objects are asked for on one."""
    if not support.named or len(support.asked) < 2:
        return 0.0
    return sum(4 * math.prod(surface.region.half_extents) for surface, _ in support.asked)


def area_asked(config: ProblemConfig, support: SupportAsset) -> float:
    """Square metres: of a polygon, or of several surfaces together; 0 where a rectangle is asked for."""
    return abs(ring_area(config.polygon)) if config.polygon else area_of(support)


def check_crowding(
    objects: Sequence[ObjectAsset], config: ProblemConfig, support: SupportAsset
) -> None:
    """Refuses more objects than can be hoped to find room in the region (ConfigError)."""
    region = config.region or support.region
    num_objects = config.placement.num_objects
    if config.is_piled and (depth := rim_height(region, support)) > 0:
        _check_volume(objects, num_objects, region, depth)
        return
    area = area_asked(config, support)
    if config.placement.most_stacked is not None and not config.shelf:
        _check_side_by_side(objects, config, area or _area_of(region))
    crowded = crowding(objects, num_objects, region, area)
    if crowded <= MOST_CROWDED:
        return
    x, y = region.half_extents
    numbers = range(num_objects - 1, 0, -1)
    most = next((n for n in numbers if crowding(objects, n, region, area) <= MOST_CROWDED), 0)
    raise ConfigError(
        f"{num_objects} objects in a region of {2 * x:.2f} x {2 * y:.2f} m: even the "
        f"smallest ones' footprints cover {crowded:.1f} times its area",
        f"{MOST_CROWDED:g} times at most; beyond about once, scenes begin to fail",
        f"num_objects={most}, or a larger region" if most else "smaller objects or a larger region",
    )


def _area_of(region: Rectangle) -> float:
    return 4 * float(np.prod(region.half_extents))


def share_packed(
    objects: Sequence[ObjectAsset], placement: PlacementConfig, area: float
) -> tuple[float, float]:
    """Outlines' area of what lies side by side, over the region's: in the mean, and of nearly every draw."""
    areas = outline_areas(objects, placement.clearance)
    number = max(placement.num_objects - (placement.most_stacked or 0), 1)
    return number * float(areas.mean()) / area, _nearly_every(areas, number) / area


def outline_areas(objects: Sequence[ObjectAsset], clearance: float) -> np.ndarray:
    """f64[K], square metres: of convex outlines, seen from above and half the clearance wider."""
    from scipy.spatial import ConvexHull

    outlines = [ConvexHull(asset.vertices[:, :2]) for asset in objects]
    # Of an outline, `area` is the length and `volume` the area.
    return np.array([each.volume + each.area * clearance / 2 for each in outlines])


def _nearly_every(sizes: np.ndarray, number: int) -> float:
    """What so many of the sizes f64[N] add up to at most in nearly every draw, none twice."""
    share = max(len(sizes) - number, 0) / max(len(sizes) - 1, 1)
    return number * float(sizes.mean()) + _NEARLY_EVERY * math.sqrt(number * share) * float(
        sizes.std()
    )


def _check_side_by_side(objects: Sequence[ObjectAsset], config: ProblemConfig, area: float) -> None:
    """Refuses more objects than find room side by side (ConfigError)."""
    placement = config.placement
    mean, _ = share_packed(objects, placement, area)
    if mean <= MOST_PACKED:
        return
    stacked = placement.most_stacked or 0
    number = placement.num_objects
    most = int(USUALLY_PACKED / mean * max(number - stacked, 1)) + stacked
    fewer = f"num_objects={most}, or " if most else ""
    raise ConfigError(
        f"{number} objects side by side, whose outlines cover {mean:.1f} times the region in the mean",
        f"{MOST_PACKED:g} times at most; beyond {USUALLY_PACKED:g}, scenes begin to fail",
        f"{fewer}smaller objects, or a larger region",
    )


def _hull_volume(asset: ObjectAsset) -> float:
    from scipy.spatial import ConvexHull

    return float(ConvexHull(asset.vertices).volume)


def _volume_of(region: Rectangle, depth: float) -> float:
    return 4 * float(np.prod(region.half_extents)) * depth


def _check_volume(
    objects: Sequence[ObjectAsset], num_objects: int, region: Rectangle, depth: float
) -> None:
    """Refuses a pile whose objects' hulls are, in the mean, larger than what holds them."""
    mean = float(np.mean([_hull_volume(asset) for asset in objects]))
    room = _volume_of(region, depth) * MOST_FULL
    if num_objects * mean > room:
        most = int(room / mean)
        fewer = f"num_objects={most}" if most else "smaller objects"
        raise ConfigError(
            f"a pile of {num_objects} objects, which fill "
            f"{1000 * num_objects * mean:.1f} litres in the mean, in {1000 * room / MOST_FULL:.1f} litres",
            f"up to {most} of these objects" if most else "a larger support, or smaller objects",
            f"{fewer}, or a larger support, such as tote or bin-0.60x0.40x0.25",
        )


def split_by_room(
    objects: Sequence[ObjectAsset],
    named: Collection[str],
    support: SupportAsset,
    region: Rectangle,
    config: ProblemConfig,
) -> tuple[list[ObjectAsset], tuple[str, ...]]:
    """The objects that find room, and what is said of those that are left out.

    Of a pile between walls the largest are left out until nearly every draw fills at most `USUALLY_FULL` of
    what holds it, unless too few would be left.

    Args:
      named: those that were asked for by name, which are never left out.
    """
    placement = config.placement
    rim = rim_height(region, support)
    if not (rim > 0 or placement.containment == "footprint"):
        return list(objects), ()
    room = 2 * np.array(region.half_extents)
    is_upright = placement.poses == "upright" and not config.is_piled
    where = f"support {support.name!r}" if rim > 0 else f"a region of {_size_text(room)}"
    kept = [each for each in objects if each.name in named or _fits(each, room, rim, is_upright)]
    notes = []
    if len(kept) < len(objects):
        names = {each.name for each in kept}
        large = [each.name for each in objects if each.name not in names]
        notes.append(f"too large for {where}, and left out: {', '.join(large)}")
    if config.is_piled and rim > 0 and not config.shelf:
        fewer = _without_largest(kept, named, placement.num_objects, _volume_of(region, rim))
        if fewer is None:
            notes.append(
                f"{placement.num_objects} of these objects fill more than {USUALLY_FULL:g} of {where} in "
                "many draws, of which some end outside"
            )
        elif len(fewer) < len(kept):
            names = {each.name for each in fewer}
            large = [each.name for each in kept if each.name not in names]
            notes.append(
                f"{placement.num_objects} objects would fill {where} too much, of which the largest are left "
                f"out: {', '.join(large)}"
            )
            kept = fewer
    return kept, tuple(notes)


def _without_largest(
    objects: Sequence[ObjectAsset], named: Collection[str], num_objects: int, room: float
) -> list[ObjectAsset] | None:
    """The objects without the largest ones, so few that nearly every draw fills the room as it may.

    None where there would be fewer than are drawn.
    """
    volumes = np.array([_hull_volume(asset) for asset in objects])
    order = [index for index in np.argsort(-volumes).tolist() if objects[index].name not in named]
    is_kept = np.ones(len(objects), bool)
    while is_kept.sum() >= num_objects:
        if _nearly_every(volumes[is_kept], num_objects) <= USUALLY_FULL * room:
            return [each for each, keeps in zip(objects, is_kept, strict=True) if keeps]
        if not order:
            break
        is_kept[order.pop(0)] = False
    return None


def check_room(
    objects: Sequence[ObjectAsset],
    support: SupportAsset,
    region: Rectangle,
    placement: PlacementConfig,
    is_piled: bool = False,
) -> None:
    """Refuses objects that cannot lie within a region that walls or the request bound on all sides.

    An object fits if its outline, seen from above, fits into the region for some heading: upright, or, where
    objects come in other poses, in any of its resting poses, or on any side of its box where its middle is
    below the rim then.

    Args:
      is_piled: objects are let fall in any orientation.

    Raises:
      ConfigError: it names the objects with their sizes, and the region's.
    """
    rim = rim_height(region, support)
    if not (rim > 0 or placement.containment == "footprint"):
        return
    room = 2 * np.array(region.half_extents)
    is_upright = placement.poses == "upright" and not is_piled
    large = [each for each in objects if not _fits(each, room, rim, is_upright)]
    if not large:
        return
    sizes = [f"{each.name} ({_size_text(2 * np.asarray(each.half_extents))})" for each in large]
    more = f" and {len(sizes) - _MOST_NAMED} more" if len(sizes) > _MOST_NAMED else ""
    where = f"a region of {_size_text(room)}"
    if rim > 0:
        where = f"support {support.name!r}, {_size_text(np.append(room, rim))} inside its walls"
    how = "as they stand" if is_upright else "whichever way they lie"
    boxes = 2 * np.array([each.half_extents for each in large])
    plans = np.sort(boxes[:, :2] if is_upright else np.sort(boxes, axis=1)[:, 1:], axis=1)[:, ::-1]
    width, depth = np.ceil(100 * plans.max(0) + 1) / 100
    larger = f"region='{width:.2f}x{depth:.2f}'"
    if rim > 0:
        larger = f"support='bin-{width:.2f}x{depth:.2f}x{rim:.2f}'"
    raise ConfigError(
        f"objects that are too large for {where}, {how}: {', '.join(sizes[:_MOST_NAMED])}{more}",
        "smaller ones, or a larger support or region",
        larger,
    )


def _size_text(size: np.ndarray) -> str:
    return " x ".join(f"{side:.2f}" for side in size) + " m"


def _fits(asset: ObjectAsset, room: np.ndarray, rim: float, is_upright: bool) -> bool:
    from scipy.spatial import ConvexHull

    vertices = asset.vertices
    if np.linalg.norm(np.ptp(vertices, axis=0)) <= room.min():
        return True
    angles = np.pi * np.arange(_TURNS) / _TURNS
    along = np.stack([np.cos(angles), np.sin(angles)])
    across = np.stack([-np.sin(angles), np.cos(angles)])
    for turn, is_resting in _orientations(asset, is_upright):
        turned = vertices @ turn.T
        if not is_resting and np.ptp(turned[:, 2]) > 2 * rim:
            continue
        outline = turned[:, :2]
        outline = outline[ConvexHull(outline).vertices]
        sides = np.stack([np.ptp(outline @ along, axis=0), np.ptp(outline @ across, axis=0)])
        if (sides <= room[:, None] + _SLACK).all(0).any():
            return True
    return False


def _orientations(asset: ObjectAsset, is_upright: bool) -> Iterator[tuple[np.ndarray, bool]]:
    """Rotations in which an object may come to lie, f64[3, 3], and whether it rests so by itself."""
    from scipy.spatial.transform import Rotation

    yield np.eye(3), True
    if is_upright:
        return
    for pose in asset.resting:
        yield Rotation.from_quat(np.roll(pose.quaternion, -1)).as_matrix(), True
    for axis in ((np.pi / 2, 0, 0), (0, np.pi / 2, 0)):
        yield Rotation.from_rotvec(axis).as_matrix(), False


def check_surface(
    objects: Sequence[ObjectAsset],
    support: SupportAsset,
    placement: PlacementConfig,
    contact: ContactConfig,
    has_region: bool,
) -> None:
    """Refuses objects that cannot stand on a slope, or under what hangs over a surface (ConfigError).

    Released upright they tip or slide whichever way they are turned; in other poses they may stand.
    """
    if not support.named:
        return
    surfaces = [surface for surface, _ in support.asked]
    if len(surfaces) > 1 and has_region:
        hint = f"surface={surfaces[0].name!r}, or no region"
        raise ConfigError("a region with several surfaces", "the surfaces' own regions", hint)
    steepest = max(surface.tilt for surface in surfaces)
    if placement.crowd_targets is not None and steepest > 0:
        given = f"objects drawn together on a slope of {math.degrees(steepest):.1f} degrees"
        raise ConfigError(f"{given}, where they would slide", "a level surface", "crowd=0")
    if placement.poses != "upright":
        return
    friction = contact.friction[0]
    slope = min(surface.tilt for surface in surfaces)
    fallen = [each.name for each in objects if not _stands_on_slope(each, slope, friction)]
    if fallen:
        raise ConfigError(
            f"objects that tip, roll or slide on a slope of {math.degrees(slope):.1f} degrees, "
            f"however they are turned: {', '.join(fallen)}",
            "other objects",
            "exclude=" + repr(tuple(fallen)),
        )
    free = max(surface.free_height for surface in surfaces)
    tall = [each.name for each in objects if 2 * each.half_extents[2] + ROOM > free]
    if tall:
        raise ConfigError(
            f"objects that are too tall for {', '.join(surface.name for surface in surfaces)} of support "
            f"{support.name!r}, with {free:.3f} m of room: {', '.join(tall)}",
            "lower ones",
            "exclude=" + repr(tuple(tall)),
        )


def _stands_on_slope(asset: ObjectAsset, slope: float, friction: float) -> bool:
    """Whether a plumb line through its centre of mass meets its base for some turn, and it does not slide."""
    if slope == 0:
        return True
    vertices = asset.vertices
    low = vertices[:, 2].min()
    base = vertices[vertices[:, 2] < low + _TOUCHING][:, :2]
    lean = (asset.center_of_mass[2] - low) * math.tan(slope)
    angles = 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    centers = asset.center_of_mass[:2] + lean * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    margin = max(support_margin(base - center) for center in centers)
    own = friction if asset.friction is None else asset.friction
    return margin > _STANDS and math.tan(slope) < own
