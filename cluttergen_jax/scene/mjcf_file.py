"""A whole scene from somebody's MJCF file: free bodies as objects, all that is fixed as the support.

For looking and drawing. What a scene file does not say is left open: resting poses, licences.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from cluttergen_jax.assets.cloud import farthest_first, sample_surface
from cluttergen_jax.assets.mesh import Mesh, joined
from cluttergen_jax.assets.object import CLOUD_SIZE, ObjectAsset, RestingPose
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.errors import AssetError
from cluttergen_jax.geometry import rotation_matrix, transformed
from cluttergen_jax.importing.readers.mjcf import compiled, geom_mesh, geom_piece, is_solid
from cluttergen_jax.scene.scene import Scene

_FLAT = 0.01


def read_mjcf_scene(path: str | Path) -> Scene:
    """Reads a scene at its keyframe called `scene`, its first keyframe, or its reference configuration.

    Raises:
      AssetError: MuJoCo cannot compile the file, or no body in it is free.
    """
    path = Path(path)
    model = compiled(path)
    data = mujoco.MjData(model)
    if model.nkey:
        named = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "scene")
        mujoco.mj_resetDataKeyframe(model, data, max(named, 0))
    mujoco.mj_kinematics(model, data)
    free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    if not len(free):
        raise AssetError(f"{path} holds nothing that can move freely", "a file with free bodies")
    provenance = Provenance(path.name, "not stated")
    objects = tuple(_object(model, data, int(body), provenance) for body in free)
    poses = np.concatenate([data.xpos[free], data.xquat[free]], axis=1)
    names = tuple(asset.name for asset in objects)
    return Scene(names, objects, poses, _support(model, data, objects, poses, provenance))


def _object(model: mujoco.MjModel, data: mujoco.MjData, body: int, provenance: Provenance) -> ObjectAsset:
    turn, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
    geoms = [i for i in range(model.ngeom) if _root(model, i) == body and is_solid(model, i)]
    touches = [i for i in geoms if model.geom_contype[i] or model.geom_conaffinity[i]]
    seen = [i for i in geoms if i not in touches] or geoms
    name = model.body(body).name or f"body-{body}"
    if not geoms:
        raise AssetError(f"body {name} has no solid geoms")
    local = {i: geom_mesh(model, data, i).transformed(turn.T, -turn.T @ origin) for i in geoms}
    pieces = tuple(geom_piece(model, data, i).transformed(turn.T, -turn.T @ origin) for i in seen)
    axes = rotation_matrix(model.body_iquat[body])
    parts = tuple(Mesh.points(local[i].vertices) for i in touches or geoms)
    return ObjectAsset(
        name=name,
        label=name,
        pieces=pieces,
        parts=parts,
        mass=float(model.body_mass[body]),
        center_of_mass=model.body_ipos[body].copy(),
        inertia=axes @ np.diag(model.body_inertia[body]) @ axes.T,
        cloud=_cloud(joined([piece.mesh for piece in pieces])),
        resting=(RestingPose((1.0, 0.0, 0.0, 0.0), float(-parts[0].vertices[:, 2].min()), 1.0),),
        provenance=provenance,
    )


def _root(model: mujoco.MjModel, geom: int) -> int:
    """The world's child that a geom hangs on; 0 for the world's own."""
    body = int(model.geom_bodyid[geom])
    return int(model.body_rootid[body])


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
    fixed = [
        i for i in range(model.ngeom) if model.body_weldid[model.geom_bodyid[i]] == 0 and is_solid(model, i)
    ]
    touches = [i for i in fixed if model.geom_contype[i] or model.geom_conaffinity[i]]
    seen = [i for i in fixed if i not in touches] or fixed
    pieces = tuple(geom_piece(model, data, i) for i in seen)
    placed = zip(objects, poses, strict=True)
    corners = [transformed(pose, part.vertices) for each, pose in placed for part in each.parts]
    standing = np.concatenate(corners)
    top = float(standing[:, 2].min())
    flat = [piece.mesh.vertices for piece in pieces] or [standing]
    level = np.concatenate(flat)
    level = level[np.abs(level[:, 2] - top) < _FLAT]
    outline = level if len(level) > 2 else standing
    low, high = outline[:, :2].min(0), outline[:, :2].max(0)
    # What stands on an edge leaves no area to be seen.
    center, half = (low + high) / 2, np.maximum((high - low) / 2, _FLAT)
    region = Rectangle((float(center[0]), float(center[1])), (float(half[0]), float(half[1])))
    return SupportAsset("support", "support", (), top, region, provenance, pieces)
