"""Scene files as JSON: poses, cameras and bounds for the stand-alone loaders that travel with an export."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from cluttergen_jax.assets.shading import box_mesh
from cluttergen_jax.geometry import transform_points
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.meshes import SUPPORT_FOLDER, object_folder


def scene_bounds(scene: Scene) -> np.ndarray:
    """f64[2, 3]: the corners of the box around the support and all objects, metres, world frame.

    Robots are put beside it: an object may reach beyond the support.
    """
    points = [box_mesh(box).vertices for box in scene.support.boxes]
    for asset, pose in zip(scene.objects, scene.poses, strict=True):
        points += [transform_points(pose, part.vertices) for part in asset.parts]
    corners = np.concatenate(points)
    return np.stack([corners.min(0), corners.max(0)])


def objects_record(scene: Scene) -> list[dict[str, Any]]:
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


def cameras_record(scene: Scene) -> dict[str, Any]:
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
    scene: Scene, ending: str = "", more: Mapping[str, Any] | None = None, support: Any = None
) -> bytes:
    """A scene's file for a loader; paths are relative to the export's folder.

    Args:
      ending: of the model file that each object and the support have; "" for none.
      more: more about each asset, by its name.
      support: more about the support.
    """
    contact = scene.contact
    sliding, torsional, rolling = contact.friction
    record = {
        "format": 1,
        "conventions": "metres, kilograms, seconds; quaternions wxyz; z up; origin on the floor",
        "timestep": scene.stability.timestep,
        "gravity": [0.0, 0.0, -contact.gravity],
        "friction": {"sliding": sliding, "torsional": torsional, "rolling": rolling},
        "bounds": scene_bounds(scene).tolist(),
        "support": {
            "name": scene.support.name,
            "top": scene.support.top,
            "region": {
                "center": list(scene.support.region.center),
                "half_extents": list(scene.support.region.half_extents),
                "yaw": scene.support.region.yaw,
            },
            **({"file": f"{SUPPORT_FOLDER}/support.{ending}"} if ending else {}),
            **(support or {}),
        },
        "assets": {
            name: {
                "folder": object_folder(name),
                **({"file": f"{object_folder(name)}/{name}.{ending}"} if ending else {}),
                **(more or {}).get(name, {}),
            }
            for name in scene.assets
        },
        "objects": objects_record(scene),
        **cameras_record(scene),
    }
    return (json.dumps(record, indent=1) + "\n").encode()
