"""How far scenes are from each other, in metres: the ground of measures of diversity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets import ObjectAsset, Rectangle
from cluttergen_jax.judging.scene_models import check_scenes

_COORDINATES = 13


def embed(
    objects: Sequence[ObjectAsset],
    poses: np.ndarray,
    is_placed: np.ndarray,
    region: Rectangle,
    top: float,
    absence: float | None = None,
    num_slots: int | None = None,
) -> np.ndarray:
    """Scenes as vectors whose Euclidean distance is the scene distance, metres: kernels of it are sound.

    The distance of one object in two scenes is the root mean square, over its mass, of how far its points lie
    from themselves: its square is |p - q|^2 + tr((R - Q) C (R - Q)^T), with p and q the centres of mass, R
    and Q the orientations, and C the second moment of the mass about its centre. A turn of a long object
    counts for more than one of a small object, as it should.

    An object that is absent counts as a point without extent at the region's centre, `absence` metres away in
    a direction of its own: the distance to it exists, is the same both ways, and two absences are zero apart.
    The distance of two scenes is the root of their objects' squares added up and divided by `num_slots`.

    Objects are told apart by their index: of two equal mugs that change places, each has moved.

    Args:
      objects: the world's K objects.
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      region: the queried region; top: height of the support's top, metres.
      absence: metres; None takes half the region's diagonal.
      num_slots: objects that a scene holds; None takes the most that any of these scenes holds. Sets that are
        to be compared need the same number.

    Returns:
      f64[N, 13 K].
    """
    check_scenes(poses, is_placed, len(objects))
    poses = np.asarray(poses, np.float64)
    is_placed = np.asarray(is_placed, bool)
    slots = int(is_placed.sum(1).max(initial=1)) if num_slots is None else num_slots
    absence = float(np.hypot(*region.half_extents)) if absence is None else absence
    vectors = np.zeros((*is_placed.shape, _COORDINATES))
    vectors[..., -1] = np.where(is_placed, 0.0, absence)
    for k, asset in enumerate(objects):
        here = is_placed[:, k]
        vectors[here, k, :-1] = _object_vectors(
            asset, poses[here, k], np.array([*region.center, top])
        )
    return vectors.reshape(len(poses), -1) / np.sqrt(slots)


def _object_vectors(asset: ObjectAsset, poses: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """f64[n, 12]: centre of mass from `origin`, then the rotation times `moment_root`."""
    if not len(poses):
        return np.zeros((0, _COORDINATES - 1))
    turn = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_matrix()
    center = poses[:, :3] + turn @ np.asarray(asset.center_of_mass) - origin
    return np.concatenate([center, (turn @ moment_root(asset)).reshape(-1, 9)], axis=1)


def moment_root(asset: ObjectAsset) -> np.ndarray:
    """f64[3, 3]: the symmetric root of the mass's second moment about its centre, metres, object axes.

    From the inertia I: C = (tr(I) / 2 - I) / m. Its trace is the squared radius of gyration about the centre.
    """
    inertia = np.asarray(asset.inertia, np.float64)
    values, axes = np.linalg.eigh((np.trace(inertia) / 2 * np.eye(3) - inertia) / asset.mass)
    return (axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T
