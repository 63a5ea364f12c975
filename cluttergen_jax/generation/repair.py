"""Broken layouts from JSON files or a bank, repaired, into a bank or a JSON file."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pyarrow as pa
import pyarrow.csv

from cluttergen_jax.assets import ObjectAsset, find_support
from cluttergen_jax.assets.pool import Pool, find_pool
from cluttergen_jax.assets.support import Ring, SupportAsset, Surface, recorded_ring
from cluttergen_jax.config import REPAIR
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.files import file_whole, write_atomically, writing
from cluttergen_jax.generation.files import write_files
from cluttergen_jax.generation.layouts import FORM, UNITS, LayoutEntry, read_layout_json
from cluttergen_jax.generation.recipe import recipe_of
from cluttergen_jax.geometry import conjugate, transform_points, turn_between
from cluttergen_jax.learning.methods import Method
from cluttergen_jax.physics.margin import OverlapProbe
from cluttergen_jax.placement import MIN_MARGIN, PlacementConfig
from cluttergen_jax.placement.problem import ProblemConfig, Setup, make_setup
from cluttergen_jax.placement.repair import LayoutRepair, RepairConfig
from cluttergen_jax.placement.rollout import BLOCK_SIZE, blocks_of
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.progress import COMPILING, Progress
from cluttergen_jax.scene.bank import Bank, BankRow, BankWriter, read_bank
from cluttergen_jax.scene.bank.card import write_card
from cluttergen_jax.scene.bank.record import INDEX
from cluttergen_jax.scene.bank.scene import missing_text, parse_reference, region_of
from cluttergen_jax.scene.bank.table import rows_of, table_of
from cluttergen_jax.scene.bank.writer import names_of
from cluttergen_jax.schema import digest_of
from cluttergen_jax.types import small_length

_SHOWN = 20


class BrokenLayout(NamedTuple):
    """N objects where they are.

    Attributes:
      source: the file or the scene.
      names: as the source has them; objects: their assets.
      poses: f64[N, 7], T_world_object, metres, wxyz.
      is_in_metres: they are taken for metres as the source states no unit.
    """

    source: str
    names: tuple[str, ...]
    objects: tuple[ObjectAsset, ...]
    poses: np.ndarray
    is_in_metres: bool = False


class LayoutSet(NamedTuple):
    """Broken layouts on one support, and what decides how they are repaired.

    Attributes:
      notes: what is odd in their files.
    """

    layouts: tuple[BrokenLayout, ...]
    support: SupportAsset
    config: ProblemConfig
    notes: tuple[str, ...] = ()


def read_layouts(
    source: str | Path, pool: str | None, support: str | None, scenes: Sequence[int] | None
) -> LayoutSet:
    """The layouts of a bank (failures included), of a JSON file, or of a folder of JSON files.

    Raises:
      ConfigError: nothing is there, a file says something else, or layouts are of several pools or supports.
      BankError, PoolError: a bank, a pool, an object or a support cannot be found or read.
    """
    path = Path(source)
    named = None if path.suffix == ".json" else parse_reference(str(source))
    if named is not None and (
        named[1] is not None or (named[0] / INDEX).is_file() or not path.is_dir()
    ):
        if pool is not None or support is not None:
            raise ConfigError("`pool` or `support` with a bank", "the bank's own", "leaving it out")
        return _layouts_of_bank(read_bank(named[0]), scenes if named[1] is None else [named[1]])
    if scenes is not None:
        raise ConfigError("`scenes` of JSON files", "scenes of a bank", "the files that are meant")
    folder = path / "scenes" if (path / "scenes").is_dir() else path
    files = [path] if path.is_file() else sorted(folder.glob("*.json"))
    if not files:
        raise ConfigError(
            f"{source}, in which there is no layout", f"a bank, or JSON files such as {FORM}"
        )
    return _layouts_of_files(files, pool, support)


def _layouts_of_bank(bank: Bank, numbers: Sequence[int] | None) -> LayoutSet:
    rows = list(bank.scenes() if numbers is None else bank.rows(numbers).values())
    if numbers is not None and len(rows) < len(set(numbers)):
        held = [int(index) for each in bank.tables(["index"]) for index in each["index"].to_numpy()]
        raise ConfigError(
            f"{bank.path}: {missing_text(sorted(set(numbers)), held)}", "scenes of the bank"
        )
    if empty := [row.index for row in rows if not row.objects]:
        raise ConfigError(
            f"{bank.path}: no object stands in scene {empty[0]}", "others", "`scenes`"
        )
    asset_of = lru_cache(maxsize=None)(bank.object)
    recipe = bank.recipe
    layouts = []
    for row in rows:
        objects = tuple(asset_of(base_name(name)) for name in row.objects)
        layouts.append(
            BrokenLayout(
                f"{bank.path.name}:{row.index}", row.objects, objects, row.poses.astype(float)
            )
        )
    config = ProblemConfig(
        pool=str(recipe.get("pool", "")),
        support=str(recipe.get("support", "")),
        region=region_of(bank),
        polygon=recorded_ring(recipe.get("polygon", ())),
        stability=bank.stability,
        contact=bank.contact,
    )
    return LayoutSet(tuple(layouts), bank.support, config)


def _layouts_of_files(files: Sequence[Path], pool: str | None, support: str | None) -> LayoutSet:
    read = {file: read_layout_json(file) for file in files}
    pool = _only("pool", {pool or each.pool for each in read.values()})
    support = _only("support", {support or each.support for each in read.values()})
    # A layout does not say on which of several surfaces its objects are.
    assets = find_pool(pool)
    table = find_support(support).on_surface("all")
    layouts = []
    for file, each in read.items():
        if each.half_extents is not None:
            theirs = np.array(each.half_extents)
            ours = np.array(table.region.half_extents)
            if np.abs(theirs - ours).max() > 1e-4:
                given = (
                    f"{file}: a support with a region of {2 * theirs[0]:g} x {2 * theirs[1]:g} m"
                )
                raise ConfigError(
                    given, f"{2 * ours[0]:g} x {2 * ours[1]:g} m, as {support!r}", "`support`"
                )
        objects = tuple(_asset_of(assets, entry, file) for entry in each.entries)
        names = tuple(e.name for e in each.entries)
        poses = np.array([e.pose for e in each.entries])
        layouts.append(BrokenLayout(file.name, names, objects, poses, each.is_in_metres))
    notes = tuple(note for each in read.values() for note in each.notes)
    return LayoutSet(tuple(layouts), table, ProblemConfig(pool=pool, support=support), notes)


def _asset_of(pool: Pool, entry: LayoutEntry, file: Path) -> ObjectAsset:
    """The object of a pool that an entry names (PoolError, with the file and what it calls the object)."""
    wanted = entry.asset or base_name(entry.name)
    try:
        return pool[wanted]
    except PoolError as error:
        given = f"{file}: {entry.name!r}: {error.given.rstrip('.')}"
        called = [each.name for each in pool.facts if each.label.lower() == wanted.lower()]
        meant = error.meant or next(iter(called), "")
        hint = f'"asset": "{meant or pool.names[0]}" in this object, beside its name'
        raise PoolError(given, error.allowed, hint, meant) from error


def _only(what: str, found: set[str]) -> str:
    """The one pool or support of all layouts."""
    if len(found) > 1 or "" in found:
        given = (
            f"a layout that names no {what}"
            if "" in found
            else f"layouts of the {what}s {sorted(found)}"
        )
        raise ConfigError(given, f"one {what}", f"`{what}`")
    return next(iter(found))


@dataclass(frozen=True, eq=False)
class RepairedLayout:
    """What became of a layout of N objects.

    Attributes:
      layout: as it was; verdict: the last word on it.
      poses: f64[N, 7], where they are now; as given where an object could not be placed.
      is_placed: bool[N].
      is_stable: all are placed, and stand together in the final check.
      reasons: why each could not be placed, "" where it could.
      hint: what its positions may have been meant as, "" where that is not plain.
    """

    layout: BrokenLayout
    verdict: str
    poses: np.ndarray
    is_placed: np.ndarray
    is_stable: bool
    reasons: tuple[str, ...]
    hint: str

    @property
    def shift(self) -> np.ndarray:
        """f64[N], metres from where they were."""
        return np.linalg.norm(self.poses[:, :3] - self.layout.poses[:, :3], axis=1)

    @property
    def turn(self) -> np.ndarray:
        """f64[N], radians."""
        return turn_between(np, self.poses[:, 3:], self.layout.poses[:, 3:])

    def records(self) -> list[dict[str, Any]]:
        """What became of each object, as JSON values."""
        layout = self.layout
        each_one = zip(self.poses.tolist(), self.is_placed.tolist(), strict=True)
        motion = zip(self.shift.tolist(), self.turn.tolist(), strict=True)
        return [
            {
                "name": name,
                "asset": asset.name,
                "position": pose[:3],
                "quaternion_wxyz": pose[3:],
                "is_placed": is_placed,
                "shift": shift,
                "turn": turn,
                "reason": reason,
            }
            for name, asset, (pose, is_placed), (shift, turn), reason in zip(
                layout.names, layout.objects, each_one, motion, self.reasons, strict=True
            )
        ]

    def __str__(self) -> str:
        if self.is_stable:
            return f"{self.layout.source}: stable"
        names = [
            f"{name} ({why})"
            for name, why in zip(self.layout.names, self.reasons, strict=True)
            if why
        ]
        why = (
            f"no stable place near its own for {', '.join(names)}"
            if names
            else f"{self.verdict} as a whole"
        )
        why += f"; {self.hint}" if self.hint else ""
        return f"not repaired: {self.layout.source}: {why}"


@dataclass(frozen=True, eq=False)
class RepairReport:
    """What `repair` did; printed, it says what is stable now, what moved by how much, what is left broken.

    Attributes:
      path: the bank or the file that was written.
      layouts: in the order of the source.
      notes: what is odd in their files.
    """

    path: Path
    layouts: tuple[RepairedLayout, ...]
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> pa.Table:
        """A row for each object: its layout and name, whether it could be placed, metres and radians."""
        return pa.Table.from_pylist(
            [
                {"layout": each.layout.source, "is_stable": each.is_stable, **record}
                for each in self.layouts
                for record in each.records()
            ]
        ).drop_columns(["position", "quaternion_wxyz"])

    def __str__(self) -> str:
        moved = [
            record for each in self.layouts for record in each.records() if record["is_placed"]
        ]
        stable = sum(each.is_stable for each in self.layouts)
        lines = [f"{stable} of {len(self.layouts)} layouts are stable now, in {self.path}"]
        if moved:
            shift, turn = (
                np.array([record[name] for record in moved]) for name in ("shift", "turn")
            )
            lines.append(
                f"motion of {len(moved)} objects: median {small_length(np.median(shift))} and "
                f"{np.degrees(np.median(turn)):.1f} deg, most {small_length(shift.max())} and "
                f"{np.degrees(turn.max()):.1f} deg"
            )
        if len(self.layouts) == 1:
            each_one = ((r["name"], small_length(r["shift"]), np.degrees(r["turn"])) for r in moved)
            lines += [f"  {name}: {shift}, {turn:.1f} deg" for name, shift, turn in each_one]
        broken = [str(each) for each in self.layouts if not each.is_stable]
        return "\n".join([*lines, *_shorten(broken), *_shorten(list(self.notes))])


def _shorten(lines: list[str]) -> list[str]:
    return lines[:_SHOWN] + ([f"and {len(lines) - _SHOWN} more"] if len(lines) > _SHOWN else [])


def repair_layouts(
    given: LayoutSet, out: Path, limits: RepairConfig, overwrite: bool
) -> RepairReport:
    """See `cluttergen_jax.repair`."""
    if out.suffix == ".json" and len(given.layouts) > 1:
        raise ConfigError(
            f"out = '{out}' for {len(given.layouts)} layouts", "a bank", "out='repaired'"
        )
    if out.suffix == ".json" and out.exists() and not overwrite:
        raise ConfigError(
            f"out = '{out}', which exists", "a new file", "another name, or `overwrite`"
        )
    setup, indices = _setup_of(given)
    world = setup.problem.world
    mend = LayoutRepair(setup, limits)
    probe = OverlapProbe(world.layout)
    half_extents = np.asarray(setup.problem.rules.geometry.half_extents)

    def row_of(number: int) -> pa.Table:
        scene = mend(indices[number], given.layouts[number].poses)
        batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], scene)
        progress.update()
        return table_of(np.array([number]), batch, world.names, half_extents)

    def report(path: Path, rows: Iterable[BankRow]) -> RepairReport:
        compare = partial(_compare, world.names, given.support, limits.max_shift, probe)
        return RepairReport(path, tuple(map(compare, given.layouts, indices, rows)), given.notes)

    with Progress("repairing", len(given.layouts), "layout") as progress:
        progress.note(COMPILING)
        if out.suffix == ".json":
            found = report(out, rows_of(row_of(0)))
            (only,) = found.layouts
            record = {
                "pool": given.config.pool,
                "support": given.config.support,
                "is_stable": only.is_stable,
            }
            data = json.dumps(record | {"objects": only.records()}, indent=1) + "\n"
            write_atomically(out, data.encode())
            return found
        poses = b"".join(each.poses.tobytes() + repr(each.names).encode() for each in given.layouts)
        recipe = recipe_of(setup.problem, Method(REPAIR), seed=None)
        recipe |= {
            # Where it has always stood among the others.
            "keep_out": recipe.pop("keep_out"),
            "limits": asdict(limits),
            "layouts": digest_of(poses),
        }
        objects = names_of(world.objects)
        with BankWriter(
            out, recipe, len(given.layouts), objects, world.support, overwrite
        ) as writer:
            for block, number in blocks_of(len(given.layouts)):
                if writer.has_block(block, number):
                    progress.update(number)
                    continue
                rows = map(row_of, range(block * BLOCK_SIZE, block * BLOCK_SIZE + number))
                writer.write_block(block, pa.concat_tables(rows).combine_chunks())
            writer.finish()
            bank = read_bank(writer.path)
            found = report(bank.path, bank.scenes())
            with writing(bank.path):
                write_files(
                    bank, len(found.layouts), setup.problem.config, False, writer.keep_digests
                )
                write_card(read_bank(bank.path))
                with file_whole(bank.path / "repair.csv") as fresh:
                    pyarrow.csv.write_csv(found.rows, fresh)
    return found


def _setup_of(given: LayoutSet) -> tuple[Setup, list[list[int]]]:
    """The problem of one world with the objects of all layouts, and which of these each layout has."""
    assets = {asset.name: asset for each in given.layouts for asset in each.objects}
    most: Counter[str] = Counter()
    for each in given.layouts:
        most |= Counter(asset.name for asset in each.objects)
    names = [name for name, number in most.items() for _ in range(number)]
    number = max(len(each.names) for each in given.layouts)
    config = replace(
        given.config,
        placement=PlacementConfig(
            num_objects=number, order="fixed", min_margin=MIN_MARGIN, history_stride=0
        ),
        stability=replace(given.config.stability, both_detectors=True),
        repeat=True,
        engine="native",
    )
    setup = make_setup(config, assets=([assets[name] for name in names], given.support))
    indices = []
    for each in given.layouts:
        free = {name: [i for i, other in enumerate(names) if other == name] for name in most}
        indices.append([free[asset.name].pop(0) for asset in each.objects])
    return setup, indices


def _compare(
    names: Sequence[str],
    support: SupportAsset,
    max_shift: float,
    probe: OverlapProbe,
    layout: BrokenLayout,
    indices: Sequence[int],
    row: BankRow,
) -> RepairedLayout:
    """A layout before and after."""
    placed = dict(zip(row.objects, row.poses.astype(float), strict=True))
    is_placed = np.array([names[index] in placed for index in indices])
    poses = np.array(
        [placed.get(names[i], pose) for i, pose in zip(indices, layout.poses, strict=True)]
    )
    overlaps: list[dict[str, float]] = [{} for _ in layout.names]
    if not is_placed.all():
        overlaps = _overlaps_of(layout, indices, len(names), probe)
    reasons = tuple(
        "" if there else reason_without_place(asset, pose, support, max_shift, overlap)
        for asset, pose, there, overlap in zip(
            layout.objects, layout.poses, is_placed, overlaps, strict=True
        )
    )
    hint = ""
    if any(reasons):
        hint = hint_for_positions(layout.objects, layout.poses, support, layout.is_in_metres)
    return RepairedLayout(layout, row.verdict, poses, is_placed, row.is_success, reasons, hint)


def _overlaps_of(
    layout: BrokenLayout, indices: Sequence[int], num_objects: int, probe: OverlapProbe
) -> list[dict[str, float]]:
    """Of each object of a layout as it was given, metres by which it overlaps others, the deepest first."""
    poses = np.zeros((num_objects, 7))
    poses[:, 3] = 1.0
    poses[list(indices)] = layout.poses
    depths = probe.depths(poses, np.isin(np.arange(num_objects), list(indices)))
    if depths is None:
        return [{} for _ in indices]
    found = []
    for index in indices:
        own = depths[index, list(indices)]
        order = [place for place in np.argsort(-own) if own[place] > _OVERLAPS]
        found.append({layout.names[place]: float(own[place]) for place in order})
    return found


_OVERLAPS = 0.001
"""Metres from which an overlap is worth a word."""
_MOST_OVERLAPS = 3
_NEAR = 0.15
"""Metres above or below a surface within which an object counts as meant to be on it."""


def reason_without_place(
    asset: ObjectAsset,
    pose: np.ndarray,
    support: SupportAsset,
    max_shift: float,
    overlaps: Mapping[str, float] | None = None,
) -> str:
    """Why an object at a pose, f64[7], finds no place on a support within `max_shift` metres.

    Args:
      overlaps: the objects that it overlaps there, and by how many metres, the deepest first.
    """
    surface, beyond, gap = _nearest(asset, pose, support)
    where = (
        f"{support.name!r}"
        if len(support.surfaces) == 1
        else f"{surface.name!r} of {support.name!r}"
    )
    said = [f"{beyond:.2f} m beyond the edge of {where}"] if beyond > 0 else []
    top = f"the top of {where}"
    if gap < -max_shift:
        said.append(f"{-gap:.2f} m under {top}")
    elif gap > max_shift:
        said.append(f"{gap:.2f} m above {top}")
    no_room = f"too little room within {max_shift:g} m, or it does not stay there"
    if overlaps:
        deepest = list(overlaps.items())[:_MOST_OVERLAPS]
        parts = [f"{name!r} by {1000 * depth:.0f} mm" for name, depth in deepest]
        more = len(overlaps) - len(deepest)
        parts += [f"{more} more"] if more else []
        return " and ".join([*said, f"overlaps {', '.join(parts)}"]) + (
            "" if said else f": {no_room}"
        )
    return " and ".join(said) or no_room


def hint_for_positions(
    objects: Sequence[ObjectAsset], poses: np.ndarray, support: SupportAsset, is_in_metres: bool
) -> str:
    """What the positions f64[N, 7] of a layout may have been meant as; "" where that is not plain.

    Args:
      is_in_metres: they are taken for metres although no unit is stated.
    """
    if _fit(objects, poses, support):
        return ""
    for unit, factor in UNITS.items() if is_in_metres else ():
        scaled = poses.copy()
        scaled[:, :3] *= factor
        if factor != 1.0 and _fit(objects, scaled, support):
            return f'in {unit} all positions would be on it: is "unit": "{unit}" missing?'
    lifted = poses.copy()
    lifted[:, 2] += support.top
    if _fit(objects, lifted, support):
        height = f"{support.top:g} m"
        return f"is z measured from its top? It counts from the floor: {height} higher all would be on it"
    return ""


def _fit(objects: Sequence[ObjectAsset], poses: np.ndarray, support: SupportAsset) -> bool:
    """Whether all objects are over a surface, and near it."""
    found = [_nearest(asset, pose, support) for asset, pose in zip(objects, poses, strict=True)]
    return all(beyond == 0 and abs(gap) <= _NEAR for _, beyond, gap in found)


def _nearest(
    asset: ObjectAsset, pose: np.ndarray, support: SupportAsset
) -> tuple[Surface, float, float]:
    """The surface that an object is nearest to; metres beyond its edge, and above it, negative below."""
    points = transform_points(pose, np.concatenate([part.vertices for part in asset.parts]))
    center = transform_points(pose, np.asarray(asset.center_of_mass)[None])
    found = []
    for surface in support.surfaces:
        back = conjugate(np.array(surface.quaternion))
        home = np.array(
            [
                *transform_points(np.array([0, 0, 0, *back]), -np.array(surface.position)[None])[0],
                *back,
            ]
        )
        gap = float(transform_points(home, points)[:, 2].min())
        found.append(
            (surface, _beyond(surface.outline, transform_points(home, center)[0, :2]), gap)
        )
    return min(found, key=lambda each: np.hypot(each[1], each[2]))


def _beyond(outline: Ring, point: np.ndarray) -> float:
    """Metres from f64[2] to a ring around it; 0 within."""
    start = np.array(outline, np.float64)
    end = np.roll(start, -1, axis=0)
    along = end - start
    share = ((point - start) * along).sum(1) / np.maximum((along**2).sum(1), 1e-12)
    nearest = start + share.clip(0, 1)[:, None] * along
    crosses = (start[:, 1] > point[1]) != (end[:, 1] > point[1])
    height = np.where(crosses, along[:, 1], 1.0)
    x = start[:, 0] + (point[1] - start[:, 1]) / height * along[:, 0]
    is_inside = bool((crosses & (x > point[0])).sum() % 2)
    return 0.0 if is_inside else float(np.linalg.norm(nearest - point, axis=1).min())
