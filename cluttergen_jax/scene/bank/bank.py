"""A bank on disk: `bank.json`, `scenes-*.parquet`, `assets/`, and a file per scene if wanted.

    bank.json               how it was made; what makes another run the same bank; digests of its files
    scenes-000000.parquet   block 0: scenes 0 to 255, a row each, failures included; and bank.json once more
    scenes-000000-000767.parquet    the same of blocks 0 to 767: a shard, in banks of more than 768 blocks
    assets/objects/NAME/    each object once; assets/support/ the table, support_open/ with open doors
    assets/textures/        the objects' images, each once
    bank_reader.py          reads the bank where this package is not
    croissant.json          its columns, for programs that read Croissant; README.md, the card
    scenes/000000.xml .png  successful scenes as MJCF, meshes by relative path, and their pictures

A block is written as a whole or not at all, so an interrupted bank is continued where it stopped
(`scene.bank.writer`). Whatever is damaged is named when it is read, with what mends it.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.assets.doors import with_joints_at
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import object_hash, read_object
from cluttergen_jax.assets.pool import public_name
from cluttergen_jax.assets.support import Rectangle, SupportAsset, recorded_rectangle
from cluttergen_jax.assets.support_file import read_support, support_hash
from cluttergen_jax.bank_reader import RowDigests
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.display import display
from cluttergen_jax.errors import BankError, ClutterGenError, PoolError, range_text
from cluttergen_jax.files import check_utf8, inside, read_regular
from cluttergen_jax.placement.relations import SIDES, parse_relations
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.blocks import StoredBlocks, record_in
from cluttergen_jax.scene.bank.record import (
    AGAIN,
    INDEX,
    NO_ASSETS,
    AssetDigests,
    Recipe,
    Record,
    check_format,
    config_of,
    fault_of,
    parse_record,
    record_error,
)
from cluttergen_jax.scene.bank.remote import bank_folder
from cluttergen_jax.scene.bank.table import BankRow, rows_of, schema_of
from cluttergen_jax.scene.scene import Origin, Scene
from cluttergen_jax.spec import SceneSpec

if TYPE_CHECKING:
    from PIL import Image


@dataclass(frozen=True, eq=False)
class Bank:
    """A bank that is read: a sequence of its scenes, failures included. `record` is what `bank.json` holds.

        bank = cg.read_bank("out")
        bank[3].picture()                                      # scene 3, as `BANK:3` names it elsewhere
        stable = [scene for scene in bank if scene.origin.is_success]

    In a notebook it is shown as a summary with pictures.
    """

    path: Path
    record: Record

    def __len__(self) -> int:
        """How many scenes it was asked for; an interrupted bank does not have all of them yet."""
        return self.num_scenes

    @overload
    def __getitem__(self, number: int) -> Scene: ...
    @overload
    def __getitem__(self, number: slice) -> list[Scene]: ...
    def __getitem__(self, number: int | slice) -> Scene | list[Scene]:
        """Scene `number`, -1 for the last, be it a success (`Scene.origin`) or not; several by a slice.

        Raises:
          BankError: there is no such scene, or not yet, or one of its files is damaged.
          TypeError: the number is none.
        """
        if isinstance(number, slice):
            return list(self._read(range(len(self))[number]))
        place = operator.index(number)
        if not -len(self) <= place < len(self):
            raise BankError(
                f"{self.path} has no scene {place}",
                f"{range_text(0, len(self) - 1)}, or -1 for the last",
            )
        (scene,) = self._read([place % len(self)])
        return scene

    def __iter__(self) -> Iterator[Scene]:
        """Each scene, by number. `read_scenes(bank)` has those that succeeded alone."""
        return self._read(range(len(self)))

    def _read(self, numbers: Sequence[int]) -> Iterator[Scene]:
        asset_of = lru_cache(maxsize=None)(self.object)
        stored = self.blocks()
        for first in range(0, len(numbers), BLOCK_SIZE):
            part = numbers[first : first + BLOCK_SIZE]
            rows = self._rows_in(stored, part)
            for number in part:
                if number not in rows:
                    raise BankError(
                        f"{self.path}: scene {number} is not there yet, as the bank is not finished",
                        hint="the `generate` call that made it, which continues it",
                    )
                yield self.scene_of(rows[number], asset_of)

    def sheet(self, **options: Any) -> Image.Image:
        """Draws scenes on one contact sheet, as `cluttergen_jax.render` does: the first 12 that succeeded.

            bank.sheet(scenes="0-7", columns=4, quality="draft").save("sheet.png")

        Args:
          options: what `render` takes of a sheet: scenes, columns, size of a picture, view, whole, hulls,
            doors, quality, samples and others.

        Raises:
          BankError: none of its scenes succeeded, or there is no such scene.
          ConfigError: a setting is out of range, or `render` takes it for something else than a sheet.
          RendererError: nothing can be drawn on this machine.
        """
        return display().sheet_of(self, options)

    def show(self, **options: Any) -> Any:
        """Shows its scenes in the viewer; see `Scene.show`."""
        return display().show(self, options)

    def _repr_html_(self) -> str:
        return display().html_of(self)

    def __repr__(self) -> str:
        names = ("pool", "method", "seed")
        words = ", ".join(
            f"{name} {value!r}" for name, value in self.recipe.items() if name in names
        )
        return f"{type(self).__name__}({str(self.path)!r}, {self.num_scenes} scenes, {words})"

    @property
    def num_scenes(self) -> int:
        """How many scenes the bank was asked for."""
        return int(self.record["num_scenes"])

    @property
    def recipe(self) -> Recipe:
        """How its scenes were made."""
        return self.record.get("recipe", {})

    @property
    def spec(self) -> SceneSpec:
        """What its scenes were asked for: `generate(other, bank.spec)` makes more of the kind.

        Raises:
          BankError: the bank does not say it whole.
        """
        try:
            return SceneSpec.from_recipe(self.recipe)
        except (KeyError, TypeError, ValueError) as error:
            raise BankError(
                f"{self.path}: how it was made is not recorded whole ({error})"
            ) from error

    @property
    def seat(self) -> str:
        """At which side of the region someone sits; "" where its scenes were not asked to be natural."""
        rules = self.recipe.get("placement") or {}
        return str(rules.get("seat", "-y")) if rules.get("natural") else ""

    @cached_property
    def region(self) -> Rectangle | None:
        """In which its objects were asked to be; None in banks that do not say it.

        Raises:
          BankError: its record is damaged.
        """
        with self._sound_record():
            region = self.recipe.get("region")
            return recorded_rectangle(region) if region else None

    @cached_property
    def has_sides(self) -> bool:
        """Whether relations asked for left, right, front or back; raises as `region`."""
        with self._sound_record():
            relations = (self.recipe.get("placement") or {}).get("relations", ())
            return any(each.kind in SIDES for each in parse_relations(relations))

    @contextmanager
    def _sound_record(self) -> Iterator[None]:
        try:
            yield
        except (AttributeError, ClutterGenError, KeyError, TypeError, ValueError) as error:
            raise record_error(self.path, error) from error

    @cached_property
    def stability(self) -> StabilityConfig:
        """By which its scenes were checked (BankError: its recipe is damaged)."""
        return config_of(StabilityConfig, self.recipe.get("stability", {}), self.path)

    @cached_property
    def contact(self) -> ContactConfig:
        """Friction, softness and solver with which its scenes were made; raises likewise."""
        return config_of(ContactConfig, self.recipe.get("contact", {}), self.path)

    @cached_property
    def table(self) -> pa.Table:
        """All rows that are there, in order, in memory.

        Raises:
          BankError: there are none, or a block is damaged; the message names its file.
        """
        rows = list(self.tables())
        names = schema_of(rows[0]).names
        return pa.concat_tables([each.select(names).replace_schema_metadata(None) for each in rows])

    def tables(
        self, columns: Sequence[str] | None = None, indices: np.ndarray | None = None
    ) -> Iterator[pa.Table]:
        """All rows that are there, in order, some thousand at a time, so that memory does not grow with them.

        Args:
          columns: those that are wanted, all if not given; every value in them is looked at.
          indices: i[S], scenes that are wanted; blocks that hold none of them are not read.

        Raises:
          BankError: see `table`.
        """
        stored = self.blocks()
        if not stored.places:
            raise BankError(f"{self.path} holds no scenes yet", hint=AGAIN)
        blocks = None if indices is None else np.unique(indices // BLOCK_SIZE).tolist()
        return map(self._check_objects, stored.tables(columns, blocks))

    def blocks(self) -> StoredBlocks:
        """Its blocks as they lie on disk now, each file held against its digest when it is first read."""
        return StoredBlocks(self.path, self._digests)

    @cached_property
    def _digests(self) -> RowDigests:
        return RowDigests(self.files or {}, partial(_files_now, self.path))

    def _check_objects(self, rows: pa.Table) -> pa.Table:
        """The rows, if `bank.json` names every object that they number (BankError)."""
        names = self.recipe.get("names")
        if isinstance(names, list) and "object_index" in rows.schema.names:
            numbers = pc.unique(pc.list_flatten(rows["object_index"])).to_pylist()
            if strange := [number for number in numbers if not 0 <= number < len(names)]:
                raise BankError(
                    f"{self.path} is damaged: a scene has object number {strange[0]} of {len(names)}",
                    hint=AGAIN,
                )
        return rows

    @property
    def files(self) -> dict[str, str] | None:
        """Digests of assets and scene files by path within the bank (`bank.index`); None in older banks."""
        return self.record.get("files")

    def scenes(self) -> Iterator[BankRow]:
        """Every scene, failures included, read as they are asked for."""
        for table in self.tables():
            yield from rows_of(table)

    def rows(self, indices: Iterable[int]) -> dict[int, BankRow]:
        """Those of these scenes that are there, by number; what lies between them is not read.

        Raises:
          BankError: a block is damaged.
        """
        return self._rows_in(self.blocks(), indices)

    def _rows_in(self, stored: StoredBlocks, indices: Iterable[int]) -> dict[int, BankRow]:
        """As `rows`; a file of `stored` that is asked several times running is opened once."""
        found = {}
        for block, wanted in groupby(sorted(set(indices)), lambda index: index // BLOCK_SIZE):
            if block in stored.places:
                table = self._check_objects(stored.read_block(block))
                places = [index % BLOCK_SIZE for index in wanted]
                held = [place for place in places if place < table.num_rows]
                kept = table.take(pa.array(held, pa.int64()))
                found.update({row.index: row for row in rows_of(kept)})
        return found

    def scene_of(self, row: BankRow, asset_of: Callable[[str], ObjectAsset] | None = None) -> Scene:
        """A row as a scene.

        Args:
          asset_of: reads an object by name; `object` if None.

        Raises:
          BankError: an asset or the record is damaged.
        """
        recipe = self.recipe
        checkpoint = recipe.get("checkpoint")
        asset_of = asset_of or self.object
        return Scene(
            names=row.objects,
            objects=tuple(asset_of(base_name(name)) for name in row.objects),
            poses=row.poses,
            support=self.support_of(row),
            stability=self.stability,
            contact=self.contact,
            origin=Origin(
                bank=self.path.resolve().name,
                index=row.index,
                pool=public_name(recipe.get("pool", "")),
                method=recipe.get("method", ""),
                # The name alone: a path would tell where its owner keeps files.
                checkpoint=None if checkpoint is None else Path(checkpoint).name,
                seed=recipe.get("seed"),
                verdict=row.verdict,
                drift=row.drift,
                is_success=bool(row.is_success),
                versions=recipe.get("versions", {}),
            ),
            region=self.region,
            seat=self.seat,
            has_sides=self.has_sides,
        )

    @cached_property
    def object_names(self) -> tuple[str, ...]:
        """The objects that its scenes were made of: where blocks drew them, all that scenes have."""
        names = self.recipe.get("names", [])
        if self.recipe.get("shelf"):
            names = [name for name in names if name in self.assets["objects"]]
        return tuple(names)

    def object(self, name: str) -> ObjectAsset:
        """The asset called `name`, from the bank's own copy.

        Raises:
          BankError: its files are missing or damaged, or it is not the one that the scenes were made with.
          UnsafePathError: the name is none, or a file is a link that leads out of the bank.
        """
        with _mended_by_generate():
            images = inside(self.path, "assets/textures")
            asset = read_object(inside(self.path, f"assets/objects/{name}"), images)
        if asset.name != name:
            raise BankError(f"{self.path}: asset {name!r} calls itself {asset.name!r}", hint=AGAIN)
        self._check_asset(name, object_hash(asset), self.assets["objects"].get(name))
        return asset

    @cached_property
    def support(self) -> SupportAsset:
        """The table, from the bank's own copy; raises as `object` does."""
        with _mended_by_generate():
            support = read_support(inside(self.path, "assets/support"))
        self._check_asset("support", support_hash(support), self.assets["support"])
        return support

    @cached_property
    def open_support(self) -> SupportAsset:
        """The table as objects were placed on it: with its doors open where its scenes close them."""
        if "support_open" not in self.assets:
            return self.support
        with _mended_by_generate():
            support = read_support(inside(self.path, "assets/support_open"))
        self._check_asset("support", support_hash(support), self.assets["support_open"])
        return support

    def support_of(self, row: BankRow) -> SupportAsset:
        """The table with its joints where a scene has them: of one that failed a door may stand open."""
        if row.joints is None or row.is_success:
            return self.support
        return with_joints_at(self.open_support, dict(enumerate(row.joints)))

    @property
    def assets(self) -> AssetDigests:
        """Digests of its objects and its support; of early banks none are known."""
        return self.record.get("assets", NO_ASSETS)

    def _check_asset(self, name: str, digest: str, wanted: str | None) -> None:
        if wanted is not None and digest != wanted:
            raise BankError(
                f"{self.path}: asset {name!r} is not the one that the scenes were made with",
                hint=AGAIN,
            )


@contextmanager
def _mended_by_generate() -> Iterator[None]:
    """Errors of the bank's own copy of an asset, with the hint that `generate` repairs it."""
    try:
        yield
    except PoolError as error:
        raise BankError(error.given, error.allowed, AGAIN) from error


def _files_now(path: Path) -> dict[str, str]:
    """Digests by path, as `bank.json` states them at this moment."""
    return read_bank(path).files or {}


def block_numbers(path: Path) -> list[int]:
    """The blocks that a bank's folder holds, in order."""
    return list(StoredBlocks(path).places)


def is_bank(path: Path) -> bool:
    """Whether a folder holds a bank, or what is left of one."""
    return (path / INDEX).exists() or bool(block_numbers(path))


def read_bank(path: str | Path) -> Bank:
    """Opens a bank, in a folder or at a URL.

    Raises:
      NewerBankError: a later version made it.
      BankError: there is none, or `bank.json` is damaged or of another format.
      ConfigError: its path is not UTF-8.
    """
    path = bank_folder(path)
    check_utf8(path)
    index = path / INDEX
    try:
        data = read_regular(inside(path, INDEX))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise BankError(
            f"{path} is not a bank: it has no {INDEX}", "a folder that `generate` made"
        ) from error
    except OSError as error:
        raise BankError(f"{index} cannot be read ({error})", hint=AGAIN) from error
    return Bank(path, parse_record(path, data))


def recover_record(path: Path) -> Record | None:
    """The bank's record as its first sound block has it, without `num_scenes`; None if no block has it.

    Raises:
      NewerBankError: a later version wrote that block.
    """
    stored = StoredBlocks(path)
    for block in stored.places:
        try:
            record = record_in(stored.read_block(block))
        except (BankError, KeyError, ValueError, RecursionError):
            continue
        check_format(path, record)
        if isinstance(record, dict) and fault_of(record | {"num_scenes": 1}) is None:
            return record  # type: ignore[return-value]
    return None
