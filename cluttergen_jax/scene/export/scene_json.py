"""Scene files as JSON: poses, cameras and bounds for the stand-alone loaders that travel with an export."""

from __future__ import annotations

import json
import posixpath
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from cluttergen_jax.assets.obj import part_name
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import PART_RGBA, SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.geometry import transform_points, yaw_quaternion
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.frames import friction_of, mean_of, principal_of
from cluttergen_jax.scene.export.meshes import (
    SUPPORT_FOLDER,
    drawn_pieces,
    object_folder,
    object_image,
    own_image,
    visual_name,
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
    scene: Scene,
    ending: str = "",
    more: Mapping[str, Any] | None = None,
    support: Any = None,
    file_of: Callable[[ObjectAsset], str] | None = None,
) -> bytes:
    """A scene's file for a loader; paths are relative to the export's folder.

    Args:
      ending: of the model file that each object and the support have; "" for none.
      more: more about each asset, by its name.
      support: more about the support.
      file_of: where an object's model lies, if not in its folder, called as it.
    """

    def model(asset: ObjectAsset) -> str:
        return file_of(asset) if file_of else f"{object_folder(asset.name)}/{asset.name}.{ending}"

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
                "folder": posixpath.dirname(model(asset)),
                **({"file": model(asset)} if ending else {}),
                **(more or {}).get(name, {}),
            }
            for name, asset in scene.assets.items()
        },
        "objects": objects_record(scene),
        **cameras_record(scene),
    }
    return (json.dumps(record, indent=1) + "\n").encode()


def maniskill_json(scene: Scene) -> bytes:
    """A scene's file for `cluttergen_maniskill.py`.

    `env_state` is ManiSkill's state dictionary without the robot: each actor's position, quaternion wxyz,
    linear and angular velocity.
    """
    bodies = {name: _body(asset, scene.contact) for name, asset in scene.assets.items()}
    record = json.loads(scene_json(scene, more=bodies, support=_support(scene.support)))
    rest = [0.0] * 6
    actors = {
        name: [*pose, *rest] for name, pose in zip(scene.names, scene.poses.tolist(), strict=True)
    }
    record["env_state"] = {"actors": actors}
    return (json.dumps(record, indent=1) + "\n").encode()


def _body(asset: ObjectAsset, contact: ContactConfig) -> dict[str, object]:
    principal = principal_of(asset)
    default = contact.friction[0]
    # What the object's own sliding coefficient has to be in PhysX, if it has one.
    own = (
        {}
        if asset.friction is None
        else {"friction": mean_of(friction_of(asset, contact)[0], default)}
    )
    return {
        "mass": float(asset.mass),
        "center_of_mass": principal.center.tolist(),
        "principal_quaternion_wxyz": principal.turn.tolist(),
        "principal_moments": principal.moments.tolist(),
        "parts": [part_name(index) for index in range(len(asset.parts))],
        "visuals": [
            {"file": visual_name(index), "rgba": list(piece.rgba), "image": object_image(piece)}
            for index, piece in enumerate(drawn_pieces(asset))
        ],
        **own,
    }


def _support(support: SupportAsset) -> dict[str, object]:
    return {
        "folder": "assets/support",
        "boxes": [
            {
                "center": list(box.center),
                "quaternion_wxyz": list(yaw_quaternion(box.yaw)),
                "half_extents": list(box.half_extents),
                "rgba": list(box.rgba),
            }
            for box in support.boxes
        ],
        "parts": [part_name(index) for index in range(len(support.parts))],
        "part_rgba": list(PART_RGBA),
        "visuals": [
            {"file": visual_name(index), "rgba": list(piece.rgba), "image": own_image(piece)}
            for index, piece in enumerate(support.pieces)
        ],
    }
