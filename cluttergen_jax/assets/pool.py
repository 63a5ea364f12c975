"""Pools: named sets of objects, in memory and on disk.

A pool folder holds `pool.json` and one folder per object. `find_pool` looks among the embedded pools first,
then among the user's own, then takes its argument for a path. `a+b` is the union of two, and `a+b~mug~pan`
the same without two of its objects. Such a text names a composition wherever a pool can be named, and so in a
bank's recipe and a checkpoint's record too.
"""

from __future__ import annotations

import errno
import hashlib
import importlib.resources
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, overload

import msgspec

from cluttergen_jax.assets.facts import FACTS_FORMAT, ObjectFacts, chosen_names, is_plain_name
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import (
    FORMAT,
    NAME_PATTERN,
    object_hash,
    read_object,
    write_object,
)
from cluttergen_jax.display import display
from cluttergen_jax.errors import ClutterGenError, PoolError, closest, first_names
from cluttergen_jax.files import folder_whole, inside, read_regular, scratch_folder, writing
from cluttergen_jax.kept_folder import PATIENCE, hold, lock_beside
from cluttergen_jax.schema import SchemaError, checked_record, convert, record_bytes

if TYPE_CHECKING:
    from PIL import Image

EMBEDDED = ("dining", "study", "office", "kitchen", "household")
ALL = "all"
_INDEX = "pool.json"
_AND = "+"
_WITHOUT = "~"
MOST_READ = 200
"""Of a larger pool each object is read when it is asked for."""
_KEPT = 256
_MOST_NAMED = 60
_MOST_IN_REPR = 10


class StoredObjects(Sequence[ObjectAsset]):
    """Objects of which each is read when it is asked for; the latest few hundred are kept.

    Args:
      readers: by the objects' names, in order.
      known: what is told of some of them, by name.
    """

    def __init__(
        self,
        readers: Mapping[str, Callable[[], ObjectAsset]],
        known: Mapping[str, ObjectFacts] | None = None,
    ) -> None:
        self.readers = dict(readers)
        self.known = dict(known or {})
        self.names = tuple(self.readers)
        self._read = lru_cache(_KEPT)(lambda name: self.readers[name]())

    def __len__(self) -> int:
        return len(self.names)

    @overload
    def __getitem__(self, index: int) -> ObjectAsset: ...
    @overload
    def __getitem__(self, index: slice) -> StoredObjects: ...
    def __getitem__(self, index: int | slice) -> ObjectAsset | StoredObjects:
        if isinstance(index, slice):
            return self.select(self.names[index])
        return self._read(self.names[index])

    def select(self, names: Iterable[str]) -> StoredObjects:
        """Those of these names, in this order."""
        return StoredObjects({name: self.readers[name] for name in names}, self.known)

    def facts_of(self, name: str) -> ObjectFacts:
        """What is told of an object, which is read where nothing tells it."""
        return self.known[name] if name in self.known else ObjectFacts.of(self._read(name))


def _read_called(folder: Path, name: str) -> ObjectAsset:
    """The object in a folder that is named after it, under another name."""
    asset = read_object(folder)
    if asset.name != folder.name:
        raise PoolError(f"{folder} holds an object called {asset.name!r}", "one of that name")
    return asset if name == asset.name else replace(asset, name=name)


@dataclass(frozen=True, eq=False)
class Pool:
    """A set of objects with unique names, in a fixed order. In a notebook it is shown as pictures.

    Attributes:
      name: `[a-z0-9_-]+`.
      objects: at least one; those of a pool of more than `MOST_READ` are read as they are asked for.
      tier: "standard" or "light", the same for all objects.
      licence: the terms on which the whole may be passed on.
    """

    name: str
    objects: Sequence[ObjectAsset]
    tier: str = "standard"
    licence: str = ""

    def __post_init__(self) -> None:
        if not NAME_PATTERN.fullmatch(self.name):
            raise PoolError(f"a pool called {self.name!r}", "names of a-z, 0-9, '_' and '-'")
        names = self.names
        twice = sorted(name for name, number in Counter(names).items() if number > 1)
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

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The objects' names, in order."""
        if isinstance(self.objects, StoredObjects):
            return self.objects.names
        return tuple(asset.name for asset in self.objects)

    @cached_property
    def facts(self) -> tuple[ObjectFacts, ...]:
        """What is told of each object, in order."""
        if isinstance(self.objects, StoredObjects):
            return tuple(map(self.objects.facts_of, self.objects.names))
        return tuple(map(ObjectFacts.of, self.objects))

    def select(self, names: Iterable[str]) -> Pool:
        """The pool with the objects of these names alone, in this order (PoolError: there is none of one)."""
        names = tuple(names)
        if (
            isinstance(self.objects, StoredObjects)
            and len(names) > MOST_READ
            and set(names) <= set(self.names)
        ):
            return replace(self, objects=self.objects.select(names))
        return replace(self, objects=tuple(self[name] for name in names))

    def __repr__(self) -> str:
        return f"Pool({self.name!r}, {len(self)} objects: {first_names(self.names, _MOST_IN_REPR)})"

    def __len__(self) -> int:
        return len(self.objects)

    def __iter__(self) -> Iterator[str]:
        """The names, as of a dictionary; the objects themselves are `objects`."""
        return iter(self.names)

    def __getitem__(self, name: str) -> ObjectAsset:
        """The object called `name`; PoolError names the others if there is none."""
        if name not in self._places:
            raise PoolError(
                f"no object {name!r} in pool {self.name!r}",
                first_names(self.names, _MOST_NAMED),
                meant=closest(name, self.names),
            )
        return self.objects[self._places[name]]

    def sheet(self, **options: Any) -> Image.Image:
        """Draws objects on one contact sheet, their surfaces beside their collision parts.

        Args:
          options: `objects`, names of those that are drawn, all if not given, of up to 200; `columns`, 4;
            and `samples`, pictures averaged for each.

        Raises:
          PoolError: there is no such object.
          ConfigError: another option, or a number out of range.
          RendererError: nothing can be drawn on this machine.
        """
        return display().pool_sheet_of(self, options)

    def _repr_html_(self) -> str:
        return display().pool_html_of(self)

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.names)}


def write_pool(path: str | Path, pool: Pool, *, overwrite: bool = False) -> Path:
    """Writes a pool folder as a whole: it is built beside its place and then renamed into it.

    Raises:
      PoolError: something is there already and `overwrite` is False, or what is there is not a pool.
    """
    path = Path(path)
    with hold_pool(path):
        _write_folder(path, pool, overwrite)
    return path


def hold_pool(path: Path) -> AbstractContextManager[None]:
    """Holds a pool's folder, which need not exist, in the block: from reading a pool to writing it again.

    Changes of pools are short: another process is waited for.

    Raises:
      BankError: another process writes it for more than a minute, or it cannot be written.
    """
    with writing(path):
        try:
            return hold(lock_beside(path, PATIENCE))
        except OSError as error:
            # Where nothing can be written, a pool that stays as it is can still be read.
            if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
                return nullcontext()
            raise


def _write_folder(path: Path, pool: Pool, overwrite: bool) -> None:
    if path.exists() and not (overwrite and (path / _INDEX).is_file()):
        raise PoolError(
            f"{path} exists", "a new folder" if not overwrite else "a new folder or a pool's"
        )
    with folder_whole(path) as fresh:
        fresh.mkdir()
        for asset in pool.objects:
            write_object(fresh / asset.name, asset)
        (fresh / _INDEX).write_bytes(record_bytes(_index(pool)))


def _index(pool: Pool) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "name": pool.name,
        "tier": pool.tier,
        "objects": list(pool.names),
        "facts_format": FACTS_FORMAT,
        "facts": [msgspec.to_builtins(each) for each in pool.facts],
        "licence": pool.licence,
        "created_by": "cluttergen_jax",
    }


def read_pool(path: str | Path, names: Sequence[str] = ()) -> Pool:
    """Reads a pool folder; of its objects those in `names` alone, if all of these are in it.

    Raises:
      PoolError: there is no pool, or one of its files is missing or damaged; the message names the file.
      UnsafePathError: one of its files is a link that leads out of its folder.
    """
    index_path = inside(path, _INDEX)
    try:
        record = checked_record(read_regular(index_path))
        if record.get("format") != FORMAT:
            raise SchemaError(f"not a pool of format {FORMAT}")
        index = convert(record, _Index)
    except OSError as error:
        raise PoolError(
            f"{path} is not a pool: {index_path} cannot be read ({error.strerror})"
        ) from error
    except SchemaError as error:
        raise PoolError(f"{index_path} is damaged: {error}", hint=_AGAIN) from error
    wanted = index.objects
    if names and set(names) <= set(wanted):
        chosen = set(names)
        wanted = [each for each in wanted if each in chosen]
    readers = {each: partial(_read_called, inside(path, each), each) for each in wanted}
    if len(readers) < len(wanted):
        raise PoolError(f"{index_path} names an object twice", hint=_AGAIN)
    facts = index.facts if index.facts_format == FACTS_FORMAT else []
    objects = StoredObjects(readers, {each.name: each for each in facts})
    return Pool(index.name, _all_if_few(objects), index.tier, index.licence)


_AGAIN = "importing or building the pool again"


class _Index(msgspec.Struct):
    """What `pool.json` holds."""

    name: str
    objects: list[Annotated[str, msgspec.Meta(pattern=f"^{NAME_PATTERN.pattern}$")]]
    tier: str
    licence: str
    facts: list[ObjectFacts] = []
    facts_format: int = 1


def embedded_root() -> Path:
    """The embedded pools and supports: `data` in the installed package, `scenes` beside it in a checkout."""
    package = Path(str(importlib.resources.files("cluttergen_jax")))
    inside = package / "data"
    return inside if inside.is_dir() else package.parent / "scenes"


def user_root() -> Path:
    """The folder of the user's own pools: `$CLUTTERGEN_HOME/pools`, else the XDG data home's."""
    if home := os.environ.get("CLUTTERGEN_HOME"):
        return Path(home) / "pools"
    data_home = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(data_home) / "cluttergen_jax" / "pools"


def list_pools() -> dict[str, Path]:
    """Every pool that can be named, with its folder: embedded ones first, then the user's."""
    found = _pools_in(embedded_root() / "pools")
    return found | {
        name: path for name, path in _pools_in(user_root()).items() if name not in found
    }


def _pools_in(root: Path) -> dict[str, Path]:
    """The embedded ones in their own order, then by name."""
    found = folders_with(_INDEX, root)
    return {name: found[name] for name in EMBEDDED if name in found} | found


def folders_with(record: str, root: Path) -> dict[str, Path]:
    """The folders in `root` that hold a file called `record`, by name, in order; hidden ones do not count."""
    folders = sorted(root.iterdir()) if root.is_dir() else []
    return {
        folder.name: folder
        for folder in folders
        if not folder.name.startswith(".") and (folder / record).is_file()
    }


def find_pool(
    name_or_path: str | Path, exclude: Sequence[str] = (), names: Sequence[str] = ()
) -> Pool:
    """The pool of that name, or at that path. `all` is the union of the embedded ones.

    Args:
      name_or_path: one pool, or several joined by `+`: their union, in which a name that occurs in more than
        one of them is prefixed with its pool's. Objects named after it, each after a `~`, are left out.
      exclude: more objects to leave out: names, patterns and conditions (`assets.facts`).
      names: objects that are wanted: of a single pool that has them the others are not read.

    Raises:
      PoolError: nothing is called so (the message lists what exists), or its files are damaged; the pools
        have one name or different tiers; or there is no such object to leave out.
    """
    text = join_pool_names(name_or_path, exclude)
    if names and len(folders := _folders(text)) == 1:
        return read_pool(folders[0], names)
    union, *without = [text] if _folders(text) else text.split(_WITHOUT)
    terms = [union] if _folders(union) else union.split(_AND)
    pools = [_read(term) for term in terms]
    pool = pools[0] if len(pools) == 1 else _union("-".join(each.name for each in pools), pools)
    patterns = [each for each in without if not is_plain_name(each)]
    if patterns:
        plain = [each for each in without if is_plain_name(each)]
        without = [*plain, *chosen_names(pool.facts, patterns, union)]
    for name in without:
        pool[name]  # Raises where there is none.
    if not set(pool.names) - set(without):
        raise PoolError(f"pool {text!r} has no object left", "leaving fewer of them out")
    return pool.select(each for each in pool.names if each not in without) if without else pool


def join_pool_names(name_or_path: str | Path, exclude: Sequence[str] = ()) -> str:
    """The text that names a pool without some of its objects."""
    return _WITHOUT.join([str(name_or_path), *exclude])


def without_exclusions(text: str) -> str:
    """The text that names the same pool with all of its objects."""
    return text if _folders(text) else text.partition(_WITHOUT)[0]


def public_name(text: str | Path) -> str:
    """The text that names a pool, but without folders: where a user keeps files stays private."""
    union, mark, without = str(text).partition(_WITHOUT)
    return _AND.join(Path(each).name for each in union.split(_AND)) + mark + without


def remove_pool(name: str) -> Pool | None:
    """Removes one of the user's own pools; what it held, None if its files were damaged.

    Raises:
      PoolError: it is embedded, or there is none of that name.
    """
    with hold_pool(user_pool_folder(name)):
        # What is removed is what the pool holds then; another process may have removed it meanwhile.
        folder = user_pool_folder(name)
        try:
            pool = read_pool(folder)
        except ClutterGenError:
            pool = None
        # Out of sight first: a removal that is stopped halfway leaves no pool of which half is missing.
        with scratch_folder(folder) as aside:
            os.rename(folder, aside / folder.name)
    return pool


def user_pool_folder(name: str) -> Path:
    """The folder of the user's own pool of that name.

    Raises:
      PoolError: there is none; the message lists the user's pools.
    """
    own = _pools_in(user_root())
    if name in (*EMBEDDED, ALL) or name not in own:
        kind = "embedded" if name in (*EMBEDDED, ALL) else "not among your own"
        raise PoolError(
            f"pool {name!r} is {kind}", f"pools of your own: {', '.join(own) or 'none yet'}"
        )
    return own[name]


def _folders(text: str) -> list[Path]:
    """The folders of the pool that a text names as a whole; none if it names no single one."""
    pools = list_pools()
    if text == ALL:
        return [pools[each] for each in EMBEDDED if each in pools]
    if text in pools:
        return [pools[text]]
    return [Path(text)] if text and (Path(text) / _INDEX).exists() else []


def _read(text: str) -> Pool:
    folders = _folders(text)
    if text == ALL:
        return _union(ALL, [read_pool(each) for each in folders])
    if folders:
        return read_pool(folders[0])
    raise PoolError(
        f"no pool is called {text!r}, and there is none at that path",
        f"{', '.join([*list_pools(), ALL])}; several joined by {_AND!r}",
        "cluttergen import SOURCE --pool NAME makes one",
        closest(text, [*list_pools(), ALL]),
    )


def _union(name: str, pools: list[Pool]) -> Pool:
    """All objects of several pools; a name that occurs in more than one is prefixed with its pool's."""
    if not pools:
        raise PoolError(
            f"pool {name!r} is the union of the embedded pools, and none of them is installed"
        )
    if len({pool.name for pool in pools}) < len(pools) or len({pool.tier for pool in pools}) > 1:
        listed = ", ".join(f"{pool.name} (tier {pool.tier})" for pool in pools)
        raise PoolError(f"the union of pools {listed}", "pools of different names and of one tier")
    number = Counter(each for pool in pools for each in pool.names)
    called = [
        (f"{pool.name}-{name}" if number[name] > 1 else name, pool, name)
        for pool in pools
        for name in pool.names
    ]
    licences = dict.fromkeys(pool.licence or "not stated" for pool in pools)
    readers = {own: partial(_rename_object, pool, name, own) for own, pool, name in called}
    objects = _all_if_few(StoredObjects(readers))
    return Pool(name, objects, pools[0].tier, "; ".join(licences))


def _all_if_few(objects: StoredObjects) -> Sequence[ObjectAsset]:
    return objects if len(objects) > MOST_READ else tuple(objects)


def _rename_object(pool: Pool, name: str, own: str) -> ObjectAsset:
    asset = pool[name]
    return asset if name == own else replace(asset, name=own)
