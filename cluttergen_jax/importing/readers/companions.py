"""The files that a mesh file names (materials, images, buffers), found also where they are not as named."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import trimesh
from PIL import Image

from cluttergen_jax.importing.readers.text import utf8

_NAMED = {
    ".obj": rb"^[ \t]*mtllib[ \t]+(.+?)[ \t\r]*$",
    ".mtl": rb"^[ \t]*map_[Kk][Dd][ \t]+(.+?)[ \t\r]*$",
    ".gltf": rb'"uri"\s*:\s*"([^"]{1,1000})"',
    ".dae": rb"<init_from>\s*([^<]+?)\s*</init_from>",
}
# In MTL a file name may stand behind options: map_Kd -s 1 1 1 -clamp on label.png
_OPTIONS = re.compile(r"(?:-[a-z]+\s+(?:(?:[-+.\de]+|on|off)\s+)*)+")
_FOLDERS = (".", "textures", "../textures", "../materials/textures")


def companions(path: Path) -> Iterator[Path]:
    """The files that a mesh file names, and that its materials name, as far as they are there."""
    pattern = _NAMED.get(path.suffix.lower())
    for name in re.findall(pattern, utf8(path.read_bytes()), re.MULTILINE) if pattern else ():
        found = find_named(path.parent, name.decode())
        if found is not None:
            yield found
            yield from companions(found) if found.suffix.lower() == ".mtl" else ()


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
        found = find_named(self._path.parent, str(name))
        if found is None:
            self.notes.append(f"{self._path.name} names {str(name)!r}, which is not there")
            raise FileNotFoundError(name)
        if _OPTIONS.match(str(name).strip()):
            self.notes.append(f"the options of an image are ignored ({str(name).strip()})")
        data = found.read_bytes()
        if found.suffix.lower() == ".mtl":
            return utf8(data)
        if found.suffix.lower() != ".bin":
            try:
                Image.open(io.BytesIO(data))
            except Exception as error:  # Pillow's decoders raise whatever they do.
                self.notes.append(f"{found.name} cannot be read as an image ({_short(error)})")
                raise
        return data


def _short(error: Exception) -> str:
    return re.sub(r" <_io.*?>", "", str(error)) or type(error).__name__
