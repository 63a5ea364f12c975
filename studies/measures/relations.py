"""Relations that arise by themselves: one thing on, in, under another, or leaning against it.

Of a settled scene, between i and j (j may be the support for `on`), each with a crisp meaning:

  in       a quarter or more of i's surface lies in j's hollow, j stands within 45 degrees of upright, and j
           carries i, directly or through others.
  leaning  i is tilted by 10 degrees or more from the nearest pose in which it rests by itself, and j presses
           on it with a twentieth of its weight or more, in a direction 30 degrees or more from the vertical.
  on       j bears a tenth or more of i's weight.
  under    straight above a quarter or more of i's surface the next body is j, and i does not bear j.

The first that applies counts; `under` only if no other one holds between the two, in either direction.
"""

from __future__ import annotations

import enum
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache

import mujoco
import numpy as np
from scipy.spatial import cKDTree

from cluttergen_jax.assets.hollow import hollow_of
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.geometry import conjugate, rotate, transform_points
from cluttergen_jax.judging.scene_models import (
    Contacts,
    SceneModels,
    StandingModel,
    contacts_of,
    each_scene,
)

SURFACE_SHARE = 0.25
MAX_VESSEL_TILT = float(np.radians(45.0))
MIN_LEAN = float(np.radians(10.0))
MIN_LEAN_NORMAL = float(np.radians(30.0))
MIN_PRESS = 0.05
_NUM_RAYS = 128


class Relation(enum.IntEnum):
    """What i is to j."""

    NONE = 0
    ON = 1
    IN = 2
    UNDER = 3
    LEANING = 4

    @property
    def label(self) -> str:
        """The word for tables."""
        return "leaning on" if self is Relation.LEANING else self.name.lower()


def relations(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    contacts: Contacts | None = None,
    num_threads: int = 0,
) -> np.ndarray:
    """The relation of every two bodies of finished scenes.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      contacts: of the same scenes, if they are at hand.

    Returns:
      i8[N, K, K + 1]: [n, i, j] is the `Relation` of i to j in scene n; index K is the support.
    """
    contacts = contacts or contacts_of(models, poses, is_placed, num_threads)
    poses = np.asarray(poses, np.float64)
    is_placed = np.asarray(is_placed, bool)
    is_in = np.zeros(contacts.rests_on.shape, bool)
    covered = np.zeros(contacts.rests_on.shape)

    def run(scene: int) -> None:
        model = models.of(is_placed[scene])
        covered[scene] = _covered_shares(model, models.world.objects, poses[scene])
        is_in[scene, :, :-1] = _inside(models.world.objects, poses[scene], is_placed[scene])

    each_scene(run, len(poses), num_threads)
    tilt = np.array(
        [
            [tilt_from_rest(a, p) for a, p in zip(models.world.objects, row, strict=True)]
            for row in poses
        ]
    )
    return _judge(contacts, is_in, tilt, covered)


def _judge(
    contacts: Contacts, is_in: np.ndarray, tilt: np.ndarray, covered: np.ndarray
) -> np.ndarray:
    """The relations from what was measured, by the definitions above."""
    rests_on = contacts.rests_on
    result = np.zeros(rests_on.shape, np.int8)
    result[rests_on] = Relation.ON
    result[(tilt[..., None] >= MIN_LEAN) & _presses_sideways(contacts)] = Relation.LEANING
    result[is_in & carried_by(rests_on)] = Relation.IN
    between = result[..., :-1]
    is_free = (between == Relation.NONE) & (np.swapaxes(between, 1, 2) == Relation.NONE)
    between[is_free & (covered[..., :-1] >= SURFACE_SHARE)] = Relation.UNDER
    return result


def carried_by(rests_on: np.ndarray) -> np.ndarray:
    """bool[N, K, K + 1]: i rests on j, directly or through others."""
    reach = np.array(rests_on, bool)
    for middle in range(reach.shape[1]):
        reach |= reach[:, :, middle, None] & reach[:, middle, None, :]
    return reach


def _presses_sideways(contacts: Contacts) -> np.ndarray:
    """bool[N, K, K + 1]: j presses on i, far from vertically."""
    size = np.linalg.norm(contacts.normal, axis=-1)
    upright = np.abs(contacts.normal[..., 2])
    is_slanted = upright <= np.cos(MIN_LEAN_NORMAL) * size
    return is_slanted & (size >= MIN_PRESS * contacts.weight[..., None]) & (size > 0)


def tilt_from_rest(asset: ObjectAsset, pose: np.ndarray) -> float:
    """Radians between up as the object at pose f[7] sees it and as it sees it in its nearest resting pose."""
    now = _up(np.asarray(pose, np.float64)[None, 3:])
    rests = _up(np.array([rest.quaternion for rest in asset.resting], np.float64))
    # The arc's cosine alone says nothing of small angles.
    angles = np.arctan2(np.linalg.norm(np.cross(rests, now), axis=1), rests @ now[0])
    return float(angles.min())


def _up(quaternions: np.ndarray) -> np.ndarray:
    """f64[M, 3]: where up is in the frames of bodies turned by f64[M, 4] wxyz."""
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return rotate(np, conjugate(unit), np.tile([0.0, 0.0, 1.0], (len(unit), 1)))


def _inside(objects: Sequence[ObjectAsset], poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
    """bool[K, K]: a quarter of i's surface lies in the hollow of j, which is upright."""
    result = np.zeros((len(objects), len(objects)), bool)
    placed = np.flatnonzero(is_placed).tolist()
    for j in placed:
        vessel = vessel_of(objects[j])
        up = rotate(np, poses[j, 3:], np.array([0.0, 0.0, 1.0]))[2]
        if vessel is None or up < np.cos(MAX_VESSEL_TILT):
            continue
        for i in (each for each in placed if each != j):
            if np.linalg.norm(poses[i, :3] - poses[j, :3]) > objects[i].radius + objects[j].radius:
                continue
            cloud = transform_points(poses[i], objects[i].cloud) - poses[j, :3]
            back = conjugate(poses[j, 3:])
            result[i, j] = vessel.holds(rotate(np, back[None], cloud)).mean() >= SURFACE_SHARE
    return result


def _covered_shares(
    scene: StandingModel, objects: Sequence[ObjectAsset], poses: np.ndarray
) -> np.ndarray:
    """f64[K, K + 1]: the share of i's surface points over which the next body straight above is j."""
    data = scene.start(poses)
    geom = np.zeros(1, np.int32)
    index = np.append(scene.objects, len(objects))[scene.layout.geom_object]
    share = np.zeros((len(objects), len(objects) + 1))
    up = np.array([0.0, 0.0, 1.0])
    for i, body in zip(scene.objects, scene.layout.body_index, strict=True):
        for point in transform_points(poses[i], objects[i].cloud[:_NUM_RAYS]):
            mujoco.mj_ray(scene.model, data, point, up, None, 1, int(body), geom)
            if geom[0] >= 0:
                share[i, index[geom[0]]] += 1 / _NUM_RAYS
    return share


def count_relations(
    relation: np.ndarray, families: Sequence[str], support: str = "support"
) -> Counter[tuple[str, str, str]]:
    """How often each relation holds between each two families, such as ("on", "mug", "hardback_book").

    Args:
      relation: i8[N, K, K + 1] from `relations`.
      families: what each of the K objects is called; several may be called alike.
      support: what to call the support.
    """
    names = [*families, support]
    found = np.argwhere(relation != Relation.NONE)
    return Counter(
        (Relation(int(relation[n, i, j])).label, names[i], names[j]) for n, i, j in found
    )


class Hollow:
    """The space that would hold water in an object that stands upright, object frame.

    Args:
      points: f64[P, 3], a cubic grid of points inside, metres; pitch: its step.
    """

    def __init__(self, points: np.ndarray, pitch: float) -> None:
        self._tree = cKDTree(points)
        self._reach = 0.5001 * pitch

    def holds(self, points: np.ndarray) -> np.ndarray:
        """bool[M]: which points f[M, 3] of the object frame lie in the hollow, to within a cell."""
        return (
            self._tree.query(points, p=np.inf, distance_upper_bound=self._reach)[0] <= self._reach
        )


@lru_cache(maxsize=256)
def vessel_of(asset: ObjectAsset) -> Hollow | None:
    """An object's hollow, or None if it has none.

    By the importer's rule (`assets.hollow`): as deep as 15 mm and a fifth of its width, and open to
    a ball of 10 mm. A plate is no vessel.
    """
    hollow = hollow_of(asset)
    return None if hollow is None else Hollow(hollow.points, hollow.pitch)
