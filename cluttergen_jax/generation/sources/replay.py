"""The problem behind a bank, set up once more: to see its attempts again, and to sample new scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from cluttergen_jax.assets.pool import StoredObjects, find_pool
from cluttergen_jax.assets.support import Rectangle, recorded_rectangle
from cluttergen_jax.config import UNPROPOSED
from cluttergen_jax.errors import BankError
from cluttergen_jax.generation.recipe import problem_of_recipe
from cluttergen_jax.learning.methods import Method, choose_method, sampler_of
from cluttergen_jax.learning.policies.checkpoint import Checkpoint
from cluttergen_jax.placement.methods.table import BASELINES, entry_of
from cluttergen_jax.placement.problem import ProblemConfig, Setup, Standing, make_setup
from cluttergen_jax.placement.replay import Replay
from cluttergen_jax.placement.rollout import BLOCK_SIZE, EpisodeRecorder
from cluttergen_jax.placement.shelves import Shelves
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.cut import number_of_seed
from cluttergen_jax.scene.bank.scene import read_start
from cluttergen_jax.spec import recorded_method

COMPILING = "compiling where it was not compiled before, which takes about a minute"


@dataclass(frozen=True, eq=False)
class ReplayContext:
    """A problem ready to be worked on by any method.

    Attributes:
      setup: the compiled world, and how episodes begin; or shelves, of which each block of scenes has one.
      checkpoints: of trained methods, by the method's name.
    """

    setup: Setup | Shelves
    checkpoints: dict[str, Checkpoint] = field(default_factory=dict)
    _made: dict[tuple[str, int], EpisodeRecorder] = field(default_factory=dict)

    @property
    def methods(self) -> tuple[str, ...]:
        """What can be asked of it: trained methods first."""
        return (*self.checkpoints, *BASELINES)

    def notice(self, method: str) -> str:
        """What to say while a scene by `method` is made: the first is compiled."""
        return "" if any(method == name for name, _ in self._made) else COMPILING

    def record(
        self,
        method: str,
        seed: int,
        index: int,
        title: str,
        width: int = 1,
        num_proposals: int = 0,
        last_only: bool = False,
    ) -> Replay:
        """Scene number `index` of `seed`, with its attempts; see `EpisodeRecorder.record`."""
        known = self._made.get((method, width))
        asked = Method(method, self.checkpoints.get(method))
        if isinstance(self.setup, Shelves):
            setup = self.setup.block(seed, index // BLOCK_SIZE)
            rollouts = {} if known is None else known.rollouts
            known = EpisodeRecorder(
                sampler_of(setup, asked), setup.problem.world, width, False, rollouts
            )
        elif known is None:
            known = EpisodeRecorder(sampler_of(self.setup, asked), self.setup.problem.world, width)
        self._made[method, width] = known
        return known.record(seed, index, title, num_proposals, last_only)


def replay_context_of(bank: Bank) -> ReplayContext:
    """The problem that a bank's scenes solve, from the bank's own assets.

    Raises:
      BankError: the bank does not say how it was made, or the bank that it started from is gone.
      PoolError: its checkpoint is gone.
      ConfigError: there is no such method.
    """
    setup = shelves_of(bank) if bank.recipe.get("shelf") else setup_of(bank)
    recipe = bank.recipe
    try:
        method = recorded_method(recipe)
        pool = recipe["pool"]
        checkpoint = recipe.get("checkpoint")
    except KeyError as error:
        raise _not_recorded(bank, error) from error
    trained = None if method is None else choose_method(method, pool, checkpoint).checkpoint
    known = {} if method is None or trained is None else {method: trained}
    return ReplayContext(setup, known)


def setup_of(bank: Bank, **changes: Any) -> Setup:
    """The setup that a bank's scenes were made in, from the bank's own assets, whatever placed them.

    Args:
      changes: fields of `ProblemConfig` that are to be others.

    Raises:
      BankError: the bank does not say how it was made, or the bank that it started from is gone.
    """
    names, config, keep_out, standing = _read_request(bank)
    if config.shelf:
        # All objects that its scenes have, in one world.
        names = bank.object_names
        config = replace(config, shelf=0, weights=(), balance="")
    num_placed = len(names) - (len(standing[0]) if standing else 0)
    objects = [bank.object(base_name(name)) for name in names[:num_placed]]
    return make_setup(replace(config, **changes), keep_out, standing, (objects, bank.open_support))


def shelves_of(bank: Bank) -> Shelves:
    """What the blocks of a bank drew their objects from. Those that no scene has are not in the bank.

    Raises:
      BankError: the bank does not say how it was made.
      PoolError: its pool is gone, or has lost objects that could be drawn.
    """
    names, config, keep_out, _ = _read_request(bank)
    pool = find_pool(config.pool).select(names)
    readers = {
        name: partial(bank.object, name)
        if name in bank.assets["objects"]
        else partial(pool.__getitem__, name)
        for name in names
    }
    known = {each.name: each for each in pool.facts}
    return Shelves(
        replace(pool, objects=StoredObjects(readers, known)), config, bank.open_support, keep_out
    )


def _read_request(
    bank: Bank,
) -> tuple[Sequence[str], ProblemConfig, list[Rectangle], Standing | None]:
    """Of a bank: names of the objects, the problem, boxes to keep out of, and what stands there already."""
    recipe = bank.recipe
    try:
        names: Sequence[str] = recipe["names"]
        config = problem_of_recipe(recipe, bank.path)
        keep_out = [recorded_rectangle(entry) for entry in recipe.get("keep_out", ())]
    except (KeyError, TypeError, ValueError) as error:
        raise _not_recorded(bank, error) from error
    return names, config, keep_out, read_start(recipe.get("start"))


def _not_recorded(bank: Bank, error: Exception) -> BankError:
    return BankError(f"{bank.path}: how it was made is not recorded whole ({error})")


def replay(
    bank: Bank,
    context: ReplayContext,
    index: int,
    stored: Replay,
    num_proposals: int = 0,
    last_only: bool = False,
) -> Replay:
    """Scene number `index` of a bank with its attempts, made once more; see `EpisodeRecorder.record`.

    Raises:
      BankError: a person made it, or it was made at once; or made again it ends elsewhere: other versions,
        another machine, changed assets.
    """
    recipe = bank.recipe
    if entry_of(recipe["method"]).is_whole:
        raise BankError(
            f"{stored.title} was made at once by method {recipe['method']!r}",
            "attempts of scenes that are placed object by object",
            "the scene itself",
        )
    if recipe["method"] in UNPROPOSED:
        raise BankError(
            f"{stored.title} was made by {recipe['method']}: its attempts cannot be made again",
            "attempts of scenes that a method made",
            "the scene itself",
        )
    width = int(recipe.get("block_size", BLOCK_SIZE))
    method = recorded_method(recipe)
    assert method is not None
    seed = int(recipe["seed"])
    number = number_of_seed(recipe, index)
    recording = context.record(method, seed, number, stored.title, width, num_proposals, last_only)
    if not _equal(recording, stored):
        made = ", ".join(f"{name} {number}" for name, number in recipe.get("versions", {}).items())
        raise BankError(
            f"{stored.title}: made again, it ends elsewhere than the stored scene (made with {made})",
            "the machine and the versions that made the bank, for banks that are to be replayed",
            "the stored scene itself, which is unharmed",
        )
    return recording


def _equal(recording: Replay, stored: Replay) -> bool:
    ends = {recording.names[i]: recording.poses[i] for i in recording.placed}
    kept = {stored.names[i]: stored.poses[i] for i in stored.placed}
    return set(ends) == set(kept) and all(np.array_equal(ends[name], kept[name]) for name in kept)
