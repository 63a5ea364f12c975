"""What NVIDIA's SimReady asks of an object beside its USD: who made it and what it is, and a picture."""

from __future__ import annotations

import datetime
import io

import numpy as np
from PIL import Image

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.scene.export.meshes import category, drawn_pieces
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import FARTHEST, RaySensor, sensed_model

QCODE = "Q223557"
"""Wikidata's item for a physical object: true of everything, and no more is known."""
MATERIAL = "unknown"
SIZE = 256
_LIGHT = np.array([-0.4, -0.5, 0.77])
_FILL = 0.35
_VIEW = np.array([-0.6, -1.0, 0.7])


def metadata(asset: ObjectAsset) -> dict[str, object]:
    """The fields of its rules SR.001 and SR.004; metres, kilograms."""
    vertices = np.concatenate([piece.mesh.vertices for piece in drawn_pieces(asset)])
    origin = asset.provenance
    return {
        "author": origin.attribution or origin.source or "unknown",
        "asset_name": asset.name,
        "asset_type": "prop",
        "asset_license": origin.licence or "not stated",
        "category": category(asset),
        "source_file": origin.source or "unknown",
        "usd_date_generated": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "qcode": QCODE,
        "rigid_body_count": 1,
        "asset_extents": np.ptp(vertices, axis=0).tolist(),
        "mass": float(asset.mass),
    }


def thumbnail(asset: ObjectAsset) -> bytes:
    """A PNG of the object, cast by rays, so that it takes no display."""
    sensor = RaySensor(sensed_model([asset], None), surfaces=bool(asset.pieces))
    data = sensor.make_data()
    sensor.pose(data, np.array([[0, 0, 0, 1, 0, 0, 0]]))
    radius = float(
        np.linalg.norm(np.concatenate([p.mesh.vertices for p in drawn_pieces(asset)]), axis=1).max()
    )
    eye = 4 * radius * _VIEW / np.linalg.norm(_VIEW)
    camera = Camera.looking(eye, np.zeros(3), SIZE, SIZE, 3.6 * SIZE / 2)
    image = sensor.sense(data, camera)
    is_seen = image.geom >= 0
    points = camera.directions * np.where(is_seen, image.depth, FARTHEST)[..., None]
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    shade = np.abs(normals @ _LIGHT) / np.linalg.norm(normals, axis=-1)
    colours = sensor.model.geom_rgba.copy()
    if asset.pieces:
        colours[sensor.model.geom_contype == 0] = [piece.mean_rgba for piece in asset.pieces]
    rgba = colours[image.geom]
    rgba[..., :3] *= (_FILL + (1 - _FILL) * shade)[..., None]
    rgba[..., 3] = is_seen
    buffer = io.BytesIO()
    Image.fromarray((255 * rgba).clip(0, 255).astype(np.uint8), "RGBA").save(buffer, "PNG")
    return buffer.getvalue()
