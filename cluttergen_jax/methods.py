"""Methods by name: geometric baselines, and trained policies from checkpoints."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from cluttergen_jax.agent.checkpoint import read_policy_record, read_record
from cluttergen_jax.assets.pool import without_exclusions
from cluttergen_jax.baselines import METHODS as BASELINES
from cluttergen_jax.baselines import Clear, make_proposer
from cluttergen_jax.errors import ConfigError, PoolError, closest
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.proposer import Proposer
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.policies.embedded import find_policy, list_policies
from cluttergen_jax.policies.policy import Policy, load_policy
from cluttergen_jax.policies.screened import Screened
from cluttergen_jax.search import SearchConfig
from cluttergen_jax.training.presets import VARIANTS

SCREENED = "policy-clear"
METHODS = (*BASELINES, *VARIANTS, SCREENED)
DEFAULT_METHOD = "policy"
FALLBACK_METHOD = "clear"
GOOD_SUCCESS = 0.9
"""Success, as its record tells it, from which an embedded policy is what a user gets unasked."""


def default_method(pool: str, support: str, num_objects: int, checkpoint: str | None = None) -> str:
    """The method where none is named.

    With a checkpoint its own. Else `policy` where one is embedded that was trained for this pool on this
    support with at least as many objects, and that fills most scenes; else `clear`.

    Raises:
      PoolError: there is no checkpoint in the given folder.
    """
    if checkpoint is not None:
        return str(read_record(Path(checkpoint)).get("variant", DEFAULT_METHOD))
    embedded = list_policies().get(f"{without_exclusions(pool)}-{DEFAULT_METHOD}")
    record = {} if embedded is None else read_policy_record(embedded)
    is_trained = record.get("support") == support and num_objects <= record["placement"]["num_objects"]
    is_good = record.get("evaluation", {}).get("success", 0.0) >= GOOD_SUCCESS
    return DEFAULT_METHOD if is_trained and is_good else FALLBACK_METHOD


def checkpoint_of(method: str, pool: str, checkpoint: str | None = None) -> Path | None:
    """The checkpoint behind a method; None for a baseline.

    Raises:
      ConfigError: there is no such method, or the given checkpoint is of another.
      PoolError: no checkpoint is embedded for it, or there is none in the given folder.
    """
    if method not in METHODS:
        raise ConfigError(
            f"method {method!r}", ", ".join(METHODS), "method='clear'", closest(method, METHODS)
        )
    if method in BASELINES:
        if checkpoint is not None:
            raise ConfigError(f"`checkpoint` with method {method!r}, which has none", ", ".join(VARIANTS))
        return None
    if checkpoint is None:
        return find_policy(DEFAULT_METHOD if method == SCREENED else method, without_exclusions(pool))
    _check_variant(method, Path(checkpoint))
    return Path(checkpoint)


def _check_variant(method: str, checkpoint: Path) -> None:
    """Refuses a checkpoint of another method; the screen takes every policy of poses."""
    variant = read_policy_record(checkpoint).get("variant", method)
    if variant == method or (method == SCREENED and variant != "ranked"):
        return
    raise ConfigError(
        f"method {method!r} with {checkpoint}, which was trained as {variant!r}",
        "a policy of poses" if method == SCREENED else f"method {variant!r}",
        f"method={variant!r}",
    )


def checkpoint_hash(checkpoint: Path) -> str:
    """Hex digest of a policy's weights and record.

    Raises:
      PoolError: there is no policy in that folder.
    """
    read_record(checkpoint)
    try:
        files = [(checkpoint / name).read_bytes() for name in ("record.json", "weights.npz")]
    except OSError as error:
        raise PoolError(
            f"{checkpoint} holds no policy ({error.strerror})", hint="the folder `policy` of a run"
        ) from error
    return hashlib.sha256(b"".join(hashlib.sha256(data).digest() for data in files)).hexdigest()


def suited(placement: PlacementConfig, checkpoint: Path | None) -> PlacementConfig:
    """The settings with the history that a method looks back on: none for a baseline."""
    stride = 0 if checkpoint is None else read_policy_record(checkpoint)["placement"]["history_stride"]
    return replace(placement, history_stride=stride)


def proposer_of(method: str, checkpoint: Path | None, rules: Rules) -> Proposer:
    """The method, bound to a world.

    Raises:
      ConfigError: the geometric screen is asked for around a policy that ranks candidates already.
    """
    if checkpoint is None:
        return make_proposer(method, rules)
    policy = load_policy(checkpoint, rules)
    if method != SCREENED:
        return policy
    if not isinstance(policy, Policy):
        raise ConfigError(
            f"method {SCREENED!r} with {checkpoint}, which ranks candidates", "a policy of poses"
        )
    return make_screened(policy, rules)


def make_screened(policy: Policy, rules: Rules) -> Screened:
    """Draws of a policy, screened by the geometry that `clear` uses."""
    search = SearchConfig(num_candidates=Screened.num_draws, num_finalists=Screened.num_draws // 2)
    return Screened(policy, Clear(rules, search))
