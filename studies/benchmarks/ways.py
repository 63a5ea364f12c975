"""Every support with every way to clutter it: success, speed, diversity, and a picture of one scene each.

Half an hour on two quiet cores; `--supports` and `--ways` take some rows, and without `--write` nothing is
written.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import tyro
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.evaluation.diversity import embed
from cluttergen_jax.judging.scene_models import by_object
from cluttergen_jax.rendering.assets import render_scene
from cluttergen_jax.rendering.sheet import contact_sheet
from studies.benchmarks.section import IMAGES, prose, report, table
from studies.measures.diversity import scene_kernel, vendi_score

SUPPORTS: dict[str, int] = {
    "table": 10,
    "round_table": 10,
    "tray": 6,
    "bin": 10,
    "tote": 15,
    "bookcase": 20,
    "rack": 12,
    "kitchen_drawer": 8,
    "dish_rack": 8,
    "steps": 8,
    "tilted_board_5": 8,
    "tilted_board_10": 8,
}
"""By name, how many objects."""
WAYS: dict[str, dict[str, Any]] = {
    "clear": {"method": "clear"},
    "drop": {"method": "drop"},
    "spread": {"method": "spread"},
    "guided": {"method": "guided"},
    "guided, resting": {"method": "guided", "poses": "resting"},
    "guided, any": {"method": "guided", "poses": "any"},
    "packed": {"method": "packed"},
    "pile": {"method": "pile"},
}
"""By name, what is asked for."""
_SEVERAL = {"bookcase", "rack", "steps"}
"""Supports of which all surfaces are used, where the way knows several."""
_ONE_SURFACE = {"pile", "packed"}
_SMALL = "width<0.2 and height<0.2"


@dataclass(frozen=True)
class Ways:
    """What is measured.

    Attributes:
      supports: names; all if empty.
      ways: names; all if empty.
      num_scenes: of each row that count; as many more are made before, while programs are compiled.
      equal: scenes of a row of which the Vendi score is.
      seed: of the first row's key; all rows have the same.
      write: put the table into reports/benchmarks.md, and the pictures beside it.
    """

    supports: tuple[str, ...] = ()
    ways: tuple[str, ...] = ()
    num_scenes: int = 24
    equal: int = 16
    seed: int = 0
    write: bool = False

    def __post_init__(self) -> None:
        for given, known in ((self.supports, SUPPORTS), (self.ways, WAYS)):
            if unknown := set(given) - known.keys():
                raise SystemExit(f"{', '.join(sorted(unknown))}: not one of {', '.join(known)}")


@dataclass(frozen=True)
class Made:
    """What came of a support and a way.

    Attributes:
      successes: of all scenes. seconds: of the process's CPU time.
      vendi: of equally many successes; None where there are fewer.
      picture: uint8[H, W, 3] of the first success; None without any.
    """

    successes: int
    seconds: float
    vendi: float | None
    picture: np.ndarray | None


def make(support: str, way: str, args: Ways) -> Made:
    """The scenes of one row.

    Raises:
      ClutterGenError: the way does not go with the support.
    """
    surface = "all" if support in _SEVERAL and way not in _ONE_SURFACE else ""
    spec = cg.SceneSpec(
        pool="all",
        objects=(_SMALL,),
        num_objects=SUPPORTS[support],
        support=support,
        surface=surface,
        **WAYS[way],
    )
    sample = cg.make_sampler(spec)
    many = jax.jit(jax.vmap(sample))
    keys = jax.random.split(jax.random.key(args.seed), 2 * args.num_scenes)
    jax.block_until_ready(many(keys[: args.num_scenes]))
    began = time.process_time()
    scenes = jax.device_get(many(keys[args.num_scenes :]))
    seconds = time.process_time() - began
    good = np.flatnonzero(scenes.is_success)
    world = sample.problem.world
    vendi = None
    picture = None
    if len(good) >= args.equal:
        some = good[: args.equal]
        rows = (scenes.object_index[some], scenes.is_placed[some], scenes.poses[some])
        poses, is_placed, _ = by_object(*rows, len(world.objects))
        region = world.support.region
        vectors = embed(world.objects, poses, is_placed, region, world.support.top)
        vendi = vendi_score(scene_kernel(vectors, region))
    if len(good):
        scene = sample.scene(scenes, int(good[0]))
        picture = render_scene(
            scene.objects, scene.poses, scene.support, close=True, width=360, height=270, samples=24
        )
    return Made(len(good), seconds, vendi, picture)


def rows_of(args: Ways, images: dict[str, np.ndarray]) -> Iterator[list[str]]:
    """A row for each support and way; pictures are put into `images`, by caption."""
    for support in args.supports or SUPPORTS:
        for way in args.ways or WAYS:
            head = [support, way, str(SUPPORTS[support])]
            try:
                made = make(support, way, args)
            except ClutterGenError as error:
                row = [*head, f"refused: {error.given}", "-", "-"]
            else:
                rate = made.successes / made.seconds
                vendi = "-" if made.vendi is None else f"{made.vendi:.1f}"
                row = [*head, f"{made.successes} of {args.num_scenes}", f"{rate:.1f}", vendi]
                if made.picture is not None:
                    images[f"{support}: {way}"] = made.picture
            print(row, file=sys.stderr, flush=True)
            yield row


def main(args: Ways) -> None:
    """Prints the table."""
    images: dict[str, np.ndarray] = {}
    rows = list(rows_of(args, images))
    text = prose(f"""
        Objects of all pools that are narrower and lower than 20 cm, five attempts an object or the method's
        own number; {args.num_scenes} scenes a row after as many that were made while programs were compiled.
        Vendi score of {args.equal} successes each: {args.equal} were all scenes without any likeness.
    """)
    header = ["support", "way", "objects", "success", "scenes per CPU-second", "Vendi score"]
    picture = "\n\n![A scene of each](images/ways.png)" if args.write else ""
    if args.write and images:
        sheet = contact_sheet(list(images.values()), list(images), columns=min(8, len(images)))
        small = Image.fromarray(sheet).reduce(2)
        small.quantize(256, dither=Image.Dither.NONE).save(IMAGES / "ways.png", optimize=True)
    report(
        "ways",
        f"## Every support, every way\n\n{text}\n\n{table(header, rows)}{picture}",
        write=args.write,
    )


if __name__ == "__main__":
    main(tyro.cli(Ways))
