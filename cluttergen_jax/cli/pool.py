"""`cluttergen pool`: what there is, what it holds, how its objects stand, and away with what is old."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import tyro

from cluttergen_jax.errors import ClutterGenError, ConfigError

if TYPE_CHECKING:
    from cluttergen_jax.assets import pool as pools
    from cluttergen_jax.assets.object import ObjectAsset

_HEADER = ("object", "size mm", "scale", "mass kg", "friction", "licence", "what people call it")


@dataclass(frozen=True)
class Pool:
    """List pools, show what one holds, remove your own, or change an object's pose: cluttergen pool list.

    Example: `cluttergen pool show dining+study`. `cluttergen pool pose mine mug` lists the poses of a mug,
    `cluttergen pool pose mine mug 1` puts it into the first other one.

    Attributes:
      action: list, show, pose or remove.
      names: of the pools. To show: names or folders, a+b for a union, a~mug for all but mug. For poses: the
        pool, the object, and the number of a pose to take.
    """

    action: tyro.conf.Positional[Literal["list", "show", "pose", "remove"]]
    names: tyro.conf.Positional[tuple[str, ...]] = ()

    def run(self) -> int:
        """Runs the command; the exit status."""
        if bool(self.names) == (self.action == "list"):
            raise ConfigError(
                f"pool {self.action} {' '.join(self.names)}".rstrip(),
                "no name" if self.action == "list" else "one name or more",
                f"cluttergen pool {self.action}{'' if self.action == 'list' else ' NAME'}",
            )
        if self.action == "list":
            _list()
        elif self.action == "pose":
            from cluttergen_jax.cli.pool_poses import pose

            pose(self.names)
        elif self.action == "show":
            from cluttergen_jax.assets.pool import find_pool

            for name in self.names:
                _show(find_pool(name))
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
        flagged = sum(bool(asset.flags) for asset in pool.objects)
        place = "embedded" if name in EMBEDDED else str(folder)
        print(f"{name:16} {len(pool):3} objects, {flagged} flagged, tier {pool.tier}, {place}")
        print(f"{'':16} licence: {pool.licence or 'not stated'}")


def _show(pool: pools.Pool) -> None:
    print(f"pool {pool.name}: {len(pool)} objects, tier {pool.tier}, content {pool.hash[:12]}")
    rows = [_HEADER, *(_row(asset) for asset in pool.objects)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADER))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    for line in (*_flags(pool.objects), *_credits(pool.objects)):
        print(line)


def _row(asset: ObjectAsset) -> tuple[str, ...]:
    from cluttergen_jax.cli.pool_table import size_text

    friction = "-" if asset.friction is None else f"{asset.friction:g}"
    numbers = size_text(asset), f"{asset.scale:g}", f"{asset.mass:.3f}", friction
    return asset.name, *numbers, asset.provenance.licence, asset.label


def _flags(objects: Sequence[ObjectAsset]) -> Iterator[str]:
    return (f"  ! {asset.name}: {flag}" for asset in objects for flag in asset.flags)


def _credits(objects: Sequence[ObjectAsset]) -> list[str]:
    """Each attribution that a licence asks for, once."""
    return [f"  {each}" for each in dict.fromkeys(asset.provenance.attribution for asset in objects) if each]


def _remove(names: Sequence[str]) -> None:
    from cluttergen_jax.assets.pool import remove_pool, user_pool_folder

    # All of them are looked up before the first is removed.
    folders = {name: user_pool_folder(name) for name in names}
    for name, folder in folders.items():
        pool = remove_pool(name)
        held = "damaged" if pool is None else f"{len(pool)} objects: {', '.join(pool.names)}"
        print(f"removed pool {name} ({held}) from {folder}")
