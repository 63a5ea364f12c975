"""Methods by name: geometric baselines, and trained policies from checkpoints."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from cluttergen_jax.agent.checkpoint import read_record
from cluttergen_jax.baselines import METHODS as BASELINES
from cluttergen_jax.baselines import Clear, make_proposer
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.proposer import Proposer
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.policies import Policy, Screened, find_policy, list_policies, load_policy
from cluttergen_jax.search import SearchConfig
from cluttergen_jax.training.presets import VARIANTS

SCREENED = "policy-clear"
METHODS = (*BASELINES, *VARIANTS, SCREENED)
DEFAULT_METHOD = "policy"
FALLBACK_METHOD = "clear"
GOOD_SUCCESS = 0.9
"""Success, as its record tells it, from which an embedded policy is what a user gets unasked."""


def default_method(pool: str, checkpoint: str | None = None) -> str:
    """The method for a pool where none is named.

    `policy` with a given checkpoint, or where one is embedded that fills most scenes; else `clear`.
    """
    if checkpoint is not None:
        return DEFAULT_METHOD
    embedded = list_policies().get(f"{pool}-{DEFAULT_METHOD}")
    if embedded is None:
        return FALLBACK_METHOD
    success = read_record(embedded).get("evaluation", {}).get("success", 0.0)
    return DEFAULT_METHOD if success >= GOOD_SUCCESS else FALLBACK_METHOD


def checkpoint_of(method: str, pool: str, checkpoint: str | None = None) -> Path | None:
    """The checkpoint behind a method; None for a baseline.

    Raises:
      ConfigError: there is no such method, or a checkpoint is given for a baseline.
      PoolError: no checkpoint is embedded for it.
    """
    if method not in METHODS:
        raise ConfigError(f"method {method!r}", ", ".join(METHODS), "--method clear")
    if method in BASELINES:
        if checkpoint is not None:
            raise ConfigError(f"--checkpoint with method {method!r}, which has none", ", ".join(VARIANTS))
        return None
    variant = DEFAULT_METHOD if method == SCREENED else method
    return Path(checkpoint) if checkpoint is not None else find_policy(variant, pool)


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
            f"{checkpoint} holds no policy ({error})", hint="the folder `policy` of a run"
        ) from error
    return hashlib.sha256(b"".join(hashlib.sha256(data).digest() for data in files)).hexdigest()


def suited(placement: PlacementConfig, checkpoint: Path | None) -> PlacementConfig:
    """The settings with the history that a method looks back on: none for a baseline."""
    stride = 0 if checkpoint is None else read_record(checkpoint)["placement"]["history_stride"]
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
