"""What is known of objects corrects masks, where a camera is said to be, and poses.

A segmenter errs where light is strange. What has not been touched, or was put down with care, is mostly where
it is expected, and depth confirms that without any colour: a pixel whose depth is that of an object at its
expected pose shows that object.

A stated orientation that is wrong by a degree moves a far corner of the table by a centimetre. The table
itself tells tilt and height (`finder.upright_at_its_place`); what stands on it tells the rest. Estimated
poses are simulated: what moves is not steady, and what overlaps is moved apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from scipy.ndimage import binary_dilation, binary_opening
from scipy.ndimage import label as connected

from cluttergen_jax.assets import ObjectAsset, SupportAsset, populated_spec
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.downstream.perception.object_model import (
    AGREES,
    IN_FRONT,
    Comparer,
    ObjectModel,
    render_alone,
)
from cluttergen_jax.downstream.perception.registration import FEWEST_PIXELS, SURE
from cluttergen_jax.downstream.perception.types import ARM, BACKGROUND, FIRST_OBJECT
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.sensing import View

LEAST_SHARE = 0.6
"""Of the pixels of an object that should be seen: so many have to have its depth for it to count as there."""
_FEWEST = 40
"""Pixels that should be seen, below which nothing is concluded."""
_MARGIN = 6
"""Pixels about an object that is there, outside of which nothing else of its kind is."""
_VOXEL = 0.012
"""Metres between points of one thing, at most."""


def correct_masks(
    looks: Sequence[View], expected: dict[int, tuple[ObjectModel, np.ndarray]]
) -> list[View]:
    """The looks, with corrected masks of those objects that depth shows where they are expected.

    Args:
      expected: by number, the object and its pose f64[4, 4], T_world_object.
    """
    return [_correct_mask(look, expected) for look in looks]


def find_unexplained(
    looks: Sequence[View], found: dict[int, tuple[ObjectModel, np.ndarray]], top: float, fewest: int
) -> list[list[np.ndarray]]:
    """What stands on the table, shown by depth, that is none of the objects where they were found.

    Args:
      found: by number, the object and its pose f64[4, 4], T_world_object.
      top: height of the table, metres. fewest: pixels of a thing; with fewer it is left out.

    Returns:
      Of each thing, the one with the most pixels first, its mask bool[H, W] in each look. Things are apart if
      their points are.
    """
    masks = [_unexplained_pixels(look, found, top) for look in looks]
    points = [look.camera.points(look.depth)[mask] for look, mask in zip(looks, masks, strict=True)]
    if not sum(map(len, points)):
        return []
    cells = np.floor(np.concatenate(points) / _VOXEL).astype(int)
    cells -= cells.min(0)
    is_full = np.zeros(cells.max(0) + 1, bool)
    is_full[tuple(cells.T)] = True
    things = connected(is_full, np.ones((3, 3, 3)))[0][tuple(cells.T)]
    counts = np.bincount(things)
    kept = [thing for thing in np.argsort(-counts, kind="stable") if counts[thing] >= fewest]
    of_looks = np.split(things, np.cumsum([len(each) for each in points])[:-1])
    result = []
    for thing in kept:
        own = [mask.copy() for mask in masks]
        for mask, each in zip(own, of_looks, strict=True):
            mask[mask] = each == thing
        result.append(own)
    return result


def _unexplained_pixels(
    look: View, found: dict[int, tuple[ObjectModel, np.ndarray]], top: float
) -> np.ndarray:
    """bool[H, W]: the pixels of one look, those at the edges of things left out."""
    height = look.camera.points(look.depth)[..., 2]
    with np.errstate(invalid="ignore"):
        stands = (height > top + IN_FRONT) & (look.label != ARM)
    for model, pose in found.values():
        behind = look.depth - render_alone(model, look.camera, pose)
        stands &= ~(np.abs(behind) < IN_FRONT)
    return np.asarray(binary_opening(stands, np.ones((3, 3))))


def _correct_mask(look: View, expected: dict[int, tuple[ObjectModel, np.ndarray]]) -> View:
    label = look.label.copy()
    nearest = np.full(look.depth.shape, np.inf)
    for number, (model, pose) in expected.items():
        drawn = render_alone(model, look.camera, pose)
        is_drawn = np.isfinite(drawn)
        behind = np.where(is_drawn & np.isfinite(look.depth), look.depth, np.nan) - drawn
        near = np.abs(behind) < IN_FRONT
        shown = behind > -IN_FRONT
        if shown.sum() < _FEWEST or near.sum() < LEAST_SHARE * shown.sum():
            continue
        stray = (label == FIRST_OBJECT + number) & ~binary_dilation(is_drawn, iterations=_MARGIN)
        label[stray] = BACKGROUND
        # Whatever is near to it in depth is no other object; what is said to be the table may be.
        own = near & ((np.abs(behind) < AGREES) | (label != BACKGROUND)) & (drawn < nearest)
        label[own] = FIRST_OBJECT + number
        nearest[own] = drawn[own]
    return replace(look, label=label)


FEWEST_KNOWN = 3
"""Objects that must be seen near where they are known to be; with fewer nothing is corrected."""
_STEPS = (0.008, 0.004, 0.002, 0.001)
"""Metres by which an object is sought about its place, one after another."""
# Metres and radians that a camera may well be wrong by in plan.
_SHIFT = 0.01
_TURN = np.radians(1)

_PLACED = 0.002
"""Metres that an object is usually seen beside its place; one much farther off counts for little."""
_ROUNDS = 10


def correct_camera(
    look: View, known: dict[int, tuple[ObjectModel, np.ndarray]], share: float = 1.0
) -> View:
    """The look with its camera moved in plan and turned about the vertical: objects are where they were.

    Args:
      look: with masks of the objects.
      known: by number, the object and its pose f64[4, 4], T_world_object; what has moved since is outvoted
        by the others.
      share: of the way that the camera is brought there.
    """
    found = {
        number: _seen_beside(look, number, model, pose) for number, (model, pose) in known.items()
    }
    found = {number: shift for number, shift in found.items() if shift is not None}
    if len(found) < FEWEST_KNOWN:
        return look
    places = np.array([known[number][1][:2, 3] for number in found])
    middle = places.mean(0)
    shift, turn = _motion(places - middle, -np.array(list(found.values())))
    T = look.camera.T_world_camera.copy()
    R = yaw_matrix(share * turn)
    T[:3, :3] = R @ T[:3, :3]
    T[:2, 3] = middle + R[:2, :2] @ (T[:2, 3] - middle) + share * shift
    return replace(look, camera=replace(look.camera, T_world_camera=T))


def _seen_beside(
    look: View, number: int, model: ObjectModel, pose: np.ndarray
) -> np.ndarray | None:
    """f64[2], metres: how far from its pose an object agrees best with a look; None if it agrees nowhere."""
    if look.mask(number).sum() < FEWEST_PIXELS:
        return None
    compare = Comparer(model, number, [look])
    shift = np.zeros(2)

    def score(shift: np.ndarray) -> float:
        moved = pose.copy()
        moved[:2, 3] += shift
        return compare(moved).score

    best = score(shift)
    for step in _STEPS:
        for move in step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
            if (tried := score(shift + move)) > best:
                best = tried
                shift = shift + move
    return shift if best >= SURE else None


def _motion(places: np.ndarray, moves: np.ndarray) -> tuple[np.ndarray, float]:
    """f64[2], metres, and radians: the motion in plan, about the origin, on which most of n points agree.

    Args:
      places, moves: f64[n, 2], of each point.
    """
    rows = np.zeros((len(places), 2, 3))
    rows[:, :, :2] = np.eye(2)
    rows[:, :, 2] = np.column_stack([-places[:, 1], places[:, 0]])
    usual = np.diag([_SHIFT, _SHIFT, _TURN])
    motion = np.zeros(3)
    for _ in range(_ROUNDS):
        off = np.linalg.norm(moves - rows @ motion, axis=1)
        weight = 1 / (_PLACED**2 + off**2)
        matrix = np.einsum("n,nij,nik->jk", weight, rows, rows) + np.linalg.inv(usual) ** 2
        motion = np.linalg.solve(matrix, np.einsum("n,nij,ni->j", weight, rows, moves))
    return motion[:2], float(motion[2])


NUM_STEPS = 20
MOST_SHIFT = 0.003
"""Metres that a steady object moves at most."""
MOST_MOVED = 0.01
"""Metres that an object is moved at most, so that it overlaps with nothing."""
# Metres of penetration from which on two objects are moved apart, and of the gap that is then left.
_OVERLAP = 0.0002
_GAP = 0.0005

_LEVEL = 0.5
"""Vertical part of a contact normal up to which objects are side by side, and not one on the other."""
_PUSH_ROUNDS = 30


class PosePhysicsCheck:
    """Simulates estimated scenes for a moment, and moves overlapping objects apart.

    Args:
      objects: K. support: what carries them.
    """

    def __init__(self, objects: Sequence[ObjectAsset], support: SupportAsset) -> None:
        names = [f"{index:02d}-{asset.name}" for index, asset in enumerate(objects)]
        spec = populated_spec(names, objects, support, StabilityConfig().timestep, ContactConfig())
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        # Of each body the number of the object; -1 of the support and of the world.
        self._number = np.full(self._model.nbody, -1)
        for index, name in enumerate(names):
            self._number[self._model.body(name).id] = index

    def __call__(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """bool[K]: of the objects placed, bool[K], at f64[K, 7], those that moved by 3 mm or less."""
        data = self._data
        mujoco.mj_resetData(self._model, data)
        data.qpos.reshape(-1, 7)[is_placed] = poses[is_placed]
        start = data.qpos.reshape(-1, 7)[:, :3].copy()
        mujoco.mj_step(self._model, data, nstep=NUM_STEPS)
        shift = np.linalg.norm(data.qpos.reshape(-1, 7)[:, :3] - start, axis=1)
        return is_placed & (shift <= MOST_SHIFT)

    def apart(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """The poses f64[K, 7], those of objects that overlap side by side moved apart along the table.

        Estimates are millimetres wrong, and no layout stands around objects that overlap. Each of two gives
        way by half; all poses are as they were where one would move by more than a centimetre.

        Args:
          is_placed: bool[K], the objects that are there.
        """
        data = self._data
        moved = poses.copy()
        mujoco.mj_resetData(self._model, data)
        for _ in range(_PUSH_ROUNDS):
            data.qpos.reshape(-1, 7)[is_placed] = moved[is_placed]
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_collision(self._model, data)
            push = self._pushes()
            if not push.any():
                break
            moved[:, :2] += push
        too_far = np.linalg.norm(moved[:, :2] - poses[:, :2], axis=1).max(initial=0.0) > MOST_MOVED
        return poses.copy() if too_far else moved

    def _pushes(self) -> np.ndarray:
        """f64[K, 2]: by how much each object has to move, for the deepest contact of each pair."""
        contact = self._data.contact
        deepest = dict[tuple[int, int], int]()
        pairs = self._number[self._model.geom_bodyid[contact.geom]]
        is_beside = (
            (contact.dist < -_OVERLAP)
            & (np.abs(contact.frame[:, 2]) < _LEVEL)
            & (pairs >= 0).all(1)
        )
        for k in np.flatnonzero(is_beside)[np.argsort(-contact.dist[is_beside], kind="stable")]:
            deepest[tuple(pairs[k].tolist())] = k
        push = np.zeros((self._model.nq // 7, 2))
        for (first, second), k in deepest.items():
            normal = contact.frame[k, :2] / np.linalg.norm(contact.frame[k, :2])
            shift = (_GAP - contact.dist[k]) / 2 * normal
            push[first] -= shift
            push[second] += shift
        return push
