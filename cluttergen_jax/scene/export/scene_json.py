"""Scene files as JSON: poses, cameras and bounds for the stand-alone loaders that travel with an export."""

from __future__ import annotations

import json
import posixpath
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import PART_RGBA, SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.geometry import transform_points, yaw_quaternion
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.shapes import (
    SUPPORT_FOLDER,
    VisualShape,
    friction_of,
    mean_of,
    object_folder,
    principal_of,
    solids_of,
    surfaces_of,
)


def scene_bounds(scene: Scene) -> np.ndarray:
    """f64[2, 3]: the corners of the box around the support and all objects, metres, world frame.

    Robots are put beside it: an object may reach beyond the support.
    """
    points = [piece.mesh.vertices for piece in scene.support.collision_pieces]
    for asset, pose in zip(scene.objects, scene.poses, strict=True):
        points += [transform_points(pose, part.vertices) for part in asset.parts]
    corners = np.concatenate(points)
    return np.stack([corners.min(0), corners.max(0)])


def objects_record(scene: Scene) -> list[dict[str, object]]:
    """What stands where: metres, wxyz."""
    return [
        {
            "name": name,
            "asset": asset.name,
            "position": pose[:3].tolist(),
            "quaternion_wxyz": pose[3:].tolist(),
        }
        for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True)
    ]


def cameras_record(scene: Scene) -> dict[str, object]:
    """The entry `cameras` where there are any: each looks along its own -z, +y is up; degrees and pixels."""
    cameras = [
        {
            "name": each.name,
            "position": each.position.tolist(),
            "quaternion_wxyz": each.quaternion.tolist(),
            "fovy": each.fovy,
            "width": each.width,
            "height": each.height,
        }
        for each in scene.cameras
    ]
    return {"cameras": cameras} if cameras else {}


def scene_json(
    scene: Scene, ending: str = "", file_of: Callable[[ObjectAsset], str] | None = None
) -> bytes:
    """A scene's file for a loader; paths are relative to the export's folder.

    Args:
      ending: of the model file that each object and the support have; "" for none.
      file_of: where an object's model lies, if not in its folder, called as it.
    """
    return _bytes(_record(scene, ending, file_of))


def _bytes(record: dict[str, Any]) -> bytes:
    return (json.dumps(record, indent=1) + "\n").encode()


def _record(
    scene: Scene, ending: str = "", file_of: Callable[[ObjectAsset], str] | None = None
) -> dict[str, Any]:
    def model(asset: ObjectAsset) -> str:
        return file_of(asset) if file_of else f"{object_folder(asset)}/{asset.name}.{ending}"

    contact = scene.contact
    sliding, torsional, rolling = contact.friction
    support: dict[str, Any] = {
        "name": scene.support.name,
        "top": scene.support.top,
        "region": asdict(scene.support.region),
    }
    assets: dict[str, dict[str, Any]] = {
        name: {"folder": posixpath.dirname(model(asset))} for name, asset in scene.assets.items()
    }
    if ending:
        support["file"] = f"{SUPPORT_FOLDER}/support.{ending}"
        for name, asset in scene.assets.items():
            assets[name]["file"] = model(asset)
    return {
        "format": 1,
        "conventions": "metres, kilograms, seconds; quaternions wxyz; z up; origin on the floor",
        "timestep": scene.stability.timestep,
        "gravity": [0.0, 0.0, -contact.gravity],
        "friction": {"sliding": sliding, "torsional": torsional, "rolling": rolling},
        "bounds": scene_bounds(scene).tolist(),
        "support": support,
        "assets": assets,
        "objects": objects_record(scene),
        **cameras_record(scene),
    }


def maniskill_json(scene: Scene) -> bytes:
    """A scene's file for `cluttergen_maniskill.py`.

    `env_state` is ManiSkill's state dictionary without the robot: each actor's position, quaternion wxyz,
    linear and angular velocity.
    """
    record = _record(scene)
    record["support"] |= _support(scene.support)
    for name, asset in scene.assets.items():
        record["assets"][name] |= _body(asset, scene.contact)
    rest = [0.0] * 6
    poses = zip(scene.names, scene.poses.tolist(), strict=True)
    record["env_state"] = {"actors": {name: [*pose, *rest] for name, pose in poses}}
    return _bytes(record)


def _body(asset: ObjectAsset, contact: ContactConfig) -> dict[str, Any]:
    principal = principal_of(asset)
    record = {
        "mass": float(asset.mass),
        "center_of_mass": principal.center.tolist(),
        "principal_quaternion_wxyz": principal.turn.tolist(),
        "principal_moments": principal.moments.tolist(),
        **_shapes(asset),
    }
    if asset.friction is not None:
        # What the object's own sliding coefficient has to be in PhysX.
        record["friction"] = mean_of(friction_of(asset, contact)[0], contact.friction[0])
    return record


def _shapes(body: ObjectAsset | SupportAsset) -> dict[str, Any]:
    """The files of a body, without its boxes."""
    return {
        "parts": [solid.file for solid in solids_of(body) if solid.file],
        **({"part_rgba": list(PART_RGBA)} if isinstance(body, SupportAsset) else {}),
        "visuals": [
            {"file": each.file, "rgba": list(each.piece.rgba), "image": each.image, **_finish(each)}
            for each in surfaces_of(body)
        ],
    }


def _finish(surface: VisualShape) -> dict[str, Any]:
    """What is said of a surface's finish, of a map of roughness its mean; nothing where it has none."""
    if (finish := surface.piece.finish) is None:
        return {}
    mean = finish.without_maps
    record = {
        "roughness": mean.roughness,
        "metallic": mean.metallic,
        "transmission": mean.transmission,
        "normal": surface.normal,
    }
    return {"finish": record}


def _support(support: SupportAsset) -> dict[str, Any]:
    boxes = [
        {
            "center": list(box.center),
            "quaternion_wxyz": list(yaw_quaternion(box.yaw)),
            "half_extents": list(box.half_extents),
            "rgba": list(box.rgba),
        }
        for box in support.boxes
    ]
    return {"folder": SUPPORT_FOLDER, "boxes": boxes, **_shapes(support)}
