"""The runner of trials: runs their episodes, makes and keeps their rows; worlds and programs are made once.

A row has figures, plain JSON, of what became of its episodes, every attempt of which is logged.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import struct

from cluttergen_jax.assets.sense import read_sense
from cluttergen_jax.assets.support_map import check_region
from cluttergen_jax.cluster import Cluster, each_on
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ClutterGenError, ConfigError
from cluttergen_jax.evaluation.records import Figures, Row, Share, Spread, origin
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
from cluttergen_jax.judging.sense import find_usual_pairs
from cluttergen_jax.learning.methods import Method, block_sampler_of, with_history_of
from cluttergen_jax.numerics import new_key
from cluttergen_jax.physics import engine_of, make_physics
from cluttergen_jax.physics.host import NumberedEngines, Physics
from cluttergen_jax.physics.margin import count_beside
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.boxes import footprint_area
from cluttergen_jax.placement.problem import Problem, ProblemConfig, Setup, make_setup
from cluttergen_jax.placement.rollout import BLOCK_SIZE, BlockSampler, Rollout, blocks_of
from cluttergen_jax.placement.room import area_asked, check_surface
from cluttergen_jax.placement.scenes import SceneBatch
from cluttergen_jax.placement.shelves import Shelves
from cluttergen_jax.placement.types import Episode, Transition
from cluttergen_jax.placement.world import World
from cluttergen_jax.progress import Progress, interruptible
from cluttergen_jax.statistics import proportion, spread_of, wilson
from cluttergen_jax.types import Array, Verdict

_KEPT_SETUPS = 4


@dataclass(eq=False)
class Runner:
    """Runs trials and remembers them.

    Attributes:
      store: results on disk.
      checkpoints: where policies are.
      engine: "auto", "native", "warp" or "jax"; num_threads: of the native engine, 0 for every core.
      is_fresh: do not use rows that were kept.
      measured_at: when and where the findings that `measure` has returned were made (`records.origin`).
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
        self._shared: dict[tuple[int, StabilityConfig, int], tuple[NumberedEngines, Physics]] = {}
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
          `trial`, `sources`, `policy`, `figures` (`figures_of`; `paper` among them is the looser
          count), `rules` with all defaults decided, `first` scenes (`first_of`), and `date`, `machine` and
          `commit` of its making, which rows of older versions lack; or `trial`,
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
        # Where each block has objects of its own they are not looked at.
        if not self._config(resolved).shelf:
            figures |= self._scene_figures(resolved, strict.scenes)
        if resolved.trial.paper_count:
            loose = self.run(resolved, judge_neighbours=False)
            figures["paper"] = figures_of(loose, has_last_check=False)
        row: Row = {
            "trial": resolved.trial.record(),
            "sources": resolved.sources,
            "policy": resolved.policy,
            "rules": resolved.rules,
            "first": first_of(strict.scenes),
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
        """The scenes and attempts of a trial (`arrays_of`), made now if they are not there.

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
                {name: known[name] for name in ("date", "machine", "commit") if name in known}
            )
            return known["figures"]
        self.begin(title)
        found = interruptible(make)
        self.measured_at.append(origin())
        figures = self.store.keep(title, key, found, self.measured_at[-1])
        self.say(f"{title}: done")
        return figures

    def run(self, resolved: ResolvedTrial, judge_neighbours: bool = True) -> EpisodeOutcomes:
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

    def first_scenes(self, trial: Trial) -> dict[str, list[int]]:
        """What becomes of a trial's first scenes now, whatever was kept, among as many as its row's were.

        Raises:
          ConfigError: its blocks have objects of their own.
          ClutterGenError: it cannot be made.
        """
        resolved = self.resolve(trial)
        if self._config(resolved).shelf:
            raise ConfigError(
                f"first scenes of {trial.title}", "rows whose objects are the same in all blocks"
            )
        place = np.arange(width_of(trial.trials))
        number = min(NUM_FIRST, trial.trials)
        sampler = self.sampler(resolved)
        scenes = self.rollout.run(sampler, new_key(trial.seed), place, place < number)
        return first_of(jax.tree.map(lambda leaf: leaf[:number], scenes))

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
            sampler = block_sampler_of(method, rules, *begins)
        return sampler

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

    def _scene_figures(self, resolved: ResolvedTrial, scenes: SceneBatch) -> Figures:
        """Who carries whom, and what touches from the side, in the trial's scenes that stand."""
        place = np.flatnonzero(scenes.is_success)[:_MOST_SENSED]
        arrays = (scenes.object_index[place], scenes.is_placed[place], scenes.poses[place])
        world = self.world(resolved)
        found = find_usual_pairs(world, *arrays, read_sense(resolved.config.placement.sense))
        beside = count_beside(world.layout, *arrays).sum() / max(scenes.is_placed[place].sum(), 1)
        return {
            "usual_pairs": found.usual_pairs,
            "num_pairs": len(found.usual) + len(found.unusual),
            "side_contacts": float(beside) if len(place) else None,
        }

    def _physics(self, world: World, config: ProblemConfig) -> Physics:
        """The engine of a world. Worlds of equal sizes share what is compiled around a native one.

        A shared one drives the world asked for last: one is at work at a time.
        """
        stability = config.stability
        engine = make_physics(world.layout, stability, config.engine, self.num_threads)
        if not isinstance(engine, NativePhysics):
            return engine
        num_doors = 0 if world.doors is None else len(world.doors.names)
        sizes = (world.num_objects, stability, num_doors)
        if sizes not in self._shared:
            engines = NumberedEngines(world.num_objects, stability, num_doors=num_doors)
            self._shared[sizes] = engines, engines.with_number(np.int32(0))
        engines, physics = self._shared[sizes]
        engines.put(engine)
        return physics

    def _config(self, resolved: ResolvedTrial, judge_neighbours: bool = True) -> ProblemConfig:
        """The trial's problem on the runner's engine, judged as its method and its count ask."""
        trial = resolved.trial
        engine = "native" if resolved.config.needs_native else self.engine
        config = replace(resolved.config, engine=engine, num_threads=self.num_threads)
        stability = replace(
            config.stability,
            stop_when_decided=resolved.is_cut and not trial.whole_attempts,
            judge_neighbours=judge_neighbours,
        )
        has_two = engine_of(engine, stability) == "native"
        is_usual = trial.spec.setting != "paper" and has_two
        return replace(
            config,
            stability=replace(stability, both_detectors=is_usual, decide_alone=is_usual),
        )

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


def open_runner(
    folder: Path | None,
    trials: Sequence[Trial],
    checkpoint: str | Path | None,
    checkpoints: str | Path | None,
    engine: str,
    num_threads: int,
    fresh: bool,
) -> Runner:
    """A runner that knows how much is left to do; what cannot be found is said before anything runs."""
    where = Checkpoints(
        folder=None if checkpoints is None else Path(checkpoints),
        path=None if checkpoint is None else Path(checkpoint),
    )
    runner = Runner(Store(folder and folder / "results"), where, engine, num_threads, fresh)
    runner.plan(trials)
    if folder is not None:
        # Before hours of work: a place that cannot be written to.
        folder.mkdir(parents=True, exist_ok=True)
    return runner


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


_MOST_SENSED = 256
"""Scenes of a trial, at most, in which it is looked what carries what."""
_WIDTHS = (16, 64, BLOCK_SIZE)
"""Few, so that programs are shared; wide enough for what is asked."""


class Attempts(struct.PyTreeNode):
    """Attempts in the order in which they were made. M attempts.

    Attributes:
      scene, slot, object_index, ordinal: i32[M], as of `Transition`; the first of an object's turn is 1.
      steps: i32[M], simulated; is_stable: bool[M].
      action: f32[M, 4], what was proposed.
      is_made: bool[M]; on the host, all of them.
    """

    scene: Array
    slot: Array
    object_index: Array
    ordinal: Array
    steps: Array
    is_stable: Array
    action: Array
    is_made: Array


@dataclass(frozen=True, eq=False)
class EpisodeOutcomes:
    """What became of N episodes.

    Attributes:
      scenes: NumPy arrays with a leading axis N.
      attempts: all of them.
      seconds, cpu_seconds: wall and process time of sampling, compilation left out.
      compile_seconds: wall time of tracing, compilation and a step in which no attempt is made.
    """

    scenes: SceneBatch
    attempts: Attempts
    seconds: float
    cpu_seconds: float
    compile_seconds: float


def width_of(num_scenes: int) -> int:
    """How many episodes are run side by side."""
    return next(each for each in _WIDTHS if each >= min(num_scenes, BLOCK_SIZE))


def run_episodes(
    rollout: Rollout,
    sampler: BlockSampler,
    num_scenes: int,
    seed: int,
    on_done: Callable[[int], None] = lambda number: None,
) -> EpisodeOutcomes:
    """Scenes 0 to num_scenes - 1 of `seed`: those of `rollout.sample_blocks`, with a log of attempts.

    Args:
      rollout: one that sees `attempts_of` each step.
      on_done: told how many more episodes are over.
    """
    width = width_of(num_scenes)
    started = time.perf_counter()
    key = new_key(seed)
    rollout.compile(sampler, key, np.arange(width), is_refilled=num_scenes > width)
    compiled = time.perf_counter()
    cpu = time.process_time()
    made: list[Attempts] = []

    note = partial(_note, made, on_done)
    scenes = rollout.run_all(sampler, key, num_scenes, width, note)
    return EpisodeOutcomes(
        scenes=scenes,
        attempts=jax.tree.map(lambda *leaves: np.concatenate(leaves), *made),
        seconds=time.perf_counter() - compiled,
        cpu_seconds=time.process_time() - cpu,
        compile_seconds=compiled - started,
    )


def run_shelves(
    rollout: Rollout,
    sampler_of: Callable[[int], tuple[BlockSampler, np.ndarray]],
    num_scenes: int,
    seed: int,
    on_done: Callable[[int], None] = lambda number: None,
) -> EpisodeOutcomes:
    """`run_episodes` in worlds of which each block has its own.

    Args:
      sampler_of: gives a block's sampler, and i32[K], the numbers of its objects in the pool: `object_index`
        of what is returned is about the pool.
    """
    outcomes = []
    for block, rows in blocks_of(num_scenes):
        sampler, numbers = sampler_of(block)
        place = np.arange(BLOCK_SIZE)
        indices = block * BLOCK_SIZE + place
        started = time.perf_counter()
        key = new_key(seed)
        rollout.compile(sampler, key, indices, is_refilled=False)
        compiled = time.perf_counter()
        cpu = time.process_time()
        made: list[Attempts] = []
        # A block is run to its end before the next one's world is made.
        note = partial(_note, made, on_done, indices)
        scenes = rollout.run(sampler, key, indices, place < rows, note)
        scenes = jax.tree.map(lambda leaf, rows=rows: leaf[:rows], scenes)
        attempts = jax.tree.map(lambda *leaves: np.concatenate(leaves), *made)
        index = np.asarray(scenes.object_index)
        scenes = scenes.replace(object_index=np.where(index < 0, -1, numbers[index]))
        attempts = attempts.replace(object_index=numbers[attempts.object_index])
        seconds = time.perf_counter() - compiled
        outcomes.append(
            EpisodeOutcomes(
                scenes, attempts, seconds, time.process_time() - cpu, compiled - started
            )
        )
    join = partial(jax.tree.map, lambda *leaves: np.concatenate(leaves))
    return EpisodeOutcomes(
        scenes=join(*(each.scenes for each in outcomes)),
        attempts=join(*(each.attempts for each in outcomes)),
        seconds=sum(each.seconds for each in outcomes),
        cpu_seconds=sum(each.cpu_seconds for each in outcomes),
        compile_seconds=sum(each.compile_seconds for each in outcomes),
    )


def _note(
    made: list[Attempts],
    on_done: Callable[[int], None],
    indices: np.ndarray,
    number: int,
    attempts: Attempts,
) -> None:
    """Keeps the attempts of a step, with the scenes in whose episodes they were made."""
    attempts = attempts.replace(scene=indices.astype(np.int32))
    made.append(jax.tree.map(lambda leaf: leaf[attempts.is_made], attempts))
    on_done(number)


def attempts_of(before: Episode, after: Episode, transition: Transition) -> Attempts:
    """What is logged of a step; which scenes its episodes are, is filled in later."""
    return Attempts(
        scene=transition.slot,
        slot=transition.slot,
        object_index=transition.object_index,
        ordinal=transition.ordinal,
        steps=transition.settling.num_steps,
        is_stable=transition.verdict == Verdict.STABLE,
        action=transition.action,
        is_made=transition.is_made,
    )


LEAST_ATTEMPTS = 3
"""Placements that needed fewer say nothing about attempts (paper, figure on stable steps)."""


def figures_of(outcome: EpisodeOutcomes, has_last_check: bool = True) -> Figures:
    """Success, objects placed, attempts, steps and speed of one run.

    Args:
      has_last_check: success means that the finished scene stands; else that every slot was filled, which is
        all that the paper's looser count asks.
    """
    scenes = outcome.scenes
    counts = outcome.scenes.counts
    good = scenes.is_success if has_last_check else scenes.is_filled
    number = len(good)
    valid = int(good.sum())
    low, high = wilson(valid, number)
    placed = scenes.is_placed.sum(1)
    num_slots = scenes.is_placed.shape[1]
    simulated = int(counts.simulated_steps.sum())
    return {
        "trials": number,
        "num_success": valid,
        "success": valid / number,
        "low95": low,
        "high95": high,
        "filled": float(scenes.is_filled.mean()),
        "placed": float(placed.mean()),
        "placed_histogram": np.bincount(placed, minlength=num_slots + 1).tolist(),
        "attempts": int(counts.attempts.sum()),
        "within": within(good, counts.attempts.sum(1), num_slots),
        "attempts_per_valid_scene": per_scene(int(counts.attempts.sum()), valid),
        "attempts_histogram": np.bincount(counts.attempts[scenes.is_placed], minlength=2).tolist(),
        "simulated_steps": simulated,
        "simulated_steps_per_valid_scene": per_scene(simulated, valid),
        "stack": spread_of(np.sum(np.asarray(scenes.level) > 0, axis=1)[good]),
        "stable_steps": spread_of(counts.steps[scenes.is_placed]),
        "rest_steps": spread_of(counts.rest_steps[scenes.is_placed]),
        "steps_by_attempt": steps_by_attempt(outcome.attempts),
        "verdicts": {Verdict(code).label: int(n) for code, n in enumerate(counts.verdicts.sum(0))},
        "num_crept": int((scenes.verdict == Verdict.CREPT).sum()),
        "seconds": outcome.seconds,
        "cpu_seconds": outcome.cpu_seconds,
        "compile_seconds": outcome.compile_seconds,
        "valid_scenes_per_second": valid / outcome.seconds,
        "valid_scenes_per_cpu_second": valid / outcome.cpu_seconds if outcome.cpu_seconds else None,
    }


NUM_FIRST = 16
"""Scenes of a row by which it is seen whether a later version makes the same ones."""


def first_of(scenes: SceneBatch) -> dict[str, list[int]]:
    """What became of the first scenes: attempts of each, objects placed, and whether it succeeded."""
    return {
        "attempts": scenes.counts.attempts.sum(1)[:NUM_FIRST].tolist(),
        "placed": scenes.is_placed.sum(1)[:NUM_FIRST].tolist(),
        "success": scenes.is_success[:NUM_FIRST].astype(int).tolist(),
    }


def per_scene(total: int, num_scenes: int) -> float | None:
    """What each scene has cost; None where there is none."""
    return total / num_scenes if num_scenes else None


WITHIN = (1.0, 1.5, 5.0)
"""Attempts in all, in objects of a scene, within which scenes are counted as finished."""


def within(is_good: np.ndarray, attempts: np.ndarray, num_objects: int) -> list[Share]:
    """Scenes that were finished with few attempts, rejected ones included.

    Args:
      is_good: bool[N], scenes that succeeded; attempts: i[N], of each scene in all.

    Returns:
      For each of `WITHIN`: `times`, `share` and its 95 % interval, `low95` and `high95`.
    """
    return [
        {"times": each, **proportion(is_good & (attempts <= each * num_objects))} for each in WITHIN
    ]


def steps_by_attempt(attempts: Attempts) -> list[Spread]:
    """Steps of the first attempt, the second and so on, over placements that took at least three.

    A placement is a turn of an object that ended with it in place.

    Returns:
      One entry per attempt number: `attempt` and the spread of steps.
    """
    if not len(attempts.scene):
        return []
    # Turns of one object after another: a slot may have several, where objects are taken away again.
    order = np.argsort(attempts.scene, kind="stable")
    turn = np.empty(len(order), np.int64)
    turn[order] = np.cumsum(attempts.ordinal[order] == 1)
    size = int(turn.max()) + 1
    is_filled = np.zeros(size, bool)
    is_filled[turn[attempts.is_stable]] = True
    is_long = np.bincount(turn, minlength=size) >= LEAST_ATTEMPTS
    chosen = (is_filled & is_long)[turn]
    most = int(attempts.ordinal[chosen].max(initial=0))
    return [
        {"attempt": number, **spread_of(attempts.steps[chosen & (attempts.ordinal == number)])}
        for number in range(1, most + 1)
    ]


def arrays_of(outcome: EpisodeOutcomes) -> dict[str, np.ndarray]:
    """What measures of scenes need, to be stored beside the figures. N scenes, S slots, M attempts."""
    scenes = outcome.scenes
    attempts = outcome.attempts
    return {
        "object_index": scenes.object_index,
        "is_placed": scenes.is_placed,
        "poses": scenes.poses,
        "level": scenes.level,
        "is_success": scenes.is_success,
        "is_filled": scenes.is_filled,
        "attempt_scene": attempts.scene,
        "attempt_slot": attempts.slot,
        "attempt_object": attempts.object_index,
        "attempt_ordinal": attempts.ordinal,
        "attempt_steps": attempts.steps,
        "attempt_is_stable": attempts.is_stable,
        "attempt_action": attempts.action,
    }
