"""The models of a BOP dataset: surfaces in millimetres, their sizes and their symmetries."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shading import shade
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.symmetry import symmetries_of
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import write_atomically

_SAME = 1e-3
_DIGITS = 6


def add_models(folder: Path, objects: Sequence[ObjectAsset]) -> dict[str, int]:
    """The number of each object's model in a dataset, by name; models that are new to it are written.

    Raises:
      ConfigError: another model of an object's name is there.
    """
    path = folder / "models" / "models_info.json"
    infos = json.loads(path.read_bytes()) if path.exists() else {}
    ids = {info["name"]: int(key) for key, info in infos.items()}
    for asset in sorted({each.name: each for each in objects}.values(), key=lambda each: each.name):
        pieces = drawn_pieces(asset)
        extent = _extent(np.concatenate([piece.mesh.vertices for piece in pieces]) * 1000)
        key = ids.setdefault(asset.name, len(ids) + 1)
        if (known := infos.get(str(key))) is None:
            write_atomically(path.with_name(f"obj_{key:06d}.ply"), model_ply(asset))
            told = {"name": asset.name, "label": asset.label, **asdict(asset.provenance)}
            infos[str(key)] = told | extent | _symmetries(pieces)
        elif any(abs(known[name] - value) > _SAME for name, value in extent.items()):
            raise ConfigError(
                f"{folder}: another model of the name {asset.name!r} is there",
                "objects of one pool in one dataset",
                "another folder",
            )
    write_atomically(path, lines(infos))
    return ids


def drawn_pieces(asset: ObjectAsset) -> tuple[Piece, ...]:
    """The asset's coloured surfaces; its collision parts where it has none."""
    return asset.pieces or tuple(Piece(part.hull()) for part in asset.parts)


def model_ply(asset: ObjectAsset) -> bytes:
    """The surfaces as one ASCII PLY: millimetres, object frame, normals and colours at the vertices."""
    rows, faces, count = [], [], 0
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


def _symmetries(pieces: Sequence[Piece]) -> dict[str, list]:
    """What BOP states of an object that looks the same in several poses, millimetres; nothing of others."""
    found = symmetries_of(pieces)
    record: dict[str, list] = {}
    if len(found.axes):
        point = _plain(1000 * found.point)
        record["symmetries_continuous"] = [{"axis": _plain(axis), "offset": point} for axis in found.axes]
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
