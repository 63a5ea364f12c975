"""Starting scenes of rearrangements: drawn for a setting, or those of a bank."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from cluttergen_jax.assets import ObjectAsset, Rectangle, turn_symmetry
from cluttergen_jax.config import Method
from cluttergen_jax.downstream.rearrange.goals import BankGoals, RelationGoals, is_bank
from cluttergen_jax.downstream.rearrange.layouts import ReachCheck, SceneDraw
from cluttergen_jax.downstream.rearrange.order import Meetings
from cluttergen_jax.downstream.rearrange.task import RearrangeSetting, RearrangeTask
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps, GraspSets
from cluttergen_jax.downstream.robot.grasping.own_grasps import GraspFinder
from cluttergen_jax.downstream.robot.protocols import GraspSource, PathPlanner
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.scene import Bank, Scene, read_scenes

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
      robot: the Panda if not given.

    Raises:
      ConfigError: goals that are not understood, that are for another support, or of unknown objects.
      BankError: no scene of the bank is a success, or has what the goals are for.
    """

    def __init__(
        self,
        setting: RearrangeSetting,
        pool: str,
        num_threads: int,
        own_grasps: GraspSource | GraspSets | None = None,
        planner: PathPlanner | None = None,
        own: OwnScenes | None = None,
        robot: RobotDescription | None = None,
    ) -> None:
        self._robot = robot
        self._pool = pool
        self._planner = planner
        self._own = own or OwnScenes()
        self._num_threads = num_threads or os.cpu_count() or 1
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
    def _placed(self) -> RearrangeSetting:
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

    def __call__(self, seed: int, index: int = 0) -> RearrangeTask:
        """What is to be rearranged.

        Args:
          index: of the episode; a bank's scenes are taken in turn.

        Raises:
          ConfigError: the pool has too few objects, no starting scene was found, or rectangles do not lie
            within what the arm reaches of the support.
        """
        rng = np.random.default_rng(seed)
        setting = self._placed
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
    ) -> RearrangeTask | None:
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
            grasps = tuple(grasps[k] for k in order)
            symmetry = tuple(symmetry[k] for k in order)
            names = tuple(scene.names[k] for k in order)
            objects = tuple(scene.objects[k] for k in order)
            scene = replace(scene, names=names, objects=objects, poses=scene.poses[order])
            numbers = [numbers[k] for k in order]
            moved = len(goal.moved)
            setting = replace(setting, num_objects=moved, num_others=len(order) - moved)
        place = self._place
        known = (tuple(numbers), grasps, symmetry, place)
        return RearrangeTask(
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
        (x, y) = area.center
        (half_x, half_y) = area.half_extents
        allowed = (
            f"within {2 * half_x:g} x {2 * half_y:g} m about {x:g}, {y:g}, which the arm reaches"
        )
        (x, y) = rectangle.center
        (half_x, half_y) = rectangle.half_extents
        given = f"{what}, {2 * half_x:g} x {2 * half_y:g} m about {x:g}, {y:g}"
        raise ConfigError(
            given, allowed, "a smaller `target`, another `setting`, or a larger support"
        )


def _draw_seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**30))


def is_stacked(
    scene: Scene, grasps: Sequence[Grasps], number: int, robot: RobotDescription | None = None
) -> bool:
    """Whether so many objects lie on others, and the arm gets at those of them on which nothing lies.

    A ring that fell over what it lies on is an example of what no hand can take.

    Args:
      grasps: of each object of the scene. robot: the Panda if not given.
    """
    lies_on = Meetings(scene.objects).relations(scene.poses, scene.poses).lies_on
    top = np.flatnonzero(lies_on.any(1) & ~lies_on.any(0)).tolist()
    if lies_on.any(1).sum() < number:
        return False
    return ReachCheck(scene.objects, grasps, top, scene.support, robot=robot)(scene.poses) == 1
