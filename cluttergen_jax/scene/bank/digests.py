"""Which files a bank has beside its blocks, and whether they are still what was written.

`bank.json` holds a digest of every file in `assets/` and of every scene's MJCF file: programs other than this
one read those, and a part that is scaled or a mass that is changed would not be seen in them. Blocks have
checksums of their own.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cluttergen_jax.files import inside
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.bank import Bank

_ASSETS, _SCENES = "assets", "scenes"


@dataclass(frozen=True)
class Change:
    """A file that is not what was written.

    Attributes:
      name: its path within the bank, parts divided by "/".
      what: "changed", "missing" or "not in bank.json".
    """

    name: str
    what: str


def digest_of(data: bytes) -> str:
    """The digest of a file's content."""
    return hashlib.sha256(data).hexdigest()


def digests_in(path: Path, folder: str) -> dict[str, str]:
    """The digest of each file below `folder` of the bank at `path`, by its path within the bank."""
    files = sorted(each for each in (path / folder).rglob("*") if each.is_file())
    return {each.relative_to(path).as_posix(): digest_of(each.read_bytes()) for each in files}


def changes_of(bank: Bank) -> list[Change] | None:
    """The files of a bank that are not what was written; None if the bank is older than digests.

    Raises:
      UnsafePathError: `bank.json` names a path outside of the bank.
    """
    known = bank.files
    if known is None:
        return None
    found = []
    for name, digest in known.items():
        file = inside(bank.path, name)
        if not file.is_file():
            found.append(Change(name, "missing"))
        elif digest_of(file.read_bytes()) != digest:
            found.append(Change(name, "changed"))
    found += [Change(name, "not in bank.json") for name in _names_in(bank.path) if name not in known]
    return sorted(found, key=lambda change: change.name)


def _names_in(path: Path) -> list[str]:
    files = [*(path / _ASSETS).rglob("*"), *(path / _SCENES).glob("*.xml")]
    return [each.relative_to(path).as_posix() for each in files if each.is_file()]


def touched(changes: Iterable[Change], file: str, objects: Iterable[str]) -> list[str]:
    """Those of the changed files that a scene is made of: its own, its objects', and what all scenes share.

    Args:
      file: the name of the scene's file in `scenes`.
      objects: the names of its bodies.
    """
    names = {base_name(name) for name in objects}

    def is_of_scene(parts: Sequence[str]) -> bool:
        if parts[0] == _SCENES:
            return parts[1:] == [file]
        return parts[1:2] != ["objects"] or len(parts) < 3 or parts[2] in names

    return [change.name for change in changes if is_of_scene(change.name.split("/"))]
