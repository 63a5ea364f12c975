"""A bank with a script for a program that pins another MuJoCo or JAX: it reads the bank by `bank_reader.py`.

README.txt MANIFEST.json    how to use it; which scenes
LICENSES.txt                the terms of what is in it
SCRIPT bank_reader.py       to be imported from here; they need nothing of cluttergen_jax
bank/                       bank.json, scenes-*.parquet, assets, README.md with the terms
"""

from __future__ import annotations

import importlib.resources
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.files import folder_whole
from cluttergen_jax.kept_folder import lock_beside
from cluttergen_jax.scene.export.folder import (
    LICENCES,
    MANIFEST,
    check_place,
    generator_version,
    licences_text,
)

_READER = "bank_reader.py"
_PARTS = ("bank.json", "README.md", _READER, "scenes-*.parquet", "assets")


@dataclass(frozen=True)
class BankFormat:
    """One program that takes a whole bank.

    Attributes:
      name: as on the command line.
      opens_in: who reads it, and how, in a sentence.
      script: in `export/scripts`.
    """

    name: str
    opens_in: str
    script: str


_ALL = (
    BankFormat(
        "mjlab",
        "mjlab 1.6: from cluttergen_mjlab import Clutter; its entities(), events() and simulation() go into "
        "the configuration of an environment.",
        "cluttergen_mjlab.py",
    ),
    BankFormat(
        "playground",
        "MuJoCo Playground 0.2: import cluttergen_playground, cluttergen_playground.register('ClutterPick'), "
        "then mujoco_playground.registry.load('ClutterPick').",
        "cluttergen_playground.py",
    ),
    BankFormat(
        "lerobot",
        "LeRobot 0.6: push the folder to a hub as a model repository, then lerobot.envs.make_env("
        "'OWNER/NAME', n_envs=4, trust_remote_code=True); or import its env.py and call make_env.",
        "env.py",
    ),
)
BANK_FORMATS = {each.name: each for each in _ALL}
"""Every such format by name."""


def export_bank(
    bank: Path,
    support: SupportAsset,
    objects: Sequence[ObjectAsset],
    indices: Sequence[int],
    out: str | Path,
    format: str,
    overwrite: bool,
) -> Path:
    """Writes a bank with the script of a format of `BANK_FORMATS`, whole or not at all.

    Args:
      support, objects: that are in it. indices: of its scenes that succeeded.
      overwrite: replace an earlier export.

    Returns:
      The folder.

    Raises:
      ConfigError: `out` exists. BankError: another export is being written there.
    """
    kind = BANK_FORMATS[format]
    out = Path(out)
    package = importlib.resources.files("cluttergen_jax")
    check_place(out, overwrite)
    with lock_beside(out):
        check_place(out, overwrite)
        with folder_whole(out) as fresh:
            (fresh / "bank").mkdir(parents=True)
            for pattern in _PARTS:
                for path in bank.glob(pattern):
                    copy = shutil.copytree if path.is_dir() else shutil.copy2
                    copy(path, fresh / "bank" / path.name)
            for source in (package / _READER, package / "scene/export/scripts" / kind.script):
                (fresh / Path(str(source)).name).write_text(
                    source.read_text(encoding="utf-8"), encoding="utf-8"
                )
            record = {
                "format": 1,
                "kind": "cluttergen export",
                "export_format": kind.name,
                "generator": {"cluttergen_jax": generator_version()},
                "scenes": [int(index) for index in indices],
            }
            terms = licences_text(support, objects, kind.script)
            (fresh / LICENCES).write_text(terms, encoding="utf-8")
            (fresh / MANIFEST).write_text(json.dumps(record) + "\n", encoding="utf-8")
            about = f"{len(indices)} scenes, exported by cluttergen_jax as {kind.name}."
            about += f"\n\nOpen with {kind.opens_in}\n"
            (fresh / "README.txt").write_text(about, encoding="utf-8")
            check_place(out, overwrite)
    return out
