"""Banks: what `generate` leaves on disk, failures included, and how it is read back."""

from cluttergen_jax.scene.bank.bank import Bank, read_bank
from cluttergen_jax.scene.bank.table import BankRow
from cluttergen_jax.scene.bank.writer import BankWriter

__all__ = ["Bank", "BankRow", "BankWriter", "read_bank"]
