"""glTF as it lies on disk: a JSON document and buffers of bytes, in one file (GLB) or in several."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.places import find_named

Document = dict[str, Any]
"""glTF's own JSON: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html"""


def read_document(path: Path) -> Document:
    """The JSON of a glTF file; empty if it is none."""
    data = path.read_bytes()
    if data[:4] == b"glTF" and len(data) >= 20:
        (length,) = struct.unpack("<I", data[12:16])
        data = data[20 : 20 + length]
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


class Buffers:
    """The bytes of a glTF file, read when they are asked for.

    Args:
      path: the file. document: its JSON.

    Attributes:
      path: the file.
    """

    def __init__(self, path: Path, document: Document) -> None:
        self.path, self._document = path, document
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


def glb(document: Document, binary: bytes) -> bytes:
    """A GLB file of a document whose only buffer is `binary`."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
