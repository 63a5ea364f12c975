"""The files beside a bank's table: an MJCF file and a picture for every success."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import takewhile
from pathlib import Path

import numpy as np

from cluttergen_jax.assets import ObjectAsset
from cluttergen_jax.assets.support import recorded_rectangle
from cluttergen_jax.files import inside, write_atomically
from cluttergen_jax.placement.problem import ProblemConfig
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.progress import track
from cluttergen_jax.rendering import PictureConfig, contact_sheet, save_png
from cluttergen_jax.rendering.config import QUALITIES, CameraView
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.rendering.look import USUAL_LOOK, find_look
from cluttergen_jax.rendering.seat_mark import seat_mark
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.bank import Bank, BankRow
from cluttergen_jax.scene.export.mjcf import scene_xml
from cluttergen_jax.schema import digest_of
from cluttergen_jax.views import ViewMaker

_OVERVIEW = 12
_PNG_BEGINS = b"\x89PNG\r\n\x1a\n"
_PNG_ENDS = b"IEND\xaeB`\x82"
_MANY = 100
_SOFT = 10
"""Pictures averaged into one of so few."""
_AHEAD = 64
"""Scenes whose objects are uploaded with those of one that is drawn."""


def scene_path(bank: Bank, index: int, ending: str) -> Path:
    """Where scene number `index` has its file."""
    return inside(bank.path, f"scenes/{index:06d}.{ending}")


def write_files(
    bank: Bank,
    num_scenes: int,
    config: ProblemConfig,
    is_drawn: bool,
    keep_digests: Callable[[dict[str, str]], None],
) -> str:
    """Writes what is missing or damaged: MJCF files, and pictures if they are wanted and can be drawn.

    Returns:
      What was written where, for people.

    Args:
      keep_digests: is given those of the MJCF files, before anything is drawn.
    """
    first = takewhile(lambda scene: scene.index < num_scenes, bank.scenes())
    scenes = [scene for scene in first if scene.is_success]
    assets = {
        name: bank.object(name)
        for name in {base_name(n) for scene in scenes for n in scene.objects}
    }
    digests: dict[str, str] = {}
    for scene in track(scenes, "writing", len(scenes), "file"):
        digests |= write_model(
            bank, scene, [assets[base_name(name)] for name in scene.objects], config
        )
    keep_digests(digests)
    written = f"files      {len(scenes)} scenes in {bank.path / 'scenes'}"
    if not (is_drawn and scenes):
        return written
    can_draw, message = renderer_status()
    if not can_draw:
        return f"{written}\npictures   skipped: {message}"
    return f"{written}\npictures   {_draw(bank, scenes, assets)}"


def write_model(
    bank: Bank, scene: BankRow, objects: Sequence[ObjectAsset], config: ProblemConfig
) -> dict[str, str]:
    """Writes the MJCF file of a scene of these objects, if it is missing or damaged; its digest by path."""
    path = scene_path(bank, scene.index, "xml")
    text = scene_xml(objects, scene.poses, bank.support, config.stability, config.contact)
    if not path.exists() or path.read_bytes() != text:
        write_atomically(path, text)
    return {path.relative_to(bank.path).as_posix(): digest_of(text)}


def _is_whole_png(path: Path) -> bool:
    """Whether a file is there that begins and ends as a PNG does."""
    data = path.read_bytes() if path.is_file() else b""
    return data.startswith(_PNG_BEGINS) and data.endswith(_PNG_ENDS)


def view_of(asked: Bank | Scene) -> CameraView:
    """From where scenes are drawn unasked: where relations have sides, from where left and right are meant.

    That is from the region's -y side, looking along its +y.
    """
    if not asked.has_sides:
        return CameraView()
    region = asked.region or asked.support.region
    return CameraView(azimuth=90.0 + math.degrees(region.yaw))


def _draw(bank: Bank, scenes: Sequence[BankRow], assets: dict) -> Path:
    images: list[np.ndarray] = []
    draft = QUALITIES["draft"]
    is_soft = len(scenes) <= _MANY
    objects = [[assets[base_name(name)] for name in scene.objects] for scene in scenes]
    picture = PictureConfig(
        samples=_SOFT if is_soft else draft.samples,
        smoothing=0 if is_soft else draft.smoothing,
        view=view_of(bank),
        look=find_look(USUAL_LOOK),
    )
    mark = seat_mark(recorded_rectangle(bank.recipe["region"]), bank.support, bank.seat)
    with ViewMaker(picture) as maker:
        for place, scene in enumerate(track(scenes, "drawing", len(scenes), "picture")):
            path = scene_path(bank, scene.index, "png")
            if _is_whole_png(path) and len(images) >= min(_OVERVIEW, len(scenes)):
                continue
            coming = objects[place + 1 : place + 1 + _AHEAD]
            maker.place(objects[place], scene.poses, bank.support, coming=coming.copy)
            image = maker.picture(trails=mark)
            save_png(image, path)
            images.append(image)
    captions = [f"{scene.index:06d}" for scene in scenes[:_OVERVIEW]]
    overview = contact_sheet(images[:_OVERVIEW], captions, columns=4)
    return save_png(overview, bank.path / "overview.png")
