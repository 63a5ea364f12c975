"""What a bank amounts to, in numbers: for `cluttergen stats` and the dataset card."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa

from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.clutter_stats import FeatureStats, clutter_of
from cluttergen_jax.scene.bank.table import CERTIFICATE, COUNTED, is_certified
from cluttergen_jax.types import Verdict, small_length

_SHOWN_GROUPS = 5
_LISTS = ("rests_on", "margins")


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
      horizon_seconds, horizon_drift: seconds simulated, and metres, the most that any object moved in them.
      residual_speed: m/s, the fastest object 0.25 s after a scene was let go.
      penetration: metres, the deepest overlap.
      contacts: contact points of a scene, mean.
      on_others: share of the objects that rest on another object.
      margin_median, margin_least: metres, the least support margin in a scene; None if an older version
        measured.
      tilt: share of directions withstood, by degrees of tilt; empty likewise.
      robust: share of the scenes that stand in soft contact, with less friction and tilted gravity; None
        likewise.
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
    robust: float | None

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
            middle, least = small_length(self.margin_median), small_length(self.margin_least)
            lines.append(f"support margin, the least in a scene: {middle} in the median, {least} at least")
        if self.tilt:
            shares = ", ".join(f"{share:.1%} by {by} degrees" for by, share in self.tilt.items())
            lines.append(f"directions in which tilted gravity topples nothing: {shares}")
        if self.robust is not None:
            lines.append(f"robust (tilted by 3 degrees, less friction, soft contact): {self.robust:.1%}")
        return lines


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
      certificate: None unless every scene that stands has one.
      clutter: features of the scenes that stand, as far as they are known.
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

    @property
    def success_rate(self) -> float:
        """Share of the scenes that stand."""
        return self.success / max(self.scenes, 1)

    def as_json(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self)


def stats_of(bank: Bank) -> BankStats:
    """The numbers of a bank.

    Raises:
      BankError: it holds no scenes yet, or a block is damaged.
    """
    table = bank.table
    success = np.array(table["is_success"])
    drift = np.array(table["drift"])[success]
    return BankStats(
        asked=bank.num_scenes,
        scenes=table.num_rows,
        missing=_missing(np.array(table["index"]), bank.num_scenes),
        success=int(success.sum()),
        filled=int(np.array(table["is_filled"]).sum()),
        verdicts=dict(Counter(table["verdict"].to_pylist()).most_common()),
        placed=int(np.array(table["num_placed"]).sum()),
        attempts=sum(sum(each) for each in table["attempts"].to_pylist()),
        simulated_steps=int(np.array(table["simulated_steps"], np.int64).sum()),
        objects=_objects(table),
        drift_median=float(np.median(drift)) if len(drift) else 0.0,
        drift_most=float(drift.max(initial=0.0)),
        duplicates=_duplicates(table),
        certificate=_certificate(table.filter(table["is_success"])) if is_certified(table) else None,
        clutter=clutter_of(bank, table),
    )


def _certificate(rows: pa.Table) -> CertificateStats | None:
    """Of rows that stand."""
    if not rows.num_rows:
        return None
    of = {name: np.array(rows[name].drop_null()) for name in CERTIFICATE.names if name not in _LISTS}
    margin, has_tilt = of["margin"], len(of["tilt_1"]) > 0
    # An object may rest on several.
    upper = [{above for above, below in pairs if below >= 0} for pairs in rows["rests_on"].to_pylist()]
    return CertificateStats(
        scenes=rows.num_rows,
        shake_median=float(np.median(of["shake"])),
        shake_least=float(of["shake"].min()),
        horizon_seconds=float(of["horizon_seconds"].max()),
        horizon_drift=float(of["horizon_drift"].max()),
        residual_speed=float(of["residual_speed"].max()),
        penetration=float(of["penetration"].max()),
        contacts=float(of["num_contacts"].mean()),
        on_others=sum(map(len, upper)) / max(int(np.array(rows["num_placed"]).sum()), 1),
        margin_median=float(np.median(margin)) if len(margin) else None,
        margin_least=float(margin.min()) if len(margin) else None,
        tilt={by: float(of[f"tilt_{by}"].mean()) for by in ("1", "2", "5")} if has_tilt else {},
        robust=float(of["robust"].mean()) if len(of["robust"]) else None,
    )


def _missing(index: np.ndarray, asked: int) -> tuple[tuple[int, int], ...]:
    """Runs of indices that are asked for and not there."""
    fences = [-1, *(int(each) for each in index if each < asked), asked]
    return tuple((one + 1, two - 1) for one, two in pairwise(fences) if two - one > 1)


def _objects(table: pa.Table) -> tuple[ObjectStats, ...]:
    drawn: Counter[str] = Counter()
    placed: Counter[str] = Counter()
    attempts: Counter[str] = Counter()
    columns = (table[name].to_pylist() for name in ("objects", "is_placed", "attempts"))
    for names, is_placed, tries in zip(*columns, strict=True):
        for name, stands, number in zip(names, is_placed, tries, strict=True):
            asset = base_name(name)
            drawn[asset] += bool(stands or number)
            placed[asset] += stands
            attempts[asset] += number
    return tuple(ObjectStats(name, drawn[name], placed[name], attempts[name]) for name in sorted(drawn))


def _duplicates(table: pa.Table) -> tuple[tuple[int, ...], ...]:
    """Groups of successful scenes with the same objects at the same poses, in whatever order."""
    groups: dict[tuple[tuple[str, bytes], ...], list[int]] = defaultdict(list)
    columns = (table[name].to_pylist() for name in ("index", "is_success", "objects", "poses"))
    for index, is_success, names, poses in zip(*columns, strict=True):
        if is_success:
            stored = [np.array(pose, np.float32).tobytes() for pose in poses]
            groups[tuple(sorted(zip(map(base_name, names), stored, strict=True)))].append(index)
    return tuple(tuple(group) for group in groups.values() if len(group) > 1)


def stats_text(bank: Bank, stats: BankStats) -> str:
    """The same for people."""
    lines = [f"bank       {bank.path}, {_made_by(bank)}", summary_of(bank.table, stats.scenes)]
    lines.append(f"verdicts   {', '.join(f'{number} {name}' for name, number in stats.verdicts.items())}")
    lines.append(
        f"movement   in the last check of scenes that stand: median {small_length(stats.drift_median)}, "
        f"most {small_length(stats.drift_most)}"
    )
    lines += [f"{'' if place else 'clutter':11}{each.line()}" for place, each in enumerate(stats.clutter)]
    if stats.certificate is not None:
        facts = stats.certificate.lines()
        lines += [f"{'' if place else 'certified':11}{fact}" for place, fact in enumerate(facts)]
    runs = ", ".join(f"{first} to {last}" if first < last else f"{first}" for first, last in stats.missing)
    lines.append(f"missing    {runs or 'nothing'} of the {stats.asked} scenes asked for")
    lines.append(f"duplicates {_duplicates_text(stats)}")
    width = max(len(each.name) for each in stats.objects)
    lines.append(f"objects    {'name':{width}}  drawn  placed  attempts each")
    for each in stats.objects:
        mean = each.attempts / max(each.drawn, 1)
        lines.append(f"           {each.name:{width}}  {each.drawn:5d}  {each.placed:6d}  {mean:13.2f}")
    return "\n".join(lines)


def _duplicates_text(stats: BankStats) -> str:
    if not stats.duplicates:
        return "no two scenes that stand are equal"
    shown = "; ".join(" = ".join(map(str, group)) for group in stats.duplicates[:_SHOWN_GROUPS])
    more = ", and others" if len(stats.duplicates) > _SHOWN_GROUPS else ""
    return f"{sum(len(group) - 1 for group in stats.duplicates)} scenes repeat another: {shown}{more}"


def _made_by(bank: Bank) -> str:
    recipe = bank.record["recipe"]
    return f"made by {recipe.get('method')} with seed {recipe.get('seed')} of pool {recipe.get('pool')}"


def summary_of(table: pa.Table, num_scenes: int, num_new: int = 0, seconds: float = 0.0) -> str:
    """Success, attempts, steps to rest and rejections by verdict of the first `num_scenes` rows.

    Args:
      num_new, seconds: scenes made just now and how long that took, for the rate; 0 leaves it out.
    """
    rows = table.slice(0, num_scenes)
    success = np.array(rows["is_success"])
    filled = np.array(rows["is_filled"])
    attempts = np.concatenate([np.array(each) for each in rows["attempts"].to_pylist()])
    steps = np.concatenate([np.array(each) for each in rows["rest_steps"].to_pylist()])
    placed = np.concatenate([np.array(each, bool) for each in rows["is_placed"].to_pylist()])
    # Objects that stood there at the beginning took no attempt.
    placed &= attempts > 0
    mean_attempts = attempts[placed].mean() if placed.any() else 0.0
    mean_steps = steps[placed].mean() if placed.any() else 0.0
    counts = {v: int(np.sum(rows[f"num_{v.label.replace('-', '_')}"])) for v in COUNTED}
    total = max(sum(counts.values()), 1)
    lines = [
        f"scenes     {len(success)}, of which {success.sum()} succeed ({success.mean():.1%}): "
        "every object placed, and all stand together in the last check",
        f"filled     {filled.sum()} ({filled.mean():.1%}) before the last check",
        f"attempts   {attempts.sum()}, {mean_attempts:.2f} per placed object",
        f"rest       after {mean_steps:.0f} steps of 1/240 s in the mean",
    ]
    rejected = [
        f"{number} {verdict.label} ({number / total:.1%}): {verdict.sentence}"
        for verdict, number in counts.items()
        if number and verdict != Verdict.STABLE
    ]
    lines.append("rejected   " + ("\n           ".join(rejected) or "nothing"))
    if num_new and seconds > 0:
        lines.append(f"speed      {num_new} new scenes in {seconds:.1f} s, compilation included")
    return "\n".join(lines)
