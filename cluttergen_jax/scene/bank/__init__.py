"""Banks: what `generate` leaves on disk, failures included, and how it is read back."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.scene.bank.bank import Bank, read_bank
    from cluttergen_jax.scene.bank.blocks import StoredBlocks
    from cluttergen_jax.scene.bank.card import (
        CARD,
        assets_section,
        front_matter,
        write_card,
        write_unless_own,
    )
    from cluttergen_jax.scene.bank.cut import cut_bank, number_of_seed
    from cluttergen_jax.scene.bank.hub import hub_of, local_paths, pull, push
    from cluttergen_jax.scene.bank.index import BankIndex, Change, changes_of, changes_to_scene
    from cluttergen_jax.scene.bank.record import AGAIN, INDEX
    from cluttergen_jax.scene.bank.remote import bank_folder, check_is_here, fetch_scenes
    from cluttergen_jax.scene.bank.scene import (
        REFERENCES,
        good_indices,
        num_good,
        parse_reference,
        read_scenes,
        region_of,
        select_rows,
    )
    from cluttergen_jax.scene.bank.stats import stats_of, stats_text
    from cluttergen_jax.scene.bank.table import CERTIFICATE, BankRow, is_certified, schema_of
    from cluttergen_jax.scene.bank.writer import BankWriter

__getattr__, __all__ = offer(
    __name__,
    {
        "bank": ("Bank", "read_bank"),
        "blocks": ("StoredBlocks",),
        "card": ("CARD", "assets_section", "front_matter", "write_card", "write_unless_own"),
        "cut": ("cut_bank", "number_of_seed"),
        "hub": ("hub_of", "local_paths", "pull", "push"),
        "index": ("BankIndex", "Change", "changes_of", "changes_to_scene"),
        "record": ("AGAIN", "INDEX"),
        "remote": ("bank_folder", "check_is_here", "fetch_scenes"),
        "scene": (
            "REFERENCES",
            "good_indices",
            "num_good",
            "parse_reference",
            "read_scenes",
            "region_of",
            "select_rows",
        ),
        "stats": ("stats_of", "stats_text"),
        "table": ("CERTIFICATE", "BankRow", "is_certified", "schema_of"),
        "writer": ("BankWriter",),
    },
)
