"""A scene of a bank as a value that exports, viewers and models take."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import public_name
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import BankError
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene import Origin, Scene
from cluttergen_jax.scene.bank.bank import Bank, SceneRecord
from cluttergen_jax.scene.bank.reference import missing_text, numbers_text

_LEAVE_OUT = "leaving those out; without numbers, all that stand are taken"
_Config = TypeVar("_Config", bound=StabilityConfig | ContactConfig | PlacementConfig)


def chosen_records(bank: Bank, indices: Sequence[int] | None = None) -> list[SceneRecord]:
    """The records of these scenes, or of all that succeeded.

    Raises:
      BankError: one of them is not there or failed, or none succeeded.
    """
    records = list(bank.scenes())
    if indices is None:
        good = [record for record in records if record.is_success]
        if not good:
            raise BankError(f"{bank.path}: none of its {len(records)} scenes succeeded", hint="more scenes")
        return good
    by_index = {record.index: record for record in records}
    said = [missing_text(indices, by_index), _failed_text([by_index[i] for i in indices if i in by_index])]
    if any(said):
        raise BankError(f"{bank.path}: {'; '.join(filter(None, said))}", "scenes that stand", _LEAVE_OUT)
    return [by_index[index] for index in indices]


def _failed_text(records: Sequence[SceneRecord]) -> str:
    """Which of these failed, and how, in one sentence; empty if none did."""
    failed = [record for record in records if not record.is_success]
    if len(failed) == 1:
        return f"scene {failed[0].index} failed ({failed[0].verdict})"
    verdicts = sorted({record.verdict for record in failed})
    numbers = numbers_text(int(record.index) for record in failed)
    return f"{len(failed)} scenes failed: {numbers} ({', '.join(verdicts)})" if failed else ""


def read_scenes(bank: Bank, indices: Sequence[int] | None = None) -> Iterator[Scene]:
    """These scenes, or all that succeeded, one by one; each asset is read once.

    Raises:
      BankError: one of them is not there or failed, none succeeded, or the bank's record is damaged.
    """
    records = chosen_records(bank, indices)
    asset_of = lru_cache(maxsize=None)(bank.object)
    for record in records:
        yield _scene(bank, record, [asset_of(base_name(name)) for name in record.objects])


def _scene(bank: Bank, record: SceneRecord, objects: Sequence[ObjectAsset]) -> Scene:
    recipe = bank.record.get("recipe", {})
    return Scene(
        names=tuple(str(name) for name in record.objects),
        objects=tuple(objects),
        poses=record.poses,
        support=bank.support,
        stability=config_of(StabilityConfig, recipe.get("stability", {}), bank.path),
        contact=config_of(ContactConfig, recipe.get("contact", {}), bank.path),
        origin=Origin(
            bank=bank.path.resolve().name,
            index=record.index,
            pool=public_name(recipe.get("pool", "")),
            method=recipe.get("method", ""),
            # The name alone: a path would tell where its owner keeps files.
            checkpoint=None if recipe.get("checkpoint") is None else Path(recipe["checkpoint"]).name,
            seed=recipe.get("seed"),
            verdict=record.verdict,
            drift=record.drift,
            is_success=bool(record.is_success),
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
    except (TypeError, AttributeError) as error:
        raise BankError(f"{path}: the record of how it was made is damaged ({error})") from error
