"""glTF as it lies on disk, in one file (GLB) or several, its extensions, and how it is plain for trimesh.

trimesh passes over quantised and sparse numbers, Draco, morphs, skins and copies: a file that has some of it
is written anew without. A file that has none of it goes to trimesh as it is.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
import trimesh

from cluttergen_jax.errors import AssetError

Json = dict[str, Any]
"""An object of glTF's own JSON, such as the document: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html"""
DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def read_document(path: Path) -> Json:
    """The JSON of a glTF file; empty if it is none."""
    with path.open("rb") as file:
        data = file.read(20)
        if data[:4] == b"glTF" and len(data) == 20:
            data = file.read(struct.unpack("<I", data[12:16])[0])
        else:
            data += file.read()
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


_SAID = {
    "label": ("label", "title", "name"),
    "synset": ("synset", "category", "class"),
    "licence": ("licence", "license"),
    "attribution": ("attribution", "author"),
}
_HOLDERS = ("scenes", "nodes", "meshes")
_LONGEST = 300


def words_of(path: Path) -> dict[str, str]:
    """What a glTF file says of its object in words: some of label, synset, licence and attribution.

    It looks at the `extras` of the file, the asset, the first scene, and of nodes and meshes where there is
    one alone; what comes first counts. Sketchfab's files have a title, an author and a source.
    """
    document = read_document(path)
    said: dict[str, str] = {}
    for holder in (document, document.get("asset"), *(_first(document, key) for key in _HOLDERS)):
        extras = holder.get("extras") if isinstance(holder, dict) else None
        if not isinstance(extras, dict):
            continue
        words = {
            str(key).lower(): " ".join(value.split())[:_LONGEST]
            for key, value in extras.items()
            if isinstance(value, str) and value.strip()
        }
        if {"author", "source"} <= words.keys():
            words["author"] = f"{words['author']}, {words['source']}"
        found = {
            key: next((words[name] for name in names if name in words), "")
            for key, names in _SAID.items()
        }
        said = {key: value for key, value in found.items() if value} | said
    return said


def _first(document: Json, key: str) -> Any:
    """The first scene, or the only node or mesh."""
    values = document.get(key)
    if isinstance(values, list) and (len(values) == 1 or (values and key == "scenes")):
        return values[0]
    return None


def object_of(holder: Json, key: str) -> Json:
    """An object within another one; an empty one where there is none."""
    value = holder.get(key)
    return value if isinstance(value, dict) else {}


def primitives_of(document: Json) -> list[Json]:
    """The surfaces of all meshes."""
    return [each for mesh in document.get("meshes", []) for each in mesh["primitives"]]


_WHITE = [1, 1, 1, 1]


def is_coloured_by_vertices(document: Json, primitive: Json) -> bool:
    """Whether the colours at a primitive's vertices are all that it has: its material is white."""
    if "COLOR_0" not in primitive["attributes"] or "material" not in primitive:
        return False
    return is_white(document["materials"][primitive["material"]])


def is_white(material: Json) -> bool:
    """Whether a material leaves colours as they are."""
    look = material.get("pbrMetallicRoughness", {})
    if "KHR_materials_pbrSpecularGlossiness" in material.get("extensions", {}):
        # The colour is there.
        return False
    return "baseColorTexture" not in look and look.get("baseColorFactor", _WHITE)[:3] == _WHITE[:3]


class _Content:
    """The bytes of a glTF file and its accessors as arrays, read when they are asked for.

    Args:
      path: the file. document: its JSON.
    """

    def __init__(self, path: Path, document: Json) -> None:
        self._path = path
        self._document = document
        self._bytes: dict[int, bytes] = {}

    def view(self, index: int) -> bytes:
        """The bytes of one buffer view."""
        view = self._document["bufferViews"][index]
        start = view.get("byteOffset", 0)
        return self._buffer(view["buffer"])[start : start + view["byteLength"]]

    def _buffer(self, index: int) -> bytes:
        """The bytes of one buffer, empty where the file has none for it.

        Raises:
          AssetError: it names a file that is not there.
        """
        if index not in self._bytes:
            uri = self._document["buffers"][index].get("uri")
            # A GLB file's own bytes are its first buffer's.
            own = _binary_chunk(self._path) if uri is None and index == 0 else b""
            self._bytes[index] = own if uri is None else self._bytes_at(uri)
        return self._bytes[index]

    def _bytes_at(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            return base64.b64decode(body) if head.endswith(";base64") else unquote_to_bytes(body)
        return buffer_file(self._path, uri).read_bytes()

    def accessor(self, index: int, raw: np.ndarray | None = None) -> np.ndarray:
        """[N, width]: an accessor's elements; floats in [-1, 1] where its integers are normalised.

        Args:
          raw: its elements, where they come from elsewhere.
        """
        accessor = self._document["accessors"][index]
        array = self._dense(accessor) if raw is None else raw
        array = self._with_sparse(array, accessor["sparse"]) if "sparse" in accessor else array
        if accessor.get("normalized") and array.dtype.kind in "iu":
            return np.maximum(
                array / np.iinfo(np.dtype(DTYPES[accessor["componentType"]])).max, -1.0
            )
        return array

    def primitive(self, primitive: Json) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
        """The attributes of a primitive by name, and its indices i[M] if it has any."""
        attributes = primitive["attributes"]
        indices = None
        raw: dict[str, np.ndarray] = {}
        compressed = primitive.get("extensions", {}).get(DRACO)
        if (
            compressed is not None
            and "bufferView" not in self._document["accessors"][attributes["POSITION"]]
        ):
            raw, indices = self._draco(compressed)
        arrays = {name: self.accessor(index, raw.get(name)) for name, index in attributes.items()}
        if indices is None and "indices" in primitive:
            indices = self.accessor(primitive["indices"]).reshape(-1)
        return arrays, indices

    def _dense(self, accessor: Json) -> np.ndarray:
        shape = accessor["count"], WIDTHS[accessor["type"]]
        if "bufferView" not in accessor:
            return np.zeros(shape, DTYPES[accessor["componentType"]])
        stride = self._document["bufferViews"][accessor["bufferView"]].get("byteStride", 0)
        return self._read(accessor["bufferView"], accessor, shape, stride)

    def _read(self, view: int, where: Json, shape: tuple[int, int], stride: int = 0) -> np.ndarray:
        dtype = np.dtype(DTYPES[where["componentType"]])
        data = self.view(view)
        strides = stride or dtype.itemsize * shape[1], dtype.itemsize
        return np.ndarray(shape, dtype, data, where.get("byteOffset", 0), strides).copy()

    def _with_sparse(self, array: np.ndarray, sparse: Json) -> np.ndarray:
        """The array with the elements replaced that are stored beside it."""
        places = sparse["indices"]
        values = sparse["values"]
        index = self._read(places["bufferView"], places, (sparse["count"], 1))[:, 0]
        new = {
            **values,
            "componentType": next(k for k, v in DTYPES.items() if array.dtype == np.dtype(v)),
        }
        array = array.copy()
        array[index] = self._read(values["bufferView"], new, (sparse["count"], array.shape[1]))
        return array

    def _draco(self, compressed: Json) -> tuple[dict[str, np.ndarray], np.ndarray]:
        try:
            import DracoPy
        except ImportError as error:
            raise AssetError(f"{self._path} with {DRACO}", hint="pip install DracoPy") from error
        decoded = DracoPy.decode(self.view(compressed["bufferView"]))
        by_id = {each["unique_id"]: np.asarray(each["data"]) for each in decoded.attributes}
        by_id = {index: data.reshape(len(data), -1) for index, data in by_id.items()}
        arrays = {
            name: by_id[index] for name, index in compressed["attributes"].items() if index in by_id
        }
        return arrays, np.asarray(decoded.faces).reshape(-1)


def buffer_file(path: Path, uri: str) -> Path:
    """The file that a buffer of a glTF file names (AssetError: it is not there)."""
    for name in (uri, unquote(uri)):
        if (file := path.parent / name).is_file():
            return file
    raise AssetError(f"{path} names buffer {uri!r}, which is not there", hint="restoring the file")


def _binary_chunk(path: Path) -> bytes:
    data = path.read_bytes()
    if data[:4] != b"glTF":
        return b""
    (length,) = struct.unpack_from("<I", data, 12)
    head = data[20 + length : 28 + length]
    return data[28 + length :][: struct.unpack("<I4s", head)[0]] if len(head) == 8 else b""


def glb(document: Json, binary: bytes) -> bytes:
    """A GLB file of a document whose only buffer is `binary`."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(binary), b"BIN\0")
        + binary
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


DRACO = "KHR_draco_mesh_compression"
INSTANCING = "EXT_mesh_gpu_instancing"
_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_UNDERSTOOD = (
    DRACO,
    INSTANCING,
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "EXT_texture_webp",
)
# They say how a surface looks, or nothing about it: the shape is the same without them.
TRANSMISSION = "KHR_materials_transmission"
_OF_LOOKS = (
    *("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_"),
    *("EXT_lights_", "KHR_xmp", "KHR_animation_pointer"),
)
_DRAWN_ALIKE = ("KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness", TRANSMISSION)
_NO_SURFACE = (0, 1, 2, 3)
"""Modes of primitives that are points and lines."""


def check_understood(path: Path, document: Json) -> None:
    """Refuses a file whose shape cannot be read without an extension that is not understood.

    Raises:
      AssetError: it names the extension, and what undoes it.
    """
    wanted = [name for name in _names(document, "extensionsRequired") if not _is_followed(name)]
    wanted += [
        name for name in _MESHOPT if name not in wanted and _is_all_that_there_is(name, document)
    ]
    if wanted:
        undo = "exporting without it"
        if wanted[0] in _MESHOPT:
            undo = f"gltf-transform copy {path.name} plain.glb"
        raise AssetError(
            f"{path} needs the glTF extension {', '.join(wanted)}, which is not read",
            ", ".join(_UNDERSTOOD),
            undo,
        )


def extension_notes(document: Json) -> Iterator[str]:
    """What is not followed, or was decided, of extensions and of surfaces that are no triangles."""
    required = _names(document, "extensionsRequired")
    used = _names(document, "extensionsUsed")
    for name in required:
        if name not in (*_UNDERSTOOD, *_DRAWN_ALIKE):
            yield f"its glTF extension {name} is not followed: its colours may differ"
    if others := [
        name for name in used if not _is_followed(name) and name not in (*required, *_MESHOPT)
    ]:
        yield f"of glTF, {', '.join(others)} is not followed"
    modes = [each.get("mode", 4) for each in primitives_of(document)]
    if num_left_out := sum(mode in _NO_SURFACE for mode in modes):
        yield f"{num_left_out} of its {len(modes)} surfaces are points or lines and are left out"
    nodes = document.get("nodes", [])
    if any("skin" in node for node in nodes):
        yield "its skin is drawn as the joints stand in the file"
    if any(any(each.get("weights") or ()) for each in (*nodes, *document.get("meshes", []))):
        yield "its morph targets are drawn with the weights that the file gives"


def _names(document: Json, key: str) -> list[str]:
    names = document.get(key)
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def _is_followed(name: str) -> bool:
    return name in _UNDERSTOOD or name.startswith(_OF_LOOKS)


def _is_all_that_there_is(name: str, document: Json) -> bool:
    """Whether a view's bytes are there in the extension's form alone: its buffer stands for no bytes."""
    buffers = document.get("buffers", [])
    views = [view for view in document.get("bufferViews", []) if name in view.get("extensions", {})]
    return any(
        "uri" not in buffers[view["buffer"]]
        and (view["buffer"] > 0 or name in buffers[0].get("extensions", {}))
        for view in views
    )


_FAN = 6
_MOST_COPIES = 10_000


def plain_gltf(path: Path) -> tuple[bytes, str]:
    """A file that trimesh reads wholly, and its suffix: floats alone, one mesh for each that is drawn.

    Its materials are called by their numbers, since names may be missing or come twice.

    Raises:
      AssetError: it needs an extension that is not understood, or cannot be read.
    """
    document = read_document(path)
    check_understood(path, document)
    _check_tree(path, document)
    if not document:
        return path.read_bytes(), path.suffix.lower()[1:]
    materials = [
        {**each, "name": str(index)} for index, each in enumerate(document.get("materials", []))
    ]
    document |= {"materials": materials} if materials else {}
    if _is_not_plain(document):
        return _Plain(path, document).build(), "glb"
    with path.open("rb") as file:
        is_binary = file.read(4) == b"glTF"
    if is_binary:
        return glb(document, _binary_chunk(path)), "glb"
    return json.dumps(document).encode(), "gltf"


def _check_tree(path: Path, document: Json) -> None:
    nodes = enumerate(document.get("nodes", []))
    try:
        TopologicalSorter({index: node.get("children", []) for index, node in nodes}).prepare()
    except CycleError as error:
        circle = ", ".join(map(str, error.args[1][1:]))
        raise AssetError(
            f"{path}: nodes {circle} hang on each other in a circle", "a tree of nodes"
        ) from error


def _is_not_plain(document: Json) -> bool:
    nodes = document.get("nodes", [])
    accessors = document.get("accessors", [])
    # trimesh draws nothing of a file without a scene.
    if not document.get("scenes"):
        return True
    if any({"skin", "weights"} & each.keys() or INSTANCING in _extensions(each) for each in nodes):
        return True
    # trimesh loses what hangs on a camera.
    if any("camera" in each and {"mesh", "children"} & each.keys() for each in nodes):
        return True
    for mesh in document.get("meshes", []):
        for primitive in mesh["primitives"]:
            named = {
                k: v for k, v in primitive["attributes"].items() if not k.startswith(("COLOR", "_"))
            }
            used = [accessors[index] for index in named.values()]
            if any(each.get("normalized") or "sparse" in each for each in used):
                return True
            if (
                "weights" in mesh
                or DRACO in _extensions(primitive)
                or primitive.get("mode") == _FAN
            ):
                return True
            # trimesh leaves colours at vertices as they are, which may be integers.
            if is_coloured_by_vertices(document, primitive):
                return True
    return False


def _extensions(element: Json) -> Json:
    return element.get("extensions", {})


class _Plain:
    """A new document, written while the old one is read."""

    def __init__(self, path: Path, document: Json) -> None:
        self._path = path
        self._old = document
        self._content = _Content(path, document)
        self._nodes: list[Json] = [dict(node) for node in document.get("nodes", [])]
        self._roots = _roots(document)
        self._world: dict[int, np.ndarray] = {}
        self._meshes: list[Json] = []
        self._accessors: list[Json] = []
        self._views: list[Json] = []
        self._binary = bytearray()
        self._known: dict[tuple[object, ...], int] = {}

    def build(self) -> bytes:
        """The new file."""
        images = [self._image(image) for image in self._old.get("images", [])]
        self._place_nodes()
        for index in self._world:
            self._draw(self._nodes[index])
        kept = {
            key: self._old[key]
            for key in ("asset", "materials", "textures", "samplers")
            if key in self._old
        }
        new = {
            "scenes": [{"nodes": self._roots}],
            "nodes": self._nodes,
            "meshes": self._meshes,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._binary)}],
        }
        return glb(kept | new | ({"images": images} if images else {}), bytes(self._binary))

    def _place_nodes(self) -> None:
        """Where every node of the scene is in it, f64[4, 4]."""
        todo = [(index, np.eye(4)) for index in self._roots]
        while todo:
            index, parent = todo.pop()
            if index in self._world:
                continue
            self._world[index] = parent @ _place(self._nodes[index])
            todo += [
                (child, self._world[index]) for child in self._nodes[index].get("children", [])
            ]

    def _draw(self, node: Json) -> None:
        """Replaces what the node draws by plain meshes."""
        mesh, skin, weights = (node.pop(key, None) for key in ("mesh", "skin", "weights"))
        copies = node.pop("extensions", {}).get(INSTANCING)
        node.pop("camera", None)
        if mesh is None:
            return
        weights = weights or self._old["meshes"][mesh].get("weights") or []
        new = self._mesh(mesh, tuple(weights), skin)
        if skin is not None:
            # Its joints place a skinned surface, its node does not.
            self._roots.append(self._add_node({"mesh": new}))
        elif copies is not None:
            children = [
                self._add_node({"mesh": new, **each}) for each in self._copies(copies["attributes"])
            ]
            node["children"] = [*node.get("children", []), *children]
        else:
            node["mesh"] = new

    def _add_node(self, node: Json) -> int:
        self._nodes.append(node)
        return len(self._nodes) - 1

    def _copies(self, attributes: dict[str, int]) -> list[Json]:
        """Where each copy of a mesh is, in its node's frame."""
        names = [name for name in ("TRANSLATION", "ROTATION", "SCALE") if name in attributes]
        columns = {
            name.lower(): self._content.accessor(attributes[name]).tolist() for name in names
        }
        count = max(map(len, columns.values()), default=0)
        if count > _MOST_COPIES:
            raise AssetError(
                f"{self._path}: {count:,} copies of a mesh ({INSTANCING})",
                f"up to {_MOST_COPIES:,}",
            )
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def _mesh(self, index: int, weights: tuple[float, ...], skin: int | None) -> int:
        """The new index of a mesh as it stands under morph weights and a skin."""
        key = ("mesh", index, weights, skin)
        if key not in self._known:
            primitives = [
                self._primitive(each, weights, skin)
                for each in self._old["meshes"][index]["primitives"]
            ]
            self._meshes.append({"primitives": primitives, "name": f"mesh-{len(self._meshes)}"})
            self._known[key] = len(self._meshes) - 1
        return self._known[key]

    def _primitive(self, old: Json, weights: tuple[float, ...], skin: int | None) -> Json:
        arrays, indices = self._content.primitive(old)
        points = arrays["POSITION"].astype(np.float64)
        for weight, target in zip(weights, old.get("targets", []), strict=False):
            if weight and "POSITION" in target:
                points = points + weight * self._content.accessor(target["POSITION"])
        if skin is not None:
            points = self._apply_skin(points, arrays, self._old["skins"][skin])
        mode = old.get("mode", 4)
        if mode == _FAN:
            fan = np.arange(len(points)) if indices is None else indices
            indices = np.stack([np.full(len(fan) - 2, fan[0]), fan[1:-1], fan[2:]], 1).reshape(-1)
            mode = 4
        kept = {name: arrays[name] for name in ("TEXCOORD_0", "COLOR_0") if name in arrays}
        attributes = {
            name: self._accessor(each) for name, each in (kept | {"POSITION": points}).items()
        }
        new = {"attributes": attributes, "mode": mode}
        if indices is not None:
            new["indices"] = self._accessor(indices[:, None].astype(np.uint32))
        return new | ({"material": old["material"]} if "material" in old else {})

    def _apply_skin(
        self, points: np.ndarray, arrays: dict[str, np.ndarray], skin: Json
    ) -> np.ndarray:
        """f64[V, 3] in the scene, as the joints stand in the file."""
        joints = np.array([self._world[joint] for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            stored = self._content.accessor(skin["inverseBindMatrices"])[: len(joints)]
            joints = joints @ stored.reshape(-1, 4, 4).transpose(0, 2, 1)
        blend = np.zeros((len(points), 4, 4))
        total = np.zeros(len(points))
        sets = sorted(name.removeprefix("WEIGHTS") for name in arrays if name.startswith("WEIGHTS"))
        for which in sets:
            share = arrays[f"WEIGHTS{which}"]
            joint = arrays[f"JOINTS{which}"].astype(int)
            blend += np.einsum("vk,vkij->vij", share, joints[joint])
            total += share.sum(1)
        if not sets:
            raise KeyError("WEIGHTS_0 of a surface with a skin")
        blend = np.where(
            total[:, None, None] > 0,
            blend / np.where(total > 0, total, 1.0)[:, None, None],
            np.eye(4),
        )
        return np.einsum("vij,vj->vi", blend[:, :3, :3], points) + blend[:, :3, 3]

    def _accessor(self, array: np.ndarray) -> int:
        is_index = array.dtype == np.uint32
        data = array if is_index else array.astype("<f4")
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[array.shape[1]]
        accessor = {"bufferView": self._view(data.tobytes()), "count": len(array), "type": kind}
        self._accessors.append(accessor | {"componentType": 5125 if is_index else 5126})
        return len(self._accessors) - 1

    def _view(self, data: bytes) -> int:
        self._binary += b"\0" * (-len(self._binary) % 4)
        self._views.append({"buffer": 0, "byteOffset": len(self._binary), "byteLength": len(data)})
        self._binary += data
        return len(self._views) - 1

    def _image(self, image: Json) -> Json:
        if "bufferView" not in image:
            return image
        return image | {"bufferView": self._view(self._content.view(image["bufferView"]))}


def _roots(document: Json) -> list[int]:
    """The nodes of the scene; of a file without one, all that hang on no other."""
    if scenes := document.get("scenes"):
        return list(scenes[document.get("scene", 0)].get("nodes", []))
    nodes = document.get("nodes", [])
    below = {child for node in nodes for child in node.get("children", [])}
    return [index for index in range(len(nodes)) if index not in below]


def _place(node: Json) -> np.ndarray:
    """f64[4, 4]: where a node is in its parent's frame."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", [0.0, 0.0, 0.0, 1.0])
    place = trimesh.transformations.quaternion_matrix([w, x, y, z])
    place[:3, :3] *= node.get("scale", [1.0, 1.0, 1.0])
    place[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
    return place
