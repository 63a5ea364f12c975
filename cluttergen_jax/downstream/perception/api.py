"""Perception: views to learn from, a segmenter, and how well objects and their poses are found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cluttergen_jax.config import (
    MAX_VIEWS,
    Method,
    SegmenterInput,
    Split,
    check_noise,
    check_range,
    check_workers,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.numerics import with_own_settings

if TYPE_CHECKING:
    from cluttergen_jax.downstream.perception.evaluation.evaluate import PerceptionResult
    from cluttergen_jax.downstream.perception.views.stored import ViewSet

_MOST_SEED = 999_999
_METHODS: dict[Method, int] = {"random": 5, "clear": 8, "drop": 8}
"""How scenes of views are made, and objects in each: rejection sampling fills few tables with more."""


@with_own_settings
def perception_data(
    out: str | Path = "views",
    *,
    pool: str | Path = "household",
    support: str | Path = "table",
    num_views: int = 6000,
    split: Split = "train",
    num_objects: int | None = None,
    arm: float = 1 / 3,
    seed: int = 0,
    num_threads: int = 0,
    overwrite: bool = False,
) -> ViewSet:
    """Renders views of scenes to train and judge perception with (`cluttergen perception data`).

    A view is what one colour and depth camera sees of a scene, with the class of each pixel and the true
    poses. Scenes are made along, by `random`, `clear` and `drop`; colours, the table's texture, light and the
    camera are drawn for each view. The same call continues an interrupted one.

    Args:
      out: the folder; each split of it is made by a call of its own.
      pool: a pool's name or folder, or several joined by +.
      support: the table, by name or folder.
      num_views: how many.
      split: train, val or test; each has table textures that no other has.
      num_objects: in each scene at most; 5 by `random` and 8 by the others if not given. Views show the
        first so many of them.
      arm: share of the views with the robot's arm in them; more than 0 needs the extra `robot`.
      seed: of all that is drawn, 0 to 999999.
      num_threads: of the simulation; 0 takes every core.
      overwrite: begin the split, and the banks made along, anew if the folder holds others of it.

    Returns:
      The views.

    Raises:
      ConfigError: a setting is out of range.
      BankError: the folder holds views made otherwise, or something else.
      PoolError: there is no such pool or support.
      MissingExtraError: the arm is wanted and the extra `robot` is not installed.
      RendererError: nothing here can draw.
    """
    from cluttergen_jax.api.generate import generate
    from cluttergen_jax.assets.pool import find_pool
    from cluttergen_jax.downstream.perception.views.maker import VIEWS_A_SCENE, ViewConfig, write_views
    from cluttergen_jax.downstream.perception.views.stored import VIEWS
    from cluttergen_jax.downstream.robot.model import panda_folder
    from cluttergen_jax.downstream.splits import SPLITS
    from cluttergen_jax.rendering.gl import find_backend

    check_folder(out)
    check_workers("num_threads", num_threads)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    check_range("num_views", num_views, 1, MAX_VIEWS, 6000)
    if split not in SPLITS:
        raise ConfigError(f"split = {split!r}", ", ".join(SPLITS))
    config = ViewConfig(seed=SPLITS[split] + seed, arm=arm)
    if arm:
        panda_folder()
    most = len(find_pool(pool).objects)
    if num_objects is not None:
        check_range("num_objects", num_objects, 1, most, min(8, most))
    num_scenes = -(-num_views // (VIEWS_A_SCENE * len(_METHODS)))
    VIEWS.check_place(Path(out))
    if overwrite or not any(Path(out).glob(f"bank-{split}-*")):
        # Scenes take minutes, and are of no use where nothing can draw them.
        find_backend()
    banks: dict[str, Any] = {
        method: generate(
            Path(out) / f"bank-{split}-{method}",
            pool=pool,
            support=support,
            method=method,
            num_objects=min(num_objects or usual, most),
            num_scenes=max(num_scenes, 8),
            order="random",
            render=False,
            max_files=0,
            seed=config.seed,
            num_threads=num_threads,
            overwrite=overwrite,
        )
        for method, usual in _METHODS.items()
    }
    return write_views(out, banks, split, num_views, config, overwrite)


@with_own_settings
def perception_train(
    data: str | Path = "views",
    out: str | Path | None = None,
    *,
    reads: SegmenterInput = "colour",
    num_views: int | None = None,
    num_epochs: int | None = None,
    batch_size: int | None = None,
    learning_rate: float | None = None,
    seed: int = 0,
    show: Callable[[str], None] = print,
) -> Path:
    """Trains a segmenter on views (`cluttergen perception train`). The same call resumes a run.

    Args:
      data: a folder of `perception data`. Validated on its split `val`, else on every tenth view.
      out: the run's folder; runs/segmenter-READS-SEED if not given.
      reads: "colour" and depth, or "depth" alone.
      num_views: the first so many of the training split; all if not given.
      num_epochs: times that every view is seen; 9 if not given.
      batch_size: views per step; 8 if not given.
      learning_rate: of the optimiser, at its highest; 0.003 if not given.
      seed: of weights, order, exposure and noise, 0 to 4294967295.
      show: is given the lines that tell how far the run is.

    Returns:
      The segmenter's folder: `perception_eval` and `rearrange` take it.

    Raises:
      ConfigError: a setting is out of range, there are no views, or the folder holds another run.
      BankError: the folder holds no views, or damaged ones.
      KeyboardInterrupt: on Ctrl-C, once everything is saved.
    """
    from dataclasses import replace
    from typing import get_args

    from cluttergen_jax.downstream.perception.segment.examples import ViewSource
    from cluttergen_jax.downstream.perception.segment.network import SegmentConfig
    from cluttergen_jax.downstream.perception.segment.training import FIT, SegmenterTraining

    check_range("seed", seed, 0, 2**32 - 1, 0)
    if num_views is not None:
        check_range("num_views", num_views, 1, MAX_VIEWS, 6000)
    if reads not in get_args(SegmenterInput):
        raise ConfigError(f"reads = {reads!r}", ", ".join(get_args(SegmenterInput)))
    given: dict[str, Any] = {
        "num_epochs": num_epochs,
        "batch_size": batch_size,
        "learning_rate": learning_rate,
        "seed": seed,
    }
    config = replace(FIT, **{name: value for name, value in given.items() if value is not None})
    source = ViewSource(Path(data), seed, num_views)
    network = SegmentConfig(len(source.views.names), colour=reads == "colour")
    folder = Path(out or f"runs/segmenter-{reads}-{seed}")
    show(f"run        {folder}")
    return SegmenterTraining(network, config, source, folder, show).run()


@with_own_settings
def perception_eval(
    data: str | Path = "views",
    segmenter: str | Path | None = None,
    *,
    split: Split = "test",
    cameras: Sequence[int] = (1, 2),
    noise: Sequence[float] = (0.0, 1.0),
    num_views: int | None = None,
    calibrate: bool = False,
    seed: int = 0,
    out: str | Path | None = None,
) -> PerceptionResult:
    """Judges masks, poses and certainty against what is true (`cluttergen perception eval`).

    Args:
      data: a folder of `perception data`.
      segmenter: a folder of `perception train`, or a pool's name where one comes with the package; "true"
        takes the true masks, so that poses alone are judged. The pool's own if not given.
      split: train, val or test.
      cameras: 1, 2 or both: with 2, both views of each moment are used together.
      noise: of the depth cameras, so many times that of a usual one; 0 for none.
      num_views: the first so many; all if not given.
      calibrate: fit the rule that tells certainties to these poses, and keep it beside the segmenter; best
        done on the split val.
      seed: of exposure and noise.
      out: where rows are kept, which are not made again. With None a function keeps nothing; the command
        takes out/perception.

    Returns:
      Rows; printed, tables: masks, poses by the share that is seen, certainty, objects.

    Raises:
      ConfigError: a setting is out of range, or the folder has no such split.
      BankError: the folder holds no views, damaged ones, or rows of other settings.
      PoolError: there is no such segmenter, or it is damaged.
      MissingExtraError: the extra `perception` is not installed.
    """
    from cluttergen_jax.downstream.perception.evaluation.evaluate import evaluate_perception
    from cluttergen_jax.downstream.perception.views.stored import read_views

    check_folder(out)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    if not isinstance(cameras, Sequence) or not cameras or set(cameras) - {1, 2}:
        raise ConfigError(f"cameras = {cameras!r}", "1, 2 or both", "cameras=(1, 2)")
    check_noise(noise)
    if num_views is not None:
        check_range("num_views", num_views, 1, MAX_VIEWS, 200)
    views = read_views(data)
    chosen = str(segmenter) if segmenter is not None else views.pool
    folder = None if out is None else Path(out)
    return evaluate_perception(
        views, split, chosen, tuple(cameras), tuple(map(float, noise)), num_views, seed, folder, calibrate
    )
