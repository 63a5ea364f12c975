"""`cluttergen export`: scenes of a bank as a folder that other programs open."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Literal

import tyro

from cluttergen_jax.cli.parse import keywords, parse_numbers
from cluttergen_jax.config import ExportFormat


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
        from cluttergen_jax.generation.sources.exporting import export
        from cluttergen_jax.scene.export import FORMATS

        folder = export(**keywords(self) | {"scenes": parse_numbers(self.scenes)})
        number = len(json.loads((folder / "MANIFEST.json").read_text())["scenes"])
        print(f"{number} scenes in {folder}: open with {FORMATS[self.format].opens_in}")
        return 0
