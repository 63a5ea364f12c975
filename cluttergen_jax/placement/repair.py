"""A broken layout made into one that is stable, with little motion.

Objects are placed again from the lowest up, each by the rules of an attempt: lifted or lowered to first
contact where it was, without its tilt; where that is far or not stable, at places around it, the nearest
first. What lay on an object that had to be moved is moved along.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.config import check_positive
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import product, rotation_matrix, transform_points, turn_between
from cluttergen_jax.numerics import new_key
from cluttergen_jax.physics.margin import OverlapProbe
from cluttergen_jax.placement.hand import HandScene
from cluttergen_jax.placement.problem import Setup
from cluttergen_jax.placement.scenes import SceneBatch
from cluttergen_jax.placement.world import World
from cluttergen_jax.types import Verdict

MAX_TILT = np.radians(30.0)
"""An object that leans by less is put upright; what leans by more, such as a bottle that lies, is left so."""
_UPRIGHT = np.cos(1e-3)
_CELL = 0.007
_SHARED = 0.05
"""Share of the smaller footprint from which one of two objects counts as above the other."""
# What is over an object with this share of its own footprint, within so many metres, lies on it.
_CARRIED = 0.25
_NEAR = 0.025

_MOST = 0.5
_DRAGGED = 0.01
"""Metres that an object may be moved without what lies on it."""
# Metres between circles of places that are tried, and places on each.
_RINGS = 0.003
_ANGLES = 12

_FIRST_STEP = 0.002
_PRECISION = 0.0005
# Attempts for an object, passes for a layout; metres between attempts, twice as many after each four.
_ATTEMPTS = 16
_PASSES = 4
_APART = 0.005

# Metres: a layout that moves less in the final check, and overlaps less, is left as it is.
_STILL = 0.0005
_TOUCHES = 0.001


@dataclass(frozen=True)
class RepairConfig:
    """How far objects may be moved.

    Attributes:
      max_shift: metres from where an object was, 0.5 at most; max_turn_deg: degrees.

    Raises:
      ConfigError: one is not a finite number above zero, or too large.
    """

    max_shift: float = 0.05
    max_turn_deg: float = 45.0

    def __post_init__(self) -> None:
        check_positive(self, "max_shift", "max_turn_deg")
        if self.max_shift > _MOST:
            given = f"RepairConfig.max_shift = {self.max_shift:g}"
            raise ConfigError(given, f"{_MOST:g} m at most", "the default, 0.05")


class LayoutRepair:
    """Repairs layouts of the objects of one world.

    Args:
      setup: the problem; its placement has slots for as many objects as a layout has.
      config: how far objects may be moved.
    """

    def __init__(self, setup: Setup, config: RepairConfig) -> None:
        self.setup = setup
        self.config = config
        self._probe = OverlapProbe(setup.problem.world.layout)

    def __call__(self, objects: Sequence[int], poses: np.ndarray) -> SceneBatch:
        """The scene that a layout becomes, without leading axes; a success only if all objects are in it.

        Args:
          objects: N of the world's, each once.
          poses: f64[N, 7], world frame, metres, wxyz: finite, of unit length.
        """
        given = np.zeros((self.setup.problem.world.num_objects, 7))
        given[:, 3] = 1.0
        given[list(objects)] = poses
        if (scene := self._if_stable(objects, given)) is not None:
            return scene
        layout = _Layout(self.setup, objects, given)
        first = dict.fromkeys(objects, 0)
        skipped = dict.fromkeys(objects, 0)
        best: SceneBatch | None = None
        plans: list[tuple[list[int], dict[int, int]]] = []
        for _ in range(_PASSES):
            plans.append((layout.order(first), dict(skipped)))
            if plans[-1] in plans[:-1]:
                break
            hand, failed = self._place(layout, *plans[-1])
            scene = hand.result()
            if not failed:
                check = hand.check()
                scene = hand.result()
                failed = [] if check.verdict == Verdict.STABLE else [check.mover]
                skipped[check.mover] += 1
            if best is None or scene.is_placed.sum() >= best.is_placed.sum():
                best = scene
            if not failed:
                break
            # Next time what found no place is placed before others.
            for each in failed:
                first[each] -= 1
        assert best is not None
        return best

    def _if_stable(self, objects: Sequence[int], given: np.ndarray) -> SceneBatch | None:
        """The layout as it is, if it is stable; what lies on what is then not known."""
        is_placed = np.isin(np.arange(len(given)), list(objects))
        depths = self._probe.depths(given, is_placed)
        if depths is None or depths.max() > _TOUCHES:
            return None
        hand = HandScene(self.setup, new_key(0), objects=objects)
        return hand.keep_as_given(given, _STILL)

    def _place(
        self, layout: _Layout, order: Sequence[int], skipped: dict[int, int]
    ) -> tuple[HandScene, list[int]]:
        """The scene after one pass, and the objects that found no place."""
        hand = HandScene(self.setup, new_key(0), objects=order)
        failed: list[int] = []
        for each in order:
            hand.choose(each)
            if not self._place_one(layout, hand, each, skipped[each]):
                failed.append(each)
        return hand, failed

    def _place_one(self, layout: _Layout, hand: HandScene, each: int, skipped: int) -> bool:
        """Whether an object found a stable place near its own, or near what carried it."""
        given = layout.given[each]
        limit = self.config.max_shift
        tried: list[np.ndarray] = []
        for pose in self._places(layout, hand, each):
            apart = _APART * 2 ** (len(tried) // 4)
            if any(np.linalg.norm(pose[:2] - other) < apart for other in tried):
                continue
            if len(tried) == _ATTEMPTS:
                break
            tried.append(pose[:2])
            if len(tried) <= skipped or hand.drop(pose).attempt.verdict != Verdict.STABLE:
                continue
            now = hand.poses[each]
            turn = np.degrees(turn_between(np, now[3:], given[3:]))
            if np.linalg.norm(now[:3] - given[:3]) <= limit and turn <= self.config.max_turn_deg:
                return True
            hand.undo()
        return False

    def _places(self, layout: _Layout, hand: HandScene, each: int) -> Iterator[np.ndarray]:
        """Poses from which an object may be let go, those first that are nearest to its own."""
        start = layout.wish(each, hand.poses, hand.is_placed)
        waiting: list[tuple[float, int, np.ndarray]] = []
        for radius in np.arange(0.0, self.config.max_shift, _RINGS):
            for angle in np.arange(_ANGLES if radius else 1) * 2 * np.pi / _ANGLES + radius * 100:
                pose = start.copy()
                pose[:2] += radius * np.cos(angle), radius * np.sin(angle)
                if self._let_down(hand, each, pose):
                    waiting.append(
                        (float(np.linalg.norm(pose[:3] - start[:3])), len(waiting), pose)
                    )
            waiting.sort()
            # What is farther away in plan is farther away.
            while waiting and waiting[0][0] <= radius + _RINGS:
                yield waiting.pop(0)[2]
        yield from (pose for _, _, pose in waiting)

    def _let_down(self, hand: HandScene, each: int, pose: np.ndarray) -> bool:
        """Lifts or lowers a pose, in place, to where it is just free of all else; whether there is one."""
        poses = hand.poses.astype(float)
        is_placed = hand.is_placed.copy()
        is_placed[each] = True

        def overlaps(z: float) -> bool:
            poses[each] = (*pose[:2], z, *pose[3:])
            depths = self._probe.depths(poses, is_placed)
            return depths is None or bool((depths[each] > 0).any())

        z = float(pose[2])
        step = _FIRST_STEP
        was = overlaps(z)
        sign = 1.0 if was else -1.0
        while step <= 2 * self.config.max_shift and overlaps(z + sign * step) == was:
            step *= 2
        if step > 2 * self.config.max_shift:
            return False
        low, high = sorted((z + sign * (step / 2 if step > _FIRST_STEP else 0.0), z + sign * step))
        while high - low > _PRECISION:
            middle = (low + high) / 2
            low, high = (middle, high) if overlaps(middle) else (low, middle)
        pose[2] = high
        return True


class _Layout:
    """What a broken layout tells: which objects lie on which, and where each would like to be.

    Attributes:
      given: f64[K, 7], world poses of the world's objects.
    """

    def __init__(self, setup: Setup, objects: Sequence[int], given: np.ndarray) -> None:
        self.given = given
        self._objects = list(objects)
        self._upright = given.copy()
        world = setup.problem.world
        cells = dict[int, Cells]()
        for each in objects:
            self._upright[each, 3:] = put_upright(given[each, 3:])
            cells[each] = _cells_of(*_columns_of(world, each, self._upright[each]))
        self._lowest = {each: bottom.min() for each, (_, bottom, _) in cells.items()}
        self._below: dict[int, set[int]] = {each: set() for each in objects}
        self._carrier: dict[int, int] = {}
        for each in objects:
            shares = {}
            for other in objects:
                if each == other:
                    continue
                share, lift, gap = _compare(cells[each], cells[other])
                if (
                    share > _SHARED * min(1.0, len(cells[other][0]) / len(cells[each][0]))
                    and lift > 0
                ):
                    self._below[each].add(other)
                    if share >= _CARRIED and abs(gap) <= _NEAR:
                        shares[other] = share
            if shares:
                self._carrier[each] = max(shares, key=shares.__getitem__)

    def order(self, first: dict[int, int]) -> list[int]:
        """The objects, each after those below it; among the others those of the least `first` come first."""
        left = set(self._objects)
        order = []
        while left:
            free = [each for each in left if not self._below[each] & left] or list(left)
            order.append(min(free, key=lambda each: (first[each], self._lowest[each], each)))
            left.remove(order[-1])
        return order

    def wish(self, each: int, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """f64[7]: where an object would like to be now that others are at `poses`, f[K, 7]."""
        pose = self._upright[each].copy()
        carrier = self._carrier.get(each)
        if carrier is not None and is_placed[carrier]:
            moved = poses[carrier, :2] - self.given[carrier, :2]
            if np.linalg.norm(moved) > _DRAGGED:
                pose[:2] += moved
        return pose


def _columns_of(world: World, each: int, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[P, 3] each: the lowest and the highest points of an object at a pose, above each other."""
    profile = world.columns[each]
    if rotation_matrix(pose[3:])[2, 2] > _UPRIGHT:
        ends = np.c_[profile.xy, profile.bottom], np.c_[profile.xy, profile.top]
        return transform_points(pose, ends[0]), transform_points(pose, ends[1])
    # Columns are those of the resting pose. Of what lies otherwise its box has to do.
    points = transform_points(pose, world.objects[each].vertices)
    low = points.min(0)
    high = points.max(0)
    grid = np.stack(np.meshgrid(*np.linspace(low[:2], high[:2], 9).T), -1).reshape(-1, 2)
    return np.c_[grid, np.full(len(grid), low[2])], np.c_[grid, np.full(len(grid), high[2])]


Cells = tuple[np.ndarray, np.ndarray, np.ndarray]
"""i64[C], cells of the plane, ascending; f64[C], lowest and highest point of an object over each."""


def _cells_of(bottom: np.ndarray, top: np.ndarray) -> Cells:
    x, y = np.floor(bottom[:, :2] / _CELL).astype(np.int64).T
    cells, place = np.unique((x << 32) + y, return_inverse=True)
    low = np.full(len(cells), np.inf)
    high = np.full(len(cells), -np.inf)
    np.minimum.at(low, place, bottom[:, 2])
    np.maximum.at(high, place, top[:, 2])
    return cells, low, high


def _compare(one: Cells, other: Cells) -> tuple[float, float, float]:
    """Of the cells that two objects share: their share of the first one's, how much higher it is, the gap."""
    _, mine, theirs = np.intersect1d(one[0], other[0], assume_unique=True, return_indices=True)
    if not len(mine):
        return 0.0, 0.0, np.inf
    lift = (one[1][mine] + one[2][mine] - other[1][theirs] - other[2][theirs]).mean() / 2
    return len(mine) / len(one[0]), float(lift), float((one[1][mine] - other[2][theirs]).min())


def put_upright(quaternion: np.ndarray) -> np.ndarray:
    """f64[4]: an orientation without its tilt, by the least turn, where that is `MAX_TILT` or less."""
    up = rotation_matrix(quaternion)[:, 2]
    if up[2] < np.cos(MAX_TILT):
        return quaternion
    back = np.array([1.0 + up[2], up[1], -up[0], 0.0])
    return product(back / np.linalg.norm(back), np.asarray(quaternion, np.float64))
