"""glTF 2.0, binary: one file per scene that holds everything, images included, for viewers.

glTF has y up: the node `world` turns the scene, below it everything is in the scene's own frame, z up. The
default scene shows the surfaces; a second one, `collision`, shows the convex parts. Mass, centre of mass,
inertia and friction, for which glTF has no words, are in `extras`.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable
from typing import Any

import numpy as np

from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shading import linear, shade
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.scene import FixedCamera, Scene
from cluttergen_jax.scene.export.shapes import friction_of

_ARRAY = 34962
_ELEMENT = 34963
_FLOAT = 5126
_UNSIGNED = 5125
_Y_UP = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
_TRANSMISSION = "KHR_materials_transmission"
"""Read beside the alpha of the colour, by which viewers without this extension show glass."""
_PART_RGBA = (0.6, 0.6, 0.65, 1.0)


def _plain(mesh: Mesh) -> Piece:
    """A collision part."""
    return Piece(mesh, _PART_RGBA)


def glb_bytes(scene: Scene) -> bytes:
    """The scene as one binary glTF file."""
    return _Builder().of(scene)


class _Builder:
    """Grows a glTF document and its buffer; meshes and materials that come again are shared."""

    def __init__(self) -> None:
        self._blob = bytearray()
        self._doc: dict[str, list[Any]] = {
            key: [] for key in ("accessors", "bufferViews", "materials", "meshes", "nodes")
        }
        self._materials: dict[tuple[Any, ...], int] = {}
        self._images: dict[Texture, int] = {}
        self._used: set[str] = set()

    def of(self, scene: Scene) -> bytes:
        solids = scene.support.collision_pieces
        assets = scene.assets.items()
        drawn = {name: self._mesh(name, asset.drawn_pieces) for name, asset in assets}
        hulls = {
            name: self._mesh(
                f"{name}/collision", map(_plain, (part.hull() for part in asset.parts))
            )
            for name, asset in assets
        }
        support = self._mesh("support", scene.support.pieces or solids)
        roots = [self._world(scene, "", support, drawn)]
        support = self._mesh("support/collision", (_plain(piece.mesh) for piece in solids))
        roots.append(self._world(scene, "/collision", support, hulls))
        return self._pack(roots)

    def _world(self, scene: Scene, suffix: str, support: int, meshes: dict[str, int]) -> int:
        friction = {"friction": scene.contact.friction[0]}
        children = [
            self._add("nodes", {"name": "support" + suffix, "mesh": support, "extras": friction})
        ]
        for own, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
            w, x, y, z = pose[3:].tolist()
            node = {
                "name": own + suffix,
                "mesh": meshes[asset.name],
                "translation": pose[:3].tolist(),
                "rotation": [x, y, z, w],
                "extras": {
                    "asset": asset.name,
                    "mass": float(asset.mass),
                    "center_of_mass": np.asarray(asset.center_of_mass).tolist(),
                    "inertia": np.asarray(asset.inertia).tolist(),
                    "friction": friction_of(asset, scene.contact)[0],
                },
            }
            children.append(self._add("nodes", node))
        children += [self._camera(each) for each in scene.cameras if not suffix]
        world: dict[str, object] = {
            "name": "world" + suffix,
            "rotation": _Y_UP,
            "children": children,
        }
        return self._add("nodes", world)

    def _camera(self, camera: FixedCamera) -> int:
        """glTF's cameras look along -z too."""
        lens = {
            "yfov": math.radians(camera.fovy),
            "aspectRatio": camera.width / camera.height,
            "znear": 0.01,
            "zfar": 100.0,
        }
        index = self._add(
            "cameras", {"name": camera.name, "type": "perspective", "perspective": lens}
        )
        w, x, y, z = camera.quaternion.tolist()
        node = {"name": f"camera/{camera.name}", "camera": index}
        return self._add(
            "nodes", {**node, "translation": camera.position.tolist(), "rotation": [x, y, z, w]}
        )

    def _mesh(self, name: str, pieces: Iterable[Piece]) -> int:
        primitives = [self._primitive(piece) for piece in pieces]
        return self._add("meshes", {"name": name, "primitives": primitives})

    def _primitive(self, piece: Piece) -> dict[str, object]:
        vertices, normals, faces, uv = shade(piece.mesh, piece.uv)
        bounds = {"min": vertices.min(0).tolist(), "max": vertices.max(0).tolist()}
        attributes = {
            "POSITION": self._accessor(vertices, "VEC3", _FLOAT, _ARRAY, **bounds),
            "NORMAL": self._accessor(normals, "VEC3", _FLOAT, _ARRAY),
        }
        if uv is not None:
            # glTF's v runs down the image.
            attributes["TEXCOORD_0"] = self._accessor(uv * [1, -1] + [0, 1], "VEC2", _FLOAT, _ARRAY)
        return {
            "attributes": attributes,
            "indices": self._accessor(faces.ravel(), "SCALAR", _UNSIGNED, _ELEMENT),
            "material": self._material(piece),
        }

    def _accessor(
        self, values: np.ndarray, kind: str, component: int, target: int, **more: Any
    ) -> int:
        data = values.astype("<u4" if component == _UNSIGNED else "<f4").tobytes()
        accessor = {
            "bufferView": self._view(data, target=target),
            "componentType": component,
            "count": len(values),
            "type": kind,
        }
        return self._add("accessors", accessor | more)

    def _view(self, data: bytes, **more: Any) -> int:
        view = {"buffer": 0, "byteOffset": len(self._blob), "byteLength": len(data), **more}
        # What comes next begins at a multiple of four bytes.
        self._blob += data + b"\0" * (-len(data) % 4)
        return self._add("bufferViews", view)

    def _material(self, piece: Piece) -> int:
        rgba = piece.rgba
        key = (rgba, piece.texture, piece.finish)
        if key not in self._materials:
            finish = piece.finish or Finish()
            colour: dict[str, object] = {
                "baseColorFactor": linear(rgba),
                "metallicFactor": finish.metallic,
                "roughnessFactor": finish.roughness,
            }
            if piece.texture is not None:
                colour["baseColorTexture"] = {"index": self._image(piece.texture)}
            if finish.orm is not None:
                colour["metallicRoughnessTexture"] = {"index": self._image(finish.orm)}
            material: dict[str, object] = {"pbrMetallicRoughness": colour, "doubleSided": True}
            if finish.normal is not None:
                material["normalTexture"] = {"index": self._image(finish.normal)}
            if finish.transmission:
                material["extensions"] = {
                    _TRANSMISSION: {"transmissionFactor": finish.transmission}
                }
                self._used.add(_TRANSMISSION)
            if rgba[3] < 1:
                material["alphaMode"] = "BLEND"
            self._materials[key] = self._add("materials", material)
        return self._materials[key]

    def _image(self, texture: Texture) -> int:
        if texture not in self._images:
            image = {
                "mimeType": "image/png",
                "name": texture.file_name,
                "bufferView": self._view(texture.data),
            }
            self._images[texture] = self._add("textures", {"source": self._add("images", image)})
        return self._images[texture]

    def _add(self, key: str, value: dict[str, object]) -> int:
        # glTF allows no empty lists: one that nothing is added to is left out.
        self._doc.setdefault(key, []).append(value)
        return len(self._doc[key]) - 1

    def _pack(self, roots: list[int]) -> bytes:
        names = ("scene", "collision")
        document = {
            "asset": {"version": "2.0", "generator": "cluttergen_jax"},
            "scene": 0,
            "scenes": [
                {"name": name, "nodes": [root]} for name, root in zip(names, roots, strict=True)
            ],
            "buffers": [{"byteLength": len(self._blob)}],
            **({"extensionsUsed": sorted(self._used)} if self._used else {}),
            **self._doc,
        }
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        blob = bytes(self._blob) + b"\0" * (-len(self._blob) % 4)
        size = 12 + 8 + len(text) + 8 + len(blob)
        head = struct.pack("<4sII", b"glTF", 2, size)
        json_head = struct.pack("<I4s", len(text), b"JSON")
        return head + json_head + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
