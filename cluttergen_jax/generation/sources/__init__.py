"""What is looked at: a bank, a scene of one, a scene file, a checkpoint, or scenes made on the spot."""

from cluttergen_jax.generation.sources.scene_sources import (
    BankSource,
    FileSource,
    LiveConfig,
    LiveSource,
    ScenesSource,
    open_source,
)

__all__ = ["BankSource", "FileSource", "LiveConfig", "LiveSource", "ScenesSource", "open_source"]
