"""Scenes that are sampled when they are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cluttergen_jax.config import Method
from cluttergen_jax.generation import make_sampler
from cluttergen_jax.generation.sources.replay import ReplayContext
from cluttergen_jax.learning.methods import checkpoint_of
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.placement.rollout.replay import Replay
from cluttergen_jax.placement.setup import Setup

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
        record = {} if given is None else given.record
        placement = record.get("placement", {})
        pool = config.pool or record.get("pool", "dining")
        method = config.method or record.get("variant", "drop")
        found = checkpoint_of(method, pool, given)
        sampler = make_sampler(
            pool=pool,
            support=config.support or record.get("support", "table"),
            num_objects=config.num_objects or placement.get("num_objects"),
            method=method,
            checkpoint=None if found is None else found.path,
            max_attempts=placement.get("max_attempts", 5),
        )
        trained = {} if found is None else {method: found}
        self._context = ReplayContext(Setup(sampler.problem, sampler.keep_out, sampler.start), trained)
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

    def replay(self, number: int, num_proposals: int = 0) -> Replay:
        """See `still`."""
        return self.sample(self.methods[0], number, num_proposals)

    def sample(self, method: str, seed: int, num_proposals: int = 0) -> Replay:
        """See `SceneSource`."""
        title = f"{method}, seed {seed}"
        return self._context.record(method, seed, 0, title, num_proposals=num_proposals)
