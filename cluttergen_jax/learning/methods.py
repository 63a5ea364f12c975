"""Methods by name: geometric baselines, and trained policies from checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, get_args

from cluttergen_jax.assets.pool import without_exclusions
from cluttergen_jax.config import VARIANTS, Setting, no_such
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.learning.policies.checkpoint import Checkpoint, read_checkpoint
from cluttergen_jax.learning.policies.embedded import find_policy, list_policies
from cluttergen_jax.learning.policies.guided import KIND, load_guided
from cluttergen_jax.learning.policies.policy import load_policy
from cluttergen_jax.placement.baselines import BASELINES, make_proposer
from cluttergen_jax.placement.config import MIN_MARGIN, RUIN_AFTER, PlacementConfig
from cluttergen_jax.placement.rollout import BlockSampler
from cluttergen_jax.placement.rules import Proposer, Rules
from cluttergen_jax.placement.setup import Setup

METHODS = (*BASELINES, *VARIANTS)
TRUSTED_METHODS = ("spread", "guided")
"""Those that ask what carries what, and that take objects away when they are stuck unless told otherwise."""
DEFAULT_METHOD, FALLBACK_METHOD = "guided", "spread"
"""What a user gets unasked; the second where no checkpoint of the first is embedded."""
SETTINGS = get_args(Setting)


class Method(NamedTuple):
    """A method by name, and the checkpoint behind it; None for a baseline."""

    name: str
    checkpoint: Checkpoint | None = None


def choose_method(method: str | None, pool: str, checkpoint: str | Path | None = None) -> Method:
    """The method of that name, or the one to take if none is named; records are read once.

    Args:
      method: None takes the given checkpoint's own; without one `guided`, or `spread` where no checkpoint of
        `guided` is embedded.
      checkpoint: a policy's folder; the embedded one if None.

    Raises:
      ConfigError: there is no such method, or the given checkpoint is of another.
      PoolError: no checkpoint is embedded for it, or there is none in the given folder.
    """
    if method is not None:
        _check_known(method)
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


def rules_asked(method: str | None, max_attempts: int, given: Mapping[str, Any]) -> dict[str, Any]:
    """`order`, `ruin_after`, `budget` and `min_margin` of a `PlacementConfig`, all of them.

    Args:
      method: by name; None for whoever acts in an environment.
      max_attempts: per object.
      given: arguments by name. Those four count where they are not None; for the others `setting` decides:
        "paper" for the paper's rules whatever the method, "default" for a margin and what suits the method.

    Raises:
      ConfigError: there is no such setting.
    """
    setting = given["setting"]
    if setting not in SETTINGS:
        raise ConfigError(
            f"setting = {setting!r}", ", ".join(SETTINGS), "setting='paper'", closest(setting, SETTINGS)
        )
    is_default = setting == "default"
    is_trusted = is_default and method in TRUSTED_METHODS
    own = {
        "order": "weighted" if is_trusted else "random",
        "ruin_after": min(RUIN_AFTER, max_attempts) if is_trusted else 0,
        "budget": None,
        "min_margin": MIN_MARGIN if is_default else 0.0,
    }
    return {name: value if given[name] is None else given[name] for name, value in own.items()}


def checkpoint_of(method: str, pool: str, given: Checkpoint | None = None) -> Checkpoint | None:
    """The checkpoint behind a method; None for a baseline.

    Args:
      given: the one to take; the embedded one for the pool if None.

    Raises:
      ConfigError: there is no such method, or the given checkpoint is of another.
      PoolError: no checkpoint is embedded for it.
    """
    _check_known(method)
    if method in BASELINES:
        if given is not None:
            raise ConfigError(f"`checkpoint` with method {method!r}, which has none", ", ".join(VARIANTS))
        return None
    if given is None:
        return read_checkpoint(find_policy(method, without_exclusions(pool)))
    _check_variant(method, given)
    return given


def _check_known(method: str, what: str = "method") -> None:
    if method not in METHODS:
        raise no_such(what, method, METHODS)


def _check_variant(method: str, given: Checkpoint) -> None:
    """Refuses a checkpoint of another method, or of one that was removed."""
    variant = given.variant or method
    _check_known(variant, f"{given.path}, a checkpoint of method")
    if variant != method:
        raise ConfigError(
            f"method {method!r} with {given.path}, which was trained as {variant!r}",
            f"method {variant!r}",
            f"method={variant!r}",
        )


def suited(placement: PlacementConfig, checkpoint: Checkpoint | None) -> PlacementConfig:
    """The settings with the history that a method looks back on: none for a baseline."""
    stride = 0 if checkpoint is None else checkpoint.placement["history_stride"]
    return replace(placement, history_stride=stride)


def check_steered(method: str, placement: PlacementConfig) -> None:
    """Refuses `clutter`, `natural` and `tidy` with a method that has no trusted candidates to choose from.

    And a free `height` with any but `random`.

    Raises:
      ConfigError: it names the methods that do.
    """
    is_steered = {
        "clutter": placement.clutter is not None,
        "natural": placement.natural,
        "tidy": placement.tidy,
    }
    if placement.height != "rest" and method != "random":
        raise ConfigError(
            f"height = {placement.height!r} with method {method!r}", "height='rest'", "method='random'"
        )
    given = [name for name, is_given in is_steered.items() if is_given]
    if given and method not in TRUSTED_METHODS:
        allowed = [name for name in TRUSTED_METHODS if name in METHODS]
        raise ConfigError(
            f"`{given[0]}` with method {method!r}", f"with {' or '.join(allowed)}", f"method={allowed[0]!r}"
        )


def proposer_of(method: str, checkpoint: Checkpoint | None, rules: Rules) -> Proposer:
    """The method, bound to a world.

    Raises:
      PoolError, ConfigError: its checkpoint cannot be read, or is of another problem.
    """
    if checkpoint is None:
        return make_proposer(method, rules)
    if checkpoint.kind == KIND:
        return load_guided(checkpoint, rules)
    return load_policy(checkpoint, rules)


def sampler_of(setup: Setup, method: Method) -> BlockSampler:
    """Episodes of a method, which looks back on as much as it was trained with.

    Raises:
      PoolError, ConfigError: its checkpoint cannot be read, or is of another problem.
    """
    rules = setup.problem.rules
    rules = replace(rules, config=suited(rules.config, method.checkpoint))
    return BlockSampler(rules, proposer_of(*method, rules), setup.keep_out, setup.start)
