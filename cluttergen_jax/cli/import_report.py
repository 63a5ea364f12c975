"""What an import did, printed: objects, axes, what belongs to what, what was passed over and what failed."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.left_out import left_out_text

if TYPE_CHECKING:
    from cluttergen_jax.importing.run import ImportReport

_MOST_DEAR = 3
"""So many objects are named for what they cost."""

_OF_POSES = (
    "  (an object in a pose that you do not want: `cluttergen pool pose POOL OBJECT` lists its\n"
    '  poses and changes it; --up file, or up = "file" in objects.toml, keeps those of the files)'
)


def print_report(report: ImportReport, command: Any) -> None:
    """What was made, which axes were taken for up, what was skipped, left out, and what failed, and why.

    Args:
      command: the class of the command, whose flags are named.
    """
    from cluttergen_jax.cli.pool_table import pool_table

    if report.objects:
        print(with_flags(pool_table(report.objects), command))
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
    for (axis, reason), names in _grouped(
        [(each.axis, each.reason, n) for n, each in report.up_axes.items()]
    ):
        print(f"up is {axis} ({with_flags(reason, command)}): {names}")
    if report.objects:
        print(_OF_POSES)
    pieces = [each for each in report.skipped if each.is_piece]
    if pieces:
        are = "file is a piece" if len(pieces) == 1 else "files are pieces"
        print(f"{len(pieces)} {are} of these objects (`ImportReport.skipped` has each)")
    others = [each for each in report.skipped if not each.is_piece]
    if others:
        print(f"{len(others)} skipped:")
        for (reason,), names in _grouped([(each.reason, each.name) for each in others]):
            print(f"  {with_flags(reason, command)}: {names}")
    print(with_flags(left_out_text(report.left_out), command), end="")
    if report.failures:
        print(f"{len(report.failures)} failed:", file=sys.stderr)
        for failure in report.failures:
            # A source that could not be found is named in its reason already.
            is_named, reason = failure.reason.startswith(failure.name), with_flags(failure.reason, command)
            print(f"  {reason if is_named else f'{failure.name}: {reason}'}", file=sys.stderr)


def _cost_line(report: ImportReport) -> str:
    """What all objects cost together, and which of them most."""
    dear = sorted(report.costs, key=lambda name: -report.costs[name].seconds)[:_MOST_DEAR]
    told = ", ".join(f"{name} {report.costs[name].seconds:.1f} s" for name in dear)
    together = f"{report.cost.seconds:.1f} s of work, {report.cost.cpu_seconds:.1f} CPU-seconds"
    return f"cost: {together}; most: {told}" if len(report.costs) > 1 else f"cost: {together}"


def _grouped(rows: Sequence[tuple[str, ...]]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Rows that agree in all but the last entry, which is a name: what they agree in, and the names."""
    for head, group in groupby(sorted(rows), key=lambda row: row[:-1]):
        yield head, ", ".join(row[-1] for row in group)
