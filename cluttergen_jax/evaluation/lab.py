"""The place where trials are run: problems, rollouts, policies and results at hand, each made once."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.agent.checkpoint import read_record
from cluttergen_jax.assets.pool import Pool, find_pool
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.evaluation.checkpoints import Checkpoints, MissingCheckpointError, train_command
from cluttergen_jax.evaluation.episodes import Outcome, attempts_of, run_episodes
from cluttergen_jax.evaluation.machine import versions
from cluttergen_jax.evaluation.progress import Progress
from cluttergen_jax.evaluation.record import arrays_of, figures_of
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import Trial, key_of
from cluttergen_jax.methods import checkpoint_hash, proposer_of, suited
from cluttergen_jax.physics import make_physics
from cluttergen_jax.physics.host import SwappablePhysics
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.physics.protocol import Physics
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.policies.checkpoint import Checkpoint, read_checkpoint
from cluttergen_jax.problem import Problem, ProblemConfig, compose
from cluttergen_jax.progress import interruptible
from cluttergen_jax.sampling import BlockSampler, Rollout
from cluttergen_jax.world import World

Record = dict[str, Any]
_KEPT_PROBLEMS = 4


@dataclass(eq=False)
class Lab:
    """Runs trials and remembers them.

    Attributes:
      store: results on disk.
      checkpoints: where policies are.
      engine: "auto", "native", "warp" or "jax"; num_threads: of the native engine, 0 for every core.
      is_fresh: do not use results at hand.
      progress: where it is shown.
    """

    store: Store
    checkpoints: Checkpoints = field(default_factory=Checkpoints)
    engine: str = "auto"
    num_threads: int = 0
    is_fresh: bool = False
    progress: Progress = field(default_factory=lambda: Progress(0))

    def __post_init__(self) -> None:
        self.rollout = Rollout(attempts_of)
        self._pools: dict[str, Pool] = {}
        self._supports: dict[str, SupportAsset] = {}
        self._problems: OrderedDict[Any, Problem] = OrderedDict()
        self._swappable: dict[tuple[int, StabilityConfig], SwappablePhysics] = {}
        self._made: set[str] = set()

    def check(self, trials: Iterable[Trial]) -> None:
        """Raises for whatever no trial may name: pools, supports and methods that do not exist."""
        for trial in trials:
            self.pool(trial.pool)
            self.support(trial.support)
            try:
                self.checkpoints.find(trial)
            except MissingCheckpointError:
                continue

    def pool(self, name: str) -> Pool:
        """`find_pool`, once."""
        if name not in self._pools:
            self._pools[name] = find_pool(name)
        return self._pools[name]

    def support(self, name: str) -> SupportAsset:
        """`find_support`, once."""
        if name not in self._supports:
            self._supports[name] = find_support(name)
        return self._supports[name]

    def at_hand(self, trial: Trial) -> Record | None:
        """The trial's result, if it was made before (or cannot be made for want of a checkpoint)."""
        try:
            sources = self.sources(trial)
        except MissingCheckpointError as error:
            return _missing(trial, error)
        key = key_of(trial, sources)
        if self.is_fresh and key not in self._made:
            return None
        return self.store.read(trial.title, key)

    def record(self, trial: Trial) -> Record:
        """The trial's result: from disk, or made now.

        Returns:
          `trial`, `sources`, `policy` and `figures` (`record.figures_of`; `paper` among them is the looser
          count); or `trial`, `missing` and `hint` if its checkpoint is missing.
        """
        known = self.at_hand(trial)
        if known is not None:
            return known
        self.progress.begin(trial.title)
        try:
            strict = self.run(trial, judge_neighbours=True)
            figures = figures_of(strict)
            if trial.paper_count:
                loose = self.run(trial, judge_neighbours=False)
                figures["paper"] = figures_of(loose, has_last_check=False)
        except MissingCheckpointError as error:
            self.progress.skip(trial.num_episodes)
            self.progress.finish(str(error))
            return _missing(trial, error)
        sources = self.sources(trial)
        key = key_of(trial, sources)
        record = {
            "trial": trial.shown(),
            "sources": sources,
            "policy": self._policy(trial),
            "figures": figures,
        }
        stored = self.store.write(trial.title, key, record, arrays_of(strict))
        self._made.add(key)
        self.progress.finish(f"success {figures['success']:.3f}, {figures['placed']:.2f} objects placed")
        return stored

    def arrays(self, trial: Trial) -> dict[str, np.ndarray]:
        """The scenes and attempts of a trial (`record.arrays_of`), made now if they are not there.

        Raises:
          MissingCheckpointError: its policy has not been trained.
        """
        key = key_of(trial, self.sources(trial))
        self.record(trial)
        arrays = self.store.read_arrays(trial.title, key)
        if arrays is None:
            self.store.path(trial.title, key).unlink(missing_ok=True)
            self.record(trial)
            arrays = self.store.read_arrays(trial.title, key)
        assert arrays is not None, f"{self.store.root}: what was just written cannot be read"
        return arrays

    def measured(self, trial: Trial, what: str, make: Callable[[], Record]) -> Record:
        """What `make` finds out about a trial's scenes: from disk, or now.

        Args:
          what: the measure's name, and all but the trial that decides what it finds.
        """
        key, title = key_of(trial, self.sources(trial)), f"{what} of {trial.title}"
        known = None if self.is_fresh else self.store.read(title, key)
        if known is not None:
            return known["figures"]
        self.progress.begin(title)
        figures = self.store.keep(title, key, interruptible(make))
        self.progress.say(f"{title}: done")
        return figures

    def sources(self, trial: Trial) -> dict[str, Any]:
        """Hashes of what a trial is about, and versions: all that decides its result beside the trial."""
        checkpoint = self.checkpoints.find(trial)
        return {
            "pool": self.pool(trial.pool).hash,
            "support": _support_hash(self.support(trial.support)),
            "checkpoint": checkpoint and checkpoint_hash(checkpoint),
            "engine": self.engine,
            "versions": versions(),
        }

    def problem(self, trial: Trial, judge_neighbours: bool = True) -> Problem:
        """The trial's compiled world and rules, ready for what is compiled already."""
        checkpoint = self.checkpoints.find(trial)
        trained = {} if checkpoint is None else read_record(checkpoint).get("stability", {})
        is_cut = trained.get("stop_when_decided", True)
        stability = StabilityConfig(
            stop_when_decided=is_cut and not trial.whole_attempts, judge_neighbours=judge_neighbours
        )
        base = self._composed(trial)
        with _usable(checkpoint, trial):
            config = suited(base.rules.config, _read(checkpoint))
        # Stable steps, as the paper counts them, need whole attempts; a policy that was trained on attempts
        # cut off as soon as they were decided reads histories of that length.
        is_longer = is_cut and trial.whole_attempts
        rules = replace(
            base.rules,
            config=config,
            physics=self._physics(base.world, stability),
            history_steps=stability.decision_step if is_longer else None,
        )
        return replace(base, config=replace(base.config, stability=stability), rules=rules)

    def world(self, trial: Trial) -> World:
        """The trial's compiled world."""
        return self._composed(trial).world

    def _physics(self, world: World, stability: StabilityConfig) -> Physics:
        """The engine of a world. Worlds of equal sizes share what is compiled around a native one.

        A shared one drives the world asked for last: one is at work at a time.
        """
        engine = make_physics(world.layout, stability, self.engine, self.num_threads)
        if not isinstance(engine, NativePhysics):
            return engine
        sizes = (world.num_objects, stability)
        if sizes not in self._swappable:
            self._swappable[sizes] = SwappablePhysics(*sizes)
        self._swappable[sizes].engine = engine
        return self._swappable[sizes]

    def _composed(self, trial: Trial) -> Problem:
        """The trial's problem but for method and stability; the latest few are kept."""
        config = ProblemConfig(
            pool=trial.pool,
            repeat=trial.repeat,
            support=trial.support,
            region=self.base_region(trial),
            change=trial.change,
            engine=self.engine,
            num_threads=self.num_threads,
            placement=PlacementConfig(
                num_objects=trial.num_objects, max_attempts=trial.attempts, min_margin=trial.min_margin
            ),
        )
        if config not in self._problems:
            objects, support = self.pool(trial.pool).objects, self.support(trial.support)
            self._problems[config] = compose(objects, support, config)
            if len(self._problems) > _KEPT_PROBLEMS:
                self._problems.popitem(last=False)
        self._problems.move_to_end(config)
        return self._problems[config]

    def sampler(self, trial: Trial, problem: Problem) -> BlockSampler:
        """The trial's method in its problem.

        Raises:
          MissingCheckpointError: its checkpoint is missing, or it cannot be used here.
        """
        checkpoint = self.checkpoints.find(trial)
        with _usable(checkpoint, trial):
            propose = proposer_of(trial.method, _read(checkpoint), problem.rules)
        return BlockSampler(problem.rules, propose)

    def run(self, trial: Trial, judge_neighbours: bool = True) -> Outcome:
        """The trial's episodes, without a look at results at hand."""
        problem = self.problem(trial, judge_neighbours)
        sampler = self.sampler(trial, problem)
        return run_episodes(self.rollout, sampler, trial.trials, trial.seed, self.progress.add)

    def base_region(self, trial: Trial) -> Rectangle:
        """The trial's region before any change."""
        own = self.support(trial.support).region
        if trial.region is None:
            return own
        return Rectangle(own.center, (trial.region[0] / 2, trial.region[1] / 2), own.yaw)

    def _policy(self, trial: Trial) -> Record | None:
        """How the trial's policy was trained; None for a baseline."""
        checkpoint = self.checkpoints.find(trial)
        if checkpoint is None:
            return None
        record, names = read_record(checkpoint), ("variant", "preset", "seed", "attempts")
        known = {name: record[name] for name in names if name in record}
        head = record["network"].get("head") if "network" in record else None
        return known | {"max_attempts": record["placement"]["max_attempts"], "head": head}


def _read(checkpoint: Path | None) -> Checkpoint | None:
    return None if checkpoint is None else read_checkpoint(checkpoint)


@contextmanager
def _usable(checkpoint: Path | None, trial: Trial) -> Iterator[None]:
    """What goes wrong with a checkpoint is a row's misfortune: the suite goes on.

    A record of an older version may lack settings, or hold some that no network knows any more.
    """
    try:
        yield
    except (ClutterGenError, TypeError, KeyError) as error:
        if checkpoint is None:
            raise
        # Results name no folders.
        name = f"{checkpoint.parent.name}/{checkpoint.name}"
        given = error.given if isinstance(error, ClutterGenError) else f"{type(error).__name__}: {error}"
        raise MissingCheckpointError(
            f"checkpoint {name} cannot be used: {given.replace(str(checkpoint), name)}",
            hint=train_command(trial),
        ) from error


def _missing(trial: Trial, error: MissingCheckpointError) -> Record:
    return {"trial": trial.shown(), "missing": error.given, "hint": error.hint}


def _support_hash(support: SupportAsset) -> str:
    facts = {
        "boxes": [asdict(box) for box in support.boxes],
        "top": support.top,
        "region": asdict(support.region),
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
