"""`cluttergen pool`: what there is, what it holds, how its objects stand, and away with what is old."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import tyro

from cluttergen_jax.errors import ClutterGenError, ConfigError, range_text

if TYPE_CHECKING:
    from cluttergen_jax.assets import pool as pools
    from cluttergen_jax.assets.object import ObjectAsset
    from cluttergen_jax.importing.poses import Pose

_HEADER = ("object", "size mm", "scale", "mass kg", "friction", "licence", "what people call it")
_PAGE = 100
_POSES = ("pose", "mm tall", "degrees from now", "tips over at", "of random falls")


@dataclass(frozen=True)
class Pool:
    """List pools, show what one holds, remove your own, or change an object's pose: cluttergen pool list.

    Example: `cluttergen pool show dining+study`. `cluttergen pool pose mine mug` lists the poses of a mug,
    `cluttergen pool pose mine mug 1` puts it into the first other one.

    Attributes:
      action: list, show, pose or remove.
      names: of the pools. To show: names or folders, a+b for a union, a~mug for all but mug. For poses: the
        pool, the object, and the number of a pose to take.
      objects: to show: only these, by names, patterns and conditions: "mug*", "label=*book* and mass<0.5".
      page: to show: which hundred objects of each.
    """

    action: tyro.conf.Positional[Literal["list", "show", "pose", "remove"]]
    names: tyro.conf.Positional[tuple[str, ...]] = ()
    objects: tuple[str, ...] = ()
    page: int = 1

    def run(self) -> int:
        if bool(self.names) == (self.action == "list"):
            raise ConfigError(
                f"pool {self.action} {' '.join(self.names)}".rstrip(),
                "no name" if self.action == "list" else "one name or more",
                f"cluttergen pool {self.action}{'' if self.action == 'list' else ' NAME'}",
            )
        if self.action == "list":
            _list()
        elif self.action == "pose":
            _pose(self.names)
        elif self.action == "show":
            from cluttergen_jax.assets.facts import chosen_names
            from cluttergen_jax.assets.pool import find_pool

            for name in self.names:
                pool = find_pool(name)
                chosen = (
                    chosen_names(pool.facts, self.objects, name) if self.objects else pool.names
                )
                _show(pool, chosen, self.page)
        else:
            _remove(self.names)
        return 0


def _list() -> None:
    from cluttergen_jax.assets.pool import EMBEDDED, list_pools, read_pool

    for name, folder in list_pools().items():
        try:
            pool = read_pool(folder)
        except ClutterGenError as error:
            print(f"{name:16} damaged: {error}")
            continue
        flagged = sum(each.flagged for each in pool.facts)
        place = "embedded" if name in EMBEDDED else str(folder)
        print(f"{name:16} {len(pool):3} objects, {flagged} flagged, tier {pool.tier}, {place}")
        print(f"{'':16} licence: {pool.licence or 'not stated'}")


def _show(pool: pools.Pool, chosen: Sequence[str], page: int) -> None:
    from cluttergen_jax.assets.pool import MOST_READ

    pages = -(-len(chosen) // _PAGE)
    if not 1 <= page <= pages:
        raise ConfigError(f"page = {page}", range_text(1, pages), "page=1")
    objects = [pool[name] for name in chosen[(page - 1) * _PAGE : page * _PAGE]]
    # Of very many objects the digest of all would have to be made by reading all.
    content = f", content {pool.hash[:12]}" if len(pool) <= MOST_READ else ""
    print(f"pool {pool.name}: {len(pool)} objects, tier {pool.tier}{content}")
    if len(chosen) < len(pool):
        print(f"{len(chosen)} of them are chosen")
    rows = [_HEADER, *(_row(asset) for asset in objects)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADER))]
    for row in rows:
        print(
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        )
    for line in (*_flags(objects), *_credits(objects)):
        print(line)
    if pages > 1:
        print(f"page {page} of {pages}; another: --page N; some: --objects 'mug* and mass<0.5'")


def _row(asset: ObjectAsset) -> tuple[str, ...]:
    from cluttergen_jax.cli.pool_table import size_text

    friction = "-" if asset.friction is None else f"{asset.friction:g}"
    numbers = size_text(asset), f"{asset.scale:g}", f"{asset.mass:.3f}", friction
    return asset.name, *numbers, asset.provenance.licence, asset.label


def _flags(objects: Sequence[ObjectAsset]) -> Iterator[str]:
    return (f"  ! {asset.name}: {flag}" for asset in objects for flag in asset.flags)


def _credits(objects: Sequence[ObjectAsset]) -> list[str]:
    """Each attribution that a licence asks for, once."""
    return [
        f"  {each}"
        for each in dict.fromkeys(asset.provenance.attribution for asset in objects)
        if each
    ]


def _remove(names: Sequence[str]) -> None:
    from cluttergen_jax.assets.pool import remove_pool, user_pool_folder

    # All of them are looked up before the first is removed.
    folders = {name: user_pool_folder(name) for name in names}
    for name, folder in folders.items():
        pool = remove_pool(name)
        held = "damaged" if pool is None else f"{len(pool)} objects: {', '.join(pool.names)}"
        print(f"removed pool {name} ({held}) from {folder}")


def _pose(words: Sequence[str]) -> None:
    """Lists an object's poses; with a number behind pool and object, after it was put into that one."""
    from cluttergen_jax.importing.poses import pool_poses, set_pose
    from cluttergen_jax.tables import aligned_table

    if len(words) not in (2, 3) or not all(word.isdecimal() for word in words[2:]):
        raise ConfigError(
            f"pool pose {' '.join(words)}",
            "a pool, one of its objects, and the number of a pose (0 or more) to change it",
            "cluttergen pool pose POOL OBJECT",
        )
    pool, name, *number = words
    if number:
        asset = set_pose(pool, name, int(number[0]))
        tall = 2000 * asset.half_extents[2]
        rate = 100 * (asset.quality.solo_rate or 0.0)
        print(f"{name} now stands so: {tall:.0f} mm tall, stable in {rate:.1f} % of trials")
        print("\n".join(f"  ! {flag}" for flag in asset.flags), end="\n" if asset.flags else "")
    print(
        aligned_table(_POSES, [_pose_row(k, each) for k, each in enumerate(pool_poses(pool, name))])
    )


def _pose_row(number: int, each: Pose) -> tuple[str, ...]:
    turn = math.degrees(math.acos(max(-1.0, min(1.0, each.up[2])))) if number else 0.0
    return (
        str(number) if number else "0 (now)",
        f"{1000 * each.height:.0f}",
        f"{turn:.0f}",
        f"{each.tip:.0f}",
        f"{100 * each.likelihood:.0f} %",
    )
