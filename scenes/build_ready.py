"""Writes a ready scene of each embedded pool into `scenes/ready`: POOL.xml, its convex parts in parts/POOL.

What is seen of the objects lies in `scenes/pools` beside it, and is not stored twice.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import EMBEDDED

_SEED = 2


def build(root: Path) -> list[Path]:
    """Writes the scenes below `root`, replacing what was there."""
    shutil.rmtree(root, ignore_errors=True)
    return [_write(root, pool) for pool in EMBEDDED]


def _write(root: Path, pool: str) -> Path:
    """The first scene that stands of a few."""
    with TemporaryDirectory() as folder:
        bank = Path(folder) / "bank"
        out = Path(folder) / "out"
        cg.generate(bank, pool=pool, num_scenes=4, num_objects=10, seed=_SEED, render=False)
        cg.export(bank, out)
        scene = min((out / "scenes").glob("*.xml"))
        shutil.copytree(
            out / "assets" / "objects",
            root / "parts" / pool,
            ignore=shutil.ignore_patterns("visual-*"),
        )
        text = scene.read_text(encoding="utf-8").replace("../assets", f"parts/{pool}")
        text = re.sub(r"objects/(\w+/visual-)", rf"../../../pools/{pool}/\1", text).replace(
            "objects/", ""
        )
        path = root / f"{pool}.xml"
        path.write_text(text, encoding="utf-8")
    return path


if __name__ == "__main__":
    for file in build(Path(__file__).parent / "ready"):
        print(file.name)
