"""Writes the modeller's supports, in their canonical proportions, into `scenes/supports`."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.assets.support_file import write_support
from scenes.furniture import SUPPORTS, make_support


def build(root: Path) -> list[Path]:
    """Writes every support into a folder of its name below `root`, replacing what was there."""
    return [write_support(root / name, make_support(name), overwrite=True) for name in SUPPORTS]


if __name__ == "__main__":
    for folder in build(Path(__file__).parent / "supports"):
        print(folder.name)
