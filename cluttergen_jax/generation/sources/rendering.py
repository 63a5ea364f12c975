"""Pictures, films, contact sheets and measurements of scenes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from cluttergen_jax.assets import ObjectAsset
from cluttergen_jax.assets.cloud import ply_of, scene_points
from cluttergen_jax.assets.doors import are_to_be_closed, with_doors_open
from cluttergen_jax.config import DoorState
from cluttergen_jax.errors import BankError, ClutterGenError, ConfigError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.generation.files import view_of
from cluttergen_jax.generation.sources import BankSource, FileSource, ScenesSource, open_source
from cluttergen_jax.placement import Replay
from cluttergen_jax.placement.doors import poses_on
from cluttergen_jax.progress import track, waiting
from cluttergen_jax.rendering import PictureConfig, contact_sheet, save_png
from cluttergen_jax.rendering.config import QUALITIES, FilmConfig, PhotoConfig, Quality
from cluttergen_jax.rendering.figure import NUM_PROPOSALS, closed_loop_figure, density_figure
from cluttergen_jax.rendering.film import check_format, replay, replay_frames, save_film, turntable
from cluttergen_jax.rendering.gl import RendererError, find_backend
from cluttergen_jax.rendering.look import PLAIN, Look, find_look
from cluttergen_jax.rendering.seat_mark import seat_mark
from cluttergen_jax.rendering.viewer.source import SceneSource
from cluttergen_jax.scene import Bank, Scene
from cluttergen_jax.scene.bank.scene import missing_text
from cluttergen_jax.sensing.camera import REALSENSE_SIZE, Camera, CameraPlan
from cluttergen_jax.views import ViewMaker
from cluttergen_jax.views.bop import BopConfig, BopScenes
from cluttergen_jax.views.images import camera_json, depth_png, npz_of, segmentation_png
from cluttergen_jax.views.inside import inside_camera
from cluttergen_jax.views.maker import SeenScene

_DRAWN = frozenset({"picture", "sheet", "turntable", "replay", "figure", "density"})
"""What is made of colours. Depth, labels and masks come from rays, point clouds from surfaces."""
# Scenes of a sheet; scenes whose objects are uploaded with those of one that is drawn.
_SHEET = 12
_AHEAD = 64

_LARGE = (1280, 960)
_SMALL = (640, 480)
_CELL = (480, 360)
_Make = Callable[[Path], Iterable[Path]]
_Failure = tuple[str, ClutterGenError]


@dataclass(frozen=True)
class RenderReport:
    """What `render` made.

    Attributes:
      paths: the files.
      failures: what could not be made, and why.
      notes: what else there is to know: what was there already, and what was left out.
    """

    paths: tuple[Path, ...]
    failures: tuple[_Failure, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Rendering:
    """What is made of scenes, and how.

    Attributes:
      products: which of the arguments of `cluttergen_jax.render` that ask for something are set.
      out: the folder for it.
      size: width and height in pixels; each product's own if None.
      quality: of pictures; each product's own if None. samples: pictures averaged into one, in its place.
      look: what is seen, and from where; its size and samples do not count.
      film: a format of films.
      pace: how fast films run.
      columns: of the contact sheet.
      bop: of a BOP dataset.
      cameras: that see each scene, in place of the look's view.
      doors: "open" shows finished scenes with those doors open that they close.
      has_view: the look's view is asked for; else it is what suits the source (`files.view_of`).
      furnished: the name or file of a look, of which what it leaves open is drawn for each scene.
      photo: what pictures of quality "photo" have besides.
    """

    products: frozenset[str]
    out: Path
    size: tuple[int, int] | None
    quality: Quality | None
    samples: int | None
    look: PictureConfig
    film: str
    pace: FilmConfig
    columns: int
    bop: BopConfig
    cameras: tuple[CameraPlan, ...] = ()
    doors: DoorState = "closed"
    has_view: bool = True
    furnished: str = PLAIN
    photo: PhotoConfig = field(default_factory=PhotoConfig)

    def make(
        self,
        source: str | Bank | Scene | Sequence[Scene],
        scenes: Sequence[int] | Literal["all"] | None,
    ) -> RenderReport:
        """Makes everything that is asked for of scenes of a source; see `open_source`, `chosen_numbers`."""
        if self._makes("turntable", "replay"):
            check_format(self.film)
        opened, own = open_source(source)
        asked: list[Bank | Scene] = []
        if isinstance(opened, BankSource):
            asked = [opened.bank]
        elif isinstance(opened, ScenesSource):
            asked = list(opened.scenes.values())
        views = {view_of(each) for each in asked}
        if self.has_view or len(views) != 1:
            return self._make_all(opened, own, scenes)
        look = replace(self.look, view=views.pop())
        return replace(self, look=look)._make_all(opened, own, scenes)

    def _make_all(
        self,
        opened: SceneSource,
        own: int | None,
        scenes: Sequence[int] | Literal["all"] | None,
    ) -> RenderReport:
        sizes = {size: self._picture(size, "draft") for size in (_LARGE, _SMALL, _CELL)}
        numbers = chosen_numbers(opened, own, scenes, _SHEET if self._makes("sheet") else 1)
        is_drawn, notes = self._can_draw()
        notes += opened.notes if isinstance(opened, FileSource) else ()
        # Beside a sheet, single pictures are drawn of scenes that are named.
        singles = self._makes("picture") and (not self._makes("sheet") or bool(scenes))
        there = set(self.out.iterdir()) if self.out.is_dir() else set[Path]()
        made: list[Path] = []
        failures: list[_Failure] = []
        with ExitStack() as stack:
            largest = np.max([plan.size for plan in self.cameras] or [_LARGE], axis=0).tolist()
            drawn = stack.enter_context(ViewMaker(self._picture(tuple(largest), "fine")))
            work = _Work(opened, singles, sizes[_SMALL], is_drawn, drawn, self.doors)
            if self._makes("bop"):
                size = self.cameras[0].size if self.cameras else REALSENSE_SIZE
                picture = self._picture(size, "draft")
                dataset = BopScenes(self.out / "bop", opened.name, self.bop, picture, is_drawn)
                work.dataset = stack.enter_context(dataset)
                work.plan(numbers)
                notes += dataset.notes
            shown = track(numbers, "bop", len(numbers), "scene") if self._makes("bop") else numbers
            for place, number in enumerate(shown):
                work.coming = tuple(numbers[place + 1 : place + 1 + _AHEAD]) if singles else ()
                failures += self._make(work, number, made)
        if self._makes("sheet"):
            # Called after its source: those of several lie in one folder.
            path = self.out / f"{_plain(opened.name)}-sheet.png"
            made.append(save_png(self._sheet(work, numbers, path.name), path))
        if replaced := there.intersection(made):
            notes += (f"replaced {len(replaced)} files of the same names that were in {self.out}",)
        return RenderReport(tuple(made), tuple(failures), notes)

    def _can_draw(self) -> tuple[bool, tuple[str, ...]]:
        """Whether there is an OpenGL, and what to say without; RendererError where a drawing is asked for."""
        if self.products == {"points"}:
            return False, ()
        if self.quality == "photo" and not self._makes("bop"):
            # Path tracing needs no OpenGL.
            return True, ()
        try:
            find_backend()
        except RendererError as error:
            drawn = self.products & _DRAWN
            others = ", ".join(sorted(self.products - _DRAWN))
            if not drawn:
                return False, (f"no colours were drawn: {error}",)
            if drawn != {"picture"} or not others:
                raise
            hint = f"picture=False, since {others} can be made without; or {error.hint}"
            raise RendererError(error.given, error.allowed, hint) from error
        return True, ()

    def _makes(self, *products: str) -> bool:
        """Whether one of them is asked for."""
        return not self.products.isdisjoint(products)

    def _picture(self, size: tuple[int, int], usual: Quality) -> PictureConfig:
        width, height = self.size or size
        quality = QUALITIES[self.quality or usual]
        samples = quality.samples
        smoothing = quality.smoothing
        if self.samples is not None:
            samples = self.samples
            smoothing = 0
        return replace(
            self.look,
            width=width,
            height=height,
            samples=samples,
            smoothing=smoothing,
            photo=self.photo if quality.is_photo else None,
        )

    def _look_of(self, number: int) -> Look | None:
        """How a scene is furnished and lit."""
        return find_look(self.furnished, self.bop.seed + number)

    def _make(self, work: _Work, number: int, made: list[Path]) -> Iterator[_Failure]:
        """Makes everything that is asked for of one scene; what cannot be made costs nothing else."""
        source = work.source
        stem = self.out / (
            f"{number:06d}" if isinstance(source, BankSource) else _stem(source, number)
        )
        attempted = None
        if self._makes("replay", "figure", "density"):
            try:
                with work.waiting_for_attempts(self._makes("density")):
                    num_proposals = NUM_PROPOSALS if self._makes("density") else 0
                    attempted = source.replay(number, num_proposals, last_only=True)
            except ClutterGenError as error:
                yield f"{stem.name}, its attempts", error
        try:
            recording = attempted or work.still(number)
        except ClutterGenError as error:
            yield stem.name, error
            return
        for ending, make in self._products(work, recording, number, attempted is not None):
            try:
                made.extend(make(_path_with(stem, ending)))
            except ClutterGenError as error:
                yield stem.name + ending, error

    def _products(
        self, work: _Work, recording: Replay, number: int, has_attempts: bool
    ) -> Iterator[tuple[str, _Make]]:
        """The endings of the files that are asked for, and how each is made."""
        look = self._look_of(number)
        large = replace(self._picture(_LARGE, "fine"), look=look)
        small = replace(work.small, look=look)
        dataset = work.dataset
        cameras: dict[str, Camera | None] = {
            f"-{plan.name}": self._camera(plan, recording, number) for plan in self.cameras
        }
        films = cameras or {"": None}
        cameras = cameras or {"": self._own_camera(recording, large)}
        for ending, camera in cameras.items() if work.singles else ():
            yield f"{ending}.png", partial(self._write_picture, work, recording, camera, look)
        if self._makes("figure") and has_attempts:
            yield (
                "-figure.png",
                lambda path: [save_png(closed_loop_figure(recording, picture=large), path)],
            )
        if self._makes("density") and has_attempts:
            yield (
                "-density.png",
                lambda path: [save_png(density_figure(recording, picture=large), path)],
            )
        for ending, camera in cameras.items() if self._makes("depth", "segmentation") else ():
            picture = (
                large
                if camera is None
                else replace(large, width=camera.width, height=camera.height)
            )
            sensed = partial(
                self._write_sensors, recording, picture=picture, is_drawn=work.is_drawn
            )
            yield f"{ending}-sensors.npz", partial(sensed, camera=camera)
        if dataset is not None:
            yield "-bop", lambda path: dataset.add(_seen_scene(recording, number))
        if self._makes("points"):
            yield "-points.ply", lambda path: [_write(path, _cloud(recording))]
        for ending, camera in films.items() if self._makes("turntable") else ():
            count = max(2, round(self.pace.fps * self.pace.seconds))
            turns = turntable(recording, self.pace, small, camera)
            yield f"{ending}-turntable.{self.film}", partial(self._write_film, turns, count)
        for ending, camera in films.items() if self._makes("replay") and has_attempts else ():
            steps = replay(recording, self.pace, small, camera)
            length = len(replay_frames(recording, self.pace))
            yield f"{ending}-replay.{self.film}", partial(self._write_film, steps, length)

    def _own_camera(self, recording: Replay, picture: PictureConfig) -> Camera | None:
        """Where it is not said from where a scene is seen; None for the picture's view."""
        if self.has_view or not are_to_be_closed(recording.support):
            return None
        poses = recording.poses[recording.placed]
        return inside_camera(_placed_objects(recording), poses, recording.support, picture)

    def _camera(self, plan: CameraPlan, recording: Replay, number: int) -> Camera:
        """Where a camera is for a scene, drawn for its number."""
        support = _seen_scene(recording, number).camera_support
        rng = np.random.default_rng([self.bop.seed, number, self.cameras.index(plan)])
        return plan.draw(support, rng)

    def _write_picture(
        self, work: _Work, recording: Replay, camera: Camera | None, look: Look | None, path: Path
    ) -> Iterator[Path]:
        yield save_png(work.draw(recording, camera, look), path)

    def _write_sensors(
        self,
        recording: Replay,
        path: Path,
        picture: PictureConfig,
        is_drawn: bool,
        camera: Camera | None,
    ) -> Iterator[Path]:
        scene = _seen_scene(recording, 0)
        if picture.photo is not None:
            picture = replace(picture, photo=PhotoConfig())
        with ViewMaker(picture, is_drawn=is_drawn) as maker:
            maker.place(scene.objects, scene.poses, scene.support)
            view = maker.see(camera)
        stem = path.with_name(path.name.removesuffix("-sensors.npz"))
        if self._makes("depth"):
            yield _write(_path_with(stem, "-depth.png"), depth_png(view.depth))
        if self._makes("segmentation"):
            yield _write(_path_with(stem, "-segmentation.png"), segmentation_png(view.label))
        told = camera_json(view.camera, scene.names, scene.poses)
        yield _write(_path_with(stem, "-camera.json"), told)
        yield _write(path, npz_of(view, scene.names, scene.poses))

    def _write_film(self, frames: Iterable[np.ndarray], count: int, path: Path) -> Iterator[Path]:
        yield save_film(track(frames, path.name, count, "frame"), path, self.pace.fps)

    def _sheet(self, work: _Work, numbers: list[int], title: str) -> np.ndarray:
        picture = self._picture(_CELL, "draft" if len(numbers) > _SHEET else "fine")
        recordings = [work.still(number) for number in numbers]
        images = []
        with ViewMaker(picture) as maker:
            for place, each in enumerate(track(recordings, title, len(recordings), "picture")):
                coming = recordings[place + 1 : place + 1 + _AHEAD]
                camera = self._own_camera(each, picture)
                look = self._look_of(numbers[place])
                images.append(_draw(maker, each, camera, partial(_objects_of, coming), look))
        captions = [
            f"{number:06d}" + ("" if recording.is_success else f" (failed: {recording.verdict})")
            for number, recording in zip(numbers, recordings, strict=True)
        ]
        return contact_sheet(images, captions, self.columns)


@dataclass
class _Work:
    """What the scenes of one call have in common.

    Attributes:
      source: of the scenes.
      singles: draw a picture of each.
      small: the picture of films.
      is_drawn: there is an OpenGL.
      maker: draws them. coming: numbers of the scenes that are drawn next.
      doors: "open" shows them with those doors open that they close.
      dataset: BOP, which the scenes are added to, if it is asked for.
      has_replayed: attempts of a scene were made again.
    """

    source: SceneSource
    singles: bool
    small: PictureConfig
    is_drawn: bool
    maker: ViewMaker
    doors: DoorState = "closed"
    coming: tuple[int, ...] = ()
    dataset: BopScenes | None = None
    has_replayed: bool = False
    _stills: dict[int, Replay] = field(default_factory=dict)

    def draw(
        self, recording: Replay, camera: Camera | None, look: Look | None = None
    ) -> np.ndarray:
        """uint8[height, width, 3]: the finished scene; None sees it as the pictures' view."""
        return _draw(self.maker, recording, camera, self._objects_coming, look)

    def _objects_coming(self) -> list[list[ObjectAsset]]:
        found = []
        for number in self.coming:
            with suppress(ClutterGenError):
                found.append(self.still(number))
        return _objects_of(found)

    def plan(self, numbers: Sequence[int]) -> None:
        """Gives the scenes their numbers in the dataset; ConfigError where one is there, seen otherwise."""
        for number in numbers:
            with suppress(ClutterGenError):
                self._stills[number] = self.source.still(number)
        for number, recording in self._stills.items():
            if self.dataset is not None:
                self.dataset.plan(_seen_scene(recording, number))

    def waiting_for_attempts(self, has_proposals: bool) -> AbstractContextManager[None]:
        """Says, at the first scene, why its attempts take long; and how long those of each take."""
        drawn = f", and {NUM_PROPOSALS} proposals for the last object" if has_proposals else ""
        reason = f"a bank keeps how scenes end{drawn}; compiled first, which takes about a minute"
        is_first = not self.has_replayed
        self.has_replayed = True
        return waiting("making attempts again", reason, None if is_first else lambda _: None)

    def still(self, number: int) -> Replay:
        """The finished scene."""
        recording = self._stills.get(number) or self.source.still(number)
        return recording if self.doors == "closed" else _with_doors_open(recording)


def _with_doors_open(recording: Replay) -> Replay:
    """A finished scene as `Scene.open_doors` has it."""
    support = with_doors_open(recording.support)
    poses = poses_on(recording.support, support, recording.objects, recording.poses)
    return replace(recording, support=support, poses=poses)


def chosen_numbers(
    source: SceneSource, own: int | None, asked: Sequence[int] | Literal["all"] | None, count: int
) -> list[int]:
    """Which scenes: those asked for, else the first `count` that stand.

    Raises:
      ConfigError: two answers to one question.
      BankError: scenes were asked for that are not there; or no scene of the bank stands.
    """
    if own is not None:
        if asked is not None:
            raise ConfigError("`scenes` beside a single scene", "one of the two")
        asked = [own]
    if asked is not None and asked != "all":
        if said := missing_text(asked, source.numbers):
            raise BankError(
                f"{source.name}: {said}", "scenes that are there", "leaving the others out"
            )
        return list(asked)
    if not isinstance(source, BankSource):
        # Scenes that were handed over are all meant; seeds have no end.
        return list(source.numbers if isinstance(source, ScenesSource) else source.numbers[:count])
    good = source.successes if asked is None else source.numbers
    if not good:
        raise BankError(
            f"{source.name}: none of its {len(source.numbers)} scenes stands",
            "`scenes` with the number of a failed one",
        )
    return list(good if asked == "all" else good[:count])


def _draw(
    maker: ViewMaker,
    recording: Replay,
    camera: Camera | None,
    coming: Callable[[], Sequence[Sequence[ObjectAsset]]],
    look: Look | None,
) -> np.ndarray:
    poses = recording.poses[recording.placed]
    maker.place(_placed_objects(recording), poses, recording.support, coming=coming, look=look)
    # A photo shows nothing that no camera sees.
    seat = "" if maker.is_photo else recording.seat
    return maker.picture(camera, seat_mark(recording.region, recording.support, seat))


def _seen_scene(recording: Replay, number: int) -> SeenScene:
    """The finished scene as writers of views take it."""
    placed = recording.placed
    return SeenScene(
        number=number,
        names=[recording.names[index] for index in placed],
        objects=_placed_objects(recording),
        poses=np.asarray(recording.poses[placed], np.float64),
        support=recording.support,
        region=recording.region,
    )


def _objects_of(recordings: Sequence[Replay]) -> list[list[ObjectAsset]]:
    return [_placed_objects(each) for each in recordings]


def _placed_objects(recording: Replay) -> list[ObjectAsset]:
    return [recording.objects[index] for index in recording.placed]


def _cloud(recording: Replay) -> bytes:
    poses = recording.poses[recording.placed]
    return ply_of(scene_points(_placed_objects(recording), poses, recording.support))


def _path_with(stem: Path, ending: str) -> Path:
    return stem.with_name(stem.name + ending)


def _stem(source: SceneSource, number: int) -> str:
    name = _plain(source.name)
    return name if len(source.numbers) == 1 else f"{name}-{number:06d}"


def _plain(name: str) -> str:
    """A name in letters that file names can have."""
    return re.sub(r"[^\w.+-]+", "-", name)


def _write(path: Path, data: bytes) -> Path:
    write_atomically(path, data)
    return path
