"""How a scene is furnished and lit for pictures: a look, as its YAML file says, some of it drawn.

In a file any value may be drawn anew for each seed: `{one_of: [A, B]}` is one of several, and
`{between: [A, B]}` a number, or a colour, between two. `looks/` beside this file has those that come along.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from PIL import Image, UnidentifiedImageError

from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.rendering.surfaces import KINDS
from cluttergen_jax.schema import SchemaError, convert, digest_of, parse_yaml, read_written

LOOKS = Path(__file__).with_name("looks")
RANDOM = "random"
USUAL_LOOK = "studio"
"""Of pictures, unless another is asked for."""
PLAIN = "plain"
"""No look: a support in its own colours, as datasets have always been drawn."""
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Rgb = tuple[Share, Share, Share]
Strength = Annotated[float, msgspec.Meta(ge=0, le=1000)]
Metres = Annotated[float, msgspec.Meta(ge=0.01, le=100)]
TableForm = Literal["legs", "cabinet", "block"]
_COVERED = ("top", "frame", "floor", "wall")
_PICTURES = (".png", ".jpg", ".jpeg")
_SKIES = (*_PICTURES, ".hdr", ".exr")


class Covering(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a top, a frame, a floor or a wall is made of.

    Attributes:
      of: a kind of `surfaces.KINDS`, or the file of an image (PNG, JPEG), relative to the look's file.
      colours: sRGB in [0, 1], the kind's ground and what is drawn on it; of an image neither.
      tile: metres that the image covers, after which it comes again.
      roughness: 0 is a mirror, 1 is dull. metallic: 1 is bare metal.
      seed: of its noise.
    """

    of: str
    colours: tuple[Rgb, Rgb] = ((0.8, 0.8, 0.8), (0.6, 0.6, 0.6))
    tile: Metres = 1.0
    roughness: Share = 0.5
    metallic: Share = 0.0
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0


class Lamp(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A square lamp that shines on the middle of the scene.

    Attributes:
      azimuth, elevation: degrees: where it is, seen from the scene; azimuth 0 is along +x, 90 along +y.
      distance: metres. size: metres a side; the larger, the softer its shadows.
      colour: sRGB in [0, 1]. strength: of its light where the scene is; 1 makes white things white.
    """

    azimuth: float = -105.0
    elevation: Annotated[float, msgspec.Meta(ge=5, le=90)] = 50.0
    distance: Metres = 2.5
    size: Metres = 1.0
    colour: Rgb = (1.0, 1.0, 1.0)
    strength: Strength = 0.7


class Sky(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Light from all around.

    Attributes:
      colour: sRGB in [0, 1]. strength: as a lamp's.
      image: a panorama (HDR, EXR, PNG, JPEG; twice as wide as high), relative to the look's file; its colours
        are multiplied by `colour` and `strength`.
      turn: degrees about the vertical.
    """

    colour: Rgb = (0.9, 0.95, 1.0)
    strength: Strength = 0.4
    image: str = ""
    turn: float = 0.0


class Look(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A look; see `find_look`.

    Attributes:
      about: in a few words.
      top, frame: of supports that have no surfaces of their own; what is under a table's top is the frame.
      floor, wall: of the room; None leaves it out. room: metres from the scene's middle to each wall.
      table: how a support that is one block is drawn: a board on legs, a cabinet, or that block.
      sky, lamps: its light. exposure: factor on all light.
    """

    about: str
    top: Covering
    frame: Covering
    floor: Covering
    wall: Covering | None = None
    room: Metres = 2.4
    table: TableForm = "legs"
    sky: Sky = Sky()
    lamps: Annotated[tuple[Lamp, ...], msgspec.Meta(min_length=1)] = (Lamp(),)
    exposure: Strength = 1.0
    format: Literal[1] = 1


def embedded_looks() -> dict[str, Path]:
    """Name and file of each look that comes along, by name."""
    return {path.stem: path for path in sorted(LOOKS.glob("*.yaml"))}


def find_look(name_or_path: str | Path, seed: int = 0) -> Look | None:
    """The look of that name or in that YAML file; "random" is any of those that come along.

    Args:
      seed: of what is drawn.

    Returns:
      None for "plain".

    Raises:
      ConfigError: there is none, or its file says what no look can be.
    """
    looks = embedded_looks()
    rng = np.random.default_rng((seed, 29))
    name = str(name_or_path)
    if name == PLAIN:
        return None
    if name == RANDOM:
        name = str(rng.choice(list(looks)))
    path = looks.get(name, Path(name))
    if name not in looks and not path.suffix:
        raise ConfigError(
            f"look {name!r}",
            f"{', '.join(looks)}, {RANDOM}, {PLAIN}, or a YAML file",
            hint=closest(name, looks),
        )
    return read_look(path, rng)


def look_record(name_or_path: str | Path) -> dict[str, str]:
    """What a record says of a look: its name, and a digest of its file; nothing of "plain"."""
    name = str(name_or_path)
    if name == PLAIN:
        return {}
    looks = embedded_looks()
    files = list(looks.values()) if name == RANDOM else [looks.get(name, Path(name))]
    text = b"".join(path.read_bytes() for path in files)
    return {"look": Path(name).name, "look_digest": digest_of(text)}


def read_look(path: Path, rng: np.random.Generator) -> Look:
    """The look in a file, with what it leaves open drawn by `rng`; files that it names are found.

    Raises:
      ConfigError: as `find_look`.
    """
    try:
        written = parse_yaml(read_written(path))
        look = convert(_draw_open_values(written, rng), Look)
        coverings = {}
        for part in _COVERED:
            # What is not drawn this time is by another seed.
            for name in _values_at(written, part, "of"):
                _check_covering(name, part, path.parent)
            covering: Covering | None = getattr(look, part)
            if covering is not None:
                found = _check_covering(covering.of, part, path.parent)
                coverings[part] = msgspec.structs.replace(covering, of=found)
        for name in _values_at(written, "sky", "image"):
            _find_image(name, path.parent, _SKIES, "sky")
        image = look.sky.image and _find_image(look.sky.image, path.parent, _SKIES, "sky")
    except OSError as error:
        raise ConfigError(
            f"look {str(path)!r} ({error.strerror})", "the YAML file of a look"
        ) from error
    except SchemaError as error:
        raise ConfigError(
            f"look {path}: {error}", "docs/reference/looks.md has an example"
        ) from error
    sky = msgspec.structs.replace(look.sky, image=image)
    return msgspec.structs.replace(look, sky=sky, **coverings)


def _draw_open_values(value: Any, rng: np.random.Generator) -> Any:
    """A value of a file with all that is left open in it chosen.

    Raises:
      SchemaError: `one_of` of nothing, or `between` of what is not two numbers or two colours.
    """
    if isinstance(value, list):
        return [_draw_open_values(each, rng) for each in value]
    if not isinstance(value, Mapping):
        return value
    if set(value) == {"one_of"}:
        options = value["one_of"]
        if not isinstance(options, list) or not options:
            raise SchemaError(f"one_of: {options!r}, where a list of one or more is needed")
        return _draw_open_values(options[int(rng.integers(len(options)))], rng)
    if set(value) == {"between"}:
        try:
            low, high = (np.asarray(each, np.float64) for each in value["between"])
            between = low + rng.uniform() * (high - low)
        except (TypeError, ValueError) as error:
            raise SchemaError(
                f"between: {value['between']!r}, where two numbers or two colours are needed"
            ) from error
        return between.tolist()
    return {key: _draw_open_values(each, rng) for key, each in value.items()}


def _values_at(value: Any, *keys: str) -> Iterator[str]:
    """All texts that a file may have drawn at a place."""
    if isinstance(value, Mapping) and set(value) == {"one_of"}:
        for option in value["one_of"]:
            yield from _values_at(option, *keys)
    elif keys and isinstance(value, Mapping):
        yield from _values_at(value.get(keys[0]), *keys[1:])
    elif not keys and isinstance(value, str):
        yield value


def _check_covering(of: str, part: str, folder: Path) -> str:
    """What a covering is of: a kind, or the path of an image that is there."""
    if of in KINDS:
        return of
    if "." not in of:
        near = closest(of, KINDS)
        raise SchemaError(f"{part} is of {of!r}; known are {', '.join(KINDS)}. {near}")
    return _find_image(of, folder, _PICTURES, part)


def _find_image(name: str, folder: Path, endings: tuple[str, ...], part: str) -> str:
    path = folder / name
    if not re.search(f"({'|'.join(endings)})$", name.lower()) or not path.is_file():
        raise SchemaError(f"{part} has image {name!r}; needed is a file: {', '.join(endings)}")
    if path.suffix.lower() in _PICTURES:
        try:
            Image.open(path).close()
        except UnidentifiedImageError as error:
            raise SchemaError(f"{part} has image {name!r}, which holds no image") from error
    return str(path)
