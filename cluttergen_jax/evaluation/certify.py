"""Stability certificates of stored scenes: columns of a bank, found by `measures.certificate`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pyarrow as pa

from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import BankError
from cluttergen_jax.evaluation.measures.arrangement import by_object
from cluttergen_jax.evaluation.measures.certificate import certificates
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.measures.simulate import horizons_of
from cluttergen_jax.files import writing
from cluttergen_jax.placement.world import base_name, make_world
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.blocks import StoredBlocks, merge_shards
from cluttergen_jax.scene.bank.card import write_card
from cluttergen_jax.scene.bank.lock import BankLock
from cluttergen_jax.scene.bank.scene import config_of
from cluttergen_jax.scene.bank.table import CERTIFICATE, CLUTTER, SCHEMA, is_fully_certified
from cluttergen_jax.scene.bank.writer import write_rows

_RENAMED = {"drift": "horizon_drift", "drift_turn": "horizon_turn", "drift_seconds": "horizon_seconds"}


@dataclass(frozen=True, eq=False)
class Certification:
    """What `cluttergen_jax.certify` did.

    Attributes:
      shake: f64[N], m/s^2, the shake scores of all scenes that stand.
      num_new: rows that were measured now.
    """

    shake: np.ndarray
    num_new: int


def certify_bank(bank: Bank, seconds: float, jobs: int, force: bool) -> Certification:
    """The certificates of a bank's scenes, written into it; see `cluttergen_jax.certify`."""
    horizons_of((seconds,))
    with writing(bank.path):
        lock = BankLock(bank.path)
    try:
        found = _certify(bank, seconds, jobs, force)
        with writing(bank.path):
            write_card(bank)
    finally:
        lock.release()
    return found


def _certify(bank: Bank, seconds: float, jobs: int, force: bool) -> Certification:
    record = {name: value for name, value in bank.record.items() if name != "num_scenes"}
    models, num_new, shake = models_of(bank), 0, [np.zeros(0)]
    stored = StoredBlocks.of(bank.path)
    with Progress("certifying", bank.num_scenes, "scene") as progress:
        for number in stored.places:
            rows = stored.read(number)
            if force or not is_fully_certified(rows):
                rows = certified(rows, models, seconds, jobs)
                write_rows(bank.path, number, rows, record)
                num_new += rows.num_rows
            shake.append(np.array(rows["shake"].drop_null()))
            progress.update(rows.num_rows)
    merge_shards(bank.path, record)
    scores = np.concatenate(shake)
    if not len(scores):
        raise BankError(f"{bank.path}: no scene in it stands", hint="more scenes")
    return Certification(scores, num_new)


def models_of(bank: Bank) -> SceneModels:
    """Plain MuJoCo models of the bank's scenes, from its own assets and settings."""
    recipe, asset_of = bank.record["recipe"], lru_cache(maxsize=None)(bank.object)
    names = recipe.get("names")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise BankError(f"{bank.path}: its record does not name the objects of its world")
    stability = config_of(StabilityConfig, recipe.get("stability", {}), bank.path)
    contact = config_of(ContactConfig, recipe.get("contact", {}), bank.path)
    world = make_world([asset_of(base_name(name)) for name in names], bank.support, stability, contact)
    return SceneModels(world, stability, contact)


def certified(rows: pa.Table, models: SceneModels, seconds: float, jobs: int) -> pa.Table:
    """The rows with the columns of `CERTIFICATE`."""
    rows = rows.select([*SCHEMA.names, *CLUTTER.names])
    scenes = rows.select(["is_success", "object_index", "is_placed", "poses"]).to_pylist()
    results: list[dict[str, Any]] = [dict.fromkeys(CERTIFICATE.names) for _ in scenes]
    good = [place for place, scene in enumerate(scenes) if scene["is_success"]]
    if good:
        poses, is_placed = _by_object([scenes[place] for place in good], models.world.num_objects)
        found = certificates(models, poses, is_placed, seconds, num_threads=jobs)
        for place, each in zip(good, found, strict=True):
            margins = [each["margins"][k] for k in scenes[place]["object_index"]]
            results[place] = {_RENAMED.get(name, name): value for name, value in each.items()}
            results[place]["margins"] = margins
    extra = pa.Table.from_pylist(results, schema=CERTIFICATE)
    for field in CERTIFICATE:
        rows = rows.append_column(field, extra[field.name])
    return rows


def _by_object(scenes: list[dict[str, Any]], num_objects: int) -> tuple[np.ndarray, np.ndarray]:
    """f64[N, K, 7] and bool[N, K] of rows whose slots may be of different numbers."""
    most = max(len(scene["object_index"]) for scene in scenes)
    index = np.full((len(scenes), most), -1)
    placed = np.zeros((len(scenes), most), bool)
    poses = np.tile(np.eye(7)[3], (len(scenes), most, 1))
    for row, scene in enumerate(scenes):
        count = len(scene["object_index"])
        index[row, :count], placed[row, :count] = scene["object_index"], scene["is_placed"]
        poses[row, :count] = np.array(scene["poses"]).reshape(-1, 7)
    if index.max() >= num_objects:
        raise BankError(
            "a scene names an object that the bank's record does not", hint="the bank's own bank.json"
        )
    return by_object(index, placed, poses, num_objects)[:2]
