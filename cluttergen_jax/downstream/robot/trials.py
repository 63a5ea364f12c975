"""Trials: episodes over scenes of a bank, one after another, resumable; causes of failure are counted."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.config import FilmFormat
from cluttergen_jax.downstream.digests import constants_hash
from cluttergen_jax.downstream.robot import cameras, episode, gripper, model, sensing_arm
from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot
from cluttergen_jax.downstream.robot.episode import EpisodeResult, robot_episode
from cluttergen_jax.downstream.robot.film import FILMS, Films
from cluttergen_jax.downstream.robot.grasping import grips
from cluttergen_jax.downstream.robot.grasping.grasps import GraspFinder, Grasps, GraspSets
from cluttergen_jax.downstream.robot.motion import (
    collision,
    execute,
    ik,
    mover,
    plan,
)
from cluttergen_jax.downstream.robot.motion.execute import Trace
from cluttergen_jax.downstream.robot.outcome import Endings, Outcome, causes_of, success_of
from cluttergen_jax.downstream.robot.places import CameraPlacer
from cluttergen_jax.downstream.robot.protocols import GraspSource, PathPlanner
from cluttergen_jax.downstream.robot.recorder import DemonstrationRecorder
from cluttergen_jax.downstream.words import RobotTask
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.evaluation import versions
from cluttergen_jax.geometry import rotation_matrix
from cluttergen_jax.kept_folder import hold_out
from cluttergen_jax.own_parts import part_label
from cluttergen_jax.scene import Scene
from cluttergen_jax.stores import RowStore
from cluttergen_jax.tables import aligned_table

EPISODES = "episodes.jsonl"
_ADDED = ("grasps", "planner", "robot", "versions", "weights")
"""Of recipes: what the published rows (reports/results/episodes) lack."""
_UPRIGHT = math.cos(math.radians(3.0))
Places = Callable[[int, Scene], np.ndarray]
"""Where the last object of a scene may stand: f64[M, 7], T_world_object, best first."""


@dataclass(frozen=True, eq=False)
class RobotTrials(Endings):
    """What became of episodes.

    Attributes:
      task: "lift" or "place".
      rows: of each episode, in order; episode k is made again by its seed alone.
    """

    task: str
    rows: tuple[EpisodeResult, ...]

    @property
    def possible(self) -> tuple[EpisodeResult, ...]:
        """The episodes in which a grasp free of contact was reached."""
        return tuple(
            row for row in self.rows if row.outcome not in (Outcome.NO_GRASP, Outcome.NO_IK)
        )

    def __str__(self) -> str:
        """Causes, a row for each object, and how exactly things were put down."""
        lines = [f"{self.task}: {success_of(self.rows)} of all episodes"]
        if len(self.possible) < len(self.rows):
            lines.append(
                f"{self.task}: {success_of(self.possible)} where a grasp free of contact was reached"
            )
        lines += self.causes()
        put = [row for row in self.rows if np.isfinite(row.error)]
        if put:
            error, turn = np.array([(1e3 * row.error, np.degrees(row.turn_error)) for row in put]).T
            lines.append(
                f"put down {np.median(error):.1f} mm and {np.median(turn):.1f} deg from where it was meant "
                f"to stand (median), at most {error.max():.1f} mm and {turn.max():.1f} deg"
            )
        cpu = np.mean([row.cpu for row in self.rows]) if self.rows else 0.0
        lines.append(f"{cpu:.1f} CPU-s an episode")
        names = sorted({row.object for row in self.rows})
        table = [
            (name, *_object_row([row for row in self.rows if row.object == name])) for name in names
        ]
        return "\n".join(
            [*lines, "", aligned_table(("object", "episodes", "success", "failures"), table)]
        )


def _object_row(rows: Sequence[EpisodeResult]) -> tuple[str, str, str]:
    return str(len(rows)), str(sum(row.is_success for row in rows)), causes_of(rows)


def keep_upright_last(scenes: Sequence[Scene]) -> list[Scene]:
    """The scenes whose last object stands upright, to 3 degrees; others may lie.

    Raises:
      ConfigError: there is none.
    """
    kept = [each for each in scenes if rotation_matrix(each.poses[-1, 3:])[2, 2] > _UPRIGHT]
    if scenes and not kept:
        raise ConfigError(
            f"{len(scenes)} scenes whose last object lies, for a robot that places it upright",
            "scenes whose last object is upright, whatever the others are",
            "a larger bank, or one of `cluttergen generate` with --poses upright",
        )
    if len(kept) < len(scenes):
        left = len(scenes) - len(kept)
        print(f"left out   {left} of {len(scenes)} scenes, whose last object lies", file=sys.stderr)
    return kept


def own_place(index: int, scene: Scene) -> np.ndarray:
    """Where the generator's search put the last object, and where it came to rest."""
    return scene.poses[-1:]


@hold_out
def run_trials(
    scenes: Sequence[Scene],
    task: RobotTask,
    number: int,
    seed: int,
    out: Path | None,
    recipe: Mapping[str, object],
    *,
    num_threads: int = 1,
    places: Places | CameraPlacer = own_place,
    films: FilmFormat | None = None,
    own_grasps: GraspSource | GraspSets | None = None,
    planner: PathPlanner | None = None,
    record: Callable[[Mapping[str, Any]], DemonstrationRecorder] | None = None,
    robot: RobotDescription | None = None,
) -> RobotTrials:
    """Runs episodes: the last object of a scene, upon which nothing lies, is the one that is moved.

    Args:
      scenes: those that stand; taken again, with other seeds, where there are fewer than `number`.
      out: the folder in which rows are kept, each as soon as it is made; None keeps none.
      recipe: what makes rows comparable; rows of another recipe are not taken up again, nor such as were made
        with other grasps or another planner, which are added here.
      num_threads: of the tests of grasps.
      places: where the object may go, for an arm that is told where everything is; or a placer, for one that
        looks.
      own_grasps: a user's, in place of those that are made and tested.
      planner: a user's, for the paths between places.
      record: opens what records every episode, of the recipe.
      films: film the first episode of each outcome in the folder `films` of `out` (`Films`).
      robot: that does it; the Panda if not given.

    Raises:
      BankError: there is no scene, the hand holds no object that is to be moved, another process writes to
        `out`, it holds rows of another recipe or of other scenes, or a film shows another end.
      RendererError: films are asked for, and nothing here can draw.
    """
    if not scenes:
        raise BankError("no scene stands", "one or more", "more scenes")
    robot = robot or find_robot()
    recipe = {
        **recipe,
        "robot": robot.hash,
        "planner": planner_recipe(planner_hash(), planner),
        "versions": versions(),
    }
    path = None if out is None else out / EPISODES
    file = RowStore(path, recipe, EpisodeResult, "robot place", _ADDED)
    rows = file.read(number)
    # A bank that has grown has scenes of their own for episodes which took the first ones again.
    numbers = [-1 if each.origin is None else each.origin.index for each in scenes]
    for index, row in enumerate(rows):
        if row.scene not in (-1, *numbers):
            raise BankError(
                f"{out}: episode {index} is of scene {row.scene}, which is not among those that stand",
                "the bank that the rows are of",
                "another folder",
            )
    assets = {scene.objects[-1].name: scene.objects[-1] for scene in islice(cycle(scenes), number)}
    found = GraspFinder(own_grasps, num_threads, robot)(list(assets.values()))
    grasps: dict[str, Grasps] = dict(zip(assets, found, strict=True))
    if not rows and not any(map(len, found)):
        raise BankError(
            f"the hand of {robot.name} holds none of what is to be moved: {', '.join(assets)}",
            "scenes whose last object it holds, in one at least",
            f"a bank of `cluttergen generate` with --graspable {robot.name}, or another robot",
        )
    file.note_grasps({name: each.digest for name, each in grasps.items()})

    def run(index: int, trace: Trace | None = None) -> EpisodeResult:
        place = index % len(scenes)
        if index < len(rows) and rows[index].scene >= 0:
            # Its own, which the bank may have had elsewhere in the row of episodes.
            place = numbers.index(rows[index].scene)
        scene = scenes[place]
        of_object = grasps[scene.objects[-1].name]
        row = _episode(scene, task, of_object, places, index, seed, trace, planner, robot)
        return replace(row, scene=numbers[place])

    def note(rows: list[EpisodeResult]) -> str:
        good = sum(row.is_success for row in rows)
        return f"{good} of {len(rows)} good, {rows[-1].object}: {rows[-1].outcome}"

    recorder = None if record is None else record(recipe)
    make_episodes(file, rows, number, run, task, note, out, films, recorder)
    return RobotTrials(task, tuple(rows))


def make_episodes(
    file: RowStore[Any],
    rows: list[Any],
    number: int,
    run: Callable[..., Any],
    title: str,
    note: Callable[[list[Any]], str],
    out: Path | None,
    films: FilmFormat | None,
    recorder: DemonstrationRecorder | None,
    again: Callable[[int, Trace], Any] | None = None,
) -> None:
    """Makes the rows that are missing, and records and films what is asked for.

    Args:
      run: runs an episode by its number. again: one that has a row; as all others if not given.
      title: of progress and films. note: says how far it is.
      out: see `run_trials`.
    """
    filmed = None if out is None or films is None else Films(run, out / FILMS, films, title)
    make: Callable[..., Any] = run if filmed is None else filmed.run
    if recorder is not None:
        recorder.complete(rows, again or run)
        make = partial(recorder.run, run=make)
    file.complete(rows, number, make, title, note=note)
    if recorder is not None:
        recorder.finish()
    if filmed is not None:
        filmed.draw(rows, again)


def _episode(
    scene: Scene,
    task: str,
    grasps: Grasps,
    places: Places | CameraPlacer,
    index: int,
    seed: int,
    trace: Trace | None,
    planner: PathPlanner | None,
    robot: RobotDescription,
) -> EpisodeResult:
    found: np.ndarray | CameraPlacer | None = None
    if task == "place":
        found = places if isinstance(places, CameraPlacer) else places(index, scene)
    own = episode_seed(seed, index)
    row = robot_episode(scene, len(scene.names) - 1, grasps, own, found, trace, planner, robot)
    return row if found is None else replace(row, placer=getattr(places, "name", row.placer))


def episode_seed(seed: int, index: int) -> int:
    """The seed of an episode, by its number alone."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0] % 2**30)


def planner_recipe(known: str, planner: PathPlanner | None) -> str:
    """What a recipe says of how the arm moves: a digest, and which planner of a user's own finds paths."""
    return known if planner is None else f"{part_label(planner, 'planner')} {known}"


@cache
def planner_hash() -> str:
    """Hex digest of how the arm moves, plans, looks and is judged."""
    motion = (collision, execute, ik, mover, plan)
    return constants_hash(cameras, episode, gripper, model, sensing_arm, grips, *motion)
