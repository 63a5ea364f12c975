"""Scenes to look at: pictures and films, datasets of views, and viewers."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from cluttergen_jax.api.text import parse_size, scene_numbers
from cluttergen_jax.config import (
    DatasetForm,
    DoorState,
    FilmFormat,
    Method,
    PixelOrigin,
    Variation,
    check_range,
    no_such,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.kept_folder import hold_folder
from cluttergen_jax.numerics import with_kept_programs, with_own_settings
from cluttergen_jax.rendering.config import QUALITIES, CameraView, FilmConfig, PhotoConfig, Quality
from cluttergen_jax.spec import in_groups

if TYPE_CHECKING:
    from cluttergen_jax.generation.sources.rendering import RenderReport
    from cluttergen_jax.rendering.viewer.viewer import Viewer
    from cluttergen_jax.scene import Bank, Scene
    from cluttergen_jax.views.dataset import ViewDataset

_MOST_VIEWS = 10_000
_MOST_COLUMNS = 1000
_SPLITS = ("train", "val", "test")


@with_kept_programs
@in_groups(
    what="scenes picture sheet turntable replay figure density depth segmentation points bop",
    where="view whole doors cameras",
    how_many="views samples seed columns",
    files="out split film",
)
def render(
    source: str | Path | Scene | Bank | Sequence[Scene],
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
    doors: DoorState = "closed",
    cameras: Sequence[str | Path] = (),
    quality: Quality | None = None,
    samples: int | None = None,
    look: str | Path = "studio",
    transparent: bool = False,
    background: str | Path | None = None,
    depth_of_field: float | None = None,
    film: FilmFormat = "gif",
    pace: FilmConfig | None = None,
    columns: int = 4,
) -> RenderReport:
    """Draws scenes: pictures, films, contact sheets and measurements (`cluttergen render`).

    Args:
      source: a bank; one scene of it, BANK:INDEX or BANK/scenes/000003.xml; any MJCF file with free bodies;
        or a checkpoint, whose policy then makes the scenes. In Python also a `Bank`, a `Scene`, or several.
      out: the folder for what is made; files are named after the scene.
      scenes: numbers such as 0,3,7 or 0-9, or all; the first success if not given (12 of them on a
        sheet). In Python also a list.
      picture: draw a PNG of each scene.
      sheet: all scenes on one contact sheet, NAME-sheet.png, after the bank or what else the source is.
      turntable: a film once around the scene.
      replay: a film of the placement as it happened, failed attempts in red.
      figure: the closed-loop figure: an object's failed attempts ringed in red, until it is stable.
      density: where the method would put the object of the last attempt, as a heat map on the table; some 20
        seconds of two cores, as the attempts are made again first.
      depth: a 16-bit PNG in millimetres along the optical axis (0: nothing there), and beside it a JSON file
        with the camera, the names and the poses, and all of it in an NPZ file. Depth, segmentation, points
        and bop need no OpenGL; without any, their colours are left out.
      segmentation: an indexed PNG: 0 floor or nothing, 1 support, 2 + k object k; and the same two files.
      points: a PLY point cloud of all surfaces: metres, world frame, colours, labels as above.
      bop: a dataset for pose estimation in the format of the BOP benchmark, in the folder bop: colour, depth,
        masks, poses, models. Scenes are added to one that is there; those of a second bank get the next
        numbers, and the same call resumes.
      views: pictures of each of its scenes, by cameras at random places around it.
      seed: for places of cameras and what looks leave open; 0 to 4294967295.
      split: folder of its scenes: train, val or test, with a kind of images after it.
      pixel_origin: of its cam_K: "center", the first pixel's middle is (0, 0), as in OpenCV; "corner", its
        corner is, as in OpenGL and in the renderer of bop_toolkit.
      size: of pictures, WIDTHxHEIGHT in pixels; 1280x960, and 640x480 for films and bop, if not given. In
        Python also a pair.
      view: from which side the scene is seen; if not given, the defaults of `CameraView`; of a bank with
        relations of left, right, front and back the side that they are meant from; of open doors the place
        before them that sees most of the objects.
      whole: show the whole support instead of the objects and the region alone.
      hulls: draw the collision parts instead of the surfaces.
      doors: "open" shows scenes that close doors with these open; what is in drawers is seen with them.
      cameras: that see each scene, for pictures, films, depth, segmentation and bop: "free:4", "overhead",
        "side", or JSON files with cameras of your own (docs/guide/datasets.md), which go around for a
        turntable; files are named after them.
      quality: "draft" has sharp shadows, "fine" soft ones for some five times the time; fine, and draft for
        films, bop and sheets of more than a dozen, if not given. "photo" traces paths of light (extra
        `photo`), which takes some 50 CPU-seconds a picture.
      samples: pictures averaged into one, or paths of each pixel of a photo, in place of the quality's.
      look: how scenes are furnished and lit: a name such as "kitchen_day", "random" for any, "plain" for the
        support's own colours on a grey floor, or a YAML file (docs/reference/looks.md). Where a look leaves
        something open, it is drawn for each scene from `seed`. bop is always plain.
      transparent: of photos: floor, walls and sky are left out, and are clear in the PNG; through glass they
        are not.
      background: of photos: what is there instead, a colour such as white or #f2efe8, or an image's file.
      depth_of_field: of photos: the f-number of the lens, such as 2.8; all is sharp if not given.
      film: "gif", or "mp4" (extra video).
      pace: how fast films run; the defaults of `FilmConfig` if not given.
      columns: of the contact sheet.

    Raises:
      PoolError, BankError, AssetError: there is no such source, no such scene, or no success.
      ConfigError: a setting is out of range, or `source` is nothing of the kind.
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
    from cluttergen_jax.rendering.look import find_look
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
    find_look(look)
    if background is not None and not str(background):
        raise ConfigError("background = ''", "a colour or the file of an image", "white")
    photo = PhotoConfig(transparent, str(background or ""), depth_of_field)
    if photo != PhotoConfig() and quality != "photo":
        raise ConfigError(
            f"transparent, background or depth_of_field with quality {quality or 'fine'!r}",
            "quality 'photo'",
            "quality='photo'",
        )
    if transparent and (turntable or replay):
        raise ConfigError("a film that is transparent", "pictures", "background='white'")
    if quality == "photo":
        from cluttergen_jax.rendering.photo import check_photo

        check_photo(photo)
        if density:
            raise ConfigError(
                "density with quality 'photo'", "'draft' or 'fine'", "quality='fine' for it"
            )
    check_range("columns", columns, 1, _MOST_COLUMNS, 4)
    if doors not in get_args(DoorState):
        raise no_such("doors", doors, get_args(DoorState))
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
        doors,
        has_view=view is not None,
        furnished=str(look),
        photo=photo,
    )
    with hold_folder(Path(out)):
        return rendering.make(str(source) if isinstance(source, Path) else source, numbers)


def _numbers(scenes: Sequence[int] | str | None) -> Sequence[int] | Literal["all"] | None:
    """Which scenes are asked for, from text or not."""
    return (scene_numbers(scenes) or "all") if isinstance(scenes, str) else scene_numbers(scenes)


@with_own_settings
@in_groups(
    where="cameras",
    how_many="num_scenes seed",
    files="out form splits",
    machine="cluster workers",
)
def make_dataset(
    banks: Sequence[str | Path | Bank] | str | Path | Bank,
    out: str | Path = "dataset",
    *,
    cameras: Sequence[str | Path] = ("free:4",),
    size: tuple[int, int] | str | None = None,
    form: DatasetForm = "parquet",
    splits: str = "train",
    num_scenes: int | None = None,
    vary: Sequence[Variation] = (),
    quality: Quality = "draft",
    look: str | Path = "plain",
    colour: bool = True,
    seed: int = 0,
    cluster: str | None = None,
    workers: int = 0,
) -> ViewDataset:
    """Makes what cameras see of every scene that stands (`cluttergen dataset`).

    A view has colour, depth, labels, each object's whole silhouette and visible share, boxes, poses, and the
    camera. The same call takes up an interrupted one.

    Args:
      banks: a bank's folder, or several. In Python also a `Bank`, or several.
      out: the folder.
      cameras: "free", "overhead" or "side", "free:4" for four that are drawn for each scene, or JSON files
        with cameras of your own, fixed or drawn from ranges (docs/guide/datasets.md).
      size: of all pictures, WIDTHxHEIGHT in pixels; 640x480, or a file's own, if not given. In Python also a
        pair.
      form: "parquet"; "webdataset", tar files; "bop", a folder for each scene; "coco", instances and images
        (extra `coco`); "yolo" or "yolo-seg", boxes or outlines and images as Ultralytics reads them. Printed,
        the dataset tells what its form holds and what it does not.
      splits: "train", or shares of all scenes such as "train=0.8, val=0.1, test=0.1", to the nearest
        scene. `seed` draws which; scenes of a dataset that grows stay where they are.
      num_scenes: the first so many of each bank; all if not given.
      vary: what is drawn anew for each view: "texture" of the table, from other ones for each split; "light";
        "colour" of objects and floor.
      quality: "draft" has sharp shadows; "fine" soft ones, for some ten times the time; "photo" traces paths
        of light (extra `photo`), for some hundred times the time.
      look: how scenes are furnished and lit: a name, "random" for any, or a YAML file
        (docs/reference/looks.md). Where a look leaves something open, it is drawn for each scene.
      colour: draw colours, which needs OpenGL, or for photos none; all else needs none.
      seed: of cameras, splits and what varies, 0 to 4294967295.
      cluster: where it is made: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`); none with "bop". All machines have to see banks and
        `out` under the same path. In this process if not given.
      workers: worker processes on the cluster; 0 takes as many as it has room for.

    Returns:
      The dataset; printed, it tells what there is.

    Raises:
      ConfigError: a setting is out of range, or there is no such camera.
      BankError: there is no bank, none of its scenes stands, or the folder holds something else.
      RendererError: colours are wanted, and nothing here can draw.
      MissingExtraError: a cluster without the extra `ray`, or "coco" without the extra `coco`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.rendering.gl import find_backend
    from cluttergen_jax.rendering.look import find_look
    from cluttergen_jax.rendering.renderer import check_size
    from cluttergen_jax.scene.bank import Bank, bank_folder
    from cluttergen_jax.sensing import parse_cameras
    from cluttergen_jax.views.dataset import ViewConfig, make

    cameras = (cameras,) if isinstance(cameras, str | Path) else cameras
    if isinstance(vary, str):
        raise ConfigError(f"vary = {vary!r}", "a sequence of words", f"vary=({vary!r},)")
    check_folder(out)
    check_range("seed", seed, 0, 2**32 - 1, 0)
    if num_scenes is not None:
        check_range("num_scenes", num_scenes, 1, 10_000_000, 100)
    for name, given, allowed in (
        ("form", form, get_args(DatasetForm)),
        ("quality", quality, tuple(QUALITIES)),
        *(("vary", each, get_args(Variation)) for each in vary),
    ):
        if given not in allowed:
            raise ConfigError(f"{name} = {given!r}", ", ".join(allowed), f"{name}={allowed[0]!r}")
    pixels = parse_size(size) if isinstance(size, str) else size
    seen_by = parse_cameras(cameras, pixels)
    for each in seen_by:
        check_size(*each.size, 1)
    find_look(look)
    if colour and quality == "photo":
        from cluttergen_jax.rendering.photo import check_photo

        check_photo(PhotoConfig())
        if "light" in vary:
            raise ConfigError(
                "vary 'light' with quality 'photo', whose light is the look's",
                "texture and colour",
                "look='random'",
            )
    elif colour:
        find_backend()
    elif vary:
        raise ConfigError(f"vary = {tuple(vary)} without colours", "colours", "colour=True")
    elif form in ("coco", "yolo", "yolo-seg"):
        raise ConfigError(
            f"form = {form!r} without colours",
            "colours: its images are what a detector sees",
            "colour=True, or form='parquet'",
        )
    if form == "bop" and cluster is not None:
        raise ConfigError(
            f"cluster = {cluster!r} with form 'bop'",
            "one of the two",
            "form='parquet' or 'webdataset'",
        )
    sources = [banks] if isinstance(banks, str | Path | Bank) else list(banks)
    if not sources:
        raise ConfigError("no bank", "one or more")
    chosen = [each.path if isinstance(each, Bank) else each for each in sources]
    folders = [bank_folder(each) for each in chosen]
    if len({each.resolve().name for each in folders}) < len(chosen):
        told = f"banks = {[str(each) for each in chosen]}"
        raise ConfigError(
            told, "each bank once, and no two folders of one name", "another name of a folder"
        )
    place = cluster_of(cluster, workers)
    config = ViewConfig(seen_by, seed, tuple(vary), quality, colour, str(look))
    return make(folders, parse_splits(splits), num_scenes, config, Path(out), form, place)


def parse_splits(text: str) -> dict[str, float]:
    """Shares by split, of a text such as "train=0.8, val=0.2" or "test".

    Raises:
      ConfigError: a split is none, comes twice, or the shares do not make 1.
    """
    shares: dict[str, float] = {}
    terms = [term.strip() for term in text.split(",")]
    for term in terms:
        match = re.fullmatch(r"(\w+)(?:\s*=\s*(0|1|0?\.\d+|1\.0*))?", term)
        is_bare = match is not None and match[2] is None and len(terms) > 1
        if match is None or match[1] not in _SPLITS or match[1] in shares or is_bare:
            raise ConfigError(
                f"splits = {text!r}",
                "one of train, val and test, or shares of them",
                "'train=0.9, test=0.1'",
            )
        shares[match[1]] = 1.0 if match[2] is None else float(match[2])
    if abs(sum(shares.values()) - 1) > 1e-6:
        raise ConfigError(
            f"splits = {text!r}, {sum(shares.values()):g} in all", "shares that make 1"
        )
    return shares


@with_kept_programs
@in_groups(
    what="pool num_objects",
    where="support",
    files="screenshots",
    machine="native host port browser",
)
def view(
    source: str | Path | Scene | Bank | Sequence[Scene] | None = None,
    *,
    pool: str | Path | None = None,
    method: Method | None = None,
    num_objects: int | None = None,
    support: str | Path | None = None,
    native: bool = False,
    host: str = "localhost",
    port: int = 8080,
    browser: bool = True,
    screenshots: str | Path = "out/screenshots",
    show: Callable[[str], None] = print,
    block: bool | None = None,
) -> Viewer | None:
    """Shows scenes in a browser until Ctrl-C, or in a window until it is closed (`cluttergen view`).

        viewer = cg.view("out", block=False)   # runs on; the last line of a cell shows it below the cell
        viewer.close()

    Args:
      source: a bank; one scene of it, BANK:INDEX or BANK/scenes/000003.xml; any MJCF file with free bodies;
        or a checkpoint, whose policy then makes the scenes. Without it, `method` makes them from `pool`.
        In Python also a `Bank`, a `Scene`, or several.
      pool: a pool's name or folder to sample from where no bank says it; a checkpoint's own if one is given.
      method: as `generate` takes it; the checkpoint's own, else "drop".
      num_objects: all of the pool's (40 at most) if not given.
      support: a support's name or folder; a checkpoint's own, else the paper's table.
      native: open MuJoCo's own viewer instead (needs a screen).
      host: the address to listen on; 0.0.0.0 lets other machines look, if they have the token.
      port: 0 takes any free one.
      browser: open a browser; not from a notebook, which shows the viewer itself.
      screenshots: the folder for screenshots.
      show: is given the lines that tell where the viewer is.
      block: wait for Ctrl-C; False returns at once, and the viewer runs until it is closed or Python ends. If
        not given, True but in a notebook.

    Returns:
      The viewer, which has its address, `url`, and `close()`; None after Ctrl-C or for a window.

    Raises:
      PoolError, BankError, AssetError: there is nothing of the kind, or it cannot be read.
      ConfigError: the port is taken, there is no such method, `source` is nothing of the kind, or `native` is
        asked not to wait.
      MissingExtraError: the extra `viewer` is not installed.
      DisplayError: there is no screen for `native`.
    """
    from cluttergen_jax.generation.sources import LiveConfig
    from cluttergen_jax.generation.sources.viewing import open_viewer, view_native, view_web

    live = LiveConfig(
        None if pool is None else str(pool),
        method,
        num_objects,
        None if support is None else str(support),
    )
    given = str(source) if isinstance(source, Path) else source
    if native:
        if block is False:
            hint = "native=False, the viewer in a browser"
            raise ConfigError(
                "block=False with native=True, a window that waits", "one of the two", hint
            )
        view_native(given, live, show)
        return None
    if block is None:
        block = not in_notebook()
    if block:
        view_web(given, live, host, port, browser, Path(screenshots), show)
        return None
    return open_viewer(
        given, live, host, port, browser and not in_notebook(), Path(screenshots), show
    )


def in_notebook() -> bool:
    """Whether a notebook runs this process: IPython with a kernel, as in Jupyter, Colab and editors."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return hasattr(shell, "kernel")
