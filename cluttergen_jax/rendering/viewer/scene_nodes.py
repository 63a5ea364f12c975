"""A recording as nodes in the browser's scene: objects, hulls, clouds, region, and attempts at any moment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from PIL import Image

from cluttergen_jax.assets.cloud import cloud_colours, top_points
from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shading import linear, shade
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.assets.support import PART_RGBA, Rectangle, SupportAsset
from cluttergen_jax.geometry import transform_points, yaw_quaternion
from cluttergen_jax.placement.replay import Attempt, Replay
from cluttergen_jax.rendering.figure import heat_points
from cluttergen_jax.rendering.seat_mark import seat_points

if TYPE_CHECKING:
    import viser

RED = (214, 30, 36)
_GHOST = (RED[0] / 255, RED[1] / 255, RED[2] / 255, 0.45)
_BLUE = (40, 110, 220)
_ORANGE = (245, 130, 20)
_DIRECTION = np.array([0.62, -0.88, 0.78])
_LIFT = 0.0015
"""Metres by which lines and points lie above the top, so that they are seen."""
_DOT = 0.3
"""Of the distance between points of heat: larger ones face the camera, and would reach into the objects."""


@dataclass
class Shown:
    """What is drawn beside the objects.

    Attributes:
      hulls: the collision parts instead of the surfaces.
      region: the queried region, and boxes that objects stayed out of.
      scene_cloud: points of the region and of all placed objects.
      object_cloud: points of the object of the chosen attempt.
      failures: all failed attempts at once.
      density: where the object of the chosen attempt was likely to be proposed, as a heat map on the table.
    """

    hulls: bool = False
    region: bool = True
    scene_cloud: bool = False
    object_cloud: bool = False
    failures: bool = False
    density: bool = False


class SceneNodes:
    """Draws one recording at a time.

    Args:
      server: of viser; or one browser of it, which then alone sees what is drawn.
    """

    def __init__(self, server: viser.ViserServer | viser.ClientHandle) -> None:
        self.server = server
        self.shown = Shown()
        self.recording: Replay | None = None
        self._roots: list[Any] = []
        self._fixed: list[Any] = []
        self._objects: dict[int, ObjectNodes] = {}
        self._failed: dict[int, FailedAttempt] = {}
        self._region: list[Any] = []
        self._top_cloud: Any = None
        self._heat: dict[int, Any] = {}
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(True, cast_shadow=True)
        # The floor has no end: far away it becomes the background.
        server.scene.configure_fog(4.0, 14.0, color=(255, 255, 255))
        server.scene.add_light_ambient("/light", intensity=0.35)

    def show(self, recording: Replay) -> None:
        """Replaces whatever was drawn by another recording, at its end."""
        with self.server.atomic():
            self._clear()
            self.recording = recording
            self._add_support(recording.support)
            self._add_region(recording)
            for index, asset in enumerate(recording.objects):
                if recording.is_placed[index] or recording.attempts_at(index):
                    self._objects[index] = ObjectNodes(
                        self.server, f"/objects/{index}", asset, index
                    )
            for number, attempt in enumerate(recording.attempts):
                if not attempt.is_stable:
                    asset = recording.objects[attempt.object_index]
                    self._failed[number] = FailedAttempt(self.server, number, asset, attempt)
                if attempt.proposals is not None:
                    self._heat[number] = self._add_heat(recording, number, attempt)
            self.at(len(recording.attempts), None)

    def at(self, number: int, progress: float | None) -> None:
        """The scene at attempt `number`, from 1; 0 is the beginning.

        Args:
          progress: how far the attempt has come, in [0, 1], and from there to 2 how far objects are that are
            drawn together after it; None is the end of both, and at the last attempt the finished scene.
        """
        recording = self.recording
        if recording is None:
            return
        attempt = recording.attempts[number - 1] if 0 < number <= len(recording.attempts) else None
        poses, is_placed = self._state(number, attempt, progress)
        with self.server.atomic():
            for index, nodes in self._objects.items():
                is_current = attempt is not None and index == attempt.object_index
                nodes.place(poses[index], bool(is_placed[index]), self.shown, is_current)
            for place, failed in self._failed.items():
                is_chosen = place == number - 1
                failed.place(progress if is_chosen else None, is_chosen or self.shown.failures)
            for place, heat in self._heat.items():
                heat.visible = self.shown.density and place == number - 1
            for node in self._region:
                node.visible = self.shown.region
            self._top_cloud.visible = self.shown.scene_cloud

    def put(self, poses: np.ndarray, is_placed: np.ndarray) -> None:
        """Moves the objects of a shown scene without attempts, f[K, 7], and hides those not placed, bool[K].

        Objects that were not placed when the scene was first shown are not there to be moved.
        """
        assert self.recording is not None
        self.recording = replace(self.recording, poses=poses, is_placed=is_placed)
        self.at(0, None)

    def _state(
        self, number: int, attempt: Attempt | None, progress: float | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poses f[K, 7] and bool[K]: what stands where, the current object included if it is to stay."""
        recording = self.recording
        assert recording is not None
        if attempt is None:
            first = recording.attempts[0] if recording.attempts and number == 0 else None
            if first is not None:
                return first.poses, first.is_placed
            return recording.poses, recording.is_placed
        if progress is None and number == len(recording.attempts) and attempt.is_stable:
            return recording.poses, recording.is_placed
        poses = attempt.poses.copy()
        is_placed = attempt.is_placed.copy()
        if attempt.is_stable:
            is_placed[attempt.object_index] = True
            if attempt.gathered is not None and (progress is None or progress > 1):
                return attempt.poses_gathering(1.0 if progress is None else progress - 1), is_placed
            poses = attempt.settled.copy() if progress is None else poses
            if progress is not None:
                poses[attempt.object_index] = _pose_at(attempt, progress)
        return poses, is_placed

    def _clear(self) -> None:
        for node in [*self._fixed, *self._region, *([self._top_cloud] if self._top_cloud else [])]:
            node.remove()
        for group in (self._objects, self._failed, self._heat):
            for nodes in group.values():
                nodes.remove()
            group.clear()
        self._fixed = []
        self._region = []
        self._top_cloud = None

    def _add_support(self, support: SupportAsset) -> None:
        scene = self.server.scene
        reach = 20.0
        self._fixed.append(
            scene.add_box(
                "/floor",
                color=(222, 223, 226),
                dimensions=(2 * reach, 2 * reach, 0.01),
                position=(0.0, 0.0, -0.005),
                cast_shadow=False,
            )
        )
        for index, piece in enumerate(support.pieces):
            self._fixed.append(_surface(self.server, f"/support/{index}", piece))
        for index, box in enumerate(() if support.pieces else support.boxes):
            self._fixed.append(
                scene.add_box(
                    f"/support/box-{index}",
                    color=_bytes(box.rgba),
                    dimensions=tuple(2 * np.array(box.half_extents)),
                    position=box.center,
                    wxyz=yaw_quaternion(box.yaw),
                )
            )
        for index, part in enumerate(() if support.pieces else support.parts):
            drawn = Piece(part.hull(), PART_RGBA)
            self._fixed.append(_surface(self.server, f"/support/part-{index}", drawn))
        points = top_points(support) + np.array([0.0, 0.0, _LIFT])
        self._top_cloud = scene.add_point_cloud(
            "/cloud", points.astype(np.float32), _BLUE, point_size=0.0035, point_shape="circle"
        )

    def _add_heat(self, recording: Replay, number: int, attempt: Attempt) -> Any:
        points, colours, size = heat_points(recording, attempt)
        points[:, 2] += _LIFT
        return self.server.scene.add_point_cloud(
            f"/heat/{number}",
            points,
            colours,
            point_size=_DOT * size,
            point_shape="circle",
            visible=False,
        )

    def _add_region(self, recording: Replay) -> None:
        support = recording.support
        pose = np.array([0.0, 0.0, support.top, 1.0, 0.0, 0.0, 0.0])
        if support.named and not support.chosen.is_level:
            pose = support.chosen.pose
        named = [("region", recording.region, pose, _BLUE)]
        if support.named and len(support.asked) > 1:
            regions = enumerate(surface for surface, _ in support.asked)
            named = [(f"region-{k}", each.region, each.pose, _BLUE) for k, each in regions]
        named += [(f"keep-out-{k}", box, pose, RED) for k, box in enumerate(recording.keep_out)]
        if recording.seat:
            line = seat_points(recording.region, support, recording.seat)
            segments = np.stack([line[:-1], line[1:]], axis=1).astype(np.float32)
            self._region.append(
                self.server.scene.add_line_segments("/seat", segments, _BLUE, thickness=0.006)
            )
        for name, rectangle, T_world_rectangle, colour in named:
            sides = transform_points(T_world_rectangle, outline(rectangle, _LIFT).reshape(-1, 3))
            self._region.append(
                self.server.scene.add_line_segments(
                    f"/{name}", sides.reshape(-1, 2, 3).astype(np.float32), colour, thickness=0.004
                )
            )


class ObjectNodes:
    """One object: a frame called `root`, its surfaces, its hulls in colours by `index`, and its cloud."""

    def __init__(
        self, server: viser.ViserServer, root: str, asset: ObjectAsset, index: int = 0
    ) -> None:
        self.frame = server.scene.add_frame(root, show_axes=False)
        self.surfaces = [
            _surface(server, f"{root}/visual-{k}", piece) for k, piece in enumerate(asset.pieces)
        ]
        self.hulls = [
            _hull(server, f"{root}/hull-{k}", part, _hue(index * 7 + k))
            for k, part in enumerate(asset.parts)
        ]
        self.cloud = server.scene.add_point_cloud(
            f"{root}/cloud", asset.cloud.astype(np.float32), cloud_colours(asset), point_size=0.0035
        )
        self.own_cloud = server.scene.add_point_cloud(
            f"{root}/own-cloud", asset.cloud.astype(np.float32), _ORANGE, point_size=0.005
        )

    def place(self, pose: np.ndarray, is_there: bool, shown: Shown, is_current: bool) -> None:
        """Puts the object to `pose` f[7] and shows of it what is wanted."""
        self.frame.position = pose[:3]
        self.frame.wxyz = pose[3:]
        self.frame.visible = is_there
        for node in self.surfaces:
            node.visible = not shown.hulls or not self.hulls
        for node in self.hulls:
            node.visible = shown.hulls or not self.surfaces
        self.cloud.visible = shown.scene_cloud
        self.own_cloud.visible = shown.object_cloud and is_current

    def remove(self) -> None:
        """Takes the object and all that belongs to it out of the scene."""
        self.frame.remove()


class FailedAttempt:
    """A failed attempt: the object in red where it ended, and its path."""

    def __init__(
        self, server: viser.ViserServer, number: int, asset: ObjectAsset, attempt: Attempt
    ) -> None:
        root = f"/failed/{number}"
        self.attempt = attempt
        self.frame = add_ghost(server, root, asset, _GHOST)
        points = attempt.trajectory[:, :3].astype(np.float32)
        segments = np.stack([points[:-1], points[1:]], axis=1)
        self.trail = server.scene.add_line_segments(
            f"/trail/{number}", segments, RED, thickness=0.003
        )

    def place(self, progress: float | None, is_seen: bool) -> None:
        """Shows the object at a moment of its attempt, None being the end."""
        pose = _pose_at(self.attempt, 1.0 if progress is None else progress)
        self.frame.position = pose[:3]
        self.frame.wxyz = pose[3:]
        self.frame.visible = self.trail.visible = is_seen

    def remove(self) -> None:
        """Takes the object and its path out of the scene."""
        self.frame.remove()
        self.trail.remove()


def add_ghost(
    server: viser.ViserServer,
    root: str,
    asset: ObjectAsset,
    rgba: tuple[float, float, float, float],
) -> Any:
    """A frame `root`, which may be moved, with an object in one colour, each channel in [0, 1]."""
    frame = server.scene.add_frame(root, show_axes=False)
    whole = join_meshes([piece.mesh for piece in asset.drawn_pieces])
    _surface(server, f"{root}/visual", Piece(whole, rgba))
    return frame


def _pose_at(attempt: Attempt, progress: float) -> np.ndarray:
    """f[7]: where the current object is, `progress` in [0, 1] of the way through its attempt."""
    return attempt.trajectory[round(progress * attempt.num_steps), :7]


def _surface(server: viser.ViserServer, name: str, piece: Piece) -> Any:
    """A mesh that is smooth where it bends gently and sharp at its edges."""
    if piece.texture is not None or piece.finish is not None:
        return server.scene.add_mesh_trimesh(name, dressed_mesh(piece))
    rgba = piece.rgba
    vertices, _, faces, _ = shade(piece.mesh)
    return server.scene.add_mesh_simple(
        name,
        vertices,
        faces,
        color=_bytes(rgba),
        opacity=None if rgba[3] >= 1 else float(rgba[3]),
        side="double",
    )


def dressed_mesh(piece: Piece) -> trimesh.Trimesh:
    """A piece with its images and its finish as trimesh keeps one, seen from both sides."""
    finish = piece.finish or Finish()
    vertices, normals, faces, uv = shade(piece.mesh, piece.uv)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=_image(piece.texture),
        baseColorFactor=np.round(255 * np.array(linear(piece.rgba))).astype(np.uint8),
        metallicFactor=finish.metallic,
        roughnessFactor=finish.roughness,
        normalTexture=_image(finish.normal),
        metallicRoughnessTexture=_image(finish.orm),
        doubleSided=True,
        alphaMode="OPAQUE" if piece.rgba[3] >= 1 else "BLEND",
    )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(vertices, faces, vertex_normals=normals, visual=visual, process=False)


def _image(texture: Texture | None) -> Image.Image | None:
    return None if texture is None else texture.image


def _hull(server: viser.ViserServer, name: str, part: Mesh, colour: tuple[int, int, int]) -> Any:
    mesh = part.hull()
    return server.scene.add_mesh_simple(
        name, mesh.vertices, mesh.faces, color=colour, flat_shading=True, visible=False
    )


def outline(rectangle: Rectangle, height: float) -> np.ndarray:
    """f32[4, 2, 3]: the sides of a rectangle at a height, in the frame that it is in."""
    ring = np.column_stack([rectangle.corners, np.full(4, height)])
    return np.stack([ring, np.roll(ring, -1, axis=0)], axis=1).astype(np.float32)


def aim(camera: Any, region: Rectangle, top: float) -> None:
    """Puts a browser's camera, or where cameras begin, so that the whole region at `top` metres is seen."""
    reach = 1.25 * float(np.hypot(*region.half_extents)) + 0.25
    target = np.array([*region.center, top + 0.05])
    camera.fov = float(np.radians(42))
    camera.position = target + 1.9 * reach * _DIRECTION / np.linalg.norm(_DIRECTION)
    camera.look_at = target


def _bytes(rgba: tuple[float, ...]) -> tuple[int, int, int]:
    red, green, blue = (round(255 * float(value)) for value in rgba[:3])
    return red, green, blue


def _hue(number: int) -> tuple[int, int, int]:
    """Distinct colours for hulls, by turning the hue."""
    turn = (0.08 + 0.618034 * number) % 1.0
    wave = 0.62 + 0.3 * np.cos(2 * np.pi * (turn + np.array([0.0, 1 / 3, 2 / 3])))
    return _bytes(tuple(wave))
