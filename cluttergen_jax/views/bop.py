"""Scenes as a dataset in the format of the BOP benchmark for 6D object pose estimation.

Format: github.com/thodan/bop_toolkit, docs/bop_datasets_format.md; what counts as visible is read from
labels, exactly, and not estimated from depth.

    camera.json, dataset_info.md   the camera, and what all of it means
    models/                        surfaces, their sizes, symmetries and sources
    SPLIT/NNNNNN/                  one scene: images, poses, and origin.json, which says which it is
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.shading import shade
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support_file import support_hash
from cluttergen_jax.config import PixelOrigin, Variation
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import folder_whole, remove_partial, write_atomically
from cluttergen_jax.geometry import rotation_matrix
from cluttergen_jax.kept_folder import FolderLock
from cluttergen_jax.rendering.look import PLAIN, find_look, look_record
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.rendering.variation import TEXTURES_OF
from cluttergen_jax.schema import SchemaError, convert, parse_json
from cluttergen_jax.sensing import Camera, CameraPlan, Instance, View, free, realsense_focal
from cluttergen_jax.views.images import depth_png, png_of
from cluttergen_jax.views.maker import SeenScene, ViewMaker

SPLIT = "train_synt"
"""Training images, synthetic."""
CAMERA = "camera.json"
ORIGIN = "origin.json"
"""Beside the files of each scene."""
DEPTH_SCALE = 0.1
"""Millimetres of one step of a depth image."""
_SPLIT_NAME = re.compile(r"(train|val|test)(_[A-Za-z0-9][A-Za-z0-9_-]*)?")
_NUMBER = re.compile(r"\d{6,}")
_HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
_DIGITS = 6
_VARIED = 13


@dataclass(frozen=True)
class BopConfig:
    """How scenes are seen in a dataset, and where they go.

    Attributes:
      views: cameras that look at each scene; seed: of where they stand.
      split: the folder of the scenes in the dataset.
      pixel_origin: see `BopDataset`.
      cameras: those that look at each scene; None for `views` of them at places that are drawn.
      vary: what is drawn anew for each view (`config.Variation`).
      look: the name or file of a look, of which what it leaves open is drawn for each scene.
    """

    views: int = 4
    seed: int = 0
    split: str = SPLIT
    pixel_origin: PixelOrigin = "center"
    cameras: tuple[CameraPlan, ...] | None = None
    vary: tuple[Variation, ...] = ()
    look: str = PLAIN


class BopScenes:
    """Holds a dataset against other writers while scenes are added to it.

    Args:
      folder: the dataset's, there or not.
      source: what to call the bank.
      picture: size, samples and look.
      is_drawn: draw colours.

    Raises:
      BankError: another process is writing the dataset.
      ConfigError: no name of a split, scenes of unknown origin in it, or a dataset of another camera.
    """

    def __init__(
        self, folder: Path, source: str, config: BopConfig, picture: PictureConfig, is_drawn: bool
    ) -> None:
        self._config = config
        self._picture = picture
        self._is_drawn = is_drawn
        self._source = source
        self._dataset = BopDataset(folder, config.split, config.pixel_origin)
        self._split = BopSplit(folder, config.split)
        self._places: dict[int, tuple[Place, SceneOrigin]] = {}
        # The same objects and support come in many scenes.
        self._hash = lru_cache(maxsize=None)(object_hash)
        self._support_hash = lru_cache(maxsize=None)(support_hash)
        self._check_camera()

    def __enter__(self) -> BopScenes:
        folder = self._dataset.folder
        folder.mkdir(parents=True, exist_ok=True)
        # What another process has begun between our looking at it and our holding it.
        self._lock = FolderLock(folder, check=self._check_camera)
        if self._split.folder.is_dir():
            remove_partial(self._split.folder)
        # What another process has added between our reading it and our holding it.
        self._split = BopSplit(folder, self._config.split)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._lock.release()

    def plan(self, scene: SeenScene) -> None:
        """Gives a scene of the bank its number in the dataset, before any is drawn.

        Raises:
          ConfigError: it is there, seen otherwise.
        """
        origin = self._origin(scene)
        self._places[scene.number] = self._split.place(origin), origin

    @property
    def notes(self) -> tuple[str, ...]:
        """What to say of scenes that need not be drawn."""
        num_there = sum(place.is_there for place, _ in self._places.values())
        if not num_there:
            return ()
        return (f"{num_there} of {len(self._places)} scenes are in {self._split.folder} already",)

    def add(self, scene: SeenScene) -> list[Path]:
        """Adds a planned scene, seen from places drawn for its number; the folder, unless it is there.

        Raises:
          RendererError: colours are wanted, and nothing here can draw.
        """
        place, origin = self._places[scene.number]
        if place.is_there:
            return []
        # A scene's light and shadows are its own, so that it looks alike whatever else is added.
        config = self._config
        with ViewMaker(self._picture, is_drawn=self._is_drawn, vary=config.vary) as maker:
            look = find_look(config.look, config.seed + scene.number)
            maker.place(scene.objects, scene.poses, scene.support, look=look)
            views = self._views(maker, scene)
            return [self._dataset.add(place.number, scene, views, origin)]

    def _views(self, maker: ViewMaker, scene: SeenScene) -> Iterator[View]:
        config = self._config
        for place, camera in enumerate(self._cameras(scene)):
            if config.vary:
                rng = np.random.default_rng([config.seed, scene.number, place, _VARIED])
                maker.dress(rng, TEXTURES_OF[config.split.partition("_")[0]])
            yield maker.see(camera, has_instances=True)

    def _cameras(self, scene: SeenScene) -> list[Camera]:
        config = self._config
        support = scene.camera_support
        size = (self._picture.width, self._picture.height)
        rng = np.random.default_rng([config.seed, scene.number])
        if config.cameras is not None:
            return [plan.draw(support, rng) for plan in config.cameras]
        focal = realsense_focal(size[0])
        return [free(support, rng, *size, focal) for _ in range(config.views)]

    def _origin(self, scene: SeenScene) -> SceneOrigin:
        what = {
            "number": scene.number,
            "objects": [self._hash(asset) for asset in scene.objects],
            "poses": scene.poses.tolist(),
            "support": self._support_hash(scene.support),
            "region": asdict(scene.region),
        }
        digest = hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()
        config = self._config
        picture = self._picture
        settings: dict[str, int | bool | str] = {
            "views": config.views,
            "seed": config.seed,
            "size": f"{picture.width}x{picture.height}",
            "samples": picture.samples,
            "hulls": picture.hulls,
            "pixel_origin": config.pixel_origin,
            "smoothing": picture.smoothing,
        }
        if config.cameras is not None:
            names = ", ".join(plan.name for plan in config.cameras)
            plans = hashlib.sha256(repr(config.cameras).encode()).hexdigest()
            settings["cameras"] = f"{names} ({plans[:8]})"
        if config.vary:
            settings["vary"] = ", ".join(sorted(config.vary))
        settings |= look_record(config.look)
        if picture.photo is not None:
            settings["quality"] = "photo"
        return SceneOrigin(self._source, scene.number, digest, settings, self._is_drawn)

    def _check_camera(self) -> None:
        """One dataset, one camera: its camera.json says which."""
        path = self._dataset.folder / CAMERA
        cameras = self._config.cameras
        if cameras is not None and len({plan.size for plan in cameras}) > 1:
            raise ConfigError(
                "cameras of different sizes in a BOP dataset",
                "pictures of one size",
                "`size` for all of them",
            )
        # Cameras of one's own may differ in what they see; each view's intrinsics are beside it.
        if cameras is not None or not path.is_file():
            return
        size = (self._picture.width, self._picture.height)
        any_camera = Camera.looking(np.zeros(3), np.ones(3), *size, realsense_focal(size[0]))
        asked = self._dataset.sensor(any_camera)
        there = json.loads(path.read_bytes())
        if differing := [name for name, value in asked.items() if there.get(name) != value]:
            had = ", ".join(f"{name} {there.get(name)}" for name in differing)
            wanted = ", ".join(f"{name} {asked[name]}" for name in differing)
            raise ConfigError(
                f"{path} says {had}, and asked for is {wanted}",
                "one `size` and one `pixel_origin` in a dataset",
                "those of the dataset, or another `out`",
            )


@dataclass(frozen=True)
class BopDataset:
    """A dataset in a folder, which may hold scenes already.

    Attributes:
      folder: where it lies; models keep the numbers that they have there.
      split: the folder of the scenes in it.
      pixel_origin: where the first pixel's (0, 0) is by `cam_K`: "center", in its middle, as OpenCV has it;
        "corner", as OpenGL has it.
    """

    folder: Path
    split: str = SPLIT
    pixel_origin: PixelOrigin = "center"

    def add(
        self,
        number: int,
        scene: SeenScene,
        views: Iterable[View],
        origin: SceneOrigin | None = None,
    ) -> Path:
        """Writes one scene, whole or not at all; returns its folder.

        Args:
          number: the scene's; one of that number is replaced.
          views: of it, one or more of one size, with instances.
          origin: which scene it is, stored beside it.

        Raises:
          ConfigError: another model of an object's name is in the dataset.
        """
        ids = add_models(self.folder, scene.objects)
        folder = self.folder / self.split / f"{number:06d}"
        cameras: dict[int, Any] = {}
        truths: dict[int, Any] = {}
        infos: dict[int, Any] = {}
        with folder_whole(folder) as fresh:
            for place, view in enumerate(views):
                _write_images(fresh, place, view)
                camera = view.camera
                turn = camera.rotation.T
                cameras[place] = {
                    "cam_K": self._intrinsics(camera).ravel().tolist(),
                    "depth_scale": DEPTH_SCALE,
                    "cam_R_w2c": turn.ravel().tolist(),
                    "cam_t_w2c": (-1000 * turn @ camera.eye).tolist(),
                }
                truths[place] = [
                    {
                        "obj_id": ids[asset.name],
                        "cam_R_m2c": (turn @ rotation_matrix(pose[3:])).ravel().tolist(),
                        "cam_t_m2c": (1000 * turn @ (pose[:3] - camera.eye)).tolist(),
                    }
                    for asset, pose in zip(scene.objects, scene.poses, strict=True)
                ]
                is_valid = np.isfinite(view.depth)
                infos[place] = [_info_record(each, is_valid) for each in view.instances]
                if place == 0:
                    sensor = self.sensor(camera)
            records = {"scene_camera": cameras, "scene_gt": truths, "scene_gt_info": infos}
            for name, record in records.items():
                write_atomically(fresh / f"{name}.json", lines(record))
            if origin is not None:
                write_atomically(fresh / ORIGIN, origin.to_json())
        write_atomically(self.folder / CAMERA, lines(sensor))
        write_atomically(self.folder / "dataset_info.md", _info(self.pixel_origin).encode())
        return folder

    def sensor(self, camera: Camera) -> dict[str, float]:
        """What camera.json says of a camera."""
        K = self._intrinsics(camera)
        size = {"width": camera.width, "height": camera.height, "depth_scale": DEPTH_SCALE}
        return {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], **size}

    def _intrinsics(self, camera: Camera) -> np.ndarray:
        """f64[3, 3]: `Camera.K` itself has its origin in the first pixel's corner."""
        return camera.K - _HALF if self.pixel_origin == "center" else camera.K


def _write_images(folder: Path, place: int, view: View) -> None:
    """The images of the view of that number."""
    if view.rgb is not None:
        write_atomically(folder / "rgb" / f"{place:06d}.png", png_of(view.rgb))
    depth = depth_png(view.depth, DEPTH_SCALE / 1000)
    write_atomically(folder / "depth" / f"{place:06d}.png", depth)
    for index, instance in enumerate(view.instances):
        for name, mask in (("mask", instance.mask), ("mask_visib", instance.visible)):
            file = folder / name / f"{place:06d}_{index:06d}.png"
            write_atomically(file, png_of(mask.astype(np.uint8) * 255))


def _info_record(instance: Instance, is_valid: np.ndarray) -> dict[str, object]:
    """As bop_toolkit's calc_gt_info has it: boxes are x, y, width, height; all -1 if nothing is seen."""
    whole = visible = [-1, -1, -1, -1]
    if instance.visible.any() and instance.box is not None:
        rows, columns = np.nonzero(instance.visible)
        visible = _box(int(columns.min()), int(columns.max()), int(rows.min()), int(rows.max()))
        whole = _box(*instance.box)
    return {
        "bbox_obj": whole,
        "bbox_visib": visible,
        "px_count_all": instance.num_pixels,
        "px_count_valid": int((instance.mask & is_valid).sum()),
        "px_count_visib": int(instance.visible.sum()),
        "visib_fract": instance.visible_share,
    }


def _box(left: int, right: int, upper: int, lower: int) -> list[int]:
    return [left, upper, right - left, lower - upper]


_MEANT = {
    "center": """the middle of the first pixel, as OpenCV, BlenderProc and the functions of bop_toolkit
  that turn depth into distance have it. bop_toolkit's own renderer has (0, 0) in that pixel's upper left
  corner: add 0.5 to cx and cy for it.""",
    "corner": """the upper left corner of the first pixel, as OpenGL and bop_toolkit's own renderer have it.
  OpenCV has (0, 0) in that pixel's middle: subtract 0.5 from cx and cy for it.""",
}


def _info(pixel_origin: PixelOrigin) -> str:
    return f"""# Synthetic scenes in BOP format

Made by `cluttergen render --bop`. Format: docs/bop_datasets_format.md of bop_toolkit.

- `SPLIT/NNNNNN`: one scene, its images seen by different cameras. `rgb` is drawn with OpenGL, and missing
  where there was none; `depth`, `mask` and `mask_visib` by casting a ray through every pixel's middle,
  without noise.
- `{ORIGIN}` in its folder: the bank and the scene in it, a digest of what stands where, and how it was seen.
- Depth images: {DEPTH_SCALE} mm a step (`depth_scale`), along the optical axis; 0: nothing, or beyond 6.5 m.
- `cam_K`: pixel coordinates (0, 0) are {_MEANT[pixel_origin]}
  World: z up, millimetres.
- `mask_visib` is where the object is seen, exactly; `visib_fract` is its share of the whole silhouette, that
  beyond the picture's edge (by up to a picture) included.
- `models`: surfaces in millimetres. The origin is the middle of the bounding box of the *collision parts*, z
  is up in the pose in which the object rests. `models_info.json` names each object, its source and its
  licence.
- Symmetries: of bodies of revolution (`symmetries_continuous`) and of boxes, prisms and the like
  (`symmetries_discrete`), colours included, to within 5 mm or 4 % of the object's size.
"""


def add_models(folder: Path, objects: Sequence[ObjectAsset]) -> dict[str, int]:
    """The number of each object's model in a dataset, by name; models that are new to it are written.

    Raises:
      ConfigError: another model of an object's name is there.
    """
    path = folder / "models" / "models_info.json"
    infos = json.loads(path.read_bytes()) if path.exists() else {}
    ids = {info["name"]: int(key) for key, info in infos.items()}
    new: dict[int, ObjectAsset] = {}
    for asset in sorted({each.name: each for each in objects}.values(), key=lambda each: each.name):
        key = ids.setdefault(asset.name, len(ids) + 1)
        if (known := infos.get(str(key))) is None:
            new[key] = asset
            pieces = asset.drawn_pieces
            extent = _extent(np.concatenate([piece.mesh.vertices for piece in pieces]) * 1000)
            source = {"name": asset.name, "label": asset.label, **asset.provenance.record()}
            infos[str(key)] = source | {"hash": object_hash(asset)} | extent | _symmetries(pieces)
        elif known["hash"] != object_hash(asset):
            raise ConfigError(
                f"{folder}: another model of the name {asset.name!r} is there",
                "objects of one pool in one dataset",
                "another folder",
            )
    for key, asset in new.items():
        write_atomically(path.with_name(f"obj_{key:06d}.ply"), model_ply(asset))
    write_atomically(path, lines(infos))
    return ids


def model_ply(asset: ObjectAsset) -> bytes:
    """The surfaces as one ASCII PLY: millimetres, object frame, normals and colours at the vertices."""
    rows = []
    faces = []
    count = 0
    for piece in asset.drawn_pieces:
        surface = shade(piece.mesh, piece.uv)
        colour = np.tile(np.array(piece.rgba[:3]), (len(surface.vertices), 1))
        if piece.texture is not None and surface.uv is not None:
            colour = colour * piece.texture.at(surface.uv)
        rows.append(np.hstack([surface.vertices * 1000.0, surface.normals, np.round(255 * colour)]))
        faces.append(surface.faces.astype(np.int64) + count)
        count += len(surface.vertices)
    buffer = io.StringIO()
    header = ["ply", "format ascii 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header += [
        f"element face {sum(map(len, faces))}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    buffer.write("\n".join(header) + "\n")
    np.savetxt(buffer, np.concatenate(rows), fmt=["%.5f"] * 6 + ["%d"] * 3)
    triangles = np.concatenate(faces)
    np.savetxt(buffer, np.column_stack([np.full(len(triangles), 3), triangles]), fmt="%d")
    return buffer.getvalue().encode()


def _extent(vertices: np.ndarray) -> dict[str, float]:
    """Bounding box and diameter, the largest distance between two vertices f[V, 3]; millimetres."""
    from scipy.spatial import ConvexHull
    from scipy.spatial.distance import pdist

    low = vertices.min(0)
    high = vertices.max(0)
    corners = vertices[ConvexHull(vertices).vertices]
    record = {"diameter": float(pdist(corners).max())}
    record |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    return record | {
        f"size_{axis}": float(value) for axis, value in zip("xyz", high - low, strict=True)
    }


def _symmetries(pieces: Sequence[Piece]) -> dict[str, list]:
    """What BOP states of an object that looks the same in several poses, millimetres; nothing of others."""
    # It loads trimesh, which other datasets do without.
    from cluttergen_jax.assets.symmetry import symmetries_of

    found = symmetries_of(pieces)
    record: dict[str, list] = {}
    if len(found.axes):
        point = _plain(1000 * found.point)
        record["symmetries_continuous"] = [
            {"axis": _plain(axis), "offset": point} for axis in found.axes
        ]
    if len(found.motions):
        scaled = found.motions * [[1.0, 1.0, 1.0, 1000.0]]
        record["symmetries_discrete"] = [_plain(motion) for motion in scaled]
    return record


def _plain(values: np.ndarray) -> list[float]:
    """Numbers row by row; no zero is negative."""
    return (np.round(values, _DIGITS) + 0.0).ravel().tolist()


def lines(record: Mapping[Any, Any]) -> bytes:
    """JSON with a line for each entry."""
    entries = [f"  {json.dumps(str(key))}: {json.dumps(value)}" for key, value in record.items()]
    return ("{\n" + ",\n".join(entries) + "\n}\n").encode()


@dataclass(frozen=True)
class SceneOrigin:
    """Which scene one of a dataset is, and how it is seen.

    Attributes:
      source: the name of the bank; scene: its number there.
      digest: of its objects, their poses, the support and the region, whatever its bank is called.
      settings: of its views.
      has_colour: whether its colours were drawn.
    """

    source: str
    scene: int
    digest: str
    settings: Mapping[str, int | bool | str]
    has_colour: bool

    def to_json(self) -> bytes:
        """As it stands in the file."""
        return json.dumps({"format": 1, **asdict(self)}, indent=1).encode() + b"\n"


@dataclass(frozen=True)
class Place:
    """Where a scene goes.

    Attributes:
      number: the scene's in the split.
      is_there: whether it is there as it was asked for, and need not be made.
    """

    number: int
    is_there: bool


class BopSplit:
    """What a split holds; it is read once, and remembers the places that it has given.

    Args:
      folder: of the dataset; split: by name.

    Raises:
      ConfigError: no name of a split, or scenes are there that do not say where they are from.
    """

    def __init__(self, folder: Path, split: str) -> None:
        if not _SPLIT_NAME.fullmatch(split):
            raise ConfigError(
                f"split = {split!r}",
                "train, val or test, alone or with a kind of images after it, as in train_synt",
                f"split={SPLIT!r}",
            )
        self.folder = folder / split
        self._by_digest: dict[str, tuple[int, SceneOrigin]] = {}
        self._taken: set[int] = set()
        self._first = ""
        folders = sorted(self.folder.glob("*")) if self.folder.is_dir() else []
        for scene in folders:
            if _NUMBER.fullmatch(scene.name):
                self._keep(int(scene.name), _read_origin(scene))

    def place(self, origin: SceneOrigin) -> Place:
        """The number of a scene: that which it has here; else its own if the split begins with scenes of
        the same bank and it is free; else the next after the highest.

        Raises:
          ConfigError: the scene is here, seen otherwise.
        """
        if known := self._by_digest.get(origin.digest):
            number, there = known
            _check_alike(self.folder, number, there, origin)
            return Place(number, there.has_colour or not origin.has_colour)
        is_free = (
            origin.source == (self._first or origin.source) and origin.scene not in self._taken
        )
        number = origin.scene if is_free else max(self._taken) + 1
        self._keep(number, origin)
        return Place(number, False)

    def _keep(self, number: int, origin: SceneOrigin) -> None:
        self._taken.add(number)
        self._by_digest[origin.digest] = (number, origin)
        self._first = self._first or origin.source


def _read_origin(scene: Path) -> SceneOrigin:
    try:
        return convert(parse_json((scene / ORIGIN).read_bytes()), SceneOrigin)
    except (OSError, SchemaError) as error:
        raise ConfigError(
            f"{scene} does not say which scene it is: {ORIGIN} is missing or damaged",
            "scenes that `render` or `dataset` has added",
            "another `split`, or another `out`",
        ) from error


def _check_alike(folder: Path, number: int, there: SceneOrigin, asked: SceneOrigin) -> None:
    """Refuses a scene that is there and was seen otherwise."""
    names = dict.fromkeys([*asked.settings, *there.settings])
    differing = [name for name in names if there.settings.get(name) != asked.settings.get(name)]
    if differing:
        wanted = ", ".join(f"{name} {asked.settings.get(name)}" for name in differing)
        had = ", ".join(f"{name} {there.settings.get(name)}" for name in differing)
        raise ConfigError(
            f"scene {asked.scene} of {asked.source} is in {folder} as {number:06d} with {had}, and is asked "
            f"for with {wanted}",
            "each scene once in a split",
            "the same settings, which resumes; another `split`, or another `out`",
        )
