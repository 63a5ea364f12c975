"""Making a dataset of views: which scenes go where, and shards made here or by workers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pyarrow as pa

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.cluster import Cluster, each_on
from cluttergen_jax.config import DatasetForm, Variation
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import remove_partial, writing
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.progress import Progress, track
from cluttergen_jax.rendering.config import QUALITIES, PhotoConfig, Quality
from cluttergen_jax.rendering.look import PLAIN, Look, find_look, look_record
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.rendering.variation import TEXTURES_OF
from cluttergen_jax.scene.bank import Bank, read_bank, read_scenes, region_of, select_rows
from cluttergen_jax.schema import Record, digest_of
from cluttergen_jax.sensing import CameraPlan
from cluttergen_jax.statistics import share_out
from cluttergen_jax.views.bop import BopConfig, BopScenes
from cluttergen_jax.views.card import write_views_card
from cluttergen_jax.views.detection import (
    DetectionFiles,
    DetectionForm,
    check_detection,
    validation_split,
)
from cluttergen_jax.views.maker import SeenScene, ViewMaker
from cluttergen_jax.views.shards import (
    SCENES_PER_SHARD,
    VIEWS,
    RowFiles,
    ShardFiles,
    ViewSource,
)

_SPLIT_DRAW = 11
# Metres beside the region, and above and below the top: what light and shadows are made for.
_BESIDE = 0.2
_HIGH = 0.4
Runs = list[list[int]]
"""First and last of numbers without a gap, ascending."""
Shares = Literal["drawn", "exact", "exact of all"]
"""How scenes get their splits: each by a draw of its own, so that shares come out by chance, as the first
versions did; exact shares of each bank; or, in new datasets, of all banks together."""
_HELD: dict[DatasetForm, tuple[str, str]] = {
    "parquet": ("depth, labels, whole silhouettes, visible shares, boxes, poses, cameras", ""),
    "webdataset": ("depth, labels, whole silhouettes, visible shares, boxes, poses, cameras", ""),
    "bop": ("depth, masks, visible shares, boxes, poses, cameras, models", ""),
    "coco": (
        "boxes and masks of what is seen; in extra keys whole silhouettes, visible shares, poses, cameras",
        "depth",
    ),
    "yolo": (
        "boxes of what is seen; in shards/ whole boxes, visible shares, poses, cameras",
        "depth, masks",
    ),
    "yolo-seg": (
        "outlines of what is seen; in shards/ whole boxes, visible shares, poses, cameras",
        "depth, whole silhouettes",
    ),
}
"""Besides colours, what files of each form hold, and what they do not."""


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
      has_colour: whether colours were drawn.
    """

    path: Path
    form: DatasetForm
    num_views: dict[str, int]
    has_colour: bool = True

    def __str__(self) -> str:
        numbers = (f"{number} of {split}" for split, number in self.num_views.items())
        held, missing = _HELD[self.form]
        lines = [
            f"views      {', '.join(numbers)} in {self.path} ({self.form})",
            f"holds      {'colours, ' if self.has_colour else ''}{held}",
        ]
        if missing:
            lines.append(f"without    {missing} (which --form parquet has)")
        split = validation_split(self.num_views)
        if self.form in ("yolo", "yolo-seg") and split != "val":
            lines.append(
                f"val        is {split}: Ultralytics needs a split `val`, and this dataset has none "
                "(--splits train=0.9,val=0.1)"
            )
        return "\n".join(lines)


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
      shares_are: how scenes got their splits.
    """

    banks: tuple[Path, ...]
    shares: dict[str, float]
    num_scenes: tuple[int, ...]
    config: ViewConfig
    shards: tuple[Shard, ...]
    rounds: tuple[list[Runs], ...]
    shares_are: Shares

    @classmethod
    def of(
        cls,
        banks: Sequence[Path],
        shares: dict[str, float],
        num_scenes: int | None,
        config: ViewConfig,
        least: Sequence[int] = (),
        rounds: Sequence[list[Runs]] | None = None,
        shares_are: Shares = "exact of all",
    ) -> DatasetPlan:
        """Reads which scenes stand, and gives each a split. Scenes of a dataset that grows keep theirs.

        Args:
          num_scenes: the first so many of each bank; all if None.
          least: of each bank that is in the dataset already, how many scenes of it are.
          rounds: those, see the attribute; None where the dataset's record has none.

        Raises:
          BankError: there is no bank, none of its scenes stands, or it has fewer than are in the dataset.
        """
        standing: list[np.ndarray] = []
        fresh: list[np.ndarray] = []
        grown: list[list[Runs]] = []
        for place, path in enumerate(banks):
            bank = read_bank(path)
            rows = pa.concat_tables(bank.tables(["index", "is_success"]))
            index = np.sort(rows["index"].to_numpy())
            good = np.sort(rows["index"].to_numpy()[rows["is_success"].to_numpy()])
            there = least[place] if place < len(least) else 0
            known = list(rounds[place]) if rounds is not None and place < len(rounds) else []
            if rounds is None and 0 < there <= len(good):
                # Records of the first versions say only how many: they are the first.
                known.append(_runs_of(index[index <= good[there - 1]]))
            is_old = _is_within(good, known)
            if not len(good) or int(is_old.sum()) < there:
                given = f"{path}: {len(good)} of its scenes stand"
                allowed = f"at least the {there} that the dataset has" if there else ""
                raise BankError(given, allowed, "more scenes")
            most = len(good) if num_scenes is None else num_scenes
            good = good[is_old | (np.arange(len(good)) < most)]
            added = index[(index <= good[-1]) & ~_is_within(index, known)]
            standing.append(good)
            fresh.append(added if np.isin(added, good).any() else added[:0])
            grown.append(known)
        if any(len(each) for each in fresh):
            # A round of all banks together, though some have nothing new.
            number = max(map(len, grown))
            for known, added in zip(grown, fresh, strict=True):
                known += [[]] * (number - len(known))
                known.append(_runs_of(added))
        shards: list[Shard] = []
        every = _splits_of(standing, shares, config.seed, grown, shares_are)
        for place, (good, names) in enumerate(zip(standing, every, strict=True)):
            # By number, so that a bank that grew has its first scenes where they were.
            number_of = good // SCENES_PER_SHARD
            for each in np.unique(number_of):
                own = {
                    split: tuple(good[(number_of == each) & (names == split)].tolist())
                    for split in shares
                }
                shards.append(
                    Shard(place, int(each), {split: some for split, some in own.items() if some})
                )
        return cls(
            tuple(banks),
            shares,
            tuple(map(len, standing)),
            config,
            tuple(shards),
            tuple(grown),
            shares_are,
        )

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
            **look_record(config.look),
            "scenes_per_shard": SCENES_PER_SHARD,
            **_shares_record(self.shares, self.shares_are),
        }


def _bank_record(path: Path) -> dict[str, Any]:
    """What a record says of a bank."""
    bank = read_bank(path)
    told = {"name": path.resolve().name, "recipe": bank.recipe}
    # Cameras of earlier versions stood about the middle of the support.
    return told if region_of(bank) == bank.support.region else told | {"cameras_about": "region"}


def _shares_record(shares: dict[str, float], shares_are: Shares) -> dict[str, str]:
    """What a recipe says of how scenes got their splits; nothing where there is one, or they were drawn."""
    return {"shares_are": shares_are} if len(shares) > 1 and shares_are != "drawn" else {}


def _splits_of(
    scenes: Sequence[np.ndarray],
    shares: dict[str, float],
    seed: int,
    rounds: Sequence[Sequence[Runs]],
    shares_are: Shares,
) -> list[np.ndarray]:
    """The split of each scene of each bank; those of earlier rounds stay where they are."""
    names = np.array(list(shares))
    if len(names) == 1:
        return [np.repeat(names, len(each)) for each in scenes]
    if shares_are == "drawn":
        return [names[_draw_splits(each, bank, shares, seed)] for bank, each in enumerate(scenes)]
    which = [np.full(len(each), -1) for each in scenes]
    for number in range(max(map(len, rounds))):
        # Of banks with few scenes, chance decides which has those of the smaller splits.
        order = np.random.default_rng([seed, number, _SPLIT_DRAW]).permutation(len(scenes))
        for bank in order.tolist():
            if number >= len(rounds[bank]):
                continue
            own = which[bank]
            is_new = _is_within(scenes[bank], [rounds[bank][number]]) & (own < 0)
            counted = own if shares_are == "exact" else np.concatenate(which)
            before = np.bincount(counted[counted >= 0], minlength=len(shares))
            rng = np.random.default_rng([seed, bank, number, _SPLIT_DRAW])
            own[is_new] = share_out(int(is_new.sum()), list(shares.values()), rng, before)
    return [names[each] for each in which]


def _draw_splits(scenes: np.ndarray, bank: int, shares: dict[str, float], seed: int) -> np.ndarray:
    """i[S]: the split of each scene by its number alone, as the first versions drew it."""
    drawn = [
        np.random.default_rng([seed, bank, scene, _SPLIT_DRAW]).uniform()
        for scene in scenes.tolist()
    ]
    edges = np.cumsum(list(shares.values()))
    return np.minimum(np.searchsorted(edges, drawn, side="right"), len(shares) - 1)


def _runs_of(numbers: np.ndarray) -> Runs:
    """Sorted numbers as runs without a gap."""
    if not len(numbers):
        return []
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
    files: ShardFiles

    def __call__(self) -> Callable[[Shard], int]:
        """The function that makes a shard's files, and returns its number of views."""
        return lambda shard: sum(1 for _ in self.views(shard))

    def is_there(self, shard: Shard, digests: Mapping[str, str]) -> bool:
        """Whether all files of a shard are there as they were written.

        Args:
          digests: of those that are known, by name.
        """
        for split, some in shard.scenes.items():
            name = self.name_of(shard, split)
            number = len(some) * len(self.config.cameras)
            if not self.files.is_whole(name, number, digests.get(name)):
                return False
        return True

    def name_of(self, shard: Shard, split: str) -> str:
        """The file that makes a split of a shard whole."""
        return self.files.name_of(split, shard.bank, shard.number)

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
        writers = {
            split: self.files.writer(self.name_of(shard, split), split) for split in shard.scenes
        }
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
                    source = ViewSource(name, shard.bank, plan.name, number, len(config.cameras))
                    writers[split].add(view, scene, source)
                    yield
        for writer in writers.values():
            writer.finish()


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
    if form in get_args(DetectionForm):
        check_detection(form, len(banks))
    recipe = DatasetPlan.of(banks, shares, num_scenes, config).recipe() | {"form": form}
    with VIEWS.hold(out), writing(out):
        remove_partial(out)
        known = _begin(out, recipe)
        there = known.get("num_scenes", ())
        plan = DatasetPlan.of(
            banks,
            shares,
            num_scenes,
            config,
            there,
            known.get("rounds", None if there else ()),
            known["recipe"].get("shares_are", "drawn") if known else "exact of all",
        )
        record: Record = {
            "recipe": plan.recipe() | {"form": form},
            "num_scenes": list(plan.num_scenes),
            "num_views": plan.num_views(),
            "rounds": list(plan.rounds),
        }
        if form in get_args(DetectionForm):
            record["categories"] = _categories(banks, known.get("categories", []))
        # Before the first file: another call shares its scenes out as this one does.
        digests = known.get("shards", {})
        VIEWS.write_record(out, record if form == "bop" else record | {"shards": digests})
        if form == "bop":
            _make_bop(plan, out)
        else:
            files: ShardFiles
            if form == "parquet" or form == "webdataset":
                files = RowFiles(out, form)
            else:
                files = DetectionFiles(out, form, tuple(record["categories"]))
            maker = ShardMaker(plan.banks, config, files)
            shards = _make_shards(plan, maker, cluster, digests)
            VIEWS.write_record(out, record | {"shards": shards})
            if form == "parquet" or form == "webdataset":
                write_views_card(out, form, plan.num_views(), [read_bank(each) for each in banks])
    return ViewDataset(out, form, plan.num_views(), config.colour)


def _begin(out: Path, recipe: Mapping[str, Any]) -> Record:
    """What is known of a dataset that is begun or continued: by the rule of its splits, and perhaps with more
    banks behind those that it has (BankError: it was made by another recipe, see `BlockStore.begin`)."""
    if not (out / VIEWS.index).exists():
        return VIEWS.begin(out, recipe)
    known = VIEWS.read_record(out).get("recipe", {})
    asked = {name: value for name, value in recipe.items() if name != "shares_are"}
    if "shares_are" in known:
        asked["shares_are"] = known["shares_are"]
    asked["banks"] = recipe["banks"][: max(len(known.get("banks", ())), 1)]
    return VIEWS.begin(out, asked)


def _categories(banks: Sequence[Path], known: Sequence[str]) -> list[str]:
    """The labels of all objects of the banks, sorted, behind those that the dataset has already."""
    labels: set[str] = set()
    for path in banks:
        bank = read_bank(path)
        names = bank.object_names
        labels |= {
            bank.object(name).label for name in track(names, "categories", len(names), "object")
        }
    return [*known, *sorted(labels.difference(known))]


def _make_shards(
    plan: DatasetPlan, maker: ShardMaker, cluster: Cluster | None, digests: dict[str, str]
) -> dict[str, str]:
    """Makes those that are missing or damaged; the digest of each by its name."""
    names: dict[str, list[str]] = {split: [] for split in plan.shares}
    for shard in plan.shards:
        for split in shard.scenes:
            names[split].append(maker.name_of(shard, split))
    maker.files.remove_partial(tuple(plan.shares))
    missing = [shard for shard in plan.shards if not maker.is_there(shard, digests)]
    total = sum(plan.num_views().values())
    left = len(plan.config.cameras) * sum(map(_num_scenes, missing))
    with Progress("views", total, "view", total - left) as progress:
        if cluster is None:
            for shard in missing:
                for _ in maker.views(shard):
                    progress.update(1)
        else:
            with closing(each_on(cluster, maker, missing, "shard")) as done:
                for _, views in done:
                    progress.update(views)
    maker.files.write_index(names, plan.num_views())
    every = sorted(name for some in names.values() for name in some)
    return {name: digest_of((maker.files.out / name).read_bytes()) for name in every}


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
                seed=config.seed,
                split=split,
                cameras=config.cameras,
                vary=config.vary,
                look=config.look,
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
