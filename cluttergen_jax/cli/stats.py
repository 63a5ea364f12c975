"""`cluttergen stats`: what a bank amounts to, and its dataset card."""

from __future__ import annotations

import json
from dataclasses import dataclass

import tyro


@dataclass(frozen=True)
class Stats:
    """Show what a bank holds: successes, failures by reason, objects, attempts, duplicates, gaps.

    Example: `cluttergen stats out --card`

    Attributes:
      path: a bank.
      card: write the dataset card, README.md, into the bank's folder again (`generate` writes it too).
      json: print JSON.
    """

    path: tyro.conf.Positional[str]
    card: bool = False
    json: bool = False

    def run(self) -> int:
        from cluttergen_jax.kept_folder import hold_folder
        from cluttergen_jax.scene.bank import read_bank
        from cluttergen_jax.scene.bank.card import CARD, write_card
        from cluttergen_jax.scene.bank.stats import stats_of, stats_text

        bank = read_bank(self.path)
        stats = stats_of(bank)
        print(json.dumps(stats.as_json(), indent=1) if self.json else stats_text(bank, stats))
        if self.card:
            with hold_folder(bank.path):
                written = write_card(read_bank(bank.path))
            if not self.json:
                print(f"card       {written or f'left alone: {bank.path / CARD} is your own'}")
        return 0
