"""A whole scene from an MJCF file: free bodies as objects, all that is fixed as the support.

For looking and drawing. What a scene file does not say is left open: resting poses, licences. What is seen is
decided as for imports (`readers.mjcf_roles`); planes are left out: who draws adds a floor.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from cluttergen_jax.assets.cloud import farthest_first, sample_surface
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.object import CLOUD_SIZE, ObjectAsset, RestingPose
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.errors import AssetError
from cluttergen_jax.geometry import rotation_matrix, transform_points
from cluttergen_jax.importing.readers.mjcf import Roles, roles_of
from cluttergen_jax.importing.readers.mjcf_compile import compile_with_notes
from cluttergen_jax.scene.scene import Scene

_FLAT = 0.01


def read_mjcf_scene(path: str | Path) -> Scene:
    """The first of `read_mjcf_scene_with_notes`."""
    return read_mjcf_scene_with_notes(path)[0]


def read_mjcf_scene_with_notes(path: str | Path) -> tuple[Scene, tuple[str, ...]]:
    """A scene at its keyframe called `scene`, its first keyframe, or its reference configuration.

    Returns:
      It, and which pictures it has to do without.

    Raises:
      AssetError: MuJoCo cannot compile the file, or no body in it is free and has a surface.
    """
    path = Path(path)
    model, notes = compile_with_notes(path)
    data = mujoco.MjData(model)
    if model.nkey:
        named = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "scene")
        mujoco.mj_resetDataKeyframe(model, data, max(named, 0))
    mujoco.mj_kinematics(model, data)
    free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    if not len(free):
        raise AssetError(f"{path} holds nothing that can move freely", "a file with free bodies")
    roles = {int(body): _roles(model, data, model.body_rootid == body) for body in free}
    # A free body of helpers alone, such as a target that is moved about, is none of the objects.
    free = np.array([body for body, found in roles.items() if found.surface], int)
    if not len(free):
        raise AssetError(
            f"{path} holds free bodies, but nothing of them is seen or collides",
            "geoms in groups 0 to 2 with an alpha above 0, or geoms that collide; planes do not count",
        )
    provenance = Provenance(path.name, "not stated")
    objects = tuple(_object(model, data, body, roles[body], provenance) for body in free.tolist())
    poses = np.concatenate([data.xpos[free], data.xquat[free]], axis=1)
    names = tuple(asset.name for asset in objects)
    return Scene(names, objects, poses, _support(model, data, objects, poses, provenance)), notes


def _roles(model: mujoco.MjModel, data: mujoco.MjData, is_of: np.ndarray) -> Roles:
    """The roles of all geoms of the bodies that bool[nbody] `is_of` marks."""
    return roles_of(model, data, np.flatnonzero(is_of[model.geom_bodyid]).tolist())


def _object(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, roles: Roles, provenance: Provenance
) -> ObjectAsset:
    turn = data.xmat[body].reshape(3, 3)
    origin = data.xpos[body]
    name = model.body(body).name or f"body-{body}"
    pieces = tuple(geom.piece().transform(turn.T, -turn.T @ origin) for geom in roles.surface)
    meshes = (geom.mesh() for geom in roles.colliding or roles.surface)
    parts = tuple(Mesh.points(mesh.transform(turn.T, -turn.T @ origin).vertices) for mesh in meshes)
    axes = rotation_matrix(model.body_iquat[body])
    return ObjectAsset(
        name=name,
        label=name,
        pieces=pieces,
        parts=parts,
        mass=float(model.body_mass[body]),
        center_of_mass=model.body_ipos[body].copy(),
        inertia=axes @ np.diag(model.body_inertia[body]) @ axes.T,
        cloud=_cloud(join_meshes([piece.mesh for piece in pieces])),
        resting=(RestingPose((1.0, 0.0, 0.0, 0.0), float(-parts[0].vertices[:, 2].min()), 1.0),),
        provenance=provenance,
    )


def _cloud(mesh: Mesh) -> np.ndarray:
    """f32[1024, 3], farthest-point ordered."""
    points = sample_surface(mesh, CLOUD_SIZE, 0)
    return points[farthest_first(points)].astype(np.float32)


def _support(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    objects: tuple[ObjectAsset, ...],
    poses: np.ndarray,
    provenance: Provenance,
) -> SupportAsset:
    """All fixed geoms; the top is where the lowest object stands."""
    seen = _roles(model, data, model.body_weldid == 0).surface
    pieces = tuple(geom.piece() for geom in seen)
    placed = zip(objects, poses, strict=True)
    corners = [
        transform_points(pose, part.vertices) for each, pose in placed for part in each.parts
    ]
    standing = np.concatenate(corners)
    top = float(standing[:, 2].min())
    flat = [piece.mesh.vertices for piece in pieces] or [standing]
    level = np.concatenate(flat)
    level = level[np.abs(level[:, 2] - top) < _FLAT]
    outline = level if len(level) > 2 else standing
    low = outline[:, :2].min(0)
    high = outline[:, :2].max(0)
    # What stands on an edge leaves no area to be seen.
    center = (low + high) / 2
    half = np.maximum((high - low) / 2, _FLAT)
    region = Rectangle((float(center[0]), float(center[1])), (float(half[0]), float(half[1])))
    return SupportAsset("support", "support", (), top, region, provenance, pieces)
