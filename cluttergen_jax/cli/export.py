"""`cluttergen export`: scenes of a bank as a folder that other programs open."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import tyro
from tqdm import tqdm

from cluttergen_jax.bank import read_bank
from cluttergen_jax.bank.scene import chosen_records, read_scenes
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.export import FORMATS, export_scenes
from cluttergen_jax.scene import Scene

_MANY = 10


@dataclass(frozen=True)
class Export:
    """Write scenes of a bank as a self-contained folder for another program.

    Attributes:
      source: a bank; or one scene of it: BANK:INDEX, or its file BANK/scenes/000003.xml.
      out: the folder to make.
      format: mjcf (MuJoCo), urdf (PyBullet), sdf (Drake, Gazebo), usd (Isaac, Omniverse), glb (any viewer),
        maniskill or robosuite.
      scenes: numbers such as 0,3,7 or 0-9; all successful ones if not given.
      overwrite: replace an earlier export.
    """

    source: tyro.conf.Positional[str]
    out: str
    format: str = "mjcf"
    scenes: str | None = None
    overwrite: bool = False

    def run(self) -> int:
        """Runs the command; the exit status."""
        path, own = split_source(self.source)
        if own is not None and self.scenes is not None:
            raise ConfigError(
                f"--scenes {self.scenes} beside the single scene {self.source}", "one of the two"
            )
        indices = own if own is not None else parse_numbers(self.scenes)
        bank = read_bank(path)
        total = len(chosen_records(bank, indices))
        scenes = _shown(read_scenes(bank, indices), total)
        folder = export_scenes(scenes, self.out, self.format, overwrite=self.overwrite)
        print(f"{total} scenes in {folder}: open with {FORMATS[self.format].opens_in}")
        return 0


def _shown(scenes: Iterable[Scene], total: int) -> Iterable[Scene]:
    if total <= _MANY:
        return scenes
    return tqdm(scenes, total=total, unit="scene", desc="exporting", disable=None)


def split_source(source: str) -> tuple[Path, list[int] | None]:
    """The bank that an argument names, and the scene of it, or None for all.

    Raises:
      BankError: a file that is no scene of a bank.
    """
    path = Path(source)
    if path.is_file():
        if (
            path.parent.name == "scenes"
            and path.stem.isdigit()
            and (path.parent.parent / "bank.json").exists()
        ):
            return path.parent.parent, [int(path.stem)]
        raise BankError(f"{source} is no scene of a bank", "BANK, BANK:INDEX or BANK/scenes/NUMBER.xml")
    bank, colon, number = source.rpartition(":")
    if colon and number.isdigit() and not path.exists():
        return Path(bank), [int(number)]
    return path, None


def parse_numbers(text: str | None) -> list[int] | None:
    """Scene numbers: `0,3,7-9` in order, each once; None and `all` are all.

    Raises:
      ConfigError: it is something else.
    """
    if text is None or text.strip() == "all":
        return None
    numbers: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)(?:\s*-\s*(\d+))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, -1)
        if last < first:
            raise ConfigError(f"--scenes {text!r}", "numbers and ranges such as 0,3,7-9, or all")
        numbers += range(first, last + 1)
    return list(dict.fromkeys(numbers))
