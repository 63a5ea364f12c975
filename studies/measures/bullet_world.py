"""The project's objects and supports as PyBullet bodies: the same hulls, masses, inertias and friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets import obj
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.geometry import conjugate, product, rotate
from cluttergen_jax.scene.export.shapes import factor_of, friction_of


def load_pybullet(purpose: str) -> ModuleType:
    """The module, or MissingExtraError naming the extra `peers`."""
    try:
        import pybullet
    except ImportError as error:
        raise MissingExtraError("peers", purpose) from error
    return pybullet


@dataclass(frozen=True, eq=False)
class BodyFrames:
    """Where each object's principal axes lie in its object frame: PyBullet takes a diagonal inertia only.

    Attributes:
      center: f64[K, 3]; turn: f64[K, 4] wxyz, the principal frames in the object frames.
      inertia: f64[K, 3], about the principal axes.
    """

    center: np.ndarray
    turn: np.ndarray
    inertia: np.ndarray

    @staticmethod
    def of(objects: Sequence[ObjectAsset]) -> BodyFrames:
        """The frames of K objects."""
        # Not the frames of the exports (`scene.export.shapes`): Bullet's contacts depend on how axes lie, and
        # published figures were made with these.
        inertia, axes = np.linalg.eigh(np.stack([asset.inertia for asset in objects]))
        axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
        turn = Rotation.from_matrix(axes).as_quat(scalar_first=True)
        return BodyFrames(np.stack([asset.center_of_mass for asset in objects]), turn, inertia)

    def body_poses(self, objects: Sequence[int], poses: np.ndarray) -> np.ndarray:
        """f64[n, 7], position and quaternion xyzw of bodies, from the objects' poses f[n, 7] (wxyz)."""
        objects = list(objects)
        position = poses[:, :3] + rotate(np, poses[:, 3:], self.center[objects])
        turn = product(poses[:, 3:], self.turn[objects])
        return np.c_[position, turn[:, 1:], turn[:, 0]]

    def object_poses(self, objects: Sequence[int], bodies: np.ndarray) -> np.ndarray:
        """The inverse of `body_poses`."""
        objects = list(objects)
        turn = product(bodies[:, [6, 3, 4, 5]], conjugate(self.turn[objects]))
        return np.c_[bodies[:, :3] - rotate(np, turn, self.center[objects]), turn]


def support_friction(contact: ContactConfig) -> float:
    """The support's coefficient: PyBullet multiplies those of two bodies."""
    return factor_of(contact.friction[0], contact.friction[0])


def object_friction(asset: ObjectAsset, contact: ContactConfig) -> float:
    """An object's: on the support its own friction, or the contact's; see `scene.export.shapes`."""
    return factor_of(friction_of(asset, contact)[0], contact.friction[0])


def write_compound(path: Path, asset: ObjectAsset, frames: BodyFrames, index: int) -> None:
    """An OBJ of the hulls of object number `index` in its principal frame.

    PyBullet makes one compound of the file's groups, each of them convex.
    """
    lines: list[str] = []
    first = 1
    back = conjugate(frames.turn[index])
    for part in asset.parts:
        vertices = rotate(np, back, part.vertices - frames.center[index])
        faces = ConvexHull(part.vertices).simplices + first
        lines += [f"o part-{first}", *obj.lines("v", vertices, ".9g"), *obj.lines("f", faces, "d")]
        first += len(vertices)
    path.write_text(obj.text(lines), encoding="ascii")


def add_support(pybullet: ModuleType, client: int, support: SupportAsset, friction: float) -> None:
    """Adds a support's boxes and convex parts, fixed."""
    for part in support.parts:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_MESH, vertices=part.vertices.tolist(), physicsClientId=client
        )
        body = pybullet.createMultiBody(0, shape, -1, physicsClientId=client)
        pybullet.changeDynamics(body, -1, lateralFriction=friction, physicsClientId=client)
    for box in support.boxes:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=box.half_extents, physicsClientId=client
        )
        turn = pybullet.getQuaternionFromEuler((0, 0, box.yaw))
        body = pybullet.createMultiBody(0, shape, -1, box.center, turn, physicsClientId=client)
        pybullet.changeDynamics(body, -1, lateralFriction=friction, physicsClientId=client)


def add_object(
    pybullet: ModuleType,
    client: int,
    compound: Path,
    mass: float,
    inertia: np.ndarray,
    friction: float,
    is_rigid: bool = False,
) -> int:
    """Adds a free body and returns its number.

    Args:
      compound: the file that `write_compound` wrote.
      mass: kilograms; inertia: f64[3], kg m^2, about the principal axes.
      is_rigid: PyBullet's older, quicker rigid bodies instead of multi-bodies.
    """
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_MESH, fileName=str(compound), physicsClientId=client
    )
    body = pybullet.createMultiBody(
        mass, shape, useMaximalCoordinates=is_rigid, physicsClientId=client
    )
    # Without the mass beside it, the inertia of a rigid body becomes not-a-number.
    pybullet.changeDynamics(
        body,
        -1,
        mass=mass,
        localInertiaDiagonal=np.asarray(inertia).tolist(),
        lateralFriction=friction,
        physicsClientId=client,
    )
    return int(body)
