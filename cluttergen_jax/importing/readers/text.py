"""Mesh files as trimesh takes them: text in UTF-8, whatever it was written in.

Old exporters write comments and material names in Latin-1. trimesh guesses the encoding with a library that
may be missing, from the first thousand bytes, and drops what it cannot decode, so that a material of the OBJ
file may no longer be found in the MTL file.
"""

from __future__ import annotations

import codecs
import io
import re
from pathlib import Path
from typing import Any

from cluttergen_jax.importing.readers.collada import with_image_paths
from cluttergen_jax.importing.readers.gltf_plain import plain_glb
from cluttergen_jax.importing.readers.stl import is_text_stl

_END_OF_HEADER = b"end_header"
_WORD_AND_TAB = re.compile(rb"^[ \t]*([a-z]+)[ ]*\t[ \t]*", re.MULTILINE)
ALL_MATERIALS = "*.mtl"
"""What an OBJ file's text calls all its material files together: trimesh asks for one."""

_MTLLIB = re.compile(rb"^[ \t]*mtllib[ \t]+(.+?)(?:[ \t]+#.*?)?[ \t\r]*$", re.MULTILINE)


def opened(path: Path) -> dict[str, Any]:
    """A mesh file as `trimesh.load_scene` takes it: `file_obj`, and `file_type` where that is no path."""
    suffix = path.suffix.lower()
    if suffix in (".glb", ".gltf") and (plain := plain_glb(path)) is not None:
        return {"file_obj": io.BytesIO(plain), "file_type": "glb"}
    if suffix == ".dae" and (named := with_image_paths(path)) is not None:
        return {"file_obj": io.BytesIO(named), "file_type": "dae"}
    if suffix not in (".obj", ".ply", ".stl"):
        return {"file_obj": str(path)}
    data = path.read_bytes()
    if suffix == ".ply":
        head, end, body = data.partition(_END_OF_HEADER)
        data = (utf8(head) if end else head) + end + body
    elif suffix == ".obj":
        data = _plain_obj(utf8(data))
    elif is_text_stl(data, len(data)):
        data = utf8(data)
    return {"file_obj": io.BytesIO(data), "file_type": suffix[1:]}


def utf8(data: bytes) -> bytes:
    """Text in UTF-8: what is UTF-8 or UTF-16 stays as it is, all else is read as Windows-1252 or Latin-1."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace").encode()
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return data.decode(encoding).encode()
        except UnicodeDecodeError:
            continue
    return data.decode("latin-1").encode()


def material_lines(data: bytes) -> list[str]:
    """What the `mtllib` lines of an OBJ text name: each one file, or several with spaces between them."""
    return [name.decode() for name in dict.fromkeys(_MTLLIB.findall(data))]


def _plain_obj(data: bytes) -> bytes:
    """An OBJ text as trimesh follows it: spaces behind keywords, and one `mtllib` line, the first."""
    if b"\t" in data:
        data = _WORD_AND_TAB.sub(rb"\1 ", data)
    return f"mtllib {ALL_MATERIALS}\n".encode() + data if material_lines(data) else data
