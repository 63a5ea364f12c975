"""What files do not say about their objects, said in TOML: `objects.toml` in a folder, or another such file.

[default]                 # every object
licence = "CC BY 4.0"

["cups/*.glb"]            # files by path from the folder on, or by name alone; * and ? stand for letters
up = "z"

["mug.obj"]               # of several tables that fit, the later one wins, key by key
scale = 0.001
friction = 0.2

["kitchen.xml#pan"]       # one body of an MJCF file
name = "frying_pan"

["kitchen.glb#pan"]       # one of several things in a mesh file: a node, an `o` of OBJ, or a number
mass = 0.9

["kitchen.xml#stove"]
take = true               # or false: whether it is an object, whatever the import makes of it

A CSV file says the same of many files, a row for each: its column `file` holds the pattern, the others have
keys for names, and an empty cell says nothing.

file,label,synset,mass
mug_012.glb,coffee mug,mug.n.04,0.3
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.object_files import NAME_PATTERN, RESERVED
from cluttergen_jax.errors import ClutterGenError, ConfigError, closest
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions, Survey
from cluttergen_jax.importing.readers.tree import SETTINGS
from cluttergen_jax.schema import SchemaError, parse_toml, read_written

DEFAULT = "default"
OF_READING = tuple(each.name for each in fields(ReadOptions))
_OF_NAMING = ("name", "label", "synset")
TAKE = "take"
KEYS = (*OF_READING, *_OF_NAMING, TAKE)
_OTHER_SPELLING = {"license": "licence"}


@dataclass(frozen=True)
class ObjectSettings:
    """A settings file that is read.

    Attributes:
      path: the file.
      tables: keys and values by file pattern, in the file's order; `default` holds for all.
      is_list: of many files, of which some may not be there.
    """

    path: Path
    tables: dict[str, dict[str, Any]]
    is_list: bool = False

    @cached_property
    def _order(self) -> dict[str, int]:
        return {pattern: place for place, pattern in enumerate(self.tables)}

    @cached_property
    def _globs(self) -> tuple[str, ...]:
        """The patterns that can fit what they do not spell."""
        return tuple(each for each in self.tables if each != DEFAULT and _is_glob(each))

    def of(self, source: ObjectFile, root: Path) -> dict[str, Any]:
        """The keys and values for one source, found below the folder `root`."""
        names = _names(source, root)
        fitting = {each for each in self._globs if any(_fits(name, each) for name in names)}
        fitting |= {name for name in names if name in self.tables and name != DEFAULT}
        values = dict(self.tables.get(DEFAULT, {}))
        for pattern in sorted(fitting, key=self._order.__getitem__):
            values |= self.tables[pattern]
        return values

    def nodes_of(self, source: ObjectFile, root: Path) -> list[str]:
        """The nodes of a mesh file that are spelt out behind its name, in the file's order."""
        if source.kind != "mesh" or source.body or not source.path.is_relative_to(root):
            return []
        names = _names(source, root)
        nodes = []
        for pattern in self.tables:
            file, _, node = pattern.partition("#")
            if node and not _is_glob(node) and any(_fits(name, file) for name in names):
                nodes.append(node)
        return nodes

    def check_used(self, groups: Sequence[tuple[Path, Survey]]) -> None:
        """Refuses patterns that fit no object, so that a slip of the pen is not passed over.

        Of a list some have to fit.

        Raises:
          ConfigError: it names the pattern, and what is spelt nearly like it.
        """
        known = []
        for root, found in groups:
            for source in found.sources:
                known += _names(source, root)
        there = set(known)
        patterns = [pattern for pattern in self.tables if pattern != DEFAULT]
        used = [
            each in there or (each in self._globs and any(_fits(name, each) for name in known))
            for each in patterns
        ]
        unused = [each for each, is_used in zip(patterns, used, strict=True) if not is_used]
        if not unused or (self.is_list and len(unused) < len(patterns)):
            return
        skipped = {
            Path(each.name).name: each.reason for _, found in groups for each in found.skipped
        }
        wrong = unused[0]
        reason = next((why for name, why in skipped.items() if _fits(name, Path(wrong).name)), None)
        why = f" (it is skipped: {reason})" if reason else ""
        some = ", ".join(sorted(there)[:5])
        raise ConfigError(
            f"{self.path}: [{wrong!r}] fits no object{why}",
            f"paths or names of files that are imported, such as {some}",
            meant="" if reason else closest(wrong, known),
        )


def read_settings(path: Path) -> ObjectSettings:
    """Reads a settings file.

    Raises:
      ConfigError: it cannot be read, or a key or a value is none; the message says which.
    """
    is_list = path.suffix.lower() == ".csv"
    try:
        text = read_written(path).decode("utf-8-sig")
        document = _rows_of(path, text) if is_list else parse_toml(text)
    except OSError as error:
        raise ConfigError(f"settings {path} cannot be read ({error.strerror})") from error
    except SchemaError as error:
        raise ConfigError(
            f"settings {path}: {error}", "a file of TOML, or a table of CSV"
        ) from error
    except (ValueError, csv.Error) as error:
        kind = "a table of CSV" if is_list else "TOML"
        raise ConfigError(f"settings {path} are not {kind}: {error}") from error
    tables = {pattern: _check_table(path, pattern, table) for pattern, table in document.items()}
    return ObjectSettings(path, tables, is_list)


_FILE = "file"
_WORDS = {"true": True, "false": False}


def _rows_of(path: Path, text: str) -> dict[str, dict[str, Any]]:
    """The rows of a CSV file, by pattern (ConfigError: a column or a row is missing, or comes twice)."""
    rows = csv.DictReader(text.splitlines(), strict=True, restkey="")
    columns = [column.strip() for column in rows.fieldnames or ()]
    if _FILE not in columns or len(set(columns)) < len(columns) or len(columns) < 2:
        raise ConfigError(
            f"{path}: columns {', '.join(columns) or 'none'}",
            f"{_FILE}, and some of {', '.join(KEYS)}",
        )
    rows.fieldnames = columns
    found: dict[str, dict[str, Any]] = {}
    for row in rows:
        pattern = (row.pop(_FILE) or "").strip()
        if not pattern or pattern in found or "" in row or None in row.values():
            given = f"{path}, line {rows.line_num}: {pattern or 'no file'!r}"
            raise ConfigError(given, f"each file once, and {len(columns)} cells in a row")
        found[pattern] = {
            key: _cell(key, cell.strip()) for key, cell in row.items() if cell.strip()
        }
    return found


def _cell(key: str, text: str) -> Any:
    """A number, a truth or a text."""
    if key in ("licence", "license", "attribution", *_OF_NAMING):
        return text
    try:
        return _WORDS[text.lower()] if text.lower() in _WORDS else float(text)
    except ValueError:
        return text


def _check_table(path: Path, pattern: str, table: Any) -> dict[str, Any]:
    where = f"{path}: [{pattern!r}]" if pattern != DEFAULT else f"{path}: [{DEFAULT}]"
    if not isinstance(table, dict):
        raise ConfigError(
            f"{path}: {pattern} = {table!r} outside a table", f"tables: [{DEFAULT}], ['mug.obj']"
        )
    values: dict[str, Any] = {
        _OTHER_SPELLING.get(str(key), str(key)): value for key, value in table.items()
    }
    for key, value in values.items():
        if key not in KEYS:
            hint = "a pattern in quotes, as ['mug.obj']" if isinstance(value, dict) else ""
            raise ConfigError(f"{where}: key {key!r}", ", ".join(KEYS), hint, closest(key, KEYS))
        if key in ("licence", "attribution", *_OF_NAMING) and not (
            isinstance(value, str) and value.strip()
        ):
            raise ConfigError(f"{where}: {key} = {value!r}", "a text")
    if not isinstance(values.get(TAKE, True), bool):
        raise ConfigError(f"{where}: {TAKE} = {values[TAKE]!r}", "true, false")
    if "name" in values and (pattern == DEFAULT or not NAME_PATTERN.fullmatch(values["name"])):
        raise ConfigError(
            f"{where}: name = {values['name']!r}", "one object's name of a-z, 0-9, '_' and '-'"
        )
    if values.get("name") == RESERVED:
        raise ConfigError(
            f"{where}: name = {RESERVED!r}",
            f"any other name: {RESERVED!r} is what stands under all",
        )
    try:
        replace(ReadOptions(), **{key: value for key, value in values.items() if key in OF_READING})
    except ClutterGenError as error:
        raise ConfigError(
            f"{where}: {error.given.removeprefix('ReadOptions.')}", error.allowed
        ) from error
    return values


def settings_for(folder: Path) -> ObjectSettings | None:
    """The settings that lie in a folder; None if there are none."""
    file = folder / SETTINGS
    return read_settings(file) if file.is_file() else None


def place_of(source: ObjectFile, root: Path) -> str:
    """A source's path from the folder `root` on, with "#" and the body where its file holds several."""
    path = source.path.name
    if source.path.is_relative_to(root):
        path = source.path.relative_to(root).as_posix()
    return f"{path}#{source.body.removeprefix('#')}" if source.body else path


def _names(source: ObjectFile, root: Path) -> list[str]:
    """What a pattern may fit: path from the folder on and plain name, with and without the body."""
    names = [place_of(replace(source, body=""), root), source.path.name]
    return names + [f"{name}#{source.body.removeprefix('#')}" for name in names if source.body]


def _is_glob(text: str) -> bool:
    return any(sign in text for sign in "*?[")


def _fits(name: str, pattern: str) -> bool:
    return name == pattern or fnmatchcase(name, pattern)
