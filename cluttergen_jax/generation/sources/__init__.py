"""What is looked at: a bank, a scene of one, a scene file, a checkpoint, or scenes made on the spot."""

from cluttergen_jax.generation.sources.live import LiveConfig, LiveSource
from cluttergen_jax.generation.sources.opening import open_source
from cluttergen_jax.generation.sources.stored import BankSource, FileSource

__all__ = ["BankSource", "FileSource", "LiveConfig", "LiveSource", "open_source"]
