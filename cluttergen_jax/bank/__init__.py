"""Banks: what `generate` leaves on disk, failures included, and how it is read back."""

from cluttergen_jax.bank.bank import Bank, BankWriter, SceneRecord, read_bank

__all__ = ["Bank", "BankWriter", "SceneRecord", "read_bank"]
