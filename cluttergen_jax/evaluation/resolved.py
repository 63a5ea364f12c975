"""What a trial's names stand for (assets, a policy) and the key of its row, each found once."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import Pool, find_pool
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.evaluation.checkpoints import Checkpoints
from cluttergen_jax.evaluation.machine import versions
from cluttergen_jax.evaluation.trial import Trial, key_of
from cluttergen_jax.learning.methods import checkpoint_hash
from cluttergen_jax.learning.ppo.checkpoint import read_record


@dataclass(frozen=True, eq=False)
class ResolvedTrial:
    """A trial with everything that it names.

    Attributes:
      checkpoint: the policy's folder; None for a baseline. policy_record: how it was trained.
      sources: hashes of what the trial names, and versions: all that decides its row beside the trial.
      key: of its row (`trial.key_of`).
    """

    trial: Trial
    pool: Pool
    support: SupportAsset
    checkpoint: Path | None
    policy_record: dict[str, Any] | None
    sources: dict[str, Any]
    key: str

    @cached_property
    def region(self) -> Rectangle:
        """The queried region before any change."""
        own, sides = self.support.region, self.trial.region
        return own if sides is None else Rectangle(own.center, (sides[0] / 2, sides[1] / 2), own.yaw)

    @property
    def is_cut(self) -> bool:
        """Whether attempts end as soon as they are decided: baselines' do, a policy's as in its training."""
        return (self.policy_record or {}).get("stability", {}).get("stop_when_decided", True)

    @property
    def policy(self) -> dict[str, Any] | None:
        """What a row says of how its policy was trained; None for a baseline."""
        record = self.policy_record
        if record is None:
            return None
        known = {name: record[name] for name in ("variant", "preset", "seed", "attempts") if name in record}
        head = record["network"].get("head") if "network" in record else None
        return known | {"max_attempts": record["placement"]["max_attempts"], "head": head}


class Resolver:
    """Finds what trials name.

    Args:
      engine: which is written among a row's sources.
    """

    def __init__(self, checkpoints: Checkpoints, engine: str) -> None:
        self.checkpoints, self._engine = checkpoints, engine
        self._pool = lru_cache(maxsize=None)(find_pool)
        self._support = lru_cache(maxsize=None)(find_support)
        self._resolved: dict[Trial, ResolvedTrial] = {}

    def resolve(self, trial: Trial) -> ResolvedTrial:
        """The trial with what it names.

        Raises:
          PoolError: there is no such pool or support.
          ConfigError: there is no such method.
          MissingCheckpointError: its policy has not been trained.
        """
        if trial not in self._resolved:
            self._resolved[trial] = self._resolve(trial)
        return self._resolved[trial]

    def _resolve(self, trial: Trial) -> ResolvedTrial:
        pool, support = self._pool(trial.pool), self._support(trial.support)
        checkpoint = self.checkpoints.find(trial)
        sources = {
            "pool": pool.hash,
            "support": _support_hash(support),
            "checkpoint": checkpoint and checkpoint_hash(checkpoint),
            "engine": self._engine,
            "versions": versions(),
        }
        record = None if checkpoint is None else read_record(checkpoint)
        return ResolvedTrial(trial, pool, support, checkpoint, record, sources, key_of(trial, sources))


def _support_hash(support: SupportAsset) -> str:
    """Of what physics knows of a support: its looks, unlike in `support_file.support_hash`, change no row."""
    facts = {
        "boxes": [asdict(box) for box in support.boxes],
        "top": support.top,
        "region": asdict(support.region),
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
