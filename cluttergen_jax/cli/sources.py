"""What `view` and `render` are given: a bank, a scene of one, a scene file, a checkpoint, or names alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from cluttergen_jax.agent.checkpoint import read_record
from cluttergen_jax.assets.readers.mjcf_scene import read_mjcf_scene
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.bank.bank import Bank, read_bank
from cluttergen_jax.cli.remake import Workshop, remade, workshop_of
from cluttergen_jax.errors import BankError, ClutterGenError, PoolError
from cluttergen_jax.methods import checkpoint_of
from cluttergen_jax.placement.recording import Recording, still
from cluttergen_jax.sampler import make_sampler
from cluttergen_jax.viewer.source import Source
from cluttergen_jax.world import base_name

_MOST = 2**31 - 1
"""Numbers of scenes that are made when they are asked for: they are seeds."""


class BankSource:
    """The scenes of a bank, failures included.

    Raises:
      BankError: there is no such bank, or it holds no scenes.
    """

    def __init__(self, path: Path) -> None:
        self.bank: Bank = read_bank(path)
        self.name = self.bank.path.resolve().name
        self._place = {int(index): place for place, index in enumerate(self.bank.table["index"].to_numpy())}
        if not self._place:
            raise BankError(f"{path} holds no scenes", "a bank of at least one", "cluttergen generate")
        self._object = lru_cache(maxsize=None)(self.bank.object)

    @property
    def numbers(self) -> tuple[int, ...]:
        """All scenes of the bank."""
        return tuple(self._place)

    @cached_property
    def successes(self) -> tuple[int, ...]:
        """The scenes that stand."""
        is_success = self.bank.table["is_success"].to_numpy(zero_copy_only=False)
        return tuple(np.array(self.numbers)[is_success].tolist())

    @property
    def methods(self) -> tuple[str, ...]:
        """Of new scenes on the same support with the same objects."""
        try:
            return self._workshop.methods
        except ClutterGenError:
            return ()

    def still(self, number: int) -> Recording:
        """See `Source`.

        Raises:
          BankError: there is no such scene.
        """
        if number not in self._place:
            raise BankError(f"{self.name} has no scene {number}", f"{min(self._place)} to {max(self._place)}")
        row = self.bank.table.slice(self._place[number], 1).to_pylist()[0]
        placed = np.array(row["is_placed"], bool)
        names = [name for name, is_there in zip(row["objects"], placed, strict=True) if is_there]
        return still(
            title=f"{self.name}, scene {number}",
            objects=[self._object(base_name(name)) for name in names],
            names=names,
            poses=np.array(row["poses"], np.float32).reshape(-1, 7)[placed],
            support=self.bank.support,
            region=self._region,
            is_success=row["is_success"],
            verdict=row["verdict"],
            drift=row["drift"],
        )

    def recorded(self, number: int) -> Recording:
        """See `Source`.

        Raises:
          BankError: there is no such scene, or its attempts cannot be made again.
          PoolError: the bank's checkpoint is gone.
        """
        return remade(self.bank, self._workshop, number, self.still(number))

    def sample(self, method: str, seed: int) -> Recording:
        """See `Source`."""
        return self._workshop.recorder(method).record(seed, 0, f"{method}, seed {seed}")

    @cached_property
    def _workshop(self) -> Workshop:
        return workshop_of(self.bank)

    @cached_property
    def _region(self) -> Rectangle:
        """The queried region that the recipe names; the support's own in banks that name none."""
        region = (self.bank.record.get("recipe") or {}).get("region")
        if not region:
            return self.bank.support.region
        return Rectangle(tuple(region["center"]), tuple(region["half_extents"]), float(region["yaw"]))


class FileSource:
    """One scene from an MJCF file that is no part of a bank.

    Raises:
      AssetError: MuJoCo cannot read it.
    """

    def __init__(self, path: Path) -> None:
        self.name = path.stem
        self.numbers: tuple[int, ...] = (0,)
        self.methods: tuple[str, ...] = ()
        scene = read_mjcf_scene(path)
        self._still = still(
            self.name,
            scene.objects,
            scene.names,
            scene.poses,
            scene.support,
            scene.support.region,
            verdict="not judged",
        )

    def still(self, number: int) -> Recording:
        """See `Source`."""
        return self._still

    def recorded(self, number: int) -> Recording:
        """How a file's scene came about, nobody knows.

        Raises:
          BankError: always.
        """
        raise BankError(
            f"{self.name}: a scene file does not tell how it was made",
            "a scene of a bank, BANK:INDEX or BANK/scenes/NUMBER.xml",
        )

    def sample(self, method: str, seed: int) -> Recording:
        """See `recorded`."""
        return self.recorded(seed)


@dataclass(frozen=True)
class LiveConfig:
    """What to sample from where no bank says it.

    Attributes:
      pool: a pool's name or folder; a checkpoint's own if one is given.
      method: random, clear, drop, or a trained policy; the checkpoint's own, else drop.
      num_objects: all of the pool's (40 at most) if not given.
      support: a support's name or folder.
    """

    pool: str | None = None
    method: str | None = None
    num_objects: int | None = None
    support: str | None = None


class LiveSource:
    """No stored scenes: each is sampled when it is asked for.

    Raises:
      PoolError: the checkpoint, the pool or the support cannot be found or read.
      ConfigError: there is no such method, or the checkpoint is of another.
    """

    def __init__(self, config: LiveConfig, checkpoint: Path | None = None) -> None:
        record = {} if checkpoint is None else read_record(checkpoint)
        placement = record.get("placement", {})
        pool = config.pool or record.get("pool", "dining")
        method = config.method or record.get("variant", "drop")
        path = checkpoint_of(method, pool, None if checkpoint is None else str(checkpoint))
        sampler = make_sampler(
            pool=pool,
            support=config.support or record.get("support", "table"),
            num_objects=config.num_objects or placement.get("num_objects"),
            method=method,
            checkpoint=path,
            max_attempts=placement.get("max_attempts", 5),
        )
        trained = {} if path is None else {method: path}
        self._workshop = Workshop(sampler.problem, sampler.keep_out, sampler.start, trained)
        self.name = pool if checkpoint is None else f"{method} of {checkpoint.resolve().name}"
        self.numbers = range(_MOST)
        first = (method,) if method in self._workshop.methods else ()
        self.methods = (*first, *(each for each in self._workshop.methods if each not in first))

    def still(self, number: int) -> Recording:
        """Scene 0 of seed `number`, by the method asked for."""
        return self.sample(self.methods[0], number)

    recorded = still

    def sample(self, method: str, seed: int) -> Recording:
        """See `Source`."""
        return self._workshop.recorder(method).record(seed, 0, f"{method}, seed {seed}")


def open_source(text: str | None, config: LiveConfig | None = None) -> tuple[Source, int | None]:
    """What an argument names, and the scene that it asks for.

    Args:
      text: BANK, BANK:INDEX, BANK/scenes/NUMBER.xml, another MJCF file, a checkpoint's folder or its run's;
        None for live sampling alone.

    Raises:
      PoolError: there is nothing of the kind.
    """
    config = config or LiveConfig()
    if text is None:
        return LiveSource(config), None
    path = Path(text)
    head, colon, number = text.rpartition(":")
    if colon and number.isdigit() and not path.exists():
        return BankSource(Path(head)), int(number)
    if path.is_file():
        bank = path.parent.parent
        if path.parent.name == "scenes" and path.stem.isdigit() and (bank / "bank.json").is_file():
            return BankSource(bank), int(path.stem)
        return FileSource(path), 0
    if (path / "bank.json").is_file():
        return BankSource(path), None
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
