"""A scene of a bank as a value that exports, viewers and models take."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import public_name
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene import Origin, Scene
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.record import damaged_record
from cluttergen_jax.scene.bank.reference import missing_text, numbers_text
from cluttergen_jax.scene.bank.table import BankRow

_LEAVE_OUT = "leaving those out; without numbers, all that stand are taken"
_Config = TypeVar("_Config", bound=StabilityConfig | ContactConfig | PlacementConfig)


def chosen_rows(bank: Bank, indices: Sequence[int] | None = None) -> list[BankRow]:
    """The rows of these scenes, or of all that succeeded.

    Raises:
      BankError: one of them is not there or failed, or none succeeded.
    """
    if indices is None:
        rows = list(bank.scenes())
        good = [row for row in rows if row.is_success]
        if not good:
            raise BankError(f"{bank.path}: none of its {len(rows)} scenes succeeded", hint="more scenes")
        return good
    by_index = bank.rows(indices)
    missing = "" if len(by_index) == len(set(indices)) else missing_text(indices, _held(bank))
    said = [missing, _failed_text([by_index[i] for i in indices if i in by_index])]
    if any(said):
        raise BankError(f"{bank.path}: {'; '.join(filter(None, said))}", "scenes that stand", _LEAVE_OUT)
    return [by_index[index] for index in indices]


def _held(bank: Bank) -> list[int]:
    """The numbers of the scenes that are there."""
    return [int(index) for rows in bank.tables(["index"]) for index in rows["index"].to_numpy()]


def _failed_text(rows: Sequence[BankRow]) -> str:
    """Which of these failed, and how, in one sentence; empty if none did."""
    failed = [row for row in rows if not row.is_success]
    if len(failed) == 1:
        return f"scene {failed[0].index} failed ({failed[0].verdict})"
    verdicts = sorted({row.verdict for row in failed})
    numbers = numbers_text(int(row.index) for row in failed)
    return f"{len(failed)} scenes failed: {numbers} ({', '.join(verdicts)})" if failed else ""


def read_scenes(bank: Bank, indices: Sequence[int] | None = None) -> Iterator[Scene]:
    """These scenes, or all that succeeded, one by one; each asset is read once.

    Raises:
      BankError: one of them is not there or failed, none succeeded, or the bank's record is damaged.
    """
    rows = chosen_rows(bank, indices)
    asset_of = lru_cache(maxsize=None)(bank.object)
    for row in rows:
        yield _scene(bank, row, [asset_of(base_name(name)) for name in row.objects])


def _scene(bank: Bank, row: BankRow, objects: Sequence[ObjectAsset]) -> Scene:
    recipe, checkpoint = bank.recipe, bank.recipe.get("checkpoint")
    return Scene(
        names=row.objects,
        objects=tuple(objects),
        poses=row.poses,
        support=bank.support,
        stability=config_of(StabilityConfig, recipe.get("stability", {}), bank.path),
        contact=config_of(ContactConfig, recipe.get("contact", {}), bank.path),
        origin=Origin(
            bank=bank.path.resolve().name,
            index=row.index,
            pool=public_name(recipe.get("pool", "")),
            method=recipe.get("method", ""),
            # The name alone: a path would tell where its owner keeps files.
            checkpoint=None if checkpoint is None else Path(checkpoint).name,
            seed=recipe.get("seed"),
            verdict=row.verdict,
            drift=row.drift,
            is_success=bool(row.is_success),
            versions=recipe.get("versions", {}),
        ),
    )


def config_of(kind: type[_Config], values: Mapping[str, Any], path: Path) -> _Config:
    """A config as a bank's recipe has it.

    Raises:
      BankError: the recipe is damaged.
    """
    known = {field.name for field in fields(kind)}
    try:
        plain: dict[str, Any] = {
            key: tuple(v) if isinstance(v, list) else v for key, v in values.items() if key in known
        }
        return kind(**plain)
    except (TypeError, AttributeError, ConfigError) as error:
        raise damaged_record(path, error) from error


def region_of(bank: Bank) -> Rectangle:
    """The region that a bank's recipe asks for.

    Raises:
      BankError: the recipe is damaged.
    """
    try:
        asked = bank.recipe["region"]
        return Rectangle(tuple(asked["center"]), tuple(asked["half_extents"]), asked["yaw"])
    except (KeyError, TypeError, ValueError) as error:
        raise damaged_record(bank.path, error) from error
