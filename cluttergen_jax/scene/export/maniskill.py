"""ManiSkill 3: what its loader needs to build a scene, and the scene's state as ManiSkill keeps it."""

from __future__ import annotations

import json
from typing import Any

from cluttergen_jax.assets.obj import part_name
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.frames import principal_of
from cluttergen_jax.scene.export.friction import friction_of, mean_of
from cluttergen_jax.scene.export.meshes import drawn_pieces, object_image, support_image, visual_name
from cluttergen_jax.scene.export.scene_json import scene_json


def maniskill_json(scene: Scene) -> bytes:
    """A scene's file for `cluttergen_maniskill.py`.

    `env_state` is ManiSkill's state dictionary without the robot: each actor's position, quaternion wxyz,
    linear and angular velocity.
    """
    bodies = {name: _body(asset) | _friction(asset, scene.contact) for name, asset in scene.assets.items()}
    record = json.loads(scene_json(scene, more=bodies, support=_support(scene.support)))
    rest = [0.0] * 6
    actors = {name: [*pose, *rest] for name, pose in zip(scene.names, scene.poses.tolist(), strict=True)}
    record["env_state"] = {"actors": actors}
    return (json.dumps(record, indent=1) + "\n").encode()


def _body(asset: ObjectAsset) -> dict[str, Any]:
    principal = principal_of(asset)
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
    }


def _friction(asset: ObjectAsset, contact: ContactConfig) -> dict[str, float]:
    """What the object's own sliding coefficient has to be in PhysX, if it has one."""
    default = contact.friction[0]
    return {} if asset.friction is None else {"friction": mean_of(friction_of(asset, contact)[0], default)}


def _support(support: SupportAsset) -> dict[str, Any]:
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
        "visuals": [
            {"file": visual_name(index), "rgba": list(piece.rgba), "image": support_image(piece)}
            for index, piece in enumerate(support.pieces)
        ],
    }
