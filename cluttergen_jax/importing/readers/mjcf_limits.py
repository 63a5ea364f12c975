"""How much an MJCF file asks of MuJoCo, by its text: MuJoCo itself has no limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from PIL import Image

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.opening import MOST_MESH, MOST_PIXELS, check_openable
from cluttergen_jax.importing.readers.xml_tree import (
    BROKEN,
    Element,
    attribute_text,
    parse_numbers,
    read_xml,
)

MOST_ELEMENTS = 200_000
"""Elements of a model, copies by <replicate>, <composite> and <attach> included."""
_MOST_COPIES = 2000
"""By <replicate>, for which MuJoCo's time grows with the third power: 19 s for 2000 bodies."""
_MOST_CELLS = 1 << 24
"""Of a height field or a grid."""
_MOST_BYTES = 4 << 30
_MOST_SUBDIVISION = 7
"""Of a sphere that MuJoCo makes: each step has four times as many triangles."""
_MOST_PARAMS = 1000
"""Of other forms that MuJoCo makes: sides and rings."""
_MOST_NESTED = 16
"""Files that attach or include each other in a row."""
_FOLDERS = ("meshdir", "assetdir", "texturedir")
_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tga")
_UNITS = {"k": 10, "m": 20, "g": 30, "t": 40, "p": 50, "e": 60}
_COUNTED: tuple[str, ...] = (
    "count",
    "grid",
    "nrow",
    "ncol",
    "nuser_body",
    "nuser_jnt",
    "nuser_geom",
    "nuser_site",
    "nuser_cam",
)
_COUNTED += (
    "nuser_tendon",
    "nuser_actuator",
    "nuser_sensor",
    "nkey",
    "nuserdata",
    "njmax",
    "nconmax",
)


def check_mjcf_extent(path: Path) -> None:
    """Refuses a model that goes beyond limits; what MuJoCo refuses itself is left to it.

    Raises:
      AssetError: it attaches or includes itself, names what is no regular file, or asks for more copies,
        cells, pixels or bytes than a model of an object has.
    """
    _Model(path).check()


@dataclass
class _Model:
    path: Path
    sizes: dict[Path, float] = field(
        default_factory=dict
    )  # Elements of each file, copies included.
    copies: float = 0.0  # Of all that is replicated.

    def check(self) -> None:
        count = self._size(self.path, (), self.path.parent)
        if self.copies > _MOST_COPIES:
            raise self._error(
                f"<replicate> of {self.copies:.7g} copies", f"up to {_MOST_COPIES:,} in all"
            )
        if count > MOST_ELEMENTS:
            raise self._error(
                f"a model of {count:.3g} elements, copies included", f"up to {MOST_ELEMENTS:,}"
            )

    def _error(self, given: str, allowed: str, hint: str = "a smaller model") -> AssetError:
        return AssetError(f"{self.path}: {given}", allowed, hint)

    def _size(self, file: Path, above: tuple[Path, ...], main: Path) -> float:
        """Elements of a file with all that it includes and attaches.

        Args:
          above: the files that do so with this one; main: the folder that names are relative to.
        """
        real = file.resolve()
        if real in above:
            way = " -> ".join(each.name for each in (*above[above.index(real) :], real))
            raise self._error(
                f"a model that attaches or includes itself ({way})", "files that do not", ""
            )
        if len(above) >= _MOST_NESTED:
            raise self._error(
                f"more than {_MOST_NESTED} files within each other", f"up to {_MOST_NESTED}"
            )
        if real in self.sizes:
            return self.sizes[real]
        try:
            root = read_xml(file)
        except BROKEN as error:
            if "within each other" in str(error):
                raise self._error(
                    str(error), "elements within each other that are fewer"
                ) from error
            # MuJoCo says why.
            return 0.0
        folders = [main, file.parent]
        for compiler in root.iter("compiler"):
            folders += [main / compiler.get(name, "").replace("\\", "/") for name in _FOLDERS]
        parts: dict[str, float] = {}
        included = 0.0
        for element in root.iter():
            self._check_element(element)
            for name in _files_of(element):
                for there in _places(name, folders):
                    self._check_file(there, element.tag)
                    if element.tag == "model":
                        parts[element.get("name", "")] = self._size(
                            there, (*above, real), there.parent
                        )
                    elif element.tag == "include":
                        included += self._size(there, (*above, real), main)
                    break
        own, copies = _copies(root, parts)
        self.sizes[real] = own + included
        self.copies += copies
        return self.sizes[real]

    def _check_file(self, file: Path, tag: str) -> None:
        check_openable(file, MOST_MESH)
        if file.suffix.lower() in _PICTURES:
            check_pixels(file)
        if tag == "hfield" and file.suffix.lower() not in _PICTURES:
            with file.open("rb") as content:
                rows, columns = (
                    int.from_bytes(content.read(4), "little", signed=True) for _ in range(2)
                )
            self._check_grid("hfield", rows, columns)

    def _check_grid(self, tag: str, rows: float, columns: float) -> None:
        if rows > 0 and columns > 0 and rows * columns > _MOST_CELLS:
            raise self._error(
                f"a <{tag}> of {rows:g} x {columns:g} cells", f"up to {_MOST_CELLS:,} cells"
            )

    def _check_element(self, element: Element) -> None:
        tag = str(element.tag)
        number = {name: _first(element, name) for name in (*_COUNTED, "width", "height")}
        if tag == "hfield":
            self._check_grid(tag, number["nrow"], number["ncol"])
        if tag == "texture" and number["width"] > 0:
            # A cube has six faces, one below the other.
            height = max(number["height"], number["width"])
            if 6 * number["width"] * height > MOST_PIXELS:
                raise self._error(
                    f"a <texture> of {number['width']:g} x {height:g} pixels",
                    f"up to {MOST_PIXELS:,} pixels",
                )
        if tag == "mesh" and element.get("builtin"):
            most = _MOST_SUBDIVISION if element.get("builtin") == "sphere" else _MOST_PARAMS
            if max(map(abs, _all(element, "params")), default=0) > most:
                raise self._error(f"a <mesh> of params {element.get('params')!r}", f"up to {most}")
        if tag == "size":
            for name in _COUNTED:
                if number[name] > _MOST_CELLS:
                    raise self._error(
                        f"<size {name}={element.get(name)!r}>", f"up to {_MOST_CELLS:,}"
                    )
            for name in ("memory", "nstack", "njmax_memory"):
                if _bytes(element.get(name, "")) > _MOST_BYTES:
                    raise self._error(f"<size {name}={element.get(name)!r}>", "up to 4G")
        if tag in ("flexcomp", "composite"):
            self._check_grid(tag, *_product(element))


def _product(element: Element) -> tuple[float, float]:
    counts = [max(each, 1.0) for each in _all(element, "count")]
    return math.prod(counts[:1]), math.prod(counts[1:])


def _copies(root: Element, parts: dict[str, float]) -> tuple[float, float]:
    """Elements of a tree, those within <replicate> as often as it says, with the models that it attaches.

    Returns:
      Their number, and that of the copies which <replicate> makes.
    """
    total = 0.0
    copies = 0.0
    todo = [(root, 1.0)]
    while todo:
        element, times = todo.pop()
        own = 1.0
        if element.tag == "replicate":
            times *= max(_first(element, "count"), 1.0)
            copies += times
        elif element.tag in ("composite", "flexcomp"):
            own += math.prod(_product(element))
        elif element.tag == "attach":
            own += parts.get(element.get("model", ""), 0.0)
        total += times * own
        if math.isnan(total) or max(total, copies) > 1e30:
            return math.inf, copies
        todo += [(child, times) for child in element]
    return total, copies


def _files_of(element: Element) -> Iterator[str]:
    for name, value in element.items():
        if name.startswith("file") and value:
            yield value.replace("\\", "/")


def _places(name: str, folders: list[Path]) -> Iterator[Path]:
    for folder in dict.fromkeys(folders):
        for place in (folder / name, folder / Path(name).name):
            try:
                if place.exists() and not place.is_dir():
                    yield place
            except (OSError, ValueError):
                continue


def _all(element: Element, name: str) -> list[float]:
    found = parse_numbers(attribute_text(element, name) or "") or []
    return [0.0 if math.isnan(each) else each for each in found]


def _first(element: Element, name: str) -> float:
    return next(iter(_all(element, name)), 0.0)


def _bytes(text: str) -> float:
    """What "1G" or "1024" says; 0 where it is no number."""
    text = text.strip().lower()
    exponent = _UNITS.get(text[-1:], 0)
    found = parse_numbers(text[:-1] if exponent else text) or [0.0]
    return found[0] * 2.0**exponent


def check_pixels(file: Path) -> None:
    """Refuses an image of too many pixels, by its head (AssetError); what is none is left to its reader."""
    try:
        with Image.open(file) as image:
            width, height = image.size
    except Image.DecompressionBombError as error:
        raise AssetError(f"{file}: {error}", f"up to {MOST_PIXELS:,} pixels") from error
    except Exception:  # Pillow's decoders raise whatever they do.
        return
    if width * height > MOST_PIXELS:
        raise AssetError(
            f"{file} has {width:,} x {height:,} pixels", f"up to {MOST_PIXELS:,} pixels"
        )
