"""Methods by name: geometric baselines, and trained policies from checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, get_args

from cluttergen_jax.assets.pool import without_exclusions
from cluttergen_jax.config import VARIANTS, Setting
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.learning.policies.checkpoint import Checkpoint, read_checkpoint
from cluttergen_jax.learning.policies.embedded import find_policy, list_policies
from cluttergen_jax.learning.policies.guided import KIND, load_guided
from cluttergen_jax.learning.policies.policy import FilteredPolicy, TrainedPolicy, load_policy
from cluttergen_jax.placement.baselines import BASELINES, Clear, make_proposer
from cluttergen_jax.placement.config import MIN_MARGIN, RUIN_AFTER, PlacementConfig
from cluttergen_jax.placement.rollout import BlockSampler
from cluttergen_jax.placement.rules import Proposer, Rules
from cluttergen_jax.placement.search import SearchConfig
from cluttergen_jax.placement.setup import Setup

FILTERED = "policy-clear"
METHODS = (*BASELINES, *VARIANTS, FILTERED)
TRUSTED_METHODS = ("spread", "guided")
"""Those that ask what carries what, and that take objects away when they are stuck unless told otherwise."""
DEFAULT_METHOD = "policy"
FALLBACK_METHOD = "clear"
GOOD_SUCCESS = 0.9
"""Success, as its record tells it, from which an embedded policy is what a user gets unasked."""
SETTINGS = get_args(Setting)


class Method(NamedTuple):
    """A method by name, and the checkpoint behind it; None for a baseline."""

    name: str
    checkpoint: Checkpoint | None = None


def choose_method(
    method: str | None, pool: str, support: str, num_objects: int, checkpoint: str | Path | None = None
) -> Method:
    """The method of that name, the one that fits the problem best if none is named; records are read once.

    Args:
      method: None takes the given checkpoint's own; without one, `policy` where one is embedded that was
        trained for this pool on this support with at least as many objects, and that fills most scenes;
        else `clear`.
      checkpoint: a policy's folder; the embedded one if None.

    Raises:
      ConfigError: there is no such method, or the given checkpoint is of another.
      PoolError: no checkpoint is embedded for it, or there is none in the given folder.
    """
    given = None if checkpoint is None else read_checkpoint(Path(checkpoint))
    if method is None and given is not None:
        method = given.variant or DEFAULT_METHOD
    if method is not None:
        return Method(method, checkpoint_of(method, pool, given))
    embedded = list_policies().get(f"{without_exclusions(pool)}-{DEFAULT_METHOD}")
    if embedded is None:
        return Method(FALLBACK_METHOD)
    found = read_checkpoint(embedded)
    is_trained = found.record.get("support") == support and num_objects <= found.placement["num_objects"]
    is_good = found.record.get("evaluation", {}).get("success", 0.0) >= GOOD_SUCCESS
    return Method(DEFAULT_METHOD, found) if is_trained and is_good else Method(FALLBACK_METHOD)


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
    if method not in METHODS:
        raise ConfigError(
            f"method {method!r}", ", ".join(METHODS), "method='clear'", closest(method, METHODS)
        )
    if method in BASELINES:
        if given is not None:
            raise ConfigError(f"`checkpoint` with method {method!r}, which has none", ", ".join(VARIANTS))
        return None
    if given is None:
        name = DEFAULT_METHOD if method == FILTERED else method
        return read_checkpoint(find_policy(name, without_exclusions(pool)))
    _check_variant(method, given)
    return given


def _check_variant(method: str, given: Checkpoint) -> None:
    """Refuses a checkpoint of another method; the geometric filter takes every policy of poses."""
    variant = given.variant or method
    if variant == method or (method == FILTERED and given.kind == "pose"):
        return
    raise ConfigError(
        f"method {method!r} with {given.path}, which was trained as {variant!r}",
        "a policy of poses" if method == FILTERED else f"method {variant!r}",
        f"method={variant!r}",
    )


def suited(placement: PlacementConfig, checkpoint: Checkpoint | None) -> PlacementConfig:
    """The settings with the history that a method looks back on: none for a baseline."""
    stride = 0 if checkpoint is None else checkpoint.placement["history_stride"]
    return replace(placement, history_stride=stride)


def check_steered(method: str, placement: PlacementConfig) -> None:
    """Refuses `clutter` and `natural` with a method that draws from no weights.

    Raises:
      ConfigError: it names the methods that do.
    """
    is_steered = {"clutter": placement.clutter is not None, "natural": placement.natural}
    given = [name for name, is_given in is_steered.items() if is_given]
    if given and method not in TRUSTED_METHODS:
        allowed = [name for name in TRUSTED_METHODS if name in METHODS]
        raise ConfigError(
            f"`{given[0]}` with method {method!r}", f"with {' or '.join(allowed)}", f"method={allowed[0]!r}"
        )


def proposer_of(method: str, checkpoint: Checkpoint | None, rules: Rules) -> Proposer:
    """The method, bound to a world.

    Raises:
      ConfigError: the geometric filter is asked for around a policy that ranks candidates already.
    """
    if checkpoint is None:
        return make_proposer(method, rules)
    if checkpoint.kind == KIND:
        return load_guided(checkpoint, rules)
    policy = load_policy(checkpoint, rules)
    if method != FILTERED:
        return policy
    if checkpoint.kind != "pose":
        raise ConfigError(
            f"method {FILTERED!r} with {checkpoint.path}, which ranks candidates", "a policy of poses"
        )
    return make_filtered(policy, rules)


def sampler_of(setup: Setup, method: Method) -> BlockSampler:
    """Episodes of a method, which looks back on as much as it was trained with.

    Raises:
      PoolError, ConfigError: its checkpoint cannot be read, or is of another problem.
    """
    rules = setup.problem.rules
    rules = replace(rules, config=suited(rules.config, method.checkpoint))
    return BlockSampler(rules, proposer_of(*method, rules), setup.keep_out, setup.start)


def make_filtered(policy: TrainedPolicy, rules: Rules) -> FilteredPolicy:
    """Draws of a policy, filtered by the geometry that `clear` uses."""
    num_draws = FilteredPolicy.num_draws
    search = SearchConfig(num_candidates=num_draws, num_finalists=num_draws // 2)
    return FilteredPolicy(policy, Clear(rules, search))
