"""References to scenes of banks in arguments, starts from such a scene, and scene numbers in messages."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.problem import Standing
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.bank import read_bank
from cluttergen_jax.scene.bank.record import INDEX
from cluttergen_jax.scene.bank.remote import bank_folder, is_url

REFERENCES = "BANK, BANK:INDEX or BANK/scenes/NUMBER.xml"
_SAID = 8


def parse_reference(text: str) -> tuple[Path, int | None] | None:
    """The bank's folder and the scene's number in it, None for all of them.

    Whatever is no file is taken for a bank's folder, unread; of a URL it is the mirror, which is fetched.
    None for a file that is no scene of a bank.

    Args:
      text: one of `REFERENCES`, where BANK may be a URL.

    Raises:
      BankError: a URL cannot be reached.
    """
    if is_url(text):
        head, _, number = text.rpartition(":")
        # What follows a question mark may end with a port.
        has_number = number.isdecimal() and "?" not in text
        return bank_folder(head if has_number else text), int(number) if has_number else None
    path = Path(text)
    if path.is_file():
        bank = path.parent.parent
        is_scene = (
            path.parent.name == "scenes" and path.stem.isdecimal() and (bank / INDEX).is_file()
        )
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
    ranges = [str(first) if first == last else f"{first}-{last}" for first, last in runs[:_SAID]]
    return ", ".join([*ranges, *(["..."] if len(runs) > _SAID else [])])


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


def read_start(text: str | None) -> Standing | None:
    """The objects of one scene of a bank, from the bank's own copies, and where they stand.

    Args:
      text: which one, as `parse_reference` reads it; None for nothing.

    Raises:
      ConfigError: the text names no single scene.
      BankError: there is no such bank or scene, or the scene failed.
    """
    if text is None:
        return None
    path, number = parse_reference(text) or (None, None)
    if path is None or number is None:
        raise ConfigError(f"start {text!r}", "BANK:INDEX, such as out:3")
    bank = read_bank(path)
    scene = bank.rows([number]).get(number)
    if scene is None or not scene.is_success:
        state = "no such scene" if scene is None else f"a scene that failed: {scene.verdict}"
        raise BankError(f"start {text}: {state}", "a scene that stands")
    return [bank.object(base_name(name)) for name in scene.objects], scene.poses
