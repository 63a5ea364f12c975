"""Results on disk: one JSON file per row, and its scenes beside it; found again by content."""

from __future__ import annotations

import io
import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.files import write_atomically
from cluttergen_jax.schema import SchemaError, checked_record, digest_of, record_bytes

FORMAT = 1
_LONGEST = 180
"""Letters of a title in a file name."""
_SCENES = "scenes"
"""In a row's file: the checksum of its scenes' file."""


class Store:
    """A folder of results.

    A file that cannot be read is set aside as `NAME.damaged` and its row is made anew.

    Args:
      root: made when something is written; None keeps nothing.
      show: told what is wrong with a file.
    """

    def __init__(self, root: Path | None, show: Callable[[str], None] | None = None) -> None:
        self.root = root
        self._show = show or partial(print, file=sys.stderr)

    def path(self, title: str, key: str) -> Path:
        """Where a result lies; its title is for people, its key decides."""
        assert self.root is not None, "a store that keeps nothing has no files"
        words = re.sub(r"[^a-z0-9.]+", "-", title.lower())[:_LONGEST].strip("-")
        return self.root / f"{words}-{key}.json"

    def read(self, title: str, key: str) -> Any | None:
        """The result, or None if there is none that can be used."""
        if self.root is None:
            return None
        path = self.path(title, key)
        try:
            record = checked_record(path.read_bytes())
            record.pop(_SCENES, None)
            if record["format"] == FORMAT and record["key"] == key and "figures" in record:
                return record
            problem = "it is not the result that its name says"
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError) as error:
            problem = f"{type(error).__name__}: {error}"
        self._set_aside(path, problem)
        return None

    def read_arrays(self, title: str, key: str) -> dict[str, np.ndarray] | None:
        """The result's scenes, or None if they are not there."""
        if self.root is None:
            return None
        path = self.path(title, key).with_suffix(".npz")
        # A damaged archive makes zipfile and NumPy raise whatever they like.
        try:
            self._check_scenes(path)
            with np.load(path, allow_pickle=False) as stored:
                return {name: stored[name] for name in stored.files}
        except FileNotFoundError:
            return None
        except Exception as error:
            self._set_aside(path, f"{type(error).__name__}: {error}")
            return None

    @staticmethod
    def _check_scenes(path: Path) -> None:
        """SchemaError for scenes that are not those that the row beside them says."""
        row = path.with_suffix(".json")
        stated = checked_record(row.read_bytes()).get(_SCENES) if row.is_file() else None
        if stated is not None and digest_of(path.read_bytes()) != stated:
            raise SchemaError(f"not the scenes of {row.name}")

    def write(
        self, title: str, key: str, record: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> Any:
        """Stores a result, its scenes first: where the JSON is, they are too. Returns what was stored."""
        stored = {"format": FORMAT, "key": key, **record}
        if self.root is not None:
            buffer = io.BytesIO()
            np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
            path = self.path(title, key)
            write_atomically(path.with_suffix(".npz"), buffer.getvalue())
            write_atomically(path, record_bytes({**stored, _SCENES: digest_of(buffer.getvalue())}))
        return stored

    def keep(
        self, title: str, key: str, figures: Any, made: Mapping[str, Any] | None = None
    ) -> Any:
        """Stores a finding that has no scenes of its own. Returns the figures as they were stored.

        Args:
          made: when and where it was (`records.origin`), stored beside the figures.
        """
        if self.root is not None:
            stored = {"format": FORMAT, "key": key, **(made or {}), "figures": figures}
            write_atomically(self.path(title, key), record_bytes(stored))
        return json.loads(json.dumps(figures))

    def remove(self, title: str, key: str) -> None:
        """Forgets a result, so that it is made anew."""
        self.path(title, key).unlink(missing_ok=True)

    def _set_aside(self, path: Path, problem: str) -> None:
        aside = path.with_name(f"{path.name}.damaged")
        os.replace(path, aside)
        self._show(
            f"note: {path} cannot be used ({problem}); set aside as {aside.name} and made anew"
        )


def json_bytes(value: Any) -> bytes:
    """JSON as it is written everywhere here: one form for one value."""
    return (json.dumps(value, indent=1, allow_nan=False) + "\n").encode()
