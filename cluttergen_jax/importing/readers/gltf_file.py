"""glTF as it lies on disk: JSON, buffers of bytes, in one file (GLB) or several, and its extensions."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.places import find_named

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
    return (
        values[0]
        if isinstance(values, list) and (len(values) == 1 or (values and key == "scenes"))
        else None
    )


_WHITE = [1, 1, 1, 1]


def is_coloured_by_vertices(document: Json, primitive: Json) -> bool:
    """Whether the colours at a primitive's vertices are all that it has: its material is white."""
    if "COLOR_0" not in primitive["attributes"] or "material" not in primitive:
        return False
    material = document["materials"][primitive["material"]]
    look = material.get("pbrMetallicRoughness", {})
    if "KHR_materials_pbrSpecularGlossiness" in material.get("extensions", {}):
        # The colour is there.
        return False
    return "baseColorTexture" not in look and look.get("baseColorFactor", _WHITE)[:3] == _WHITE[:3]


class Buffers:
    """The bytes of a glTF file, read when they are asked for.

    Args:
      path: the file. document: its JSON.

    Attributes:
      path: the file.
    """

    def __init__(self, path: Path, document: Json) -> None:
        self.path = path
        self._document = document
        self._read: dict[int, bytes] = {}

    def view(self, index: int) -> bytes:
        """The bytes of one buffer view."""
        view = self._document["bufferViews"][index]
        start = view.get("byteOffset", 0)
        return self.buffer(view["buffer"])[start : start + view["byteLength"]]

    def buffer(self, index: int) -> bytes:
        """The bytes of one buffer, empty where the file has none for it.

        Raises:
          AssetError: it names a file that is not there.
        """
        if index not in self._read:
            uri = self._document["buffers"][index].get("uri")
            # A GLB file's own bytes are its first buffer's.
            own = _binary_chunk(self.path) if uri is None and index == 0 else b""
            self._read[index] = own if uri is None else self._bytes_at(uri)
        return self._read[index]

    def _bytes_at(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            return base64.b64decode(body) if head.endswith(";base64") else unquote_to_bytes(body)
        found = find_named(self.path.parent, uri)
        if found is None:
            raise AssetError(
                f"{self.path} names buffer {uri!r}, which is not there", hint="restoring the file"
            )
        return found.read_bytes()


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
_OF_LOOKS = (
    *(
        "KHR_materials_",
        "KHR_texture_",
        "EXT_texture_",
        "MSFT_texture_",
        "KHR_lights_",
        "EXT_lights_",
    ),
    *("KHR_xmp", "KHR_animation_pointer"),
)
_DRAWN_ALIKE = ("KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness")
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
        undo = (
            f"gltf-transform copy {path.name} plain.glb"
            if wanted[0] in _MESHOPT
            else "exporting without it"
        )
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
    modes = [
        each.get("mode", 4) for mesh in document.get("meshes", []) for each in mesh["primitives"]
    ]
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
