"""The table of a pool: what was measured about each object, and its flags."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.tables import aligned_table

_HEADER = (
    *("object", "size mm", "scale", "mass kg", "parts", "vertices"),
    *("deviation", "cavity", "ball", "solo", "steps", "poses"),
)


_MOST_ALIKE = 4
_NAMES_AND_NUMBERS = re.compile(r"'[^']*'|\S+\.\w+|\d[\d,.]*")


def pool_table(objects: Sequence[ObjectAsset]) -> str:
    """One line per object, then flags (!) and notes (-) in words, then the counts of the project's bars.

    Of many notes that differ in names and numbers alone, the first is told, and how many there are.
    """
    lines = [aligned_table(_HEADER, [_row(asset) for asset in objects])]
    lines += [f"  ! {asset.name}: {flag}" for asset in objects for flag in asset.flags]
    lines += _notes(objects)
    return "\n".join([*lines, _summary(objects)])


def _notes(objects: Sequence[ObjectAsset]) -> Iterator[str]:
    kinds: defaultdict[str, list[tuple[str, str]]] = defaultdict(list)
    for asset in objects:
        for note in asset.notes:
            kinds[_NAMES_AND_NUMBERS.sub("#", note)].append((asset.name, note))
    for alike in kinds.values():
        shown = alike if len(alike) <= _MOST_ALIKE else alike[:1]
        yield from (f"  - {name}: {note}" for name, note in shown)
        if len(shown) < len(alike):
            owners = {name for name, _ in alike}
            of = f"{len(owners)} objects" if len(owners) > 1 else alike[0][0]
            yield f"    ... and {len(alike) - 1} more notes like it, of {of} (`ObjectAsset.notes` has all)"


def _row(asset: ObjectAsset) -> tuple[str, ...]:
    quality = asset.quality
    ball = {None: "-", True: "held", False: "lost"}[quality.holds_ball]
    return (
        asset.name,
        size_text(asset),
        f"{asset.scale:g}",
        f"{asset.mass:.3f}",
        str(len(asset.parts)),
        str(sum(len(part.vertices) for part in asset.parts)),
        _percent(quality.deviation),
        _percent(quality.cavity_fill),
        ball,
        _percent(quality.solo_rate),
        "-" if quality.solo_steps is None else f"{quality.solo_steps:.1f}",
        str(len(asset.resting)),
    )


def size_text(asset: ObjectAsset) -> str:
    """Its three sides in millimetres, in its resting pose."""
    return " x ".join(f"{2000 * half:.0f}" for half in asset.half_extents)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _summary(objects: Sequence[ObjectAsset]) -> str:
    qualities = [asset.quality for asset in objects]
    hollow = [quality for quality in qualities if quality.cavity_fill is not None]
    is_open = [quality.cavity_fill <= 0.2 and bool(quality.holds_ball) for quality in hollow]  # type: ignore[operator]
    solo = sum(quality.solo_rate is not None and quality.solo_rate >= 0.99 for quality in qualities)
    near = sum(quality.deviation is not None and quality.deviation <= 0.05 for quality in qualities)
    return (
        f"{len(objects)} objects, tier {objects[0].tier}: {solo} stand alone in 99 % of trials or more, "
        f"{near} deviate by 5 % or less, {sum(is_open)} of {len(hollow)} hollow ones are open, "
        f"{sum(bool(asset.flags) for asset in objects)} flagged"
    )
