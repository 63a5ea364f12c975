"""`cluttergen export`: scenes of a bank as a folder that other programs open."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import tyro

from cluttergen_jax.cli.parse import parse_numbers
from cluttergen_jax.config import ExportFormat
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.progress import tracked

if TYPE_CHECKING:
    from cluttergen_jax.scene import Scene

_MANY = 10


@dataclass(frozen=True)
class Export:
    """Write scenes of a bank as a self-contained folder for another program.

    Example: `cluttergen export out --format urdf --scenes 0-9 --out elsewhere`

    Attributes:
      source: a bank; or one scene of it: BANK:INDEX, or its file BANK/scenes/000003.xml.
      out: the folder to make.
      format: mjcf (MuJoCo), urdf (PyBullet), sdf (Drake, Gazebo), usd (Isaac, Omniverse), glb (any viewer),
        maniskill, robosuite or libero.
      scenes: numbers such as 0,3,7 or 0-9; all successful ones if not given.
      cameras: cameras around the support, to be added to every scene: overhead, front, side, wrist.
      overwrite: replace an earlier export.
    """

    source: tyro.conf.Positional[str]
    out: str
    format: ExportFormat = "mjcf"
    scenes: str | None = None
    cameras: tuple[Literal["overhead", "front", "side", "wrist"], ...] = ()
    overwrite: bool = False

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.bank import read_bank
        from cluttergen_jax.bank.reference import REFERENCES, parse_reference
        from cluttergen_jax.bank.scene import chosen_records, read_scenes
        from cluttergen_jax.export import FORMATS, export_scenes

        named = parse_reference(self.source)
        if named is None:
            raise BankError(f"{self.source} is no scene of a bank", REFERENCES)
        path, own = named
        if own is not None and self.scenes is not None:
            raise ConfigError(
                f"--scenes {self.scenes} beside the single scene {self.source}", "one of the two"
            )
        indices = parse_numbers(self.scenes) if own is None else [own]
        bank = read_bank(path)
        total = len(chosen_records(bank, indices))
        scenes = _shown(read_scenes(bank, indices), total)
        folder = export_scenes(scenes, self.out, self.format, overwrite=self.overwrite, cameras=self.cameras)
        print(f"{total} scenes in {folder}: open with {FORMATS[self.format].opens_in}")
        return 0


def _shown(scenes: Iterable[Scene], total: int) -> Iterable[Scene]:
    if total <= _MANY:
        return scenes
    return tracked(scenes, "exporting", total, "scene")
