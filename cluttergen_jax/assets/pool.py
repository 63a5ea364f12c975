"""Pools: named sets of objects, in memory and on disk.

A pool folder holds `pool.json` and one folder per object. `find_pool` looks among the embedded pools first,
then among the user's own, then takes its argument for a path.
"""

from __future__ import annotations

import hashlib
import importlib.resources
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import FORMAT, NAME_PATTERN, object_hash, read_object, write_object
from cluttergen_jax.errors import PoolError
from cluttergen_jax.files import folder_whole, inside

EMBEDDED = ("dining", "study", "office", "kitchen", "household")
ALL = "all"
_INDEX = "pool.json"


@dataclass(frozen=True, eq=False)
class Pool:
    """A set of objects with unique names, in a fixed order.

    Attributes:
      name: `[a-z0-9_-]+`.
      objects: at least one.
      tier: "standard" or "light", the same for all objects.
      licence: the terms on which the whole may be passed on.
    """

    name: str
    objects: tuple[ObjectAsset, ...]
    tier: str = "standard"
    licence: str = ""

    def __post_init__(self) -> None:
        if not NAME_PATTERN.fullmatch(self.name):
            raise PoolError(f"a pool called {self.name!r}", "names of a-z, 0-9, '_' and '-'")
        names = [asset.name for asset in self.objects]
        twice = sorted({name for name in names if names.count(name) > 1})
        if not names or twice:
            raise PoolError(
                f"pool {self.name!r} with {len(names)} objects, twice: {twice}",
                "one or more objects of different names",
            )

    @cached_property
    def hash(self) -> str:
        """Hex digest of tier and objects: equal for pools of equal content, whatever their name or place."""
        digests = [self.tier, *(object_hash(asset) for asset in self.objects)]
        return hashlib.sha256("\n".join(digests).encode()).hexdigest()

    @property
    def names(self) -> tuple[str, ...]:
        """The objects' names, in order."""
        return tuple(asset.name for asset in self.objects)

    def __len__(self) -> int:
        return len(self.objects)

    def __iter__(self) -> Iterator[str]:
        """The names, as of a dictionary; the objects themselves are `objects`."""
        return iter(self.names)

    def __getitem__(self, name: str) -> ObjectAsset:
        """The object called `name`; PoolError names the others if there is none."""
        for asset in self.objects:
            if asset.name == name:
                return asset
        raise PoolError(f"no object {name!r} in pool {self.name!r}", ", ".join(self.names))


def write_pool(path: str | Path, pool: Pool, *, overwrite: bool = False) -> Path:
    """Writes a pool folder as a whole: it is built beside its place and then renamed into it.

    Raises:
      PoolError: something is there already and `overwrite` is False, or what is there is not a pool.
    """
    path = Path(path)
    if path.exists() and not (overwrite and (path / _INDEX).is_file()):
        raise PoolError(f"{path} exists", "a new folder" if not overwrite else "a new folder or a pool's")
    with folder_whole(path) as fresh:
        fresh.mkdir()
        for asset in pool.objects:
            write_object(fresh / asset.name, asset)
        (fresh / _INDEX).write_text(json.dumps(_index(pool), indent=1) + "\n", encoding="utf-8")
    return path


def _index(pool: Pool) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "name": pool.name,
        "tier": pool.tier,
        "objects": list(pool.names),
        "licence": pool.licence,
        "created_by": "cluttergen_jax",
    }


def read_pool(path: str | Path) -> Pool:
    """Reads a pool folder.

    Raises:
      PoolError: there is no pool, or one of its files is missing or damaged; the message names the file.
      UnsafePathError: one of its files is a link that leads out of its folder.
    """
    index_path = Path(path) / _INDEX
    try:
        index = json.loads(index_path.read_text(encoding="utf-8"))
    except OSError as error:
        raise PoolError(f"{path} is not a pool: {index_path} cannot be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        raise PoolError(f"{index_path} is not JSON: {error}") from error
    if not isinstance(index, dict) or index.get("format") != FORMAT:
        raise PoolError(f"{index_path} is not a pool of format {FORMAT}")
    try:
        name, names, tier, licence = index["name"], index["objects"], index["tier"], index["licence"]
    except KeyError as error:
        raise PoolError(f"{index_path} lacks {error}") from error
    is_text = all(isinstance(each, str) for each in (name, tier, licence))
    is_named = isinstance(names, list) and all(
        isinstance(each, str) and NAME_PATTERN.fullmatch(each) for each in names
    )
    if not (is_text and is_named):
        raise PoolError(f"{index_path} is damaged: a name, tier, licence or list of objects is none")
    objects = tuple(read_object(inside(path, each)) for each in names)
    for each, asset in zip(names, objects, strict=True):
        if asset.name != each:
            raise PoolError(f"{Path(path) / each} holds an object called {asset.name!r}", "one of that name")
    return Pool(name, objects, tier, licence)


def embedded_root() -> Path:
    """The folder `scenes`: inside the installed package, or beside it in a checkout."""
    package = Path(str(importlib.resources.files("cluttergen_jax")))
    inside = package / "scenes"
    return inside if inside.is_dir() else package.parent / "scenes"


def user_root() -> Path:
    """The folder of the user's own pools: `$CLUTTERGEN_HOME/pools`, else the XDG data home's."""
    if home := os.environ.get("CLUTTERGEN_HOME"):
        return Path(home) / "pools"
    data_home = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(data_home) / "cluttergen_jax" / "pools"


def list_pools() -> dict[str, Path]:
    """Every pool that can be named, with its folder: embedded ones first, then the user's."""
    found: dict[str, Path] = {}
    for root in (embedded_root() / "pools", user_root()):
        folders = sorted(root.iterdir()) if root.is_dir() else []
        for folder in sorted(folders, key=lambda each: _rank(each.name)):
            if not folder.name.startswith(".") and (folder / _INDEX).is_file():
                found.setdefault(folder.name, folder)
    return found


def _rank(name: str) -> int:
    return EMBEDDED.index(name) if name in EMBEDDED else len(EMBEDDED)


def find_pool(name_or_path: str | Path) -> Pool:
    """The pool of that name, or at that path. `all` is the union of the embedded ones.

    Raises:
      PoolError: nothing is called so (the message lists what exists), or its files are damaged.
    """
    pools = list_pools()
    name = str(name_or_path)
    if name == ALL:
        return _union(ALL, [read_pool(pools[each]) for each in EMBEDDED if each in pools])
    if name in pools:
        return read_pool(pools[name])
    if (Path(name_or_path) / _INDEX).exists():
        return read_pool(name_or_path)
    raise PoolError(
        f"no pool is called {name!r}, and there is none at that path",
        ", ".join([*pools, ALL]) or "none exists yet",
        "cluttergen import SOURCE --pool NAME makes one",
    )


def _union(name: str, pools: list[Pool]) -> Pool:
    """All objects of several pools; a name that occurs in more than one is prefixed with its pool's."""
    if not pools:
        raise PoolError(f"pool {name!r} is the union of the embedded pools, and none of them is installed")
    names = [each for pool in pools for each in pool.names]
    objects = tuple(
        replace(asset, name=f"{pool.name}-{asset.name}") if names.count(asset.name) > 1 else asset
        for pool in pools
        for asset in pool.objects
    )
    return Pool(name, objects, pools[0].tier, pools[0].licence)
