"""Trials of rearrangement: starting scenes by setting and seed, episodes one after another, resumable."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.symmetry import turn_symmetry
from cluttergen_jax.config import FilmFormat
from cluttergen_jax.downstream.digests import constants_hash
from cluttergen_jax.downstream.parts import is_own, part_label
from cluttergen_jax.downstream.rearrange import episode, judge, layouts, moves, observe, order, task
from cluttergen_jax.downstream.rearrange.episode import rearrange_episode
from cluttergen_jax.downstream.rearrange.layouts import ReachCheck, SceneDraw
from cluttergen_jax.downstream.rearrange.observe import Observer, TrueObserver
from cluttergen_jax.downstream.rearrange.order import Meetings
from cluttergen_jax.downstream.rearrange.sheet import save_sheets
from cluttergen_jax.downstream.rearrange.task import (
    Chooser,
    RearrangeOptions,
    RearrangeResult,
    RearrangeSetting,
    RearrangeTask,
)
from cluttergen_jax.downstream.robot.film import FILMS, film_firsts
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps, GraspSets
from cluttergen_jax.downstream.robot.grasping.own_grasps import GraspFinder
from cluttergen_jax.downstream.robot.motion.execute import Trace
from cluttergen_jax.downstream.robot.outcome import Endings, success_of
from cluttergen_jax.downstream.robot.protocols import GraspSource, PathPlanner
from cluttergen_jax.downstream.robot.trials import EPISODES, episode_seed, planner_hash, planner_recipe
from cluttergen_jax.downstream.rows import RowFile, share_of
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.machine import versions
from cluttergen_jax.scene import Scene
from cluttergen_jax.tables import aligned_table

_MOST_DRAWS = 16
_ADDED = ("grasps", "objects", "planner", "registration")
"""Of recipes: what files of older versions lack."""


class Starts:
    """Starting scenes of a setting: each is made again by its seed.

    Args:
      setting: the setting. pool: a pool's name.
      num_threads: of the simulation and the tests of grasps; 0 takes every core.
      own_grasps, planner: a user's.
    """

    def __init__(
        self,
        setting: RearrangeSetting,
        pool: str,
        num_threads: int,
        own_grasps: GraspSource | GraspSets | None = None,
        planner: PathPlanner | None = None,
    ) -> None:
        self.setting, self._pool, self._planner = setting, pool, planner
        self._num_threads = num_threads or os.cpu_count() or 1
        self._find_grasps = GraspFinder(own_grasps, self._num_threads)
        self._grasps: dict[str, Grasps] = {}
        self._symmetry = cache(turn_symmetry)

    # Compiled when the first scene is asked for.

    @cached_property
    def _place(self) -> SceneDraw:
        return SceneDraw(self._pool, "clear", self.setting.num_slots, self._num_threads)

    @cached_property
    def _start(self) -> SceneDraw:
        method = self.setting.method
        if method == "clear":
            return self._place
        return SceneDraw(self._pool, method, self.setting.num_slots, self._num_threads)

    def __call__(self, seed: int) -> RearrangeTask:
        """What is to be rearranged.

        Raises:
          ConfigError: the pool has too few objects, or no starting scene was found.
        """
        setting, place = self.setting, self._place
        rng = np.random.default_rng(seed)
        for _ in range(_MOST_DRAWS):
            numbers = rng.permutation(len(place.objects))[: setting.num_slots].tolist()
            moved, others = numbers[: setting.num_objects], numbers[setting.num_objects :]
            stay = np.zeros((0, 7))
            if others:
                found = place(_draw_seed(rng), others, setting.target)
                if not len(found):
                    continue
                stay = found[0]
            objects = tuple(place.objects[each] for each in numbers)
            scenes = self._start(_draw_seed(rng), moved, setting.start, others, stay)
            for poses in scenes:
                scene = Scene(
                    tuple(each.name for each in objects),
                    objects,
                    np.concatenate([poses, stay]),
                    place.support,
                )
                grasps, symmetry = self._grasps_of(objects), tuple(map(self._symmetry, objects))
                if setting.num_stacked and not is_stacked(scene, grasps, setting.num_stacked):
                    continue
                seed, known = _draw_seed(rng), (tuple(numbers), grasps, symmetry, place)
                return RearrangeTask(setting, scene, *known, seed, self._planner)
        raise ConfigError(f"no starting scene of {setting.name!r}", "smaller objects", "another pool")

    def _grasps_of(self, objects: Sequence[ObjectAsset]) -> tuple[Grasps, ...]:
        """Of each object, found when it is first asked for."""
        fresh = [each for each in objects if each.name not in self._grasps]
        if fresh:
            found = self._find_grasps(fresh)
            self._grasps.update(zip((each.name for each in fresh), found, strict=True))
        return tuple(self._grasps[each.name] for each in objects)


def _draw_seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**30))


def is_stacked(scene: Scene, grasps: Sequence[Grasps], number: int) -> bool:
    """Whether so many objects lie on others, and the arm gets at those of them on which nothing lies.

    A ring that fell over what it lies on is an example of what no hand can take.

    Args:
      grasps: of each object of the scene.
    """
    lies_on = Meetings(scene.objects).relations(scene.poses, scene.poses).lies_on
    top = np.flatnonzero(lies_on.any(1) & ~lies_on.any(0)).tolist()
    if lies_on.any(1).sum() < number:
        return False
    return ReachCheck(scene.objects, grasps, top, scene.support)(scene.poses) == 1


@dataclass(frozen=True, eq=False)
class Rearrangements(Endings):
    """What became of episodes of one setting.

    Attributes:
      setting: its name. observer: what told the arm where things are.
      rows: of each episode, in order; episode k is made again by its seed alone.
    """

    setting: str
    observer: str
    rows: tuple[RearrangeResult, ...]

    def __str__(self) -> str:
        """Rates, causes, and what an episode costs."""
        rows = self.rows
        lines = [f"{self.setting}, {self.observer}: {success_of(rows)} of all episodes"]
        right = [each for row in rows for each in row.right]
        lines.append(f"objects where they should be: {share_of(sum(right), len(right))}")
        lines += self.causes()
        good = [row for row in rows if row.is_success]
        if good:
            over = sum(row.picks - row.fewest for row in good)
            lines.append(
                f"where it succeeded: {np.mean([row.picks for row in good]):.1f} picks, {over} more in all "
                f"than the fewest possible, {sum(row.waits for row in good)} of them to wait; at most "
                f"{1e3 * max(row.error for row in good):.1f} mm and "
                f"{np.degrees(max(row.turn_error for row in good)):.1f} deg from the layout"
            )
        if rows:
            names = ("looks", "path", "seconds", "cpu")
            looks, path, seconds, cpu = (np.mean([getattr(row, name) for row in rows]) for name in names)
            lines.append(
                f"an episode: {looks:.0f} looks at all objects, {path:.1f} m of the tool, {seconds:.0f} s "
                f"simulated, {cpu:.1f} CPU-s"
            )
        table = [
            (name, *_object_row(rows, name))
            for name in sorted({name for row in rows for name in row.objects})
        ]
        return "\n".join([*lines, "", aligned_table(("object", "moved", "right"), table)])


def _object_row(rows: Sequence[RearrangeResult], name: str) -> tuple[str, str]:
    right = [row.right[row.objects.index(name)] for row in rows if name in row.objects]
    return str(len(right)), str(sum(right))


@cache
def rearrange_hash() -> str:
    """Hex digest of how rearrangements are planned, done and judged, but for what an observer does."""
    return constants_hash(episode, judge, layouts, moves, observe, order, task, arm=planner_hash())


def run_rearrangements(
    setting: RearrangeSetting,
    options: RearrangeOptions,
    number: int,
    seed: int,
    out: Path | None,
    *,
    pool: str = "household",
    observer: Observer | None = None,
    num_threads: int = 1,
    ask: Chooser | None = None,
    films: FilmFormat | None = None,
    sheets: bool = False,
    own_grasps: GraspSource | GraspSets | None = None,
    planner: PathPlanner | None = None,
) -> Rearrangements:
    """Runs episodes of a setting.

    Args:
      out: the folder in which rows are kept, each as soon as it is made; None keeps none.
      observer: tells where things are; the true poses if not given.
      num_threads: of the simulation of layouts and the tests of grasps; 0 takes every core.
      ask: a person, who chooses the layouts.
      films: film the first episode of each outcome in the folder `films` of `out` (`film_firsts`).
      own_grasps, planner: a user's.
      sheets: draw the layouts of each episode as `out`/layouts-NUMBER.png (`layout_sheet`).

    Raises:
      BankError: the folder holds rows of other settings, grasps or weights, a damaged file, or a film shows
        another end.
      ConfigError: the pool has too few objects.
      RendererError: pictures are asked for, and nothing here can draw.
    """
    observer = observer or TrueObserver()
    told = getattr(observer, "name", type(observer).__name__)
    recipe = {"setting": setting.name, "pool": pool, "seed": seed, **asdict(options)}
    recipe["observer"] = part_label(observer, "observer") if is_own(observer) else told
    recipe |= {name: getattr(observer, name, "") for name in ("weights", "registration")}
    recipe |= {"objects": find_pool(pool).hash, "versions": versions()}
    recipe["planner"] = planner_recipe(rearrange_hash(), planner)
    if ask is not None:
        recipe["choose"] = "person"
    file = RowFile(None if out is None else out / EPISODES, recipe, RearrangeResult, "rearrange", _ADDED)
    rows = file.read(number)
    # Where nothing is left to be done it is not made.
    starts = cache(lambda: Starts(setting, pool, num_threads, own_grasps, planner))

    def task_of(index: int) -> RearrangeTask:
        task = starts()(episode_seed(seed, index))
        file.note_grasps({each.name: each.digest for each in task.grasps})
        return task

    def again(index: int, trace: Trace) -> RearrangeResult:
        # What a person chose is not asked for again.
        given = options if ask is None else replace(options, layout=rows[index].layout)
        return rearrange_episode(task_of(index), given, observer, trace)

    def run(index: int) -> RearrangeResult:
        return rearrange_episode(task_of(index), options, observer, ask=ask)

    def note(rows: list[RearrangeResult]) -> str:
        return f"{sum(row.is_success for row in rows)} of {len(rows)} good, the last: {rows[-1].outcome}"

    file.complete(rows, number, run, setting.name, note=note)
    if out is not None and sheets:
        save_sheets(rows, task_of, options, observer, out)
    if out is not None and films is not None:
        film_firsts(rows, again, out / FILMS, films, setting.name)
    return Rearrangements(setting.name, told, tuple(rows))
