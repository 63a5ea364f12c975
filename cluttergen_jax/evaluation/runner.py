"""The runner of trials: makes and keeps their rows, with worlds and compiled programs made once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cluttergen_jax.assets.support_map import check_region
from cluttergen_jax.cluster import Cluster, each_on
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ClutterGenError, ConfigError
from cluttergen_jax.evaluation.episodes import (
    Outcome,
    arrays_of,
    attempts_of,
    figures_of,
    run_episodes,
    run_shelves,
)
from cluttergen_jax.evaluation.machine import origin
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.resolved import (
    Checkpoints,
    MissingCheckpointError,
    MissingRowError,
    ResolvedTrial,
    Resolver,
    usable,
)
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.methods import Method, block_sampler_of, with_history_of
from cluttergen_jax.physics import engine_of, make_physics
from cluttergen_jax.physics.host import NumberedEngines, Physics
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.boxes import footprint_area
from cluttergen_jax.placement.problem import (
    Problem,
    ProblemConfig,
    Setup,
    area_asked,
    make_setup,
)
from cluttergen_jax.placement.rollout import BlockSampler, Rollout
from cluttergen_jax.placement.shelves import Shelves
from cluttergen_jax.placement.surface_set import check_surface
from cluttergen_jax.placement.world import World
from cluttergen_jax.progress import Progress, interruptible

_KEPT_SETUPS = 4


@dataclass(eq=False)
class Runner:
    """Runs trials and remembers them.

    Attributes:
      store: results on disk.
      checkpoints: where policies are.
      engine: "auto", "native", "warp" or "jax"; num_threads: of the native engine, 0 for every core.
      is_fresh: do not use rows that were kept.
      measured_at: when and where the findings that `measure` has returned were made (`machine.origin`).
      errors: why rows could not be made, in the order in which they were asked for.
    """

    store: Store
    checkpoints: Checkpoints = field(default_factory=Checkpoints)
    engine: str = "auto"
    num_threads: int = 0
    is_fresh: bool = False

    def __post_init__(self) -> None:
        self.rollout = Rollout(attempts_of)
        self.resolve = Resolver(self.checkpoints, self.engine).resolve
        self.progress = Progress("evaluating", 0, "scene")
        self._setups: OrderedDict[Any, Setup] = OrderedDict()
        self._drawn: tuple[Any, Shelves] | None = None
        self._shared: dict[tuple[int, StabilityConfig], tuple[NumberedEngines, Physics]] = {}
        self._made: set[str] = set()
        self._rows: dict[str, Row] = {}
        self._num_rows = self._num_done = 0
        self.measured_at: list[Any] = []
        self.errors: list[ClutterGenError] = []

    def plan(self, trials: Iterable[Trial]) -> None:
        """Counts the rows that are to be made and says so; progress is shown from now on.

        Raises:
          ClutterGenError: a trial names a pool, support or method that does not exist, or a checkpoint was
            given that no trial asks.
        """
        trials = list(trials)
        self.checkpoints.check_asked(trials)
        stored = {trial: self.stored_row(trial) for trial in trials}
        rows = {trial: row for trial, row in stored.items() if "missing" not in (row or {})}
        kept = [trial for trial, row in rows.items() if row is not None]
        total, done = (sum(trial.num_episodes for trial in some) for some in (rows, kept))
        self.progress = Progress("evaluating", total, "scene", done)
        self._num_rows = len(rows)
        self._num_done = len(kept)
        self.say(
            f"{len(rows)} rows, {len(kept)} kept from before, {len(rows) - len(kept)} to be made"
        )

    def say(self, text: str) -> None:
        """Tells the user something, above the bar."""
        self.progress.say(text)

    def begin(self, title: str) -> None:
        """Tells the user what is done now."""
        self.progress.rename(title)
        self._tell(title, "begins")

    def stored_row(self, trial: Trial) -> Row | None:
        """The trial's row, if it was made before (or cannot be made for want of a checkpoint)."""
        try:
            key = self.resolve(trial).key
        except MissingCheckpointError as error:
            return self._missing(trial, error)
        if key in self._rows:
            return self._rows[key]
        if self.is_fresh and key not in self._made:
            return None
        return self.store.read(trial.title, key)

    def row(self, trial: Trial) -> Row:
        """The trial's row: from disk, or made now.

        Returns:
          `trial`, `sources`, `policy`, `figures` (`episodes.figures_of`; `paper` among them is the looser
          count), and `date` and `machine` of its making, which rows of older versions lack; or `trial`,
          `missing` and `hint` if it cannot be made: its checkpoint is missing, its pool has too few objects.
        """
        known = self.stored_row(trial)
        if known is not None:
            return known
        resolved = self.resolve(trial)
        self.begin(trial.title)
        try:
            row, arrays = self.make(resolved)
        except ClutterGenError as error:
            return self._fail(resolved, error)
        return self._keep(resolved, row, arrays)

    def make(self, resolved: ResolvedTrial) -> tuple[Row, dict[str, np.ndarray]]:
        """The trial's row and its scenes, made now and kept nowhere.

        Raises:
          MissingCheckpointError: its checkpoint cannot be used here.
          ClutterGenError: its settings do not fit its pool or support.
        """
        strict = self.run(resolved)
        figures = figures_of(strict)
        figures["fill"] = self._fill(resolved)
        if resolved.trial.paper_count:
            loose = self.run(resolved, judge_neighbours=False)
            figures["paper"] = figures_of(loose, has_last_check=False)
        row: Row = {
            "trial": resolved.trial.record(),
            "sources": resolved.sources,
            "policy": resolved.policy,
            **origin(),  # type: ignore[typeddict-item]
            "figures": figures,
        }
        return row, arrays_of(strict)

    def make_on(self, cluster: Cluster, trials: Iterable[Trial]) -> None:
        """Makes the rows that are missing on a cluster, each in one worker, and keeps them here.

        Raises:
          ConfigError: a worker finds something else under a name (a pool, a support, a checkpoint) than this
            process does.
        """
        missing = [trial for trial in dict.fromkeys(trials) if self.stored_row(trial) is None]
        maker = RowMaker(self.checkpoints, self.engine, self.num_threads or 1)
        is_on_gpu = engine_of(self.engine, StabilityConfig()) == "warp"
        with closing(
            each_on(cluster, maker, missing, "row", maker.num_threads, int(is_on_gpu))
        ) as done:
            for place, (key, found) in done:
                trial = missing[place]
                resolved = self.resolve(trial)
                if key != resolved.key:
                    raise ConfigError(
                        f"{trial.title}: a worker has another pool, support or checkpoint of that name",
                        "the same files under the same path on all machines",
                    )
                if isinstance(found, ClutterGenError):
                    self._fail(resolved, found)
                else:
                    self.progress.update(trial.num_episodes)
                    self._rows[key] = self._keep(resolved, *found)

    def _fail(self, resolved: ResolvedTrial, error: ClutterGenError) -> Row:
        """A row that cannot be made; it is not tried again, and the others are."""
        self._finish(resolved.trial, str(error))
        self._rows[resolved.key] = self._missing(resolved.trial, error)
        return self._rows[resolved.key]

    def _missing(self, trial: Trial, error: ClutterGenError) -> Row:
        self.errors.append(error)
        allowed = f" (allowed: {error.allowed})" if error.allowed else ""
        return {"trial": trial.record(), "missing": error.given + allowed, "hint": error.hint}

    def _keep(self, resolved: ResolvedTrial, row: Row, arrays: dict[str, np.ndarray]) -> Row:
        trial = resolved.trial
        figures = row["figures"]
        stored = self.store.write(trial.title, resolved.key, row, arrays)
        self._made.add(resolved.key)
        self._finish(
            trial, f"success {figures['success']:.3f}, {figures['placed']:.2f} objects placed"
        )
        return stored

    def _finish(self, trial: Trial, text: str) -> None:
        self._num_done += 1
        self._tell(trial.title, text)

    def _tell(self, title: str, text: str) -> None:
        self.say(
            f"[{self._num_done} of {self._num_rows} rows, {self.progress.times()}] {title}: {text}"
        )

    def arrays(self, trial: Trial) -> dict[str, np.ndarray]:
        """The scenes and attempts of a trial (`episodes.arrays_of`), made now if they are not there.

        Raises:
          MissingRowError: they cannot be made; most often its policy has not been trained.
        """
        key = self.resolve(trial).key
        row = self.row(trial)
        if "missing" in row:
            raise MissingRowError(row["missing"], hint=row["hint"])
        arrays = self.store.read_arrays(trial.title, key)
        if arrays is None:
            self.store.remove(trial.title, key)
            self.row(trial)
            arrays = self.store.read_arrays(trial.title, key)
        assert arrays is not None, "what was just written cannot be read"
        return arrays

    def measure(self, trial: Trial, what: str, make: Callable[[], Any]) -> Row:
        """What `make` finds out about a trial's scenes: from disk, or now.

        Args:
          what: the measure's name, and all but the trial that decides what it finds.
        """
        key = self.resolve(trial).key
        title = f"{what} of {trial.title}"
        known = None if self.is_fresh else self.store.read(title, key)
        if known is not None:
            self.measured_at.append(
                {name: known[name] for name in ("date", "machine") if name in known}
            )
            return known["figures"]
        self.begin(title)
        found = interruptible(make)
        self.measured_at.append(origin())
        figures = self.store.keep(title, key, found, self.measured_at[-1])
        self.say(f"{title}: done")
        return figures

    def run(self, resolved: ResolvedTrial, judge_neighbours: bool = True) -> Outcome:
        """The trial's episodes, whatever was kept: scene i is that of `generate` with the trial's seed."""
        trial = resolved.trial
        config = self._config(resolved, judge_neighbours)
        if not config.shelf:
            sampler = self.sampler(resolved, judge_neighbours)
            return run_episodes(
                self.rollout, sampler, trial.trials, trial.seed, self.progress.update
            )
        shelves = self._shelves(resolved, config)

        def block(number: int) -> tuple[BlockSampler, np.ndarray]:
            setup = shelves.block(trial.seed, number)
            names = setup.problem.world.names
            return self._sampler_of(resolved, setup, config.stability), shelves.numbers(names)

        return run_shelves(self.rollout, block, trial.trials, trial.seed, self.progress.update)

    def sampler(self, resolved: ResolvedTrial, judge_neighbours: bool = True) -> BlockSampler:
        """The trial's method in its setup.

        Raises:
          MissingCheckpointError: its checkpoint cannot be used here.
        """
        setup = self._base_setup(resolved)
        problem = self.setup(resolved, judge_neighbours)
        return self._sampler_of(resolved, replace(setup, problem=problem), problem.config.stability)

    def _sampler_of(
        self, resolved: ResolvedTrial, setup: Setup, stability: StabilityConfig
    ) -> BlockSampler:
        trial = resolved.trial
        with usable(resolved.checkpoint, trial):
            config = with_history_of(setup.problem.rules.config, resolved.checkpoint)
        # Stable steps, as the paper counts them, need whole attempts; a policy that was trained on attempts
        # cut off as soon as they were decided reads histories of that length.
        is_longer = resolved.is_cut and trial.whole_attempts
        rules = replace(
            setup.problem.rules,
            config=config,
            history_steps=stability.decision_step if is_longer else None,
        )
        # What is compiled for episodes that begin with nothing is shared by all of them.
        is_bare = not trial.spec.keep_out and resolved.standing is None
        begins = (None, None) if is_bare else (setup.keep_out, setup.start)
        method = Method(trial.method, resolved.checkpoint)
        with usable(resolved.checkpoint, trial):
            return block_sampler_of(method, rules, *begins)

    def setup(self, resolved: ResolvedTrial, judge_neighbours: bool = True) -> Problem:
        """The trial's compiled world and rules, ready for what is compiled already."""
        base = self._base_setup(resolved).problem
        config = self._config(resolved, judge_neighbours)
        if config.shelf:
            return base
        physics = self._physics(base.world, config)
        rules = replace(base.rules, physics=physics)
        return replace(base, config=replace(base.config, stability=config.stability), rules=rules)

    def world(self, resolved: ResolvedTrial) -> World:
        """The trial's compiled world."""
        return self._base_setup(resolved).problem.world

    def _fill(self, resolved: ResolvedTrial) -> float:
        """Footprints of a scene's objects over the region's area, on average, before any change of it."""
        problem = self._base_setup(resolved).problem
        areas = footprint_area(problem.rules.geometry.half_extents)
        width, depth = (2 * each for each in problem.region.half_extents)
        area = area_asked(problem.config, problem.world.support) or width * depth
        return float(np.mean(areas) * resolved.trial.num_objects / area)

    def _physics(self, world: World, config: ProblemConfig) -> Physics:
        """The engine of a world. Worlds of equal sizes share what is compiled around a native one.

        A shared one drives the world asked for last: one is at work at a time.
        """
        stability = config.stability
        engine = make_physics(world.layout, stability, config.engine, self.num_threads)
        if not isinstance(engine, NativePhysics):
            return engine
        sizes = (world.num_objects, stability)
        if sizes not in self._shared:
            engines = NumberedEngines(*sizes)
            self._shared[sizes] = engines, engines.with_number(np.int32(0))
        engines, physics = self._shared[sizes]
        engines.put(engine)
        return physics

    def _config(self, resolved: ResolvedTrial, judge_neighbours: bool = True) -> ProblemConfig:
        """The trial's problem on the runner's engine, judged as its method and its count ask."""
        trial = resolved.trial
        # Piles are made by the native engine alone.
        engine = "native" if resolved.config.is_piled else self.engine
        config = replace(resolved.config, engine=engine, num_threads=self.num_threads)
        stability = replace(
            config.stability,
            stop_when_decided=resolved.is_cut and not trial.whole_attempts,
            judge_neighbours=judge_neighbours,
        )
        has_two = engine_of(engine, stability) == "native"
        is_asked = trial.spec.setting != "paper"
        return replace(config, stability=replace(stability, both_detectors=is_asked and has_two))

    def _base_setup(self, resolved: ResolvedTrial) -> Setup:
        """The trial's setup but for method and stability; the latest few are kept.

        Where each block draws objects of its own, that of the first block.
        """
        spec = resolved.trial.spec
        config = self._config(resolved)
        if config.shelf:
            return self._shelves(resolved, config).block(resolved.trial.seed, 0)
        config = replace(config, stability=resolved.config.stability)
        key = (config, spec.keep_out, spec.start)
        if key not in self._setups:
            pool = resolved.pool
            objects = [pool[name] for name in config.objects] if config.objects else pool.objects
            region = resolved.region
            if spec.region is not None:
                check_region(region, resolved.support)
            if spec.surface:
                check_surface(
                    objects,
                    resolved.support,
                    config.placement,
                    config.contact,
                    spec.region is not None,
                )
            config = replace(config, region=region)
            self._setups[key] = make_setup(
                config, spec.boxes(), resolved.standing, (objects, resolved.support)
            )
            if len(self._setups) > _KEPT_SETUPS:
                self._setups.popitem(last=False)
        self._setups.move_to_end(key)
        return self._setups[key]

    def _shelves(self, resolved: ResolvedTrial, config: ProblemConfig) -> Shelves:
        """What the trial's blocks draw their objects from; the latest are kept."""
        spec = resolved.trial.spec
        key = (config, spec.keep_out)
        if self._drawn is None or self._drawn[0] != key:
            pool = resolved.pool.select(config.objects) if config.objects else resolved.pool
            self._drawn = (key, Shelves(pool, config, resolved.support, spec.boxes()))
        return self._drawn[1]


@dataclass(frozen=True)
class RowMaker:
    """Makes rows in another process, which finds what trials name as this one does; see `Runner`."""

    checkpoints: Checkpoints
    engine: str
    num_threads: int

    def __call__(self) -> Callable[[Trial], tuple[str, Any]]:
        """The function that is given a trial: its key, and `Runner.make` of it, or why it cannot be made."""
        runner = Runner(Store(None), self.checkpoints, self.engine, self.num_threads)

        def make(trial: Trial) -> tuple[str, Any]:
            resolved = runner.resolve(trial)
            try:
                return resolved.key, runner.make(resolved)
            except ClutterGenError as error:
                return resolved.key, error

        return make
