"""Mesh files as trimesh takes them: text in UTF-8, whatever it was written in.

Old exporters write comments and material names in Latin-1. trimesh guesses the encoding with a library that
may be missing, from the first thousand bytes, and drops what it cannot decode, so that a material of the OBJ
file may no longer be found in the MTL file.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import trimesh
from PIL import Image

from cluttergen_jax.files import MOST_WORDS
from cluttergen_jax.importing.readers.collada import plain_collada
from cluttergen_jax.importing.readers.damage import is_text_stl
from cluttergen_jax.importing.readers.gltf_plain import plain_glb
from cluttergen_jax.importing.readers.opening import as_utf8, read_file
from cluttergen_jax.importing.readers.places import OPTIONS, find_named

_END_OF_HEADER = b"end_header"
_OLD_COLOUR = re.compile(rb"(?<=[ \t])diffuse_(red|green|blue)\b")
"""What early PLY files call their colours."""
_WORD_AND_TAB = re.compile(rb"^[ \t]*([a-z]+)[ ]*\t[ \t]*", re.MULTILINE)
ALL_MATERIALS = "*.mtl"
"""What an OBJ file's text calls all its material files together: trimesh asks for one."""

_MTLLIB = re.compile(rb"mtllib[ \t]++([^\n]++)$", re.MULTILINE)
_REMARK = re.compile(rb"(?<=[ \t])#.*", re.DOTALL)


class MeshInput(NamedTuple):
    """A mesh file as `trimesh.load_scene` takes it: its content and suffix, or its path."""

    file_obj: io.BytesIO | str
    file_type: str | None = None


def mesh_input(path: Path) -> MeshInput:
    """A mesh file in a form that trimesh understands."""
    suffix = path.suffix.lower()
    if suffix in (".glb", ".gltf") and (plain := plain_glb(path)) is not None:
        return MeshInput(io.BytesIO(plain), "glb")
    if suffix == ".dae" and (named := plain_collada(path)) is not None:
        return MeshInput(io.BytesIO(named), "dae")
    if suffix not in (".obj", ".ply", ".stl"):
        return MeshInput(str(path))
    data = read_file(path)
    if suffix == ".ply":
        head, end, body = data.partition(_END_OF_HEADER)
        data = (_OLD_COLOUR.sub(rb"\1", as_utf8(head)) if end else head) + end + body
    elif suffix == ".obj":
        data = _plain_obj(as_utf8(data))
    elif is_text_stl(data, len(data)):
        data = as_utf8(data)
    return MeshInput(io.BytesIO(data), suffix[1:])


def material_lines(data: bytes) -> list[str]:
    """What the `mtllib` lines of an OBJ text name: each one file, or several with spaces between them."""
    lines = [
        found[1]
        for found in _MTLLIB.finditer(data)
        if not data[data.rfind(b"\n", 0, found.start()) + 1 : found.start()].strip(b" \t")
    ]
    named = (_REMARK.sub(b"", line, count=1).strip(b" \t\r") for line in lines)
    return [name.decode() for name in dict.fromkeys(named) if name]


def _plain_obj(data: bytes) -> bytes:
    """An OBJ text as trimesh follows it: spaces behind keywords, and one `mtllib` line, the first."""
    if b"\t" in data:
        data = _WORD_AND_TAB.sub(rb"\1 ", data)
    return f"mtllib {ALL_MATERIALS}\n".encode() + data if material_lines(data) else data


_NAMED = {
    ".mtl": rb"^[ \t]*+map_[Kk][Dd][ \t]++([^\n]++)$",
    ".gltf": rb'"uri"\s*:\s*"([^"]{1,1000})"',
    ".dae": rb"<init_from>([^<]++)</init_from>",
}
_USED, _DEFINED = (
    re.compile(rb"^[ \t]*+%s[ \t]++([^\n]++)$" % word, re.MULTILINE)
    for word in (b"usemtl", b"newmtl")
)
_ONE_NUMBER = re.compile(rb"^([ \t]*Kd)[ \t]+([-+.\deE]+)(?=[ \t\r]*$)", re.MULTILINE)


def companions(path: Path) -> Iterator[Path]:
    """The files that a mesh file names, and that its materials name, as far as they are there."""
    suffix = path.suffix.lower()
    if suffix == ".obj":
        for _, found in _material_files(path):
            if found is not None:
                yield found
                yield from companions(found) if found.suffix.lower() == ".mtl" else ()
    elif pattern := _NAMED.get(suffix):
        for name in re.findall(pattern, as_utf8(read_file(path)), re.MULTILINE):
            if (found := find_named(path.parent, name.strip().decode())) is not None:
                yield found


def _names(pattern: re.Pattern[bytes], text: bytes) -> list[bytes]:
    return [name.strip() for name in pattern.findall(text)]


def _material_files(obj: Path) -> Iterator[tuple[str, Path | None]]:
    """The material files of an OBJ file by name, None where one is not there.

    A line names one file, whose name may hold spaces; or if that is not there, several.
    """
    for line in material_lines(as_utf8(read_file(obj))):
        names = [line] if find_named(obj.parent, line) else line.split()
        yield from ((name, find_named(obj.parent, name)) for name in names)


class Companions(trimesh.resolvers.FilePathResolver):
    """Hands a mesh file's companions to trimesh, and remembers what could not be read.

    Attributes:
      notes: that in words.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(str(path))
        self._path = path
        self.notes: list[str] = []

    def get(self, name: str) -> bytes:
        """The content of the file that is called so."""
        if name == ALL_MATERIALS:
            return self._materials()
        found = find_named(self._path.parent, str(name))
        if found is None:
            self._miss(str(name))
            raise FileNotFoundError(name)
        if OPTIONS.match(str(name).strip()):
            self.notes.append(f"the options of an image are ignored ({str(name).strip()})")
        data = read_file(found)
        if found.suffix.lower() != ".bin":
            try:
                Image.open(io.BytesIO(data))
            except Exception as error:  # Pillow's decoders raise whatever they do.
                reason = re.sub(r" <_io.*?>", "", str(error)) or type(error).__name__
                self.notes.append(f"{found.name} cannot be read as an image ({reason})")
                raise
        return data

    def _materials(self) -> bytes:
        """The content of all material files of an OBJ file."""
        texts = []
        for name, found in _material_files(self._path):
            if found is None:
                self._miss(name)
            else:
                texts.append(as_utf8(read_file(found, MOST_WORDS)))
        text = b"\n".join(texts)
        if texts:
            used = dict.fromkeys(_names(_USED, as_utf8(self._path.read_bytes())))
            defined = set(_names(_DEFINED, text))
            lost = [name.decode() for name in used if name not in defined]
            self.notes += [
                f"{self._path.name} names material {name!r}, which is nowhere defined"
                for name in lost
            ]
        # Of a colour with one number the others are equal to it.
        return _ONE_NUMBER.sub(rb"\1 \2 \2 \2", text)

    def _miss(self, name: str) -> None:
        self.notes.append(f"{self._path.name} names {name!r}, which is not there")
