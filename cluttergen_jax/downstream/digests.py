"""Digests of JSON values, of checkpoints, and of the constants that modules fix."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

_CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]*")
_SKIPPED = object()


def constants_hash(*modules: ModuleType, **others: Any) -> str:
    """Hex digest of the numbers and texts that modules name in capitals, and of others by name.

    In which of the modules a constant stands does not matter: code can be moved. Other machines compute the
    last digits of a cosine otherwise: twelve count.
    """
    fixed = [(name, value) for module in modules for name, value in vars(module).items()]
    named = [(name, value) for name, value in fixed if _CONSTANT.fullmatch(name)] + list(
        others.items()
    )
    plain = ((name, _plain(value)) for name, value in named)
    known = {json.dumps([name, value]) for name, value in plain if value is not _SKIPPED}
    return json_digest(sorted(known))


def json_digest(value: Any, length: int = 64) -> str:
    """The first hex digits of the digest of a JSON value."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:length]


def folder_hash(folder: Path, names: Sequence[str] | None = None) -> str:
    """The digest of a checkpoint's files, or of those of some names."""
    found = folder.rglob("*") if names is None else (folder / name for name in names)
    files = sorted(each for each in found if each.is_file())
    parts = [f"{each.relative_to(folder)}".encode() + each.read_bytes() for each in files]
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()


def _plain(value: Any) -> Any:
    """As JSON has it; types, functions and what holds any are no constants."""
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, int | float | np.number):
        return f"{float(value):.12g}"
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain([getattr(value, field.name) for field in dataclasses.fields(value)])
    if isinstance(value, tuple | list):
        parts = [_plain(each) for each in value]
        return _SKIPPED if any(part is _SKIPPED for part in parts) else parts
    return _SKIPPED
