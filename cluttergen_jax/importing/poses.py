"""The poses of a pool's objects: which there are, and how an object is put into another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import find_pool, hold_pool, read_pool, user_pool_folder, write_pool
from cluttergen_jax.assets.settle import upright_turn
from cluttergen_jax.assets.stances import stances
from cluttergen_jax.errors import PoolError, range_text
from cluttergen_jax.importing.solo_stability import turned_object
from cluttergen_jax.physics.log import silent_log

_SAME = np.cos(np.radians(12))


@dataclass(frozen=True)
class Pose:
    """A pose in which an object of a pool can stand.

    Attributes:
      up: the direction of its frame that points up there.
      height: metres from the table to its highest point.
      tip: degrees by which it can be tilted, and comes back.
      likelihood: share of all directions from which it rolls into this pose.
    """

    up: tuple[float, float, float]
    height: float
    tip: float
    likelihood: float


def pool_poses(pool: str, name: str) -> tuple[Pose, ...]:
    """The poses of an object: 0 is the one that it has, the others follow, the steadiest first.

    Raises:
      PoolError: there is no such pool, or no such object in it.
    """
    return _poses(find_pool(pool)[name])


def _poses(asset: ObjectAsset) -> tuple[Pose, ...]:
    found = stances(np.concatenate([part.vertices for part in asset.parts]), asset.center_of_mass)
    poses = []
    for each in found:
        x, y, z = each.up.tolist()
        poses.append(Pose((x, y, z), each.height, float(np.degrees(each.tip)), each.likelihood))
    own = [pose for pose in poses if pose.up[2] > _SAME][:1]
    as_it_is = Pose((0.0, 0.0, 1.0), float(2 * asset.half_extents[2]), 0.0, 0.0)
    return (*(own or [as_it_is]), *(pose for pose in poses if pose not in own))


def set_pose(pool: str, name: str, pose: int) -> ObjectAsset:
    """Puts an object of one of the user's own pools into another of its `pool_poses`; writes the pool anew.

    Parts stay, but for their flat bottom; what depends on the pose is measured again. Cached objects stay as
    they were imported. The pool has another hash after it.

    Returns:
      The object as it is now; 0 changes nothing.

    Raises:
      PoolError: there is no such pool of the user's own, no such object in it, or no such pose.
      AssetError: it does not stand so.
    """
    with hold_pool(user_pool_folder(pool)):
        folder = user_pool_folder(pool)
        old = read_pool(folder)
        asset = old[name]
        poses = _poses(asset)
        if not 0 <= pose < len(poses):
            raise PoolError(
                f"pose {pose} of {name!r}",
                range_text(0, len(poses) - 1, "an object that has poses"),
            )
        if pose == 0:
            return asset
        with silent_log():
            turned = turned_object(asset, upright_turn(np.array(poses[pose].up)))
        # Of a large pool objects are read anew whenever they are asked for.
        objects = tuple(turned if each.name == name else each for each in old.objects)
        write_pool(folder, replace(old, objects=objects), overwrite=True)
    return turned
