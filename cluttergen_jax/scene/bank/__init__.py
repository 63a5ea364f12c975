"""Banks: what `generate` leaves on disk, failures included, and how it is read back."""

from cluttergen_jax.scene.bank.bank import Bank, read_bank
from cluttergen_jax.scene.bank.blocks import AGAIN
from cluttergen_jax.scene.bank.card import assets_section, front_matter, write_unless_own
from cluttergen_jax.scene.bank.lock import LOCK, BankLock
from cluttergen_jax.scene.bank.scene import read_scenes, region_of
from cluttergen_jax.scene.bank.table import BankRow
from cluttergen_jax.scene.bank.writer import BankWriter

__all__ = [
    "AGAIN",
    "LOCK",
    "Bank",
    "BankLock",
    "BankRow",
    "BankWriter",
    "assets_section",
    "front_matter",
    "read_bank",
    "read_scenes",
    "region_of",
    "write_unless_own",
]
