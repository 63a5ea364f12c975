"""Rerun's recordings (.rrd), which its viewer opens: a scene as it stands. This needs the extra `rerun`.

    world/support            surfaces; world/support/collision: what collides
    world/objects/NAME       where an object stands; below it its surfaces, and collision
    world/cameras/NAME       a pinhole camera

Metres, z up. Everything is static: it has no time. Names are those of the scene; what has several surfaces
has them numbered. `RerunFile` writes what moves, too, along the timeline `time`, in seconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shading import shade
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.files import file_whole
from cluttergen_jax.importing.readers import primitives
from cluttergen_jax.scene import FixedCamera, Scene

_WORLD = "world"
_APPLICATION = "cluttergen"
_TIMELINE = "time"
_PART_RGBA = (0.6, 0.6, 0.65, 0.5)
_CAMERA_SIZE = 0.1
"""Metres from a camera to where its picture is drawn."""
_DRAWN_GROUPS = 3
"""MuJoCo's viewer draws geoms of the groups below this one."""
_SHAPES = mujoco.mjtGeom
Place = Sequence[str]
"""A path in the recording, name by name."""


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
        file.add_support(scene.support, has_collision=True)
        for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
            file.add_object(name, asset, has_collision=True)
            file.set_pose(file.object_place(name), pose)
        for camera in scene.cameras:
            file.add_camera(camera)


class RerunFile:
    """A recording that is written; a context manager, after which the file is there whole, or not at all.

    What is added has no time, but for what follows `set_time`.

    Args:
      path: of the file. name: of the recording: two files of one name are shown as one.

    Raises:
      MissingExtraError: the extra `rerun` is not installed.
    """

    def __init__(self, path: Path, name: str) -> None:
        self._rr = require_rerun()
        self._path = path
        self._name = name
        self._is_static = True

    require = staticmethod(require_rerun)

    def __enter__(self) -> RerunFile:
        with ExitStack() as stack:
            fresh = stack.enter_context(file_whole(self._path))
            self._stream = self._rr.RecordingStream(_APPLICATION, recording_id=self._name)
            # Before the file takes its place.
            stack.callback(self._stream.disconnect)
            self._stream.save(fresh)
            self._log([_WORLD], self._rr.ViewCoordinates.RIGHT_HAND_Z_UP)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def set_time(self, seconds: float) -> None:
        """What is added from now on is so at this time."""
        self._is_static = False
        self._stream.set_time(_TIMELINE, duration=seconds)

    @staticmethod
    def object_place(name: str) -> Place:
        """Where an object of that name is in the recording."""
        return [_WORLD, "objects", name]

    @staticmethod
    def body_place(name: str) -> Place:
        """Where a body of that name is that is no object and no support."""
        return [_WORLD, "robot", name]

    def set_pose(self, place: Place, pose: np.ndarray) -> None:
        """Says where something is, f[7], metres, wxyz, in the frame of what it lies below."""
        w, x, y, z = np.asarray(pose[3:], np.float64).tolist()
        turn = self._rr.Quaternion(xyzw=[x, y, z, w])
        self._log(place, self._rr.Transform3D(translation=pose[:3], quaternion=turn))

    def add_support(self, support: SupportAsset, has_collision: bool = False) -> None:
        """Draws a support, world frame."""
        place = [_WORLD, "support"]
        self._add_pieces(place, support.pieces or support.collision_pieces)
        if has_collision:
            solids = [Piece(each.mesh, _PART_RGBA) for each in support.collision_pieces]
            self._add_pieces([*place, "collision"], solids)

    def add_object(self, name: str, asset: ObjectAsset, has_collision: bool = False) -> None:
        """Draws an object at its place, object frame."""
        place = self.object_place(name)
        self._add_pieces(place, asset.drawn_pieces)
        if has_collision:
            hulls = [Piece(part.hull(), _PART_RGBA) for part in asset.parts]
            self._add_pieces([*place, "collision"], hulls)

    def add_body(self, name: str, model: mujoco.MjModel, body: int) -> bool:
        """Draws what MuJoCo's viewer draws of a body, body frame; whether there is something."""
        is_drawn = False
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
            material = model.geom_matid[geom]
            rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
            mesh = _mesh_of(model, geom)
            if mesh is None or rgba[3] <= 0 or model.geom_group[geom] >= _DRAWN_GROUPS:
                continue
            is_drawn = True
            place = [*self.body_place(name), f"geom-{geom}"]
            self.set_pose(place, np.concatenate([model.geom_pos[geom], model.geom_quat[geom]]))
            r, g, b, a = rgba.tolist()
            self._add_pieces(place, [Piece(mesh, (r, g, b, a))])
        return is_drawn

    def add_camera(self, camera: FixedCamera) -> None:
        """A camera at its place in the world."""
        pinhole = camera.pinhole
        T = pinhole.T_world_camera
        lens = self._rr.Pinhole(
            image_from_camera=pinhole.K,
            resolution=[camera.width, camera.height],
            camera_xyz=self._rr.ViewCoordinates.RDF,
            image_plane_distance=_CAMERA_SIZE,
        )
        at = self._rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
        self._log([_WORLD, "cameras", camera.name], at, lens)

    def add_number(self, place: Place, value: float) -> None:
        """A point of a curve."""
        self._log(place, self._rr.Scalars(value))

    def add_picture(self, place: Place, picture: np.ndarray) -> None:
        """u8[H, W, 3]."""
        self._log(place, self._rr.Image(picture))

    def add_words(self, place: Place, words: str) -> None:
        """A text: at a time a line of a log."""
        kind = self._rr.TextDocument if self._is_static else self._rr.TextLog
        self._log(place, kind(words))

    def _log(self, place: Place, *things: Any) -> None:
        self._stream.log(list(place), *things, static=self._is_static)

    def _add_pieces(self, place: Place, pieces: Iterable[Piece]) -> None:
        for number, piece in enumerate(pieces):
            self._log([*place, f"surface-{number}"], self._mesh(piece))

    def _mesh(self, piece: Piece) -> Any:
        vertices, normals, faces, uv = shade(piece.mesh, piece.uv)
        more = {}
        if uv is not None and piece.texture is not None:
            # Rerun's v runs down the image.
            more["vertex_texcoords"] = uv * [1, -1] + [0, 1]
            more["albedo_texture"] = np.asarray(piece.texture.image.convert("RGB"))
        return self._rr.Mesh3D(
            vertex_positions=vertices,
            vertex_normals=normals,
            triangle_indices=faces,
            albedo_factor=np.round(255 * np.array(piece.rgba)).astype(np.uint8),
            **more,
        )


def _mesh_of(model: mujoco.MjModel, geom: int) -> Mesh | None:
    """A geom's surface in its own frame; None of one without end, such as a floor."""
    kind = model.geom_type[geom]
    size = model.geom_size[geom]
    if kind == _SHAPES.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        first = int(mesh.vertadr[0])
        start = int(mesh.faceadr[0])
        vertices = model.mesh_vert[first : first + int(mesh.vertnum[0])]
        return Mesh(vertices, model.mesh_face[start : start + int(mesh.facenum[0])])
    if kind == _SHAPES.mjGEOM_BOX:
        return primitives.box(size)
    if kind == _SHAPES.mjGEOM_SPHERE:
        return primitives.ellipsoid(size[[0, 0, 0]])
    if kind == _SHAPES.mjGEOM_ELLIPSOID:
        return primitives.ellipsoid(size)
    if kind == _SHAPES.mjGEOM_CYLINDER:
        return primitives.cylinder(size[0], size[1])
    if kind == _SHAPES.mjGEOM_CAPSULE:
        return primitives.capsule(size[0], size[1])
    return None
