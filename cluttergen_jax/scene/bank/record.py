"""What `bank.json` says: how a bank was made, with which assets, computed by what, and its files' digests.

A record's `bits` are a list of `numerics.bits_of_here`, one for each kind of process that made scenes: equal
recipes give equal scenes where these are equal. Banks of older versions, and banks that a person makes, have
none, and are continued anywhere.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, NotRequired, TypedDict, TypeVar

from cluttergen_jax import bank_reader
from cluttergen_jax.assets.object_files import NAME_PATTERN
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.schema import refuse_control_characters

FORMAT = bank_reader.FORMAT
INDEX = "bank.json"
READER = "bank_reader.py"
AGAIN = (
    "the same `cluttergen generate` again, which mends what is damaged and makes what is missing"
)
Bits = dict[str, str]


class Recipe(TypedDict, total=False):
    """What decides the scenes of a bank (`generation.recipe.recipe_of`); old and made-up ones lack some.

    `placement`, `stability` and `contact` are the fields of the configs of these names; `region` and
    `keep_out` those of a `Rectangle`. `method_digest` is there where the method was a user's own, and `asked`
    where a language model wrote its layout: request, model and tries; `cut` where its scenes are some of
    another bank's: that one's name, and the numbers by which the seed makes them, as runs of first and last.
    """

    pool: str
    objects: list[str]
    repeat: bool
    shelf: int
    weights: list[tuple[str, float]]
    balance: str
    support: str
    region: Mapping[str, Any]
    keep_out: list[Mapping[str, Any]]
    engine: str
    placement: Mapping[str, Any]
    stability: Mapping[str, Any]
    contact: Mapping[str, Any]
    start: str | None
    method: str
    method_digest: str
    checkpoint: str | None
    checkpoint_hash: str | None
    seed: int
    block_size: int
    names: list[str]
    versions: dict[str, str]
    asked: Mapping[str, Any]
    cut: Mapping[str, Any]


class AssetDigests(TypedDict):
    """`object_hash` by name, and `support_hash`; of the open one where scenes close doors."""

    objects: dict[str, str]
    support: str | None
    support_open: NotRequired[str]


class Record(TypedDict, total=False):
    """The record of a bank; blocks hold it without `num_scenes` and `files`, which change while they stay.

    `files` has digests by path within the bank (`bank.index`).
    """

    num_scenes: int
    format: int
    recipe: Recipe
    assets: AssetDigests
    bits: list[Bits]
    files: dict[str, str]


NO_ASSETS: AssetDigests = {"objects": {}, "support": None}
"""Of banks that do not say."""


class NewerBankError(BankError):
    """The bank was made by a later version of this package: not damaged, and not to be mended."""


def check_format(path: Path, record: Any) -> None:
    """Refuses the record of a bank that a later version made (NewerBankError: it is one)."""
    number = record.get("format") if isinstance(record, dict) else None
    if isinstance(number, int) and number > FORMAT:
        raise _newer(path, f"format {number}")


def parse_record(path: Path, data: bytes) -> Record:
    """The record in the `bank.json` of the bank at `path`.

    Raises:
      NewerBankError: a later version wrote it.
      BankError: it is damaged, or of another format.
    """
    index = path / INDEX
    try:
        record = bank_reader.parse_record(data)
        refuse_control_characters(record)
    except bank_reader.NewerFormatError as error:
        raise _newer(path, error) from error
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else error
        raise BankError(f"{index} is damaged ({reason})", hint=AGAIN) from error
    if fault := fault_of(record):
        raise BankError(f"{index} is damaged ({fault})", hint=AGAIN)
    return record  # type: ignore[return-value]


def _newer(path: Path, number: object) -> NewerBankError:
    return NewerBankError(
        f"{path} was made by a newer version ({number}; this one reads {FORMAT})",
        hint="a newer cluttergen_jax",
    )


def block_record(record: Record) -> Record:
    """The record as blocks hold it: without what changes while they stay as they are."""
    kept = record.copy()
    for name in ("num_scenes", "files"):
        kept.pop(name, None)  # type: ignore[misc]
    return kept


def index_bytes(record: Mapping[str, Any]) -> bytes:
    """The content of `bank.json`: the record, and its digest, so that damage is noticed."""
    return (
        json.dumps({**record, "hash": bank_reader.digest_of_record(record)}, indent=1) + "\n"
    ).encode()


def fault_of(record: Mapping[str, Any]) -> str | None:
    """What is wrong with the record of a bank, in words; None if it is sound."""
    try:
        bank_reader.check_record(dict(record))
    except ValueError as error:
        return str(error)
    assets = record.get("assets", NO_ASSETS)
    if "support" not in assets:
        return "its digests of assets are not understood"
    if strange := [name for name in assets["objects"] if not NAME_PATTERN.fullmatch(name)]:
        return f"it names an object {strange[0]!r}"
    bits = record.get("bits", [{}])
    if (
        not isinstance(bits, list)
        or not bits
        or not all(
            isinstance(each, dict) and all(isinstance(text, str) for text in each.values())
            for each in bits
        )
    ):
        return "by what its scenes were computed is not understood"
    return None


def record_error(path: Path, error: Exception) -> BankError:
    """The error for a bank whose recipe, sound as JSON, cannot be what made it."""
    reason = f"no {error}" if isinstance(error, KeyError) else getattr(error, "given", error)
    return BankError(
        f"{path / INDEX}: the record of how the bank was made is damaged ({reason})",
        hint="a copy of the bank that is whole",
    )


def cut_runs(recipe: Mapping[str, Any]) -> list[tuple[int, int]]:
    """By which numbers the seed makes the scenes of a bank that was cut of another, in order.

    Returns:
      First and last of each run; nothing of a bank that was not cut.

    Raises:
      BankError: the recipe does not say it whole.
    """
    if "cut" not in recipe:
        return []
    try:
        return [(int(first), int(last)) for first, last in recipe["cut"]["scenes"]]
    except (TypeError, ValueError, LookupError) as error:
        given = f"a bank whose record of what it was cut of is damaged ({error})"
        raise BankError(given, hint="a copy of the bank that is whole") from error


def check_bits(path: Path, ours: Bits, known: list[Bits]) -> None:
    """Refuses to mix scenes that one recipe makes differently (BankError)."""
    if ours not in known:
        raise BankError(
            f"{path} would get scenes of other bits than those it has, so that equal seeds would not mean "
            f"equal scenes: {'; '.join(differences(ours, known[-1]))}",
            "the machine and the settings that made it",
            "another `out`, `overwrite` to begin anew, or `allow_other_bits` for a bank that is a mixture",
        )


def differences(ours: Bits, theirs: Bits) -> list[str]:
    """What differs, and where many words are alike those that are not."""
    lines = []
    for name in sorted({*ours, *theirs}):
        here = ours.get(name, "").split()
        there = theirs.get(name, "").split()
        if here != there:
            only_here = " ".join(word for word in here if word not in there) or "nothing more"
            only_there = " ".join(word for word in there if word not in here) or "nothing more"
            lines.append(f"{name} (here {only_here}, the bank {only_there})")
    return lines


_Config = TypeVar("_Config", bound=StabilityConfig | ContactConfig | PlacementConfig)


def config_of(kind: type[_Config], values: Mapping[str, Any], path: Path) -> _Config:
    """A config as a bank's recipe has it (BankError: the recipe is damaged)."""
    known = {field.name for field in fields(kind)}
    try:
        plain: dict[str, Any] = {
            key: tuple(v) if isinstance(v, list) else v for key, v in values.items() if key in known
        }
        return kind(**plain)
    except (TypeError, AttributeError, ConfigError) as error:
        raise record_error(path, error) from error
