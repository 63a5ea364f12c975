"""LIBERO: what its loader needs to build a scene; objects and the support are as for robosuite."""

from __future__ import annotations

import json

import numpy as np

from cluttergen_jax.export.placement import placement_json, support_bounds
from cluttergen_jax.physics.rotation import rotate
from cluttergen_jax.scene import Scene


def libero_json(scene: Scene) -> bytes:
    """A scene's file for `cluttergen_libero.py`.

    `bounds`, f64[2, 3], are the corners of the box around the support and all objects, world frame: the robot
    stands clear of it.
    """
    record = json.loads(placement_json(scene, ending="xml"))
    corners = [support_bounds(scene.support)]
    for asset, pose in zip(scene.objects, scene.poses, strict=True):
        vertices = np.concatenate([part.vertices for part in asset.parts])
        corners.append(rotate(np, pose[3:], vertices) + pose[:3])
    points = np.concatenate(corners)
    record["bounds"] = [points.min(0).tolist(), points.max(0).tolist()]
    return (json.dumps(record, indent=1) + "\n").encode()
