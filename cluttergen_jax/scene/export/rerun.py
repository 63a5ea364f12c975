"""Rerun's recordings (.rrd), which its viewer opens: a scene as it stands. This needs the extra `rerun`.

    world/support            surfaces; world/support/collision: what collides
    world/objects/NAME       where an object stands; below it its surfaces, and collision
    world/cameras/NAME       a pinhole camera

Metres, z up. Everything is static: it has no time. Names are those of the scene; what has several surfaces
has them numbered.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.shading import shade
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.files import file_whole
from cluttergen_jax.scene import FixedCamera, Scene

WORLD = "world"
_APPLICATION = "cluttergen"
_PART_RGBA = (0.6, 0.6, 0.65, 0.5)
_CAMERA_SIZE = 0.1
"""Metres from a camera to where its picture is drawn."""


def require_rerun() -> Any:
    """Rerun's module (MissingExtraError: the extra `rerun` is not installed)."""
    try:
        import rerun
    except ImportError as error:
        raise MissingExtraError("rerun", "a recording for Rerun") from error
    return rerun


def write_scene_rerun(path: Path, scene: Scene) -> None:
    """Writes the recording of a scene.

    Raises:
      MissingExtraError: the extra `rerun` is not installed.
    """
    origin = scene.origin
    with RerunFile(path, f"{origin.bank or 'scene'}-{origin.index}") as file:
        support = scene.support
        drawn = support.pieces or support.collision_pieces
        file.add_pieces([WORLD, "support"], drawn)
        solids = [piece.mesh for piece in support.collision_pieces]
        file.add_pieces([WORLD, "support", "collision"], [Piece(m, _PART_RGBA) for m in solids])
        for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
            place = [WORLD, "objects", name]
            file.add_pose(place, pose)
            file.add_pieces(place, asset.drawn_pieces)
            hulls = [Piece(part.hull(), _PART_RGBA) for part in asset.parts]
            file.add_pieces([*place, "collision"], hulls)
        for camera in scene.cameras:
            file.add_camera([WORLD, "cameras", camera.name], camera)


class RerunFile:
    """A recording that is written; a context manager, after which the file is there whole, or not at all.

    Args:
      path: of the file. name: of the recording: two files of one name are shown as one.

    Attributes:
      rr: Rerun's module. stream: what is logged to, with paths as lists of names.

    Raises:
      MissingExtraError: the extra `rerun` is not installed.
    """

    def __init__(self, path: Path, name: str) -> None:
        self.rr = require_rerun()
        self._file = file_whole(path)
        self._fresh = self._file.__enter__()
        self.stream = self.rr.RecordingStream(_APPLICATION, recording_id=name)
        self.stream.save(self._fresh)
        up = self.rr.ViewCoordinates.RIGHT_HAND_Z_UP
        self.stream.log(WORLD, up, static=True)

    def __enter__(self) -> RerunFile:
        return self

    def __exit__(self, *error: Any) -> None:
        self.stream.disconnect()
        self._file.__exit__(*error)

    def add_pose(self, place: list[str], pose: np.ndarray, *, is_static: bool = True) -> None:
        """Says where something is, f[7], metres, wxyz, in the frame of what it lies below.

        Args:
          is_static: it has no time; else it is there at the time that the stream is set to.
        """
        w, x, y, z = pose[3:].tolist()
        turn = self.rr.Quaternion(xyzw=[x, y, z, w])
        at = self.rr.Transform3D(translation=pose[:3], quaternion=turn)
        self.stream.log(place, at, static=is_static)

    def add_pieces(self, place: list[str], pieces: Iterable[Piece]) -> None:
        """Draws surfaces below a place, numbered."""
        for number, piece in enumerate(pieces):
            self.stream.log([*place, f"surface-{number}"], self._mesh(piece), static=True)

    def add_camera(self, place: list[str], camera: FixedCamera) -> None:
        """A camera at its place in the world."""
        pinhole = camera.pinhole
        T = pinhole.T_world_camera
        lens = self.rr.Pinhole(
            image_from_camera=pinhole.K,
            resolution=[camera.width, camera.height],
            camera_xyz=self.rr.ViewCoordinates.RDF,
            image_plane_distance=_CAMERA_SIZE,
        )
        at = self.rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
        self.stream.log(place, at, lens, static=True)

    def _mesh(self, piece: Piece) -> Any:
        vertices, normals, faces, uv = shade(piece.mesh, piece.uv)
        more = {}
        if uv is not None and piece.texture is not None:
            # Rerun's v runs down the image.
            more["vertex_texcoords"] = uv * [1, -1] + [0, 1]
            more["albedo_texture"] = np.asarray(piece.texture.image.convert("RGB"))
        return self.rr.Mesh3D(
            vertex_positions=vertices,
            vertex_normals=normals,
            triangle_indices=faces,
            albedo_factor=np.round(255 * np.array(piece.rgba)).astype(np.uint8),
            **more,
        )
