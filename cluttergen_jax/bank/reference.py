"""How an argument names a bank, or one scene of it."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.bank.bank import INDEX

REFERENCES = "BANK, BANK:INDEX or BANK/scenes/NUMBER.xml"


def parse_reference(text: str) -> tuple[Path, int | None] | None:
    """The bank's folder and the scene's number in it, None for all of them.

    Whatever is no file is taken for a bank's folder, unread. None for a file that is no scene of a bank.

    Args:
      text: one of `REFERENCES`.
    """
    path = Path(text)
    if path.is_file():
        bank = path.parent.parent
        is_scene = path.parent.name == "scenes" and path.stem.isdecimal() and (bank / INDEX).is_file()
        return (bank, int(path.stem)) if is_scene else None
    head, _, number = text.rpartition(":")
    if head and number.isdecimal() and not path.exists():
        return Path(head), int(number)
    return path, None
