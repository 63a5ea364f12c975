"""`cluttergen import`: from meshes, URDF, SDF, MJCF or YCB to a pool of measured bodies, or to a support."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from cluttergen_jax.api.import_ import import_pool, import_support
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import Options, command
from cluttergen_jax.cli.pools import pool_table, surface_table
from cluttergen_jax.errors import ConfigError

if TYPE_CHECKING:
    from cluttergen_jax.importing.run import ImportReport
    from cluttergen_jax.importing.scenery import LeftOut


@command(
    import_pool,
    import_support,
    sources=Positional[tuple[str, ...]],
    pool=str | None,
    path=Annotated[str | None, arg(name="support")],
    licence=Annotated[str, arg(aliases=["--license"])],
)
def run_import(options: Options) -> int:
    """Import objects as a pool, or a table: OBJ, STL, PLY, GLB, GLTF, DAE, URDF, SDF, MJCF, or `ycb`.

    Example: `cluttergen import my_meshes/ --pool mine --scale 0.001`
    """
    if options.path is not None:
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
