"""How an argument names a bank, or one scene of it; and how numbers of scenes are said."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from cluttergen_jax.bank.bank import INDEX

REFERENCES = "BANK, BANK:INDEX or BANK/scenes/NUMBER.xml"
_SAID = 8


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


def numbers_text(numbers: Iterable[int]) -> str:
    """Numbers of scenes as ranges such as `0-3, 7, 9-12`; of many ranges the first eight."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and runs[-1][1] == number - 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    said = [str(first) if first == last else f"{first}-{last}" for first, last in runs[:_SAID]]
    return ", ".join([*said, *(["..."] if len(runs) > _SAID else [])])


def missing_text(asked: Collection[int], held: Collection[int]) -> str:
    """What to say of scenes that were asked for and are not held, in one sentence; empty if all are there.

    Args:
      asked: numbers, each once.
      held: at least one.
    """
    held = held if isinstance(held, range) else frozenset(held)
    missing = [number for number in asked if number not in held]
    if not missing:
        return ""
    holds = f"{held[0]}-{held[-1]}" if isinstance(held, range) else numbers_text(held)
    if len(missing) == 1:
        return f"no scene {missing[0]} in it, which holds {holds}"
    most = f"{len(missing)} of the {len(asked)} scenes asked for"
    return f"{most} ({numbers_text(missing)}) are not in it, which holds {holds}"
