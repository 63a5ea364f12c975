"""Layouts: where given objects may stand in a region, around others; many are drawn, ten unlike ones kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist

from cluttergen_jax.assets import ObjectAsset, Rectangle, SupportAsset, find_support
from cluttergen_jax.config import Method
from cluttergen_jax.downstream.robot import ROOM as HAND_ROOM
from cluttergen_jax.downstream.robot import (
    ArmKinematics,
    Grasps,
    Mode,
    PlanningWorld,
    RobotDescription,
    base_pose,
    rank_grasps,
)
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.downstream.words import LayoutRule
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation import embed
from cluttergen_jax.generation import make_sampler, setup_of
from cluttergen_jax.geometry import Array
from cluttergen_jax.learning import choose_method, sampler_of
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement import MIN_MARGIN, PlacementConfig, make_region
from cluttergen_jax.scene import Bank, Scene, region_of

AREA = Rectangle((0.0, 0.0), (0.27, 0.32))
"""All of the usual table that the arm reaches; objects may wait anywhere in it."""
ROOM = 0.01
"""Metres between the two nearest objects from which on a layout has room; poses are seen to millimetres."""
NUM_DRAWN = 128
"""Layouts that are drawn for those that are kept."""


class SceneDraw:
    """Draws scenes of given objects in a given region around others: one compiled program for them all.

    Args:
      source: a pool's name; or a bank, of whose objects and on whose support scenes are drawn.
      method: as of `generate`.
      num_slots: objects that a scene has at most, those that stand there already included.
      num_threads: simulation threads; 0 takes every core.
      support: a support's name or folder, for a pool; the usual table if None.
      relations: that each scene fulfils (`placement.relations`); objects of their roles are told by number.

    Attributes:
      names, objects: K of the pool or bank. support: with the region of that.
      area: where objects may be: the middle of the support's region, as far as the arm reaches.
    """

    def __init__(
        self,
        source: str | Bank,
        method: Method,
        num_slots: int,
        num_threads: int = 0,
        support: str | None = None,
        relations: Sequence[str] = (),
    ) -> None:
        self._sampler: Any = None
        if isinstance(source, Bank):
            self.area = reached_part(region_of(source))
            config = PlacementConfig(
                num_objects=num_slots, min_margin=MIN_MARGIN, relations=tuple(relations)
            )
            setup = setup_of(source, placement=config, region=self.area, num_threads=num_threads)
            problem = setup.problem
            steps = sampler_of(setup, choose_method(method, setup.problem.config.pool))
        else:
            self.area = AREA if support is None else reached_part(find_support(support).region)
            sampler = make_sampler(
                source,
                support="table" if support is None else support,
                num_objects=num_slots,
                method=method,
                region=self.area,
                num_threads=num_threads,
                relations=relations,
            )
            self._sampler = sampler
            problem = sampler.problem
            steps = sampler.steps
        world = problem.world
        self.names = world.names
        self.objects = world.objects
        self.support: SupportAsset = world.support
        self._num_slots = num_slots
        self._is_related = bool(relations)
        rules = steps.rules
        step = steps.step_one
        top = float(world.support.top)

        def draw(
            key: Array,
            order: Array,
            first: Array,
            poses: Array,
            is_placed: Array,
            box: Array,
            roles: Array,
        ) -> Any:
            region = make_region(box[:2], box[2:4], box[4], jnp.float32(top))
            episode = rules.begin(key, region).replace(
                object_index=order, first_slot=first, slot=first, poses=poses, is_placed=is_placed
            )
            if relations:
                episode = episode.replace(roles=roles)
            last = jax.lax.while_loop(
                lambda each: ~each.is_over, lambda each: step(each)[0], episode
            )
            return last.poses, last.is_success

        self._draw: Any = jax.jit(jax.vmap(draw, in_axes=(0, *[None] * 6)))

    def write_bank(self, path: Path, scenes: Sequence[Scene], method: str, seed: int) -> Bank:
        """Writes scenes of a pool's objects as a bank (`Sampler.write_bank`); a bank's are in theirs."""
        assert self._sampler is not None
        found: Bank = self._sampler.write_bank(path, scenes, method, seed)
        return found

    def __call__(
        self,
        seed: int,
        chosen: Sequence[int],
        region: Rectangle,
        standing: Sequence[int] = (),
        poses: np.ndarray | None = None,
        number: int = NUM_DRAWN,
        roles: Sequence[int] = (),
    ) -> np.ndarray:
        """Of `number` scenes those that stand, f64[S, n, 7]: T_world_object of the objects `chosen`.

        Args:
          chosen: n of the pool's objects by number; those of the largest footprint are placed first.
          region: where; no larger than `area`.
          standing: objects that are there already; poses: f[m, 7] of these.
          roles: objects of the relations' roles, in the order of `relations.order_of`; `chosen` then are
            placed in their own order.
        """
        if len(chosen) + len(standing) > self._num_slots:
            raise ConfigError(
                f"{len(chosen) + len(standing)} objects", f"{self._num_slots} at most"
            )
        area = [np.prod(self.objects[each].half_extents[:2]) for each in chosen]
        large_first = [chosen[each] for each in np.argsort(-np.array(area), kind="stable")]
        large_first = list(chosen) if self._is_related else large_first
        order = np.full(self._num_slots, -1, np.int32)
        order[: len(standing) + len(chosen)] = [*standing, *large_first]
        start = np.tile(np.eye(7, dtype=np.float32)[3], (len(self.objects), 1))
        is_placed = np.zeros(len(self.objects), bool)
        if poses is not None and len(standing):
            start[list(standing)] = poses
            is_placed[list(standing)] = True
        box = np.array([*region.center, *region.half_extents, region.yaw], np.float32)
        keys = jax.random.split(new_key(seed), number)
        taken = np.array(roles, np.int32)
        found, stands = self._draw(
            keys, order, np.int32(len(standing)), start, is_placed, box, taken
        )
        kept = np.asarray(found, np.float64)[np.asarray(stands)][:, list(chosen)]
        kept[..., 3:] /= np.linalg.norm(kept[..., 3:], axis=-1, keepdims=True)
        return kept


def reached_part(region: Rectangle) -> Rectangle:
    """The middle of a region before which the arm stands, as far as it reaches."""
    half_x, half_y = np.minimum(region.half_extents, AREA.half_extents).tolist()
    return Rectangle(region.center, (half_x, half_y), region.yaw)


@dataclass(frozen=True, eq=False)
class Layouts:
    """L layouts of N objects, and what is known of each before it is chosen.

    Attributes:
      poses: f64[L, N, 7], T_world_object.
      clearance: f64[L], metres, seen from above: the least gap between one that is moved and any other.
      reach: f64[L], share of the objects that the arm can hold firmly, with room, in the finished layout.
      travel: f64[L], metres, the mean way in plan from where objects stand.
    """

    poses: np.ndarray
    clearance: np.ndarray
    reach: np.ndarray
    travel: np.ndarray

    def __len__(self) -> int:
        return len(self.poses)

    def rank(self, rule: LayoutRule) -> np.ndarray:
        """i[L]: the layouts, best first. Those that are reached wholly come first under every rule."""
        worth = {"clearance": self.clearance, "reach": self.reach, "similar": -self.travel}[rule]
        return np.lexsort((-self.clearance, -worth, -self.reach))


def choose_unlike(
    objects: Sequence[ObjectAsset], poses: np.ndarray, region: Rectangle, number: int
) -> np.ndarray:
    """i[number]: of scenes f64[S, N, 7] each the farthest from those before it (`diversity.embed`)."""
    if len(poses) <= number:
        return np.arange(len(poses))
    vectors = embed(objects, poses, np.ones(poses.shape[:2], bool), region, 0.0)
    distances = cdist(vectors, vectors)
    # The one in the middle of all is the first.
    chosen = [int(distances.mean(1).argmin())]
    while len(chosen) < number:
        chosen.append(int(distances[chosen].min(0).argmax()))
    return np.array(chosen)


def prefer(reach: np.ndarray, clearance: np.ndarray, number: int) -> np.ndarray:
    """i[M]: of layouts with f64[S] each those that are reached wholly and have `ROOM`, but at least `number`.

    If they are fewer, those follow that are reached best, of these those with the widest gaps.
    """
    is_good = (reach == 1) & (clearance >= ROOM)
    best = np.lexsort((-clearance, -reach, ~is_good))
    return np.sort(best[: max(number, int(is_good.sum()))])


def clearance_of(objects: Sequence[ObjectAsset], poses: np.ndarray, num_moved: int) -> float:
    """Metres between the two nearest of objects at f64[N, 7], seen from above; 0 where footprints overlap.

    Footprints are the hulls of the collision parts' shadows, looked at every 5 mm along their edges.

    Args:
      num_moved: the first so many objects are moved; how near the others stand to each other does not count.
    """
    outlines = [_outline(asset, pose) for asset, pose in zip(objects, poses, strict=True)]
    least = np.inf
    for i, one in enumerate(outlines):
        for other in outlines[: min(i, num_moved)]:
            if _is_over(one, other) or _is_over(other, one):
                return 0.0
            least = min(least, float(cdist(one, other).min()))
    return least


def _outline(asset: ObjectAsset, pose: np.ndarray) -> np.ndarray:
    place = matrix_of(pose)
    vertices = np.concatenate([part.vertices for part in asset.parts])
    corners = vertices @ place[:2, :3].T + place[:2, 3]
    ring = corners[ConvexHull(corners).vertices]
    ahead = np.roll(ring, -1, axis=0)
    number = int(np.linalg.norm(ahead - ring, axis=1).max() / 0.005) + 1
    return np.concatenate([ring + (ahead - ring) * share for share in np.arange(number) / number])


def _is_over(one: np.ndarray, other: np.ndarray) -> bool:
    planes = ConvexHull(one).equations
    return bool((other @ planes[:, :2].T + planes[:, 2] < 0).all(1).any())


class ReachCheck:
    """Which objects the arm could take with room, as all stand.

    Args:
      objects: N; grasps: of each. moved: the numbers of the objects that count. support: the table.
      max_lever: metres, of the grasps that count (`grips.Grip`).
    """

    def __init__(
        self,
        objects: Sequence[ObjectAsset],
        grasps: Sequence[Grasps],
        moved: Sequence[int],
        support: SupportAsset,
        robot: RobotDescription,
        max_lever: float = np.inf,
    ) -> None:
        self._grasps = grasps
        self._max_lever = max_lever
        base = base_pose(support, robot)
        self._kinematics = ArmKinematics(base, robot)
        names = list(map(str, range(len(objects))))
        nowhere = np.tile(np.eye(7)[3], (len(objects), 1))
        self._worlds = {
            k: PlanningWorld(names, objects, nowhere, k, support, base, robot) for k in moved
        }
        for world in self._worlds.values():
            world.room = HAND_ROOM

    def __call__(self, poses: np.ndarray) -> float:
        """The share of those that count, all N at f64[N, 7]."""
        return float(np.mean([self._is_taken(k, poses) for k in self._worlds]))

    def _is_taken(self, target: int, poses: np.ndarray) -> bool:
        world = self._worlds[target]
        T_world_object = matrix_of(poses[target])
        for number, pose in enumerate(poses):
            world.move(number, pose)
        for grip in rank_grasps(self._grasps[target], T_world_object, world.gripper):
            if grip.lever > self._max_lever:
                continue
            T_world_tool = T_world_object @ grip.T_object_tool
            opening = grip.opening
            if not world.is_hand_free(T_world_tool, opening, Mode.COME):
                continue
            found = self._kinematics.solutions(T_world_tool, 1)
            if any(world.is_free(joints, opening, Mode.COME) for joints in found):
                return True
        return False
