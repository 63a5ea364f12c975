"""`cluttergen import`: from meshes, URDF, SDF, MJCF or YCB to a pool of measured bodies, or to a support."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from cluttergen_jax.api.import_ import import_pool, import_support
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.errors import ConfigError

if TYPE_CHECKING:
    from cluttergen_jax.importing.run import ImportReport

_MOST_DEAR = 3
"""So many objects are named for what they cost."""


@options_from(
    import_pool,
    import_support,
    sources=Positional[tuple[str, ...]],
    pool=str | None,
    path=Annotated[str | None, arg(name="support")],
    licence=Annotated[str, arg(aliases=["--license"])],
)
class Import(Options):
    """Import objects as a pool, or a table: OBJ, STL, PLY, GLB, GLTF, DAE, URDF, SDF, MJCF, or `ycb`.

    Example: `cluttergen import my_meshes/ --pool mine --scale 0.001`
    """

    def run(self) -> int:
        """Runs the command: 0, or 1 if an object could not be imported."""
        if self.path is not None:
            return self._import_support()
        if self.pool is None or self.name is not None:
            raise ConfigError(
                "import with neither --pool nor --support" if self.pool is None else "--name with --pool",
                "SOURCES --pool NAME for objects, or --support FILE [--name NAME] for a table",
            )
        report = self.call(import_pool)
        print_report(report)
        return 1 if report.failures else 0

    def _import_support(self) -> int:
        if self.sources or self.pool is not None:
            raise ConfigError("--support together with sources or --pool", "one of them", "two commands")
        from cluttergen_jax.assets.support_file import user_supports

        ignored = ("decomposition", "jobs", "time_limit", "progress", "cluster", "workers")
        hint = "leaving it out: a table is not an object"
        support = self.call(import_support, "with --support", hint, ignored)
        x, y = support.region.half_extents
        print(
            f"{user_supports() / support.name}: top at {support.top:.3f} m, "
            f"made of {len(support.boxes)} boxes; "
            f"the queried region is {2 * x:.3f} x {2 * y:.3f} m\nUse it: --support {support.name}"
        )
        return 0


def print_report(report: ImportReport) -> None:
    """What was made, which axes were taken for up, what was skipped, and what failed, and why."""
    from cluttergen_jax.cli.pool_table import pool_table

    if report.objects:
        print(with_flags(pool_table(report.objects), Import))
        made = len(report.objects) - report.num_cached
        print(
            f"{report.path}: {len(report.objects)} objects ({made} made, {report.num_cached} from the cache)"
        )
    if report.costs:
        print(_cost_line(report))
    for (axis, reason), names in _grouped(
        [(each.axis, each.reason, n) for n, each in report.up_axes.items()]
    ):
        print(f"up is {axis} ({with_flags(reason, Import)}): {names}")
    if any(each.axis == "y" for each in report.up_axes.values()):
        print('  (an object that lies on its side: --up z, or up = "z" for its file in objects.toml)')
    if report.skipped:
        print(f"{len(report.skipped)} skipped:")
        for (reason,), names in _grouped([(each.reason, each.name) for each in report.skipped]):
            print(f"  {reason}: {names}")
    if report.failures:
        print(f"{len(report.failures)} failed:", file=sys.stderr)
        for failure in report.failures:
            # A source that could not be found is named in its reason already.
            is_named, reason = failure.reason.startswith(failure.name), with_flags(failure.reason, Import)
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
