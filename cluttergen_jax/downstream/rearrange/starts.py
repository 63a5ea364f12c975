"""Starting scenes of rearrangements: drawn for a setting, or those of a bank."""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from cluttergen_jax.assets import (
    ObjectAsset,
    ObjectFacts,
    Rectangle,
    SupportAsset,
    object_hash,
    turn_symmetry,
)
from cluttergen_jax.config import Method
from cluttergen_jax.downstream.rearrange.layouts import ReachCheck, SceneDraw
from cluttergen_jax.downstream.rearrange.order import Meetings
from cluttergen_jax.downstream.rearrange.task import (
    RearrangeProblem,
    RearrangeResult,
    RearrangeSetting,
)
from cluttergen_jax.downstream.robot import (
    GraspFinder,
    Grasps,
    GraspSets,
    GraspSource,
    PathPlanner,
    RobotDescription,
)
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.placement import (
    KINDS,
    Relation,
    can_be_filled,
    candidates_of,
    conditions_of,
    parse_relations,
)
from cluttergen_jax.scene import Bank, Scene, read_bank, read_scenes

_PHRASES = {"on top of": "on", "onto": "on", "into": "in", "inside": "in", "beside": "next_to"}
_PHRASES |= {kind.replace("_", " "): kind for kind in (*KINDS, "under")}
_VERB = re.compile(r"^(?:please )?(?:put|place|move|set|bring|lay) ", re.IGNORECASE)
_FILLER = re.compile(r"(?:(?<!next )\bto the|\b(?:the|a|an)) ", re.IGNORECASE)
_NUM_DRAWN = 32
"""Layouts that are drawn at a time: few objects move, and each is looked for where its relation holds."""
_HINT = (
    "'put the candle left of the basket', 'candle left_of basket; toy_car behind candle', or a bank"
)


class Goal(NamedTuple):
    """What an episode has to reach.

    Attributes:
      moved: of the scene's objects those that have to move, by number.
      layouts: `RearrangeProblem.goals`.
    """

    moved: list[int]
    layouts: Callable[[int, np.ndarray], np.ndarray]


def parse_goal(text: str) -> tuple[Relation, ...]:
    """The relations of a text: sentences or relations, divided by semicolons.

    Raises:
      ConfigError: one is not understood.
    """
    return parse_relations([_plain_relation(each) for each in text.split(";") if each.strip(" .")])


def _plain_relation(text: str) -> str:
    with suppress(ConfigError):
        return str(Relation.parse(text))
    words = re.sub(r"[\s_]+", " ", text.strip(" .\n\t"))
    words = _FILLER.sub("", _VERB.sub("", words))
    for phrase in sorted(_PHRASES, key=len, reverse=True):
        subject, found, reference = words.partition(f" {phrase} ")
        if found:
            name, _, gap = reference.partition(":")
            terms = (subject.strip(), _PHRASES[phrase], name.strip())
            return " ".join(each.replace(" ", "_") for each in terms) + (
                f":{gap.strip()}" if gap else ""
            )
    raise ConfigError(
        f"goal {text.strip()!r}", f"an object, one of {', '.join(_PHRASES)}, an object", _HINT
    )


class RelationGoals:
    """Layouts in which relations hold: what each is said of moves, all else stays.

    Args:
      text: the relations (`parse_goal`).
      make_draw: of relations a `SceneDraw` of the objects among which they are to hold.
    """

    def __init__(self, text: str, make_draw: Callable[[Sequence[str]], SceneDraw]) -> None:
        self._relations = parse_goal(text)
        self._make_draw = make_draw
        if not self._relations:
            raise ConfigError(f"goals = {text!r}", "one relation or more", _HINT)
        self._conditions = conditions_of((), self._relations)
        self.name = "; ".join(map(str, self._relations))

    @cached_property
    def _draw(self) -> SceneDraw:
        return self._make_draw([str(each) for each in self._relations])

    def fits(self, objects: Sequence[ObjectAsset]) -> bool:
        """Whether there is another object for every role."""
        return self._candidates(objects) is not None

    def _candidates(self, objects: Sequence[ObjectAsset]) -> np.ndarray | None:
        facts = [ObjectFacts.of(each) for each in objects]
        try:
            found = candidates_of(self._conditions, facts)
        except ConfigError:
            return None
        return found if can_be_filled(found) else None

    def check(self, objects: Sequence[ObjectAsset]) -> None:
        """Refuses relations of objects that are not among these (ConfigError)."""
        found = candidates_of(self._conditions, [ObjectFacts.of(each) for each in objects])
        if not can_be_filled(found):
            raise ConfigError(f"goals {self.name!r}", "a different object for each name", _HINT)

    def __call__(
        self, scene: Scene, numbers: Sequence[int], seed: int, region: Rectangle
    ) -> Goal | None:
        """Which objects take which role in a scene, at random; None if it lacks one.

        Args:
          numbers: of the scene's objects among those of the `SceneDraw`.
          region: where what is moved goes.
        """
        candidates = self._candidates(scene.objects)
        if candidates is None:
            return None
        noise = np.random.default_rng(seed).random(candidates.shape)
        taken = linear_sum_assignment(noise + 1e3 * ~candidates)[1].tolist()
        subjects = {each.subject for each in self._relations}
        moved = [k for name, k in zip(self._conditions, taken, strict=True) if name in subjects]
        rest = [k for k in range(len(numbers)) if k not in moved]

        def layouts(draw: int, poses: np.ndarray) -> np.ndarray:
            chosen, standing, filled = ([numbers[k] for k in each] for each in (moved, rest, taken))
            return self._draw(seed + draw, chosen, region, standing, poses, _NUM_DRAWN, filled)

        return Goal(moved, layouts)


class BankGoals:
    """Target layouts of a bank, or one of its scenes: the objects that they have move there, all else stays.

    Args:
      place: the bank's folder, or FOLDER:INDEX.
    """

    def __init__(self, place: str) -> None:
        folder, index = bank_place(place)
        stored = list(read_scenes(read_bank(folder)))
        known = [each.origin.index for each in stored if each.origin is not None]
        self._scenes = [
            each
            for each in stored
            if index is None or (each.origin is not None and each.origin.index == index)
        ]
        if not stored:
            raise ConfigError(
                f"goals = {place!r}, where no scene is a success", "one or more", _HINT
            )
        if not self._scenes:
            more = " ..." if len(known) > 20 else ""
            raise ConfigError(
                f"goals = {place!r}",
                f"scenes {', '.join(map(str, known[:20]))}{more}",
                f"{folder}:{known[0]}",
            )
        self.name = place

    def check_support(self, support: SupportAsset) -> None:
        """Refuses layouts for another support (ConfigError)."""
        other = self._scenes[0].support
        if other.name != support.name or abs(other.top - support.top) > 1e-6:
            raise ConfigError(
                f"goals on {other.name!r}, scenes on {support.name!r}", "the same support"
            )

    def fits(self, objects: Sequence[ObjectAsset]) -> bool:
        """Whether these are all that one of the layouts has."""
        known = Counter(map(object_hash, objects))
        return any(Counter(map(object_hash, each.objects)) <= known for each in self._scenes)

    def __call__(
        self, scene: Scene, numbers: Sequence[int], seed: int, region: Rectangle
    ) -> Goal | None:
        """The layouts of the first scene all of whose objects this one has, and of those with the same."""
        known = {
            name: object_hash(each) for name, each in zip(scene.names, scene.objects, strict=True)
        }
        fitting = [each for each in self._scenes if self._has(known, each)]
        if not fitting:
            return None
        names = fitting[0].names
        alike = [each for each in fitting if set(each.names) == set(names)]
        poses = np.stack([each.poses[[each.names.index(name) for name in names]] for each in alike])

        def layouts(draw: int, standing: np.ndarray) -> np.ndarray:
            return poses[: 0 if draw else None].astype(np.float64)

        return Goal([scene.names.index(name) for name in names], layouts)

    @staticmethod
    def _has(known: dict[str, str], goal: Scene) -> bool:
        pairs = zip(goal.names, goal.objects, strict=True)
        return all(known.get(name) == object_hash(each) for name, each in pairs)


def is_bank(text: str) -> bool:
    """Whether goals are told by a folder, or by FOLDER:INDEX."""
    return Path(text).is_dir() or Path(text.rpartition(":")[0] or text).is_dir()


def bank_place(text: str) -> tuple[str, int | None]:
    """The folder, and the index of one of its scenes if there is one.

    Raises:
      ConfigError: what follows the colon is no whole number.
    """
    if Path(text).is_dir():
        return text, None
    folder, _, index = text.rpartition(":")
    if not re.fullmatch(r"[0-9]+", index):
        raise ConfigError(
            f"goals = {text!r}", "FOLDER, or FOLDER:INDEX with a whole number", f"{folder}:0"
        )
    return folder, int(index)


def task_words(goals: str) -> Callable[[RearrangeResult], str]:
    """What the task of an episode is called, of its row."""
    if goals and not is_bank(goals):
        told = [
            f"put the {each.subject} {each.kind} the {each.reference}" for each in parse_goal(goals)
        ]
        words = "; ".join(told)
        return lambda row: words.replace("_", " ")

    def words_of(row: RearrangeResult) -> str:
        return f"bring {', '.join(f'the {name}' for name in row.objects)} to their places".replace(
            "_", " "
        )

    return words_of


_MOST_DRAWS = 16
_MOST_CHOICES = 1000
_SLACK = 1e-6


@dataclass(frozen=True)
class OwnScenes:
    """What of a setting is a user's own; None and empty where it is not.

    Attributes:
      bank: whose scenes are the starting scenes.
      support: a support's name or folder, to whose region's middle the setting's rectangles are moved.
      target: where layouts are drawn, world frame.
      goals: a bank's folder, FOLDER:INDEX, or relations (`goals.parse_goal`).
    """

    bank: Bank | None = None
    support: str | None = None
    target: Rectangle | None = None
    goals: str = ""


class Starts:
    """Starting scenes of a setting: each is made again by its seed, or is a bank's.

    Args:
      setting: the setting. pool: a pool's name.
      num_threads: of the simulation and the tests of grasps; 0 takes every core.
      own_grasps, planner, own: a user's.
      robot: that does it.

    Raises:
      ConfigError: goals that are not understood, that are for another support, or of unknown objects.
      BankError: no scene of the bank is a success, or has what the goals are for.
    """

    def __init__(
        self,
        setting: RearrangeSetting,
        pool: str,
        num_threads: int,
        own_grasps: GraspSource | GraspSets | None,
        planner: PathPlanner | None,
        own: OwnScenes | None,
        robot: RobotDescription,
    ) -> None:
        self._robot = robot
        self._pool = pool
        self._planner = planner
        self._own = own or OwnScenes()
        self._num_threads = num_threads
        self._find_grasps = GraspFinder(own_grasps, self._num_threads, robot)
        self._grasps: dict[str, Grasps] = {}
        self._symmetry = cache(turn_symmetry)
        self._goals: RelationGoals | BankGoals | None = None
        if text := self._own.goals:
            self._goals = BankGoals(text) if is_bank(text) else RelationGoals(text, self._goal_draw)
        self._scenes: list[Scene] = []
        if self._own.bank is not None:
            self._scenes = _fitting_scenes(self._own.bank, self._goals)
            most = max(len(each.names) for each in self._scenes)
            setting = replace(
                setting, num_objects=most, num_others=0, method="clear", num_stacked=0
            )
        self.setting = setting

    # Compiled when the first scene is asked for.

    @cached_property
    def _place(self) -> SceneDraw:
        place = self._draw("clear")
        if isinstance(self._goals, BankGoals):
            self._goals.check_support(place.support)
        elif self._goals is not None:
            self._goals.check(place.objects)
        return place

    @cached_property
    def _start(self) -> SceneDraw:
        method = self.setting.method
        return self._place if method == "clear" else self._draw(method)

    def _draw(self, method: Method, relations: Sequence[str] = ()) -> SceneDraw:
        source = self._own.bank or self._pool
        slots = self.setting.num_slots
        return SceneDraw(source, method, slots, self._num_threads, self._own.support, relations)

    def _goal_draw(self, relations: Sequence[str]) -> SceneDraw:
        # It looks for places at which relations hold, and learns nothing.
        return self._draw("spread", relations)

    @cached_property
    def _setting_here(self) -> RearrangeSetting:
        """The setting with its rectangles where they are on the support."""
        setting = self.setting
        own = self._own
        area = self._place.area
        if own.bank is not None:
            setting = replace(setting, start=area, target=own.target or area)
        elif own.support is not None:
            start, target = (_carry_over(each, area) for each in (setting.start, setting.target))
            setting = replace(setting, start=start, target=own.target or target)
        elif own.target is not None:
            setting = replace(setting, target=own.target)
        elif not own.goals:
            return setting
        if own.goals and own.target is None:
            setting = replace(setting, target=area)
        _check_inside(setting.start, area, f"the start of setting {setting.name!r}")
        _check_inside(setting.target, area, "the target")
        return setting

    def __call__(self, seed: int, index: int = 0) -> RearrangeProblem:
        """What is to be rearranged.

        Args:
          index: of the episode; a bank's scenes are taken in turn.

        Raises:
          ConfigError: the pool has too few objects, no starting scene was found, or rectangles do not lie
            within what the arm reaches of the support.
        """
        rng = np.random.default_rng(seed)
        setting = self._setting_here
        place = self._place
        if self._scenes:
            scene = self._scenes[index % len(self._scenes)]
            scene = replace(scene, support=place.support)
            numbers = [place.names.index(name) for name in scene.names]
            setting = replace(setting, num_objects=len(numbers))
            task = self._task(scene, numbers, self._grasps_of(scene.objects), setting, rng)
            assert task is not None
            return task
        for _ in range(_MOST_DRAWS):
            numbers = self._choose(rng)
            moved = numbers[: setting.num_objects]
            others = numbers[setting.num_objects :]
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
                grasps = self._grasps_of(objects)
                if setting.num_stacked and not is_stacked(
                    scene, grasps, setting.num_stacked, self._robot
                ):
                    continue
                if (task := self._task(scene, numbers, grasps, setting, rng)) is not None:
                    return task
        raise ConfigError(
            f"no starting scene of {setting.name!r}", "smaller objects", "another pool"
        )

    def write_bank(self, path: Path, scenes: Sequence[Scene], seed: int) -> Bank:
        """A bank of starting scenes, in which environments can begin."""
        return self._place.write_bank(path, scenes, f"starts of {self.setting.name}", seed)

    def _choose(self, rng: np.random.Generator) -> list[int]:
        """Objects of the pool at random; such as the goals are for, if there are goals."""
        objects = self._place.objects
        for _ in range(_MOST_CHOICES):
            numbers = rng.permutation(len(objects))[: self.setting.num_slots].tolist()
            if self._goals is None or self._goals.fits([objects[each] for each in numbers]):
                return numbers
        number = self.setting.num_slots
        raise ConfigError(
            f"goals for other objects than {number} of the pool", "objects of the pool"
        )

    def _task(
        self,
        scene: Scene,
        numbers: list[int],
        grasps: tuple[Grasps, ...],
        setting: RearrangeSetting,
        rng: np.random.Generator,
    ) -> RearrangeProblem | None:
        """A scene as a task, what is to be moved first; None if it lacks what the goals are for."""
        seed = _draw_seed(rng)
        symmetry = tuple(map(self._symmetry, scene.objects))
        layouts = None
        if self._goals is not None:
            goal = self._goals(scene, numbers, seed, setting.target)
            if goal is None:
                return None
            layouts = goal.layouts
            order = [*goal.moved, *(k for k in range(len(numbers)) if k not in goal.moved)]

            def sorted_by_goal(each: Sequence[Any]) -> tuple[Any, ...]:
                return tuple(each[k] for k in order)

            grasps = sorted_by_goal(grasps)
            symmetry = sorted_by_goal(symmetry)
            names = sorted_by_goal(scene.names)
            objects = sorted_by_goal(scene.objects)
            scene = replace(scene, names=names, objects=objects, poses=scene.poses[order])
            numbers = list(sorted_by_goal(numbers))
            moved = len(goal.moved)
            setting = replace(setting, num_objects=moved, num_others=len(order) - moved)
        place = self._place
        known = (tuple(numbers), grasps, symmetry, place)
        return RearrangeProblem(
            setting, scene, *known, seed, self._planner, layouts, place.area, self._robot
        )

    def _grasps_of(self, objects: Sequence[ObjectAsset]) -> tuple[Grasps, ...]:
        """Of each object, found when it is first asked for."""
        fresh = list(
            {each.name: each for each in objects if each.name not in self._grasps}.values()
        )
        if fresh:
            found = self._find_grasps(fresh)
            self._grasps.update(zip((each.name for each in fresh), found, strict=True))
        return tuple(self._grasps[each.name] for each in objects)


def _fitting_scenes(bank: Bank, goals: RelationGoals | BankGoals | None) -> list[Scene]:
    """The successes of a bank; only those with the goals' objects."""
    scenes = list(read_scenes(bank))
    kept = [each for each in scenes if goals is None or goals.fits(each.objects)]
    if not kept:
        what = (
            "is a success"
            if goals is None or not scenes
            else f"has what the goals are for: {goals.name}"
        )
        raise BankError(
            f"{bank.path}: no scene {what}", "one or more", "another bank, or other goals"
        )
    if len(kept) < len(scenes):
        left = len(scenes) - len(kept)
        print(
            f"left out   {left} of {len(scenes)} scenes, without the goals' objects",
            file=sys.stderr,
        )
    return kept


def _carry_over(rectangle: Rectangle, area: Rectangle) -> Rectangle:
    """A setting's rectangle, told from the usual table's middle, on another support."""
    x, y = np.asarray(area.center) + rotate_in_plane(np.array(rectangle.center), area.yaw)
    return Rectangle((float(x), float(y)), rectangle.half_extents, area.yaw + rectangle.yaw)


def _check_inside(rectangle: Rectangle, area: Rectangle, what: str) -> None:
    corners = rotate_in_plane(rectangle.corners - np.asarray(area.center), -area.yaw)
    if (np.abs(corners) > np.asarray(area.half_extents) + _SLACK).any():
        raise ConfigError(
            f"{what}, {_size_text(rectangle)}",
            f"within {_size_text(area)}, which the arm reaches",
            "a smaller `target`, another `setting`, or a larger support",
        )


def _size_text(rectangle: Rectangle) -> str:
    x, y = rectangle.center
    half_x, half_y = rectangle.half_extents
    return f"{2 * half_x:g} x {2 * half_y:g} m about {x:g}, {y:g}"


def _draw_seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**30))


def is_stacked(
    scene: Scene, grasps: Sequence[Grasps], number: int, robot: RobotDescription
) -> bool:
    """Whether so many objects lie on others, and the arm gets at those of them on which nothing lies.

    A ring that fell over what it lies on is an example of what no hand can take.

    Args:
      grasps: of each object of the scene.
    """
    lies_on = Meetings(scene.objects).relations(scene.poses, scene.poses).lies_on
    top = np.flatnonzero(lies_on.any(1) & ~lies_on.any(0)).tolist()
    if lies_on.any(1).sum() < number:
        return False
    return ReachCheck(scene.objects, grasps, top, scene.support, robot)(scene.poses) == 1
