"""The commands about pools and supports: imported, listed, shown, measured, and removed."""

from __future__ import annotations

import math
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from cluttergen_jax.api.import_ import import_pool, import_support
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import Options, command
from cluttergen_jax.errors import ClutterGenError, ConfigError, range_text
from cluttergen_jax.tables import aligned_table

if TYPE_CHECKING:
    from cluttergen_jax.assets.object import ObjectAsset
    from cluttergen_jax.assets.pool import Pool
    from cluttergen_jax.assets.support import SupportAsset
    from cluttergen_jax.importing.poses import Pose
    from cluttergen_jax.importing.run import ImportReport
    from cluttergen_jax.importing.scenery import LeftOut

_PAGE = 100
_SHOWN = ("object", "size mm", "scale", "mass kg", "friction", "licence", "what people call it")
_POSES = ("pose", "mm tall", "degrees from now", "tips over at", "of random falls")
_MEASURED = (
    *("object", "size mm", "scale", "mass kg", "parts", "vertices"),
    *("deviation", "cavity", "ball", "solo", "steps", "poses"),
)
_MOST_ALIKE = 4
_NAMES_AND_NUMBERS = re.compile(r"'[^']*'|\S+\.\w+|\d[\d,.]*")


@command()
def run_pool(
    action: Positional[Literal["list", "show", "pose", "remove"]],
    names: Positional[tuple[str, ...]] = (),
    *,
    objects: tuple[str, ...] = (),
    graspable: str = "",
    page: int = 1,
) -> None:
    """List pools, show what one holds, remove your own, or change an object's pose: cluttergen pool list.

    Example: `cluttergen pool show dining+study`. `cluttergen pool pose mine mug` lists the poses of a mug,
    `cluttergen pool pose mine mug 1` puts it into the first other one.

    Args:
      action: list, show, pose or remove.
      names: of the pools. To show: names or folders, a+b for a union, a~mug for all but mug. For poses: the
        pool, the object, and the number of a pose to take.
      objects: to show: only these, by names, patterns and conditions: "mug*", "label=*book* and mass<0.5".
      graspable: to show: only what the hand of a robot can hold, by its name or file (extra `robot`).
      page: to show: which hundred objects of each.
    """
    from cluttergen_jax.assets.facts import chosen_names
    from cluttergen_jax.assets.pool import find_pool
    from cluttergen_jax.graspable import graspable_names

    if bool(names) == (action == "list"):
        raise ConfigError(
            f"pool {action} {' '.join(names)}".rstrip(),
            "no name" if action == "list" else "one name or more",
            f"cluttergen pool {action}{'' if action == 'list' else ' NAME'}",
        )
    if action == "list":
        _list()
    elif action == "pose":
        _pose(names)
    elif action == "remove":
        _remove(names)
    else:
        for name in names:
            pool = find_pool(name)
            chosen = chosen_names(pool.facts, objects, name) if objects else pool.names
            chosen = graspable_names(name, chosen, graspable) if graspable else chosen
            _show(pool, chosen, page)


def _list() -> None:
    from cluttergen_jax.assets.pool import EMBEDDED, list_pools, read_pool

    for name, folder in list_pools().items():
        try:
            pool = read_pool(folder)
        except ClutterGenError as error:
            print(f"{name:16} damaged: {error}")
            continue
        flagged = sum(each.flagged for each in pool.facts)
        place = "embedded" if name in EMBEDDED else str(folder)
        print(f"{name:16} {len(pool):3} objects, {flagged} flagged, tier {pool.tier}, {place}")
        print(f"{'':16} licence: {pool.licence or 'not stated'}")


def _show(pool: Pool, chosen: Sequence[str], page: int) -> None:
    from cluttergen_jax.assets.pool import MOST_READ

    pages = -(-len(chosen) // _PAGE)
    if not 1 <= page <= pages:
        raise ConfigError(f"page = {page}", range_text(1, pages), "page=1")
    objects = [pool[name] for name in chosen[(page - 1) * _PAGE : page * _PAGE]]
    # Of very many objects the digest of all would have to be made by reading all.
    content = f", content {pool.hash[:12]}" if len(pool) <= MOST_READ else ""
    print(f"pool {pool.name}: {len(pool)} objects, tier {pool.tier}{content}")
    if len(chosen) < len(pool):
        print(f"{len(chosen)} of them are chosen")
    print(_left_table([_SHOWN, *(_shown_row(asset) for asset in objects)]))
    for line in (*_flags(objects), *_credits(objects)):
        print(line)
    if pages > 1:
        print(f"page {page} of {pages}; another: --page N; some: --objects 'mug* and mass<0.5'")


def _shown_row(asset: ObjectAsset) -> tuple[str, ...]:
    friction = "-" if asset.friction is None else f"{asset.friction:g}"
    numbers = size_text(asset), f"{asset.scale:g}", f"{asset.mass:.3f}", friction
    return asset.name, *numbers, asset.provenance.licence, asset.label


def _flags(objects: Sequence[ObjectAsset]) -> Iterator[str]:
    return (f"  ! {asset.name}: {flag}" for asset in objects for flag in asset.flags)


def _credits(objects: Sequence[ObjectAsset]) -> list[str]:
    """Each attribution that a licence asks for, once."""
    return [
        f"  {each}"
        for each in dict.fromkeys(asset.provenance.attribution for asset in objects)
        if each
    ]


def _remove(names: Sequence[str]) -> None:
    from cluttergen_jax.assets.pool import remove_pool, user_pool_folder

    # All of them are looked up before the first is removed.
    folders = {name: user_pool_folder(name) for name in names}
    for name, folder in folders.items():
        pool = remove_pool(name)
        held = "damaged" if pool is None else f"{len(pool)} objects: {', '.join(pool.names)}"
        print(f"removed pool {name} ({held}) from {folder}")


def _pose(words: Sequence[str]) -> None:
    """Lists an object's poses; with a number behind pool and object, after it was put into that one."""
    from cluttergen_jax.importing.poses import pool_poses, set_pose

    if len(words) not in (2, 3) or not all(word.isdecimal() for word in words[2:]):
        raise ConfigError(
            f"pool pose {' '.join(words)}",
            "a pool, one of its objects, and the number of a pose (0 or more) to change it",
            "cluttergen pool pose POOL OBJECT",
        )
    pool, name, *number = words
    if number:
        asset = set_pose(pool, name, int(number[0]))
        tall = 2000 * asset.half_extents[2]
        rate = 100 * (asset.quality.solo_rate or 0.0)
        print(f"{name} now stands so: {tall:.0f} mm tall, stable in {rate:.1f} % of trials")
        print("\n".join(f"  ! {flag}" for flag in asset.flags), end="\n" if asset.flags else "")
    print(
        aligned_table(_POSES, [_pose_row(k, each) for k, each in enumerate(pool_poses(pool, name))])
    )


def _pose_row(number: int, each: Pose) -> tuple[str, ...]:
    turn = math.degrees(math.acos(max(-1.0, min(1.0, each.up[2])))) if number else 0.0
    return (
        str(number) if number else "0 (now)",
        f"{1000 * each.height:.0f}",
        f"{turn:.0f}",
        f"{each.tip:.0f}",
        f"{100 * each.likelihood:.0f} %",
    )


@command()
def run_list() -> None:
    """List pools and their objects, supports, layouts, robots and checkpoints.

    Example: `cluttergen list`
    """
    from cluttergen_jax.assets.pool import ALL, EMBEDDED, list_pools, read_pool
    from cluttergen_jax.assets.support_file import list_supports
    from cluttergen_jax.downstream.robot.description import find_robot, list_robots
    from cluttergen_jax.generation.layouts import list_layouts, read_layout
    from cluttergen_jax.learning.policies.embedded import list_policies

    print("pools")
    for name, path in list_pools().items():
        try:
            pool = read_pool(path)
            names = ", ".join(f"{n}*" if pool[n].flags else n for n in pool.names)
            print(f"  {name:12} {len(pool):3} objects: {names}")
        except ClutterGenError as error:
            print(f"  {name:12} damaged: {error}")
    print(f"  {ALL:12}     the union of {', '.join(EMBEDDED)}")
    print(
        "  (* flagged: `cluttergen inspect POOL` says why; a+b is the union of two, a~mug leaves mug out)"
    )
    print("supports")
    for name in list_supports():
        print(f"  {name}")
    print(
        "  table-WxD[xH] is a cuboid of that size in metres, such as table-0.40x0.50; bin-WxD[xH],"
    )
    print(
        "  tote-WxD[xH] and tray-WxD[xH] are containers of that size inside, such as bin-0.50x0.30x0.20"
    )
    print("layouts, of `cluttergen generate --layout`")
    for name in list_layouts():
        print(f"  {name:20} {len(read_layout(name).relations)} relations")
    print("robots, of `cluttergen robot` and `cluttergen rearrange`")
    for name in list_robots():
        try:
            find_robot(name)
            print(f"  {name}")
        except ClutterGenError as error:
            print(f"  {name:12} {error}")
    print("trained checkpoints, POOL-METHOD, or METHOD alone where one serves any pool")
    for name in list_policies():
        print(f"  {name}")
    if not list_policies():
        print("  none yet: cluttergen train makes one")


@command()
def run_inspect(
    pool: Positional[str],
    out: Path | None = None,
    *,
    objects: tuple[str, ...] = (),
    exclude: tuple[str, ...] = (),
    columns: int = 4,
    grasps: bool = False,
) -> None:
    """Show what was measured about objects of a pool, or surfaces of a support; draw it.

    Example: `cluttergen inspect dining --out dining.png`

    Args:
      pool: a pool's name or folder, or several joined by +; or a support's name or folder, of which surfaces
        are listed, and drawn with their numbers.
      out: write a contact sheet to this PNG file; or to an HTML file a page to scroll through, flagged
        objects first, with a picture of each and what was measured.
      objects: only these, by names, patterns and conditions: "mug*", "label=*book* and mass<0.5".
      exclude: all but these.
      columns: objects in a row of the sheet.
      grasps: draw grasps of the Panda's hand about each object instead (extra `robot`); those that are not
        kept are found first, as `robot grasps` does.
    """
    from cluttergen_jax.assets.pool import list_pools
    from cluttergen_jax.assets.support_file import find_support, is_support
    from cluttergen_jax.files import check_file
    from cluttergen_jax.kept_folder import hold_file

    check_file(out, "out", f"{pool}.png")
    with hold_file(out):
        # A pool comes before a support of the same name.
        if pool in list_pools() or not is_support(pool):
            _inspect_pool(pool, out, objects, exclude, columns, grasps)
        elif objects or exclude or grasps or (out is not None and out.suffix != ".png"):
            support = find_support(pool)
            raise ConfigError(
                f"options about objects, or an HTML page, with support {support.name!r}",
                "its name, and --out with a PNG file",
                f"cluttergen inspect {pool} --out {support.name}.png",
            )
        else:
            _inspect_support(find_support(pool), out)


def _inspect_pool(
    name: str,
    out: Path | None,
    objects: Sequence[str],
    exclude: tuple[str, ...],
    columns: int,
    grasps: bool,
) -> None:
    from cluttergen_jax.assets.facts import chosen_names
    from cluttergen_jax.assets.pool import find_pool
    from cluttergen_jax.rendering.sheet import save_png

    pool = find_pool(name, exclude)
    chosen = chosen_names(pool.facts, objects, name) if objects else pool.names
    assets = tuple(pool[each] for each in chosen)
    is_page = out is not None and out.suffix == ".html"
    if is_page and grasps:
        raise ConfigError("--grasps with an HTML page", "a PNG file", f"--out {name}.png")
    print(f"pool {pool.name}, licence: {pool.licence or 'not stated'}, content {pool.hash[:12]}")
    print(pool_table(assets))
    if grasps:
        from cluttergen_jax.downstream.robot.api import robot_grasps

        print(sets := robot_grasps(name, [asset.name for asset in assets]))
    if out is None:
        return
    if is_page:
        from cluttergen_jax.rendering.assets import write_pool_report

        print(write_pool_report(out, pool, assets))
    elif grasps:
        from cluttergen_jax.downstream.robot.grasping.grasps import grasp_sheet

        print(save_png(grasp_sheet(assets, sets, columns), out))
    else:
        from cluttergen_jax.rendering.assets import object_sheet

        print(save_png(object_sheet(assets, columns), out))


def _inspect_support(support: SupportAsset, out: Path | None) -> None:
    solids = f"{len(support.boxes)} boxes, {len(support.parts)} convex parts"
    print(f"support {support.name} ({support.label}), collision: {solids}")
    print(surface_table(support))
    if out is not None:
        from cluttergen_jax.rendering.assets import support_sheet
        from cluttergen_jax.rendering.sheet import save_png

        print(save_png(support_sheet(support), out))


def pool_table(objects: Sequence[ObjectAsset]) -> str:
    """One line per object, then flags (!) and notes (-) in words, then the counts of the project's bars.

    Of many notes that differ in names and numbers alone, the first is told, and how many there are.
    """
    lines = [aligned_table(_MEASURED, [_measured_row(asset) for asset in objects])]
    lines += [f"  ! {asset.name}: {flag}" for asset in objects for flag in asset.flags]
    lines += _notes(objects)
    return "\n".join([*lines, _summary(objects)])


def _notes(objects: Sequence[ObjectAsset]) -> Iterator[str]:
    kinds: defaultdict[str, list[tuple[str, str]]] = defaultdict(list)
    for asset in objects:
        for note in asset.notes:
            kinds[_NAMES_AND_NUMBERS.sub("#", note)].append((asset.name, note))
    for alike in kinds.values():
        shown = alike if len(alike) <= _MOST_ALIKE else alike[:1]
        yield from (f"  - {name}: {note}" for name, note in shown)
        if len(shown) < len(alike):
            owners = {name for name, _ in alike}
            of = f"{len(owners)} objects" if len(owners) > 1 else alike[0][0]
            yield f"    ... and {len(alike) - 1} more notes like it, of {of} (`ObjectAsset.notes` has all)"


def _measured_row(asset: ObjectAsset) -> tuple[str, ...]:
    quality = asset.quality
    ball = {None: "-", True: "held", False: "lost"}[quality.holds_ball]
    return (
        asset.name,
        size_text(asset),
        f"{asset.scale:g}",
        f"{asset.mass:.3f}",
        str(len(asset.parts)),
        str(sum(len(part.vertices) for part in asset.parts)),
        _percent(quality.deviation),
        _percent(quality.cavity_fill),
        ball,
        _percent(quality.solo_rate),
        "-" if quality.solo_steps is None else f"{quality.solo_steps:.1f}",
        str(len(asset.resting)),
    )


def size_text(asset: ObjectAsset) -> str:
    """Its three sides in millimetres, in its resting pose."""
    return " x ".join(f"{2000 * half:.0f}" for half in asset.half_extents)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _summary(objects: Sequence[ObjectAsset]) -> str:
    qualities = [asset.quality for asset in objects]
    hollow = [quality for quality in qualities if quality.cavity_fill is not None]
    is_open = [quality.cavity_fill <= 0.2 and bool(quality.holds_ball) for quality in hollow]  # type: ignore[operator]
    solo = sum(quality.solo_rate is not None and quality.solo_rate >= 0.99 for quality in qualities)
    near = sum(quality.deviation is not None and quality.deviation <= 0.05 for quality in qualities)
    return (
        f"{len(objects)} objects, tier {objects[0].tier}: {solo} stand alone in 99 % of trials or more, "
        f"{near} deviate by 5 % or less, {sum(is_open)} of {len(hollow)} hollow ones are open, "
        f"{sum(bool(asset.flags) for asset in objects)} flagged"
    )


def surface_table(support: SupportAsset) -> str:
    """A row for each surface: number, name, height, slope, area, region, free height; metres, degrees."""
    rows = [("", "surface", "height", "slope", "area", "region", "free height above")]
    for number, each in enumerate(support.surfaces, 1):
        x, y = each.region.half_extents
        free = "open" if math.isinf(each.free_height) else f"{each.free_height:.3f} m"
        slope = "level" if each.is_level else f"{math.degrees(each.tilt):.1f} deg"
        rows.append(
            (
                str(number),
                each.name,
                f"{each.position[2]:.3f} m",
                slope,
                f"{each.area:.3f} m^2",
                f"{2 * x:.2f} x {2 * y:.2f} m",
                free,
            )
        )
    return _left_table(rows)


def _left_table(rows: Sequence[Sequence[str]]) -> str:
    """Columns of equal width, all flush left."""
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
    return "\n".join(lines)


@command(
    import_pool,
    import_support,
    sources=Positional[tuple[str, ...]],
    pool=str | None,
    support=str | None,
    licence=Annotated[str, arg(aliases=["--license"])],
    everyday="pool support scale up density mass licence set settings add force jobs",
)
def run_import(options: Options) -> int:
    """Import objects as a pool, or a table: OBJ, STL, PLY, GLB, GLTF, DAE, URDF, SDF, MJCF, or `ycb`.

    Example: `cluttergen import my_meshes/ --pool mine --scale 0.001`
    """
    if options.support is not None:
        _import_support(options)
        return 0
    if options.pool is None or options.name is not None:
        raise ConfigError(
            "import with neither --pool nor --support"
            if options.pool is None
            else "--name with --pool",
            "SOURCES --pool NAME for objects, or --support FILE [--name NAME] for a table",
        )
    report = options.call(import_pool)
    print_report(report, options)
    # An object could not be imported, or none was.
    return 1 if report.failures or not report.objects else 0


def _import_support(options: Options) -> None:
    from cluttergen_jax.assets.support_file import user_supports

    if options.sources or options.pool is not None:
        raise ConfigError(
            "--support together with sources or --pool", "one of them", "two commands"
        )
    ignored = ("decomposition", "jobs", "time_limit", "progress", "cluster", "workers")
    hint = "leaving it out: a table is not an object"
    support = options.call(import_support, "with --support", hint, ignored)
    x, y = support.region.half_extents
    parts = f" and {len(support.parts)} convex parts" if support.parts else ""
    print(
        f"{user_supports() / support.name}: top at {support.top:.3f} m, "
        f"made of {len(support.boxes)} boxes{parts}; "
        f"the queried region is {2 * x:.3f} x {2 * y:.3f} m\nUse it: --support {support.name}"
    )
    if len(support.surfaces) > 1:
        print(surface_table(support))
        print(f"See them: cluttergen inspect {support.name} --out {support.name}.png")


_MOST_DEAR = 3
"""So many objects are named for what they cost."""

_OF_POSES = (
    "  (an object in a pose that you do not want: `cluttergen pool pose POOL OBJECT` lists its\n"
    '  poses and changes it; --up file, or up = "file" in objects.toml, keeps those of the files)'
)


def print_report(report: ImportReport, options: Any) -> None:
    """What was made, which axes were taken for up, what was skipped, left out, and what failed, and why.

    Args:
      options: the options of the command, whose flags are named.
    """
    if report.objects:
        print(with_flags(pool_table(report.objects), options))
        made = len(report.objects) - report.num_cached
        print(
            f"{report.path}: {len(report.objects)} objects ({made} made, {report.num_cached} from the cache)"
        )
    else:
        print("no object was made: why, stands below", file=sys.stderr)
    for line in report.sets:
        print(f"{line} (--set none goes by the general rules)")
    if report.costs:
        print(_cost_line(report))
    for (axis, reason), names in _group_rows(
        [(each.axis, each.reason, n) for n, each in report.up_axes.items()]
    ):
        print(f"up is {axis} ({with_flags(reason, options)}): {names}")
    if report.objects:
        print(_OF_POSES)
    print(with_flags(_unused_text(report), options), end="")
    pieces = [each for each in report.skipped if each.is_piece]
    if pieces:
        are = "file is a piece" if len(pieces) == 1 else "files are pieces"
        print(f"{len(pieces)} {are} of these objects (`ImportReport.skipped` has each)")
    others = [each for each in report.skipped if not each.is_piece]
    if others:
        print(f"{len(others)} skipped:")
        for (reason,), names in _group_rows([(each.reason, each.name) for each in others]):
            print(f"  {with_flags(reason, options)}: {names}")
    print(with_flags(left_out_text(report.left_out), options), end="")
    if report.failures:
        print(f"{len(report.failures)} failed:", file=sys.stderr)
        for failure in report.failures:
            # A source that could not be found is named in its reason already.
            is_named = failure.reason.startswith(failure.name)
            reason = with_flags(failure.reason, options)
            print(f"  {reason if is_named else f'{failure.name}: {reason}'}", file=sys.stderr)


def _unused_text(report: ImportReport) -> str:
    """What is stated beside objects and not used: that of objects that are made stands with their flags."""
    if not report.unused:
        return ""
    flags = {flag for asset in report.objects for flag in asset.flags}
    others = [each for each in report.unused if each.partition(": ")[2] not in flags]
    is_one = len(report.unused) == 1
    head = f"{len(report.unused)} {'statement' if is_one else 'statements'} in JSON beside objects not used"
    lines = [f"  ! {each}" for each in others[:_MOST_NAMED]]
    if len(others) > _MOST_NAMED:
        lines.append(f"  and {len(others) - _MOST_NAMED} more (`ImportReport.unused` has each)")
    seen = " (marked ! above)" if len(others) < len(report.unused) else ""
    return "\n".join([f"{head}{seen}{':' if lines else ''}", *lines, ""])


def _cost_line(report: ImportReport) -> str:
    """What all objects cost together, and which of them most."""
    dear = sorted(report.costs, key=lambda name: -report.costs[name].seconds)[:_MOST_DEAR]
    dearest = ", ".join(f"{name} {report.costs[name].seconds:.1f} s" for name in dear)
    together = f"{report.cost.seconds:.1f} s of work, {report.cost.cpu_seconds:.1f} CPU-seconds"
    return f"cost: {together}; most: {dearest}" if len(report.costs) > 1 else f"cost: {together}"


def _group_rows(rows: Sequence[tuple[str, ...]]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Rows that agree in all but the last entry, which is a name: what they agree in, and the names."""
    for head, group in groupby(sorted(rows), key=lambda row: row[:-1]):
        yield head, ", ".join(row[-1] for row in group)


_MOST_NAMED = 8
"""So many of what was left out for one reason are named; `ImportReport.left_out` has them all."""
_MANY_FILES = 3


def left_out_text(left_out: Sequence[LeftOut]) -> str:
    """One block, or nothing; options are called as the arguments of `import_pool`."""
    if not left_out:
        return ""
    lines = [f"{len(left_out)} left out, as no objects for a table:"]
    for reason in dict.fromkeys(each.reason for each in left_out):
        lines.append(
            f"  {reason}: {_names_text([each for each in left_out if each.reason == reason])}"
        )
    one = f"[{_one_of(left_out)!r}] take = true"
    return "\n".join(
        [*lines, f"  (`take_all` takes them all; objects.toml takes one of them: {one})", ""]
    )


def _one_of(left_out: Sequence[LeftOut]) -> str:
    """The name of one object, for an example: of what holds several only one of these."""
    from cluttergen_jax.importing.scenery import SEVERAL

    whole = next((each.name for each in left_out if each.reason != SEVERAL), "")
    return whole or left_out[0].detail.split(", ")[0]


def _names_text(group: Sequence[LeftOut]) -> str:
    """The first few by name; bodies that many files have, once."""
    bodies = [each.name.rpartition("#")[2] for each in group]
    files = Counter(bodies)
    shown = {}
    for each, body in zip(group, bodies, strict=True):
        if files[body] >= _MANY_FILES and body != each.name and not body.isdigit():
            shown[body] = f"{body} in {files[body]} files"
        else:
            shown[each.name] = each.name + (f" ({each.detail})" if each.detail else "")
    names = list(shown.values())
    more = [f"{len(names) - _MOST_NAMED} more"] if len(names) > _MOST_NAMED else []
    return ", ".join([*names[:_MOST_NAMED], *more])
