"""Perception: views to learn from, a segmenter, and how well objects and their poses are found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cluttergen_jax.config import SegmenterInput, Split, check_workers
from cluttergen_jax.errors import ConfigError

if TYPE_CHECKING:
    from cluttergen_jax.downstream.perception.evaluation.evaluate import PerceptionResult
    from cluttergen_jax.downstream.perception.views.stored import ViewSet

_MOST_VIEWS = 1_000_000
_MOST_SEED = 999_999
_VIEWS_A_SCENE = 4
_METHODS = {"random": 5, "clear": 8, "drop": 8}
"""How scenes of views are made, and objects in each: rejection sampling fills few tables with more."""


def perception_data(
    out: str | Path = "views",
    *,
    pool: str | Path = "household",
    support: str | Path = "table",
    num_views: int = 3000,
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
      split: train, val or test; the last two have table textures that training does not see.
      num_objects: in each scene at most; 5 by `random` and 8 by the others if not given. Views show the
        first so many of them.
      arm: share of the views with the robot's arm in them; more than 0 needs the extra `robot`.
      seed: of all that is drawn, 0 to 999999.
      num_threads: of the simulation; 0 takes every core.
      overwrite: begin the split anew if the folder holds others of it.

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
    from cluttergen_jax.downstream.perception.views.maker import ViewConfig, write_views
    from cluttergen_jax.downstream.perception.views.stored import SPLITS
    from cluttergen_jax.downstream.robot.model import panda_folder
    from cluttergen_jax.placement.setup import check_range

    check_workers("num_threads", num_threads)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    check_range("num_views", num_views, 1, _MOST_VIEWS, 3000)
    if split not in SPLITS:
        raise ConfigError(f"split = {split!r}", ", ".join(SPLITS))
    config = ViewConfig(seed=SPLITS[split] + seed, arm=arm, held_out=split != "train")
    if arm:
        panda_folder()
    most = len(find_pool(pool).objects)
    if num_objects is not None:
        check_range("num_objects", num_objects, 1, most, min(8, most))
    num_scenes = -(-num_views // (_VIEWS_A_SCENE * len(_METHODS)))
    banks: dict[str, Any] = {
        method: generate(
            Path(out) / f"bank-{split}-{method}",
            pool=pool,
            support=support,
            method=method,  # type: ignore[arg-type]
            num_objects=min(num_objects or usual, most),
            num_scenes=max(num_scenes, 8),
            order="random",
            render=False,
            max_files=0,
            seed=config.seed,
            num_threads=num_threads,
        )
        for method, usual in _METHODS.items()
    }
    return write_views(out, banks, split, num_views, config, overwrite)
