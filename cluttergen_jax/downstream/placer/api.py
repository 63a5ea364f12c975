"""Stable placement from one camera's view: pairs to learn from, training, and placers side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax import SceneSpec
from cluttergen_jax.config import Method, check_range, check_workers
from cluttergen_jax.downstream.words import (
    MAX_PAIRS,
    PlacerHead,
    PlacerNoise,
    SensedFrom,
    Split,
    check_choice,
    check_noise,
)
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.kept_folder import hold_folder
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.placement import entry_of

if TYPE_CHECKING:
    from cluttergen_jax.downstream.placer.evaluate import PlacerComparison
    from cluttergen_jax.downstream.placer.pairs import PairSet
    from cluttergen_jax.downstream.placer.query import Placer, PlainPlacer

_MOST_SEED = 999_999


@with_own_settings
def placer_data(
    out: str | Path = "pairs",
    bank: str | Path | None = None,
    spec: SceneSpec | None = None,
    *,
    pool: str | Path | None = None,
    num_scenes: int | None = None,
    method: Method | None = None,
    support: str | Path | None = None,
    num_objects: int | None = None,
    num_pairs: int | None = None,
    split: Split | None = None,
    camera: SensedFrom = "free",
    seed: int = 0,
    num_threads: int = 0,
    overwrite: bool = False,
) -> PairSet:
    """Makes pairs for stable placement of a bank's scenes (`cluttergen placer data`).

    A pair is one depth image of the first objects of a scene, the true pose of the next object, and 32
    labelled candidate poses. The same call resumes an interrupted one.

    Args:
      out: the folder; each split of it is made by a call of its own.
      bank: the scenes to use; if not given, a bank is generated in the folder.
      spec: the request for that bank; household if not given.
      pool, num_scenes, method, support, num_objects: for that bank, as in `generate`, in place of those of
        `spec`; 500 scenes, guided and the usual table if not given.
      num_pairs: number of pairs; if not given, one for each object of each success.
      split: train, val or test, by the seed of the bank: from 0, 1000000 or 2000000 on; of a bank that is
        given, its own, else train.
      camera: free, drawn anew for each pair; overhead; or side, the paper's.
      seed: for everything random, the generated bank included, 0 to 999999.
      num_threads: 0 takes every core.
      overwrite: replace the split, and the generated bank, if the folder holds others of it.

    Returns:
      The pairs, as `load_queries` of `downstream.placer.pairs` reads them.

    Raises:
      ConfigError: a setting is out of range, or contradicts the bank.
      BankError: the bank cannot be read or holds no success, or the folder holds something else.
      PoolError: there is no such pool or support.
    """
    from cluttergen_jax import generate
    from cluttergen_jax.assets import find_support
    from cluttergen_jax.downstream.bank_scenes import (
        bank_or_made,
        check_one_level,
        check_upright,
        poses_of,
    )
    from cluttergen_jax.downstream.placer.pair_maker import split_of, write_pairs
    from cluttergen_jax.downstream.placer.pairs import PAIRS
    from cluttergen_jax.downstream.samples import SPLITS
    from cluttergen_jax.scene import Bank

    check_folder(out)
    check_workers("num_threads", num_threads)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    if num_pairs is not None:
        check_range("num_pairs", num_pairs, 1, MAX_PAIRS, 5000)
    if split is not None:
        check_choice("split", split, Split)
    name = split or "train"

    def make() -> Bank:
        asked = (spec or SceneSpec(pool="household")).replace_given(
            pool, method, support, num_objects
        )
        check_upright(asked.poses, "a placer")
        check_one_level(find_support(asked.support).on_surface(asked.surface), "a placer")
        return generate(
            Path(out) / f"bank-{name}",
            replace(asked, num_threads=num_threads),
            num_scenes=500 if num_scenes is None else num_scenes,
            seed=SPLITS[name] + seed,
            render=False,
            max_files=0,
            overwrite=overwrite,
        )

    given = (spec, pool, num_scenes, method, support, num_objects)
    with PAIRS.store.hold(Path(out)):
        found = bank_or_made(bank, make, "spec pool num_scenes method support num_objects", given)
        check_upright(poses_of(found), "a placer")
        check_one_level(found.support, "a placer")
        if "assets" not in found.record:
            raise BankError(
                f"{bank} has no digests of its assets: an older version made it",
                hint="generating the bank again",
            )
        if entry_of(found.recipe.get("method")).is_heap:
            hint = "generate --method guided"
            raise BankError(
                f"{found.path} holds piles", "scenes placed one object after another", hint
            )
        of_split = split_of(found, split)
        return write_pairs(out, found, of_split, num_pairs, camera, seed, num_threads, overwrite)


@with_own_settings
def placer_eval(
    data: str | Path,
    placers: Sequence[str | Path | Placer | PlainPlacer] = (
        "random",
        "geometry",
        "geometry-occupied",
    ),
    *,
    noise: Sequence[float] = (0.0, 1.0),
    split: Split = "test",
    num_pairs: int | None = None,
    cameras: int = 1,
    chains: int = 0,
    seed: int = 0,
    num_threads: int = 0,
    fresh: bool = False,
    out: str | Path | None = None,
) -> PlacerComparison:
    """Compares placers: the success rate of their proposals (`cluttergen placer eval`).

    Args:
      data: a folder that `placer.data` made.
      placers: "random", "geometry", "geometry-occupied", folders of trained ones, and "drop", "guided" and
        "policy", which see the scene itself; in Python also your own
        (`cluttergen_jax.downstream.placer.query.PlainPlacer`, or `Placer` in JAX).
      noise: factors of the simulated sensor noise of a usual depth camera; 0 for none.
      split: train, val or test.
      num_pairs: the first so many queries; all of the split if not given.
      cameras: that look at each scene, their maps fused; all but the first are drawn anew around the table,
        which pairs of the camera "free" alone allow.
      chains: number of tables that each placer also fills by itself, with a new image after each object; at
        most as many as the split has scenes.
      seed: of noise and proposals, 0 to 999999.
      num_threads: 0 takes every core.
      fresh: make rows again that are at hand.
      out: where everything goes: tables, and rows, which are not made again. With None a function writes
        nothing; the command takes out/placer.

    Returns:
      Rows and tables; printed, the tables.

    Raises:
      ConfigError: a setting is out of range, the folder has no such split, there is no such placer, or one of
        your own returned something else than poses.
      BankError: the folder holds no pairs, or they are damaged.
      PoolError: a placer's files are damaged, or there is none for the pool.
    """
    from cluttergen_jax.downstream.placer.evaluate import PlacerTrials, compare_placers
    from cluttergen_jax.downstream.placer.pairs import read_pairs
    from cluttergen_jax.evaluation import Store

    check_folder(out)
    check_workers("num_threads", num_threads)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    if num_pairs is not None:
        check_range("num_pairs", num_pairs, 1, MAX_PAIRS, 1000)
    if isinstance(placers, str) or not placers:
        raise ConfigError(f"placers = {placers!r}", "a sequence of names", "placers=('geometry',)")
    check_noise(noise)
    if not 0 <= chains <= MAX_PAIRS:
        raise ConfigError(f"chains = {chains}", f"0 to {MAX_PAIRS}", "chains=100")
    folder = None if out is None else Path(out)
    with hold_folder(folder):
        store = Store(folder and folder / "results")
        trials = PlacerTrials(
            read_pairs(data), split, num_pairs, seed, store, fresh, num_threads, cameras
        )
        asked = tuple(str(each) if isinstance(each, Path) else each for each in placers)
        return compare_placers(trials, asked, tuple(map(float, noise)), folder, chains)


@with_own_settings
def placer_train(
    data: str | Path | Sequence[str | Path],
    head: PlacerHead = "scored",
    out: str | Path | None = None,
    *,
    noise: PlacerNoise = "both",
    num_pairs: int | None = None,
    num_epochs: int | None = None,
    batch_size: int | None = None,
    learning_rate: float | None = None,
    seed: int = 0,
    show: Callable[[str], None] = print,
) -> Path:
    """Trains a placer on pairs (`cluttergen placer train`). The same call resumes an interrupted run.

    Args:
      data: a folder of `placer data`, or several; one network learns from all. Validated on the split `val`
        where there is one, else on every tenth scene of the training split.
      head: "scored": candidates, each with the probability that it is stable.
      out: the run's folder; runs/placer-HEAD-SEED if not given.
      noise: of the camera: "on", "off", or "both": every other pair is seen with noise.
      num_pairs: of each folder the first so many; all if not given.
      num_epochs: times that every pair is seen; 12 if not given.
      batch_size: pairs per step; 32 if not given.
      learning_rate: of the optimiser, at its highest; 0.002 if not given.
      seed: of weights, order and noise, 0 to 4294967295.
      show: is given the lines that tell how far the run is.

    Returns:
      The placer's folder: `find_placer` and `placer.eval` take it.

    Raises:
      ConfigError: a setting is out of range, there are no pairs, or the folder holds another run.
      BankError: a folder holds no pairs, or damaged ones; or another process writes to `out`.
      KeyboardInterrupt: on Ctrl-C, once everything is saved.
    """
    from cluttergen_jax.downstream.fitting import FitConfig
    from cluttergen_jax.downstream.placer.scored import head_of_name
    from cluttergen_jax.downstream.placer.training import ExampleSource, PlacerTraining
    from cluttergen_jax.learning import hold_run

    check_range("seed", seed, 0, 2**32 - 1, 0)
    if num_pairs is not None:
        check_range("num_pairs", num_pairs, 1, MAX_PAIRS, 5000)
    folders = (data,) if isinstance(data, str | Path) else tuple(data)
    found = head_of_name(head)
    config = FitConfig().replace_given(num_epochs, batch_size, learning_rate, seed)
    folder = Path(out or f"runs/placer-{head}-{seed}")
    with hold_run(folder):
        source = ExampleSource(tuple(Path(each) for each in folders), noise, seed, num_pairs)
        show(f"run        {folder}")
        return PlacerTraining(found, config, source, folder, show).run()
