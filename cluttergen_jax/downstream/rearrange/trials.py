"""Trials of rearrangement: starting scenes by setting and seed, episodes one after another, resumable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from cluttergen_jax.assets import find_pool
from cluttergen_jax.config import FilmFormat
from cluttergen_jax.downstream.digests import constants_hash
from cluttergen_jax.downstream.episodes import layout_judge
from cluttergen_jax.downstream.rearrange import episode, layouts, observe, order, task
from cluttergen_jax.downstream.rearrange.episode import rearrange_episode
from cluttergen_jax.downstream.rearrange.layout_views import save_sheets
from cluttergen_jax.downstream.rearrange.observe import Observer, TrueObserver
from cluttergen_jax.downstream.rearrange.starts import OwnScenes, Starts, is_bank, task_words
from cluttergen_jax.downstream.rearrange.task import (
    Chooser,
    RearrangeOptions,
    RearrangeProblem,
    RearrangeResult,
    RearrangeSetting,
)
from cluttergen_jax.downstream.robot import (
    EPISODES,
    STARTS,
    Endings,
    GraspSets,
    GraspSource,
    PathPlanner,
    RecordAsked,
    RobotDescription,
    Trace,
    episode_seed,
    find_robot,
    make_episodes,
    planner_hash,
    planner_recipe,
    success_of,
)
from cluttergen_jax.evaluation import versions
from cluttergen_jax.kept_folder import hold_out
from cluttergen_jax.own_parts import is_own, part_label
from cluttergen_jax.statistics import share_of
from cluttergen_jax.stores import RowStore
from cluttergen_jax.tables import aligned_table

_ADDED = ("grasps", "objects", "planner", "registration", "robot")
"""Of recipes: what the published rows (reports/results/episodes) lack."""


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
            looks, path, seconds, cpu = (
                np.mean([getattr(row, name) for row in rows]) for name in names
            )
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
    right = [
        is_right
        for row in rows
        for each, is_right in zip(row.objects, row.right, strict=True)
        if each == name
    ]
    return str(len(right)), str(sum(right))


@cache
def rearrange_hash() -> str:
    """Hex digest of how rearrangements are planned, done and judged, but for what an observer does."""
    return constants_hash(episode, layout_judge, layouts, observe, order, task, arm=planner_hash())


@hold_out
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
    own: OwnScenes | None = None,
    told_own: Mapping[str, object] | None = None,
    record: RecordAsked | None = None,
    robot: RobotDescription | None = None,
) -> Rearrangements:
    """Runs episodes of a setting.

    Args:
      out: the folder in which rows are kept, each as soon as it is made; None keeps none.
      observer: tells where things are; the true poses if not given.
      num_threads: of the simulation of layouts and the tests of grasps; 0 takes every core.
      ask: a person, who chooses the layouts.
      films: film the first episode of each outcome in the folder `films` of `out` (`Films`).
      own_grasps, planner, own: a user's; told_own: what a recipe says of `own`.
      record: where and how every episode is recorded; scenes that are in no bank are written beside it.
      sheets: draw the layouts of each episode as `out`/layouts-NUMBER.png (`layout_sheet`).
      robot: that does it; the Panda if not given.

    Raises:
      BankError: another process writes to `out`, it holds rows of other settings, grasps or weights, a
        damaged file, or a film shows another end.
      ConfigError: the pool has too few objects.
      RendererError: pictures are asked for, and nothing here can draw.
    """
    observer = observer or TrueObserver()
    told = getattr(observer, "name", type(observer).__name__)
    recipe = {
        "setting": setting.name,
        "pool": pool,
        "seed": seed,
        **asdict(options),
        **(told_own or {}),
    }
    recipe["observer"] = part_label(observer, "observer") if is_own(observer) else told
    recipe |= {name: getattr(observer, name, "") for name in ("weights", "registration")}
    robot = robot or find_robot()
    # Those of a bank are told by the bank.
    objects = find_pool(pool).hash if own is None or own.bank is None else ""
    recipe |= {"robot": robot.hash, "objects": objects, "versions": versions()}
    recipe["planner"] = planner_recipe(rearrange_hash(), planner)
    if ask is not None:
        recipe["choose"] = "person"
    path = None if out is None else out / EPISODES
    file = RowStore(path, recipe, RearrangeResult, "rearrange", _ADDED)
    rows = file.read(number)
    # Where nothing is left to be done it is not made.
    starts = cache(lambda: Starts(setting, pool, num_threads, own_grasps, planner, own, robot))

    @cache
    def task_of(index: int) -> RearrangeProblem:
        task = starts()(episode_seed(seed, index), index)
        file.note_grasps({each.name: each.digest for each in task.grasps})
        return task

    goals = "" if own is None else own.goals

    def with_words(row: RearrangeResult, trace: Trace | None) -> RearrangeResult:
        if trace is not None and goals and not is_bank(goals):
            trace.words = task_words(goals)(row)
        return row

    def again(index: int, trace: Trace) -> RearrangeResult:
        # What a person chose is not asked for again.
        given = options if ask is None else replace(options, layout=rows[index].layout)
        return with_words(rearrange_episode(task_of(index), given, observer, trace), trace)

    def run(index: int, trace: Trace | None = None) -> RearrangeResult:
        return with_words(rearrange_episode(task_of(index), options, observer, trace, ask), trace)

    def note(rows: list[RearrangeResult]) -> str:
        return f"{sum(row.is_success for row in rows)} of {len(rows)} good, the last: {rows[-1].outcome}"

    recorder = None
    if record is not None:
        bank = None if own is None else own.bank
        if bank is None:
            scenes = [task_of(index).scene for index in range(number)]
            bank = starts().write_bank(record.folder / STARTS, scenes, seed)
        recorder = record.open("rearrange", str(bank.path), robot, recipe)
    make_episodes(file, rows, number, run, setting.name, note, out, films, recorder, again)
    if out is not None and sheets:
        save_sheets(rows, task_of, options, observer, out)
    return Rearrangements(setting.name, told, tuple(rows))
