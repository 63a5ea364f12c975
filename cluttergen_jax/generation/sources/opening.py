"""Finds out what an argument of `view` and `render` names."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.errors import PoolError
from cluttergen_jax.generation.sources.live import LiveConfig, LiveSource
from cluttergen_jax.generation.sources.stored import BankSource, FileSource
from cluttergen_jax.rendering.viewer.source import SceneSource
from cluttergen_jax.scene.bank.record import INDEX
from cluttergen_jax.scene.bank.reference import parse_reference


def open_source(text: str | None, config: LiveConfig | None = None) -> tuple[SceneSource, int | None]:
    """What an argument names, and the scene that it asks for.

    Args:
      text: BANK, BANK:INDEX, BANK/scenes/NUMBER.xml, another MJCF file, a checkpoint's folder or its run's;
        None for live sampling alone.

    Raises:
      PoolError: there is nothing of the kind.
    """
    config = config or LiveConfig()
    if text is None:
        return LiveSource(config), None
    path, named = Path(text), parse_reference(text)
    if named is None:
        return FileSource(path), 0
    bank, index = named
    if index is not None or (bank / INDEX).is_file():
        return BankSource(bank), index
    for folder in (path, path / "best", path / "policy"):
        if (folder / "weights.npz").is_file():
            return LiveSource(config, folder), None
    if (path / "scene.xml").is_file():
        return FileSource(path / "scene.xml"), 0
    raise PoolError(
        f"{text} is no bank, no scene and no checkpoint",
        "BANK, BANK:INDEX, an MJCF file, or the folder of a checkpoint",
        "cluttergen generate --out out, then the same command with out",
    )
