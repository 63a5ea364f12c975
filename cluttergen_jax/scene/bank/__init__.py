"""Banks: what `generate` leaves on disk, failures included, and how it is read back."""

from cluttergen_jax.scene.bank.bank import Bank, SceneRecord, read_bank
from cluttergen_jax.scene.bank.writer import BankWriter

__all__ = ["Bank", "BankWriter", "SceneRecord", "read_bank"]
