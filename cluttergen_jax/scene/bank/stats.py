"""What a bank amounts to, in numbers: for `cluttergen stats` and the dataset card."""

from __future__ import annotations

import hashlib
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.assets.hollow import hollow_of
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotation_matrix
from cluttergen_jax.placement.arranged import count_arranged
from cluttergen_jax.placement.arrangements import parse_arrangements
from cluttergen_jax.placement.clutter import CROWDED, NAMES, Clutter
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.progress import time_text
from cluttergen_jax.scene.bank.bank import Bank, read_bank
from cluttergen_jax.scene.bank.record import record_error
from cluttergen_jax.scene.bank.relation_tally import RelationFailures, RelationTally
from cluttergen_jax.scene.bank.table import BY_HAND, CERTIFICATE, COUNTED, count_column, rows_of
from cluttergen_jax.types import Verdict, small_length

_NEAR_ENOUGH = 0.1
_SHARES = {"side": "num_beside", "lean": "num_leaning"}
"""Of features that are told for each object of a scene: the column that counts them."""
_MOST_HITS = 5
"""Of doors and objects that are named."""
_WORDS = {
    "stack": "objects on others",
    "contained": "objects in others",
    "depth": "objects below each, summed",
    "contacts": "pairs that touch",
    "near": "metres to the nearest other, mean",
    "occlusion": "share hidden, mean",
    "side": "pairs that touch from the side, for each object",
    "lean": "share of the objects that lean",
    "height": "metres from the support to the highest point",
    "row": "objects in rows",
    "stacked": "objects upon their like",
    "nest": "objects nested in their like",
}
_HEIGHT = "height"
_ARRANGED = ("row", "stacked", "nest")


@dataclass
class Totals:
    """Sums over rows of a bank, which are added some at a time.

    Attributes:
      scenes, success, filled: how many, how many of them stand, and of how many every slot was filled.
      placed, attempts, simulated_steps: of all of them.
      num_rested: objects that took an attempt and were placed; own_attempts, rest_steps: sums over those.
      verdicts: attempts by verdict.
      has_doors: whether scenes close doors; door_hits: how often one hit an object or did not close; hits:
        scenes by the last time, in words.
    """

    scenes: int = 0
    success: int = 0
    filled: int = 0
    placed: int = 0
    attempts: int = 0
    simulated_steps: int = 0
    num_rested: int = 0
    own_attempts: int = 0
    rest_steps: int = 0
    verdicts: dict[Verdict, int] = field(default_factory=lambda: dict.fromkeys(COUNTED, 0))
    has_doors: bool = False
    door_hits: int = 0
    hits: Counter[str] = field(default_factory=Counter)

    def add(self, rows: pa.Table) -> None:
        """Counts some more rows."""
        self.scenes += rows.num_rows
        self.success += _sum(rows, "is_success")
        self.filled += _sum(rows, "is_filled")
        self.placed += _sum(rows, "num_placed")
        self.simulated_steps += _sum(rows, "simulated_steps")
        attempts, steps, placed = (
            np.array(pc.list_flatten(rows[name]))
            for name in ("attempts", "rest_steps", "is_placed")
        )
        self.attempts += int(attempts.sum())
        # Objects that stood there at the beginning took no attempt.
        placed &= attempts > 0
        self.num_rested += int(placed.sum())
        self.own_attempts += int(attempts[placed].sum())
        self.rest_steps += int(steps[placed].sum())
        for verdict in COUNTED:
            self.verdicts[verdict] += _sum(rows, count_column(verdict))
        if "door_hit" in rows.schema.names:
            self.has_doors = True
            self.door_hits += _sum(rows, "num_door_hits")
            self.hits.update(base_name(text) for text in rows["door_hit"].to_pylist() if text)

    def text(self, num_new: int = 0, seconds: float = 0.0) -> str:
        """Success, attempts, steps to rest and rejections by verdict.

        Args:
          num_new, seconds: scenes made just now and how long that took, for the rate; 0 leaves it out.
        """
        rested = max(self.num_rested, 1)
        each = f"{self.own_attempts / rested:.2f} per placed object"
        total = max(sum(self.verdicts.values()), 1)
        lines = [
            f"scenes     {self.scenes}, of which {self.success} succeed ({self.success / self.scenes:.1%}): "
            "every object placed, and all stand together in the last check",
            f"filled     {self.filled} ({self.filled / self.scenes:.1%}) before the last check",
            f"attempts   {self.attempts}, {each if self.num_rested else 'no object placed'}",
            f"rest       after {self.rest_steps / rested:.0f} steps of 1/240 s in the mean",
        ]
        rejected = [
            f"{number} {verdict.label} ({number / total:.1%}): {verdict.sentence}"
            for verdict, number in self.verdicts.items()
            if number and verdict != Verdict.STABLE
        ]
        lines.append("rejected   " + ("\n           ".join(rejected) or "nothing"))
        if self.has_doors:
            named = "; ".join(
                f"{text} ({number})" for text, number in self.hits.most_common(_MOST_HITS)
            )
            hits = f"blocked {self.door_hits} time{'s' * (self.door_hits != 1)}: {named}"
            lines.append(f"doors      {hits if self.door_hits else 'all closed at once'}")
        if num_new and seconds > 0:
            lines.append(
                f"speed      {num_new} scenes made in {seconds:.1f} s, compilation included"
            )
        return "\n".join(lines)


def _sum(rows: pa.Table, name: str) -> int:
    return int(np.sum(rows[name], dtype=np.int64))


def totals_of(tables: Iterable[pa.Table]) -> Totals:
    """The totals of all these rows."""
    totals = Totals()
    for rows in tables:
        totals.add(rows)
    return totals


@dataclass(frozen=True)
class FeatureStats:
    """One feature of clutter over the scenes of a bank that stand.

    Attributes:
      name: as in `placement.clutter.Clutter`; or what arrangements count, or "height".
      got: mean over the scenes.
      asked: the target; None where nothing was asked.
      within: share of the scenes within 10 % of the target, or at or above it for `CROWDED`; None likewise.
    """

    name: str
    got: float
    asked: float | None = None
    within: float | None = None

    def line(self) -> str:
        """For people."""
        text = f"{self.name} {self.got:.3g} ({_WORDS[self.name]})"
        if self.asked is None or self.within is None:
            return text
        reach = "reach it" if self.name in CROWDED else "are within 10 %"
        return f"{text}, asked for {self.asked:g}: {self.within:.1%} of the scenes {reach}"


class ClutterTally:
    """Sums of the features that rows know, of the scenes that stand; rows are added some at a time.

    Args:
      bank: whose targets count.
    """

    def __init__(self, bank: Bank) -> None:
        self._arranged = _arrangement_targets(bank)
        self._targets = _targets(bank) | self._arranged
        self._names = (*NAMES, _HEIGHT, *(name for name in _ARRANGED if name in self._arranged))
        self._number = dict.fromkeys(self._names, 0)
        self._sum = dict.fromkeys(self._names, 0.0)
        self._num_near = dict.fromkeys(self._names, 0)
        self._bank = bank
        self._asset = lru_cache(maxsize=None)(bank.object)

    def add(self, rows: pa.Table) -> None:
        """Counts some more rows."""
        rows = rows.filter(rows["is_success"])
        found = {name: _values(rows, name) for name in NAMES}
        found[_HEIGHT] = self._heights(rows.filter(pc.is_valid(rows["num_beside"])))
        if self._arranged:
            found |= self._count_arranged(rows)
        for name in self._names:
            values = found[name]
            self._number[name] += len(values)
            self._sum[name] += float(values.sum())
            if (asked := self._targets.get(name)) is not None:
                away = asked - values if name in CROWDED else np.abs(values - asked)
                slack = 0.0 if name in CROWDED else _NEAR_ENOUGH * asked
                self._num_near[name] += int((away <= slack + 1e-6).sum())

    def _heights(self, rows: pa.Table) -> np.ndarray:
        """f64[N]: metres from the support to the highest point of the objects' boxes in each scene."""
        heights = []
        for row in rows_of(rows):
            half = np.array([self._asset(base_name(name)).half_extents for name in row.objects])
            upward = [rotation_matrix(pose[3:])[2] for pose in row.poses.astype(np.float64)]
            tops = row.poses[:, 2] + (np.abs(upward) * half).sum(1)
            heights.append(tops.max() - self._bank.support.top)
        return np.array(heights)

    def _count_arranged(self, rows: pa.Table) -> dict[str, np.ndarray]:
        """f64[N] by name: how many objects of each scene are in rows, stacks and nests."""
        counts = []
        for row in rows_of(rows):
            names = [base_name(name) for name in row.objects]
            assets = [self._asset(name) for name in names]
            half = np.array([each.half_extents for each in assets]).reshape(-1, 3)
            is_hollow = np.array([hollow_of(each) is not None for each in assets], bool)
            counts.append(count_arranged(names, half, is_hollow, row.poses))
        columns = np.array(counts, float).reshape(-1, len(_ARRANGED)).T
        return dict(zip(_ARRANGED, columns, strict=True))

    def features(self) -> tuple[FeatureStats, ...]:
        """Those that some row knows."""
        known = [name for name in self._names if self._number[name]]
        return tuple(
            FeatureStats(
                name,
                self._sum[name] / self._number[name],
                self._targets.get(name),
                self._num_near[name] / self._number[name] if name in self._targets else None,
            )
            for name in known
        )


def _values(rows: pa.Table, name: str) -> np.ndarray:
    """f64[N]: a feature of the scenes that know it."""
    if name == "depth":
        lists = rows["levels"].drop_null().combine_chunks()
        levels = np.maximum(np.array(pc.list_flatten(lists)), 0)
        return np.bincount(np.array(pc.list_parent_indices(lists)), levels, len(lists))
    if name in _SHARES:
        known = rows.filter(pc.is_valid(rows[_SHARES[name]]))
        return np.array(known[_SHARES[name]], float) / np.maximum(np.array(known["num_placed"]), 1)
    column = {"stack": "num_on", "contained": "num_in", "contacts": "num_touching"}.get(name, name)
    return np.array(rows[column].drop_null(), float)


def _targets(bank: Bank) -> dict[str, float]:
    try:
        placement = bank.recipe.get("placement", {})
        asked = placement.get("clutter")
        targets = Clutter.of(asked).targets if asked else {}
        if crowd := placement.get("crowd"):
            of_crowd = PlacementConfig(num_objects=placement["num_objects"], crowd=crowd)
            pairs = zip(CROWDED, of_crowd.crowd_targets or (), strict=True)
            targets |= {name: value for name, value in pairs if value}
        return targets
    except (AttributeError, ConfigError, KeyError, TypeError) as error:
        raise record_error(bank.path, error) from error


def _arrangement_targets(bank: Bank) -> dict[str, float]:
    """How many objects a bank's arrangements put in rows, upon and into their like; none if it has none."""
    try:
        asked = parse_arrangements(bank.recipe.get("placement", {}).get("arrangements", ()))
    except (AttributeError, TypeError, ConfigError) as error:
        raise record_error(bank.path, error) from error
    found: dict[str, float] = {}
    for each in asked:
        number = each.number if each.kind == "row" else each.number - 1
        # What is nested is upon its like as well.
        names = {"row": ("row",), "stack": ("stacked",), "nest": ("stacked", "nest")}[each.kind]
        for name in names:
            found[name] = found.get(name, 0) + number
    return found


_SHOWN_GROUPS = 5
_LISTS = ("rests_on", "margins", "detectors")


@dataclass(frozen=True)
class ObjectStats:
    """One object over all scenes of a bank.

    Attributes:
      name: the asset's; copies of it in one scene count each.
      drawn: slots that it was drawn for and that were reached.
      placed: how many of those it was placed in.
      attempts: that it took.
    """

    name: str
    drawn: int
    placed: int
    attempts: int


@dataclass(frozen=True)
class CertificateStats:
    """What `cluttergen certify` found, over the scenes that stand.

    Attributes:
      scenes: how many were measured.
      shake_median, shake_least: m/s^2, sideways acceleration that a scene withstands.
      horizon_seconds, horizon_drift: seconds for which every scene was simulated, some longer, and metres,
        the most that any object moved.
      residual_speed: m/s, the fastest object 0.25 s after a scene was let go.
      penetration: metres, the deepest overlap.
      contacts: contact points of a scene, mean.
      on_others: share of the objects that rest on another object.
      margin_median, margin_least: metres, the least support margin in a scene; None if nothing is carried
        from below.
      tilt: share of directions withstood, by degrees of tilt.
      robust: share of the scenes that stand in soft contact, with less friction and tilted gravity.
    """

    scenes: int
    shake_median: float
    shake_least: float
    horizon_seconds: float
    horizon_drift: float
    residual_speed: float
    penetration: float
    contacts: float
    on_others: float
    margin_median: float | None
    margin_least: float | None
    tilt: dict[str, float]
    robust: float

    def lines(self) -> list[str]:
        """For people, a fact each."""
        lines = [
            f"shake: {self.shake_median:.2f} m/s^2 in the median, {self.shake_least:.2f} at least",
            f"drift: {small_length(self.horizon_drift)} at most in {self.horizon_seconds:g} s",
            f"residual speed: {small_length(self.residual_speed)}/s at most",
            f"overlap: {small_length(self.penetration)} at most",
            f"contact points: {self.contacts:.1f} a scene",
            f"objects that rest on another: {self.on_others:.1%}",
        ]
        if self.margin_median is not None and self.margin_least is not None:
            middle = small_length(self.margin_median)
            least = small_length(self.margin_least)
            lines.append(
                f"support margin, the least in a scene: {middle} in the median, {least} at least"
            )
        shares = ", ".join(f"{share:.1%} by {by} degrees" for by, share in self.tilt.items())
        return [
            *lines,
            f"directions in which tilted gravity topples nothing: {shares}",
            f"robust (tilted by 3 degrees, less friction, soft contact): {self.robust:.1%}",
        ]


@dataclass(frozen=True)
class BankStats:
    """A bank in numbers.

    Attributes:
      asked: scenes that the bank was asked for.
      scenes: scenes that are there, failures included; missing: indices below `asked` that are not, as first
        and last of each run.
      success: scenes that stand; filled: scenes whose every slot was filled.
      verdicts: scenes by their last word.
      placed: placed objects; attempts, simulated_steps: of all scenes.
      objects: by asset.
      drift_median, drift_most: metres, movement in the last check of the scenes that stand.
      duplicates: indices of scenes that stand and are equal to the bit, objects and poses, group by group.
      certificate: of those scenes that have one; None if none has.
      clutter: features of the scenes that stand, as far as they are known.
      relations: at which scenes failed, and how often.
      hand_median, hand_total: seconds that a person spent on a scene, and on all; None where none did.
      door_hits: scenes by what a door hit last, such as `door_left hits mug`; None where none are closed.
      summary: where the bank is, who made it, and its totals, in words.
    """

    asked: int
    scenes: int
    missing: tuple[tuple[int, int], ...]
    success: int
    filled: int
    verdicts: dict[str, int]
    placed: int
    attempts: int
    simulated_steps: int
    objects: tuple[ObjectStats, ...]
    drift_median: float
    drift_most: float
    duplicates: tuple[tuple[int, ...], ...]
    certificate: CertificateStats | None
    clutter: tuple[FeatureStats, ...] = ()
    relations: tuple[RelationFailures, ...] = ()
    hand_median: float | None = None
    hand_total: float | None = None
    door_hits: dict[str, int] | None = None
    summary: str = field(default="", repr=False, compare=False)

    def __str__(self) -> str:
        """What `cluttergen stats` prints."""
        return _text(self)

    @property
    def success_rate(self) -> float:
        """Share of the scenes that stand."""
        return self.success / max(self.scenes, 1)

    def certificate_lines(self) -> list[str]:
        """What the certificates say, for people, a fact each; nothing if no scene has one."""
        if self.certificate is None:
            return []
        measured = self.certificate.scenes
        lines = self.certificate.lines()
        if measured == self.success:
            return lines
        return [
            f"measured: {measured} of {self.success} scenes; `cluttergen certify` adds the rest",
            *lines,
        ]

    def as_json(self) -> dict[str, object]:
        """JSON values."""
        record = asdict(self)
        del record["summary"]
        return record


def stats_of(bank: Bank | str | Path) -> BankStats:
    """What a bank holds, in numbers; printed, a table for people (`cluttergen stats`).

    The bank is read some thousand scenes at a time.

    Args:
      bank: a bank, its folder or its URL.

    Raises:
      BankError: there is no bank, it holds no scenes yet, or a block is damaged.
    """
    bank = bank if isinstance(bank, Bank) else read_bank(bank)
    tally = _Tally(bank)
    for rows in bank.tables():
        tally.add(rows)
    return tally.stats()


class _Tally:
    """Sums over the rows of a bank. Some 20 bytes a scene are kept: movements, and digests for duplicates."""

    def __init__(self, bank: Bank) -> None:
        self._bank = bank
        self._clutter = ClutterTally(bank)
        self._relations = RelationTally(bank)
        self._totals = Totals()
        self._missing: list[tuple[int, int]] = []
        self._last = -1
        self._verdicts: Counter[str] = Counter()
        self._objects: dict[str, np.ndarray] = {}
        self._drift: list[np.ndarray] = []
        self._index: list[np.ndarray] = []
        self._digest: list[np.ndarray] = []
        self._certified: list[pa.Table] = []
        self._seconds: list[np.ndarray] = []

    def add(self, rows: pa.Table) -> None:
        """Counts some more rows, which follow those before."""
        good = rows.filter(rows["is_success"])
        self._totals.add(rows)
        self._clutter.add(rows)
        self._relations.add(rows)
        self._look_for_gaps(np.array(rows["index"]))
        for each in pc.value_counts(rows["verdict"]).to_pylist():
            self._verdicts[each["values"]] += each["counts"]
        self._count_objects(rows)
        self._drift.append(np.array(good["drift"]))
        self._index.append(np.array(good["index"]))
        self._digest.append(_digests(good))
        self._seconds += [
            np.array(rows[name]) for name in BY_HAND.names if name in rows.schema.names
        ]
        self._certified.append(_certificate_rows(good.filter(pc.is_valid(good["shake"]))))

    def stats(self) -> BankStats:
        """The numbers of all that was added."""
        totals = self._totals
        drift = np.concatenate(self._drift)
        self._look_for_gaps(np.array([self._bank.num_scenes]))
        seconds = np.concatenate(self._seconds) if self._seconds else None
        return BankStats(
            asked=self._bank.num_scenes,
            scenes=totals.scenes,
            missing=tuple(self._missing),
            success=totals.success,
            filled=totals.filled,
            verdicts=dict(self._verdicts.most_common()),
            placed=totals.placed,
            attempts=totals.attempts,
            simulated_steps=totals.simulated_steps,
            objects=tuple(
                ObjectStats(name, *self._objects[name].tolist()) for name in sorted(self._objects)
            ),
            drift_median=float(np.median(drift)) if len(drift) else 0.0,
            drift_most=float(drift.max(initial=0.0)),
            duplicates=_duplicates(
                self._bank, np.concatenate(self._index), np.concatenate(self._digest)
            ),
            certificate=_certificate(pa.concat_tables(self._certified)),
            clutter=self._clutter.features(),
            relations=self._relations.failures(),
            hand_median=None if seconds is None else float(np.median(seconds)),
            hand_total=None if seconds is None else float(seconds.sum()),
            door_hits=dict(totals.hits.most_common()) if totals.has_doors else None,
            summary=_summary(self._bank, totals),
        )

    def _look_for_gaps(self, index: np.ndarray) -> None:
        """Runs of indices that are asked for and not there."""
        fences = np.append(self._last, index[index <= self._bank.num_scenes])
        self._missing += [
            (int(fences[gap]) + 1, int(fences[gap + 1]) - 1)
            for gap in np.flatnonzero(np.diff(fences) > 1)
        ]
        self._last = int(fences[-1])

    def _count_objects(self, rows: pa.Table) -> None:
        names = pc.list_flatten(rows["objects"].combine_chunks()).dictionary_encode()
        stands, tries = (
            np.array(pc.list_flatten(rows[name])) for name in ("is_placed", "attempts")
        )
        counts = [
            np.bincount(names.indices, weights, len(names.dictionary)).astype(int)
            for weights in (stands | (tries > 0), stands, tries)
        ]
        for name, *numbers in zip(names.dictionary.to_pylist(), *counts, strict=True):
            asset = base_name(name)
            self._objects[asset] = self._objects.get(asset, np.zeros(3, int)) + numbers


def _certificate_rows(rows: pa.Table) -> pa.Table:
    """What `_certificate` needs of rows that stand: numbers, and how many objects rest on another."""
    # An object may rest on several.
    upper = [
        len({above for above, below in pairs if below >= 0})
        for pairs in rows["rests_on"].to_pylist()
    ]
    kept = rows.select([*(name for name in CERTIFICATE.names if name not in _LISTS), "num_placed"])
    return kept.append_column("num_on_others", pa.array(upper, pa.int32())).replace_schema_metadata(
        None
    )


def _certificate(rows: pa.Table) -> CertificateStats | None:
    """Of rows that stand."""
    if not rows.num_rows:
        return None
    of = {
        name: np.array(rows[name].drop_null()) for name in CERTIFICATE.names if name not in _LISTS
    }
    margin = of["margin"]
    return CertificateStats(
        scenes=rows.num_rows,
        shake_median=float(np.median(of["shake"])),
        shake_least=float(of["shake"].min()),
        horizon_seconds=float(of["horizon_seconds"].min()),
        horizon_drift=float(of["horizon_drift"].max()),
        residual_speed=float(of["residual_speed"].max()),
        penetration=float(of["penetration"].max()),
        contacts=float(of["num_contacts"].mean()),
        on_others=int(np.sum(rows["num_on_others"])) / max(int(np.sum(rows["num_placed"])), 1),
        margin_median=float(np.median(margin)) if len(margin) else None,
        margin_least=float(margin.min()) if len(margin) else None,
        tilt={by: float(of[f"tilt_{by}"].mean()) for by in ("1", "2", "5")},
        robust=float(of["robust"].mean()),
    )


def _digests(rows: pa.Table) -> np.ndarray:
    """u64[N]: equal for scenes of the same objects at the same poses, in whatever order they were placed."""
    lists = rows["objects"].combine_chunks()
    names = pc.list_flatten(lists).dictionary_encode()
    known = [zlib.crc32(base_name(name).encode()) for name in names.dictionary.to_pylist()]
    poses = np.array(pc.list_flatten(pc.list_flatten(rows["poses"])), np.float32).view(np.uint32)
    slots = np.array(known, np.uint64)[np.array(names.indices)] if known else np.zeros(0, np.uint64)
    for column in poses.reshape(-1, 7).T:
        # A step of splitmix64 (Steele et al., 2014) for each of the numbers; sums of slots know no order.
        slots = (slots ^ column) * np.uint64(0x9E3779B97F4A7C15)
        slots = (slots ^ (slots >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        slots ^= slots >> np.uint64(27)
    found = np.zeros(len(lists), np.uint64)
    np.add.at(found, np.array(pc.list_parent_indices(lists)), slots)
    return found


def _duplicates(bank: Bank, index: np.ndarray, digest: np.ndarray) -> tuple[tuple[int, ...], ...]:
    """Groups of successful scenes with the same objects at the same poses, in whatever order."""
    ordered = np.sort(digest)
    repeated = np.unique(ordered[1:][ordered[1:] == ordered[:-1]])
    suspects = index[np.isin(digest, repeated)].tolist()
    groups: dict[bytes, list[int]] = defaultdict(list)
    for first in range(0, len(suspects), BLOCK_SIZE):
        for number, row in bank.rows(suspects[first : first + BLOCK_SIZE]).items():
            pairs = zip(map(base_name, row.objects), row.poses, strict=True)
            content = sorted((name, pose.tobytes()) for name, pose in pairs)
            groups[hashlib.sha256(repr(content).encode()).digest()].append(number)
    return tuple(tuple(group) for group in groups.values() if len(group) > 1)


def stats_text(bank: Bank, stats: BankStats) -> str:
    """The text of `stats`, which are those of `bank`; `str(stats)` is the same."""
    return str(stats)


def _summary(bank: Bank, totals: Totals) -> str:
    recipe = bank.recipe
    made_by = f"made by {recipe.get('method')} with seed {recipe.get('seed')} of pool {recipe.get('pool')}"
    return f"bank       {bank.path}, {made_by}\n{totals.text()}"


def _text(stats: BankStats) -> str:
    lines = [stats.summary]
    lines.append(
        f"verdicts   {', '.join(f'{number} {name}' for name, number in stats.verdicts.items())}"
    )
    lines.append(
        f"movement   in the last check of scenes that stand: median {small_length(stats.drift_median)}, "
        f"most {small_length(stats.drift_most)}"
    )
    lines += [
        f"{'' if place else 'clutter':11}{each.line()}" for place, each in enumerate(stats.clutter)
    ]
    lines += [
        f"{'' if place else 'relations':11}{each.line()}"
        for place, each in enumerate(stats.relations)
    ]
    facts = stats.certificate_lines()
    lines += [f"{'' if place else 'certified':11}{fact}" for place, fact in enumerate(facts)]
    if stats.hand_median is not None and stats.hand_total is not None:
        median = time_text(stats.hand_median)
        total = time_text(stats.hand_total)
        lines.append(f"by hand    {median} a scene in the median, {total} in all")
    runs = ", ".join(
        f"{first} to {last}" if first < last else f"{first}" for first, last in stats.missing
    )
    lines.append(f"missing    {runs or 'nothing'} of the {stats.asked} scenes asked for")
    lines.append(f"duplicates {_duplicates_text(stats)}")
    width = max(len(each.name) for each in stats.objects)
    lines.append(f"objects    {'name':{width}}  drawn  placed  attempts each")
    for each in stats.objects:
        mean = each.attempts / max(each.drawn, 1)
        lines.append(
            f"           {each.name:{width}}  {each.drawn:5d}  {each.placed:6d}  {mean:13.2f}"
        )
    return "\n".join(lines)


def _duplicates_text(stats: BankStats) -> str:
    if not stats.duplicates:
        return "no two scenes that stand are equal"
    shown = "; ".join(" = ".join(map(str, group)) for group in stats.duplicates[:_SHOWN_GROUPS])
    more = ", and others" if len(stats.duplicates) > _SHOWN_GROUPS else ""
    return (
        f"{sum(len(group) - 1 for group in stats.duplicates)} scenes repeat another: {shown}{more}"
    )
