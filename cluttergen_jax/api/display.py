"""Scenes, banks and pools that show themselves: pictures, sheets, the viewer, and what a notebook shows.

Options are those of `render` and `view`, whatever these take: what is not for one picture or for a sheet is
refused by name.
"""

from __future__ import annotations

import base64
import html
import inspect
import io
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from itertools import compress
from typing import TYPE_CHECKING, Any

from cluttergen_jax.api.render import render, view
from cluttergen_jax.config import check_range
from cluttergen_jax.errors import ClutterGenError, ConfigError, closest

if TYPE_CHECKING:
    from PIL import Image

    from cluttergen_jax.assets.object import ObjectAsset
    from cluttergen_jax.assets.pool import Pool
    from cluttergen_jax.rendering.viewer.viewer import Viewer
    from cluttergen_jax.scene import Bank, Scene

_PRODUCTS = (
    "picture",
    "sheet",
    "turntable",
    "replay",
    "figure",
    "density",
    "depth",
    "segmentation",
    "points",
    "bop",
)
_NOT_DRAWN = ("source", "out", *_PRODUCTS, "views", "split", "pixel_origin", "film", "pace")
"""Arguments of `render` that say what is made, or are about films and datasets."""
_NOT_OF_PICTURES = (*_NOT_DRAWN, "scenes", "columns", "cameras")
_NOT_OF_SHEETS = (*_NOT_DRAWN, "cameras", "seed")
_NOTEBOOK = {"size": (640, 480), "quality": "fine"}
"""Of a scene's picture in a notebook, which is drawn whenever a cell ends with a scene."""
_SMALL_SHEET = {"size": (240, 180), "quality": "draft", "columns": 4}
_SCENES = 8
_OBJECTS = 24
"""Drawn of a bank and of a pool in a notebook."""
_OBJECT_SIZE = (200, 150)
_OBJECT_COLUMNS = 6
_OBJECT_SAMPLES = 4
_MOST_COLUMNS = 1000


def picture_of(scene: Scene, options: Mapping[str, Any]) -> Image.Image:
    """See `Scene.picture`."""
    asked = dict(options)
    camera = asked.pop("camera", None)
    _check(asked, "picture", ("camera", *_options_of_render(_NOT_OF_PICTURES)))
    if camera is not None:
        asked["cameras"] = (camera,)
    return _draw_one(scene, asked, picture=True)


def sheet_of(source: Bank | Sequence[Scene], options: Mapping[str, Any]) -> Image.Image:
    """See `Bank.sheet`."""
    _check(options, "sheet", _options_of_render(_NOT_OF_SHEETS))
    # `render` adds single pictures of scenes that are named unless it is told not to.
    return _draw_one(source, options, picture=False, sheet=True)


def show(source: Scene | Bank, options: Mapping[str, Any]) -> Viewer | None:
    """See `Scene.show`."""
    return view(source, **{"port": 0, **options})


def pool_sheet_of(pool: Pool, options: Mapping[str, Any]) -> Image.Image:
    """See `Pool.sheet`."""
    from PIL import Image

    from cluttergen_jax.assets.pool import MOST_READ
    from cluttergen_jax.rendering.assets import object_sheet

    _check(options, "sheet", ("objects", "columns", "samples"))
    names = options.get("objects")
    columns = options.get("columns", 4)
    check_range("columns", columns, 1, _MOST_COLUMNS, 4)
    if isinstance(names, str):
        raise ConfigError(f"objects = {names!r}", "a sequence of names", f"objects=({names!r},)")
    if names is None and len(pool) > MOST_READ:
        given = f"a sheet of all {len(pool)} objects of pool {pool.name!r}"
        hint = "objects=pool.names[:40]"
        raise ConfigError(given, f"up to {MOST_READ}, or those of `objects`", hint)
    objects = pool.objects if names is None else [pool[name] for name in names]
    return Image.fromarray(object_sheet(objects, columns, options.get("samples")))


def png_of(scene: Scene) -> bytes | None:
    """A scene as a PNG for a notebook; None, with a warning, where nothing can draw."""
    try:
        return _png(picture_of(scene, _NOTEBOOK))
    except ClutterGenError as error:
        warnings.warn(f"no picture of the scene: {error}", stacklevel=2)
        return None


def html_of(bank: Bank) -> str:
    """A bank for a notebook: how it was made, how much of it succeeded, and its first scenes."""
    recipe = bank.recipe
    rules = recipe.get("placement") or {}
    (counted, scenes) = _scenes_of(bank)
    rows = {
        "scenes": counted,
        "pool": _public(recipe.get("pool")),
        "support": _public(recipe.get("support")),
        "objects of a scene": rules.get("num_objects"),
        "method": recipe.get("method"),
        "seed": recipe.get("seed"),
    }
    cells = "".join(
        f"<tr><td>{title}</td><td>{html.escape(str(value))}</td></tr>"
        for title, value in rows.items()
        if value not in (None, "")
    )
    name = html.escape(bank.path.resolve().name)
    drawn = _picture_or_reason(lambda: sheet_of(bank, {**_SMALL_SHEET, "scenes": scenes}), scenes)
    return f"<div><b>Bank {name}</b><table>{cells}</table>{drawn}</div>"


def pool_html_of(pool: Pool) -> str:
    """A pool for a notebook: its first objects, each with its name, and its label where that differs."""
    names = pool.names[:_OBJECTS]
    about = f"{len(pool)} objects"
    if len(names) < len(pool):
        about += f", of which these are the first {len(names)}"
    drawn = _picture_or_reason(lambda: _labelled_sheet([pool[name] for name in names]), names)
    return f"<div><b>Pool {html.escape(pool.name)}</b>: {about}{drawn}</div>"


def _scenes_of(bank: Bank) -> tuple[str, list[int]]:
    """How many scenes there are and succeeded; and the first that did, or the first of all if none did."""
    try:
        known = [rows.to_pydict() for rows in bank.tables(["index", "is_success"])]
    except ClutterGenError as error:
        return str(error), []
    numbers = [number for rows in known for number in rows["index"]]
    is_success = [value for rows in known for value in rows["is_success"]]
    good = list(compress(numbers, is_success))
    counted = f"{len(numbers)}, of which {len(good)} succeed"
    if len(numbers) < bank.num_scenes:
        counted = f"{len(numbers)} of {bank.num_scenes} so far, of which {len(good)} succeed"
    return counted, (good or numbers)[:_SCENES]


def _labelled_sheet(objects: Sequence[ObjectAsset]) -> Image.Image:
    from PIL import Image

    from cluttergen_jax.rendering.assets import render_object
    from cluttergen_jax.rendering.gl import gl_context
    from cluttergen_jax.rendering.sheet import contact_sheet

    (width, height) = _OBJECT_SIZE
    with gl_context(width, height):
        # Lines drawn about an object, of which there are none, take the place of its collision parts.
        images = [
            render_object(each, width=width, height=height, samples=_OBJECT_SAMPLES, trails=())
            for each in objects
        ]
    captions = [
        each.name
        if each.label.replace(" ", "_").lower() in ("", each.name.lower())
        else f"{each.name} ({each.label})"
        for each in objects
    ]
    return Image.fromarray(contact_sheet(images, captions, columns=_OBJECT_COLUMNS))


def _picture_or_reason(draw: Callable[[], Image.Image], shown: Sequence[Any]) -> str:
    """A picture as HTML, or why there is none; nothing where there is nothing to show."""
    if not shown:
        return ""
    try:
        data = base64.b64encode(_png(draw())).decode()
    except ClutterGenError as error:
        return f"<p>No pictures: {html.escape(str(error))}</p>"
    return f'<br><img alt="" src="data:image/png;base64,{data}">'


def _public(text: Any) -> str:
    """A name of a pool or a support without the folders that lead to it; "" for none."""
    from cluttergen_jax.assets.pool import public_name

    return "" if text is None else public_name(str(text))


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def _options_of_render(others: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for name in inspect.signature(render).parameters if name not in others)


def _check(options: Mapping[str, Any], verb: str, allowed: Sequence[str]) -> None:
    """Refuses options that a verb does not have (ConfigError)."""
    for name in options:
        if name not in allowed:
            hint = ""
            if name in inspect.signature(render).parameters:
                hint = f"cluttergen_jax.render(..., {name}=...)"
            raise ConfigError(
                f"{verb}({name}=...)", ", ".join(allowed), hint, meant=closest(name, allowed)
            )


def _draw_one(source: Any, options: Mapping[str, Any], **products: Any) -> Image.Image:
    """The one picture that `render` makes of these."""
    from PIL import Image

    with tempfile.TemporaryDirectory() as folder:
        report = render(source, folder, **options, **products)
        for _, error in report.failures:
            raise error
        if len(report.paths) != 1:
            given = (
                f"{len(report.paths)} pictures ({', '.join(path.name for path in report.paths)})"
            )
            raise ConfigError(given, "one", "`cluttergen_jax.render` for several")
        with Image.open(report.paths[0]) as image:
            image.load()
            return image.copy()
