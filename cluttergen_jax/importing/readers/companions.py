"""The files that a mesh file names (materials, images, buffers), found also where they are not as named."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import trimesh
from PIL import Image

from cluttergen_jax.importing.readers.text import ALL_MATERIALS, material_lines, utf8

_NAMED = {
    ".mtl": rb"^[ \t]*map_[Kk][Dd][ \t]+(.+?)[ \t\r]*$",
    ".gltf": rb'"uri"\s*:\s*"([^"]{1,1000})"',
    ".dae": rb"<init_from>\s*([^<]+?)\s*</init_from>",
}
# In MTL a file name may stand behind options: map_Kd -s 1 1 1 -clamp on label.png
_OPTIONS = re.compile(r"(?:-[a-z]+\s+(?:(?:[-+.\de]+|on|off)\s+)*)+")
_FOLDERS = (".", "textures", "../textures", "../materials/textures")


def companions(path: Path) -> Iterator[Path]:
    """The files that a mesh file names, and that its materials name, as far as they are there."""
    suffix = path.suffix.lower()
    if suffix == ".obj":
        for _, found in _material_files(path):
            if found is not None:
                yield found
                yield from companions(found) if found.suffix.lower() == ".mtl" else ()
    elif pattern := _NAMED.get(suffix):
        for name in re.findall(pattern, utf8(path.read_bytes()), re.MULTILINE):
            if (found := find_named(path.parent, name.decode())) is not None:
                yield found


def _material_files(obj: Path) -> Iterator[tuple[str, Path | None]]:
    """The material files of an OBJ file by name, None where one is not there.

    A line names one file, whose name may hold spaces; or if that is not there, several.
    """
    for line in material_lines(utf8(obj.read_bytes())):
        names = [line] if find_named(obj.parent, line) else line.split()
        yield from ((name, find_named(obj.parent, name)) for name in names)


def find_named(folder: Path, name: str) -> Path | None:
    """The file that a file in `folder` calls `name`; None if there is none.

    Looked for where it is said to be, then by its last part alone beside it and in folders called `textures`:
    many files name a place on their author's machine.
    """
    plain = unquote(_OPTIONS.sub("", name.strip(), count=1).strip('"').removeprefix("file://"))
    plain = plain.replace("\\", "/")
    last = plain.rpartition("/")[2]
    for candidate in (folder / plain, *(folder / each / last for each in _FOLDERS)):
        try:
            if last and candidate.is_file():
                return candidate
        except (OSError, ValueError):
            continue
    return None


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
        if _OPTIONS.match(str(name).strip()):
            self.notes.append(f"the options of an image are ignored ({str(name).strip()})")
        data = found.read_bytes()
        if found.suffix.lower() != ".bin":
            try:
                Image.open(io.BytesIO(data))
            except Exception as error:  # Pillow's decoders raise whatever they do.
                self.notes.append(f"{found.name} cannot be read as an image ({_short(error)})")
                raise
        return data

    def _materials(self) -> bytes:
        """The content of all material files of an OBJ file."""
        texts = []
        for name, found in _material_files(self._path):
            if found is None:
                self._miss(name)
            else:
                texts.append(utf8(found.read_bytes()))
        return b"\n".join(texts)

    def _miss(self, name: str) -> None:
        self.notes.append(f"{self._path.name} names {name!r}, which is not there")


def _short(error: Exception) -> str:
    return re.sub(r" <_io.*?>", "", str(error)) or type(error).__name__


_SCHEME = re.compile(r"^(file|package|model)://")
_DRIVE = re.compile(r"/?[A-Za-z]:/")
_MESH_FOLDERS = ("meshes", "../meshes", *_FOLDERS)


def mesh_place(urdf: Path, name: str) -> Path | None:
    """The file that a URDF names, None if it is not there.

    Looked for as it is named, beside the URDF and in four folders above, where `package://` asks for that;
    then by the last parts of its path, as many as fit: it may be a place on its author's machine.
    """
    roots = (urdf.parent, *list(urdf.resolve().parents)[1:5])
    for text in dict.fromkeys((name, unquote(name))):
        plain = _plain_path(text)
        in_package = plain.partition("/")[2] if text.startswith(("package://", "model://")) else ""
        parts = [part for part in plain.split("/") if part not in ("", ".", "..")]
        shorter = ["/".join(parts[start:]) for start in range(1, len(parts) - 1)]
        candidates = [root / tail for root in roots for tail in (plain, in_package) if tail]
        candidates += [root / tail for tail in shorter for root in roots]
        candidates += [urdf.parent / each / parts[-1] for each in _MESH_FOLDERS if parts]
        if (found := next(filter(_is_file, candidates), None)) is not None:
            return found
    return None


def is_found_elsewhere(name: str, file: Path) -> bool:
    """Whether a file bears the last part alone of the path by which a URDF names it."""
    return len(parts := _plain_path(unquote(name)).split("/")) > 1 and file.parts[-2:-1] != (parts[-2],)


def _plain_path(name: str) -> str:
    """A path with slashes, without scheme and drive."""
    plain = _SCHEME.sub("", name.strip(), count=1).replace("\\", "/")
    return plain[drive.end() :] if (drive := _DRIVE.match(plain)) else plain


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
