"""Where scenes to look at come from: banks, MJCF files, scenes in memory, methods that make them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.support import Rectangle, recorded_rectangle
from cluttergen_jax.config import Method
from cluttergen_jax.errors import BankError, ClutterGenError, ConfigError, PoolError
from cluttergen_jax.generation import make_sampler
from cluttergen_jax.generation.sources.replay import ReplayContext, replay, replay_context_of
from cluttergen_jax.learning import checkpoint_of
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.placement import Replay, Setup
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.rendering.viewer.source import SceneSource
from cluttergen_jax.scene import Bank, Scene, read_bank
from cluttergen_jax.scene.bank.bank import INDEX
from cluttergen_jax.scene.bank.scene import parse_reference


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
            raise BankError(
                f"{path} holds no scenes", "a bank of at least one", "cluttergen generate"
            )
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
        """See `SceneSource`; BankError where there is no such scene."""
        row = self.bank.rows([number]).get(number)
        if row is None:
            raise BankError(
                f"{self.name} has no scene {number}", f"{self.numbers[0]} to {self.numbers[-1]}"
            )
        return Replay(
            title=f"{self.name}, scene {number}",
            objects=tuple(self._object(base_name(name)) for name in row.objects),
            names=row.objects,
            poses=row.poses,
            support=self.bank.support_of(row),
            region=self._region,
            is_placed=np.ones(len(row.objects), bool),
            is_success=row.is_success,
            verdict=row.verdict,
            drift=row.drift,
            seat=self.bank.seat,
        )

    def replay(self, number: int, num_proposals: int = 0, last_only: bool = False) -> Replay:
        """See `SceneSource`.

        Raises:
          BankError: there is no such scene, or its attempts cannot be made again.
          PoolError: the bank's checkpoint is gone.
        """
        return replay(
            self.bank, self._context, number, self.still(number), num_proposals, last_only
        )

    def sample(
        self, method: str, seed: int, num_proposals: int = 0, last_only: bool = False
    ) -> Replay:
        """See `SceneSource`."""
        title = f"{method}, seed {seed}"
        return self._context.record(
            method, seed, 0, title, num_proposals=num_proposals, last_only=last_only
        )

    @cached_property
    def _context(self) -> ReplayContext:
        return replay_context_of(self.bank)

    @cached_property
    def _region(self) -> Rectangle:
        """The queried region that the recipe names; the support's own in banks that name none."""
        region = (self.bank.record.get("recipe") or {}).get("region")
        return recorded_rectangle(region) if region else self.bank.support.region


class ScenesSource:
    """Scenes in memory, without the attempts that led to them.

    Args:
      name: what to call them all.
      scenes: by number, in order; at least one.
    """

    _is_a = "a `Scene`"

    def __init__(self, name: str, scenes: Mapping[int, Scene]) -> None:
        self.name = name
        self.scenes = dict(scenes)
        self.numbers: tuple[int, ...] = tuple(self.scenes)
        self.methods: tuple[str, ...] = ()

    def notice(self, method: str | None = None) -> str:
        """See `SceneSource`."""
        return ""

    def still(self, number: int) -> Replay:
        """See `SceneSource`."""
        scene = self.scenes[number]
        origin = scene.origin
        return Replay(
            title=self.name if len(self.scenes) == 1 else f"{self.name}, scene {number}",
            objects=scene.objects,
            names=scene.names,
            support=scene.support,
            region=scene.region or scene.support.region,
            poses=scene.poses.astype(np.float32),
            is_placed=np.ones(len(scene.names), bool),
            is_success=origin.is_success is not False,
            verdict=origin.verdict or "not judged",
            drift=origin.drift or 0.0,
            seat=scene.seat,
        )

    def replay(self, number: int, num_proposals: int = 0, last_only: bool = False) -> Replay:
        """Refused: such a scene does not tell how it was made (BankError)."""
        raise BankError(
            f"{self.name}: {self._is_a} does not tell how it was made",
            "a scene of a bank, BANK:INDEX or BANK/scenes/NUMBER.xml",
        )

    def sample(
        self, method: str, seed: int, num_proposals: int = 0, last_only: bool = False
    ) -> Replay:
        """See `replay`."""
        return self.replay(seed)


class FileSource(ScenesSource):
    """One scene from an MJCF file that is no part of a bank.

    Attributes:
      notes: what its picture leaves out.

    Raises:
      AssetError: MuJoCo cannot read it.
    """

    _is_a = "a scene file"

    def __init__(self, path: Path) -> None:
        # Readers of files load what no bank needs.
        from cluttergen_jax.scene.mjcf_file import read_mjcf_scene_with_notes

        scene, self.notes = read_mjcf_scene_with_notes(path)
        super().__init__(path.stem, {0: scene})


_MOST = 2**31 - 1
"""Numbers of scenes are seeds."""


@dataclass(frozen=True)
class LiveConfig:
    """What to sample from where no bank says it.

    Attributes:
      pool: a pool's name or folder; a checkpoint's own if one is given.
      method: as `generate` takes it; the checkpoint's own, else drop.
      num_objects: all of the pool's (40 at most) if not given.
      support: a support's name or folder.
    """

    pool: str | None = None
    method: Method | None = None
    num_objects: int | None = None
    support: str | None = None


class LiveSource:
    """No stored scenes: each is sampled when it is asked for.

    Raises:
      PoolError: the checkpoint, the pool or the support cannot be found or read.
      ConfigError: there is no such method, or the checkpoint is of another.
    """

    def __init__(self, config: LiveConfig, checkpoint: Path | None = None) -> None:
        given = None if checkpoint is None else read_checkpoint(checkpoint)
        known = None if given is None else given.trained
        pool = config.pool or (known and known.pool) or "dining"
        method: Any = config.method or (known and known.variant) or "drop"
        found = checkpoint_of(method, pool, given)
        sampler = make_sampler(
            pool=pool,
            support=config.support or (known and known.support) or "table",
            num_objects=config.num_objects or (known.placement.num_objects if known else None),
            method=method,
            checkpoint=None if found is None else found.path,
            max_attempts=known.placement.max_attempts if known else 5,
        )
        trained = {} if found is None else {method: found}
        self._context = ReplayContext(
            Setup(sampler.problem, sampler.keep_out, sampler.start), trained
        )
        self.name = pool if checkpoint is None else f"{method} of {checkpoint.resolve().name}"
        self.numbers = range(_MOST)
        first = (method,) if method in self._context.methods else ()
        self.methods = (*first, *(each for each in self._context.methods if each not in first))

    def notice(self, method: str | None = None) -> str:
        """See `SceneSource`."""
        return self._context.notice(method or self.methods[0])

    def still(self, number: int) -> Replay:
        """Scene 0 of seed `number`, by the method asked for."""
        return self.replay(number)

    def replay(self, number: int, num_proposals: int = 0, last_only: bool = False) -> Replay:
        """See `still`."""
        return self.sample(self.methods[0], number, num_proposals, last_only)

    def sample(
        self, method: str, seed: int, num_proposals: int = 0, last_only: bool = False
    ) -> Replay:
        """See `SceneSource`."""
        title = f"{method}, seed {seed}"
        return self._context.record(
            method, seed, 0, title, num_proposals=num_proposals, last_only=last_only
        )


def open_source(
    given: str | Bank | Scene | Sequence[Scene] | None, config: LiveConfig | None = None
) -> tuple[SceneSource, int | None]:
    """What an argument names or is, and the scene that it asks for.

    Args:
      given: BANK, BANK:INDEX, BANK/scenes/NUMBER.xml, another MJCF file, a checkpoint's folder or its run's;
        a bank; a scene, or several; None for live sampling alone.

    Raises:
      PoolError: there is nothing of the kind.
      ConfigError: it is of no such kind, or there are no scenes.
    """
    config = config or LiveConfig()
    if given is None:
        return LiveSource(config), None
    if isinstance(given, Bank):
        return BankSource(given.path), None
    if isinstance(given, Scene):
        origin = given.origin
        name = f"{origin.bank}-{origin.index:06d}" if origin.bank else origin.pool or "scene"
        return ScenesSource(name, {origin.index: given}), origin.index
    if not isinstance(given, str):
        return ScenesSource("scenes", dict(enumerate(_checked_scenes(given)))), None
    text = given
    path = Path(text)
    named = parse_reference(text)
    if named is None:
        return FileSource(path), 0
    bank, index = named
    if index is not None or (bank / INDEX).is_file():
        return BankSource(bank), index
    for folder in (path, path / "best", path / "policy"):
        if (folder / "weights.npz").is_file():
            return LiveSource(config, folder), None
    if (path / "scene.xml").is_file():
        return FileSource(path / "scene.xml"), 0
    raise PoolError(
        f"{text} is no bank, no scene and no checkpoint",
        "BANK, BANK:INDEX, an MJCF file, or the folder of a checkpoint",
        "cluttergen generate --out out, then the same command with out",
    )


def _checked_scenes(given: Any) -> list[Scene]:
    """Scenes that were given as values (ConfigError: they are none)."""
    allowed = "a bank, a `Scene`, several, or a text that names one"
    if hasattr(given, "is_success"):
        hint = "`sampler.scene(sampled)`, which makes a `Scene` of what a sampler drew"
        raise ConfigError(f"scenes of {type(given).__name__}", allowed, hint)
    if not isinstance(given, Iterable):
        raise ConfigError(f"scenes of {type(given).__name__}", allowed)
    scenes = list(given)
    if wrong := [each for each in scenes if not isinstance(each, Scene)]:
        raise ConfigError(f"a {type(wrong[0]).__name__} among scenes", allowed)
    if not scenes:
        raise ConfigError("no scenes", allowed)
    return scenes
