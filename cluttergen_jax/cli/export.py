"""`cluttergen export`: scenes of a bank as a folder that other programs open."""

from __future__ import annotations

import json
from typing import ClassVar

from tyro.conf import Positional

from cluttergen_jax.api.export import export
from cluttergen_jax.cli.options import Options, options_from


@options_from(export, source=Positional[str], format=str)
class Export(Options):
    """Write scenes of a bank as a self-contained folder for another program.

    Example: `cluttergen export out --format urdf --scenes 0-9 --out elsewhere`
    """

    resumes: ClassVar[bool] = False

    def run(self) -> int:
        from cluttergen_jax.scene.export import BANK_FORMATS
        from cluttergen_jax.scene.export.folder import MANIFEST
        from cluttergen_jax.scene.export.formats import find_format

        kind = BANK_FORMATS.get(self.format) or find_format(self.format)
        folder = self.call(export, format=self.format if self.format in BANK_FORMATS else kind)
        scenes = json.loads((folder / MANIFEST).read_text())["scenes"]
        print(f"{len(scenes)} scenes in {folder}: open with {kind.opens_in}")
        return 0
