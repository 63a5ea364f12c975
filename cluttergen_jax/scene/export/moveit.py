"""MoveIt's text files of planning scenes: a collision object for the support and one for each object.

As `PlanningScene::loadGeometryFromStream` of moveit_core reads them, of MoveIt 1 and 2, in its newer form:
the scene's name on a line of its own; for each object a line `* NAME`, its pose, the number of its shapes,
each with a pose in the object's frame and a colour, and the number of subframes; a dot at the end. Poses are
x y z on a line and a quaternion xyzw on the next. Shapes are `box` and three sides, or `mesh`, the numbers
of vertices and triangles, and these (`constructShapeFromText` of geometric_shapes).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import Box
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.shapes import text

_HERE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
_SUPPORT = "support"


def planning_scene(scene: Scene) -> bytes:
    """The file of a scene: what collides, world frame, metres; what shapes have are the collision parts."""
    support = _SUPPORT
    while support in scene.names:
        support += "_"
    name = scene.origin.bank or "scene"
    lines = [" ".join(f"{name} {scene.origin.index}".split())]
    drawn = scene.support.pieces or scene.support.collision_pieces
    boxes = [_box_lines(box) for box in scene.support.boxes]
    meshes = [_mesh_lines(part.hull()) for part in scene.support.parts]
    lines += _object_lines(support, _HERE, [*boxes, *meshes], drawn)
    for own, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        meshes = [_mesh_lines(part.hull()) for part in asset.parts]
        lines += _object_lines(own, pose, meshes, asset.drawn_pieces)
    return "\n".join([*lines, ".", ""]).encode()


def _object_lines(
    name: str, pose: np.ndarray, shapes: Sequence[list[str]], drawn: Sequence[Piece]
) -> Iterator[str]:
    """An object of some shapes at a pose, in the colour of the first thing that is drawn of it."""
    colour = text(drawn[0].mean_rgba)
    yield f"* {name}"
    yield from _pose_lines(pose)
    yield str(len(shapes))
    for shape in shapes:
        yield from shape
        yield colour
    # No subframes.
    yield "0"


def _box_lines(box: Box) -> list[str]:
    pose = np.concatenate([box.center, yaw_quaternion(box.yaw)])
    return ["box", text(2 * np.array(box.half_extents)), *_pose_lines(pose)]


def _mesh_lines(mesh: Mesh) -> list[str]:
    return [
        "mesh",
        f"{len(mesh.vertices)} {len(mesh.faces)}",
        *map(text, mesh.vertices),
        *(" ".join(map(str, face)) for face in mesh.faces.tolist()),
        *_pose_lines(_HERE),
    ]


def _pose_lines(pose: np.ndarray) -> list[str]:
    """Of f[7], metres, wxyz."""
    return [text(pose[:3]), text([*pose[4:], pose[3]])]
