"""Scenes as a dataset in the format of the BOP benchmark for 6D object pose estimation.

Format: github.com/thodan/bop_toolkit, docs/bop_datasets_format.md; what counts as visible is read from
labels, exactly, and not estimated from depth.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shading import shaded
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import folder_whole, write_atomically
from cluttergen_jax.geometry import rotation_matrix
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.scene_renderer import PictureConfig, RenderStyle, scene_renderer
from cluttergen_jax.rendering.sensors import depth_png, png_of
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.instances import Instance, InstanceSensor

SPLIT = "train_synt"
"""The folder of the scenes: training images, synthetic."""
DEPTH_SCALE = 0.1
"""Millimetres of one step of a depth image."""
_HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
_SAME = 1e-3


@dataclass(frozen=True)
class BopDataset:
    """A dataset in a folder, which may hold scenes already.

    Attributes:
      folder: where it lies; models keep the numbers that they have there.
    """

    folder: Path

    def add(
        self,
        number: int,
        objects: Sequence[ObjectAsset],
        poses: np.ndarray,
        support: SupportAsset,
        cameras: Sequence[Camera],
        picture: PictureConfig,
    ) -> Path:
        """Writes one scene, seen by several cameras of one size; returns its folder.

        Args:
          number: the scene's; one of that number is replaced.
          objects, poses: N objects that stand at f[N, 7], T_world_object, metres, wxyz.
          picture: of the cameras' size; its view does not count.

        Raises:
          RendererError: nothing here can draw.
          ConfigError: another model of an object's name is in the dataset.
        """
        poses = np.asarray(poses, np.float64).reshape(-1, 7)
        ids = self._models(objects)
        scene = self.folder / SPLIT / f"{number:06d}"
        sensor = InstanceSensor(objects, support, surfaces=not picture.hulls)
        records: dict[str, dict[int, Any]] = {"scene_camera": {}, "scene_gt": {}, "scene_gt_info": {}}
        with (
            folder_whole(scene) as fresh,
            scene_renderer(objects, support, close_points(objects, poses, support), picture) as renderer,
        ):
            for view, camera in enumerate(cameras):
                renderer.camera = camera
                rgb = renderer.picture([RenderStyle(pose) for pose in poses])
                image, instances = sensor.sense(poses, camera)
                write_atomically(fresh / "rgb" / f"{view:06d}.png", png_of(Image.fromarray(rgb)))
                data = depth_png(image.depth, DEPTH_SCALE / 1000)
                write_atomically(fresh / "depth" / f"{view:06d}.png", data)
                _write_masks(fresh, view, instances)
                records["scene_camera"][view] = _camera_record(camera)
                records["scene_gt"][view] = [
                    _pose_record(ids[asset.name], pose, camera)
                    for asset, pose in zip(objects, poses, strict=True)
                ]
                is_valid = np.isfinite(image.depth)
                records["scene_gt_info"][view] = [_info_record(each, is_valid) for each in instances]
            for name, record in records.items():
                write_atomically(fresh / f"{name}.json", _lines(record))
        write_atomically(self.folder / "camera.json", _lines(_sensor_record(cameras[0])))
        write_atomically(self.folder / "dataset_info.md", _INFO.encode())
        return scene

    def _models(self, objects: Sequence[ObjectAsset]) -> dict[str, int]:
        """The number of each object's model, by name; models that are new are written."""
        path = self.folder / "models" / "models_info.json"
        infos = json.loads(path.read_bytes()) if path.exists() else {}
        ids = {info["name"]: int(key) for key, info in infos.items()}
        for asset in sorted({each.name: each for each in objects}.values(), key=lambda each: each.name):
            vertices = np.concatenate([piece.mesh.vertices for piece in drawn_pieces(asset)]) * 1000
            info = {"name": asset.name, "label": asset.label, **asdict(asset.provenance), **_extent(vertices)}
            key = ids.setdefault(asset.name, len(ids) + 1)
            if (known := infos.get(str(key))) is None:
                write_atomically(path.with_name(f"obj_{key:06d}.ply"), model_ply(asset))
                infos[str(key)] = info
            elif any(abs(known[name] - info[name]) > _SAME for name in _extent(vertices)):
                raise ConfigError(
                    f"{self.folder}: another model of the name {asset.name!r} is there",
                    "objects of one pool in one dataset",
                    "another folder",
                )
        write_atomically(path, _lines(infos))
        return ids


def drawn_pieces(asset: ObjectAsset) -> tuple[Piece, ...]:
    """The asset's coloured surfaces; its collision parts where it has none."""
    return asset.pieces or tuple(Piece(part.hull()) for part in asset.parts)


def model_ply(asset: ObjectAsset) -> bytes:
    """The surfaces as one ASCII PLY: millimetres, object frame, normals and colours at the vertices."""
    rows, faces, count = [], [], 0
    for piece in drawn_pieces(asset):
        surface = shaded(piece.mesh, piece.uv)
        colour = np.tile(np.array(piece.rgba[:3]), (len(surface.vertices), 1))
        if piece.texture is not None and surface.uv is not None:
            colour = colour * piece.texture.at(surface.uv)
        rows.append(np.hstack([surface.vertices * 1000.0, surface.normals, np.round(255 * colour)]))
        faces.append(surface.faces.astype(np.int64) + count)
        count += len(surface.vertices)
    buffer = io.StringIO()
    header = ["ply", "format ascii 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header += [f"element face {sum(map(len, faces))}", "property list uchar int vertex_indices", "end_header"]
    buffer.write("\n".join(header) + "\n")
    np.savetxt(buffer, np.concatenate(rows), fmt=["%.5f"] * 6 + ["%d"] * 3)
    triangles = np.concatenate(faces)
    np.savetxt(buffer, np.column_stack([np.full(len(triangles), 3), triangles]), fmt="%d")
    return buffer.getvalue().encode()


def _extent(vertices: np.ndarray) -> dict[str, float]:
    """Bounding box and diameter, the largest distance between two vertices f[V, 3]; millimetres."""
    low, high = vertices.min(0), vertices.max(0)
    corners = vertices[ConvexHull(vertices).vertices]
    record = {"diameter": float(pdist(corners).max())}
    record |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    return record | {f"size_{axis}": float(value) for axis, value in zip("xyz", high - low, strict=True)}


def _bop_intrinsics(camera: Camera) -> np.ndarray:
    """f64[3, 3]: bop_toolkit takes a pixel's middle to be at whole numbers."""
    return camera.K - _HALF


def _sensor_record(camera: Camera) -> dict[str, Any]:
    K = _bop_intrinsics(camera)
    size = {"width": camera.width, "height": camera.height, "depth_scale": DEPTH_SCALE}
    return {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], **size}


def _camera_record(camera: Camera) -> dict[str, Any]:
    turn = camera.rotation.T
    return {
        "cam_K": _bop_intrinsics(camera).ravel().tolist(),
        "depth_scale": DEPTH_SCALE,
        "cam_R_w2c": turn.ravel().tolist(),
        "cam_t_w2c": (-1000 * turn @ camera.eye).tolist(),
    }


def _pose_record(number: int, pose: np.ndarray, camera: Camera) -> dict[str, Any]:
    turn = camera.rotation.T
    return {
        "obj_id": number,
        "cam_R_m2c": (turn @ rotation_matrix(pose[3:])).ravel().tolist(),
        "cam_t_m2c": (1000 * turn @ (pose[:3] - camera.eye)).tolist(),
    }


def _info_record(instance: Instance, is_valid: np.ndarray) -> dict[str, Any]:
    """As bop_toolkit's calc_gt_info has it: boxes are x, y, width, height; all -1 if nothing is seen."""
    whole = visible = [-1, -1, -1, -1]
    if instance.visible.any() and instance.box is not None:
        rows, columns = np.nonzero(instance.visible)
        visible = _box(int(columns.min()), int(columns.max()), int(rows.min()), int(rows.max()))
        whole = _box(*instance.box)
    return {
        "bbox_obj": whole,
        "bbox_visib": visible,
        "px_count_all": instance.num_pixels,
        "px_count_valid": int((instance.mask & is_valid).sum()),
        "px_count_visib": int(instance.visible.sum()),
        "visib_fract": instance.visible_share,
    }


def _box(left: int, right: int, upper: int, lower: int) -> list[int]:
    return [left, upper, right - left, lower - upper]


def _write_masks(folder: Path, view: int, instances: Sequence[Instance]) -> None:
    for index, instance in enumerate(instances):
        for name, mask in (("mask", instance.mask), ("mask_visib", instance.visible)):
            picture = Image.fromarray(mask.astype(np.uint8) * 255)
            write_atomically(folder / name / f"{view:06d}_{index:06d}.png", png_of(picture))


def _lines(record: Mapping[Any, Any]) -> bytes:
    """JSON with a line for each entry."""
    entries = [f"  {json.dumps(str(key))}: {json.dumps(value)}" for key, value in record.items()]
    return ("{\n" + ",\n".join(entries) + "\n}\n").encode()


_INFO = f"""# Synthetic scenes in BOP format

Made by `cluttergen render --bop`. Format: docs/bop_datasets_format.md of bop_toolkit.

- `{SPLIT}/NNNNNN`: one scene, its images seen by different cameras. `rgb` is drawn with OpenGL; `depth`,
  `mask` and `mask_visib` by casting a ray through every pixel's middle, without noise.
- Depth images: {DEPTH_SCALE} mm a step (`depth_scale`), along the optical axis; 0: nothing, or beyond 6.5 m.
- `cam_K`: a pixel's middle is at whole numbers, as in bop_toolkit. World: z up, millimetres.
- `mask_visib` is where the object is seen, exactly; `visib_fract` is its share of the whole silhouette, that
  beyond the picture's edge (by up to a picture) included.
- `models`: surfaces in millimetres. The origin is the middle of the bounding box of the *collision parts*, z
  is up in the pose in which the object rests. Symmetries are not stated. `models_info.json` names each
  object, its source and its licence.
"""
