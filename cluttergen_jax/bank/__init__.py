"""Banks: what `generate` leaves on disk, failures included, and how it is read back."""

from cluttergen_jax.bank.bank import Bank, SceneRecord, read_bank
from cluttergen_jax.bank.writer import BankWriter

__all__ = ["Bank", "BankWriter", "SceneRecord", "read_bank"]
