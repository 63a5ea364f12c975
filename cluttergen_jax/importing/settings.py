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

["kitchen.xml#stove"]
take = true               # or false: whether it is an object, whatever the import makes of it
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.object_files import NAME_PATTERN, RESERVED
from cluttergen_jax.errors import ClutterGenError, ConfigError
from cluttergen_jax.importing.readers import Found, ObjectFile, ReadOptions
from cluttergen_jax.importing.readers.tree import SETTINGS

DEFAULT = "default"
OF_READING = tuple(each.name for each in fields(ReadOptions))
_OF_NAMING = ("name", "label")
TAKE = "take"
KEYS = (*OF_READING, *_OF_NAMING, TAKE)
_OTHER_SPELLING = {"license": "licence"}


@dataclass(frozen=True)
class Settings:
    """A settings file that is read.

    Attributes:
      path: the file.
      tables: keys and values by file pattern, in the file's order; `default` holds for all.
    """

    path: Path
    tables: dict[str, dict[str, Any]]

    def of(self, source: ObjectFile, root: Path) -> dict[str, Any]:
        """The keys and values for one source, found below the folder `root`."""
        values = dict(self.tables.get(DEFAULT, {}))
        for pattern, table in self.tables.items():
            if pattern != DEFAULT and any(_fits(name, pattern) for name in _names(source, root)):
                values |= table
        return values

    def check_used(self, groups: Sequence[tuple[Path, Found]]) -> None:
        """Refuses patterns that fit no object, so that a slip of the pen is not passed over.

        Raises:
          ConfigError: it names the pattern, and what is spelt nearly like it.
        """
        known = [name for root, found in groups for source in found.sources for name in _names(source, root)]
        patterns = [pattern for pattern in self.tables if pattern != DEFAULT]
        unused = [each for each in patterns if not any(_fits(name, each) for name in known)]
        if not unused:
            return
        skipped = {Path(each.name).name: each.reason for _, found in groups for each in found.skipped}
        wrong = unused[0]
        reason = next((why for name, why in skipped.items() if _fits(name, Path(wrong).name)), None)
        why = f" (it is skipped: {reason})" if reason else did_you_mean(wrong, known)
        raise ConfigError(
            f"{self.path}: [{wrong!r}] fits no object{why}",
            "paths or names of files that are imported, such as " + ", ".join(sorted(set(known))[:5]),
        )


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """A question in brackets where something known is spelt nearly like `word`, or nothing."""
    close = difflib.get_close_matches(word, list(known), 1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def read_settings(path: Path) -> Settings:
    """Reads a settings file.

    Raises:
      ConfigError: it cannot be read, or a key or a value is none; the message says which.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"settings {path} cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise ConfigError(f"settings {path} are not TOML: {error}") from error
    return Settings(
        path, {pattern: _check_table(path, pattern, table) for pattern, table in document.items()}
    )


def _check_table(path: Path, pattern: str, table: Any) -> dict[str, Any]:
    where = f"{path}: [{pattern!r}]" if pattern != DEFAULT else f"{path}: [{DEFAULT}]"
    if not isinstance(table, dict):
        raise ConfigError(
            f"{path}: {pattern} = {table!r} outside a table", f"tables: [{DEFAULT}], ['mug.obj']"
        )
    values: dict[str, Any] = {_OTHER_SPELLING.get(str(key), str(key)): value for key, value in table.items()}
    for key, value in values.items():
        if key not in KEYS:
            hint = "a pattern in quotes, as ['mug.obj']" if isinstance(value, dict) else ""
            raise ConfigError(f"{where}: key {key!r}{did_you_mean(key, KEYS)}", ", ".join(KEYS), hint)
        if key in ("licence", "attribution", *_OF_NAMING) and not (isinstance(value, str) and value.strip()):
            raise ConfigError(f"{where}: {key} = {value!r}", "a text")
    if not isinstance(values.get(TAKE, True), bool):
        raise ConfigError(f"{where}: {TAKE} = {values[TAKE]!r}", "true, false")
    if "name" in values and (pattern == DEFAULT or not NAME_PATTERN.fullmatch(values["name"])):
        raise ConfigError(f"{where}: name = {values['name']!r}", "one object's name of a-z, 0-9, '_' and '-'")
    if values.get("name") == RESERVED:
        raise ConfigError(
            f"{where}: name = {RESERVED!r}", f"any other name: {RESERVED!r} is what stands under all"
        )
    try:
        replace(ReadOptions(), **{key: value for key, value in values.items() if key in OF_READING})
    except ClutterGenError as error:
        raise ConfigError(f"{where}: {error.given.removeprefix('ReadOptions.')}", error.allowed) from error
    return values


def settings_for(folder: Path) -> Settings | None:
    """The settings that lie in a folder; None if there are none."""
    file = folder / SETTINGS
    return read_settings(file) if file.is_file() else None


def place_of(source: ObjectFile, root: Path) -> str:
    """A source's path from the folder `root` on, with "#" and the body where its file holds several."""
    path = source.path.relative_to(root).as_posix() if source.path.is_relative_to(root) else source.path.name
    return f"{path}#{source.body.removeprefix('#')}" if source.body else path


def _names(source: ObjectFile, root: Path) -> list[str]:
    """What a pattern may fit: path from the folder on and plain name, with and without the body."""
    names = [place_of(replace(source, body=""), root), source.path.name]
    return names + [f"{name}#{source.body.removeprefix('#')}" for name in names if source.body]


def _fits(name: str, pattern: str) -> bool:
    return name == pattern or fnmatchcase(name, pattern)
