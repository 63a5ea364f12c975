"""Methods by name: geometric baselines, and trained policies from checkpoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from cluttergen_jax.assets.pool import without_exclusions
from cluttergen_jax.config import no_such
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.policies.checkpoint import Checkpoint, read_checkpoint
from cluttergen_jax.learning.policies.embedded import find_policy, list_policies
from cluttergen_jax.learning.policies.guided import KIND, load_guided
from cluttergen_jax.learning.policies.policy import load_policy
from cluttergen_jax.placement import KeepOut, PlacementConfig, Proposer, Rules, Setup, Start
from cluttergen_jax.placement.methods.table import (
    BASELINES,
    LEARNED,
    METHODS,
    entry_of,
    episodes_of,
    find_method,
    make_proposer,
)
from cluttergen_jax.placement.rollout import BlockSampler

# What a user gets unasked; the second where no checkpoint of the first is embedded.
DEFAULT_METHOD = "guided"
FALLBACK_METHOD = "spread"


class Method(NamedTuple):
    """A method by name (of a user's own an `OwnMethod`), and the checkpoint behind it; None without one."""

    name: str
    checkpoint: Checkpoint | None = None


def choose_method(method: Any, pool: str, checkpoint: str | Path | None = None) -> Method:
    """The method of that name, or the one to take if none is named; records are read once.

    Args:
      method: as `find_method` takes it. None takes the given checkpoint's own; without one `guided`, or
        `spread` where no checkpoint of `guided` is embedded.
      checkpoint: a policy's folder; the embedded one if None.

    Raises:
      ConfigError: there is no such method, or the given checkpoint is of another.
      PoolError: no checkpoint is embedded for it, or there is none in the given folder.
    """
    if method is not None:
        method = find_method(method)
    given = None if checkpoint is None else read_checkpoint(Path(checkpoint))
    if method is None:
        method = _default() if given is None else given.variant or "policy"
    return Method(method, checkpoint_of(method, pool, given))


def _default() -> str:
    return DEFAULT_METHOD if DEFAULT_METHOD in list_policies() else FALLBACK_METHOD


def methods_of(pool: str) -> tuple[str, ...]:
    """What is compared unasked: the baselines, and what was learned where it is embedded for the pool."""
    embedded = list_policies()
    learned = {"policy": f"{without_exclusions(pool)}-policy", DEFAULT_METHOD: DEFAULT_METHOD}
    return (*BASELINES, *(method for method, name in learned.items() if name in embedded))


def checkpoint_of(method: str, pool: str, given: Checkpoint | None = None) -> Checkpoint | None:
    """The checkpoint behind a method; None for a baseline.

    Args:
      given: the one to take; the embedded one for the pool if None.

    Raises:
      ConfigError: there is no such method, or the given checkpoint is of another.
      PoolError: no checkpoint is embedded for it.
    """
    if not entry_of(find_method(method)).needs_checkpoint:
        if given is not None:
            raise ConfigError(
                f"`checkpoint` with method {str(method)!r}, which has none", ", ".join(LEARNED)
            )
        return None
    if given is None:
        return read_checkpoint(find_policy(method, without_exclusions(pool)))
    _check_variant(method, given)
    return given


def _check_variant(method: str, given: Checkpoint) -> None:
    """Refuses a checkpoint of another method, or of one that was removed."""
    variant = given.variant or method
    if variant not in METHODS:
        raise no_such(f"{given.path}, a checkpoint of method", variant, METHODS)
    if variant != method:
        raise ConfigError(
            f"method {method!r} with {given.path}, which was trained as {variant!r}",
            f"method {variant!r}",
            f"method={variant!r}",
        )


def with_history_of(placement: PlacementConfig, checkpoint: Checkpoint | None) -> PlacementConfig:
    """The settings with the history that a method looks back on: none for a baseline."""
    stride = 0 if checkpoint is None else checkpoint.trained.placement.history_stride
    return (
        placement
        if stride == placement.history_stride
        else replace(placement, history_stride=stride)
    )


def proposer_of(method: str, checkpoint: Checkpoint | None, rules: Rules) -> Proposer:
    """The method, bound to a world; its checkpoint may be unreadable (PoolError) or unfit (ConfigError)."""
    if checkpoint is None:
        return make_proposer(method, rules)
    if checkpoint.kind == KIND:
        return load_guided(checkpoint, rules)
    return load_policy(checkpoint, rules)


def sampler_of(setup: Setup, method: Method) -> BlockSampler:
    """Episodes of a method, which looks back on as much as it was trained with; errors: `proposer_of`."""
    rules = setup.problem.rules
    rules = replace(rules, config=with_history_of(rules.config, method.checkpoint))
    return block_sampler_of(method, rules, setup.keep_out, setup.start)


def block_sampler_of(
    method: Method, rules: Rules, keep_out: KeepOut | None = None, start: Start | None = None
) -> BlockSampler:
    """Episodes of a method by these rules; errors: `proposer_of`."""
    sampler: BlockSampler = episodes_of(method.name)(
        rules, proposer_of(*method, rules), keep_out, start
    )
    return sampler
