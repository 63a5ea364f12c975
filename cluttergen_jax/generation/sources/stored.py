"""Scenes on disk: those of a bank, and one in an MJCF file."""

from __future__ import annotations

from functools import cached_property, lru_cache
from itertools import compress
from pathlib import Path

import numpy as np

from cluttergen_jax.assets.support import Rectangle, recorded_rectangle
from cluttergen_jax.errors import BankError, ClutterGenError
from cluttergen_jax.generation.sources.replay import ReplayContext, replay, replay_context_of
from cluttergen_jax.placement.rollout.replay import Replay
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank import Bank, read_bank
from cluttergen_jax.scene.mjcf_file import read_mjcf_scene_with_notes


class BankSource:
    """The scenes of a bank, failures included.

    Attributes:
      numbers, successes: of all its scenes, and of those that stand.

    Raises:
      BankError: there is no such bank, or it holds no scenes.
    """

    def __init__(self, path: Path) -> None:
        self.bank: Bank = read_bank(path)
        self.name = self.bank.path.resolve().name
        known = [rows.to_pydict() for rows in self.bank.tables(["index", "is_success"])]
        self.numbers: tuple[int, ...] = tuple(number for rows in known for number in rows["index"])
        self.successes: tuple[int, ...] = tuple(
            number for rows in known for number in compress(rows["index"], rows["is_success"])
        )
        if not self.numbers:
            raise BankError(f"{path} holds no scenes", "a bank of at least one", "cluttergen generate")
        self._object = lru_cache(maxsize=None)(self.bank.object)

    @property
    def methods(self) -> tuple[str, ...]:
        """Of new scenes on the same support with the same objects."""
        try:
            return self._context.methods
        except ClutterGenError:
            return ()

    def notice(self, method: str | None = None) -> str:
        """See `SceneSource`. Stored scenes come at once."""
        return self._context.notice(method) if method else ""

    def still(self, number: int) -> Replay:
        """See `SceneSource`.

        Raises:
          BankError: there is no such scene.
        """
        row = self.bank.rows([number]).get(number)
        if row is None:
            raise BankError(f"{self.name} has no scene {number}", f"{self.numbers[0]} to {self.numbers[-1]}")
        return Replay(
            title=f"{self.name}, scene {number}",
            objects=tuple(self._object(base_name(name)) for name in row.objects),
            names=row.objects,
            poses=row.poses,
            support=self.bank.support,
            region=self._region,
            is_placed=np.ones(len(row.objects), bool),
            is_success=row.is_success,
            verdict=row.verdict,
            drift=row.drift,
        )

    def recorded(self, number: int, num_proposals: int = 0) -> Replay:
        """See `SceneSource`.

        Raises:
          BankError: there is no such scene, or its attempts cannot be made again.
          PoolError: the bank's checkpoint is gone.
        """
        return replay(self.bank, self._context, number, self.still(number), num_proposals)

    def sample(self, method: str, seed: int, num_proposals: int = 0) -> Replay:
        """See `SceneSource`."""
        title = f"{method}, seed {seed}"
        return self._context.record(method, seed, 0, title, num_proposals=num_proposals)

    @cached_property
    def _context(self) -> ReplayContext:
        return replay_context_of(self.bank)

    @cached_property
    def _region(self) -> Rectangle:
        """The queried region that the recipe names; the support's own in banks that name none."""
        region = (self.bank.record.get("recipe") or {}).get("region")
        return recorded_rectangle(region) if region else self.bank.support.region


class FileSource:
    """One scene from an MJCF file that is no part of a bank.

    Raises:
      AssetError: MuJoCo cannot read it.
    """

    def __init__(self, path: Path) -> None:
        self.name = path.stem
        self.numbers: tuple[int, ...] = (0,)
        self.methods: tuple[str, ...] = ()
        scene, self.notes = read_mjcf_scene_with_notes(path)
        self._still = Replay(
            title=self.name,
            objects=scene.objects,
            names=scene.names,
            support=scene.support,
            region=scene.support.region,
            poses=scene.poses.astype(np.float32),
            is_placed=np.ones(len(scene.names), bool),
            is_success=True,
            verdict="not judged",
        )

    def notice(self, method: str | None = None) -> str:
        """See `SceneSource`."""
        return ""

    def still(self, number: int) -> Replay:
        """See `SceneSource`."""
        return self._still

    def recorded(self, number: int, num_proposals: int = 0) -> Replay:
        """Refused: a scene file does not tell how it was made.

        Raises:
          BankError: always.
        """
        raise BankError(
            f"{self.name}: a scene file does not tell how it was made",
            "a scene of a bank, BANK:INDEX or BANK/scenes/NUMBER.xml",
        )

    def sample(self, method: str, seed: int, num_proposals: int = 0) -> Replay:
        """See `recorded`."""
        return self.recorded(seed)
