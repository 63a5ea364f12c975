"""A trial with what it names (pool, support, checkpoint) and the key of its row, each found once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets import Rectangle, SupportAsset, find_support, object_hash
from cluttergen_jax.assets.pool import Pool, find_pool
from cluttergen_jax.config import ROBUST_TILT, StabilityConfig, no_such, stability_record
from cluttergen_jax.errors import ClutterGenError, ConfigError, PoolError
from cluttergen_jax.evaluation.records import versions
from cluttergen_jax.evaluation.trial import Trial, key_of
from cluttergen_jax.learning import checkpoint_of
from cluttergen_jax.learning.policies.checkpoint import Checkpoint, read_checkpoint
from cluttergen_jax.learning.policies.embedded import FOR_ANY_POOL
from cluttergen_jax.learning.training.suite import (
    DEFAULT_ATTEMPTS,
    DEFAULT_OBJECTS,
    PAPERS_PRESET,
    PAPERS_VARIANTS,
)
from cluttergen_jax.learning.training.worlds import HELD_OUT_FAMILIES, TRAINING_FAMILIES, variants
from cluttergen_jax.placement.methods.table import LEARNED, METHODS, OwnMethod, entry_of
from cluttergen_jax.placement.problem import ProblemConfig, Standing
from cluttergen_jax.scene.bank.scene import read_start

VARIANT_POOLS = {"held_out_families": HELD_OUT_FAMILIES, "training_families": TRAINING_FAMILIES}
"""Names of pools of the modeller's variants, which no folder holds, and the families of their objects."""
# Objects of each, and their first seed: far from those that networks are trained on.
NUM_VARIANTS = 40
FIRST_SEED = 5000


def find_any_pool(name: str) -> Pool:
    """The pool of that name or path; one of variants is made at first, and its bodies are cached.

    Raises:
      PoolError: nothing is called so, or its files are damaged.
      AssetError: a variant could not be made.
    """
    if name not in VARIANT_POOLS:
        return find_pool(name)
    return Pool(name, variants(NUM_VARIANTS, FIRST_SEED, VARIANT_POOLS[name]), licence="Apache-2.0")


class MissingRowError(PoolError):
    """A row cannot be made: the figures of others do not depend on it."""


class MissingCheckpointError(MissingRowError):
    """A row's policy has not been trained; `hint` is the command that does it."""


@dataclass(frozen=True)
class Checkpoints:
    """Finds policies: each row has the one of its own method.

    Attributes:
      folder: of training runs, `POOL-VARIANT[-attemptsA][-SEED]`, each with its `policy`; None takes embedded
        checkpoints. It hides those of single pools; a method for all pools that was not trained there is
        taken from the package.
      path: the checkpoint of the method that it was trained as; goes before everything else.
    """

    folder: Path | None = None
    path: Path | None = None

    def __post_init__(self) -> None:
        if self.folder is None:
            return
        if not self.folder.is_dir():
            raise ConfigError(
                f"checkpoints = {str(self.folder)!r}",
                "a folder of training runs, such as runs",
                "cluttergen train, which makes runs/POOL-VARIANT-SEED",
            )
        if (self.folder / "policy" / "record.json").is_file():
            raise ConfigError(
                f"checkpoints = {str(self.folder)!r}, which is a training run itself",
                "the folder that it lies in, which holds the runs of several methods",
                f"checkpoint={str(self.folder / 'policy')!r} for this one",
            )

    @cached_property
    def given(self) -> Checkpoint | None:
        """The checkpoint in `path`.

        Raises:
          PoolError: there is none.
        """
        return None if self.path is None else read_checkpoint(self.path)

    def check_asked(self, trials: Iterable[Trial]) -> None:
        """Refuses a given checkpoint that none of the rows asks.

        Raises:
          ConfigError: it names the method that the checkpoint was trained as.
        """
        methods = dict.fromkeys(trial.method for trial in trials)
        if self.given is None or any(self._is_of(method) for method in methods):
            return
        variant = self.given.variant or "policy"
        if variant in METHODS:
            raise ConfigError(
                f"`checkpoint` {self.path}, trained as {variant!r}, with rows of {', '.join(methods)}",
                f"rows of {variant!r} among them",
                f"methods=({variant!r},)",
            )
        raise no_such(f"{self.path}, a checkpoint of method", variant, METHODS)

    def _is_of(self, method: str) -> bool:
        """Whether the given checkpoint is the method's; a record that does not say fits any of poses."""
        if self.given is None or method not in LEARNED:
            return False
        return method == self.given.variant or (
            self.given.variant is None and method not in FOR_ANY_POOL
        )

    def find(self, trial: Trial) -> Checkpoint | None:
        """The trial's policy; None for a baseline.

        Raises:
          MissingCheckpointError: there is none, or its record is damaged.
          ConfigError: there is no such method. PoolError: `path` holds no checkpoint.
        """
        if not entry_of(trial.method).needs_checkpoint:
            checkpoint_of(trial.method, trial.pool)
            return None
        given = self.given if self._is_of(trial.method) else None
        found = given or self._in_folder(trial) or self._find_embedded(trial)
        if found is None:
            raise MissingCheckpointError(
                f"no checkpoint for method {trial.method!r} on pool {trial.pool!r}",
                hint=train_command(trial),
            )
        return found

    def run_folder(self, trial: Trial) -> Path | None:
        """The training run behind a learned trial, with its progress; None if it is not there."""
        for name in _names(trial):
            if self.folder is not None and (self.folder / name / "progress.csv").is_file():
                return self.folder / name
        return None

    def _in_folder(self, trial: Trial) -> Checkpoint | None:
        if self.folder is None:
            return None
        places = [self.folder / name / inner for name in _names(trial) for inner in ("policy", "")]
        place = next((place for place in places if (place / "weights.npz").is_file()), None)
        with usable(place, trial):
            return None if place is None else read_checkpoint(place)

    def _find_embedded(self, trial: Trial) -> Checkpoint | None:
        """The embedded ones are of training seed 0; a given folder hides those of single pools."""
        is_hidden = self.folder is not None and trial.method not in FOR_ANY_POOL
        if is_hidden or trial.training_seed != 0:
            return None
        try:
            return checkpoint_of(trial.method, trial.pool)
        except PoolError:
            return None


@contextmanager
def usable(given: Checkpoint | Path | None, trial: Trial) -> Iterator[None]:
    """A checkpoint that cannot be used makes a row that is missing: the suite goes on.

    A record of an older version may lack settings, or hold some that no network knows any more.
    """
    try:
        yield
    except (ClutterGenError, TypeError, KeyError) as error:
        if given is None:
            raise
        path = given.path if isinstance(given, Checkpoint) else given
        reason = (
            error.given
            if isinstance(error, ClutterGenError)
            else f"{type(error).__name__}: {error}"
        )
        text = _without_folder(f"checkpoint {path} cannot be used: {reason}", path)
        raise MissingCheckpointError(text, hint=train_command(trial)) from error


def _without_folder(text: str, path: Path) -> str:
    """Results name no folders."""
    return text.replace(str(path), f"{path.parent.name}/{path.name}")


def _names(trial: Trial) -> list[str]:
    """Run folders that a trial's policy may be in, the best first.

    One trained with the trial's attempts goes before one trained with the usual number.
    """
    if trial.method in FOR_ANY_POOL:
        return [
            f"{trial.method}-{trial.training_seed}",
            *([trial.method] * (not trial.training_seed)),
        ]
    pool = trial.pool_name
    attempts = (
        "" if trial.spec.max_attempts == DEFAULT_ATTEMPTS else f"-attempts{trial.spec.max_attempts}"
    )
    stems = [f"{pool}-{trial.method}{extra}" for extra in dict.fromkeys((attempts, ""))]
    endings = (f"-{trial.training_seed}", *([""] if trial.training_seed == 0 else []))
    return [f"{stem}{ending}" for stem in stems for ending in endings]


def train_command(trial: Trial) -> str:
    """The command that trains what a row lacks."""
    is_for_any = trial.method in FOR_ANY_POOL
    of_pool = "" if is_for_any else f" --pool {trial.pool}"
    words = [f"cluttergen train{of_pool} --variant {trial.method}"]
    if trial.training_seed:
        words.append(f"--seed {trial.training_seed}")
    if is_for_any:
        return " ".join(words)
    if trial.method in PAPERS_VARIANTS:
        words.append(f"--preset {PAPERS_PRESET} --encoder-weights encoder")
    if trial.num_objects < DEFAULT_OBJECTS:
        # Who was trained with more objects fills smaller scenes too; but a pool may have no more.
        words.append(f"--num-objects {trial.num_objects}")
    if trial.spec.max_attempts != DEFAULT_ATTEMPTS:
        words.append(f"--max-attempts {trial.spec.max_attempts} --out runs/{_names(trial)[0]}")
    return " ".join(words)


@dataclass(frozen=True, eq=False)
class ResolvedTrial:
    """A trial with everything that it names.

    Attributes:
      checkpoint: its policy; None for a baseline.
      standing: what stands there when an episode begins; None for nothing.
      sources: hashes of what the trial names, and versions: all that decides its row beside the trial.
      key: of its row (`trial.key_of`).
    """

    trial: Trial
    pool: Pool
    support: SupportAsset
    checkpoint: Checkpoint | None
    sources: dict[str, Any]
    key: str
    standing: Standing | None = None

    @cached_property
    def config(self) -> ProblemConfig:
        """Its problem, for any engine.

        Raises:
          ConfigError: what it asks for does not fit its pool or support.
        """
        trial = self.trial
        config = trial.spec.problem_config(trial.method, self.pool)
        return replace(config, change=trial.change)

    @property
    def region(self) -> Rectangle:
        """The queried region before any change."""
        return self.config.region or self.support.region

    @property
    def is_cut(self) -> bool:
        """Whether attempts end as soon as they are decided: baselines' do, a policy's as in its training."""
        record = self.checkpoint.record if self.checkpoint else {}
        return record.get("stability", {}).get("stop_when_decided", True)

    @property
    def rules(self) -> Mapping[str, Any]:
        """What its scenes are made by, all defaults decided."""
        placement = self.config.placement
        return {
            "max_attempts": placement.max_attempts,
            "budget": placement.max_scene_attempts,
            "order": placement.order,
            "ruin_after": placement.ruin_after,
            "min_margin": placement.min_margin,
        }

    @property
    def policy(self) -> Mapping[str, Any] | None:
        """What a row says of how its policy was trained; None for a baseline."""
        if self.checkpoint is None:
            return None
        record = self.checkpoint.record
        network, placement, ppo = (record.get(name, {}) for name in ("network", "placement", "ppo"))
        known: dict[str, Any] = {
            name: record[name]
            for name in ("variant", "preset", "seed", "attempts")
            if name in record
        }
        known |= {"max_attempts": placement["max_attempts"], "head": network.get("head")}
        if not ppo:
            return known
        encoder = network["scene_encoder"]
        return known | {
            "reward": placement["reward"],
            "encoder": encoder
            if encoder == "set"
            else f"{encoder} of {network['scene_points']:,} points",
            "height_precision": network["height_precision"],
            "is_cut": self.is_cut,
            **{name: ppo[name] for name in ("discount", "entropy_cost", "learning_rate")},
        }


class Resolver:
    """Finds what trials name.

    Args:
      engine: which is written among a row's sources.
    """

    def __init__(self, checkpoints: Checkpoints, engine: str) -> None:
        self.checkpoints = checkpoints
        self._engine = engine
        self._pool = lru_cache(maxsize=None)(find_any_pool)
        self._support = lru_cache(maxsize=None)(find_support)
        self._resolved: dict[Trial, ResolvedTrial] = {}

    def resolve(self, trial: Trial) -> ResolvedTrial:
        """The trial with what it names.

        Raises:
          PoolError: there is no such pool or support.
          ConfigError: there is no such method.
          MissingCheckpointError: its policy has not been trained.
        """
        if trial not in self._resolved:
            self._resolved[trial] = self._resolve(trial)
        return self._resolved[trial]

    def _resolve(self, trial: Trial) -> ResolvedTrial:
        pool = self._pool(trial.pool)
        support = self._support(trial.support)
        checkpoint = self.checkpoints.find(trial)
        standing = read_start(trial.spec.start)
        sources: dict[str, Any] = {
            "pool": pool.hash,
            "support": _support_hash(support),
            "checkpoint": checkpoint and checkpoint.hash,
            "engine": self._engine,
            "versions": versions(),
        }
        if isinstance(trial.method, OwnMethod):
            sources["method"] = trial.method.digest
        if trial.spec.robust:
            sources["robust"] = stability_record(StabilityConfig(robust_tilt=ROBUST_TILT))
        if standing is not None:
            sources["start"] = _standing_hash(standing)
        return ResolvedTrial(
            trial,
            pool,
            support.on_surface(trial.spec.surface),
            checkpoint,
            sources,
            key_of(trial, sources),
            standing,
        )


def _standing_hash(standing: Standing) -> str:
    """Of objects and where they stand."""
    objects, poses = standing
    digest = hashlib.sha256(np.ascontiguousarray(poses).tobytes())
    for asset in objects:
        digest.update(object_hash(asset).encode())
    return digest.hexdigest()


def _support_hash(support: SupportAsset) -> str:
    """Of what physics knows of a support: its looks, unlike in `support_file.support_hash`, change no row."""
    facts = {
        "boxes": [asdict(box) for box in support.boxes],
        "top": support.top,
        "region": asdict(support.region),
    }
    if support.parts or support.named:
        facts["parts"] = [part.vertices.tolist() for part in support.parts]
        facts["surfaces"] = [asdict(surface) for surface in support.named]
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
