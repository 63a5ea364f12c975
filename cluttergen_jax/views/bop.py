"""Scenes as a dataset in the format of the BOP benchmark for 6D object pose estimation.

Format: github.com/thodan/bop_toolkit, docs/bop_datasets_format.md; what counts as visible is read from
labels, exactly, and not estimated from depth.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.shading import shade
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.symmetry import symmetries_of
from cluttergen_jax.config import PixelOrigin
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import folder_whole, write_atomically
from cluttergen_jax.geometry import rotation_matrix
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.views.bop_split import ORIGIN, SPLIT, SceneOrigin
from cluttergen_jax.rendering.scene_renderer import PictureConfig, RenderStyle, scene_renderer
from cluttergen_jax.views.images import depth_png, png_of
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import Instance, InstanceSensor

__all__ = ["CAMERA", "DEPTH_SCALE", "SPLIT", "BopDataset", "model_ply"]

CAMERA = "camera.json"
DEPTH_SCALE = 0.1
"""Millimetres of one step of a depth image."""
_HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
_SAME = 1e-3
_DIGITS = 6


@dataclass(frozen=True)
class BopDataset:
    """A dataset in a folder, which may hold scenes already.

    Attributes:
      folder: where it lies; models keep the numbers that they have there.
      split: the folder of the scenes in it.
      pixel_origin: where the first pixel's (0, 0) is by `cam_K`: "center", in its middle, as OpenCV has it;
        "corner", as OpenGL has it.
    """

    folder: Path
    split: str = SPLIT
    pixel_origin: PixelOrigin = "center"

    def add(
        self,
        number: int,
        objects: Sequence[ObjectAsset],
        poses: np.ndarray,
        support: SupportAsset,
        cameras: Sequence[Camera],
        picture: PictureConfig,
        origin: SceneOrigin | None = None,
        is_drawn: bool = True,
    ) -> Path:
        """Writes one scene, seen by several cameras of one size, whole or not at all; returns its folder.

        Args:
          number: the scene's; one of that number is replaced.
          objects, poses: N objects that stand at f[N, 7], T_world_object, metres, wxyz.
          picture: of the cameras' size; its view does not count.
          origin: which scene it is, stored beside it.
          is_drawn: draw the colours, which needs OpenGL; all else needs none.

        Raises:
          RendererError: colours are wanted, and nothing here can draw.
          ConfigError: another model of an object's name is in the dataset.
        """
        poses = np.asarray(poses, np.float64).reshape(-1, 7)
        ids = add_models(self.folder, objects)
        scene = self.folder / self.split / f"{number:06d}"
        sensor = InstanceSensor(objects, support, surfaces=not picture.hulls)
        records: dict[str, dict[int, Any]] = {
            "scene_camera": {},
            "scene_gt": {},
            "scene_gt_info": {},
        }
        with ExitStack() as stack:
            fresh = stack.enter_context(folder_whole(scene))
            if is_drawn:
                points = close_points(objects, poses, support)
                renderer = stack.enter_context(scene_renderer(objects, support, points, picture))
            for view, camera in enumerate(cameras):
                if is_drawn:
                    renderer.camera = camera
                    rgb = renderer.picture([RenderStyle(pose) for pose in poses])
                    write_atomically(
                        fresh / "rgb" / f"{view:06d}.png", png_of(Image.fromarray(rgb))
                    )
                image, instances = sensor.sense(poses, camera)
                data = depth_png(image.depth, DEPTH_SCALE / 1000)
                write_atomically(fresh / "depth" / f"{view:06d}.png", data)
                for index, instance in enumerate(instances):
                    for name, mask in (("mask", instance.mask), ("mask_visib", instance.visible)):
                        file = fresh / name / f"{view:06d}_{index:06d}.png"
                        write_atomically(file, png_of(Image.fromarray(mask.astype(np.uint8) * 255)))
                turn = camera.rotation.T
                records["scene_camera"][view] = {
                    "cam_K": self._intrinsics(camera).ravel().tolist(),
                    "depth_scale": DEPTH_SCALE,
                    "cam_R_w2c": turn.ravel().tolist(),
                    "cam_t_w2c": (-1000 * turn @ camera.eye).tolist(),
                }
                records["scene_gt"][view] = [
                    {
                        "obj_id": ids[asset.name],
                        "cam_R_m2c": (turn @ rotation_matrix(pose[3:])).ravel().tolist(),
                        "cam_t_m2c": (1000 * turn @ (pose[:3] - camera.eye)).tolist(),
                    }
                    for asset, pose in zip(objects, poses, strict=True)
                ]
                is_valid = np.isfinite(image.depth)
                records["scene_gt_info"][view] = [
                    _info_record(each, is_valid) for each in instances
                ]
            for name, record in records.items():
                write_atomically(fresh / f"{name}.json", lines(record))
            if origin is not None:
                write_atomically(fresh / ORIGIN, origin.to_json())
        write_atomically(self.folder / CAMERA, lines(self.sensor(cameras[0])))
        write_atomically(self.folder / "dataset_info.md", _info(self.pixel_origin).encode())
        return scene

    def sensor(self, camera: Camera) -> dict[str, float]:
        """What camera.json says of a camera."""
        K = self._intrinsics(camera)
        size = {"width": camera.width, "height": camera.height, "depth_scale": DEPTH_SCALE}
        return {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], **size}

    def _intrinsics(self, camera: Camera) -> np.ndarray:
        """f64[3, 3]: `Camera.K` itself has its origin in the first pixel's corner."""
        return camera.K - _HALF if self.pixel_origin == "center" else camera.K


def _info_record(instance: Instance, is_valid: np.ndarray) -> dict[str, object]:
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


_MEANT = {
    "center": """the middle of the first pixel, as OpenCV, BlenderProc and the functions of bop_toolkit
  that turn depth into distance have it. bop_toolkit's own renderer has (0, 0) in that pixel's upper left
  corner: add 0.5 to cx and cy for it.""",
    "corner": """the upper left corner of the first pixel, as OpenGL and bop_toolkit's own renderer have it.
  OpenCV has (0, 0) in that pixel's middle: subtract 0.5 from cx and cy for it.""",
}


def _info(pixel_origin: PixelOrigin) -> str:
    return f"""# Synthetic scenes in BOP format

Made by `cluttergen render --bop`. Format: docs/bop_datasets_format.md of bop_toolkit.

- `SPLIT/NNNNNN`: one scene, its images seen by different cameras. `rgb` is drawn with OpenGL, and missing
  where there was none; `depth`, `mask` and `mask_visib` by casting a ray through every pixel's middle,
  without noise.
- `{ORIGIN}` in its folder: the bank and the scene in it, a digest of what stands where, and how it was seen.
- Depth images: {DEPTH_SCALE} mm a step (`depth_scale`), along the optical axis; 0: nothing, or beyond 6.5 m.
- `cam_K`: pixel coordinates (0, 0) are {_MEANT[pixel_origin]}
  World: z up, millimetres.
- `mask_visib` is where the object is seen, exactly; `visib_fract` is its share of the whole silhouette, that
  beyond the picture's edge (by up to a picture) included.
- `models`: surfaces in millimetres. The origin is the middle of the bounding box of the *collision parts*, z
  is up in the pose in which the object rests. `models_info.json` names each object, its source and its
  licence.
- Symmetries: of bodies of revolution (`symmetries_continuous`) and of boxes, prisms and the like
  (`symmetries_discrete`), colours included, to within 5 mm or 4 % of the object's size.
"""


def add_models(folder: Path, objects: Sequence[ObjectAsset]) -> dict[str, int]:
    """The number of each object's model in a dataset, by name; models that are new to it are written.

    Raises:
      ConfigError: another model of an object's name is there.
    """
    path = folder / "models" / "models_info.json"
    infos = json.loads(path.read_bytes()) if path.exists() else {}
    ids = {info["name"]: int(key) for key, info in infos.items()}
    new: dict[int, ObjectAsset] = {}
    for asset in sorted({each.name: each for each in objects}.values(), key=lambda each: each.name):
        pieces = drawn_pieces(asset)
        extent = _extent(np.concatenate([piece.mesh.vertices for piece in pieces]) * 1000)
        key = ids.setdefault(asset.name, len(ids) + 1)
        if (known := infos.get(str(key))) is None:
            new[key] = asset
            source = {"name": asset.name, "label": asset.label, **asset.provenance.record()}
            infos[str(key)] = source | {"hash": object_hash(asset)} | extent | _symmetries(pieces)
        # Earlier versions kept no digest.
        elif any(abs(known[name] - value) > _SAME for name, value in extent.items()) or (
            "hash" in known and known["hash"] != object_hash(asset)
        ):
            raise ConfigError(
                f"{folder}: another model of the name {asset.name!r} is there",
                "objects of one pool in one dataset",
                "another folder",
            )
    for key, asset in new.items():
        write_atomically(path.with_name(f"obj_{key:06d}.ply"), model_ply(asset))
    write_atomically(path, lines(infos))
    return ids


def drawn_pieces(asset: ObjectAsset) -> tuple[Piece, ...]:
    """The asset's coloured surfaces; its collision parts where it has none."""
    return asset.pieces or tuple(Piece(part.hull()) for part in asset.parts)


def model_ply(asset: ObjectAsset) -> bytes:
    """The surfaces as one ASCII PLY: millimetres, object frame, normals and colours at the vertices."""
    rows = []
    faces = []
    count = 0
    for piece in drawn_pieces(asset):
        surface = shade(piece.mesh, piece.uv)
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
    header += [
        f"element face {sum(map(len, faces))}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    buffer.write("\n".join(header) + "\n")
    np.savetxt(buffer, np.concatenate(rows), fmt=["%.5f"] * 6 + ["%d"] * 3)
    triangles = np.concatenate(faces)
    np.savetxt(buffer, np.column_stack([np.full(len(triangles), 3), triangles]), fmt="%d")
    return buffer.getvalue().encode()


def _extent(vertices: np.ndarray) -> dict[str, float]:
    """Bounding box and diameter, the largest distance between two vertices f[V, 3]; millimetres."""
    low = vertices.min(0)
    high = vertices.max(0)
    corners = vertices[ConvexHull(vertices).vertices]
    record = {"diameter": float(pdist(corners).max())}
    record |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    return record | {
        f"size_{axis}": float(value) for axis, value in zip("xyz", high - low, strict=True)
    }


def _symmetries(pieces: Sequence[Piece]) -> dict[str, list]:
    """What BOP states of an object that looks the same in several poses, millimetres; nothing of others."""
    found = symmetries_of(pieces)
    record: dict[str, list] = {}
    if len(found.axes):
        point = _plain(1000 * found.point)
        record["symmetries_continuous"] = [
            {"axis": _plain(axis), "offset": point} for axis in found.axes
        ]
    if len(found.motions):
        scaled = found.motions * [[1.0, 1.0, 1.0, 1000.0]]
        record["symmetries_discrete"] = [_plain(motion) for motion in scaled]
    return record


def _plain(values: np.ndarray) -> list[float]:
    """Numbers row by row; no zero is negative."""
    return (np.round(values, _DIGITS) + 0.0).ravel().tolist()


def lines(record: Mapping[Any, Any]) -> bytes:
    """JSON with a line for each entry."""
    entries = [f"  {json.dumps(str(key))}: {json.dumps(value)}" for key, value in record.items()]
    return ("{\n" + ",\n".join(entries) + "\n}\n").encode()
