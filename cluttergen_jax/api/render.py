"""Pictures, films, contact sheets and measurements of scenes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from cluttergen_jax.api.text import parse_size, scene_numbers
from cluttergen_jax.config import FilmFormat, PixelOrigin, check_range
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.kept_folder import hold_folder
from cluttergen_jax.numerics import with_kept_programs
from cluttergen_jax.rendering.config import QUALITIES, CameraView, FilmConfig, Quality

if TYPE_CHECKING:
    from cluttergen_jax.generation.sources.rendering import RenderReport

_MOST_VIEWS = 10_000
_MOST_COLUMNS = 1000


@with_kept_programs
def render(
    source: str | Path,
    out: str | Path = "out/pictures",
    *,
    scenes: Sequence[int] | str | None = None,
    picture: bool = True,
    sheet: bool = False,
    turntable: bool = False,
    replay: bool = False,
    figure: bool = False,
    density: bool = False,
    depth: bool = False,
    segmentation: bool = False,
    points: bool = False,
    bop: bool = False,
    views: int = 4,
    seed: int = 0,
    split: str = "train_synt",
    pixel_origin: PixelOrigin = "center",
    size: tuple[int, int] | str | None = None,
    view: CameraView | None = None,
    whole: bool = False,
    hulls: bool = False,
    cameras: Sequence[str | Path] = (),
    quality: Quality | None = None,
    samples: int | None = None,
    film: FilmFormat = "gif",
    pace: FilmConfig | None = None,
    columns: int = 4,
) -> RenderReport:
    """Draws scenes: pictures, films, contact sheets and measurements (`cluttergen render`).

    Args:
      source: a bank; one scene of it, BANK:INDEX or BANK/scenes/000003.xml; any MJCF file with free bodies;
        or a checkpoint, whose policy then makes the scenes.
      out: the folder for what is made; files are named after the scene.
      scenes: numbers such as 0,3,7 or 0-9, or all; the first success if not given (12 of them on a
        sheet). In Python also a list.
      picture: draw a PNG of each scene.
      sheet: all scenes on one contact sheet, NAME-sheet.png, after the bank or what else the source is.
      turntable: a film once around the scene.
      replay: a film of the placement as it happened, failed attempts in red.
      figure: the closed-loop figure: an object's failed attempts ringed in red, until it is stable.
      density: where the method would put the object of the last attempt, as a heat map on the table.
      depth: a 16-bit PNG in millimetres along the optical axis (0: nothing there), and beside it a JSON file
        with the camera, the names and the poses, and all of it in an NPZ file. Depth, segmentation, points
        and bop need no OpenGL; without any, their colours are left out.
      segmentation: an indexed PNG: 0 floor or nothing, 1 support, 2 + k object k; and the same two files.
      points: a PLY point cloud of all surfaces: metres, world frame, colours, labels as above.
      bop: a dataset for pose estimation in the format of the BOP benchmark, in the folder bop: colour, depth,
        masks, poses, models. Scenes are added to one that is there; those of a second bank get the next
        numbers, and the same call resumes.
      views: pictures of each of its scenes, by cameras at random places around it.
      seed: for places of cameras that are drawn; 0 to 4294967295.
      split: folder of its scenes: train, val or test, with a kind of images after it.
      pixel_origin: of its cam_K: "center", the first pixel's middle is (0, 0), as in OpenCV; "corner", its
        corner is, as in OpenGL and in the renderer of bop_toolkit.
      size: of pictures, WIDTHxHEIGHT in pixels; 1280x960, and 640x480 for films and bop, if not given. In
        Python also a pair.
      view: from which side the scene is seen; the defaults of `CameraView` if not given.
      whole: show the whole support instead of the objects and the region alone.
      hulls: draw the collision parts instead of the surfaces.
      cameras: that see each scene, for pictures, films, depth, segmentation and bop: "free:4", "overhead",
        "side", or JSON files with cameras of your own (docs/guide/datasets.md), which go around for a
        turntable; files are named after them.
      quality: "draft" has sharp shadows, "fine" soft ones for some five times the time; fine, and draft for
        films, bop and sheets of more than a dozen, if not given.
      samples: pictures averaged into one, in place of the quality's.
      film: "gif", or "mp4" (extra video).
      pace: how fast films run; the defaults of `FilmConfig` if not given.
      columns: of the contact sheet.

    Raises:
      PoolError, BankError, AssetError: there is no such source, no such scene, or no success.
      ConfigError: a setting is out of range.
      RendererError: what is asked for has to be drawn, and nothing can be drawn on this machine.
      BankError: another process writes to `out`.
    """
    products = {
        "picture": picture,
        "sheet": sheet,
        "turntable": turntable,
        "replay": replay,
        "figure": figure,
        "density": density,
        "depth": depth,
        "segmentation": segmentation,
        "points": points,
        "bop": bop,
    }
    check_folder(out)
    if not any(products.values()):
        others = ", ".join(f"`{name}`" for name in products)
        raise ConfigError(
            "picture=False, and nothing else is asked for", f"one or more of {others}"
        )
    numbers = _numbers(scenes)
    size = parse_size(size) if isinstance(size, str) else size
    from cluttergen_jax.rendering.gl import check_importable

    check_importable()
    from cluttergen_jax.generation.sources.rendering import Rendering
    from cluttergen_jax.rendering.scene_renderer import PictureConfig
    from cluttergen_jax.sensing.camera import parse_cameras
    from cluttergen_jax.views.bop import BopConfig

    check_range("views", views, 1, _MOST_VIEWS, 4)
    check_range("seed", seed, 0, 2**32 - 1, 0)
    if pixel_origin not in get_args(PixelOrigin):
        raise ConfigError(f"pixel_origin = {pixel_origin!r}", ", ".join(get_args(PixelOrigin)))
    if quality is not None and quality not in QUALITIES:
        raise ConfigError(f"quality = {quality!r}", ", ".join(QUALITIES), "quality='draft'")
    plans = parse_cameras(cameras, size) if cameras else ()
    check_range("columns", columns, 1, _MOST_COLUMNS, 4)
    rendering = Rendering(
        frozenset(name for name, is_asked in products.items() if is_asked),
        Path(out),
        size,
        quality,
        samples,
        PictureConfig(view=view or CameraView(), whole=whole, hulls=hulls),
        film,
        pace or FilmConfig(),
        columns,
        BopConfig(views, seed, split, pixel_origin, plans or None),
        plans,
    )
    with hold_folder(Path(out)):
        return rendering.make(str(source), numbers)


def _numbers(scenes: Sequence[int] | str | None) -> Sequence[int] | Literal["all"] | None:
    """Which scenes are asked for, from text or not."""
    return (scene_numbers(scenes) or "all") if isinstance(scenes, str) else scene_numbers(scenes)
