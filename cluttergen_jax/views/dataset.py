"""Making a dataset of views: which scenes go where, and shards made here or by workers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.cluster import Cluster, each_on
from cluttergen_jax.config import DatasetForm, Variation
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import remove_partial, write_atomically, writing
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering.config import QUALITIES, PhotoConfig, Quality
from cluttergen_jax.rendering.look import PLAIN, Look, find_look
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.rendering.variation import TEXTURES_OF
from cluttergen_jax.scene.bank import Bank, read_bank, read_scenes, region_of, select_rows
from cluttergen_jax.schema import digest_of
from cluttergen_jax.sensing import CameraPlan
from cluttergen_jax.statistics import share_out
from cluttergen_jax.views.bop import BopConfig, BopScenes
from cluttergen_jax.views.maker import SeenScene, ViewMaker
from cluttergen_jax.views.shards import (
    SCENES_PER_SHARD,
    VIEWS,
    ShardForm,
    encode_rows,
    is_whole_shard,
    row_of,
    shard_name,
)

_SPLIT_DRAW = 11
# Metres beside the region, and above and below the top: what light and shadows are made for.
_BESIDE = 0.2
_HIGH = 0.4
Runs = list[list[int]]
"""First and last of numbers without a gap, ascending."""


@dataclass(frozen=True)
class ViewConfig:
    """How the scenes of a dataset are seen.

    Attributes:
      cameras: that look at each scene.
      seed: of cameras that are drawn, and of all that varies.
      vary: what is drawn anew for each view (`config.Variation`).
      quality: of colours.
      look: the name or file of a look, of which what it leaves open is drawn for each scene.
      colour: draw colours, which needs OpenGL; all else needs none.
    """

    cameras: tuple[CameraPlan, ...]
    seed: int = 0
    vary: tuple[Variation, ...] = ()
    quality: Quality = "draft"
    colour: bool = True
    look: str = PLAIN

    def picture(self) -> PictureConfig:
        """Of colours, as large as the largest of the cameras' pictures."""
        width, height = np.max([plan.size for plan in self.cameras], axis=0).tolist()
        quality = QUALITIES[self.quality]
        return PictureConfig(
            width,
            height,
            quality.samples,
            smoothing=quality.smoothing,
            photo=PhotoConfig() if quality.is_photo else None,
        )

    def look_of(self, number: int) -> Look | None:
        """How a scene is furnished and lit, by its number in its bank."""
        return find_look(self.look, self.seed + number)


@dataclass(frozen=True)
class ViewDataset:
    """A dataset of views that is made.

    Attributes:
      path: its folder; form: of its files.
      num_views: by split.
    """

    path: Path
    form: str
    num_views: dict[str, int]

    def __str__(self) -> str:
        lines = (f"{number} of {split}" for split, number in self.num_views.items())
        return f"views      {', '.join(lines)} in {self.path} ({self.form})"


@dataclass(frozen=True, eq=False)
class Shard:
    """Scenes of a bank that are made together.

    Attributes:
      bank: its place among the banks; number: of the shard in it.
      scenes: by split, their numbers in the bank.
    """

    bank: int
    number: int
    scenes: dict[str, tuple[int, ...]]


@dataclass(frozen=True)
class DatasetPlan:
    """Which scenes are seen, and how.

    Attributes:
      banks: their folders; shares: by split; num_scenes: how many of each, the first that stand.
      shards: all of them.
      rounds: of each bank, the scenes that each call added, as runs of numbers, first and last.
    """

    banks: tuple[Path, ...]
    shares: dict[str, float]
    num_scenes: tuple[int, ...]
    config: ViewConfig
    shards: tuple[Shard, ...]
    rounds: tuple[list[Runs], ...]

    @classmethod
    def of(
        cls,
        banks: Sequence[Path],
        shares: dict[str, float],
        num_scenes: int | None,
        config: ViewConfig,
        least: Sequence[int] = (),
        rounds: Sequence[list[Runs]] = (),
    ) -> DatasetPlan:
        """Reads which scenes stand, and gives each a split. Scenes of a dataset that grows keep theirs.

        Args:
          num_scenes: the first so many of each bank; all if None.
          least: of each bank, how many are in the dataset already.
          rounds: those, see the attribute.

        Raises:
          BankError: there is no bank, none of its scenes stands, or it has fewer than are in the dataset.
        """
        shards: list[Shard] = []
        numbers: list[int] = []
        grown: list[list[Runs]] = []
        for place, path in enumerate(banks):
            bank = read_bank(path)
            rows = pa.concat_tables(bank.tables(["index", "is_success"]))
            index = np.sort(rows["index"].to_numpy())
            good = np.sort(rows["index"].to_numpy()[rows["is_success"].to_numpy()])
            there = least[place] if least else 0
            known = list(rounds[place]) if rounds else []
            is_old = _is_within(good, known)
            if not len(good) or int(is_old.sum()) < there:
                given = f"{path}: {len(good)} of its scenes stand"
                allowed = f"at least the {there} that the dataset has" if there else ""
                raise BankError(given, allowed, "more scenes")
            most = len(good) if num_scenes is None else num_scenes
            good = good[is_old | (np.arange(len(good)) < most)]
            fresh = index[(index <= good[-1]) & ~_is_within(index, known)]
            if np.isin(fresh, good).any():
                known.append(_runs_of(fresh))
            numbers.append(len(good))
            grown.append(known)
            names = _splits_of(good, place, shares, config.seed, known)
            # By number, so that a bank that grew has its first scenes where they were.
            number = good // SCENES_PER_SHARD
            for each in np.unique(number):
                own = {
                    split: tuple(good[(number == each) & (names == split)].tolist())
                    for split in shares
                }
                shards.append(
                    Shard(place, int(each), {split: some for split, some in own.items() if some})
                )
        return cls(tuple(banks), shares, tuple(numbers), config, tuple(shards), tuple(grown))

    def num_views(self) -> dict[str, int]:
        """Of each split."""
        total = dict.fromkeys(self.shares, 0)
        for shard in self.shards:
            for split, some in shard.scenes.items():
                total[split] += len(some) * len(self.config.cameras)
        return total

    def recipe(self) -> dict[str, Any]:
        """What decides every view but which there are."""
        config = self.config
        return {
            "banks": list(map(_bank_record, self.banks)),
            "cameras": [asdict(plan) | {"stored": repr(plan.stored)} for plan in config.cameras],
            "shares": self.shares,
            "seed": config.seed,
            "vary": list(config.vary),
            "quality": config.quality,
            "colour": config.colour,
            # Versions before averaged fewer pictures.
            **({"samples": QUALITIES[config.quality].samples} if config.quality != "draft" else {}),
            **({"look": config.look} if config.look != PLAIN else {}),
            "scenes_per_shard": SCENES_PER_SHARD,
            # Versions before drew the split of each scene by itself, and shares came out by chance.
            **({"shares_are": "exact"} if len(self.shares) > 1 else {}),
        }


def _bank_record(path: Path) -> dict[str, Any]:
    """What a record says of a bank."""
    bank = read_bank(path)
    told = {"name": path.resolve().name, "recipe": bank.recipe}
    # Cameras of earlier versions stood about the middle of the support.
    return told if region_of(bank) == bank.support.region else told | {"cameras_about": "region"}


def _splits_of(
    scenes: np.ndarray, bank: int, shares: dict[str, float], seed: int, rounds: Sequence[Runs]
) -> np.ndarray:
    """The split of each scene: exact shares of all, and those of earlier rounds stay where they are."""
    which = np.full(len(scenes), -1)
    for number, runs in enumerate(rounds):
        is_new = _is_within(scenes, [runs]) & (which < 0)
        before = np.bincount(which[which >= 0], minlength=len(shares))
        rng = np.random.default_rng([seed, bank, number, _SPLIT_DRAW])
        which[is_new] = share_out(int(is_new.sum()), list(shares.values()), rng, before)
    return np.array(list(shares))[which]


def _runs_of(numbers: np.ndarray) -> Runs:
    """Sorted numbers as runs without a gap."""
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 2) > 1)
    ends = np.append(starts[1:], len(numbers)) - 1
    return [
        [int(numbers[first]), int(numbers[last])] for first, last in zip(starts, ends, strict=True)
    ]


def _is_within(numbers: np.ndarray, rounds: Sequence[Runs]) -> np.ndarray:
    """bool[N]: which numbers lie in a run of some round."""
    runs = [run for each in rounds for run in each]
    within = [np.arange(first, last + 1) for first, last in runs]
    return np.isin(numbers, np.concatenate(within) if within else ())


@dataclass(frozen=True)
class ShardMaker:
    """Makes shards, here or in another process that sees the same files."""

    banks: tuple[Path, ...]
    config: ViewConfig
    out: Path
    form: ShardForm

    def __call__(self) -> Callable[[Shard], int]:
        """The function that makes a shard's files, and returns its number of views."""
        return lambda shard: sum(1 for _ in self.views(shard))

    def views(self, shard: Shard) -> Iterator[None]:
        """Makes a shard; yields after each view.

        A view depends on its scene, its camera, the bank's place, the seed, and where its colours vary on the
        objects of the shard's scenes.
        """
        bank = read_bank(self.banks[shard.bank])
        name = bank.path.resolve().name
        split_of = {number: split for split, some in shard.scenes.items() for number in some}
        scenes = _standing_scenes(bank, sorted(split_of))
        config = self.config
        made: dict[str, list[dict[str, Any]]] = {split: [] for split in shard.scenes}
        with ViewMaker(
            config.picture(),
            is_drawn=config.colour,
            vary=config.vary,
            around=_around(scenes[0].support),
            most_together=sys.maxsize,
        ) as maker:
            objects = [scene.objects for scene in scenes]
            for scene in scenes:
                split = split_of[scene.number]
                look = config.look_of(scene.number)
                maker.place(
                    scene.objects, scene.poses, scene.support, coming=lambda: objects, look=look
                )
                for number, plan in enumerate(config.cameras):
                    rng = np.random.default_rng([config.seed, shard.bank, scene.number, number])
                    camera = plan.draw(scene.support, rng)
                    if config.vary:
                        maker.dress(rng, TEXTURES_OF[split])
                    view = maker.see(camera, has_instances=True)
                    # Compressed at once: what a camera sees is some megabytes.
                    made[split].append(row_of(view, scene, name, plan.name))
                    yield
        for split, rows in made.items():
            data = encode_rows(rows, self.form)
            write_atomically(
                self.out / shard_name(split, shard.bank, shard.number, self.form), data
            )


def _standing_scenes(bank: Bank, numbers: Sequence[int]) -> list[SeenScene]:
    """Scenes whose support has the region that they were made in."""
    region = region_of(bank)
    support = replace(bank.support, region=region)
    found = []
    for each in read_scenes(bank, numbers):
        # With each copy quaternions are made unit ones again, to the last bit as they have always been.
        scene = replace(each, support=support)
        poses = np.asarray(scene.poses, np.float64)
        found.append(
            SeenScene(scene.origin.index, scene.names, scene.objects, poses, support, region)
        )
    return found


def _stored_scenes(bank: Bank, numbers: Sequence[int]) -> list[SeenScene]:
    """Scenes with the poses that the bank stores, which a BOP dataset has digests of."""
    region = region_of(bank)
    asset_of = lru_cache(maxsize=None)(bank.object)
    found = []
    for row in select_rows(bank, numbers):
        objects = [asset_of(base_name(name)) for name in row.objects]
        poses = np.asarray(row.poses, np.float64)
        found.append(SeenScene(row.index, row.objects, objects, poses, bank.support, region))
    return found


def _around(support: SupportAsset) -> np.ndarray:
    """f64[2, 3]: corners of what light and shadows of all scenes are made for.

    Alike for all: shadows are the coarser the more they are made for.
    """
    region = support.region
    middle = np.array([*region.center, support.top])
    half = np.append(np.array(region.half_extents) + _BESIDE, _HIGH)
    return np.stack([middle - half, middle + half])


def make(
    banks: Sequence[Path],
    shares: dict[str, float],
    num_scenes: int | None,
    config: ViewConfig,
    out: Path,
    form: DatasetForm,
    cluster: Cluster | None,
) -> ViewDataset:
    """A dataset in a folder, begun or continued; see `cluttergen_jax.make_dataset`."""
    recipe = DatasetPlan.of(banks, shares, num_scenes, config).recipe() | {"form": form}
    with VIEWS.hold(out), writing(out):
        remove_partial(out)
        known = VIEWS.begin(out, recipe)
        there = known.get("num_scenes", ())
        rounds = known.get("rounds", ())
        plan = DatasetPlan.of(banks, shares, num_scenes, config, there, rounds)
        record = {
            "recipe": recipe,
            "num_scenes": list(plan.num_scenes),
            "num_views": plan.num_views(),
        }
        record["rounds"] = list(plan.rounds)
        # Before the first file: another call shares its scenes out as this one does.
        digests = known.get("shards", {})
        VIEWS.write_record(out, record if form == "bop" else record | {"shards": digests})
        if form == "bop":
            _make_bop(plan, out)
        else:
            shards = _make_shards(plan, out, form, cluster, digests)
            VIEWS.write_record(out, record | {"shards": shards})
    return ViewDataset(out, form, plan.num_views())


def _make_shards(
    plan: DatasetPlan, out: Path, form: ShardForm, cluster: Cluster | None, digests: dict[str, str]
) -> dict[str, str]:
    """Makes those that are missing or damaged; the digest of each by its name."""
    maker = ShardMaker(plan.banks, plan.config, out, form)
    num_cameras = len(plan.config.cameras)
    names = {
        (shard, split): shard_name(split, shard.bank, shard.number, form)
        for shard in plan.shards
        for split in shard.scenes
    }

    def is_there(shard: Shard) -> bool:
        for split, some in shard.scenes.items():
            name = names[shard, split]
            if not is_whole_shard(out / name, form, len(some) * num_cameras, digests.get(name)):
                return False
        return True

    missing = [shard for shard in plan.shards if not is_there(shard)]
    total = sum(plan.num_views().values())
    left = num_cameras * sum(map(_num_scenes, missing))
    with Progress("views", total, "view", total - left) as progress:
        if cluster is None:
            for shard in missing:
                for _ in maker.views(shard):
                    progress.update(1)
        else:
            with closing(each_on(cluster, maker, missing, "shard")) as done:
                for _, views in done:
                    progress.update(views)
    return {name: digest_of((out / name).read_bytes()) for name in sorted(names.values())}


def _num_scenes(shard: Shard) -> int:
    return sum(map(len, shard.scenes.values()))


def _make_bop(plan: DatasetPlan, out: Path) -> None:
    """The scenes of each split as a folder of a BOP dataset."""
    config = plan.config
    for place, path in enumerate(plan.banks):
        bank = read_bank(path)
        for split in plan.shares:
            chosen = [
                number
                for shard in plan.shards
                if shard.bank == place
                for number in shard.scenes.get(split, ())
            ]
            if not chosen:
                continue
            asked = BopConfig(
                seed=config.seed, split=split, cameras=config.cameras, vary=config.vary
            )
            name = bank.path.resolve().name
            with BopScenes(out, name, asked, config.picture(), config.colour) as dataset:
                scenes = _stored_scenes(bank, chosen)
                for scene in scenes:
                    dataset.plan(scene)
                with Progress(f"views of {split}", len(scenes), "scene") as progress:
                    for scene in scenes:
                        dataset.add(scene)
                        progress.update(1)
